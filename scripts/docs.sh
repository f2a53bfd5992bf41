#!/usr/bin/env bash
# The API reference from the docstrings, as web pages in build/docs: makes .venv if needed and installs pdoc.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/venv.sh
ensure_venv "[docs]"
# Without compilation the kernels are plain functions, whose signatures and docstrings pdoc can see.
NUMBA_DISABLE_JIT=1 "$PYTHON" - <<'PYTHON'
from pathlib import Path

import pdoc

import deep_contact
import deep_contact.cnn

# pdoc looks names up where they are stored; ours are found when they are first asked for.
for package in (deep_contact, deep_contact.cnn):
    for name in package.__all__:
        vars(package)[name] = getattr(package, name)
pdoc.pdoc("deep_contact", output_directory=Path("build/docs"))
PYTHON
echo "The reference is build/docs/index.html."
