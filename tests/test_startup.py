"""Importing the environments imports nothing heavy; `baselines.benchmarks.startup` times it."""

from __future__ import annotations

import subprocess
import sys

from tests.baselines.interruption import ROOT

HEAVY = ("torch", "stable_baselines3", "numba", "matplotlib", "scipy.stats", "bnprl_agents")


def test_importing_the_environments_imports_nothing_heavy() -> None:
    code = f"import sys, bnprl_envs; assert not set({HEAVY}) & sys.modules.keys()"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)
