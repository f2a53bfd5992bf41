"""Deep Contact: rigid circles, contact solvers, and how much these gain from a learned start.

A name is imported when it is first used (`io.lazy`), so a job that predicts nothing never loads TensorFlow.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from deep_contact.constants import VERSION as __version__
from deep_contact.io.lazy import attach

# ruff: noqa: F401
if TYPE_CHECKING:
    from deep_contact import cnn, peers, physics, sph, warm_start
    from deep_contact.bounds import force_bounds
    from deep_contact.cnn.inference import load_model
    from deep_contact.io.contacts_csv import contact_table
    from deep_contact.io.shipped import sample_file
    from deep_contact.io.state_xml import read_state, write_state
    from deep_contact.physics.exact import solve_exactly
    from deep_contact.physics.forces import coordination, forces, mean_stress, neighbours, stress
    from deep_contact.physics.ready import find_contacts
    from deep_contact.physics.scenes import (
        barrel,
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
    from deep_contact.simulation import (
        Simulation,
        Simulator,
        simulate,
        simulate_many,
        solve_contacts,
        step,
    )
    from deep_contact.state import State, World
    from deep_contact.state.arrays import Bodies, Contacts
    from deep_contact.state.checks import make_bodies
    from deep_contact.state.scales import BOX2D, ContactScales
    from deep_contact.studies import starts as experiments
    from deep_contact.trade import load_trade, measure_trade
    from deep_contact.trajectory import Trajectory, film, load_trajectory

__getattr__, __dir__, __all__ = attach(__name__, __file__)
__all__ += ["__version__"]
