#!/usr/bin/env bash
# From a fresh checkout to the first picture: makes .venv, installs, and draws Figure 3.8 in its quick form.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/venv.sh
ensure_venv ""
"$PYTHON" scripts/figure_3_8_sph.py --quick --out figures
echo "The picture is figures/figure_3_8.png, its numbers are figures/figure_3_8.json."
