"""Studies in parts: every finished part is stored, so that an interrupted study goes on where it stopped."""

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

    functions: name -> function of the arguments, found by import, whose result JSON can hold. A part is known by name
    and arguments: one with other settings is another part. One that JSON cannot read is computed again.
    jobs: as in `parallel.finished`. text: of the progress bar.
    """
    paths = []
    for name, arguments in parts:
        digest = hashlib.sha256(json.dumps([name, arguments], sort_keys=True).encode()).hexdigest()[:16]
        paths.append(work / f"{name}_{arguments['n_bodies']}_{digest}.json")
    missing = [i for i, path in enumerate(paths) if _read(path) is None]
    work.mkdir(parents=True, exist_ok=True)
    tasks = [(functions[parts[i][0]], parts[i][1]) for i in missing]
    with closing(parallel.finished(_compute, tasks, jobs=jobs)) as found:
        for k, result in figures.progress_bar(found, total=len(missing), text=text):
            with results.replacing(paths[missing[k]]) as temporary:
                temporary.write_text(json.dumps(result, allow_nan=False), encoding="utf-8")
    return [_read(path)["result"] for path in paths]


def _read(path: Path) -> dict | None:
    """The file of a part, under "result"; None where there is none that JSON can read."""
    try:
        return {"result": json.loads(path.read_text(encoding="utf-8"))}
    except (FileNotFoundError, ValueError):
        return None


def _compute(task: tuple[Callable, dict]):
    function, arguments = task
    return results.plain(function(**arguments))
