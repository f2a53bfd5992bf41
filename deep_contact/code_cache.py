"""Keep Numba's on-disk cache true to the sources.

Numba notices when the file of a cached function changes, but not when a function or a constant changes that lies in
another file and has been compiled into it. After an update of the package, old physics would go on silently.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

_PACKAGE = Path(__file__).parent


def drop_stale_code(package: Path = _PACKAGE) -> bool:
    """Delete the package's cached machine code if any of its sources changed since it was made. Says whether it did.

    Sources are compared by name, size and time of change. Where the folder cannot be written there is nothing to do:
    Numba then keeps its cache elsewhere, and a package that cannot be written is replaced as a whole.
    """
    stamp_file = package / "__pycache__" / "sources.stamp"
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        stat = path.stat()
        digest.update(f"{path.relative_to(package)} {stat.st_size} {stat.st_mtime_ns}\n".encode())
    stamp = digest.hexdigest()
    try:
        if stamp_file.read_text() == stamp:
            return False
    except OSError:
        pass
    try:
        for pattern in ("*.nbi", "*.nbc"):
            for path in package.rglob(f"__pycache__/{pattern}"):
                path.unlink(missing_ok=True)
        stamp_file.parent.mkdir(exist_ok=True)
        temporary = stamp_file.with_name(f"{stamp_file.name}.{os.getpid()}")
        temporary.write_text(stamp)
        os.replace(temporary, stamp_file)
    except OSError:
        return False
    return True
