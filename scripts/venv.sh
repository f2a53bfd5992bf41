# Sourced by quickstart.sh and test.sh: `ensure_venv EXTRAS` makes .venv if needed, installs the package into it with
# the extras unless that has been done for this setup.cfg, and leaves its python in $PYTHON.
# DEEP_CONTACT_VENV names another folder for it, DEEP_CONTACT_PYTHON another python to make it with.

ensure_venv() {
    local extras="$1" venv="${DEEP_CONTACT_VENV:-.venv}" stamp
    PYTHON="$venv/bin/python"
    stamp="$venv/installed$(echo "$extras" | tr -c 'a-z\n' '-')"
    if [ -x "$PYTHON" ] && cmp -s setup.cfg "$stamp"; then
        return
    fi
    echo "installing into $venv (a few minutes; TensorFlow is a few hundred MB)"
    if [ ! -x "$PYTHON" ]; then
        "${DEEP_CONTACT_PYTHON:-python3}" -m venv "$venv"
    fi
    # What pip says is worth a screen only if it fails.
    if ! "$PYTHON" -m pip install --quiet --disable-pip-version-check --editable ".$extras" >"$venv/install.log" 2>&1; then
        cat "$venv/install.log" >&2
        return 1
    fi
    cp setup.cfg "$stamp"
}
