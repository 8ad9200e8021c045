"""Figure 6.3: a hundred intersections, with and without a hand-coded heuristic while learning.

Units that pass in a step of 100-step episodes. "Helped" learners follow the heuristic (the longer
of the two queues) with probability .1 at each step of each agent while they learn.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from baselines.environment import EnvironmentSpec
from baselines.experiment import Entry, Experiment
from baselines.reproduction import (
    REWARD_PER_STEP,
    Comparison,
    Computation,
    Lines,
    Reproduction,
)
from bnprl_agents.controllers.learner import ControllerAgent
from bnprl_agents.controllers.mcem import MonteCarloEM, MonteCarloEMConfig
from bnprl_agents.controllers.stick_breaking import StickBreaking, StickBreakingConfig
from bnprl_agents.episodes import FloatArray
from bnprl_agents.training import train
from bnprl_envs import GridTrafficBatch
from bnprl_envs.hand_coded import POLICIES, follow_longer_queue
from bnprl_envs.registry import Reference
from bnprl_envs.team import agent_names, agent_spaces

ID = "bnprl/GridTraffic-v0"
HELP = 0.1
"""Probability of the heuristic's action, as in Wu et al. 2013."""
COPIES = 50
UNITS = "units that pass in a step"
SIZES: dict[str, Any] = {"nodes": 4, "batch_episodes": 100}


def hand_coded() -> tuple[Reference, ...]:
    """What the policies that need no learning let pass, by simulation."""
    found = []
    for name, policy in POLICIES[ID].items():
        rng = np.random.default_rng(0)
        found.append(Reference(name, units(lambda seen, t: policy(seen, t, rng)), "simulated here"))  # noqa: B023
    return tuple(found)


def units(act: Callable[[Any, int], Any]) -> float:
    """Mean units that pass in a step of fresh episodes.

    Args:
        act: observations (copies, N) and the time -> actions (copies, N).
    """
    env = GridTrafficBatch(COPIES)
    seen, _ = env.reset(seed=0)
    steps, passed = env.max_episode_steps or 1, 0.0
    for t in range(steps):
        seen, reward, *_ = env.step(act(seen, t))
        passed += float(reward.mean())
    return passed / steps


class Helped(ControllerAgent):
    """A learner of controllers whose behaviour follows the heuristic with probability `HELP`."""

    def behaviour_probabilities(self) -> list[FloatArray]:
        """For each agent (n, A): its own behaviour mixed with the longer queue's action."""
        heuristic = np.eye(2)[follow_longer_queue(self._seen, 0, self.rng)]
        return [
            (1.0 - HELP) * own + HELP * heuristic[:, n]
            for n, own in enumerate(super().behaviour_probabilities())
        ]


class HelpedStickBreaking(Helped, StickBreaking):
    """Stick-breaking with the heuristic."""


class HelpedMonteCarloEM(Helped, MonteCarloEM):
    """Monte-Carlo EM with the heuristic."""


def curve(agent: ControllerAgent, episodes: int, seed: int) -> tuple[list[float], list[float]]:
    """Train; return the steps of each update and the units after it."""
    steps, passed = [], []
    for progress in train(agent, GridTrafficBatch(COPIES), seed=seed, episodes=episodes):
        if not progress.metrics:
            continue
        state: Any = None

        def act(seen: Any, t: int) -> Any:
            nonlocal state
            names = agent_names(seen.shape[1])
            actions, state = agent.predict(dict(zip(names, seen.T, strict=True)), state)
            return np.stack([actions[name] for name in names], axis=1)

        steps.append(float(progress.steps))
        passed.append(units(act))
    return steps, passed


def helped(quick: bool) -> Lines:
    """Learn with the heuristic."""
    spaces = agent_spaces(GridTrafficBatch(1))
    makers: dict[str, Callable[[int], ControllerAgent]] = {
        "stick-breaking": lambda seed: HelpedStickBreaking(
            *spaces, StickBreakingConfig(**SIZES), discount=0.9, seed=seed
        ),
        "mcem": lambda seed: HelpedMonteCarloEM(
            *spaces, MonteCarloEMConfig(**SIZES), discount=0.9, seed=seed
        ),
    }
    seeds, episodes = (1, 200) if quick else (3, 2000)
    lines = {}
    for name, make in makers.items():
        runs = [curve(make(seed), episodes, seed) for seed in range(seeds)]
        lines[name] = (np.array(runs[0][0]), np.array([passed for _, passed in runs]))
    return lines


REPRODUCTION = Reproduction(
    title="Figure 6.3: grid traffic, 100 intersections",
    panels=(
        Comparison(
            "random-behaviour",
            "From uniformly random behaviour",
            Experiment(
                EnvironmentSpec(ID),
                (
                    Entry("controller-search", "controller-search", {}),
                    Entry("stick-breaking", "stick-breaking", SIZES),
                    Entry("mcem", "mcem", SIZES),
                ),
                steps=200_000,
                seeds=3,
                eval_episodes=COPIES,
                eval_points=8,
            ),
            quick={"steps": 20_000, "seeds": 1, "eval_points": 2, "eval_episodes": 16},
            measure=REWARD_PER_STEP,
            slow=Experiment(
                EnvironmentSpec(ID),
                (
                    Entry("ppo-shared", "ppo-shared", {}),
                    Entry("ppo-independent", "ppo-independent", {}),
                ),
                steps=48_000,
                seeds=1,
                eval_episodes=COPIES,
                eval_points=4,
            ),
            slow_quick={"steps": 1600, "eval_points": 1, "eval_episodes": 16},
            computed=hand_coded,
        ),
        Computation(
            "helped",
            "With the heuristic in 10% of the actions",
            helped,
            x="environment steps of training",
            y=UNITS,
        ),
    ),
    notes=(
        "The dynamics are declared by this suite, since the source leaves them open, so its "
        "figure's numbers do not carry over.",
        "controller-search lets all agents of equal spaces share one controller; the others "
        "learn a hundred controllers or networks, ppo-shared one network that knows its agent.",
    ),
)
