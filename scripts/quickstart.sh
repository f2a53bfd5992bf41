#!/usr/bin/env bash
# From a fresh checkout to the first picture: makes .venv, installs, and draws Figure 5.9 in its quick form: the
# starts of the thesis, with the shipped networks, on a held-out scene.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/venv.sh
ensure_venv ""
"$PYTHON" scripts/figure_5_9_cnn.py --quick --out figures
echo "The picture is figures/figure_5_9.png, its numbers are figures/figure_5_9.json."
