"""Make a figure, and draw it again from its stored numbers.

For those who need a figure: each figure of the thesis is made by one script, which has the number of the figure. With
`--replot` the script draws the stored numbers, and computes nothing. The stored numbers are plain JSON, so a picture of
your own takes a few lines.
"""

import subprocess
import sys

import deep_contact as dc

figure = [sys.executable, "-m", "deep_contact", "figure", "3.3", "--out", "."]
subprocess.run(figure, check=True)  # writes figure_3_3.json and figure_3_3.png
subprocess.run([*figure, "--replot"], check=True)

found = dc.results.read_results("figure_3_3.json")
print(found["id"], found["title"], "by version", found["provenance"]["version"])
for claim in found["claims"]:
    print("holds" if claim["holds"] else "does not hold", "-", claim["text"])
