"""Every method against the same contact problems: nnls, the natural map, sweeps done by hand, and whole runs."""

import numpy as np
import pytest
from conftest import kinetic_energy, momentum, solved_states
from scipy import optimize

import deep_contact as dc
from deep_contact.constants import LINEAR_SLOP, MAX_ROTATION, MAX_TRANSLATION
from deep_contact.physics import engine, metrics
from deep_contact.physics.collision import make_contacts
from deep_contact.physics.contact_solver import apply_impulses, contact_rows, integrate_velocities, make_rows, sweep
from deep_contact.physics.exact import solve_exactly
from deep_contact.physics.lcp import contact_problem
from deep_contact.physics.scenes import single_body
from deep_contact.physics.solvers import METHODS, apgd, describe, nesterov, soft_steps
from deep_contact.physics.solvers.psor import LARGEST_OMEGA, better_omega
from deep_contact.physics.solvers.registry import for_state
from deep_contact.simulation import ready
from deep_contact.state import State, World, make_bodies
from deep_contact.warm_start import Builtin

PAST_NEED = {"sweeps": 100_000, "tolerance": 1e-11}
EXACT = [
    dc.PGS(**PAST_NEED),
    dc.PSOR(**PAST_NEED),
    dc.PSOR(**PAST_NEED, omega=1.0, adaptive=True),
    dc.SymmetricPGS(**PAST_NEED),
    dc.NNCG(**PAST_NEED),
    dc.NesterovPGS(**PAST_NEED),
    dc.APGD(**PAST_NEED),
]
"""Methods that solve the rigid contact problem, far past need."""


@pytest.fixture(scope="module")
def nnls_velocities(frictionless_states):
    """Velocities (n, 3) of min over λ >= 0 of ½ |B λ + M^½ v|², B = M^-½ Jᵀ: without friction, the only ones."""
    found = []
    for state in frictionless_states:
        problem = contact_problem(state, friction=False)
        root = np.sqrt(problem.inverse_mass)
        expected, _ = optimize.nnls(
            root[:, None] * problem.jacobian.T.toarray(), -problem.free_velocity / root, maxiter=100_000
        )
        found.append(problem.velocities(expected).reshape(-1, 3))
    return found


@pytest.mark.parametrize("solver", EXACT, ids=describe)
def test_frictionless_velocities_equal_nnls(solver, frictionless_states, nnls_velocities):
    for state, velocity in zip(frictionless_states, nnls_velocities):
        solution = dc.solve_contacts(state, solver=solver)
        assert solution.record.status == "converged"
        np.testing.assert_allclose(solution.velocities, velocity[:, :2], atol=1e-8)
        np.testing.assert_allclose(solution.angular_velocities, velocity[:, 2], atol=1e-8)


@pytest.mark.parametrize("solver", EXACT, ids=describe)
def test_solution_is_complementary_and_in_the_cone(solver, falling_states):
    # Eq 2.27 and 2.29 row by row; θ of 1e-11 N·s over masses of 1 kg and more leaves far less than 1e-8 m/s.
    done = 0
    for state in falling_states[::3]:
        solution = dc.solve_contacts(state, solver=solver)
        if solution.record.status == "converged":  # with friction nothing promises that it does
            done += 1
            largest = state.world.friction * solution.normal_impulses
            assert (solution.normal_impulses >= 0).all()
            assert (np.abs(solution.tangent_impulses) <= largest + 1e-8).all()
            assert metrics.residual(state, solution) < 1e-8
    assert done >= 0.8 * len(falling_states[::3])


def problem_of(state):
    """A, b, μ and the impulses to start from, rows as `contact_problem` numbers them."""
    problem = contact_problem(state)
    start = np.column_stack([state.contacts.normal_start, state.contacts.tangent_start]).ravel()
    return problem.A.toarray(), problem.b, state.world.friction, start


def swept(A, b, mu, impulse, *, omega=1.0, friction_omega=None, backwards=False):
    """λ after one sweep by hand: every change of a row times ω, cut to what is admissible; tangent row first."""
    factors = omega, omega if friction_omega is None else friction_omega
    impulse = impulse.copy()
    contacts = range(0, b.size, 2)
    for row in reversed(contacts) if backwards else contacts:
        for i in (row + 1, row):
            free = impulse[i] - factors[i - row] * (A[i] @ impulse + b[i]) / A[i, i]
            bound = mu * impulse[row]
            impulse[i] = max(free, 0.0) if i == row else max(-bound, min(free, bound))
    return impulse


def assert_impulses(solution, impulse):
    # Equal but for rounding, which tens of sweeps do not amplify beyond 1e-11.
    np.testing.assert_allclose(solution.normal_impulses, impulse[::2], atol=1e-11 * impulse.max())
    np.testing.assert_allclose(solution.tangent_impulses, impulse[1::2], atol=1e-11 * impulse.max())


def test_psor_is_over_relaxed_algorithm_1(falling_states):
    A, b, mu, impulse = problem_of(falling_states[5])
    for _ in range(5):
        impulse = swept(A, b, mu, impulse, omega=1.4)
    assert_impulses(dc.solve_contacts(falling_states[5], solver=dc.PSOR(sweeps=5, tolerance=None, omega=1.4)), impulse)


def test_friction_omega_is_that_of_the_tangent_rows(falling_states):
    A, b, mu, impulse = problem_of(falling_states[5])
    before = impulse
    for _ in range(5):
        before, impulse = impulse, swept(A, b, mu, impulse, omega=1.8, friction_omega=1.3)
    solver = dc.PSOR(sweeps=5, tolerance=None, omega=1.8, friction_omega=1.3)
    solution = dc.solve_contacts(falling_states[5], solver=solver)
    assert_impulses(solution, impulse)
    # By the smaller ω, so that θ is no less than what a plain sweep would have changed.
    assert solution.record.theta[-1] == pytest.approx(np.abs(impulse - before).max() / 1.3, rel=1e-9)


def test_adaptive_omega_changes_every_twelve_sweeps(falling_states):
    A, b, mu, impulse = problem_of(falling_states[5])
    omega, theta = 1.0, np.empty(30)
    for k in range(30):
        after = swept(A, b, mu, impulse, omega=omega)
        theta[k] = np.abs(after - impulse).max() / omega
        impulse = after
        if k in (11, 23):
            omega = better_omega(theta, k, omega)
            assert omega > 1.01
    solver = dc.PSOR(sweeps=30, tolerance=None, omega=1.0, adaptive=True)
    solution = dc.solve_contacts(falling_states[5], solver=solver)
    assert_impulses(solution, impulse)
    np.testing.assert_allclose(solution.record.theta, theta, atol=1e-11 * impulse.max())


@pytest.mark.parametrize("mu", [0.2, 0.6, 0.9])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.9])
def test_better_omega_is_that_of_young(mu, share):
    # With Jacobi's spectral radius μ, SOR's λ solves (λ + ω − 1)² = λ ω² μ² while ω is below the best,
    # 2 / (1 + √(1 − μ²)) (Young 1954). Only the largest θ of each half of the window counts.
    best = 2 / (1 + np.sqrt(1 - mu**2))
    omega = 1 + share * (best - 1)
    rate = np.roots([1, 2 * (omega - 1) - omega**2 * mu**2, (omega - 1) ** 2]).max()
    theta = rate ** np.arange(24.0) * np.tile([1, 0.5, 0.3, 0.9, 0.2, 0.1], 4)
    np.testing.assert_allclose(better_omega(theta, 23, omega), best, rtol=1e-7)
    np.testing.assert_allclose(better_omega(theta, 17, omega), best, rtol=1e-7)


@pytest.mark.parametrize(
    ("rate", "omega", "expected"),
    [(1.1, 1.6, 1.3), (1.0, 1.4, 1.2), (0.3, 1.4, 1.4), (0.999, 1.2, LARGEST_OMEGA), (0.999, 1.0, LARGEST_OMEGA)],
)
def test_omega_goes_back_where_theta_grew_and_no_further_than_is_safe(rate, omega, expected):
    # Half of the way to 1 where θ did not fall; as it is where θ falls by ω − 1, which is as fast as SOR can.
    np.testing.assert_allclose(better_omega(rate ** np.arange(12.0), 11, omega), expected, rtol=1e-12)


def test_symmetric_sweeps_go_there_and_back(falling_states):
    A, b, mu, impulse = problem_of(falling_states[5])
    for k in range(4):
        impulse = swept(A, b, mu, impulse, backwards=k % 2 == 1)
    assert_impulses(dc.solve_contacts(falling_states[5], solver=dc.SymmetricPGS(sweeps=4, tolerance=None)), impulse)


@pytest.mark.parametrize("sweeps", [2, 3, 6, 20])
def test_nncg_is_fletcher_and_reeves_on_sweeps(falling_states, sweeps):
    # Silcowitz et al. 2010, Algorithm 3: λ ← λ + β p, p ← β p − ∇f with −∇f the sweep's change; p ← 0 where β > 1.
    A, b, mu, impulse = problem_of(falling_states[5])
    along, last = np.zeros_like(impulse), np.inf
    for k in range(sweeps):
        after = swept(A, b, mu, impulse)
        change, size = after - impulse, ((after - impulse) ** 2).sum()
        impulse = after
        if k < sweeps - 1:
            beta, last = size / last, size
            impulse = after + (beta <= 1) * beta * along
            along = beta * along + change if beta <= 1 else np.zeros_like(along)
    assert_impulses(dc.solve_contacts(falling_states[5], solver=dc.NNCG(sweeps=sweeps, tolerance=None)), impulse)


def test_apgd_is_nesterov_with_backtracking_and_restarts(falling_states):
    # Mazhar et al. 2015, Algorithm 1, in λ / √D: the next θ of the momentum solves θ² + θ_k² θ − θ_k² = 0.
    A, b, mu, before = problem_of(falling_states[5])
    mass, y, lipschitz, momentum, theta = 1 / A.diagonal(), before, 2.0, 1.0, []
    restarts = doubled = 0
    for _ in range(40):
        g = A @ y + b
        free = y - mass * g / lipschitz
        impulse = np.maximum(free, 0.0)
        impulse[1::2] = np.clip(free[1::2], -mu * impulse[::2], mu * impulse[::2])
        step = impulse - y
        theta.append(lipschitz * np.abs(step).max())
        if step @ A @ step > lipschitz * (step**2 / mass).sum():
            lipschitz, doubled = 2 * lipschitz, doubled + 1
            continue
        restart = g @ (impulse - before) > 0
        after = 1.0 if restart else np.roots([1, momentum**2, -(momentum**2)]).max()
        share = 0.0 if restart else momentum * (1 - momentum) / (momentum**2 + after)
        momentum, restarts = after, restarts + restart
        y, before, lipschitz = impulse + share * (impulse - before), impulse, 0.9 * lipschitz
    assert restarts > 0
    assert doubled > 0
    record = dc.solve_contacts(falling_states[5], solver=dc.APGD(sweeps=40, tolerance=None)).record
    np.testing.assert_allclose(record.theta, theta, rtol=1e-7, atol=1e-11 * impulse.max())


def test_kinetic_is_twice_the_kinetic_energy_of_all_circles():
    # s = ω r of a disc: I ω² = m s² / 2. The four walls at the end are not moved.
    rng = np.random.default_rng(0)
    change, solver_bodies = rng.normal(size=(7, 4)), rng.uniform(0.5, 2.0, (7, 4))
    expected = sum((x**2 + y**2 + s**2 / 2) / w for (x, y, s), w in zip(change[:3, :3], solver_bodies[:3, 3]))
    np.testing.assert_allclose(apgd.kinetic(change, solver_bodies), expected, rtol=1e-14)


@pytest.mark.parametrize("method", [dc.PSOR, dc.SymmetricPGS, dc.NNCG, dc.NesterovPGS])
def test_the_first_sweep_is_that_of_pgs(method, falling_states):
    options = {"omega": 1.0} if method is dc.PSOR else {}
    for state in falling_states[::5]:
        one = dc.solve_contacts(state, solver=method(sweeps=1, tolerance=None, **options))
        other = dc.solve_contacts(state, solver=dc.PGS(sweeps=1, tolerance=None))
        np.testing.assert_array_equal(one.normal_impulses, other.normal_impulses)
        np.testing.assert_array_equal(one.velocities, other.velocities)


@pytest.mark.parametrize("solver", EXACT, ids=describe)
def test_velocities_stay_those_of_the_impulses(solver, falling_states):
    # v = v⁻ + M⁻¹ Jᵀ λ after hundreds of extrapolations: rounding adds up to far less than 1e-9 m/s.
    state = falling_states[4]
    solution = dc.solve_contacts(state, solver=type(solver)(sweeps=300, tolerance=None))
    impulse = np.column_stack([solution.normal_impulses, solution.tangent_impulses]).ravel()
    velocity = contact_problem(state).velocities(impulse).reshape(-1, 3)
    np.testing.assert_allclose(solution.velocities, velocity[:, :2], atol=1e-9)
    np.testing.assert_allclose(solution.angular_velocities, velocity[:, 2], atol=1e-9)


def test_gradient_steps_do_not_depend_on_the_order_of_contacts(falling_states):
    # The same pile with its circles numbered backwards: APGD ends at the same velocities, PGS does not.
    state = falling_states[6]
    backwards = state.replace(
        bodies=type(state.bodies)(*(np.ascontiguousarray(field[::-1]) for field in state.bodies)), contacts=None
    )
    for method, same in ((dc.APGD, True), (dc.PGS, False)):
        solver = method(sweeps=40, tolerance=None)
        one = dc.solve_contacts(state, solver=solver, start=None).velocities
        other = dc.solve_contacts(backwards, solver=solver, start=None).velocities[::-1]
        assert np.allclose(one, other, atol=1e-9) == same


def test_nncg_needs_under_half_of_the_sweeps_of_pgs():
    # Silcowitz et al. 2010; on transient states of the thesis's scenes, from Builtin, to θ < 6e-5 (issue: 0.45).
    pgs, nncg = [], []
    for seed in range(10):
        scene = dc.circles_in_box(70 + 4 * seed, seed=seed)
        scene = dc.simulate(scene, steps=100, solver=dc.NNCG()).state
        for state in solved_states(scene, steps=350, every=35, solver=dc.NNCG()):
            for solver, found in ((dc.PGS(sweeps=20_000), pgs), (dc.NNCG(sweeps=20_000), nncg)):
                found.append(dc.solve_contacts(state, solver=solver).record.sweeps)
    assert len(pgs) > 90
    assert np.median(nncg) <= 0.45 * np.median(pgs)


@pytest.mark.parametrize("sweeps", [2, 4, 5])
def test_momentum_is_nesterovs(falling_states, sweeps):
    # β = (t − 1) / t⁺ from t = 1, restarted by the gradient; within the first window only sudden growth binds it.
    A, b, mu, start = problem_of(falling_states[5])
    last, t, most, size, shares = start, 1.0, nesterov.FIRST_MOMENTUM, np.inf, []
    for _ in range(sweeps):
        impulse = swept(A, b, mu, start)
        size, before = ((impulse - start) ** 2).sum(), size
        most = 2 * most - 1 if size > 1.2 * before else most
        after = (1 + np.sqrt(1 + 4 * t * t)) / 2
        uphill = (impulse - start) @ (impulse - last) < 0
        share, t = (0.0, 1.0) if uphill else (min((t - 1) / after, most), after)
        shares.append(share)
        start, last = impulse + share * (impulse - last), impulse
    assert sweeps < 4 or max(shares[:-1]) > 0.2
    assert_impulses(dc.solve_contacts(falling_states[5], solver=dc.NesterovPGS(sweeps=sweeps, tolerance=None)), impulse)


def test_momentum_leaves_a_third_of_the_error_of_pgs(falling_states):
    # Against the nearest of each method's own solutions, after as many sweeps; measured in the geometric mean: 0.13.
    ratios = []
    for state in falling_states:
        far = [dc.solve_contacts(state, solver=method(**PAST_NEED)) for method in (dc.PGS, dc.NesterovPGS)]
        left = [
            metrics.nearest_velocity_error(
                state, dc.solve_contacts(state, solver=method(sweeps=40, tolerance=None), start=None), far
            )
            for method in (dc.PGS, dc.NesterovPGS)
        ]
        if left[0] > 1e-6:  # otherwise there was nothing left to do
            ratios.append((left[1] + 1e-9) / left[0])
    assert len(ratios) >= 10
    assert np.exp(np.mean(np.log(ratios))) < 1 / 3


def test_momentum_agrees_with_pivots(falling_states):
    # Another algorithm altogether, from where a few sweeps of PGS end.
    same = []
    for state in falling_states[::4]:
        near = dc.solve_contacts(state, solver=dc.PGS(sweeps=100, tolerance=None))
        exact = solve_exactly(state, near.normal_impulses, near.tangent_impulses)
        solution = dc.solve_contacts(state, solver=dc.NesterovPGS(**PAST_NEED))
        if exact.converged and solution.record.status == "converged":
            same.append(metrics.velocity_error(state, solution, exact.solution) < 1e-6)
    assert len(same) >= 3
    assert np.mean(same) >= 0.7  # exact solutions may differ with friction


def test_adaptive_omega_beats_omega_one(falling_states):
    def sweeps(**options):
        solver = dc.PSOR(sweeps=20_000, omega=1.0, **options)
        return np.median([dc.solve_contacts(state, solver=solver).record.sweeps for state in falling_states])

    assert sweeps(adaptive=True) < 0.75 * sweeps()


@pytest.mark.parametrize("method", [dc.PGS, dc.NNCG, dc.NesterovPGS])
def test_single_precision_is_right_to_its_digits(method, falling_states):
    # 24 bits: unit roundoff 6e-8, some hundred sweeps; and it is float32 indeed, or all digits would agree.
    for state in falling_states[::5]:
        found = {}
        for precision in ("single", "double"):
            solver = method(sweeps=100, tolerance=None, precision=precision)
            found[precision] = dc.solve_contacts(state, solver=solver)
        single, double = found["single"], found["double"]
        assert single.velocities.dtype == single.normal_impulses.dtype == np.float64
        scale = np.abs(double.velocities).max()
        np.testing.assert_allclose(single.velocities, double.velocities, atol=1e-4 * scale)
        assert np.abs(single.velocities - double.velocities).max() > 1e-9 * scale


def test_what_is_not_finite_any_more_is_called_diverged(falling_states):
    # Beyond float32, and past the face of the package, which refuses such a start.
    state = falling_states[5]
    huge = np.full(state.contacts.count, 1e45)
    for method in (dc.PGS, dc.NNCG, dc.NesterovPGS, dc.APGD):
        assert engine.solve(state, method(precision="single"), huge, huge).record.status == "diverged"


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS.keys())
def test_every_method_goes_on_from_a_file_as_if_never_stopped(method, tmp_path):
    solver = method() if method is dc.SoftSteps else method(sweeps=25)
    scene = dc.circles_in_box(40, radius=(0.5, 1.5), restitution=0.3, seed=10)
    through = dc.simulate(scene, steps=140, solver=solver).state
    stopped = dc.simulate(scene, steps=70, solver=solver).state
    dc.write_state(tmp_path / "stop.xml", stopped)
    state = dc.read_state(tmp_path / "stop.xml")
    assert state.solver == stopped.solver == for_state(solver, scene)
    resumed = dc.simulate(state, steps=70).state
    np.testing.assert_array_equal(resumed.bodies.position, through.bodies.position)
    np.testing.assert_array_equal(resumed.bodies.velocity, through.bodies.velocity)


def test_soft_steps_fall_freely_in_small_steps():
    # Symplectic Euler with h = Δt / 4: after N small steps y = y_0 − g h² N (N + 1) / 2.
    steps, h, g = 20, 0.01 / 4, 9.81
    state = dc.simulate(single_body(height=20.0), steps=steps, solver=dc.SoftSteps()).state
    n = 4 * steps
    fallen = single_body(height=20.0).bodies.position[0, 1] - state.bodies.position[0, 1]
    np.testing.assert_allclose(fallen, g * h**2 * n * (n + 1) / 2, rtol=1e-12)


def test_soft_column_carries_k_weights_and_keeps_its_height():
    n, weight = 8, np.pi * 9.81 * 0.01
    state = dc.simulate(dc.column(n), steps=400, solver=dc.SoftSteps()).state
    below = {
        a: p for a, b, p in zip(state.contacts.body_a, state.contacts.body_b, state.contacts.normal_impulse) if b < n
    }
    np.testing.assert_allclose([below[n - 1 - k] for k in range(1, n)], weight * np.arange(1, n), rtol=1e-3)
    sunk = dc.column(n).bodies.position[:, 1] - state.bodies.position[:, 1]
    assert (sunk <= 2 * LINEAR_SLOP * np.arange(1, n + 1)).all()


def test_soft_steps_keep_momentum_and_make_no_energy():
    scene = dc.drifting_circles(40, size=40.0, sigma_coef=0.9, speed=3.0, seed=2)
    before = scene
    for _ in range(30):
        after = dc.step(before, solver=dc.SoftSteps())
        if before.contacts is not None and (before.contacts.body_b < 40).all():
            np.testing.assert_allclose(momentum(after.bodies), momentum(before.bodies), atol=1e-9)
        # What had penetrated at the start of a step is pushed out, and the relaxing sweep takes the push back.
        assert kinetic_energy(after.bodies) <= kinetic_energy(before.bodies) * (1 + 1e-9)
        before = after


@pytest.mark.parametrize("restitution", [0.5, 1.0])
def test_soft_head_on_pair_ends_as_newton_says(restitution):
    scene = dc.two_bodies(speed=4.0, radius=(1.0, 0.5), restitution=restitution)
    solution = dc.solve_contacts(scene, solver=dc.SoftSteps(), start=None)
    closing = solution.velocities[0, 0] - solution.velocities[1, 0]
    np.testing.assert_allclose(closing, -restitution * 4.0, rtol=1e-9)


def test_soft_pile_comes_to_rest():
    state = dc.simulate(dc.circles_in_box(50, seed=5), steps=900, solver=dc.SoftSteps()).state
    assert np.median(np.hypot(*state.bodies.velocity.T)) < 1e-2
    assert metrics.penetration(state) < 3 * LINEAR_SLOP


def test_a_soft_bounce_keeps_momentum_along_any_normal():
    # Without friction and with e = 1 nothing of the energy is lost: circles of 1 and 3 kg along (0.6, 0.8).
    bodies = make_bodies([[10.0, 10.0], [11.2, 11.6]], velocity=[[2.0, 3.0], [-1.0, 0.5]], spin=1.0, mass=[1.0, 3.0])
    world = World(gravity=(0, 0), friction=0.0, restitution=1.0)
    scene = State(name="oblique", world=world, bodies=bodies)
    solution = dc.solve_contacts(scene, solver=dc.SoftSteps(), start=None)
    after = bodies._replace(velocity=solution.velocities, spin=solution.angular_velocities)
    np.testing.assert_allclose(momentum(after), momentum(bodies), rtol=1e-12)
    np.testing.assert_allclose(kinetic_energy(after), kinetic_energy(bodies), rtol=1e-12)
    change = after.velocity[1] - bodies.velocity[1]
    np.testing.assert_allclose(change / np.hypot(*change), [0.6, 0.8], rtol=1e-9)


SPRING = soft_steps.SoftSettings(substeps=4, hertz=30.0, damping_ratio=0.7, push_speed=1e9)


def soft_row(scene, *, gap, start=0.0, speed=0.0):
    """One contact for a small step: its rows with λ_n = `start` applied, solver bodies, masses and gap."""
    state = ready(scene)
    contacts = state.contacts._replace(normal_start=np.array([start]), tangent_start=np.zeros(1))
    bodies = state.bodies._replace(velocity=state.bodies.velocity + speed * np.array([0.0, 1.0]))
    solver_bodies = np.empty((bodies.count + 4, 4))
    integrate_velocities(bodies, (0.0, 0.0), 0.0, solver_bodies)
    rows, _ = contact_rows(bodies, contacts, solver_bodies, 0.0, 1.0, make_rows(1, solver_bodies.dtype))
    apply_impulses(rows, solver_bodies)
    return rows, solver_bodies, rows.data[:, 2].copy(), np.array([gap])


@pytest.mark.parametrize("start", [0.0, 0.3])
@pytest.mark.parametrize(("scene", "hertz"), [(dc.two_bodies(speed=0.0), 30.0), (single_body(), 60.0)])
def test_soft_contacts_are_springs_by_implicit_euler(scene, hertz, start):
    # m v' = −k C − c v with C' = v, k = m ω², c = 2 ζ m ω: v₁ = (v₀ − h ω² C₀) / (1 + 2 ζ ω h + ω² h²), whatever
    # impulse the row starts from. Walls are twice as stiff. C: the gap beyond the slop.
    h, zeta, omega, gap = 0.0025, 0.7, 2 * np.pi * hertz, -0.01
    rows, solver_bodies, mass, gaps = soft_row(scene, gap=gap, start=start)
    soft_steps.soften(rows, gaps, mass, SPRING, h, scene.bodies.count)
    sweep(rows, 0.0, solver_bodies)
    a, b = rows.body[0]
    apart = (solver_bodies[b, :2] - solver_bodies[a, :2]) @ rows.data[0, :2]
    np.testing.assert_allclose(apart, -h * omega**2 * gap / (1 + 2 * zeta * omega * h + (omega * h) ** 2), rtol=1e-12)


def test_springs_push_no_faster_than_asked_and_no_stiffer_than_the_small_step_allows():
    h, scene = 0.0025, single_body()
    for hertz, push, expected in ((30.0, 0.2, 0.2), (1e4, 1e9, None), (100.0, 1e9, None)):
        rows, _, mass, gaps = soft_row(scene, gap=-0.5)
        settings = soft_steps.SoftSettings(substeps=4, hertz=hertz, damping_ratio=10.0, push_speed=push)
        soft_steps.soften(rows, gaps, mass, settings, h, 1)
        omega = 2 * np.pi * 2 * min(hertz, 0.25 / h)  # a quarter of the small steps a second, twice that for walls
        np.testing.assert_allclose(rows.data[0, 6], expected or 0.5 * omega / (20 + h * omega), rtol=1e-12)


@pytest.mark.parametrize(("speed", "expected"), [(-10.0, -4.0), (-3.0, -3.0)])
def test_open_contacts_may_close_within_the_small_step(speed, expected):
    # A gap of 0.01 m leaves 4 m/s for h = 0.0025 s, in both sweeps.
    h = 0.0025
    for stage in ("soften", "harden"):
        rows, solver_bodies, mass, gaps = soft_row(single_body(), gap=0.01, speed=speed)
        if stage == "soften":
            soft_steps.soften(rows, gaps, mass, SPRING, h, 1)
        else:
            soft_steps.harden(rows, gaps, mass, h)
        sweep(rows, 0.0, solver_bodies)
        np.testing.assert_allclose(solver_bodies[0, 1], expected, rtol=1e-12)


def test_the_second_sweep_takes_the_push_back():
    rows, solver_bodies, mass, gaps = soft_row(single_body(), gap=-0.01)
    soft_steps.soften(rows, gaps, mass, SPRING, 0.0025, 1)
    sweep(rows, 0.0, solver_bodies)
    soft_steps.harden(rows, gaps, mass, 0.0025)
    sweep(rows, 0.0, solver_bodies)
    np.testing.assert_allclose(solver_bodies[0, :2], 0.0, atol=1e-15)
    np.testing.assert_array_equal(rows.data[:, 2], mass)


def test_gaps_follow_the_bodies_along_the_normal():
    # Separation and slop, plus what b has moved more than a along n; a wall does not move.
    contacts = make_contacts(2)
    contacts.body_a[:], contacts.body_b[:] = [0, 1], [1, 2]
    contacts.normal[:], contacts.separation[:] = [[0.6, 0.8], [0.0, -1.0]], [-0.02, 0.03]
    origin = np.array([[1.0, 2.0], [3.0, 5.0]])
    moved = origin + np.array([[0.01, 0.02], [0.05, -0.04]])
    gap = np.empty(2)
    soft_steps.find_gaps(contacts, moved, origin, LINEAR_SLOP, gap)
    expected = [-0.02 + LINEAR_SLOP + 0.6 * 0.04 + 0.8 * -0.06, 0.03 + LINEAR_SLOP - 0.04]
    np.testing.assert_allclose(gap, expected, rtol=1e-12)


def test_soft_steps_move_and_turn_no_further_than_the_engine():
    scene = single_body(height=10.0)
    fast = scene.bodies._replace(velocity=np.array([[-3e4, 4e4]]), spin=np.array([-1e5]))
    bodies = dc.step(scene.replace(bodies=fast, world=World(gravity=(0, 0))), solver=dc.SoftSteps()).bodies
    moved = bodies.position - scene.bodies.position
    np.testing.assert_allclose(moved, [[-0.6 * MAX_TRANSLATION, 0.8 * MAX_TRANSLATION]], rtol=1e-12)
    np.testing.assert_allclose(bodies.velocity, moved / 0.01, rtol=1e-12)
    np.testing.assert_allclose([bodies.angle[0], bodies.spin[0] * 0.01], -MAX_ROTATION, rtol=1e-12)


@pytest.mark.parametrize("precision", ["double", "single"])
def test_soft_steps_leave_no_velocity_beyond_the_largest(precision):
    # A bounce is given after the last small step: off a heavy circle at 190 m/s a light one would part at 380 m/s.
    bodies = make_bodies([[10.0, 15.0], [12.0, 15.0]], velocity=[[190.0, 0.0], [0.0, 0.0]], mass=[1e3, 1.0])
    scene = State(name="bounce", world=World(gravity=(0, 0), restitution=1.0), bodies=bodies)
    after = dc.step(scene, solver=dc.SoftSteps(precision=precision)).bodies
    # Cut in the precision of the sweeps: 24 bits.
    np.testing.assert_allclose(after.velocity[1], [MAX_TRANSLATION / scene.dt, 0.0], rtol=1e-6)


def test_the_options_of_soft_steps_say_what_a_step_costs():
    solver = dc.SoftSteps(substeps=3)
    assert (solver.sweeps, solver.position_sweeps, solver.tolerance) == (6, 0, None)
    assert dc.simulate(dc.column(2), steps=1, solver=solver).sweeps[0] == 6


def test_solving_softly_leaves_the_state_alone(falling_states):
    state = falling_states[5]
    before = [field.copy() for part in (state.bodies, state.contacts) for field in part]
    solution = dc.solve_contacts(state, solver=dc.SoftSteps(), start=Builtin()(state, None))
    assert np.abs(solution.velocities - state.bodies.velocity).max() > 0
    for one, other in zip(before, [field for part in (state.bodies, state.contacts) for field in part]):
        np.testing.assert_array_equal(one, other)


def test_description_tells_what_differs():
    assert describe(dc.NNCG(sweeps=20, tolerance=None)) == "NNCG(sweeps=20, tolerance=None)"


@pytest.mark.parametrize(
    ("method", "options", "message"),
    [
        (dc.PSOR, {"omega": 2.0}, "omega: expected a number above 0, below 2, got 2.0"),
        (dc.PSOR, {"omega": 0}, "omega: expected a number above 0, below 2, got 0"),
        (dc.PSOR, {"friction_omega": 2}, "friction_omega: expected a number above 0, below 2, got 2"),
        (dc.PSOR, {"friction_omega": 1, "adaptive": True}, "friction_omega: expected None with adaptive=True, got 1"),
        (dc.PSOR, {"adaptive": "yes"}, "adaptive: expected True or False, got 'yes'"),
        (dc.NNCG, {"precision": "half"}, "precision: expected one of double, single, got 'half'"),
        (dc.APGD, {"sweeps": -1}, "sweeps: expected an integer >= 0, got -1"),
        (dc.SoftSteps, {"substeps": 0}, "substeps: expected an integer >= 1, got 0"),
        (dc.SoftSteps, {"hertz": float("inf")}, "hertz: expected a finite number > 0, got inf"),
    ],
)
def test_methods_refuse_bad_options(method, options, message):
    with pytest.raises(ValueError, match=message):
        method(**options)
