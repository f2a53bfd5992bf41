"""HTML pages that play runs: one file with all states in it, which any browser shows without a network.

A page consists of `player.html`, `player.js` and the data. Numbers are stored in columns of integers. Columns of
circles and segments store differences from the state before. The integers of a column are written as four planes of
bytes, compressed by deflate, and encoded in base64.

| column | of each | meaning and unit                                                                        |
|--------|---------|-----------------------------------------------------------------------------------------|
| x, y   | circle  | centre minus `low`, in steps of `unit` m, about 1/1000 of the smallest radius or less   |
| angle  | circle  | orientation, in steps of 2π / 65,536                                                    |
| radius | circle  | radius, m: bits of a float32                                                            |
| mass   | circle  | mass, kg: bits of a float32                                                             |
| speed  | circle  | speed, in steps of 1/65,535 of `topSpeed`                                               |
| colour | circle  | value, in steps of 1/65,535 of the range `colours`; only with `colour=`                 |
| lines  | segment | ends x, y, x, y, in steps as for x and y                                                |
| a, b   | contact | first circle a, minus a of the contact before; second body b, minus a                   |
| normal | contact | k, where (k / 65,535)² `topForce` is the normal force, N: fine steps for small forces   |
| across | contact | k of the friction force, as in normal, with a sign                                      |
"""

from __future__ import annotations

import base64
import json
import math
import zlib
from collections.abc import Sequence
from importlib import resources
from itertools import pairwise
from pathlib import Path

import numpy as np

from deep_contact.io.files import write_bytes
from deep_contact.plot.plotting import top_speed
from deep_contact.state.arrays import no_contacts
from deep_contact.state.checks import check_state
from deep_contact.state.validation import expect, floats

MOST_CIRCLES = 2_000_000
"""Largest number of circles on a page, summed over all states. Such a page has some 20 MB, and takes some 200 MB in a
browser."""

ANGLES = 65_536
"""Number of steps of a whole turn in the column angle."""

STEPS = 65_535
"""Number of steps from the least to the largest value of a column of 16 bits."""

FINEST = 2**30
"""Largest number of length steps from one side of the scene to the other."""

WIDEST_SHARE = 98
"""Percentile of all normal forces that gets the widest line. With the largest force instead, an impact would make all
lines of a pile at rest thin."""


def write_page(path, states: Sequence, *, colour=None) -> Path:
    """Write the page of these states (`page`) in one move. Returns its path. Raises OSError if it cannot be written."""
    return write_bytes(path, page(states, colour=colour).encode())


def page(states: Sequence, *, colour=None) -> str:
    """Return HTML that plays states in the box of the first state.

    colour: for each state, numbers that colour its circles, (n,). Raises ValueError for numbers that are not finite or
    do not fit the circles, and for more than `MOST_CIRCLES` circles.
    """
    files = resources.files("deep_contact.plot")
    html, script = (files.joinpath(f"player.{kind}").read_text(encoding="utf-8") for kind in ("html", "js"))
    # The data are ASCII without "<", so that no text in them ends the script or is read as HTML.
    data = json.dumps(page_data(states, colour=colour), separators=(",", ":")).replace("<", "\\u003c")
    return html.replace("@SCRIPT@", script).replace("@DATA@", data)


def page_data(states: Sequence, *, colour=None) -> dict:
    """Return the data of a page in types that JSON can store. `player.js` reads them."""
    total, hint = sum(state.bodies.count for state in states), "; one in so many states is enough for the eye (every=…)"
    few = f"at most {MOST_CIRCLES:,} circles in all of them together"
    expect(total <= MOST_CIRCLES, f"states: expected {few}, got {total:,}{hint}")
    states = [_checked(i, state) for i, state in enumerate(states)]
    world, low, unit, ends = states[0].world, *_grid(states)
    contacts = [no_contacts() if state.contacts is None else state.contacts for state in states]
    normal, across = (
        np.concatenate([getattr(c, name) / state.dt for c, state in zip(contacts, states)])
        for name in ("normal_impulse", "tangent_impulse")
    )
    top_force = float(max(normal.max(initial=0.0), np.abs(across).max(initial=0.0))) or 1.0
    fastest = top_speed(states) or 1.0
    places = [np.rint((state.bodies.position - low) / unit) for state in states]
    columns = {
        "x": [place[:, 0] for place in places],
        "y": [place[:, 1] for place in places],
        "angle": [np.rint(np.mod(state.bodies.angle, 2 * math.pi) * (ANGLES / (2 * math.pi))) for state in states],
        "radius": [state.bodies.radius.astype(np.float32).view(np.int32) for state in states],
        "mass": [state.bodies.mass.astype(np.float32).view(np.int32) for state in states],
        "speed": [np.rint(np.hypot(*state.bodies.velocity.T) * (STEPS / fastest)) for state in states],
        "lines": [np.rint((of_state - low) / unit).ravel() for of_state in ends],
    }
    data = {
        "name": states[0].name,
        "box": list(world.box),
        "low": low.tolist(),
        "unit": unit,
        "times": [state.time for state in states],
        "circles": [state.bodies.count for state in states],
        "contacts": [c.count for c in contacts],
        "segments": [len(of_state) // 2 for of_state in ends],
        "surfaces": list(world.surface_speeds or ()),
        "topSpeed": fastest,
        "topForce": top_force,
        "widest": float(np.percentile(normal[normal > 0], WIDEST_SHARE)) if normal.any() else 0.0,
        "isMean": all(state.solved for state in states),
    }
    if colour is not None:
        values = _checked_colours(colour, states)
        every = np.concatenate([*values, np.zeros(int(not total))])
        least, most = float(every.min()), float(every.max())
        data["colours"] = [least, most]
        columns["colour"] = [np.rint((value - least) * (STEPS / ((most - least) or 1.0))) for value in values]
    data["columns"] = {name: _packed(_differences(of_states)) for name, of_states in columns.items()}
    data["columns"] |= {
        "a": _packed(np.concatenate([np.diff(c.body_a, prepend=0) for c in contacts])),
        "b": _packed(np.concatenate([c.body_b - c.body_a for c in contacts])),
        "normal": _packed(_roots(normal / top_force)),
        "across": _packed(_roots(across / top_force)),
    }
    return data


def _checked(i: int, state):
    try:
        return check_state(state)
    except ValueError as error:
        raise ValueError(f"states[{i}]: {error}") from error


def _checked_colours(colour, states: Sequence) -> list[np.ndarray]:
    colour = list(colour)
    expect(len(colour) == len(states), f"colour: expected numbers for {len(states)} states, got {len(colour)}")
    return [floats(f"colour[{i}]", one, (state.bodies.count,)) for i, (one, state) in enumerate(zip(colour, states))]


def _grid(states: Sequence) -> tuple[np.ndarray, float, list[np.ndarray]]:
    """Return (origin, step, ends): the origin of a page's coordinates, (2,), m, and their step, m.

    ends: ends of the segments of each state, (2 S, 2), m.
    """
    ends = [np.reshape(state.world.segments, (-1, 2)) for state in states]
    x_min, y_min, x_max, y_max = states[0].world.box
    every = np.concatenate([*(state.bodies.position for state in states), *ends, [(x_min, y_min), (x_max, y_max)]])
    low, high = every.min(axis=0), every.max(axis=0)
    smallest = min((state.bodies.radius.min() for state in states if state.bodies.count), default=math.inf)
    return low, float(max(min(smallest / 1000, (high - low).max() / 1000), (high - low).max() / FINEST)), ends


def _differences(of_states: Sequence[np.ndarray]) -> np.ndarray:
    """Return the numbers of each state minus those of the state before, as one array, int64.

    If a state has more numbers than the state before, the additional numbers stay as they are.
    """
    found = [values.astype(np.int64) for values in of_states]
    for before, after in reversed([*pairwise(found)]):
        shared = min(len(before), len(after))
        after[:shared] -= before[:shared]
    return np.concatenate(found)


def _roots(shares: np.ndarray) -> np.ndarray:
    return np.rint(STEPS * np.sign(shares) * np.sqrt(np.abs(shares)))


def _packed(numbers: np.ndarray) -> str:
    """Return integers modulo 2³² as text.

    Small integers of either sign have three bytes of 0, which take almost no space after compression.
    """
    signed = numbers.astype(np.int64).astype(np.uint32).view(np.int32)
    folded = (signed << 1) ^ (signed >> 31)
    planes = folded.view(np.uint8).reshape(-1, 4).T.tobytes()
    return base64.b64encode(zlib.compress(planes, 9)).decode()
