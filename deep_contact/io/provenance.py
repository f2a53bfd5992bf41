"""Provenance of results: version and commit of the package, versions of other packages, and the processor."""

from __future__ import annotations

import hashlib
import os
import platform
import re
import subprocess
from contextlib import suppress
from importlib import metadata
from pathlib import Path

from deep_contact.io.shipped import find
from deep_contact.state.constants import VERSION

PACKAGES = ("numba", "numpy", "scipy", "keras", "tensorflow", "lxml", "matplotlib")
"""Packages whose versions are recorded if they are installed."""


def provenance(*, seed: int | None = None, wall_s: float = 0.0, options: dict | None = None) -> dict:
    """Return the provenance of results: version, commit, Python, packages, processor, seed and wall time, s.

    options: options of the run, or None. If they are passed, the record also has "inputs": path -> digest of each file
    that they name. The name of the machine is not recorded. No package is imported to learn its version.
    """
    record = {
        "version": VERSION,
        "commit": commit(),
        "python": platform.python_version(),
        "packages": package_versions(),
        "cpu": processor(),
        "seed": seed,
        "wall_s": round(float(wall_s), 3),
    }
    return record if options is None else record | {"inputs": digests(options)}


def commit() -> str:
    """Return the 40-digit hash of the package's commit, or "unknown" for an installed package or without git.

    "+changes" follows the digits if tracked files differ from the commit. Results under data/reference do not count:
    they are made one after the other, and none depends on another.
    """
    try:
        # An installed package may lie inside the checkout of another project. It is then not tracked there, and this
        # command raises an error.
        _git("ls-files", "--error-unmatch", "__init__.py")
        digits = _git("rev-parse", "HEAD")
        changed = _git("status", "--porcelain", "--untracked-files=no", "--", ":/", ":(top,exclude)data/reference")
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    return digits + ("+changes" if changed else "")


def digests(options) -> dict[str, str]:
    """Return path -> SHA-256 of each file that the options of a run name, such as model files.

    options: dicts, lists and values, nested. A text counts as a path if it ends in a suffix such as ".h5", and if
    `shipped.find` finds this file.
    """
    if isinstance(options, dict):
        options = list(options.values())
    if isinstance(options, (list, tuple)):
        return {name: digest for item in options for name, digest in digests(item).items()}
    with suppress(OSError):
        if isinstance(options, str) and re.search(r"\.\w+$", options):
            return {options: hashlib.sha256(find(options).read_bytes()).hexdigest()}
    return {}


def _git(*arguments: str) -> str:
    package = Path(__file__).resolve().parents[1]
    done = subprocess.run(["git", *arguments], cwd=package, capture_output=True, text=True, timeout=20, check=True)
    return done.stdout.strip()


def package_versions() -> dict[str, str]:
    """Return package -> version for each installed package of `PACKAGES`, without importing any."""
    versions = {}
    for distribution in (*PACKAGES, "tensorflow-cpu"):  # TensorFlow is published under both names
        with suppress(metadata.PackageNotFoundError):
            versions[distribution.removesuffix("-cpu")] = metadata.version(distribution)
    return versions


def processor() -> str:
    """Return the model of the processor and its number of cores, such as "AMD EPYC 9R14, 2 cores"."""
    model = platform.processor() or platform.machine() or "unknown"
    with suppress(OSError):
        info = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
        named = re.search(r"^model name\s*:\s*(.+)$", info, re.MULTILINE)
        model = named[1].strip() if named else model
    return f"{model}, {os.cpu_count()} cores"
