"""A program as users write it, for strict type checkers: `mypy --strict` and pyright find nothing in it."""

import numpy as np

import deep_contact as dc
from deep_contact import PGS, Simulation, State, World, make_bodies
from deep_contact.cnn import CHANNELS, ImageSpec, LearnedModel
from deep_contact.sph import Grid


def scene(count: int = 5, *, friction: float = 0.3) -> State:
    segments = np.array([[[0.0, 2.0], [4.0, 1.0]]])
    world = World(box=(0, 0, 10, 10), friction=friction, segments=segments, surface_speeds=[0.5])
    x = np.linspace(1.0, 9.0, count)
    return State(name="mine", world=world, bodies=make_bodies(np.column_stack([x, np.full(count, 5.0)]), radius=0.5))


def silo() -> State:
    rough = [[0.4, 0.0], [0.0, 0.4]]
    walls = World(
        friction=np.array(rough),
        restitution=0.1,
        rolling_friction=[[0.05, 0.0], [0.0, 0.0]],
        touches=[[True, True], [True, False]],
        wall_materials=[0, 1, 0, 1],
        segments=[((0, 6), (10, 6))],
        segment_materials=(1,),
    )
    grains = make_bodies([[3.0, 9.0], [6.0, 9.0]], radius=[0.4, 0.5], material=[0, 1], fixed=[False, True])
    return State(name="silo", world=walls, bodies=grains)


def watch(state: State, record: object) -> None:
    print(state.time, record)


def costs(state: State) -> None:
    dc.measure_trade(state, seeds=2).plot().savefig("trade.pdf")


run: Simulation = dc.simulate(scene(), steps=50, solver=PGS(sweeps=20), record=10, forces=True, on_step=watch)
state = run.state
floor = run.force_on("floor") + run.force_on("segment", 0)
heights = [float(one.bodies.position[:, 1].max()) for one in run.trajectory]
print(floor.mean(), heights, dc.forces(state).walls["left"], dc.stress(state).shape, dc.neighbours(state, 0))
model: LearnedModel = dc.load_model()
normal, tangent = model.predict(state)
pairs = model.predict([state, state])
print(len(pairs), ImageSpec().spacing, CHANNELS, model.network, model.card["architecture"])
for start in ("none", "builtin", None, (normal, tangent), dc.warm_start.Sph(spacing=0.5), model):
    solution = dc.solve_contacts(state, solver=dc.NNCG(sweeps=20), start=start)
    print(solution.record.status, solution.normal_impulses.sum() + solution.record.theta[-1])
live = dc.Simulator(state, accuracy="fast")
live.set(gravity=(0.0, -1.62), segment_velocities=[((0.0, 0.1), (0.0, 0.1))])
live.step(10)
seen = dc.Simulator(state, forces=True, on_step=watch)
seen.step(5)
print(seen.force_on("floor") + seen.force_on("circle", [0, 1]), dc.forces(seen.solved).torque)
turned = dc.Simulator(silo(), on_step=lambda state, record: print(state.solved, record.shifts))
turned.set(fixed_velocities=(0.1, 0.0), fixed_spins=1.0, rolling_friction=0.02, push=np.zeros((2, 2)))
turned.step()
solved: State = turned.solved
print(solved == turned.solved, solved in [turned.solved], solved.bodies.material, silo().world.materials)
table: dict[str, np.ndarray] = solved.bodies.table()
print(table["material"], run.trajectory.table()["time"], dc.contact_table(solved)["b"], run.trajectory.dissipated.sum())
added = live.add(dc.make_bodies([[5.0, 9.0]], radius=0.2))
print(
    live.positions[added],
    live.remove(np.array([0])),
    run.force_on("circle", np.array([0, 1])),
    dc.plan(state),
    dc.recommend(state, budget_ms=1.0).solver,
)
runs = dc.simulate_many([scene(n) for n in (3, 4)], steps=10, accuracy="balanced")
studied = dc.experiments.paired([state], {"builtin": dc.warm_start.Builtin()}, sweeps=10)
print(dc.sph.density(Grid.over_box((0, 0, 10, 10), 0.5), state.bodies.position, h=0.5).sum(), len(runs), studied)
dc.write_state("mine.xml", dc.read_state(dc.sample_file()).replace(contacts=None, world=dc.World(scales=dc.BOX2D)))
figure, ax = dc.plotting.subplots()
with dc.plotting.style():
    dc.plotting.draw_state(ax, state)
dc.plotting.save(figure, "mine.png")
