"""Figure 4.3: online EM on Hallway when its policy sees the last few observations only.

The column of EM-MDP is open: its policy was the authors' own and is not published.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from baselines.contenders import contender
from baselines.environment import EnvironmentSpec
from baselines.evaluation import evaluate
from baselines.learners import build_learner
from baselines.reproduction import Computation, Lines, Reproduction, registered
from bnprl_agents.controllers.controller import Controller
from bnprl_agents.episodes import FloatArray, IntArray

HALLWAY = EnvironmentSpec("bnprl/Hallway-v0", {"max_episode_steps": 101})
WINDOWS = (1, 2, 3, 4, 6)
EPISODES = (500, 2_000, 10_000, 25_000, 50_000)
NODES = 40


class Forgetful:
    """A controller that remembers its last actions and observations only.

    Nodes begin at the distribution before the first observation and advance over what is
    remembered, so that with a window of 1 the policy depends on the last pair alone.

    Args:
        controller: of one agent.
        window: pairs of an action and the observation after it, at least 1.
        rng: source of the actions.
    """

    def __init__(self, controller: Controller, window: int, rng: np.random.Generator) -> None:
        self.controller, self.window, self.predict_rng = controller, window, rng

    def predict(
        self,
        observation: IntArray,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[IntArray, Any]:
        """Choose actions (n,); the state holds the pairs (n, window, 2), -1 where there is none."""
        n = len(observation)
        if state is None:
            pairs = np.full((n, self.window, 2), -1)
        else:
            pairs, last = state
            newest = np.stack([last, observation], axis=1)[:, None]
            pairs = np.concatenate([pairs[:, 1:], newest], axis=1)
            if episode_start is not None:
                pairs[np.asarray(episode_start, dtype=bool)] = -1
        p = self.controller.action_probabilities(self._nodes(pairs)).cumsum(axis=1)
        drawn = self.predict_rng.random((n, 1)) * p[:, -1:]
        action = (p > drawn).argmax(axis=1)
        return action, (pairs, action)

    def _nodes(self, pairs: IntArray) -> FloatArray:
        """Return the node distribution (n, Z) after the pairs."""
        first = self.controller.n_observations - 1  # the null observation
        nodes = self.controller.begin(np.full(len(pairs), first))
        for action, seen in np.moveaxis(pairs, 1, 0).transpose(0, 2, 1):
            held = action >= 0
            nodes[held] = self.controller.advance(nodes[held], action[held], seen[held])
        return nodes


def values_by_window(quick: bool) -> Lines:
    """Return the mean discounted return by episodes of training, for each window and for none."""
    episodes, seeds = (EPISODES[:2], 1) if quick else (EPISODES, 5)
    learner = contender("online-em")
    settings = type(learner.settings)(nodes=NODES)
    found: dict[str, list[list[float]]] = {}
    for seed in range(seeds):
        rng = np.random.default_rng([4, 3, seed])
        trained = build_learner(learner, HALLWAY, settings, seed)
        waiting = list(episodes)
        scores: dict[str, list[float]] = {}
        for progress in trained.learn(episodes=episodes[-1]):
            if progress.episodes >= waiting[0]:
                waiting.pop(0)
                for label, value in _scores(trained.policy, rng).items():
                    scores.setdefault(label, []).append(value)
        for label, values in scores.items():
            found.setdefault(label, []).append(values)
    return {label: (np.array(episodes, dtype=float), np.array(y)) for label, y in found.items()}


def _scores(policy: Any, rng: np.random.Generator) -> dict[str, float]:
    """Return the mean return of 500 episodes for each window and with the whole history."""
    policies = {f"|h| = {w}": Forgetful(policy.controllers[0], w, rng) for w in WINDOWS}
    return {
        label: float(
            evaluate(p, HALLWAY, episodes=500, seed=int(rng.integers(2**31))).returns.mean()
        )
        for label, p in (policies | {"whole history": policy}).items()
    }


REPRODUCTION = Reproduction(
    title="Figure 4.3: how much history the policy needs, Hallway",
    panels=(
        Computation(
            "windows",
            "online EM, 40 nodes",
            values_by_window,
            x="episodes of training",
            y="mean discounted return",
            references=registered("bnprl/Hallway-v0"),
        ),
    ),
    notes=(
        "The policies are learned with their whole history and evaluated with a part of it.",
        "EM-MDP, the source's comparison, is open: it evaluates a policy of other authors.",
        "Other learners on Hallway: figure 4.1.",
    ),
)
