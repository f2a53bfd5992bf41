"""Solvers of contact problems as functions problem -> impulses (2 m,): ours, Siconos's and pinocchio's.

What they return is judged by `lcp.siconos_error`, whatever they say of themselves. Siconos comes with Debian
(python3-siconos), pinocchio with the extra `rivals`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import partial

import numpy as np
from scipy import sparse

from deep_contact.physics.lcp import ContactProblem, siconos_error
from deep_contact.physics.matrix_solvers import solve_problem
from deep_contact.physics.solvers import PGS, NesterovPGS

MOST_SWEEPS = 10_000
"""As Siconos's own tests allow."""


def methods(tolerance: float) -> dict[str, Callable]:
    """Every solver that can be imported, by name, to an error of `tolerance`. Prints why the others cannot."""
    makers = {f"ours, {kind.__name__}": partial(ours, kind) for kind in (PGS, NesterovPGS)}
    makers |= {f"Siconos {name}": partial(siconos, name) for name in ("NSGS", "ADMM", "NSN_AC")}
    makers["pinocchio ADMM"], importable = pinocchio, {}
    for name, make in makers.items():
        try:
            importable[name] = make(tolerance)
        except ImportError as error:
            print(f"{name}: {error}")
    return importable


def ours(kind, tolerance: float) -> Callable:
    """One of our methods. Its form of the problem is made in every run."""
    solver = kind(sweeps=MOST_SWEEPS, tolerance=None)
    return lambda problem: solve_problem(problem, solver, error=tolerance)[0]


def siconos(name: str, tolerance: float) -> Callable:
    """Siconos's solver SICONOS_FRICTION_3D_… of this name. Its form of a problem is made in the first run.

    Its planar solvers refuse sparse matrices, so every contact gets a second tangent that meets nothing.
    """
    from siconos import numerics

    built: dict[int, tuple] = {}

    def solve(problem: ContactProblem) -> np.ndarray:
        m = problem.friction.size
        if id(problem) not in built:
            W, q = padded(problem)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # that it converts indices
                theirs = numerics.FrictionContactProblem(3, m, W, q, problem.friction)
            built[id(problem)] = theirs, problem, W, q  # it holds no references of its own
        options = numerics.SolverOptions(getattr(numerics, f"SICONOS_FRICTION_3D_{name}"))
        options.iparam[0], options.dparam[0] = MOST_SWEEPS, tolerance
        reaction, velocity = np.zeros(3 * m), np.zeros(3 * m)
        numerics.fc3d_driver(built[id(problem)][0], reaction, velocity, options)
        return reaction.reshape(m, 3)[:, :2].ravel().copy()

    return solve


def pinocchio(tolerance: float) -> Callable:
    """ADMM of pinocchio 4. Contacts are padded as for Siconos, with the normal last.

    It stops by a measure of its own, in other units: the loosest power of ten at which its result has the error that is
    asked for is found in the first run of a problem.
    """
    import pinocchio as pin

    if not hasattr(pin, "ADMMConstraintSolver"):
        raise ImportError(f"pinocchio: expected version 4 or later, got {pin.__version__}")
    built: dict[int, tuple] = {}

    def run(form: tuple, own: float) -> np.ndarray:
        W, q, models, datas, m = form
        settings, result = pin.ADMMSolverSettings(), pin.ADMMSolverResult()
        settings.max_iterations, settings.lanczos_size = MOST_SWEEPS, 20  # its default never ends on large problems
        settings.absolute_feasibility_tol = settings.absolute_complementarity_tol = own
        settings.relative_feasibility_tol = settings.relative_complementarity_tol = 0.0
        pin.ADMMConstraintSolver(q.size).solve(pin.DelassusOperatorSparse(W), q, models, datas, settings, result)
        return np.array(result.retrieveConstraintImpulses()).reshape(m, 3)[:, [2, 0]].ravel()

    def solve(problem: ContactProblem) -> np.ndarray:
        if id(problem) not in built:
            m = problem.friction.size
            W, q = padded(problem)
            order = (3 * np.arange(m)[:, None] + [1, 2, 0]).ravel()
            models, datas = pin.StdVec_ConstraintModel(), pin.StdVec_ConstraintData()
            for friction in problem.friction.tolist():
                contact = pin.PointContactConstraintModel(pin.Model())
                contact.setFriction(friction)
                models.append(pin.ConstraintModel(contact))
                datas.append(models[len(models) - 1].createData())
            form = sparse.csc_matrix(W.tocsr()[order][:, order]), q[order], models, datas, m
            for own in 10.0 ** -np.arange(1, 11):
                if siconos_error(problem, run(form, own)) <= tolerance:
                    break
            built[id(problem)] = form, own, problem
        return run(*built[id(problem)][:2])

    return solve


def padded(problem: ContactProblem) -> tuple[sparse.csc_matrix, np.ndarray]:
    """W and q with a third row for every contact, whose entry is that of the tangent and which nothing pulls."""
    m = problem.friction.size
    kept = (3 * np.arange(m)[:, None] + np.arange(2)).ravel()
    A = problem.A.tocoo()
    third = 3 * np.arange(m) + 2
    rows, columns = (np.concatenate([kept[index], third]) for index in A.coords)
    entries = np.concatenate([A.data, problem.A.diagonal()[1::2]])
    q = np.zeros(3 * m)
    q[kept] = problem.b
    return sparse.csc_matrix((entries, (rows, columns)), shape=(3 * m, 3 * m)), q
