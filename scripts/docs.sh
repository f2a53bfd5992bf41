#!/usr/bin/env bash
# The documentation site, with its examples executed, as web pages in build/docs: makes .venv if needed and installs
# MkDocs. A warning is an error. DEEP_CONTACT_GALLERY=quick leaves out the longest examples.
set -euo pipefail
cd "$(dirname "$0")/.."
. scripts/venv.sh
ensure_venv "[docs]"
"$PYTHON" -m mkdocs build --strict "$@"
echo "The site is build/docs/index.html."
