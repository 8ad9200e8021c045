"""Figure 3.3: on Baird's star, where fixed bases diverge, online GPQ does not.

Both learn from the same behaviour, which takes the dashed action with probability 6/7, and begin
with values that are not 0; all rewards are 0.
"""

from __future__ import annotations

import numpy as np

from baselines.reproduction import Computation, Lines, Reproduction
from bnprl_agents.episodes import FloatArray, IntArray
from bnprl_agents.gaussian_process.gp_q import GPQ, GPQConfig
from bnprl_envs.benchmarks.baird_star import (
    DASHED,
    SOLID,
    baird_star,
    star_features,
    star_initial_weights,
)
from bnprl_envs.tabular import single_agent_spaces

RATE = 0.01
"""Learning rate of the fixed bases."""
SEEDS, STEPS, POINTS = 20, 5000, 50


def behaviour(steps: int, seed: int) -> tuple[IntArray, IntArray, IntArray]:
    """Return states, actions and next states (steps,) of one long episode."""
    model, rng = baird_star(), np.random.default_rng([3, seed])
    actions = np.where(rng.random(steps) < 6 / 7, DASHED, SOLID)
    ends = np.where(actions == DASHED, rng.integers(6, size=steps), model.n_states - 1)
    states = np.concatenate([rng.integers(7, size=1), ends[:-1]])
    return states, actions, ends


def fixed_bases(seed: int, points: IntArray) -> FloatArray:
    """Return max |Q| of semi-gradient Q-learning on Baird's bases at some steps."""
    model, phi, weights = baird_star(), star_features(), star_initial_weights()
    found = []
    for t, (s, a, s_t) in enumerate(zip(*behaviour(int(points[-1]), seed), strict=True), 1):
        delta = model.discount * (phi[s_t] @ weights).max() - phi[s, a] @ weights
        weights = weights + RATE * delta * phi[s, a]
        if t in points:
            found.append(np.abs(phi @ weights).max())
    return np.array(found)


def gpq(seed: int, points: IntArray) -> FloatArray:
    """Return max |Q| of GPQ, which first measured Q = 10 everywhere, at some steps."""
    model = baird_star()
    action_space, observation_space = single_agent_spaces(model)
    agent = GPQ(
        observation_space,
        action_space,
        GPQConfig(bandwidth=(1.0,), budget=7),
        discount=model.discount,
        seed=seed,
    )
    every = np.arange(model.n_states)
    for state in every:
        for action in (SOLID, DASHED):
            agent.reset(int(state))
            agent.observe(action, 10.0, int(state), True, False)
    agent.update()
    found = []
    for t, (s, a, s_t) in enumerate(zip(*behaviour(int(points[-1]), seed), strict=True), 1):
        agent.reset(int(s))
        agent.observe(int(a), 0.0, int(s_t), False, False)
        if t in points:
            agent.update()
            found.append(np.abs(agent.action_values(every)).max())
    return np.array(found)


def largest_values(quick: bool) -> Lines:
    """Return max |Q - Q*| while learning; Q* is 0."""
    steps, seeds = (1000, 5) if quick else (STEPS, SEEDS)
    points = np.linspace(steps // POINTS, steps, POINTS).astype(np.int64)
    learners = {"GPQ": gpq, "Q-learning on fixed bases": fixed_bases}
    return {
        name: (points.astype(float), np.array([learner(s, points) for s in range(seeds)]))
        for name, learner in learners.items()
    }


REPRODUCTION = Reproduction(
    title="Figure 3.3: Baird's star",
    panels=(
        Computation(
            "star",
            "the same transitions for both",
            largest_values,
            x="transitions",
            y="largest |Q - Q*|",
            logarithmic=True,
        ),
    ),
    notes=(
        "GPQ's error falls slowly: every target weighs alike, and the first ones were 10.",
        "GPQ begins with one measurement of 10 in every state and action, so that it has something "
        "to forget; its prior mean is the solution.",
    ),
)
