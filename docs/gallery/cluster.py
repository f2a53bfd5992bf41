"""Spread scenes over a cluster.

For many runs: `jobs=` takes Dask's executor in place of a number of processes. The workers here are two processes of
this machine. The program kills one of the workers. Dask then gives the scenes of that worker to the other worker, and
no bit of the results changes. To use a cluster of many machines, pass the address of its scheduler to `Client(…)`.
"""

import os
import signal

import numpy as np
from distributed import Client, LocalCluster

import deep_contact as dc

if __name__ == "__main__":
    scenes = [dc.lattice_in_box(40, gap=0.05, seed=seed) for seed in range(60)]

    # Each worker has one thread, since one thread does the steps of a scene. The workers are processes. They share
    # nothing, so no worker waits for another.
    with (
        LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None
        ) as cluster,
        Client(cluster) as client,
    ):
        executor = client.get_executor(pure=False)
        first = client.run(os.getpid).values()
        os.kill(next(iter(first)), signal.SIGKILL)
        runs = dc.simulate_many(scenes, steps=300, jobs=executor)

    alone = dc.simulate_many(scenes, steps=300)
    same = sum(a.state == b.state for a, b in zip(alone, runs))
    heights = [run.state.bodies.position[:, 1].max() for run in runs]
    print(f"{same} of {len(scenes)} scenes end in the same bits as without a cluster")
    print(f"heights of the piles: {np.mean(heights):.2f} ± {np.std(heights):.2f} m")
