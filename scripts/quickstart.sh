#!/usr/bin/env bash
# From a fresh clone to two pictures in figures/: a pile that falls, and how fast the solver converges from each start.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/venv.sh
ensure_venv ""
"$PYTHON" scripts/figure_3_6_snapshots.py "$@"
"$PYTHON" scripts/figure_5_7_starts.py --quick "$@"
