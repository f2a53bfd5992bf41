"""The style of all figures, and functions that draw states, contact forces, curves, tables and networks, and save them.

The colours are those of Okabe and Ito, which people with any kind of colour vision can tell apart. Every start (of the
solver's impulses) has its own colour *and* line style. Matplotlib is imported inside the functions and used without
pyplot: no function opens a window or keeps global state.

Tests: tests/figures/test_figure.py
"""

from __future__ import annotations

import io
import math
import os
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from itertools import cycle
from pathlib import Path

import numpy as np

from deep_contact.io.files import path_of, replacing
from deep_contact.state.arrays import Bodies, Contacts, no_contacts
from deep_contact.state.state import State, contact_lines
from deep_contact.state.validation import expect, one_of
from deep_contact.state.world import World

DPI = 150
"""Dots per inch of every picture."""

PAGE = 8.3
"""Width of a page, inches."""

BLACK, GREY = "#000000", "#767676"
ORANGE, SKY, GREEN, YELLOW = "#E69F00", "#56B4E9", "#009E73", "#F0E442"
BLUE, VERMILION, PURPLE = "#0072B2", "#D55E00", "#CC79A7"
CYCLE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)
"""Colours of curves that do not belong to starts, in order. Yellow is for areas only: a yellow line is hard to see on
white."""

COLOUR_MAP = "viridis"
"""Sequential colour map: perceptually uniform, and monotonic in grey."""

WIDEST = 4.0
"""Width of the line of the largest force, points."""

START_STYLE = {
    name: {"color": colour, "linestyle": line, "label": label}
    for name, colour, line, label in (
        ("none", BLACK, ":", "None"),
        ("builtin", VERMILION, "-", "Builtin"),
        ("scaled", GREY, "--", "Scaled"),
        ("sph", SKY, "--", "SPH, bilinear"),
        ("sph spline", SKY, "-", "SPH, spline"),
        ("sph consistent", BLUE, "-", "SPH, consistent"),
        ("copy", GREEN, "-.", "Copy"),
        ("cnn", PURPLE, "-", "CNN, the thesis's network"),
        ("far field", ORANGE, "-", "far field, ours"),
        ("best classical", BLACK, "-", "Best classical"),
    )
}
"""Name of a start -> keyword arguments for `ax.plot`, which are the same in every figure."""

SHARING = "#17BECF"
"""Colour of "sharing" in figures that also show starts. Sharing is the way in which the thesis's authors get the
impulses of contacts back from the grid."""

ENGINE_MARKER = {"Box2D 2.3": "s", "pymunk": "^", "Box2D v3": "D"}
"""Name of another physics engine -> its marker. Other engines are drawn in grey."""

_STYLE = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same letters on every machine
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.6,
    "legend.frameon": True,
    "legend.framealpha": 0.9,
    "legend.edgecolor": "#DDDDDD",
    "legend.fontsize": 8.0,
    "legend.title_fontsize": 8.0,
    "figure.facecolor": "white",
    "figure.constrained_layout.use": True,
    "figure.constrained_layout.h_pad": 0.08,
    "figure.constrained_layout.w_pad": 0.08,
    "image.cmap": COLOUR_MAP,
}


def shades(count: int) -> list[str]:
    """Return `count` colours for an ordered series (sizes, steps, presets), from light to dark.

    No start has one of these colours.
    """
    from matplotlib import colormaps, colors

    return [colors.to_hex(colour) for colour in colormaps["cividis"](np.linspace(0.85, 0.0, count))]


def style() -> AbstractContextManager[None]:
    """Return a context manager with the style of all figures: `with plotting.style(): ...`.

    Figures are made and saved in this context.
    """
    from cycler import cycler
    from matplotlib import style as styles

    # Based on matplotlib's own defaults, not on the user's: the same data give the same picture everywhere.
    return styles.context(["default", {**_STYLE, "axes.prop_cycle": cycler(color=CYCLE)}])


def style_of(start: str) -> dict:
    """Return keyword arguments for `ax.plot` for a start: color, linestyle, label.

    start: name of a start, by which the solver gets its starting impulses. Raises ValueError, which lists the known
    starts, for an unknown one.
    """
    return dict(START_STYLE[one_of("start", start, START_STYLE)])


def styles_of(names: Iterable[str]) -> dict[str, dict]:
    """Return name -> keyword arguments for `ax.plot`. Starts have those of `style_of`.

    Each other name gets the next free pair of colour and line style.
    """
    looks = {name: START_STYLE.get(name) for name in names}
    taken = {look["color"] for look in looks.values() if look}
    # Seven colours and four lines have no common factor, so they make 28 different pairs. If there are starts among the
    # names, their colours are left out, unless they have all seven.
    pairs = zip(cycle(CYCLE), cycle(("-", "--", "-.", ":")))
    free = (pair for pair in pairs if pair[0] not in taken or taken >= set(CYCLE))
    return {name: look or dict(zip(("color", "linestyle"), next(free)), label=name) for name, look in looks.items()}


def subplots(rows: int = 1, columns: int = 1, *, size: tuple[float, float] | None = None, **keywords) -> tuple:
    """Return a figure and its axes (one, or an array as from `Figure.subplots`), made without pyplot.

    A notebook shows the figure. size: width and height, inches; by default 6 × 4 for one panel, and 4.2 × 3.6 for each
    of several. The figure is no wider than a page (`PAGE`), so that letters have their size when it is shown. keywords:
    those of `Figure.subplots`.
    """
    from matplotlib.figure import Figure

    width, height = size or ((6.0, 4.0) if rows == columns == 1 else (4.2 * columns, 3.6 * rows))
    with style():
        figure = Figure(figsize=(min(width, PAGE), height), layout="constrained")
        axes = figure.subplots(rows, columns, **keywords)

    def png() -> bytes:
        content = io.BytesIO()
        with style():
            figure.savefig(content, format="png", dpi=DPI)
        return content.getvalue()

    figure._repr_png_ = png  # IPython shows only figures of pyplot, and objects with this method
    return figure, axes


def label_axes(ax, x: str, y: str, *, x_unit: str = "", y_unit: str = "", title: str = "") -> None:
    """Label both axes as "quantity (unit)", or "quantity" for a pure number, and set the title of the panel.

    Without `title` no title is set.
    """
    ax.set_xlabel(f"{x} ({x_unit})" if x_unit else x)
    ax.set_ylabel(f"{y} ({y_unit})" if y_unit else y)
    if title:
        ax.set_title(title)


def name_bars(ax, names: Sequence[str]) -> None:
    """Label horizontal bars at 0, 1, …, the first at the top, and remove the grid lines along the bars."""
    ax.set_yticks(range(len(names)), names)
    ax.invert_yaxis()
    ax.grid(False, axis="y")


def log_axes(ax) -> None:
    """Make both axes logarithmic, with labels 1, 2 and 5 of each decade as plain numbers.

    An axis longer than two decades has labels at powers of ten only.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    ax.set(xscale="log", yscale="log")
    for axis, (low, high) in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim())):
        axis.set_major_locator(LogLocator(subs=(1.0,) if high > 100 * low else (1.0, 2.0, 5.0)))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())


def band(ax, x, middle, low, high, **look) -> None:
    """Draw the curve `middle` over x, and shade the interval from `low` to `high` around it.

    look: keyword arguments for `ax.plot`.
    """
    (line,) = ax.plot(x, middle, **look)
    ax.fill_between(x, low, high, color=line.get_color(), alpha=0.15, linewidth=0)


def legend_below(figure, ax, title: str = "", *, rows: int = 1):
    """Add the legend of `ax` below all panels, in this number of rows, and the title above them. Returns the figure.

    Without `title` no title is set.
    """
    if title:
        figure.suptitle(title, fontsize=10)
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=-(-len(labels) // rows))
    return figure


def scene_axes(ax, box: Sequence[float], *, walls: bool = True) -> None:
    """Prepare axes for a scene: metres, equal scales, and the whole box in view with a margin of 2 %.

    box: (x_min, y_min, x_max, y_max), m. walls: whether the box is outlined.
    """
    from matplotlib.patches import Rectangle

    x_min, y_min, x_max, y_max = box
    margin = 0.02 * max(x_max - x_min, y_max - y_min)
    ax.set(xlim=(x_min - margin, x_max + margin), ylim=(y_min - margin, y_max + margin), aspect="equal")
    ax.grid(False)
    ax.spines[:].set_visible(False)
    ax.tick_params(length=0)
    if walls:
        ax.add_patch(Rectangle((x_min, y_min), x_max - x_min, y_max - y_min, fill=False, linewidth=1.5))
    label_axes(ax, "x", "y", x_unit="m", y_unit="m")


def scene_and_part(state, x: np.ndarray, y: np.ndarray, *, centre: np.ndarray, half: float):
    """Draw a scene with a grid in two panels: the whole scene, and a square part of it with the nodes of the grid.

    x, y: coordinates of the grid's columns and rows, m. centre, half: centre of the square, (2,), m, and half of its
    side, m. Returns the figure and both axes.
    """
    from matplotlib.patches import Rectangle

    figure, axes = subplots(1, 2, size=(PAGE, 4.4))
    for ax in axes:
        draw_state(ax, state, colour_by=None, contacts=False).set_alpha(0.5)
        look = {"colors": "#BBBBBB", "linewidths": 0.4, "zorder": 0.5}
        ax.vlines(x, y[0], y[-1], **look)
        ax.hlines(y, x[0], x[-1], **look)
    whole, part = axes
    (left, low), (right, high) = centre - half, centre + half
    whole.add_patch(Rectangle((left, low), 2 * half, 2 * half, fill=False, edgecolor=BLUE, linewidth=1.8, zorder=5))
    part.plot(*map(np.ravel, np.meshgrid(x, y)), "o", color=VERMILION, markersize=4, markeredgewidth=0, zorder=1.2)
    part.set(xlim=(left, right), ylim=(low, high))
    part.spines[:].set(visible=True, color=BLUE)
    return figure, whole, part


def body_values(state, colour_by: str) -> tuple[np.ndarray, str]:
    """Return the values that colour the circles, (n,), and their label.

    colour_by: "speed", m/s, or "impulse", the sum of λ_n over the contacts of a circle, N·s. Raises ValueError for any
    other `colour_by`.
    """
    if one_of("colour_by", colour_by, ("speed", "impulse")) == "speed":
        return np.hypot(*np.asarray(state.bodies.velocity).T), "speed (m/s)"
    total = np.zeros(state.bodies.count + 4 + len(state.world.segments))
    if state.contacts is not None:
        np.add.at(total, state.contacts.body_a, state.contacts.normal_impulse)
        np.add.at(total, state.contacts.body_b, state.contacts.normal_impulse)
    return total[: state.bodies.count], "sum of normal impulses (N·s)"


def top_speed(states: Iterable) -> float:
    """Return the speed of the last colour for these states, m/s: that of the fastest circle, but at least √(g r̄).

    r̄ is the mean radius. A circle that falls by half of r̄ reaches √(g r̄). With this lower limit, circles at rest are
    dark although rounding leaves them some speed.
    """
    top = 0.0
    for state in states:
        radius = float(state.bodies.radius.mean()) if state.bodies.count else 0.0
        floor = math.sqrt(math.hypot(*state.world.gravity) * radius)
        top = max(top, floor, float(np.hypot(*np.asarray(state.bodies.velocity).T).max(initial=0.0)))
    return top


def round_down(value: float) -> float:
    """Return the largest number 1, 2 or 5 · 10ᵏ that is at most `value`, for a scale bar."""
    decade = 10.0 ** math.floor(math.log10(value))
    return max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= value or step == 1.0)


def state_data(state) -> dict:
    """Return the part of a state that `draw_state` needs, for a results file. `state_of` reads it."""
    data = {"name": state.name, "time": state.time, "box": state.world.box, "segments": state.world.segments}
    return data | {"bodies": state.bodies, "contacts": state.contacts or no_contacts()}


def state_of(data: Mapping):
    """Return the state that `state_data` stored. data: result of `state_data`.

    It cannot be simulated, because it has neither gravity nor settings of the solver.
    """
    bodies, contacts = ({name: np.array(of) for name, of in data[part].items()} for part in ("bodies", "contacts"))
    contacts = Contacts(**contacts) if contacts["body_a"].size else no_contacts()
    world = World(box=tuple(data["box"]), segments=data.get("segments", ()))
    return State(name=data["name"], world=world, bodies=Bodies(**bodies), contacts=contacts, time=data["time"])


def draw_state(
    ax,
    state,
    *,
    colour_by: str | None = "speed",
    contacts: bool = True,
    limits: tuple[float, float] | None = None,
    largest_impulse: float | None = None,
    bar: bool = True,
):
    """Draw a state into `ax`: circles, a tick for the orientation of each circle, and contact impulses as lines.

    The line of a contact runs from the centre of one circle to that of the other, or to the wall or segment. Its width
    grows in proportion to the normal impulse; a contact without impulse is a hairline. colour_by: "speed" or "impulse"
    (`body_values`), or None for one colour. contacts: whether the impulses are drawn. limits: values of the first and
    of the last colour; by default 0 and the largest value, which is `top_speed` for speeds. largest_impulse: impulse of
    the widest line, N·s; by default the largest of this state. To compare several states, set limits and
    largest_impulse. bar: whether a bar of the colours is drawn at the right of the axes. Returns the collection of the
    circles, for a colour bar of several axes.
    """
    from matplotlib.collections import EllipseCollection, LineCollection

    bodies, look = state.bodies, {"units": "xy", "offset_transform": ax.transData}
    circles = EllipseCollection(*[2.0 * bodies.radius] * 2, np.zeros(bodies.count), offsets=bodies.position, **look)
    circles.set(edgecolor="#333333", facecolor="#CFE6F5", linewidth=0.5)
    if colour_by is not None:
        values, label = body_values(state, colour_by)
        high = top_speed([state]) if colour_by == "speed" else float(values.max(initial=0.0))
        low, high = limits or (0.0, high)
        circles.set(array=values, clim=(low, high if high > low else low + 1.0), cmap=COLOUR_MAP, label=label)
    scene_axes(ax, state.world.box)
    if state.world.segments:
        segments = np.reshape(state.world.segments, (-1, 2, 2))
        ax.add_collection(LineCollection(segments, colors=BLACK, linewidths=1.5, capstyle="round"))
        signs = np.sign(state.world.surface_speeds or np.zeros(len(segments)))
        along = signs[:, None] * np.diff(segments, axis=1)[:, 0]
        for middle, way in zip(segments.mean(axis=1), along):
            if way.any():  # a surface that moves, as an arrow in its direction
                look = {"arrowstyle": "-|>", "color": BLACK, "shrinkA": 0, "shrinkB": 0}
                ax.annotate("", xy=middle + 0.25 * way, xytext=middle - 0.25 * way, arrowprops=look)
    ax.add_collection(circles)

    circles.update_scalarmappable()
    colours = readable_on(np.atleast_2d(circles.get_facecolor()))
    heading = np.stack([np.cos(bodies.angle), np.sin(bodies.angle)], axis=1) * bodies.radius[:, None]
    # The tick begins at half of the radius. A tick of a whole radius looks like a contact.
    ticks = np.stack([bodies.position + 0.5 * heading, bodies.position + 0.95 * heading], axis=1)
    ax.add_collection(LineCollection(ticks, colors=colours, linewidths=1.0))
    if contacts and state.contacts is not None and state.contacts.count:
        impulse = state.contacts.normal_impulse
        largest = float(impulse.max()) if largest_impulse is None else largest_impulse
        width = 0.3 + 4.0 * np.minimum(impulse / (largest or 1.0), 1.0)
        # A white line underneath makes each line stand out from circles of any colour.
        for colour, more in (("white", 0.8), (VERMILION, 0.0)):
            look = {"colors": colour, "linewidths": width + more, "capstyle": "round"}
            ax.add_collection(LineCollection(contact_lines(state), **look))
    if bar and colour_by is not None and bodies.count:
        with style():  # as an inset of the axes, so that clearing the axes removes the bar
            place = ax.inset_axes((1.02, 0.0, 0.03, 1.0))
            ax.figure.colorbar(circles, cax=place, label=label).outline.set_visible(False)
    return circles


def draw_contact_forces(ax, state, *, friction: bool = False, largest: float | None = None, key: bool = True) -> None:
    """Draw the network of contact forces: a line through each contact that pushes, as wide as its normal force.

    friction: whether a line across each contact, as wide as its friction force, is drawn too. largest: force of the
    widest line, N; by default the largest normal force of this state. key: whether a key explains the widths in N. With
    the key, the forces of walls and segments on the circles are drawn as arrows that end where the force acts, and
    listed in the key. `deep_contact.analysis.contact_forces` says for which moment the forces hold.
    """
    from matplotlib.collections import LineCollection
    from matplotlib.lines import Line2D

    from deep_contact.stepping.prepare import ready

    state = ready(state, of_step=True)
    c, radius = state.contacts, state.bodies.radius
    normal, across = c.normal_impulse / state.dt, np.abs(c.tangent_impulse) / state.dt
    largest = float(normal.max(initial=0.0)) if largest is None else largest
    draw_state(ax, state, colour_by=None, contacts=False).set(edgecolor="#BBBBBB", facecolor="#F4F4F4")
    ax.collections[-1].set_color("#BBBBBB")  # the ticks of the orientations
    tangent = (0.4 * radius[c.body_a])[:, None] * np.column_stack([c.normal[:, 1], -c.normal[:, 0]])
    crossing = np.stack([c.position - tangent, c.position + tangent], axis=1)
    shown = [(contact_lines(state), normal, VERMILION)] + [(crossing, across, BLUE)] * friction
    for lines, force, colour in shown:
        acts = force > 1e-6 * largest
        widths = WIDEST * np.minimum(force[acts] / (largest or 1.0), 1.0)
        ax.add_collection(LineCollection(lines[acts], colors=colour, linewidths=widths, capstyle="round", zorder=3))
    if key:
        names = _draw_reactions(ax, state)
        parts = [(f"{share * largest:.3g} N", VERMILION, WIDEST * share) for share in (1.0, 0.5, 0.1) if largest > 0]
        parts += [("across: friction", BLUE, 0.5 * WIDEST)] * friction
        look = {"solid_capstyle": "butt"}
        handles = [Line2D([], [], color=colour, linewidth=width, label=text, **look) for text, colour, width in parts]
        handles += [Line2D([], [], linewidth=0, marker=r"$\rightarrow$", color=BLACK, label=text) for text in names]
        place = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.0}
        ax.legend(handles=handles, title="contact forces", **place)


def _draw_reactions(ax, state) -> list[str]:
    """Draw the forces of walls and segments on the circles as arrows. Returns the sizes of the forces, N, as texts.

    The longest arrow is a tenth of the longer side of the box.
    """
    from deep_contact.analysis.contact_forces import forces

    acting, c, beyond = forces(state), state.contacts, state.contacts.body_b - state.bodies.count
    given = -np.concatenate([np.reshape([*acting.walls.values()], (4, 2)), acting.segments])
    sizes = np.hypot(*given.T)
    x_min, y_min, x_max, y_max = state.world.box
    longest = 0.1 * max(x_max - x_min, y_max - y_min)
    for part in np.flatnonzero(sizes > 1e-6 * sizes.max(initial=0.0)):
        of_part = beyond == part
        tip = np.average(c.position[of_part], axis=0, weights=c.normal_impulse[of_part] + 1e-300)
        tail = tip - longest / sizes.max() * given[part]
        look = {"arrowstyle": "-|>", "color": BLACK, "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", xy=tip, xytext=tail, arrowprops=look, annotation_clip=False, zorder=4)
    ax.set(xlim=(x_min - 1.1 * longest, x_max + 1.1 * longest), ylim=(y_min - 1.1 * longest, y_max + 1.1 * longest))
    totals = [f"{side}: {size:,.4g} N" for side, size in zip(acting.walls, sizes) if size > 0]
    return totals + [f"segments: {np.hypot(*given[4:].sum(axis=0)):,.4g} N"] * bool(sizes[4:].any())


def draw_stress(ax, state, *, spacing: float):
    """Draw the mean pressure in square cells as an image: half the trace of `contact_forces.mean_stress`, N/m.

    spacing: side of a cell, m. Returns the image, for a colour bar.
    """
    from deep_contact.analysis.contact_forces import mean_stress

    pressure = 0.5 * np.trace(mean_stress(state, spacing), axis1=2, axis2=3)
    scene_axes(ax, state.world.box)
    (rows, columns), (left, low) = pressure.shape, state.world.box[:2]
    place = (left, left + columns * spacing, low, low + rows * spacing)
    limits = {"xlim": ax.get_xlim(), "ylim": ax.get_ylim()}
    image = ax.imshow(pressure, origin="lower", extent=place, cmap=COLOUR_MAP)
    ax.set(**limits)
    return image


def impulse_key(figure, largest: float) -> None:
    """Add a key below a figure of states: line widths with their normal impulses, N·s, and the meaning of the ticks.

    largest: impulse of the widest line, N·s.
    """
    from matplotlib.lines import Line2D

    lines = [
        Line2D([], [], color=VERMILION, linewidth=0.3 + 4.0 * share, label=f"λ$_n$ = {share * largest:.2g} N·s")
        for share in ((0.1, 0.5, 1.0) if largest > 0 else ())
    ]
    tick = Line2D([], [], color="#222222", linewidth=1.0, label="tick: orientation of a circle")
    figure.legend(handles=[*lines, tick], loc="outside lower center", ncols=len(lines) + 1, fontsize=8)


def readable_on(colours: np.ndarray) -> np.ndarray:
    """Return black or white for each colour, RGBA (…, 4): the one that stands out from the colour."""
    return np.where(colours[..., :3] @ np.array([0.299, 0.587, 0.114]) > 0.5, "#222222", "white")


_CHARACTER = 0.084
"""Width of a character of a table at 8 pt, inches."""

_LINE = 0.17
"""Height of a line of a table at 8 pt, inches."""


def draw_table(rows: Sequence[Sequence[str]], title: str):
    """Return a figure that shows a table of text. rows: cells of each row; the first row is the head.

    Text is wrapped so that the table fits a page. If the longest words do not fit, letters are smaller.
    """
    for width in range(100, 4, -1):
        wrapped = [[textwrap.fill(text, width, break_long_words=False) for text in row] for row in rows]
        widths = [2 + max(len(line) for text in column for line in text.split("\n")) for column in zip(*wrapped)]
        if _CHARACTER * sum(widths) <= PAGE:
            break
    scale = min(1.0, PAGE / (_CHARACTER * sum(widths)))
    heights = [_LINE * (1 + max(text.count("\n") for text in row)) + 0.09 for row in wrapped]
    wide = max(4.0, scale * _CHARACTER * sum(widths))
    figure, ax = subplots(size=(wide, scale * sum(heights) + 0.5))
    with style():
        ax.axis("off")
        ax.set_title(textwrap.fill(title, int(wide / 0.1)))
        shares = [width / sum(widths) for width in widths]
        table = ax.table(wrapped, colWidths=shares, cellLoc="left", bbox=(0, 0, 1, 1), edges="B")
        table.auto_set_font_size(False)
        table.set_fontsize(8.0 * scale)
        for (row, _), cell in table.get_celld().items():
            cell.set(height=heights[row], edgecolor="#CCCCCC" if row else BLACK)
            cell.set_text_props(weight="normal" if row else "bold")
    return figure


def draw_network(
    ax,
    values: Sequence[Sequence[float]],
    weights: Sequence[Sequence[Sequence[float]]],
    *,
    titles: Sequence[str] = (),
    dropped: Sequence[Sequence[bool]] | None = None,
    numbers: str = "{:.2f}",
) -> None:
    """Draw a fully connected network: one column of neurons for each layer, from left to right.

    values: values of the neurons of each layer. weights: weights between each layer and the next, (n, m), drawn as
    lines whose width grows with the size of the weight: blue, or dashed vermilion if the weight is negative. titles:
    texts below the layers. dropped: flags of neurons that are crossed out and have no lines. numbers: format of a
    neuron's value; "" omits the values.
    """
    places = [[(i, 0.5 * (len(layer) - 1) - j) for j in range(len(layer))] for i, layer in enumerate(values)]
    gone = dropped or [[False] * len(layer) for layer in values]
    largest = max(np.abs(between).max() for between in weights) or 1.0
    for i, between in enumerate(weights):
        for (a, b), w in np.ndenumerate(between):
            if w and not (gone[i][a] or gone[i + 1][b]):
                ends, look = zip(places[i][a], places[i + 1][b]), (BLUE, "-") if w > 0 else (VERMILION, "--")
                ax.plot(*ends, color=look[0], linestyle=look[1], linewidth=0.3 + 2.7 * abs(w) / largest, zorder=1)
    for layer, shown, out_of in zip(places, values, gone):
        for place, value, out in zip(layer, shown, out_of):
            face, edge = ("#EEEEEE", GREY) if out else ("#CFE6F5", BLACK)
            ax.plot(*place, "o", markersize=30, markerfacecolor=face, markeredgecolor=edge)
            if out:
                ax.plot(*place, "x", markersize=22, color=GREY, markeredgewidth=1.5)
            elif numbers:
                ax.text(*place, numbers.format(value), ha="center", va="center", fontsize=8)
    high = 0.5 * (max(map(len, values)) - 1)
    for i, text in enumerate(titles):
        ax.text(i, -high - 0.45, text, ha="center", va="top", fontsize=9)
    ax.set(xlim=(-0.4, len(values) - 0.6), ylim=(-high - (0.9 if titles else 0.5), high + 0.5))
    ax.axis("off")


def save(figure, path: str | os.PathLike) -> Path:
    """Write a figure as PNG to a path that ends in .png. Returns the path. Equal figures give equal bytes."""
    path = path_of(path)
    hint = "figure.savefig writes other formats"
    expect(path.suffix.lower() == ".png", f"path: expected a name that ends in .png, got {str(path)!r}; {hint}")
    with style(), replacing(path) as temporary:
        # No date and no version in the file, so that equal pictures are equal files.
        figure.savefig(temporary, format="png", dpi=DPI, metadata={"Software": None})
    return path
