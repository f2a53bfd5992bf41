#!/usr/bin/env bash
# The engine alone: install requirements-core.txt and the package into an environment of its own, 0.6 GB, and use there
# all that needs no network. With `install` nothing is used yet. DEEP_CONTACT_CORE names its folder, DEEP_CONTACT_PYTHON
# the python.
set -euo pipefail
cd "$(dirname "$0")/../.."
folder="${DEEP_CONTACT_CORE:-${TMPDIR:-/tmp}/deep_contact_core}"
[ -x "$folder/bin/python" ] || "${DEEP_CONTACT_PYTHON:-python3}" -m venv "$folder"
install=("$folder/bin/python" -m pip install --quiet --no-compile --disable-pip-version-check)
"${install[@]}" -r requirements-core.txt
"${install[@]}" --no-deps --editable .
"${install[@]}" pytest pytest-timeout
[ "${1:-}" != install ] || exit 0
for package in keras tensorflow highspy; do
    ! "$folder/bin/python" -c "import $package" 2> /dev/null || { echo "$package: expected none in $folder"; exit 1; }
done
"$folder/bin/python" -m pytest -p no:cacheprovider -m "" tests/behaviour/test_without_keras.py
echo "The engine alone works without Keras, TensorFlow and HiGHS."
