"""`deep_contact.validation`: what the border lets through, and the messages of what it refuses."""

import numpy as np
import pytest

from deep_contact.validation import flag, integer, number, one_of


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
