"""The E-step against hmmlearn's scaled C++ forward-backward, as ratios in one run.

`python -m baselines.benchmarks.e_step` prints the table and exits 1 on a miss. The peer's three
C++ routines are called directly, with its emission probabilities ready: an ordinary HMM, one
transition matrix for all steps, where ours has one for each action and observation.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable

import numpy as np
from hmmlearn import _hmmc

from baselines.benchmarks.contest import Contest, run_contests
from bnprl_agents.controllers.controller import random_controller
from bnprl_agents.controllers.messages import soft_counts
from bnprl_agents.episodes import EpisodeBatch

SIZES = ((1000, 20, 30), (200, 100, 20))
"""(K episodes, T steps, Z nodes) of the contests."""

N_ACTIONS, N_OBSERVATIONS = 5, 22
"""Of Hallway, the null observation included."""


def our_e_step(episodes: int, length: int, nodes: int) -> Callable[[], float]:
    """Return work: `soft_counts` on random episodes with a reward at every step."""
    rng = np.random.default_rng(0)
    steps = episodes * length
    batch = EpisodeBatch(
        offsets=np.arange(episodes + 1) * length,
        observations=rng.integers(N_OBSERVATIONS, size=(steps, 1)),
        actions=rng.integers(N_ACTIONS, size=(steps, 1)),
        rewards=rng.random(steps),
        behaviour=np.full((steps, 1), 1.0 / N_ACTIONS),
        final_observations=np.zeros((episodes, 1), dtype=np.int64),
        terminated=np.ones(episodes, dtype=np.bool_),
    )
    controller = random_controller(nodes, N_ACTIONS, N_OBSERVATIONS, rng)

    def work() -> float:
        soft_counts(batch, controller, 0.95)
        return steps

    return work


def hmm_e_step(episodes: int, length: int, nodes: int) -> Callable[[], float]:
    """Return work: forward, backward and transition sums of every sequence."""
    rng = np.random.default_rng(0)
    start, transition = rng.dirichlet(np.ones(nodes)), rng.dirichlet(np.ones(nodes), size=nodes)
    frames = rng.random((episodes, length, nodes))

    def work() -> float:
        for frame in frames:
            _, forward, scaling = _hmmc.forward_scaling(start, transition, frame)
            backward = _hmmc.backward_scaling(start, transition, frame, scaling)
            _hmmc.compute_scaling_xi_sum(forward, transition, backward, frame)
        return episodes * length

    return work


def main() -> None:
    """Run the contests."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=2.0, help="a side and contest")
    seconds = parser.parse_args().seconds
    contests = [
        Contest(
            f"soft_counts / hmmlearn scaled C++ at N={k}, T={t}, Z={z}",
            our_e_step(k, t, z),
            hmm_e_step(k, t, z),
            wanted=3.0,
        )
        for k, t, z in SIZES
    ]
    sys.exit(0 if run_contests(contests, seconds) else 1)


if __name__ == "__main__":
    main()
