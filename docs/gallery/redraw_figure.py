"""Redraw a figure from its stored numbers.

For those who need a figure: each figure of the thesis is one script with its number. With `--replot` a script draws
what is stored, without computing anything. The numbers are plain JSON, so a picture of your own takes a few lines.
"""

import shutil
import subprocess
import sys
from pathlib import Path

import deep_contact as dc

root = Path(dc.__file__).parents[1]
shutil.copy(root / "data" / "reference" / "figure_3_3.json", ".")
script = root / "scripts" / "figure_3_3_kernels.py"
subprocess.run([sys.executable, script, "--replot", "--out", "."], check=True)  # writes figure_3_3.png

found = dc.results.read_results(root / "data" / "reference" / "figure_6_8.json")
print(found["id"], found["title"], "from commit", found["provenance"]["commit"])
for claim in found["claims"]:
    print("met" if claim["holds"] else "missed", "-", claim["text"])
