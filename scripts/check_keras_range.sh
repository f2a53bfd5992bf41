#!/usr/bin/env bash
# Predict with the oldest and with the newest Keras and TensorFlow that setup.cfg allows, each in an environment of its
# own, and compare with the stored numbers. DEEP_CONTACT_RANGE names a folder for the environments (1.5 GB each),
# DEEP_CONTACT_PYTHON the python, which the oldest TensorFlow has to support (2.16: up to Python 3.12).
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/venv.sh
folder="${DEEP_CONTACT_RANGE:-${TMPDIR:-/tmp}/deep_contact_range}"
mkdir -p "$folder"
sed -nE 's/^ +(keras|tensorflow) >=([0-9.]+)$/\1 ==\2.*/p' setup.cfg > "$folder/oldest.txt"
: > "$folder/newest.txt"
for end in oldest newest; do
    export PIP_CONSTRAINT="$folder/$end.txt" DEEP_CONTACT_VENV="$folder/$end"
    ensure_venv "[test]"
    "$PYTHON" -m pip list 2> /dev/null | grep -E '^(keras|tensorflow|numpy|numba|h5py) '
    "$PYTHON" -m pytest tests/cnn/test_stored_predictions.py tests/cnn/test_inference.py tests/cnn/test_convolution.py
done
