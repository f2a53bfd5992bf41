#!/usr/bin/env bash
# All fast tests: makes .venv if needed, installs with the test tools, the peer engines and Dask. Arguments go to pytest,
# for instance `bash scripts/test.sh -m slow` for the tests that take minutes.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/venv.sh
ensure_venv "[test,peers,cluster]"
"$PYTHON" -m pytest "$@"
