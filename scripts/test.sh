#!/usr/bin/env bash
# All fast tests, in two processes: makes .venv if needed, installs with the test tools and the peer engines.
# Arguments go to pytest: `bash scripts/test.sh -m slow` runs the tests that take minutes, `-n 0` runs in one process.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/venv.sh
ensure_venv "[test,peers]"
"$PYTHON" -m pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder "$@"
