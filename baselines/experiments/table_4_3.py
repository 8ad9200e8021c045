"""Table 4.3: rewards earned during the first 3,500 (Hallway) or 5,000 (Tag) steps of learning.

Protocol C: what counts is the sum of the rewards while learning, exploration included.
"""

from __future__ import annotations

from typing import Any

from baselines.environment import EnvironmentSpec
from baselines.experiment import Entry, Experiment
from baselines.reproduction import EARNED, Comparison, Reproduction
from bnprl_envs.registry import Reference

SOURCE = {
    "Hallway": (6.0, 3.0, 0.2, 1.6, 6.6),
    "Tag": (-4908.0, -4987.0, -16000.0, -7400.0, -3500.0),
}
METHODS = ("RPR, 10 nodes", "RPR, 40 nodes", "iPOMDP", "PP-2", "PP-3")
STEPS = {"Hallway": 3500, "Tag": 5000}
SHIFTS: dict[str, dict[str, Any]] = {"Hallway": {}, "Tag": {"reward_shift": 10.0}}
"""The smallest reward of Tag is -10."""
EM: dict[str, Any] = {"batch_episodes": 1}
"""So few steps hold some 50 episodes: Algorithm 3 as printed, an update after each."""
SMALL_BATCHES: dict[str, Any] = {"batch_steps": 256, "minibatch_steps": 256}
SMALL_ROLLOUTS: dict[str, Any] = {"n_steps": 16, "batch_size": 256}
"""Of 256 steps as well, by 16 copies."""
INFINITE: dict[str, Any] = {"batch_episodes": 5}


def row(name: str) -> Comparison:
    """Return one environment's row."""
    shift = SHIFTS[name]
    contenders = (
        *(Entry(f"online-em-{z}", "online-em", EM | {"nodes": z} | shift) for z in (10, 40)),
        Entry("infinite-rpr", "infinite-rpr", INFINITE | shift),
        Entry("predictive-actor-critic", "predictive-actor-critic", SMALL_BATCHES),
        Entry("random", "random", {}),
    )
    environment = EnvironmentSpec(f"bnprl/{name}-v0", {"max_episode_steps": 101})
    return Comparison(
        name.lower(),
        name,
        Experiment(
            environment,
            contenders,
            steps=STEPS[name],
            seeds=10,
            eval_episodes=250,
            eval_points=1,
        ),
        quick={"seeds": 1},
        measure=EARNED,
        slow=Experiment(
            environment,
            (Entry("recurrent-ppo", "recurrent-ppo", SMALL_ROLLOUTS),),
            steps=STEPS[name],
            seeds=2,
            eval_episodes=250,
            eval_points=1,
        ),
        slow_quick={"seeds": 1, "steps": 2_048},
        references=tuple(
            Reference(f"{method} (source)", value, "source dissertation, Table 4.3")
            for method, value in zip(METHODS, SOURCE[name], strict=True)
        ),
    )


REPRODUCTION = Reproduction(
    title="Table 4.3: rewards earned while learning",
    panels=tuple(row(name) for name in SOURCE),
    notes=(
        "The sum is over the whole episodes that fit in the budget, 3,500 steps in Hallway and "
        "5,000 in Tag, and is lower than over all steps by a part of one episode.",
        "PP-2 and PP-3 are given an expert's trajectories; the others learn alone.",
        "What came out: in Hallway EM and iRPR earn more than the source's, but not twice what "
        "random behaviour does: so few rewards come in, also for predictive-actor-critic. In "
        "Tag the source's EM loses little beyond one a step, as if it never tagged in vain; ours, "
        "with rewards shifted by 10, needs longer to unlearn that than 50 episodes. "
        "predictive-actor-critic is ahead of PP-2 and behind the source's EM and PP-3.",
        "predictive-actor-critic and recurrent-ppo learn from 256 steps at a time, where their "
        "defaults are 2,000 and more: so few steps would hold one or two updates.",
        "recurrent-ppo has 2 seeds, the others 10.",
        "EM learns after every episode (Algorithm 3 as printed), iRPR after 5; in Tag the rewards "
        "of both are shifted by 10.",
    ),
    shape="table",
)
