"""python scripts/figure_3_6_snapshots.py: snapshots of the falling pile, coloured by speed."""

from deep_contact import figures
from deep_contact.studies import starts

FIGURE = starts.snapshots_figure(id="3.6", title="How the pile falls", times=[0.0, 1.0, 2.0, 6.0], colour_by="speed")
figures.run_as_script(FIGURE, __name__)
