# Sourced by quickstart.sh, test.sh and docs.sh: `ensure_venv EXTRAS` makes .venv if needed, installs the package into it
# with the extras, "[test,docs]", unless that has been done for this setup.cfg, and leaves its python in $PYTHON.
# DEEP_CONTACT_CONSTRAINTS names a file of versions for pip, such as constraints.txt: those that made data/reference.
# DEEP_CONTACT_VENV names another folder for it, DEEP_CONTACT_PYTHON another python to make it with.

ensure_venv() {
    local extra venv="${DEEP_CONTACT_VENV:-.venv}" missing="" stamps
    PYTHON="$venv/bin/python"
    stamps="installed $(printf '%s' "$1" | tr -d '[]' | tr ',' '\n' | sed 's/^/installed-/')"
    for extra in $stamps; do
        cmp -s setup.cfg "$venv/$extra" || missing=yes
    done
    if [ -x "$PYTHON" ] && [ -z "$missing" ]; then
        return
    fi
    echo "installing into $venv (a few minutes; TensorFlow is a few hundred MB)"
    if [ ! -x "$PYTHON" ]; then
        "${DEEP_CONTACT_PYTHON:-python3}" -m venv "$venv"
    fi
    # What pip says is worth a screen only if it fails.
    if ! "$PYTHON" -m pip install --quiet --no-compile --disable-pip-version-check \
        ${DEEP_CONTACT_CONSTRAINTS:+--constraint "$DEEP_CONTACT_CONSTRAINTS"} --editable ".$1" >"$venv/install.log" 2>&1; then
        cat "$venv/install.log" >&2
        return 1
    fi
    for extra in $stamps; do
        cp setup.cfg "$venv/$extra"
    done
}
