"""The way into a step passes few functions: their number is part of how the engine reads, and of what a call costs."""

import importlib.util
from pathlib import Path


def counted():
    """`tests/tools/first_step.py` as a module."""
    path = Path(__file__).parents[1] / "tools" / "first_step.py"
    spec = importlib.util.spec_from_file_location("first_step", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_first_step_and_a_step_of_a_simulator_call_few_functions():
    tool = counted()
    first, step = tool.first_step(), tool.step_of_simulator()
    assert any(function == "advance" for _, _, function in first)
    assert len(first) <= 120
    assert tool.changes_of_file(first) <= 86
    assert len(step) <= 16
