#!/usr/bin/env bash
# From a fresh clone to two pictures in figures/: a pile that falls, and how fast the solver converges from each start.
# Beside the second picture it compiles ahead what first runs need. DEEP_CONTACT_CONSTRAINTS=constraints.txt: the versions
# of data/reference.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/venv.sh
ensure_venv ""
"$PYTHON" scripts/figure_3_6_snapshots.py "$@"
log=$(mktemp)
"$PYTHON" -m deep_contact warm-up >"$log" 2>&1 &
warm_up=$!
trap 'kill $warm_up 2>/dev/null || true; rm -f "$log"' EXIT
"$PYTHON" scripts/figure_5_7_starts.py --quick "$@"
echo "Both pictures are drawn. What other scenes need is compiled in the background:"
wait $warm_up || { cat "$log"; exit 1; }
cat "$log"
cat <<END

Two pictures:
  figures/figure_3_6.png  a pile of circles falls, at four times; the colour is the speed
  figures/figure_5_7.png  how fast the solver converges from each start: the lower a line, the better the start
Go on with
  $PYTHON -m deep_contact simulate --accuracy fast --out pile.gif  # a film of a pile that falls
  $PYTHON -m deep_contact simulate --bodies 100 --accuracy fast --out run.h5
  $PYTHON -m deep_contact figure 3.3  # any figure or table by its number; without one, what there is
END
