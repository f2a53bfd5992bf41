"""What does a setting make of a hopper's discharge?

For users of granular media: a setting is a solver with its options. The number that counts here is the discharge: how
many circles a second fall through the hole. The trade is the cost of each setting against its error of this number,
measured on this hopper. `trade.choose` returns the solver of the cheapest setting whose error is within a tolerance.
"""

import deep_contact as dc


def scene(seed):
    return dc.hopper(120, opening=10.0, seed=seed)


foot = min(y for segment in scene(0).world.segments for y in segment[1::2])


def through(state):
    return (state.bodies.position[:, 1] < foot).sum()


trade = dc.measure_trade(scene, steps=400, seeds=4, quantities={"through": through})
print(trade)
print(trade.choose(through=0.25))
dc.plotting.save(trade.plot(), "hopper_trade.png")

rates = {name: runs[:, -1] / 4.0 for name, runs in trade.values("through").items()}
figure, ax = dc.plotting.subplots(size=(8.3, 4.0))
for k, rate in enumerate(rates.values()):
    ax.errorbar(
        rate.mean(),
        k,
        xerr=rate.std() / len(rate) ** 0.5,
        marker="o",
        color=dc.plotting.BLUE,
    )
ax.set_yticks(range(len(rates)), list(rates), fontsize=7)
dc.plotting.label_axes(
    ax, "discharge", "", x_unit="circles a second, with its standard error"
)
dc.plotting.save(figure, "discharge.png")
