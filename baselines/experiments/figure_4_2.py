"""Figure 4.2: online EM on Hallway and Tag with 10 to 60 nodes."""

from __future__ import annotations

from baselines.environment import EnvironmentSpec
from baselines.experiment import Entry, Experiment
from baselines.experiments.figure_4_1 import PROBLEMS
from baselines.reproduction import LENGTH, RETURN, REWARD, Comparison, Reproduction, registered

NODES = (10, 20, 30, 40, 50, 60)
LABELS = {f"nodes-{z}": f"{z} nodes" for z in NODES}
RUNS = {"Hallway": (50_000, 5), "Tag": (5_000, 5)}
"""Training episodes and seeds."""
QUICK = {"seeds": 1, "episodes": 1_000, "eval_points": 4, "eval_episodes": 250}


def panels(name: str) -> tuple[Comparison, ...]:
    """Return a problem's panels, of the same runs."""
    problem = PROBLEMS[name]
    settings = {"reward_shift": problem.shift, "batch_episodes": problem.batch}
    episodes, seeds = RUNS[name]
    experiment = Experiment(
        EnvironmentSpec(f"bnprl/{name}-v0", {"max_episode_steps": problem.size}),
        (
            *(Entry(f"nodes-{z}", "online-em", {"nodes": z} | settings) for z in NODES),
            Entry("random", "random", {}),
        ),
        episodes=episodes,
        seeds=seeds,
        eval_episodes=500,
        eval_points=5,
    )
    known = registered(f"bnprl/{name}-v0")
    value = Comparison(
        name.lower(),
        name,
        experiment,
        QUICK,
        RETURN,
        references=known,
        x="episodes",
        labels=LABELS,
    )
    steps = Comparison(
        name.lower(),
        f"{name}: steps",
        experiment,
        QUICK,
        LENGTH,
        x="episodes",
        labels=LABELS,
    )
    if name == "Tag":
        return value, steps
    goal = Comparison(
        name.lower(),
        f"{name}: share of episodes at the goal",
        experiment,
        QUICK,
        REWARD,
        x="episodes",
        labels=LABELS,
    )
    return value, goal, steps


REPRODUCTION = Reproduction(
    title="Figure 4.2: online EM by number of nodes",
    panels=tuple(panel for name in RUNS for panel in panels(name)),
    notes=(
        "An episode of Hallway earns 1 at the goal and nothing else, so that the mean sum of its "
        "rewards is the share of episodes that reach it; in Tag the steps say as much, 101 being "
        "those of an episode that is cut.",
        "5 seeds; 50,000 episodes in Hallway as in the source, in Tag 5,000 where it has 50,000.",
        "What came out: in Hallway every size is above the source's .3, and from 20 nodes on EM is "
        "at the best memoryless policy or a little above it; more nodes than that gain little. In "
        "Tag EM first learns not to tag in vain, which is worth about -20, and is still there, "
        "the signal being weak under rewards shifted by 10; the source has -8 after ten times as "
        "many episodes.",
        "Other learners in these two environments: figure 4.1.",
    ),
)
