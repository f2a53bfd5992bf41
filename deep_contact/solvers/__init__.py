"""The solvers, one file each: the options with their source and weakness, the compiled loop, and the registration."""

# The order of the imports is the order of `METHODS`.
# isort: off
from deep_contact.stepping.interface import METHODS, Loop, SolverOptions, describe, register, solver_from
from deep_contact.stepping.rows import sweep
from deep_contact.solvers.pgs import PGS
from deep_contact.solvers.batched import BatchedPGS
from deep_contact.solvers.psor import PSOR
from deep_contact.solvers.nncg import NNCG
from deep_contact.solvers.nesterov import NesterovPGS
# isort: on

__all__ = [
    "METHODS", "NNCG", "PGS", "PSOR", "BatchedPGS", "Loop", "NesterovPGS", "SolverOptions", "describe", "register",
    "solver_from", "sweep",
]  # fmt: skip
