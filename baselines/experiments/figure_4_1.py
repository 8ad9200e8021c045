"""Figure 4.1: value and time of online and batch EM as episodes come in, on five problems.

Protocol A: 5 runs, 251 evaluation episodes of at most 251 steps, 101 and 101 for Hallway and Tag.
"""

from __future__ import annotations

from typing import Any

from baselines.environment import EnvironmentSpec
from baselines.experiment import Entry, Experiment
from baselines.reproduction import RETURN, SECONDS, Comparison, Reproduction, registered
from bnprl_envs.registry import Reference

PROBLEMS: dict[str, tuple[int, int, int, dict[str, Any]]] = {
    "Shuttle": (20, 251, 600, {"reward_shift": 3.0}),
    "CheeseMaze": (20, 251, 5_000, {}),
    "Grid4x4": (20, 251, 5_000, {}),
    "Hallway": (40, 101, 50_000, {}),
    "Tag": (40, 101, 20_000, {"reward_shift": 10.0}),
}
"""Nodes, evaluation episodes and their horizon, training episodes, settings."""
SOURCE = {
    "Hallway": (
        Reference("online EM at 50,000 (source)", 0.3, "source dissertation, section 4.4"),
        Reference("batch EM in equal time (source)", 0.1, "source dissertation, section 4.4"),
    ),
    "Tag": (
        Reference("online EM at 50,000 (source)", -8.0, "source dissertation, section 4.4"),
        Reference("batch EM in equal time (source)", -14.0, "source dissertation, section 4.4"),
    ),
}
QUICK = {"seeds": 1, "eval_points": 5}


def panels(name: str) -> tuple[Comparison, Comparison]:
    """Return a problem's two panels, of the same runs."""
    nodes, size, episodes, settings = PROBLEMS[name]
    common: dict[str, Any] = {"nodes": nodes} | settings
    entries = (
        Entry("online-em", "online-em", common),
        Entry(
            "batch-em-all", "batch-em", common | {"keep": True, "batch_episodes": episodes // 20}
        ),
        Entry("batch-em-newest", "batch-em", common | {"batch_episodes": min(300, episodes // 20)}),
        Entry("random", "random", {}),
    )
    environment = EnvironmentSpec(f"bnprl/{name}-v0", {"max_episode_steps": size})
    experiment = Experiment(
        environment, entries, episodes=episodes, seeds=5, eval_episodes=size, eval_points=20
    )
    deep = Experiment(
        environment,
        (Entry("recurrent-ppo", "recurrent-ppo", {}), Entry("ours", "predictive-actor-critic", {})),
        episodes=max(50, episodes // 100),
        seeds=2,
        eval_episodes=size,
        eval_points=5,
    )
    quick = QUICK | {"episodes": episodes // 20}
    slow_quick = {"seeds": 1, "episodes": 20, "eval_points": 1}
    value = Comparison(
        name.lower(),
        name,
        experiment,
        quick,
        RETURN,
        slow=deep,
        slow_quick=slow_quick,
        references=SOURCE.get(name, ()) + registered(f"bnprl/{name}-v0"),
        x="episodes",
        logarithmic_x=True,
    )
    time = Comparison(
        name.lower(), f"{name}: time", experiment, quick, SECONDS, x="episodes", logarithmic=True
    )
    return value, time


REPRODUCTION = Reproduction(
    title="Figure 4.1: online and batch EM",
    columns=2,
    panels=tuple(panel for name in PROBLEMS for panel in panels(name)),
    notes=(
        "batch-em-all is the source's batch method: all episodes so far, by their importance "
        "ratios; it learns 20 times on the way. batch-em-newest learns from the newest batch "
        "alone, on-policy. online-em learns from 100 at a time.",
        "recurrent-ppo and ours (predictive-actor-critic) have 2 seeds and a hundredth of the "
        "episodes, at least 50.",
        "Reference values are over an infinite horizon; the source stopped batch EM before 1,000 "
        "episodes.",
        "In Tag rewards are shifted by 10 and in Shuttle by 3 for the three EM learners.",
    ),
)
