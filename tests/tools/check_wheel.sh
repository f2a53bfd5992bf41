#!/usr/bin/env bash
# The package without its repository: build the source distribution, from that the wheel; install the wheel beside the
# packages of .venv and use it in an empty folder; pass the tests of files in the unpacked source distribution; let strict
# type checkers read a program of a user.
# DEEP_CONTACT_WHEEL_PYTHON names another python, such as python3.13: then the wheel comes with its own packages from
# the index (2.6 GB), and every program of the gallery runs.
set -euo pipefail
cd "$(dirname "$0")/../.."
. scripts/venv.sh
ensure_venv "[test,peers]"
PYTHON="$(cd "$(dirname "$PYTHON")" && pwd)/$(basename "$PYTHON")"
export TF_CPP_MIN_LOG_LEVEL=3 CUDA_VISIBLE_DEVICES=""
unset PYTHONPATH DEEP_CONTACT_MODELS

work="$(mktemp -d)"
tests="" types=""
trap '[ -z "$tests$types" ] || kill $tests $types 2> /dev/null || true; rm -rf "$work"' EXIT
mkdir "$work/repository" "$work/empty"

# From the files that git knows, or would add: caches and old builds must not be what makes it work.
comm -23 <(git ls-files --cached --others --exclude-standard | sort) <(git ls-files --deleted | sort) > "$work/expected"
tar cf - -T "$work/expected" | tar xf - -C "$work/repository"
"$PYTHON" -m build --no-isolation --outdir "$work" "$work/repository" > "$work/log" 2>&1 || { cat "$work/log"; exit 1; }
tar xzf "$work"/deep_contact-*.tar.gz -C "$work"
rm "$work"/deep_contact-*.tar.gz
source="$(echo "$work"/deep_contact-*/)"
# Building adds its records.
if ! (cd "$source" && find * .ci .gitignore -type f | grep -vE '^PKG-INFO$|\.egg-info/' | sort) |
    diff "$work/expected" -; then
    echo "the source distribution (>) is not the repository (<): see MANIFEST.in"
    exit 1
fi

# Meanwhile, the tests of files that compile nothing.
(
    cd "$source"
    PYTHONPATH="$source" "$PYTHON" -m pytest -p no:cacheprovider tests/io/test_provenance.py \
        tests/io/test_shipped.py tests/cnn/test_inference.py::test_every_shipped_file_is_registered_under_its_hash \
        tests/cnn/test_inference.py::test_models_are_found_in_the_folder_that_is_named_and_in_the_current_one \
        tests/test_command_line.py::test_every_figure_and_table_is_listed_and_reached_by_its_name \
        tests/documents/test_readme.py::test_tables_and_sentences_have_the_numbers_of_the_results_files > "$work/log" 2>&1
) &
tests=$!

other="${DEEP_CONTACT_WHEEL_PYTHON:-}"
"${other:-$PYTHON}" -m venv --without-pip "$work/env"
packages="$("$work/env/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')"
install=("$PYTHON" -m pip --python "$work/env/bin/python" install --quiet --disable-pip-version-check)
if [ -n "$other" ]; then
    "${install[@]}" "$work"/deep_contact-*.whl
else
    # The folders of packages are added to an environment with the wheel alone. Their .pth files, which name the
    # checkout, are not read there.
    "${install[@]}" --no-deps --no-index "$work"/deep_contact-*.whl
    # Machine code that the tests have made: whether it fits is told by the contents of the sources. Status 1 of tar:
    # another process has written a file meanwhile.
    find deep_contact -name '*.nb[ic]' | { tar cf - -T - || [ $? = 1 ]; } | tar xf - -C "$packages"
    "$PYTHON" -c 'import sys; print(*(path for path in sys.path if path.endswith("-packages")), sep="\n")' \
        > "$packages/outside.pth"
fi
export PATH="$work/env/bin:$PATH"

# What strict type checkers say of the wheel, meanwhile.
(
    mkdir "$work/typed"
    cd "$work/typed"
    cp "$source/tests/tools/user_script.py" .
    "$PYTHON" -m mypy --strict --python-executable "$work/env/bin/python" --cache-dir "$work/mypy" user_script.py
    "$PYTHON" -m pyright --pythonpath "$work/env/bin/python" user_script.py
) > "$work/types" 2>&1 &
types=$!

cd "$work/empty"
python - "$packages" << 'CHECKS'
import sys
from importlib.metadata import version
from pathlib import Path

import deep_contact as dc

assert Path(dc.__file__).parent == Path(sys.argv[1]).resolve() / "deep_contact", dc.__file__
assert version("deep-contact") == dc.__version__
run = dc.simulate(dc.circles_in_box(n_bodies=20, size=12.0), steps=100)
assert run.state.contacts.count > 0
dc.write_state("later.xml", run.state)
assert dc.recommend(run.state).solver.sweeps > 0
dc.plan(run.state)
state = dc.read_state(dc.sample_file())
assert dc.load_model().card["architecture"] == "thesis"
normal, tangent = dc.load_model().predict(state)
assert normal.shape == tangent.shape == (state.contacts.count,)
for start in ("builtin", "cnn", "far field", (normal, tangent)):
    assert dc.solve_contacts(state, solver=dc.PGS(sweeps=30), start=start).record.sweeps > 0
dc.load_model("far field, no past")
CHECKS
deep-contact --version
deep-contact simulate later.xml --steps 20 --warm-start "far field" --out run.h5
deep-contact predict --no-pictures "$(deep-contact sample rest_362)"
deep-contact generate-data --quick --jobs 1
deep-contact train --from "far field" --data data/generated/quick --epochs 1 --states-per-epoch 32 --out trained
deep-contact simulate --bodies 10 --steps 8 --every 4 --out film.gif
deep-contact simulate --bodies 10 --steps 8 --every 4 --out run.html
deep-contact figure 5.3 --quick > figure.txt
python "$source/scripts/figure_3_5_bilinear.py" --quick > script.txt  # of a clone, with the installed package
deep-contact table 5.1 --quick > table.txt
programs=("$source"/docs/gallery/predict_impulses.py)
[ -z "$other" ] || programs=("$source"/docs/gallery/*.py)
for program in "${programs[@]}"; do
    mkdir "${program##*/}" && (cd "${program##*/}" && python "$program" > printed.txt)
done
for file in later.xml run.h5 predictions/rest_362.csv film.gif run.html trained/model.h5 figures/figure_5_3.png figures/figure_3_5.png figures/table_5_1.json; do
    [ -s "$file" ] || { echo "$file: expected a file, got none"; exit 1; }
done

wait "$types" || { cat "$work/types"; exit 1; }
wait "$tests" || { cat "$work/log"; exit 1; }
echo "The wheel works without the repository, and the source distribution passes its tests of files."
