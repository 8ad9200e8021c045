"""The same summary from a cluster as from one process, also when a worker of it is killed."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from baselines.cli import main
from tests.baselines.interruption import ROOT, command, lines, summary

COMPARE = ["compare", "bnprl/Hallway-v0", "--agents", "online-em", "random", "--seeds", "2"]
BUDGET = ["--episodes", "2000", "--eval-episodes", "100", "--eval-points", "4", "--no-progress"]
PATIENCE = 400.0
"""Seconds for a cluster to begin, and to end, on a busy machine."""
ENVIRONMENT = os.environ | {
    "PYTHONPATH": str(ROOT),
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "1",
    "RAY_USAGE_STATS_ENABLED": "0",
}


@contextlib.contextmanager
def dask_cluster(folder: Path) -> Iterator[str]:
    """Start a scheduler and two workers."""
    module = [sys.executable, "-m", "distributed.cli.dask_scheduler"]
    address = folder / "scheduler.json"
    options: dict[str, Any] = {
        "cwd": folder,
        "env": ENVIRONMENT,
        "stdout": subprocess.DEVNULL,
        "stderr": subprocess.DEVNULL,
    }
    file = ["--scheduler-file", str(address)]
    scheduler = [*module, "--host", "127.0.0.1", "--port", "0", "--no-dashboard", *file]
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", *file, "--no-dashboard"]
    worker += ["--nworkers", "2", "--nthreads", "1", "--host", "127.0.0.1"]
    started = [subprocess.Popen(scheduler, **options), subprocess.Popen(worker, **options)]
    try:
        while not address.exists() or "}" not in address.read_text():
            time.sleep(0.1)
        yield str(json.loads(address.read_text())["address"])
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait(timeout=30)


@contextlib.contextmanager
def ray_cluster(folder: Path) -> Iterator[str]:
    """Start a head node for two workers."""
    ray = [sys.executable, "-m", "ray.scripts.scripts"]
    port = "26379"
    start = [*ray, "start", "--head", "--num-cpus", "2", "--port", port, "--temp-dir", str(folder)]
    start += ["--include-dashboard", "false", "--node-ip-address", "127.0.0.1"]
    subprocess.run(start, env=ENVIRONMENT, check=True, capture_output=True)
    try:
        yield f"127.0.0.1:{port}"
    finally:
        subprocess.run([*ray, "stop", "--force"], check=True, capture_output=True)


CLUSTERS: dict[str, Any] = {"dask": dask_cluster, "ray": ray_cluster}
WORKER = {"dask": b"from multiprocessing.spawn", "ray": b"ray::PoolActor"}
"""What the command line of a worker that runs something begins with or holds."""


def workers(engine: str) -> list[int]:
    """Process numbers of the cluster's workers."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            if WORKER[engine] in path.read_bytes():
                found.append(int(path.parent.name))
    return found


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    out = tmp_path_factory.mktemp("alone") / "out"
    assert main([*COMPARE, *BUDGET, "--jobs", "1", "--out", str(out)]) == 0
    return summary(out)


@pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="finds workers in /proc")
@pytest.mark.parametrize("engine", ["dask", "ray"])
def test_a_killed_worker_loses_no_run(engine: str, tmp_path: Path, alone: dict[str, Any]) -> None:
    if importlib.util.find_spec(engine) is None:
        pytest.skip(f"{engine} is not installed")
    out, there = tmp_path / "out", Path("/tmp") / f"bnprl-{engine}-{os.getpid()}"
    there.mkdir()  # the sockets of Ray want short names
    with CLUSTERS[engine](there) as address:
        run = [*COMPARE, *BUDGET, "--engine", engine, "--address", address, "--out", str(out)]
        process = command(*run, env=ENVIRONMENT)
        try:
            deadline = time.monotonic() + PATIENCE
            while not any(lines(out).values()):
                assert process.poll() is None, process.communicate()
                assert time.monotonic() < deadline
                time.sleep(0.01)
            os.kill(workers(engine)[0], signal.SIGKILL)
            shown = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
            process.communicate()
    assert process.returncode == 0, shown
    assert summary(out) == alone
