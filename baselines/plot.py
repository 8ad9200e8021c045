"""The command `plot`: a picture of what a policy file holds."""

from __future__ import annotations

from typing import TYPE_CHECKING

from baselines.contenders import load_policy
from baselines.records import write_atomic
from baselines.study import load_study
from baselines.usage import usage_errors
from bnprl_agents.value_learner import ValueAgent

if TYPE_CHECKING:
    from baselines.cli import Plot

COMPASS_WORLDS = ("bnprl/Gridworld-v0", "bnprl/PuddleWorld-v0")
"""Whose actions are moves to the north, south, east and west."""


def plot(options: Plot) -> int:
    """Draw the learned values beside the policy file; return the exit code."""
    with usage_errors():
        policy = load_policy(options.file)
        if not isinstance(policy, ValueAgent):
            raise ValueError(f"{options.file}: holds no action values, which are what is drawn")
        from baselines.q_pictures import draw_values  # imports matplotlib

        folder = options.file.resolve().parent.parent.parent
        known = options.env is None and (folder / "experiment.json").is_file()
        id = load_study(folder).experiment.environment.id if known else options.env
        target = options.out or options.file.with_suffix(".png")
        title = f"{type(policy).__name__} after {policy.steps:,} steps"
        picture = draw_values(
            policy,
            compass=id in COMPASS_WORLDS,
            title=title if id is None else f"{id}: {title}",
        )
        write_atomic(target, picture)
    print(f"picture: {target}")
    return 0
