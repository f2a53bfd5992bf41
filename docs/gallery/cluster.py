"""Run a study on a cluster.

For cluster users: what takes `jobs` takes a number of local processes or the workers of a Dask cluster, and the
numbers are the same bits. Here the cluster is one of two workers on this machine; yours has an address of its own.
Dask comes with the extra `cluster`: `python -m pip install ".[cluster]"`.
"""

import numpy as np
from dask.distributed import LocalCluster

import deep_contact as dc
from deep_contact import parallel

STUDY = {"n_bodies": 30, "size": 18.0, "steps": 100, "sweeps": 300, "scenes": 2}


def main():
    """Compare two starts on two scenes, here and on the cluster."""
    starts = {"none": "none", "builtin": "builtin"}
    here = dc.experiments.compare_starts(starts, jobs=1, **STUDY)
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None
    ) as machines:
        with parallel.cluster(machines.scheduler_address) as workers:
            there = dc.experiments.compare_starts(starts, jobs=workers, **STUDY)
    for name, found in there["paired"].items():
        print(f"{name}: mean sweeps {found['sweeps']['mean']:.1f}")
        assert np.array_equal(found["theta"], here["paired"][name]["theta"])
    print("the same bits as in this process")


if __name__ == "__main__":
    main()
