#!/usr/bin/env bash
# Predict with the oldest and with the newest Keras and TensorFlow that setup.cfg allows, each in an environment of its
# own, and compare with the stored numbers: `bash tests/tools/check_keras_range.sh [install] [oldest] [newest]`, both by
# default. With `install` nothing is predicted yet.
# DEEP_CONTACT_RANGE names a folder for the environments (1.5 GB each), DEEP_CONTACT_PYTHON the python. The oldest
# TensorFlow (2.16) supports Python up to 3.12: without one at hand, that end is skipped, with the reason.
set -euo pipefail
cd "$(dirname "$0")/../.."
. scripts/venv.sh
folder="${DEEP_CONTACT_RANGE:-${TMPDIR:-/tmp}/deep_contact_range}"
mkdir -p "$folder"
sed -nE 's/^ +(keras|tensorflow) >=([0-9.]+)$/\1 ==\2.*/p' setup.cfg > "$folder/oldest.txt"
: > "$folder/newest.txt"
given="${DEEP_CONTACT_PYTHON:-}"
only_install=""
[ "${1:-}" != install ] || { only_install=yes; shift; }
[ $# -gt 0 ] || set -- oldest newest
for end; do
    [ -e "$folder/$end.txt" ] || { echo "$end: expected oldest or newest" >&2; exit 2; }
    if [ "$end" = oldest ]; then
        DEEP_CONTACT_PYTHON=""
        for python in "${given:-python3}" python3.12 python3.11 python3.10; do
            if "$python" -c 'import ensurepip, sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 12))' 2> /dev/null
            then
                DEEP_CONTACT_PYTHON="$python"
                break
            fi
        done
        if [ -z "$DEEP_CONTACT_PYTHON" ]; then
            echo "oldest Keras: skipped, for it needs Python 3.10 to 3.12 and ${given:-python3} is $("${given:-python3}" -V)"
            continue
        fi
    else
        DEEP_CONTACT_PYTHON="${given:-python3}"
    fi
    export PIP_CONSTRAINT="$folder/$end.txt" DEEP_CONTACT_VENV="$folder/$end"
    ensure_venv ""
    "$PYTHON" -m pip install --quiet --no-compile --disable-pip-version-check pytest pytest-timeout
    [ -z "$only_install" ] || continue
    "$PYTHON" -m pip list 2> /dev/null | grep -E '^(keras|tensorflow|numpy|numba|h5py) '
    "$PYTHON" -m pytest tests/cnn/test_stored_predictions.py tests/cnn/test_inference.py tests/cnn/test_convolution.py
done
