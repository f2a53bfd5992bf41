"""Pictures of the stored results: letters that can be read, nothing clipped, no legend over data."""

import numpy as np
import pytest
from conftest import SCRIPTS, load_script
from matplotlib.text import Text

from deep_contact.reporting import plotting, results, scripts

STORED = {
    name: path
    for name, path in scripts.find(SCRIPTS).items()
    if "T" not in name and results.reference(scripts.stem(path))
}

SMALLEST = 8.0
"""Points of a letter as shown, on a page of `plotting.PAGE` inches."""


def picture_of(name):
    """A stored figure, drawn and laid out."""
    figure = load_script(STORED[name].stem).FIGURE
    found = results.reference(figure.stem)
    with plotting.style():
        picture = figure.draw(found["data"], found["options"])
        picture.draw_without_rendering()
    return picture


def shown_texts(picture):
    """The texts that can be seen: no empty ones, and no labels of ticks outside of their axis."""
    hidden = set()
    for ax in picture.axes:
        for axis in (ax.xaxis, ax.yaxis):
            low, high = sorted(axis.get_view_interval())
            for tick in axis.get_major_ticks() + axis.get_minor_ticks():
                seen = ax.axison and tick.get_visible() and low <= tick.get_loc() <= high
                hidden |= set() if seen else {tick.label1, tick.label2}
    texts = picture.findobj(lambda artist: isinstance(artist, Text) and artist.get_visible())
    return [text for text in texts if text.get_text().strip() and text not in hidden]


def points_of(ax):
    """Where the axes show lines, (n, 2), pixels."""
    lines = [line.get_transform().transform(line.get_xydata()) for line in ax.lines if line.get_visible()]
    points, seen = np.concatenate([np.empty((0, 2)), *lines]), ax.get_window_extent()
    return points[((points >= seen.min) & (points <= seen.max)).all(axis=1)]


@pytest.mark.parametrize("name", STORED)
def test_a_picture_can_be_read(name):
    picture = picture_of(name)
    scale = min(1.0, plotting.PAGE / picture.get_figwidth())
    texts = shown_texts(picture)
    small = {text.get_text(): text.get_fontsize() * scale for text in texts if text.get_fontsize() * scale < SMALLEST}
    assert not small, "letters below 8 pt where a page shows them"
    width, height = picture.bbox.size
    outside = {
        text.get_text(): box.extents
        for text in texts
        for box in [text.get_window_extent()]
        if min(box.x0, box.y0, width - box.x1, height - box.y1) < -1
    }
    assert not outside, "texts that the picture cuts off"
    for ax in picture.axes:
        if ax.get_legend():
            box = ax.get_legend().get_window_extent()
            inside = (points_of(ax) > box.min) & (points_of(ax) < box.max)
            assert not inside.all(axis=1).any(), "a legend over data"
