"""Every example runs, at a small size, and shows what it promises."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.baselines.interruption import ROOT

EXAMPLES = {
    "train_and_watch": (["--episodes", "300"], "discounted return"),
    "my_pomdp_file": (["--steps", "3000"], "best memoryless"),
    "my_gymnasium_env": (["--steps", "2100"], "ppo"),
    "team": (["--steps", "2000000"], "exact value: "),
    "my_agent": (["--steps", "2100"], "Sarsa"),
    "on_a_cluster": (["--episodes", "300"], "online-em/1"),
}


def test_every_example_is_here() -> None:
    assert {path.stem for path in (ROOT / "examples").glob("*.py")} == EXAMPLES.keys()


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_runs(name: str) -> None:
    small, promised = EXAMPLES[name]
    done = subprocess.run(
        [sys.executable, f"examples/{name}.py", *small],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert promised in done.stdout
    assert "Traceback" not in done.stderr
    assert "Warning" not in done.stderr
