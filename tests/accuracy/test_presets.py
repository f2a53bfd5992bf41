"""Presets and recommendations for runs: what they choose from a study, how they scale, what they say."""

import math
import re
import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from conftest import circles_at, load_script

import deep_contact as dc
from deep_contact.accuracy import presets
from deep_contact.accuracy.presets import PRESETS
from deep_contact.accuracy.scene_numbers import scene_numbers
from deep_contact.accuracy.stiffness import stiffness
from deep_contact.figures import results
from deep_contact.io.simulation_h5 import read_simulation, write_simulation
from deep_contact.run.method import method_of
from deep_contact.studies import runs
from deep_contact.studies.runs import KINDS, dam_break, two_densities


def entry(name, dt, us, share, of="fast", **options):
    """A setting whose errors are `share` of the tolerances of the preset `of`, at 100 and 1,000 circles."""
    errors = {error: share * most for error, most in PRESETS[of].items()}
    times = {"100": {"plain": us}, "1000": {"plain": 10 * us}}
    by_size = {size: {"plain": errors} for size in times}
    return {"name": name, "options": options, "dt": dt, "us": times, "errors": by_size}


TABLE = {
    "cpu": "a processor",
    "sizes": [100, 1000],
    "kinds": {"plain": [100, 1000]},
    "settings": [
        entry("few", 0.01, 10.0, 0.8, of="preview", method="PGS", sweeps=2, tolerance=None),
        entry("enough", 0.01, 20.0, 0.8, method="PGS", sweeps=9, tolerance=None),
        entry("small", 0.0025, 50.0, 0.01, method="PSOR", omega=1.3, sweeps=2, tolerance=None, start="none"),
    ],
}


@pytest.fixture
def study(monkeypatch):
    monkeypatch.setattr(presets, "installed", lambda: TABLE)
    monkeypatch.setattr(presets, "_chosen", presets._chosen.__wrapped__)


def test_the_cheapest_setting_that_keeps_the_preset_is_chosen(study):
    scene = dc.circles_in_box(100)
    assert dc.recommend(scene).solver == dc.PGS(sweeps=9, tolerance=None)
    assert dc.recommend(scene, accuracy="preview").solver == dc.PGS(sweeps=2, tolerance=None)
    assert dc.recommend(scene, accuracy="fast").us == 20.0
    found = dc.recommend(scene, accuracy="reference")
    assert found.solver == dc.PSOR(omega=1.3, sweeps=2, tolerance=None, substeps=4)
    assert (found.warm_start, found.reached, found.accuracy) == ("none", True, "reference")
    np.testing.assert_allclose(found.us, 50.0)


def test_a_margin_costs_at_most_twice():
    costs_and_errors = (1.0, 8.6), (2.0, 8.5), (2.1, 1.0)
    near, safe, dear = ({"us": us, "errors": {"energy": error}} for us, error in costs_and_errors)
    for settings, best in (([near, safe, dear], safe), ([near, dear], near), ([dear], dear)):
        assert presets.cheapest(settings, {"energy": 10.0}) is best
    assert presets.keeping([near, safe, dear], {"energy": 10.0}, margin=False) == [near, safe, dear]


def test_a_simulation_without_a_solver_takes_fast(study):
    scene = dc.circles_in_box(40, seed=1)
    run = dc.simulate(scene, steps=60)
    by_hand = dc.simulate(scene, steps=60, solver=dc.PGS(sweeps=9, tolerance=None))
    assert run.state.solver == by_hand.state.solver
    np.testing.assert_array_equal(run.state.bodies.position, by_hand.state.bodies.position)
    assert dc.simulate(scene, steps=1, accuracy="fast").state.solver == run.state.solver
    assert type(dc.simulate(by_hand.state.replace(solver=dc.NNCG()), steps=1).state.solver) is dc.NNCG


def test_a_preset_takes_its_start_and_the_default_keeps_the_one_that_was_given(study):
    scene = dc.circles_in_box(40, seed=1)
    started = []
    dc.simulate(dc.simulate(scene, steps=100).state.replace(solver=None), steps=1, accuracy="reference",
                on_step=lambda state, _: started.append(state.contacts.normal_start.sum()))  # fmt: skip
    assert started[0] == 0
    run = dc.simulate(scene, steps=80, warm_start=None)
    by_hand = dc.simulate(scene, steps=80, warm_start=None, solver=dc.PGS(sweeps=9, tolerance=None))
    np.testing.assert_array_equal(run.state.bodies.position, by_hand.state.bodies.position)


@pytest.mark.parametrize(
    ("radius", "dt", "expected"), [(1.0, 0.01, 1), (1.0, 0.04, 4), (1e-3, 0.01, 32), (1e-3, 0.1, 512), (4, 0.01, 1)]
)
def test_steps_too_long_for_the_circles_are_divided(study, radius, dt, expected):
    scene = dc.lattice_in_box(100, radius=(radius, radius)).replace(dt=dt)
    solver = dc.recommend(scene).solver
    assert solver.substeps == expected
    # What counts is Δt √(g / r), which is to be at most that of the study.
    assert dt / solver.substeps * math.sqrt(1 / radius) <= 0.01 * (1 + 1e-9)
    assert expected == 1 or dt / solver.substeps * math.sqrt(1 / radius) > 0.005


def test_fast_circles_get_short_steps_without_gravity(study):
    slow, quick = (dc.drifting_circles(50, speed=speed, seed=1) for speed in (1.0, 300.0))
    assert dc.recommend(slow).solver.substeps == 1
    assert dc.recommend(quick).solver.substeps > 1
    reckless = dc.recommend(dc.drifting_circles(50, speed=1e6, seed=1))
    assert reckless.solver.substeps == presets.MOST_SUBSTEPS
    assert "dt = 0.01 s: circles of" in str(reckless)
    still = dc.circles_in_box(20, gravity=(0, 0))
    assert dc.recommend(still).solver.substeps == 1


@pytest.mark.parametrize("speed", [3.0, -3.0, 300.0, -300.0])
def test_what_a_fast_surface_drags_gets_short_steps_whichever_way_it_moves(study, speed):
    belt = {"segments": [((5.0, 5.0), (9.0, 5.0))], "surface_speeds": [speed]}
    scene = circles_at([[7.0, 6.0]], gravity=(0, 0), **belt)
    # Δt |v| / r as of circles at `FASTEST` √(g r) in steps of 10 ms.
    needed = abs(speed) / (presets.FASTEST * math.sqrt(9.81))
    assert dc.recommend(scene).solver.substeps == 2 ** max(0, math.ceil(math.log2(needed)))


def test_a_step_that_is_hardly_longer_than_the_studys_is_not_divided(study):
    # The mean of radii drawn around 1 m is not 1 m.
    circle = dc.single_body()
    times = {0.1: 1, 1.0: 1, 1.04: 1, 1.06: 2, 2.09: 2, 2.2: 4, 1e5: 1024}
    assert {ratio: presets.parts_for(scene_numbers(circle.replace(dt=0.01 * ratio)), 0.01) for ratio in times} == times
    scene = dc.lattice_in_box(100, radius=(0.97, 0.97))
    assert dc.recommend(scene).solver.substeps == 1


def test_a_projectile_gets_steps_as_short_as_each_preset_needs(study):
    # At 64 substeps at most, presets of shorter steps took the run of the others.
    scene = dc.circles_in_box(100, seed=1)
    velocity = scene.bodies.velocity.copy()
    velocity[0] = (300.0, 0.0)
    scene = scene.replace(bodies=scene.bodies._replace(velocity=velocity))
    fast, reference = (dc.recommend(scene, accuracy=name).solver.substeps for name in ("fast", "reference"))
    assert (fast, reference) == (16, 64)


def test_what_a_preset_cannot_keep_is_said_once_with_what_to_do(study):
    small = dc.lattice_in_box(10, radius=(1e-3, 1e-3)).replace(dt=1.0)
    (text,) = presets.decide(small, None).warnings
    assert "dt = 1 s: circles of 0.001 m at up to 0 m/s need" in text
    least = float(text.split("give a dt of at most ")[1].split(" s")[0])
    assert not presets.decide(small.replace(dt=least), None).warnings


def test_a_warning_names_the_line_of_the_user_and_a_loop_says_it_once(study):
    scene = dc.lattice_in_box(10, radius=(1e-3, 1e-3)).replace(dt=1.0)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("default")
        for _ in range(3):
            dc.simulate(scene, steps=1, accuracy="fast")
    assert [one.filename for one in said] == [__file__]


def test_a_budget_buys_the_most_accurate_setting(study):
    scene = dc.circles_in_box(100)
    assert dc.recommend(scene, budget_ms=0.025).solver == dc.PGS(sweeps=9, tolerance=None)
    assert dc.recommend(scene, budget_ms=1).accuracy == "reference"
    with pytest.raises(ValueError, match="budget_ms: expected"):
        dc.recommend(scene, budget_ms=0.001)


def test_an_error_as_large_as_its_tolerance_keeps_it(monkeypatch):
    exact = entry("exact", 0.01, 20.0, 1.0, method="PGS", sweeps=9, tolerance=None)
    monkeypatch.setattr(presets, "installed", lambda: TABLE | {"settings": [exact]})
    assert dc.recommend(dc.circles_in_box(100), budget_ms=1).accuracy == "fast"


def test_times_follow_the_number_of_circles_by_powers():
    assert presets._us_at(1000, {100: 10.0, 1000: 100.0}) == pytest.approx(100)
    assert presets._us_at(316, {100: 10.0, 1000: 100.0}) == pytest.approx(31.6)
    assert presets._us_at(10_000, {100: 10.0, 1000: 100.0}) == pytest.approx(1000)
    assert presets._us_at(3, {100: 10.0, 1000: 100.0}) == pytest.approx(10)


def test_a_preset_out_of_reach_is_said(study, monkeypatch):
    monkeypatch.setitem(PRESETS, "reference", PRESETS["reference"] | {"energy": 1e-3})
    scene = dc.circles_in_box(30)
    found = dc.recommend(scene, accuracy="reference")
    assert not found.reached
    assert "no setting of the study keeps all tolerances" in str(found)
    with pytest.warns(
        presets.PresetWarning, match="accuracy='reference': no setting of the study keeps its tolerances for 30"
    ):
        dc.simulate(scene, steps=1, accuracy="reference")


@pytest.mark.parametrize(
    ("scene", "said"),
    [
        (dc.circles_in_box(4, friction=5.0), ()),
        (dc.circles_in_box(50, friction=1.0), ()),
        (dc.lattice_in_box(100, radius=(0.15, 1.5), restitution=0.6), ()),
        (dc.hopper(100), ()),
        (
            dc.circles_in_box(50, friction=5.0, restitution=0.95),
            ("friction 5: .* up to 1;", r"restitution 0\.95: .* up to 0\.9;"),
        ),
        (dc.hopper(100, radius=(0.2, 1.0)), (r"radii that differ [345]\.?\d* times, .* up to 1\.3;",)),
    ],
)
def test_a_named_preset_says_which_quantities_nobody_checked(scene, said):
    """Once, with what to do; the default promises nothing, and a scene that was checked gets no sentence."""
    found = presets.decide(scene, "balanced").warnings
    assert len(found) == bool(said)
    for pattern in said:
        assert re.search(rf"^accuracy='balanced': .*{pattern}.*measure_trade", found[0])
    assert presets.decide(scene, None).warnings == ()
    assert dc.plan(scene, accuracy="balanced").warnings == found
    assert ("warning: " in str(dc.plan(scene, accuracy="balanced"))) == bool(said)


def test_no_scene_of_the_check_outside_of_the_study_has_a_warning():
    verify = load_script("run_tradeoff_verify")
    numbers = {kind: presets.scene_numbers(verify.scene(kind, 100, 0)) for kind in verify.KINDS}
    assert {kind: found for kind, of in numbers.items() if (found := presets.unchecked(of))} == {}


@pytest.mark.parametrize(
    ("scene", "said"),
    [
        (dc.circles_in_box(100), None),
        (dc.circles_in_box(100, radius=(0.4, 1.0)), "100 circles of the kind mixed radii; it has none of about this"),
        (dc.lattice_in_box(200, radius=(0.1, 1.0)), r"radii that differ 9\.\d+ times; it has up to 3"),
        (dc.circles_in_box(50, friction=0.9), r"friction 0\.9; it has 0 and 0\.5"),
        (dc.circles_in_box(50, restitution=0.9), r"restitution 0\.9; it has 0, 0\.3 and 0\.8"),
        (
            dc.circles_in_box(50, friction=[[0.5, 0.1], [0.1, 0.5]], wall_materials=[1] * 4),
            r"friction from 0\.1 to 0\.5 between pairs; it has 0 and 0\.5",
        ),
        (
            dc.circles_in_box(50, restitution=[[0.0, 0.8], [0.8, 0.0]], wall_materials=[0, 1, 0, 1]),
            r"restitution from 0 to 0\.8 between pairs; it has 0, 0\.3 and 0\.8",
        ),
        (dc.circles_in_box(50, rolling_friction=0.2), r"rolling resistance of up to 0\.2 m; it has none"),
        (dc.drifting_circles(50), "50 circles of the kind gas"),
        (dc.column(4), "4 circles; it has 100 to 1,000"),
    ],
)
def test_a_scene_outside_of_the_study_is_called_so(study, scene, said):
    text = str(dc.recommend(scene))
    assert re.search(f"outside of the study: {said}", text) if said else "outside" not in text


def test_what_is_next_is_told(study):
    text = str(dc.recommend(dc.circles_in_box(100)))
    for part in ("fast: PGS(sweeps=9", "20 μs a step of 0.01 s, 100 circles; a processor", "energy 9.6 % (12)",
                 "cheaper: preview, PGS(sweeps=2, tolerance=None), 0.5 times", "better: balanced, "):  # fmt: skip
        assert part in text, part


def test_the_study_in_the_package_keeps_fast_for_the_scenes_of_the_thesis():
    found = dc.recommend(dc.circles_in_box(100, seed=3))
    assert found.reached
    assert all(found.errors[name] <= most for name, most in found.tolerances.items() if name in found.errors)


@pytest.mark.parametrize(
    ("options", "kinds"),
    [
        ({}, {"plain"}),
        ({"radius": (0.5, 1.0)}, {"mixed radii"}),
        ({"friction": 0.1}, {"no friction", "plain"}),
        ({"friction": 0.0}, {"no friction"}),
        ({"restitution": 0.1}, {"plain", "elastic 0.3"}),
        ({"restitution": 0.5}, {"elastic 0.3", "elastic 0.8"}),
        ({"restitution": 0.9, "radius": (0.5, 1.0)}, {"mixed radii", "elastic 0.8"}),
        ({"gravity": (0, 0)}, {"gas"}),
        ({"segments": [((0, 0), (9, 0))], "surface_speeds": (1.0,)}, {"drum"}),
        ({"segments": [((0, 0), (9, 0))]}, {"terrain", "hopper"}),
        ({"segments": [((0, 2), (20, 5)), ((20, 5), (30, 0))]}, {"terrain"}),
        ({"segments": [((0, 0), (9, 0))], "segment_velocities": [((0, 1), (0, 1))]}, {"piston"}),
    ],
)
def test_a_scene_is_like_kinds_of_the_study(options, kinds):
    assert set(presets.kinds_of(scene_numbers(dc.circles_in_box(20, seed=1, **options)))) == kinds
    assert kinds <= KINDS.keys()


@pytest.mark.parametrize(
    ("ratio", "heavy", "kinds"),
    [
        (1.5, "mixed", {"densities 1 : 2"}),
        (2, "above", {"heavy on light 1 : 10"}),
        (3, "mixed", {"densities 1 : 10"}),
        (10, "below", {"light on heavy 1 : 10"}),
        (30, "below", {"densities 1 : 100"}),
        (100, "above", {"heavy on light 1 : 100"}),
    ],
)
def test_two_densities_are_the_next_larger_ratio_of_the_study(ratio, heavy, kinds):
    scene = two_densities(200, ratio=ratio, heavy=heavy, seed=1)
    assert set(presets.kinds_of(scene_numbers(scene))) == kinds
    assert kinds <= KINDS.keys()
    assert stiffness(scene) is None


@pytest.mark.parametrize("n", [100, 1000, 3000, 10_000])
def test_what_a_preset_runs_is_what_the_study_priced(n):
    """Of every kind that the study has, by the shipped table against the study's own choice."""
    scene_of = cache(lambda kind: runs.scene_of_kind(kind, n, 0))
    for row in runs.presets(results.reference("run_tradeoff")["data"]["rows"]):
        for kind, priced in row["kinds"].items() if row["n_bodies"] == n else ():
            found = dc.recommend(scene_of(kind), accuracy=row["preset"])
            assert found.reached == (priced is not None), (kind, row["preset"])
            if kind == "hopper":  # a scene with an opening takes what keeps terrains too
                assert priced is None or found.us >= 0.99 * priced["us"], (kind, row["preset"])
                continue
            assert priced is None or found.us == pytest.approx(priced["us"], rel=0.01), (kind, row["preset"])


@pytest.mark.parametrize(("aspect", "room", "is_dam"), [(2, 4, True), (2, 1.2, False), (6, 3, True)])
def test_what_stands_higher_than_it_can_lie_is_a_dam(aspect, room, is_dam):
    scene = dam_break(300, aspect=aspect, room=room)
    assert ("dam break" in presets.kinds_of(scene_numbers(scene))) == is_dam
    (x_min, y_min, x_max, y_max), position = scene.world.box, scene.bodies.position[:, ::-1].copy()
    aside = replace(scene.world, box=(y_min, x_min, y_max, x_max), gravity=scene.world.gravity[::-1])
    lying = scene.replace(world=aside, bodies=scene.bodies._replace(position=position))
    assert ("dam break" in presets.kinds_of(scene_numbers(lying))) == is_dam


def test_a_run_solved_to_a_tolerance_says_so_once_with_the_price_and_a_plan_prints_it():
    scene = dc.column(120, width=3.0)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("ignore")
        dc.simulate(scene, steps=1)  # a compiler that warns makes Python forget what has been said
        warnings.simplefilter("default")
        for _ in range(2):
            dc.simulate(scene, steps=1)
    (text,) = (str(one.message) for one in said if one.category is presets.PresetWarning)
    most = dc.recommend(scene).us
    assert text.endswith(
        f"120 circles high: solved to a tolerance, which takes up to {most / 1e3:.3g} ms a step of 0.01 s"
    )
    assert f", at most {most:,.0f} μs a step\n" in str(dc.plan(scene))


def test_a_preset_is_chosen_by_errors_and_times_of_the_kinds_that_a_scene_is_like(monkeypatch):
    plain, mixed = dc.circles_in_box(100, seed=1), dc.lattice_in_box(100, seed=1, radius=(0.8, 1.2))
    cheap, dear = (entry(name, 0.01, us, 0.5, method="PGS", sweeps=us) for name, us in (("cheap", 10), ("dear", 20)))
    on_plain = entry("on plain piles alone", 0.01, 1, 0.5, method="PGS", sweeps=30)
    for size in ("100", "1000"):
        for setting, times_worse in ((cheap, 9), (dear, 1)):
            errors = setting["errors"][size]
            errors["mixed radii"] = {name: times_worse * value for name, value in errors["plain"].items()}
            setting["us"][size]["mixed radii"] = 3 * setting["us"][size]["plain"]
    settings = [cheap, dear, on_plain]
    kinds = {"plain": [100, 1000], "mixed radii": [100, 1000]}
    table = {"cpu": "", "sizes": [100, 1000], "kinds": kinds, "settings": settings}
    monkeypatch.setattr(presets, "installed", lambda: table)
    assert dc.recommend(plain).solver.sweeps == 30
    found = dc.recommend(mixed)
    assert (found.solver.sweeps, found.us, found.reached) == (20, 60.0, True)


@pytest.mark.parametrize("accuracy", presets.PRESETS)
def test_a_pile_at_rest_stays_as_it_is(accuracy):
    # Without drift (a tenth of a slop), trembling (a tenth of the speed at which circles fall asleep; half of them: a
    # loose one rolls on), and without a step that takes more substeps than the fewest.
    settled = dc.simulate(dc.circles_in_box(60, seed=7), steps=1500, accuracy=accuracy).state.replace(solver=None)
    run = dc.simulate(settled, steps=20_000, record=500, accuracy=accuracy)
    heights = [state.bodies.position[:, 1].mean() for state in run.trajectory]
    speeds = [np.median(np.hypot(*state.bodies.velocity.T)) for state in run.trajectory]
    assert np.ptp(heights) < 0.1 * settled.scales.slop
    assert max(speeds) < 0.1 * settled.scales.sleep_speed
    assert len(set(run.substeps)) == 1


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("world", [{}, {"gravity": (0, 0)}, {"restitution": 0.5, "segments": [((1, 1), (9, 1))]}])
def test_a_scene_without_circles_warns_of_nothing(world):
    """An empty box, to be poured into, gave 17 warnings a call, and `recommend` ended in NumPy's "zero-size array"."""
    scene = dc.State(name="empty", world=dc.World(**world), bodies=dc.make_bodies(np.zeros((0, 2))))
    assert dc.recommend(scene).outside[0].startswith("0 circles; ")
    assert presets.decide(scene, None).warnings == ()
    run = dc.simulate(scene, steps=2, record=1, forces=True)
    filled = run.state.with_bodies(add=dc.make_bodies([[5.0, 5.0]]))
    assert dc.simulate(filled, steps=1).state.bodies.count == 1
    looks = dc.plan, dc.forces, dc.stress, dc.coordination, dc.contact_table, repr, dc.find_contacts, dc.solve_exactly
    for look in looks:
        look(run.state)
    assert run.trajectory.energies.tolist() == [[0.0, 0.0]] * 3
    dc.plotting.draw_state(dc.plotting.subplots()[1], run.state)


def test_a_stiff_run_that_goes_on_keeps_the_division_of_its_steps():
    bodies = dc.make_bodies([[5.0, 1.0], [5.0, 3.0]], mass=[1.0, 1e3], velocity=[0.0, -800.0])
    scene = dc.State(name="stiff", world=dc.World(), bodies=bodies)
    solver = method_of(scene, accuracy="fast").solver
    slower = bodies._replace(velocity=np.zeros((2, 2)))
    slower = scene.replace(step=3, solver=solver, bodies=slower, preset="fast")
    assert presets.decide(slower, "fast").solver.substeps < solver.substeps
    assert method_of(slower, accuracy="fast").solver == solver


@pytest.mark.parametrize("through", ["memory", "xml", "h5"])
def test_a_run_that_goes_on_under_its_preset_keeps_its_solver(through, tmp_path):
    """At another moment a preset can take another solver: this gas is slower, a dam has broken."""
    scene = dc.drifting_circles(30, size=20.0, speed=5, restitution=0.9)
    later = dc.simulate(scene, steps=37, accuracy="fast").state
    assert presets.decide(later, "fast").solver != later.solver
    if through == "xml":
        dc.write_state(tmp_path / "later.xml", later)
        later = dc.read_state(tmp_path / "later.xml")
    if through == "h5":
        write_simulation(tmp_path / "later.h5", [later])
        later = read_simulation(tmp_path / "later.h5").state(0)
    assert dc.simulate(later, steps=9, accuracy="fast").state == dc.simulate(scene, steps=46, accuracy="fast").state
    assert method_of(later, accuracy="preview").solver == presets.decide(later, "preview").solver
    for change in ({"dt": 0.002}, {"world": replace(later.world, restitution=0.5)}, {"solver": dc.PGS(sweeps=99)}):
        other = later.replace(**change)
        assert method_of(other, accuracy="fast").solver == presets.decide(other, "fast").solver


@pytest.mark.parametrize("field", ["velocity", "position"])
def test_circles_that_were_written_to_are_another_scene_for_a_preset(field):
    """The state keeps its preset, and its load tells that it is not the state to which the run has come."""
    later = dc.simulate(dc.column(3), steps=3, accuracy="fast").state
    before = later.solver
    assert method_of(later, accuracy="fast").solver == before
    getattr(later.bodies, field)[0] += 1e-3
    later.bodies.velocity[:] -= 200.0 * (field == "velocity")
    assert later.preset == "fast"
    now = method_of(later, accuracy="fast").solver
    assert now == method_of(later.replace(solver=None), accuracy="fast").solver
    assert (now.substeps > before.substeps) == (field == "velocity")
    if field == "velocity":
        assert dc.simulate(later, steps=1, accuracy="fast").state.solver == now


def test_a_state_names_the_preset_of_its_own_solver_alone():
    state = dc.simulate(dc.column(3), steps=3, accuracy="fast").state
    assert state.preset == "fast"
    assert dc.simulate(state, steps=2).state.preset == "fast"
    assert dc.simulate(state, steps=2, accuracy="fast").state.preset == "fast"
    assert dc.simulate(state, steps=2, solver=dc.PGS(sweeps=2)).state.preset is None
    assert dc.simulate(state, steps=2, accuracy="preview").state.preset == "preview"
    assert dc.simulate(dc.column(3), steps=2).state.preset is None
