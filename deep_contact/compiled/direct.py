"""Calls of compiled functions that look at the types of their arguments once."""

from __future__ import annotations


class Direct:
    """A compiled function that is always called with arguments of the same types.

    To find out the types of some eighty arrays takes Numba longer than a step of a hundred circles does.
    """

    def __init__(self, function):
        self._function, self._entry = function, None

    def __call__(self, *arguments):
        if self._entry is not None:
            return self._entry(*arguments)
        result = self._function(*arguments)
        compiled = getattr(self._function, "overloads", None)  # none without the compiler
        if compiled:
            self._entry = compiled[tuple(map(self._function.typeof_pyval, arguments))].entry_point
        return result
