"""The command `plot`: a picture of what a policy file holds."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym

from baselines.environment import EnvironmentSpec
from baselines.files import write_atomic
from baselines.learners import load_policy
from baselines.records import Record, read_records
from baselines.study import load_study, trusted_environment
from baselines.usage import usage_errors
from bnprl_agents.controllers.learner import ControllerAgent
from bnprl_agents.value_learner import ValueAgent

if TYPE_CHECKING:
    from baselines.options import Plot

COMPASS_WORLDS = ("bnprl/Gridworld-v0", "bnprl/PuddleWorld-v0")
"""Whose actions are moves to the north, south, east and west."""


def plot(options: Plot) -> int:
    """Draw learned values or controllers beside the policy file; return the exit code."""
    with usage_errors():
        policy = load_policy(options.file, options.agent)
        environment = _environment(options)
        if isinstance(policy, ValueAgent):
            picture = _values(policy, environment)
        elif isinstance(policy, ControllerAgent):
            picture = _controllers(policy, environment, options.file)
        else:
            raise ValueError(
                f"{options.file}: holds neither action values nor controllers, which are what is "
                "drawn"
            )
        target = options.out or options.file.with_suffix(".png")
        write_atomic(target, picture)
    print(f"picture: {target}")
    return 0


def _environment(options: Plot) -> EnvironmentSpec | None:
    """Return the environment that is given, or that of the experiment around the file."""
    if options.env is not None:
        return EnvironmentSpec(options.env)
    folder = options.file.resolve().parent.parent.parent
    known = (folder / "experiment.json").is_file()
    return trusted_environment(load_study(folder)) if known else None


def _values(policy: ValueAgent, environment: EnvironmentSpec | None) -> bytes:
    from baselines.q_pictures import draw_values  # imports matplotlib

    title = f"{type(policy).__name__} after {policy.steps:,} steps"
    axes, actions = ((), ()) if environment is None else _names(environment)
    id = None if environment is None else environment.id
    return draw_values(
        policy,
        axes=axes,
        actions=actions,
        compass=id in COMPASS_WORLDS,
        title=title if id is None else f"{id}: {title}",
    )


def _names(environment: EnvironmentSpec) -> tuple[Sequence[str], Sequence[str]]:
    """Return what an environment calls the axes of its observations, and its actions."""
    model = environment.model()
    if model is not None:
        return (), model.names.actions[0]
    with contextlib.closing(gym.make(environment.id, **environment.kwargs)) as env:
        made: Any = env.unwrapped
        return getattr(made, "state_names", ()), getattr(made, "action_names", ())


def _controllers(policy: ControllerAgent, environment: EnvironmentSpec | None, file: Path) -> bytes:
    model = None if environment is None else environment.model()
    if environment is None or model is None:
        raise ValueError(
            f"{file}: to draw controllers takes a known model of what they act in: give --env ID"
        )
    from baselines.controller_pictures import draw_controllers  # imports matplotlib

    title = f"{environment.id}: {type(policy).__name__}"
    return draw_controllers(model, policy.controllers, _records(file), title)


def _records(file: Path) -> tuple[Record, ...]:
    """Return the records of the run that wrote a policy file; none where they are not beside it."""
    lines = file.with_name(file.name.split(".")[0] + ".jsonl")
    return read_records(lines).lines if lines.is_file() else ()
