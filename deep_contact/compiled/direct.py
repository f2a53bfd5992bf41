"""Calls of compiled functions that look at the types of their arguments once."""

from __future__ import annotations

OFTEN = 50
"""Calls from which on it pays to look at the types, which takes as long as so many calls."""


class Direct:
    """A compiled function that is always called with arguments of the same types.

    To find out the types of some eighty arrays takes Numba longer than a step of a hundred circles does.
    """

    def __init__(self, function):
        self._function, self._entry, self._calls = function, None, 0

    def __call__(self, *arguments):
        if self._entry is not None:
            return self._entry(*arguments)
        result = self._function(*arguments)
        self._calls += 1
        compiled = getattr(self._function, "overloads", None)  # none without the compiler
        if compiled and self._calls == OFTEN:
            self._entry = compiled[tuple(map(self._function.typeof_pyval, arguments))].entry_point
        return result
