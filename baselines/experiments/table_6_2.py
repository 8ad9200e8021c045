"""Table 6.2: decentralised learners on five benchmarks, beside what the literature reports.

Values are exact at discount .9. The planners of the source's table know the model; the learners
see episodes, and `controller-search` a simulator. `python -m baselines.benchmarks.stick_breaking`
holds the kept records against the source's values.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from baselines.environment import EnvironmentSpec
from baselines.experiment import Entry, Experiment
from baselines.reproduction import (
    EXACT,
    SECONDS,
    Comparison,
    Measure,
    Reproduction,
    learner_metric,
    registered,
)
from bnprl_envs.registry import Reference

SHIFTS = {
    "DecTiger": 101.0,
    "BroadcastChannel": 0.0,
    "RecyclingRobots": 20.0,
    "BoxPushing": 10.2,
    "MarsRovers": 11.0,
}
"""Minus the smallest reward, or more, which EM on rewards needs."""

TITLES = {
    "DecTiger": "Dec-Tiger",
    "BroadcastChannel": "Broadcast channel",
    "RecyclingRobots": "Recycling robots",
    "BoxPushing": "Box pushing",
    "MarsRovers": "Mars rovers",
}

PRINTED = {
    "DecTiger": {"pbvi-bb": 13.45, "periem": 9.42},
    "BroadcastChannel": {"pbvi-bb": 9.2710},
    "RecyclingRobots": {"pbvi-bb": 31.9291, "periem": 31.80},
    "BoxPushing": {"pbvi-bb": 224.1387, "periem": 106.68},
    "MarsRovers": {"periem": 18.13},
}
"""Planners' values as printed."""
SOURCE_SECONDS = {
    "DecTiger": {"dissertation": 96.0, "mcem": 20.0, "periem": 6540.0},
    "BroadcastChannel": {"dissertation": 7.0, "mcem": 24.0},
    "RecyclingRobots": {"dissertation": 147.0, "mcem": 19.0, "periem": 272.0},
    "BoxPushing": {"dissertation": 290.0, "mcem": 32.0, "periem": 7164.0},
    "MarsRovers": {"dissertation": 1286.0, "mcem": 160.0, "periem": 6088.0},
}
SOURCE_NODES = {
    "DecTiger": 6.0,
    "BroadcastChannel": 2.0,
    "RecyclingRobots": 3.0,
    "BoxPushing": 14.0,
    "MarsRovers": 10.0,
}
"""|Z| of DEC-SBPR as printed."""
TABLE = "Table 6.2 as printed"
NODES = learner_metric("nodes of a controller", "nodes")
HORIZON = 40
"""Steps of the episodes that are learned from: what comes later counts for less than 2%."""
SETTINGS: dict[str, dict[str, Any]] = {
    "DecTiger": {
        "initialisation": "random",
        "weighting": "linear",
        "temperature": 1.0,
        "exploration_prior": 0.5,
        "nodes": 8,
        "batch_episodes": 400,
    },
    "BroadcastChannel": {},
    "RecyclingRobots": {"starts": 2},
    "BoxPushing": {"starts": 3},
    "MarsRovers": {"starts": 10, "start_updates": 12},
}
"""Of stick-breaking, where they are not its defaults."""
EPISODES = {
    "DecTiger": 40_000,
    "BroadcastChannel": 12_000,
    "RecyclingRobots": 18_000,
    "BoxPushing": 24_000,
    "MarsRovers": 42_000,
}
"""Of one run; a start takes 6,000, on Mars 3,600."""


def _panel(name: str, kind: str, measure: Measure, known: tuple[Reference, ...] = ()) -> Comparison:
    """One row; rows of one problem share their runs."""
    id = f"bnprl/{name}-v0"
    learners = (
        Entry("stick-breaking", "stick-breaking", SETTINGS[name]),
        Entry("our-mcem", "mcem", {"nodes": 4, "reward_shift": SHIFTS[name]}),
    )
    return Comparison(
        name.lower(),
        TITLES[name] + kind,
        Experiment(
            EnvironmentSpec(id, {"max_episode_steps": HORIZON}),
            learners,
            episodes=EPISODES[name],
            seeds=20,
            eval_episodes=200,
            eval_points=1,
        ),
        quick={"episodes": EPISODES[name] // 4, "seeds": 2, "eval_episodes": 50},
        slow=Experiment(
            EnvironmentSpec(id),
            (Entry("controller-search", "controller-search", {}),),
            steps=30_000_000,
            seeds=3,
            eval_episodes=200,
            eval_points=1,
        ),
        slow_quick={"steps": 5_000_000, "seeds": 1, "eval_episodes": 50},
        measure=measure,
        references=known,
    )


def _printed(numbers: Mapping[str, float]) -> tuple[Reference, ...]:
    return tuple(Reference(label, value, TABLE) for label, value in numbers.items())


REPRODUCTION = Reproduction(
    title="Table 6.2: decentralised benchmarks, discount .9",
    panels=(
        *(
            _panel(name, "", EXACT, registered(f"bnprl/{name}-v0") + _printed(PRINTED[name]))
            for name in TITLES
        ),
        *(_panel(name, ": seconds", SECONDS, _printed(SOURCE_SECONDS[name])) for name in TITLES),
        *(
            _panel(name, ": nodes", NODES, _printed({"dissertation": SOURCE_NODES[name]}))
            for name in TITLES
        ),
    ),
    notes=(
        "stick-breaking has its defaults and several starts of 20 updates (Mars 12), the best of "
        "which goes on, where more than one is worth trying. On Dec-Tiger its rows begin at "
        "random, since the last observation alone is worth nothing, and weights are linear in the "
        "return, since exponential ones pay for opening a door by chance. our-mcem shifts the "
        "rewards above 0, which makes its steps small: it is far from done at these budgets.",
        "The column dissertation is the source's DEC-SBPR, mcem what it prints of Wu et al. 2013; "
        "pbvi-bb and periem are its planners, mc-jesp has a simulator alone (2023).",
        f"Both learn from episodes of {HORIZON} steps; the values are of endless ones.",
        "controller-search had 30 million simulated steps of each of three seeds; "
        "`python -m baselines.benchmarks.team_learners` gives it up to 300 million and 10 seeds.",
        "memoryless is the best deterministic memoryless joint policy known. Broadcast's 9.19 is "
        "agent 1 sending always but at first, when agent 2 does; agent 1 alone earns 9.1, and from "
        "there both must change at once.",
        "Seconds are wall-clock of training, ours with other work beside it; the source's are as "
        "printed, of its machine.",
    ),
    shape="table",
)
