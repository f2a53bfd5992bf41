#!/usr/bin/env bash
# A wheel with machine code inside, for this platform and this Python: a lab or a CI installs it and compiles nothing.
# `bash scripts/wheel_with_code.sh [FOLDER]` writes it into FOLDER, by default dist/. The code is for the processors of
# x86-64-v3 (AVX2; Intel from 2013, AMD from 2015) and for the installed version of Numba. Where one of them differs, the
# package compiles as usual.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/venv.sh
ensure_venv ""
folder="${1:-dist}"
mkdir -p "$folder"
PYTHON="$(cd "$(dirname "$PYTHON")" && pwd)/$(basename "$PYTHON")"
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
"$PYTHON" -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir "$work" .
"$PYTHON" -m pip install --quiet --disable-pip-version-check --target "$work/tools" wheel
PYTHONPATH="$work/tools" "$PYTHON" -m wheel unpack --dest "$work/tree" "$work"/deep_contact-*.whl
tree="$(echo "$work"/tree/deep_contact-*)"
# The file names the target. `deep_contact.compiled` reads it, here and where the wheel is installed.
echo x86-64-v3 > "$tree/deep_contact/compiled/target.txt"
(cd "$work" && env -u NUMBA_CACHE_DIR PYTHONPATH="$tree" "$PYTHON" -m deep_contact warm-up)
find "$tree" -name '*.pyc' -delete
tag="$("$PYTHON" -c 'import sys; print(f"cp{sys.version_info[0]}{sys.version_info[1]}")')"
sed -i "s/^Root-Is-Purelib: .*/Root-Is-Purelib: false/; s/^Tag: .*/Tag: $tag-$tag-linux_x86_64/" "$tree"/deep_contact-*.dist-info/WHEEL
PYTHONPATH="$work/tools" "$PYTHON" -m wheel pack --dest-dir "$folder" "$tree"
