"""`deep_contact.state.validation`: what the border lets through, and the messages of what it refuses."""

from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest

import deep_contact as dc
from deep_contact.state.validation import flag, integer, number, one_of, real_numbers


@pytest.mark.parametrize("value", [1, np.int32(1), np.uint8(1), np.int64(1)])
def test_integers_and_numbers_of_any_width_come_back_as_pythons(value):
    assert type(integer("n", value, 1)) is int
    assert type(number("x", value)) is type(number("x", np.float32(0.5))) is float


@pytest.mark.parametrize("value", [0, -1, 1.0, True, np.float64(1), "1", None, np.ones(2, int), float("nan")])
def test_what_is_no_integer_or_too_small_is_refused(value):
    with pytest.raises(ValueError, match="n: expected an integer >= 1, got "):
        integer("n", value, 1)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), True, "1", None, 1j, np.ones(1), 10**400], ids=str)
def test_what_is_no_finite_number_is_refused(value):
    with pytest.raises(ValueError, match="x: expected a finite number, got "):
        number("x", value)


@pytest.mark.parametrize(
    ("limits", "least", "too_small", "expected"),
    [
        ({"low": 0}, 0, -1, "a finite number >= 0"),
        ({"above": 0}, 1, 0, "a finite number > 0"),
        ({"low": 0, "high": 1}, 0, -1, "a finite number >= 0 and <= 1"),
        ({"low": 0, "below": 1}, 0, 1, "a finite number >= 0 and < 1"),
        ({"above": 0, "high": 1}, 1, 0, "a finite number > 0 and <= 1"),
        ({"above": 0, "below": 1}, 0.5, 1, "a finite number > 0 and < 1"),
        ({"high": 1}, 1, 2, "a finite number <= 1"),
    ],
)
def test_limits_are_kept_and_named(limits, least, too_small, expected):
    assert number("x", least, **limits) == least
    with pytest.raises(ValueError, match=f"x: expected {expected}, got {too_small}"):
        number("x", too_small, **limits)
    assert integer("n", 5, most=5) == 5
    with pytest.raises(ValueError, match="n: expected an integer <= 5, got 6"):
        integer("n", 6, most=5)


HIDDEN = np.ma.masked_array([1.0, 2.0], [False, True])
"""The second number is hidden, and NumPy's conversions show it again."""

NO_NUMBERS = {
    "text": ["1", "2"], "text beside": [1.0, "2"], "bytes": [b"1", b"2"], "objects": np.array([1.0, "2"], object),
    "dates": np.array(["2020-01-01", "2021-01-01"], "datetime64[D]"), "spans": np.array([1, 2], "timedelta64[s]"),
    "hidden": HIDDEN, "complex": [1.0, 2.0 + 1j], "none": [1.0, None], "ragged": [1.0, [2.0]], "huge": [1, 10**310],
}  # fmt: skip
TAKERS = {
    "radius": lambda two: dc.make_bodies([[1, 1], [4, 1]], radius=two),
    "position": lambda two: dc.make_bodies(two),
    "positions": lambda two: dc.make_bodies([two, [4.0, 1.0]]),
    "density": lambda two: dc.make_bodies([[1, 1], [4, 1]], density=two),
    "bodies": lambda two: dc.step(dc.two_bodies().replace(bodies=dc.two_bodies().bodies._replace(mass=two))),
    "segments": lambda two: dc.World(segments=[(two, (3.0, 4.0))]),
    "gravity": lambda two: dc.World(gravity=two),
    "scenes": lambda two: dc.circles_in_box(3, radius=two),
    "starts": lambda two: dc.solve_contacts(dc.simulate(dc.column(2), steps=5).state, start=(two, two)),
    "sph": lambda two: dc.sph.Grid.over_box((0, 0, 9, 9), 0.5) and dc.sph.kernels.value("poly6", two, 3.0),
}
"""What takes two numbers -> a call of it."""


@pytest.mark.parametrize("of", NO_NUMBERS)
@pytest.mark.parametrize("taker", TAKERS)
def test_what_numpy_would_make_numbers_of_is_refused(taker, of):
    with pytest.raises(ValueError, match="expected") as caught:
        TAKERS[taker](NO_NUMBERS[of])
    assert len(str(caught.value)) < 300


def test_numbers_of_any_kind_are_taken():
    shown = np.ma.masked_array([1.0, 2.0], [False, False])
    for values in ([1, 2], (1.0, 2), np.float32([1, 2]), [Fraction(1), Decimal(2)], shown, np.array([1, 2], ">i4")):
        np.testing.assert_array_equal(real_numbers(values), [1.0, 2.0])


@pytest.mark.parametrize("value", [np.zeros(3000), [0.0] * 3000, "x" * 3000])
def test_a_message_is_no_page(value):
    """Messages of 270 lines held whole arrays."""
    for call in (
        lambda: dc.World(gravity=value), lambda: dc.World(segments=value), lambda: dc.make_bodies(value),
        lambda: number("x", value), lambda: integer("n", value), lambda: flag("f", value), lambda: dc.step(value),
        lambda: one_of("o", value, ["a"]), lambda: dc.circles_in_box(3, radius=value),
        lambda: dc.solve_contacts(dc.column(2), start=[value]), lambda: dc.simulate(dc.column(2), steps=value),
        lambda: dc.plan(value),
    ):  # fmt: skip
        with pytest.raises(ValueError, match="expected") as caught:
            call()
        assert len(str(caught.value)) < 400, caught.value
        assert "\n" not in str(caught.value)


def test_a_flag_is_a_bool_and_not_a_number():
    assert flag("f", np.bool_(True)) is True
    for value in (1, "yes", None, np.array([True, False])):
        with pytest.raises(ValueError, match="f: expected True or False, got "):
            flag("f", value)


CHOICES = [
    ("buildin", "builtin"),
    ("SHP", "sph"),
    ("magic", None),
    (1, None),
    ([], None),
    (np.array(["none"] * 2), None),
]


@pytest.mark.parametrize(("value", "meant"), CHOICES)
@pytest.mark.parametrize("known", [("none", "builtin", "sph"), {"none": 1, "builtin": 2, "sph": 3}])
def test_a_choice_suggests_the_nearest_name(known, value, meant):
    with pytest.raises(ValueError, match="k: expected one of none, builtin, sph, got ") as refusal:
        one_of("k", value, known)
    assert str(refusal.value).endswith(f"; did you mean {meant!r}?" if meant else f"got {value!r}")
