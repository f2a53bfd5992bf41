"""python scripts/table_6_3_runtimes.py: what runs the far-field network fastest, and what the rest of a start takes."""

from itertools import product

from deep_contact.reporting import figures
from deep_contact.reporting.figures import Claim, Figure
from deep_contact.studies.learned_starts import RUNTIMES, times_in_process

NETWORKS = ("model.h5",)

LIMIT = 500.0
"""μs that a start may take for 100 circles on one core."""


def compute(options, seed, jobs, progress):
    """One number of threads and circles after the other: nothing may run beside what is timed."""
    found = [
        times_in_process({**options, "threads": threads, "count": circles, "seed": seed})
        for threads, circles in progress(list(product(options["threads"], options["circles"])), text="windows")
    ]
    return {name: [row for one in found for row in one[name]] for name in ("times", "stages")}


def of_shipped(data):
    """The rows of networks that are still shipped."""
    return {name: [row for row in data[name] if row["network"] in NETWORKS] for name in ("times", "stages")}


def claims(data):
    data = of_shipped(data)
    times = {(t["network"], t["circles"], t["threads"], t["batch"], t["runtime"]): t["us"] for t in data["times"]}
    cases = list(dict.fromkeys(key[:-1] for key in times))
    gain = {key: min(times[*key, name] for name in RUNTIMES[1:]) / times[*key, RUNTIMES[0]] for key in cases}
    on_one = {f"{key[0]}, {key[1]} circles": value for key, value in gain.items() if key[2:] == (1, 1)}
    text = "for one scene on one thread the convolution in Numba is faster than TensorFlow's best"
    yield Claim(text, None, min(on_one.values()) > 1, on_one)
    least = min(gain, key=gain.get)
    measured = {"least": "{}, {} circles, {} threads, batch of {}".format(*least), "gain": gain[least]}
    yield Claim("batches and a second thread do not change that", None, gain[least] > 1, measured)
    smallest = min(stage["circles"] for stage in data["stages"])
    starts = {f"{one['network']}, μs": one["all"] for one in data["stages"] if one["circles"] == smallest}
    text = f"image, network and reading back take at most {LIMIT / 1000:g} ms for {smallest} circles on one core"
    yield Claim(text, None, max(starts.values()) <= LIMIT, starts)
    prices = {f"{s['network']}, {s['circles']} circles": s["all"] / s["sweep"] for s in data["stages"]}
    yield Claim("a learned start costs at most 5 sweeps", None, max(prices.values()) <= 5, prices)


def table(data):
    data = of_shipped(data)
    batches = sorted({t["batch"] for t in data["times"]})
    many = [f"{name}, {b} at once" if b > 1 else name for name in RUNTIMES for b in batches]
    rows = [["network", "circles", "threads", *many, "image", "reading back", "start", "start in sweeps"]]
    found: dict = {}
    for t in data["times"]:
        found.setdefault((t["network"], t["circles"], t["threads"]), {})[t["runtime"], t["batch"]] = t["us"]
    stages = {(stage["network"], stage["circles"], stage["threads"]): stage for stage in data["stages"]}
    for key, us in found.items():
        parts = [None] * 4
        if key in stages:
            stage = stages[key]
            parts = [stage["image"], stage["read"], stage["all"], stage["all"] / stage["sweep"]]
        rows.append([*key, *(us[name, b] for name in RUNTIMES for b in batches), *parts])
    return rows


OPTIONS = {
    "models": [f"models/{name}" for name in NETWORKS], "circles": [100, 1000, 10000], "threads": [1, 2],
    "batches": [1, 8], "repeats": 40,
}  # fmt: skip
QUICK = {"circles": [100], "threads": [1], "batches": [1]}
FIGURE = Figure("T 6.3", "Runtimes of the far-field network, μs a scene", compute, table, claims=claims,
                options=OPTIONS, quick=QUICK, digits=4)  # fmt: skip

if __name__ == "__main__":
    raise SystemExit(figures.main(FIGURE))
