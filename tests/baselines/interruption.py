"""A comparison that is killed and begun again must end like one that was left alone.

`python -m tests.baselines.interruption --steps 8000 --seeds 2` shows it on the showcase of the
README, Stable-Baselines3 included, with one job and with two, each killed several times at random
moments; it exits 1 where a summary differs.
"""

from __future__ import annotations

import argparse
import json
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from baselines.records import read_records

ROOT = Path(__file__).parents[2]
AGENTS = ("online-em", "batch-em", "recurrent-ppo", "ppo", "random")


def command(*arguments: str, **options: Any) -> subprocess.Popen[str]:
    """Start the command in a process of its own."""
    return subprocess.Popen(
        [sys.executable, "-m", "baselines.cli", *arguments],
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        **options,
    )


def summary(out: Path) -> dict[str, Any]:
    """The summary without wall-clock."""
    found: dict[str, Any] = json.loads((out / "summary.json").read_bytes())
    for row in found["rows"]:
        del row["train_seconds"]
    return found


def lines(out: Path) -> dict[str, int]:
    """Complete lines of each run so far."""
    found = sorted((out / "runs").glob("*/*.jsonl"))
    return {str(path.relative_to(out)): len(read_records(path).lines) for path in found}


def finish(arguments: Sequence[str], timeout: float) -> None:
    """Run the command to its end."""
    process = command(*arguments)
    try:
        shown = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        process.kill()
        raise
    assert process.returncode == 0, shown


def kill_after(arguments: Sequence[str], out: Path, n_lines: int, timeout: float) -> int:
    """Kill the command once it has written so many lines; return how many there are then."""
    process = command(*arguments)
    deadline = time.monotonic() + timeout
    while sum(lines(out).values()) < n_lines and time.monotonic() < deadline:
        time.sleep(0.01)
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    return sum(lines(out).values())


def kill_at(arguments: Sequence[str], seconds: float) -> None:
    """Kill the command after some time, unless it ends before."""
    process = command(*arguments)
    try:
        process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()


def main() -> int:
    """Show it once; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--id", default="bnprl/Hallway-v0")
    parser.add_argument("--agents", nargs="+", default=AGENTS)
    parser.add_argument("--steps", default="8000")
    parser.add_argument("--seeds", default="2")
    parser.add_argument("--eval-episodes", default="200")
    parser.add_argument("--kills", type=int, default=5, help="of each command")
    parser.add_argument("--timeout", type=float, default=3600.0, help="seconds of each command")
    options = parser.parse_args()
    compare = ["compare", options.id, "--agents", *options.agents, "--steps", options.steps]
    compare += ["--seeds", options.seeds, "--eval-episodes", options.eval_episodes]
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        whole, begin = Path(folder) / "whole", time.monotonic()
        finish([*compare, "--no-progress", "--jobs", "1", "--out", str(whole)], options.timeout)
        wanted, taken = summary(whole), time.monotonic() - begin
        print(f"uninterrupted: {sum(lines(whole).values())} lines, {taken:.1f} s", flush=True)
        alike = []
        for jobs in ("1", "2"):
            out = Path(folder) / f"killed-{jobs}"
            arguments = [*compare, "--no-progress", "--jobs", jobs, "--out", str(out)]
            for seconds in rng.uniform(0.0, taken / int(jobs) / 2.0, options.kills):
                kill_at(arguments, seconds)
                print(f"--jobs {jobs}: after {seconds:.1f} s {sum(lines(out).values())} lines")
            finish(arguments, options.timeout)
            alike.append(summary(out) == wanted)
            print(f"--jobs {jobs}: alike: {alike[-1]}", flush=True)
    return 0 if all(alike) else 1


if __name__ == "__main__":
    sys.exit(main())
