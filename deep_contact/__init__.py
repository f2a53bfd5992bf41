"""Deep Contact: rigid circles, contact solvers, and how much these gain from a learned start.

Type checkers and editors see the imports below. At run time they are only read, and `__getattr__` imports a name when
it is first used: `import deep_contact` costs next to nothing, and a job that predicts nothing never loads TensorFlow.
(The stubs of `lazy_loader` know neither aliases nor the modules of a package.)
"""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from typing import TYPE_CHECKING

from deep_contact.constants import VERSION as __version__

# ruff: noqa: F401
if TYPE_CHECKING:
    from deep_contact import cnn, physics, sph, warm_start
    from deep_contact.cnn.inference import load_model
    from deep_contact.io.shipped import sample_file
    from deep_contact.io.state_xml import read_state, write_state
    from deep_contact.physics.exact import solve_exactly
    from deep_contact.physics.scenes import (
        barrel,
        bench_disks,
        circles_in_box,
        column,
        drifting_circles,
        drum,
        hopper,
        lattice_in_box,
        single_body,
        terrain,
        two_bodies,
    )
    from deep_contact.physics.solvers import NNCG, PGS, PSOR, BatchedPGS, NesterovPGS
    from deep_contact.planning import plan
    from deep_contact.presets import recommend
    from deep_contact.reporting import figures, plotting, results
    from deep_contact.simulation import simulate, simulate_many, solve_contacts, step
    from deep_contact.state import Bodies, Contacts, State, World, make_bodies
    from deep_contact.state.scales import BOX2D, ContactScales
    from deep_contact.studies import peers
    from deep_contact.studies import starts as experiments
    from deep_contact.trajectory import Trajectory, load_trajectory

_IMPORT = re.compile(r"^    from ([\w.]+) import (\([^)]*\)|.*)", re.MULTILINE)
_HOME = {  # public name -> (module or package, name in it)
    public or name: (module, name)
    for module, names in _IMPORT.findall(Path(__file__).read_text(encoding="utf-8"))
    for name, public in re.findall(r"(\w+)(?: as (\w+))?", names)
}

__all__ = [*_HOME, "__version__"]


def __getattr__(public: str):
    if public not in _HOME:
        raise AttributeError(f"module 'deep_contact' has no attribute {public!r}")
    module, name = _HOME[public]
    home = importlib.import_module(module)
    if module == __name__ or not hasattr(home, name):
        return importlib.import_module(f"{module}.{name}")
    # Kept, since looking it up takes 3 µs, a good part of what `step` takes beside its computation.
    found = globals()[public] = getattr(home, name)
    return found


def __dir__() -> list[str]:
    return sorted(__all__)
