"""Figure 6.3: a hundred intersections, with and without a hand-coded heuristic while learning.

Units that pass in a step of 100-step episodes. "Helped" learners follow the heuristic (the longer
of the two queues) with probability .1 at each step of each agent while they learn. Those by EM
learn from the actions that were taken; the search scores its candidates by episodes that are
disturbed in this way.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
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
from bnprl_agents.search.controller_search import ControllerSearch
from bnprl_agents.search.settings import ControllerSearchConfig
from bnprl_agents.training import train
from bnprl_envs import GridTrafficBatch
from bnprl_envs.hand_coded import POLICIES, follow_longer_queue, uniform_policy
from bnprl_envs.registry import Reference
from bnprl_envs.team import agent_names, agent_spaces

ID = "bnprl/GridTraffic-v0"
HELP = 0.1
"""Probability of the heuristic's action, as in Wu et al. 2013."""
COPIES = 50
SEARCH_COPIES = 8
SEARCH = ControllerSearchConfig(explore_seeds=16, refine_seeds=64, judge_seeds=512)
"""The default numbers of episodes: here each seed begins one in every copy."""
SEARCH_STEPS, EM_STEPS = 300_000, 30_000
POINTS = 4
"""Evaluations of a helped run, and of one by EM."""
SEARCH_SEEDS, EM_SEEDS = 10, 1
UNITS = "units that pass in a step"
JUDGING, ACTING = 0, 1
"""Seeds of the episodes that judge and of what acts by chance in them; learners have others."""
SIZES: dict[str, Any] = {"nodes": 4, "batch_episodes": 100}


def hand_coded() -> tuple[Reference, ...]:
    """What the policies that need no learning let pass, by simulation."""
    found = []
    for name, policy in {
        "random": uniform_policy(GridTrafficBatch(COPIES)),
        **POLICIES[ID],
    }.items():
        rng = np.random.default_rng(ACTING)
        found.append(Reference(name, units(lambda seen, t: policy(seen, t, rng)), "simulated here"))  # noqa: B023
    return tuple(found)


def units(act: Callable[[Any, int], Any]) -> float:
    """Mean units that pass in a step of fresh episodes.

    Args:
        act: observations (copies, N) and the time -> actions (copies, N).
    """
    env = GridTrafficBatch(COPIES)
    seen, _ = env.reset(seed=JUDGING)
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


class HelpedTraffic(gym.vector.VectorWrapper):
    """Grid traffic whose lights follow the heuristic with probability `HELP`."""

    def __init__(self, env: GridTrafficBatch) -> None:
        super().__init__(env)
        self.max_episode_steps = env.max_episode_steps
        self._rng = np.random.default_rng()

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        """Begin new episodes; the seed is that of the heuristic's turns too."""
        if seed is not None:
            (turns,) = np.random.SeedSequence(seed).spawn(1)
            self._rng = np.random.default_rng(turns)
        self._seen, info = self.env.reset(seed=seed, options=options)
        return self._seen, info

    def step(self, actions: Any) -> Any:
        """Act, here and there by the heuristic."""
        helped = self._rng.random(actions.shape) < HELP
        heuristic = follow_longer_queue(self._seen, 0, self._rng)
        self._seen, *rest = self.env.step(np.where(helped, heuristic, actions))
        return self._seen, *rest


def curve(agent: ControllerAgent, env: Any, budget: int, seed: int) -> FloatArray:
    """Train for so many steps; return the units (POINTS,) that pass along the way."""
    passed: list[float] = []
    for progress in train(agent, env, seed=seed, steps=budget):
        if progress.steps * POINTS >= (len(passed) + 1) * budget:
            passed.append(units(by_memory(agent)))
    return np.array(passed + [units(by_memory(agent))] * (POINTS - len(passed)))


def seed_pairs(runs: int) -> list[tuple[int, int]]:
    """Seeds of each run's learner and environment."""
    drawn = np.random.SeedSequence(JUDGING).generate_state(2 * runs).tolist()
    return list(zip(drawn[::2], drawn[1::2], strict=True))


def by_memory(agent: ControllerAgent) -> Callable[[Any, int], Any]:
    """The agent's policy as a function of observations and time."""
    state: Any = None

    def act(seen: Any, t: int) -> Any:
        nonlocal state
        names = agent_names(seen.shape[1])
        actions, state = agent.predict(dict(zip(names, seen.T, strict=True)), state)
        return np.stack([actions[name] for name in names], axis=1)

    return act


def helped(quick: bool) -> Lines:
    """Learn with the heuristic; quick: a fifth of the steps."""
    spaces = agent_spaces(GridTrafficBatch(1))
    plain, disturbed = GridTrafficBatch(COPIES), HelpedTraffic(GridTrafficBatch(SEARCH_COPIES))
    config, mcem = StickBreakingConfig(**SIZES), MonteCarloEMConfig(**SIZES)
    contenders: dict[str, tuple[Callable[[int], ControllerAgent], Any, int, int]] = {
        "controller-search": (
            lambda seed: ControllerSearch(*spaces, SEARCH, discount=0.9, seed=seed),
            disturbed,
            SEARCH_STEPS,
            2 if quick else SEARCH_SEEDS,
        ),
        "stick-breaking": (
            lambda seed: HelpedStickBreaking(*spaces, config, discount=0.9, seed=seed),
            plain,
            EM_STEPS,
            EM_SEEDS,
        ),
        "mcem": (
            lambda seed: HelpedMonteCarloEM(*spaces, mcem, discount=0.9, seed=seed),
            plain,
            EM_STEPS,
            EM_SEEDS,
        ),
    }
    lines = {}
    for name, (make, env, steps, seeds) in contenders.items():
        budget = steps // 5 if quick else steps
        runs = [curve(make(own), env, budget, world) for own, world in seed_pairs(seeds)]
        lines[name] = (np.linspace(0, budget, POINTS + 1)[1:], np.array(runs))
    return lines


REPRODUCTION = Reproduction(
    title="Figure 6.3: grid traffic, 100 intersections",
    panels=(
        Comparison(
            "random-behaviour",
            "From uniformly random behaviour",
            Experiment(
                EnvironmentSpec(ID),
                (Entry("controller-search", "controller-search", {}),),
                steps=2_000_000,
                seeds=10,
                eval_episodes=COPIES,
                eval_points=5,
            ),
            quick={"steps": 200_000, "seeds": 2, "eval_points": 2},
            measure=REWARD_PER_STEP,
            computed=hand_coded,
            logarithmic_x=True,
        ),
        Comparison(
            "by-em",
            "The same, learners by EM",
            Experiment(
                EnvironmentSpec(ID),
                (
                    Entry("stick-breaking", "stick-breaking", SIZES),
                    Entry("mcem", "mcem", SIZES),
                ),
                steps=EM_STEPS,
                seeds=EM_SEEDS,
                eval_episodes=COPIES,
                eval_points=POINTS,
            ),
            quick={"steps": EM_STEPS // 5, "eval_points": 1, "eval_episodes": 16},
            measure=REWARD_PER_STEP,
        ),
        Computation(
            "helped",
            "With the heuristic in 10% of the actions",
            helped,
            x="environment steps of training",
            y=UNITS,
        ),
        Comparison(
            "ppo",
            "Stable-Baselines3's PPO, one seed",
            Experiment(
                EnvironmentSpec(ID),
                (
                    Entry("ppo-independent", "ppo-independent", {}),
                    Entry("ppo-shared", "ppo-shared", {}),
                ),
                steps=4800,
                seeds=1,
                eval_episodes=COPIES,
                eval_points=3,
            ),
            quick={"steps": 1600, "eval_points": 1, "eval_episodes": 16},
            measure=REWARD_PER_STEP,
        ),
    ),
    columns=2,
    notes=(
        "The dynamics are declared by this suite, since the source leaves them open, so its "
        "figure's numbers do not carry over.",
        "controller-search lets all agents of equal spaces share one controller; the others "
        "learn a hundred controllers or networks, ppo-shared one network that knows its agent.",
        "EM has 300 episodes and PPO 48, which take it minutes, and nothing comes of them: the "
        "team's one reward says next to nothing of one agent among a hundred. The search's shared "
        "tables make one agent's change everybody's.",
    ),
)
