"""The same matrices, our solvers and others: time to an error, the price of convexity, and what starts are worth.

A problem is a `ContactProblem`; what a solver returns is judged by a function of ours, whatever it says of itself:
`lcp.siconos_error`. Rivals: Siconos (Debian's python3-siconos), pinocchio, and Clarabel on the convex relaxation. Each
is left out with the reason where it cannot be imported.
"""

from __future__ import annotations

import itertools
import json
import time
import warnings
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from scipy import sparse

from deep_contact.io.fclib import read_guess, read_problem, write_fclib
from deep_contact.io.files import write_json
from deep_contact.physics.exact import solve_exactly
from deep_contact.physics.lcp import ContactProblem, check_problem, contact_problem, siconos_error
from deep_contact.physics.matrix_solvers import solve_problem
from deep_contact.physics.solvers import NNCG, PGS, NesterovPGS
from deep_contact.reporting.figures import seeds
from deep_contact.studies.piles import pile, states_of

MOST_SWEEPS = 10_000
"""As Siconos's own tests allow."""

OURS = {"PGS": PGS, "NNCG": NNCG, "NesterovPGS": NesterovPGS}

SICONOS = ("NSGS", "ADMM", "NSN_AC")
"""Names of Siconos's solvers, behind SICONOS_FRICTION_3D_."""

FACTORS = (1, 2, 5, 10, 100)
"""Of a performance profile: share of problems solved within so many times the time of the fastest."""


def read_problems(paths: Iterable[Path]) -> dict[str, ContactProblem]:
    """The problems of fc2d and FCLIB files, by the names of the files."""
    return {Path(path).name.split(".")[0]: read_problem(path) for path in paths}


def own_problems(counts: Iterable[int], seed: int = 0) -> dict[str, ContactProblem]:
    """A state of a settling pile for every number of circles."""
    counts = list(counts)
    found = {}
    for count, own in zip(counts, seeds(seed, len(counts))):
        state = states_of(pile("settling", count, own), count=1)[0]
        found[f"settling pile of {count}"] = check_problem(contact_problem(state))
    return found


def ours(name: str, tolerance: float) -> Callable:
    """Our solver, as problem, start -> impulses."""
    solver = OURS[name](sweeps=MOST_SWEEPS, tolerance=None)
    return lambda problem, start: solve_problem(problem, solver, start, error=tolerance)[0]


def siconos(name: str, tolerance: float) -> Callable:
    """A solver of Siconos, as problem, start -> impulses. Raises ImportError.

    Its planar solvers refuse sparse matrices, so every contact gets a second tangent that meets nothing. Its form of a
    problem is kept, so that only the first run builds it; ours are built in every run.
    """
    from siconos import numerics

    built: dict[int, tuple] = {}

    def problem_of(problem: ContactProblem):
        if id(problem) not in built:
            W, q = padded(problem)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # that it converts indices
                given = numerics.FrictionContactProblem(3, problem.friction.size, W, q, problem.friction)
            built[id(problem)] = given, problem, W, q  # it holds no references of its own
        return built[id(problem)][0]

    def solve(problem: ContactProblem, start):
        m = problem.friction.size
        given = problem_of(problem)
        options = numerics.SolverOptions(getattr(numerics, f"SICONOS_FRICTION_3D_{name}"))
        options.iparam[0], options.dparam[0] = MOST_SWEEPS, tolerance
        reaction, velocity = np.zeros(3 * m), np.zeros(3 * m)
        reaction.reshape(m, 3)[:, :2] = 0.0 if start is None else start.reshape(m, 2)
        numerics.fc3d_driver(given, reaction, velocity, options)
        return reaction.reshape(m, 3)[:, :2].ravel().copy()

    return solve


def pinocchio(tolerance: float) -> Callable:
    """ADMM of pinocchio 4, as problem, start -> impulses. Raises ImportError.

    It stops by a measure of its own, in other units: the loosest power of ten at which its result has the error that is
    asked for is found in the first run of a problem. Contacts are padded as for Siconos, with the normal last.
    """
    import pinocchio as pin

    if not hasattr(pin, "ADMMConstraintSolver"):
        raise ImportError(f"pinocchio: expected version 4 or later, got {pin.__version__}")
    built: dict[int, tuple] = {}

    def run(given: tuple, start, own: float) -> np.ndarray:
        W, q, models, datas, m = given
        settings, result = pin.ADMMSolverSettings(), pin.ADMMSolverResult()
        settings.max_iterations, settings.lanczos_size = MOST_SWEEPS, 20  # its default never ends on large problems
        settings.absolute_feasibility_tol = settings.absolute_complementarity_tol = own
        settings.relative_feasibility_tol = settings.relative_complementarity_tol = 0.0
        if start is not None:
            guess = np.zeros((m, 3))
            guess[:, [2, 0]] = start.reshape(m, 2)
            result.setConstraintImpulseGuess(guess.ravel())
        pin.ADMMConstraintSolver(q.size).solve(pin.DelassusOperatorSparse(W), q, models, datas, settings, result)
        return np.array(result.retrieveConstraintImpulses()).reshape(m, 3)[:, [2, 0]].ravel()

    def solve(problem: ContactProblem, start) -> np.ndarray:
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
            given = sparse.csc_matrix(W.tocsr()[order][:, order]), q[order], models, datas, m
            for own in 10.0 ** -np.arange(1, 11):
                if siconos_error(problem, run(given, start, own)) <= tolerance:
                    break
            built[id(problem)] = given, own, problem
        return run(built[id(problem)][0], start, built[id(problem)][1])

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


def relaxed(problem: ContactProblem, tolerance: float = 1e-10) -> np.ndarray:
    """The convex relaxation: min ½ λᵀ A λ + bᵀ λ in the friction cones, by Clarabel. Raises ImportError.

    A sliding contact parts at μ times its slip there (Anitescu 2006), as in MuJoCo, SAP and APGD's paper.
    """
    import clarabel

    m = problem.friction.size
    i = np.arange(m)
    rows = np.concatenate([2 * i, 2 * i, 2 * i + 1, 2 * i + 1])
    columns = np.concatenate([2 * i, 2 * i + 1, 2 * i, 2 * i + 1])
    ones = np.ones(m)
    G = sparse.csc_matrix(
        (np.concatenate([-problem.friction, ones, -problem.friction, -ones]), (rows, columns)), shape=(2 * m, 2 * m)
    )
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    bounds = sparse.vstack([G, sparse.csc_matrix((-ones, (i, 2 * i)), shape=(m, 2 * m))], format="csc")
    P = sparse.csc_matrix(sparse.triu(problem.A))
    cones = [clarabel.NonnegativeConeT(3 * m)]
    found = clarabel.DefaultSolver(P, problem.b, bounds, np.zeros(3 * m), cones, settings).solve()
    return np.array(found.x)


def methods(tolerance: float) -> tuple[dict[str, Callable], dict[str, str]]:
    """Every solver that can be had, by name, and why the others cannot."""
    found: dict[str, Callable] = {f"ours, {name}": ours(name, tolerance) for name in OURS}
    missing = {}
    for name in SICONOS:
        try:
            found[f"Siconos {name}"] = siconos(name, tolerance)
        except ImportError as error:
            missing[f"Siconos {name}"] = str(error)
    try:
        found["pinocchio ADMM"] = pinocchio(tolerance)
    except ImportError as error:
        missing["pinocchio ADMM"] = str(error)
    return found, missing


def compare(
    problems: dict[str, ContactProblem],
    *,
    tolerance: float = 1e-5,
    repeats: int = 5,
    most: float = 20.0,
    only: Sequence[str] = (),
    progress=None,
) -> dict:
    """Processor time and error of every method on every problem, without a start, one run of each after the other.

    repeats: times each is run, in turns; the least time counts. One that takes more than `most` seconds runs once, and
    on no larger problem: time and error are None there. only: names of methods; by default all.
    """
    solvers, missing = methods(tolerance)
    solvers = {name: solve for name, solve in solvers.items() if name in (only or solvers)}
    times: dict[str, dict[str, float]] = {}
    errors: dict[str, dict[str, float]] = {}
    problems = dict(sorted(problems.items(), key=lambda item: item[1].friction.size))
    slow: set[str] = set()
    for title, problem in problems.items():
        times[title], errors[title] = dict.fromkeys(slow), dict.fromkeys(slow)
        for turn in range(repeats + 1):  # the first compiles, and counts where no other follows
            for name, solve in solvers.items():
                if name in slow:
                    continue
                begin = time.process_time()
                impulse = solve(problem, None)
                seconds = time.process_time() - begin
                errors[title][name] = finite_or_one(siconos_error(problem, impulse))
                if turn < 2 or seconds < times[title][name]:
                    times[title][name] = seconds
                if seconds > most:
                    slow.add(name)
        if progress:
            progress(f"{title}: {problem.friction.size} contacts")
    return {
        "tolerance": tolerance,
        "contacts": {title: int(problem.friction.size) for title, problem in problems.items()},
        "seconds": times,
        "error": errors,
        "missing": missing,
        "profile": profile(times, errors, tolerance),
    }


def with_again(first: dict, second: dict) -> dict:
    """The rows of two runs by name. What both have is named "…, again" in the second, for ratios within that run."""
    return first | {f"{name}, again" if name in first else name: row for name, row in second.items()}


def with_second_run(first: dict, second: dict) -> dict:
    """A result of `compare` with the methods of another run on the same problems, in an environment of its own.

    In the profile, times of the second run count by their ratio to those of a method that both have. Raises ValueError
    where problems or tolerance differ, or where they share no method.
    """
    for key in ("contacts", "tolerance"):
        if first[key] != second[key]:
            raise ValueError(f"{key}: expected {first[key]} as in the first run, got {second[key]}")
    shared = [name for name in second["profile"] if name in first["profile"]]
    if not shared:
        raise ValueError(f"profile: expected one of {', '.join(first['profile'])}, got {', '.join(second['profile'])}")
    both, times, errors = {}, {}, {}
    for key in ("seconds", "error"):
        both[key] = {title: with_again(rows, second[key][title]) for title, rows in first[key].items()}
    for title, rows in first["seconds"].items():
        others = second["seconds"][title]
        scale = rows[shared[0]] / others[shared[0]]
        times[title] = {name: time and scale * time for name, time in others.items()} | rows
        errors[title] = second["error"][title] | first["error"][title]
    both["profile"] = profile(times, errors, first["tolerance"])
    more = {key: second[key] for key in ("relaxation", "mujoco") if key in second}
    found = {*second["profile"], *("MuJoCo" for _ in more.get("mujoco", [])[:1])}
    missing = {name: why for name, why in first["missing"].items() if name not in found}
    return first | both | more | {"missing": missing, "second_provenance": second["provenance"]}


def finite_or_one(error: float) -> float:
    """The error; 1, as of no impulses where bodies meet, if what was returned is not finite."""
    return float(error) if np.isfinite(error) else 1.0


def profile(times: dict, errors: dict, tolerance: float) -> dict[str, list[float]]:
    """Share of problems that each method solved within `FACTORS` times the fastest (Dolan and Moré 2002)."""
    found: dict[str, list[float]] = {}
    for name in {name for row in times.values() for name in row}:
        ratios = []
        for title, row in times.items():
            solved = {other: row[other] for other in row if _is_solved(errors[title][other], tolerance)}
            ratios.append(row[name] / min(solved.values()) if name in solved else np.inf)
        found[name] = [float(np.mean(np.array(ratios) <= factor)) for factor in FACTORS]
    return dict(sorted(found.items()))


def _is_solved(error: float | None, tolerance: float) -> bool:
    return error is not None and error <= tolerance


def table(found: dict) -> list[list[str]]:
    """The results as rows, head first: milliseconds, in brackets with the error where that missed the tolerance."""
    titles = list(found["contacts"])
    rows = [["method", *(f"{title}, {found['contacts'][title]:,} contacts" for title in titles)]]
    for name in found["seconds"][titles[0]]:
        cells = []
        for title in titles:
            seconds, error = found["seconds"][title][name], found["error"][title][name]
            text = "–" if seconds is None else f"{1e3 * seconds:,.3g} ms"
            missed = seconds is not None and not _is_solved(error, found["tolerance"])
            cells.append(f"({text}, error {error:.0e})" if missed else text)
        rows.append([name, *cells])
    return rows + [[name, f"left out: {why}", *[""] * (len(titles) - 1)] for name, why in found["missing"].items()]


def draw_profile(found: dict):
    """The performance profile as a matplotlib figure: share of problems by times of the fastest."""
    from deep_contact.reporting import plotting

    figure, ax = plotting.subplots(size=(7.5, 3.8))
    for (name, shares), marker in zip(found["profile"].items(), itertools.cycle("osD^vPX*")):
        ax.plot(FACTORS, shares, "-" if name.startswith("ours") else "--", marker=marker, label=name)
    title = f"{len(found['contacts'])} problems to an error of {found['tolerance']:g}"
    plotting.label_axes(ax, "time over the fastest's", "share of problems solved", title=title)
    ax.set(xscale="log", ylim=(-0.02, 1.02), xticks=FACTORS, xticklabels=[f"{factor:g}" for factor in FACTORS])
    ax.minorticks_off()
    ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return figure


def relaxation_table(found: dict) -> list[list[str]]:
    """The errors of the convex relaxation as rows, head first: median, largest, by pile and μ."""
    rows = found.get("relaxation", [])
    frictions = sorted({row["friction"] for row in rows})
    cells = {(row["circles"], row["kind"], row["friction"]): row for row in rows}
    table = [["pile", *(f"μ = {friction:g}" for friction in frictions)]]
    for circles, kind in dict.fromkeys((row["circles"], row["kind"]) for row in rows):
        line = [f"{circles:,} {kind}"]
        for friction in frictions:
            row = cells[circles, kind, friction]
            errors = row["errors"]
            text = f"{np.median(errors):.2f}, {max(errors):.2f}" if errors else "–"
            line.append(text if len(errors) == row["states"] else f"{text} ({len(errors)} of {row['states']})")
        table.append(line)
    return table


def relaxation_errors(
    kinds: Sequence[str], counts: Sequence[int], frictions: Sequence[float], *, states: int = 4, seed: int = 0
) -> list[dict]:
    """Velocity error of the convex relaxation against the exact solution, over kinds of piles, sizes, μ and seeds.

    Relative, in the energy norm: 1 is the error of doing nothing (`metrics.velocity_error`). μ is that of the step that
    is looked at; the pile fell with the thesis's. States without an exact solution are left out, and counted.
    """
    rows = []
    for kind in kinds:
        for count in counts:
            piles = [states_of(pile(kind, count, own), count=1)[0] for own in seeds(seed, states)]
            for friction in frictions:
                errors = []
                for state in piles:
                    problem = check_problem(contact_problem(state))._replace(
                        friction=np.full(state.contacts.count, friction)
                    )
                    start = state.contacts.normal_impulse, state.contacts.tangent_impulse
                    exact = solve_exactly(problem, *start)
                    if exact.converged:
                        solution = exact.solution
                        impulse = np.column_stack([solution.normal_impulses, solution.tangent_impulses]).ravel()
                        errors.append(energy_error(problem, relaxed(problem), impulse))
                rows.append({"kind": kind, "circles": count, "friction": friction, "states": states, "errors": errors})
    return rows


def energy_error(problem: ContactProblem, impulse: np.ndarray, reference: np.ndarray) -> float:
    """`metrics.velocity_error` from impulses: ‖λ − λ*‖_A / ‖λ*‖_A, since v − v* = M⁻¹ Jᵀ (λ − λ*)."""
    wrong = impulse - reference
    return float(np.sqrt(max(0.0, wrong @ (problem.A @ wrong)) / (reference @ (problem.A @ reference))))


def write_sequence(folder: Path, states: Iterable) -> Path:
    """Write states in sequence as FCLIB files with the carried impulses as the guess, and a list of them.

    For a benchmark of starts: step_0000.hdf5, … and sequence.json. Returns the folder.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for k, state in enumerate(states):
        files.append({"file": write_fclib(folder / f"step_{k:04d}.hdf5", state).name, "contacts": state.contacts.count})
    write_json(folder / "sequence.json", {"format": "FCLIB local problems with one guess", "steps": files})
    return folder


def score_starts(
    folder: Path, starts: dict[str, Callable], *, tolerance: float = 1e-4, solvers: dict[str, Callable] | None = None
) -> dict[str, dict[str, dict]]:
    """What starts are worth on a sequence: seconds and unsolved steps of every solver from every start.

    starts: name -> function of (problem, carried impulses (2 m,)) that returns impulses (2 m,), or None for none.
    solvers: name -> function of (problem, start); by default those of `methods`. Times include the start's own.
    Every problem is solved once before, untimed, since rivals build it then. Times are of the processor.
    Returns {solver: {start: {"seconds": sum over the steps, "unsolved": steps above the tolerance, "steps"}}}.
    """
    folder = Path(folder)
    steps = json.loads((folder / "sequence.json").read_text(encoding="utf-8"))["steps"]
    problems = [(read_problem(folder / step["file"]), read_guess(folder / step["file"])) for step in steps]
    solvers = methods(tolerance)[0] if solvers is None else solvers
    found: dict[str, dict[str, dict]] = {}
    for solver, solve in solvers.items():
        for problem, _ in problems:
            solve(problem, None)
        for name, start in starts.items():
            seconds, unsolved = 0.0, 0
            for problem, carried in problems:
                begin = time.process_time()
                impulse = solve(problem, start(problem, carried))
                seconds += time.process_time() - begin
                unsolved += not siconos_error(problem, impulse) <= tolerance
            found.setdefault(solver, {})[name] = {"seconds": seconds, "unsolved": unsolved, "steps": len(problems)}
    return found


def starts_table(found: dict) -> list[list[str]]:
    """The scores as rows, head first: mean milliseconds of a step from every start, and how many were not solved."""
    solvers = found["solvers"]
    rows = [["solver", *next(iter(solvers.values()))]]
    for solver, row in solvers.items():
        cells = []
        for cell in row.values():
            unsolved = f", {cell['unsolved']} of {cell['steps']} unsolved" if cell["unsolved"] else ""
            cells.append(f"{1e3 * cell['seconds'] / cell['steps']:.3g} ms{unsolved}")
        rows.append([solver, *cells])
    return rows


STARTS: dict[str, Callable] = {
    "none": lambda problem, carried: None,
    "carried": lambda problem, carried: carried,
}
"""Starts that `scripts/benchmark_starts.py` scores: nothing, and last step's impulses."""
