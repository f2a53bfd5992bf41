# Sourced by quickstart.sh and test.sh: `ensure_venv EXTRAS` makes .venv if needed, installs the package into it with
# the extras unless that has been done for this setup.cfg, and leaves its python in $PYTHON.
# DEEP_CONTACT_VENV names another folder for it, DEEP_CONTACT_PYTHON another python to make it with.

ensure_venv() {
    local extras="$1" venv="${DEEP_CONTACT_VENV:-.venv}" stamp
    PYTHON="$venv/bin/python"
    if [ ! -x "$PYTHON" ]; then
        echo "making the virtual environment $venv"
        "${DEEP_CONTACT_PYTHON:-python3}" -m venv "$venv"
    fi
    stamp="$venv/installed$(echo "$extras" | tr -c 'a-z\n' '-')"
    if ! cmp -s setup.cfg "$stamp"; then
        echo "installing the package and what it needs (TensorFlow is a few hundred MB)"
        "$PYTHON" -m pip install --quiet --disable-pip-version-check --editable ".$extras"
        cp setup.cfg "$stamp"
    fi
}
