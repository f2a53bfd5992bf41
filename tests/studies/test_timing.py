"""Timing: warm-up runs, interleaved runs, and what is kept of their times."""

import gc

import pytest

from deep_contact.studies import timing


class Clock:
    """A clock that the callables of `spend` advance."""

    now = 0.0

    def __call__(self):
        return self.now

    def spend(self, *seconds):
        """A callable that takes these times, one per call."""
        left = list(seconds)

        def run():
            self.now += left.pop(0)

        return run


def test_runs_are_interleaved_after_a_warm_up_run_that_does_not_count():
    clock, order = Clock(), []
    runs = {name: (lambda name=name: order.append(name)) for name in "ab"}
    timing.interleaved(runs, repeats=2, clock=clock, setup={"b": lambda: order.append("setup")})
    assert order == ["a", "setup", "b"] * 3
    for reduce, expected in (({"reduce": list}, {"a": [3.0, 5.0], "b": [4.0, 2.0]}), ({}, {"a": 3.0, "b": 2.0})):
        runs = {"a": clock.spend(1.0, 3.0, 5.0), "b": clock.spend(0.0, 4.0, 2.0)}
        setup = {"b": clock.spend(9.0, 9.0, 9.0)}  # is not timed
        assert timing.interleaved(runs, repeats=2, clock=clock, setup=setup, **reduce) == expected


def test_the_garbage_collector_waits_and_is_enabled_again_after_an_error():
    seen = []
    timing.interleaved({"": lambda: seen.append(gc.isenabled())}, repeats=1)
    assert seen == [False, False]
    with pytest.raises(ZeroDivisionError):
        timing.interleaved({"": lambda: 1 / 0}, repeats=1)
    assert gc.isenabled()


def test_the_release_of_what_a_run_returns_is_not_timed():
    clock = Clock()

    class Large:
        def __del__(self):
            clock.now += 9.0

    def run():
        clock.now += 2.0
        return Large()

    assert timing.interleaved({"": run}, repeats=3, clock=clock, reduce=list) == {"": [2.0, 2.0, 2.0]}
