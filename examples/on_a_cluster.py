"""Spread the runs of a comparison over a cluster of Dask; --engine ray does it on one of Ray.

The cluster of two workers here is on this machine; with the address of another it is the same
command. Its workers must see the folder of the results. Run: python examples/on_a_cluster.py
"""

import argparse
import tempfile

from dask.distributed import LocalCluster

from baselines.cli import main as bnprl

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", default="20000")
    options = parser.parse_args()
    out = tempfile.mkdtemp()
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        agents = ["--agents", "online-em", "batch-em", "random", "--seeds", "2"]
        budget = ["--episodes", options.episodes, "--eval-episodes", "500", "--out", out]
        workers = ["--engine", "dask", "--address", cluster.scheduler_address]
        bnprl(["compare", "bnprl/Hallway-v0", *agents, *budget, *workers])
    bnprl(["status", out])
