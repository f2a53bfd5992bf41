"""Call compiled functions without a check of the types of their arguments in every call.

Tests: tests/run/test_simulator.py
"""

from __future__ import annotations

OFTEN = 50
"""Number of calls after which the types of the arguments are determined, once. To do this takes as long as 50 calls."""


class Direct:
    """A compiled function whose arguments have the same types in every call.

    Numba determines the types of the arguments in each call. For a step, with about eighty arrays, this takes longer
    than the step of a hundred circles itself. After `OFTEN` calls, this class therefore calls the machine code
    directly.

    function: compiled function, or a plain Python function if the compiler is switched off.
    """

    def __init__(self, function):
        self._function, self._entry, self._calls = function, None, 0

    def __call__(self, *arguments):
        if self._entry is not None:
            return self._entry(*arguments)
        result = self._function(*arguments)
        self._calls += 1
        compiled = getattr(self._function, "overloads", None)  # a plain function has no such attribute
        if compiled and self._calls == OFTEN:
            self._entry = compiled[tuple(map(self._function.typeof_pyval, arguments))].entry_point
        return result
