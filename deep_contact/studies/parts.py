"""Studies in parts: every finished part is stored, so that an interrupted study goes on where it stopped."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from pathlib import Path

from deep_contact import parallel
from deep_contact.reporting import results


def done(
    parts: Sequence[tuple[str, dict]], functions: Mapping[str, Callable], *, work: Path, jobs: int | Executor, text: str
) -> list:
    """The results of parts (name, arguments), in their order: read from `work`, or computed and stored there.

    functions: name -> function of the arguments, found by import, whose result JSON can hold. A part with other
    arguments is another part. One that JSON cannot read is computed again. jobs: as in `parallel.finished`; a process
    stores its own parts. text: of the progress bar.
    """
    work.mkdir(parents=True, exist_ok=True)
    tasks = [
        (functions[name], arguments, work / f"{name}_{arguments['n_bodies']}_{digest_of([name, arguments])}.json")
        for name, arguments in parts
    ]
    return parallel.parallel_map(_done, tasks, jobs=jobs, progress=parallel.progress_bar, text=text)


def digest_of(value) -> str:
    """Sixteen hexadecimal digits of a value that JSON can hold."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:16]


def _done(task: tuple[Callable, dict, Path]):
    function, arguments, path = task
    with suppress(FileNotFoundError, ValueError):
        return json.loads(path.read_text(encoding="utf-8"))
    result = results.plain(function(**arguments))
    results.write_json(path, result)
    return result
