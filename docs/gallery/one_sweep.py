"""When is one sweep enough?

For those who care for speed: in a thin gas circles meet in pairs, and one sweep solves a pair. In a pile each circle
has several contacts, and one sweep does not solve them together. The trades of both scenes show this. Ten sweeps leave
no smaller errors than one sweep in the gas, and much smaller errors in the pile.
"""

import deep_contact as dc


def gas(seed):
    return dc.drifting_circles(
        100, size=80.0, sigma_coef=2.0, speed=5.0, restitution=0.9, seed=seed
    )


def pile(seed):
    return dc.lattice_in_box(100, seed=seed)


one, ten = (dc.PGS(sweeps=k, tolerance=None) for k in (1, 10))
for make in (gas, pile):
    trade = dc.measure_trade(make, steps=300, seeds=4, settings=[one, ten])
    print(trade)
    errors = {row["setting"]["sweeps"]: row["errors"] for row in trade.rows}
    for name in ("energy", "penetration_max"):
        print(
            f"{make.__name__}, {name}: one sweep {errors[1][name][0]:.3g} %, ten {errors[10][name][0]:.3g} %"
        )
    dc.plotting.save(trade.plot(), f"one_sweep_{make.__name__}.png")
