"""python scripts/figure_5_1_snapshots.py: snapshots of the experiment's scene, coloured by impulse."""

from deep_contact import figures
from deep_contact.studies import starts

FIGURE = starts.snapshots_figure(
    id="5.1", title="Where the pile carries its impulses", times=[0.5, 1.2, 1.8, 3.0], colour_by="impulse"
)
figures.run_as_script(FIGURE, __name__)
