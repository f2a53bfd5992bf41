"""Studies in parts: every finished part is stored, so that an interrupted study goes on where it stopped.

Ours in place of joblib.Memory, which stores where a task runs: processes send back what this one stores.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from pathlib import Path

from deep_contact import parallel
from deep_contact.reporting import figures, results


def done(
    parts: Sequence[tuple[str, dict]], functions: Mapping[str, Callable], *, work: Path, jobs: int | Executor, text: str
) -> list:
    """The results of parts (name, arguments), in their order: read from `work`, or computed and stored there.

    functions: name -> function of the arguments, found by import, whose result JSON can hold. A part with other
    arguments is another part. One that JSON cannot read is computed again. jobs: as in `parallel.finished`. text: of
    the progress bar.
    """
    paths = [work / f"{name}_{arguments['n_bodies']}_{digest_of([name, arguments])}.json" for name, arguments in parts]
    stored = [_read(path) for path in paths]
    missing = [i for i, one in enumerate(stored) if one is None]
    work.mkdir(parents=True, exist_ok=True)
    tasks = [(functions[parts[i][0]], parts[i][1]) for i in missing]
    with closing(parallel.finished(_compute, tasks, jobs=jobs)) as computed:
        for k, result in figures.progress_bar(computed, total=len(missing), text=text):
            stored[missing[k]] = (result,)
            results.write_json(paths[missing[k]], result)
    return [result for (result,) in stored]


def digest_of(value) -> str:
    """Sixteen hexadecimal digits of a value that JSON can hold."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:16]


def _read(path: Path) -> tuple | None:
    """(What a file holds,); None where there is none that JSON can read."""
    try:
        return (json.loads(path.read_text(encoding="utf-8")),)
    except (FileNotFoundError, ValueError):
        return None


def _compute(task: tuple[Callable, dict]):
    function, arguments = task
    return results.plain(function(**arguments))
