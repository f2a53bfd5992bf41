#!/usr/bin/env bash
# From a fresh checkout to the first picture: makes .venv, installs, and draws a pile and how fast the solver converges
# from each start. Arguments go to scripts/quickstart.py: `--verbose` prints all numbers.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/venv.sh
ensure_venv ""
"$PYTHON" scripts/quickstart.py "$@"
