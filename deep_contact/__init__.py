"""Deep Contact: rigid circles in contact, contact solvers, and their starting impulses from a neural network.

A public name is imported when it is first used (`lazy`). A program that predicts no impulses therefore never loads
TensorFlow. The imports below have the form `import x as x`, because strict type checkers treat a plainly imported name
as private.

Tests: tests/test_imports.py
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from deep_contact.lazy import HOOKS, attach
from deep_contact.state.constants import VERSION as __version__

if TYPE_CHECKING:
    from deep_contact import analysis as analysis
    from deep_contact import cnn as cnn
    from deep_contact import figures as figures
    from deep_contact import solvers as solvers
    from deep_contact import sph as sph
    from deep_contact import warm_start as warm_start
    from deep_contact.accuracy.presets import recommend as recommend
    from deep_contact.analysis.bounds import force_bounds as force_bounds
    from deep_contact.analysis.contact_forces import coordination as coordination
    from deep_contact.analysis.contact_forces import forces as forces
    from deep_contact.analysis.contact_forces import mean_stress as mean_stress
    from deep_contact.analysis.contact_forces import neighbours as neighbours
    from deep_contact.analysis.contact_forces import stress as stress
    from deep_contact.analysis.exact import solve_exactly as solve_exactly
    from deep_contact.cnn.inference import load_model as load_model
    from deep_contact.figures import results as results
    from deep_contact.io.contacts_csv import contact_table as contact_table
    from deep_contact.io.shipped import sample_file as sample_file
    from deep_contact.io.state_xml import read_state as read_state
    from deep_contact.io.state_xml import write_state as write_state
    from deep_contact.measure import peers as peers
    from deep_contact.measure.measurement import measure_trade as measure_trade
    from deep_contact.measure.trade import load_trade as load_trade
    from deep_contact.plot import plotting as plotting
    from deep_contact.run.many_scenes import simulate_many as simulate_many
    from deep_contact.run.one_scene import simulate as simulate
    from deep_contact.run.one_scene import solve_contacts as solve_contacts
    from deep_contact.run.one_scene import step as step
    from deep_contact.run.planning import plan as plan
    from deep_contact.run.result import Simulation as Simulation
    from deep_contact.run.simulator import Simulator as Simulator
    from deep_contact.run.trajectory import Trajectory as Trajectory
    from deep_contact.run.trajectory import film as film
    from deep_contact.run.trajectory import load_trajectory as load_trajectory
    from deep_contact.scenes import barrel as barrel
    from deep_contact.scenes import circles_in_box as circles_in_box
    from deep_contact.scenes import column as column
    from deep_contact.scenes import drifting_circles as drifting_circles
    from deep_contact.scenes import drum as drum
    from deep_contact.scenes import hopper as hopper
    from deep_contact.scenes import lattice_in_box as lattice_in_box
    from deep_contact.scenes import single_body as single_body
    from deep_contact.scenes import terrain as terrain
    from deep_contact.scenes import two_bodies as two_bodies
    from deep_contact.solvers import NNCG as NNCG
    from deep_contact.solvers import PGS as PGS
    from deep_contact.solvers import PSOR as PSOR
    from deep_contact.solvers import BatchedPGS as BatchedPGS
    from deep_contact.solvers import NesterovPGS as NesterovPGS
    from deep_contact.state.arrays import Bodies as Bodies
    from deep_contact.state.arrays import Contacts as Contacts
    from deep_contact.state.fields import make_bodies as make_bodies
    from deep_contact.state.scales import BOX2D as BOX2D
    from deep_contact.state.scales import ContactScales as ContactScales
    from deep_contact.state.state import State as State
    from deep_contact.state.world import World as World
    from deep_contact.stepping.prepare import find_contacts as find_contacts
    from deep_contact.studies import starts as experiments

    __all__ = ["experiments"]  # type checkers do not take `starts as experiments` for public

# Functions that `State` calls. They are in modules that `deep_contact.state` must not import.
HOOKS.update(
    find_contacts="deep_contact.stepping.prepare:find_contacts", picture="deep_contact.plot.notebook:picture_of"
)
__getattr__, __dir__, __all__ = attach(__name__, __file__)
__all__ += ["__version__"]
