"""What a wheel has beside the modules: files of `models/`, `scripts/` and `data/`, which lie below the package there.

`deep_contact.io.shipped` finds them in a wheel and in a checkout. All else is in `setup.cfg`.
"""

from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

SHIPPED = (
    "models/registry.json",
    "models/model.h5",
    "models/far_field.h5",
    "models/far_field_no_past.h5",
    "scripts/figure_*.py",
    "scripts/table_*.py",
    "scripts/all_figures.py",
    "scripts/generate_data.py",
    "scripts/predict.py",
    "scripts/train.py",
    "data/sample/*",
    "data/reference/run_tradeoff.json",  # Figures 6.1 and 6.2 draw it
)
"""30 MB installed, of which the thesis's network, models/model.h5, has 25."""


class BuildWithShippedFiles(build_py):
    """Copies them, except for an editable installation, which uses the checkout."""

    def run(self):
        super().run()
        if self.editable_mode:
            return
        root = Path(__file__).resolve().parent
        for pattern in SHIPPED:
            found = sorted(root.glob(pattern))
            if not found:
                raise FileNotFoundError(f"{pattern}: expected files of the wheel in {root}, got none")
            for path in found:
                target = Path(self.build_lib, "deep_contact", path.relative_to(root))
                self.mkpath(str(target.parent))
                self.copy_file(str(path), str(target))


setup(cmdclass={"build_py": BuildWithShippedFiles})
