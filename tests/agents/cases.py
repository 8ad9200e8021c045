"""Small episodes and models that several tests share."""

import json

import numpy as np

from bnprl_agents.controllers.controller import Controller, random_controller
from bnprl_agents.episodes import EpisodeBatch
from bnprl_envs.model import TabularModel


def random_episodes(rng, lengths, action_sizes, observation_sizes):
    """Episodes of random indices, rewards and behaviour probabilities."""
    steps = sum(lengths)
    columns = {"observations": observation_sizes, "actions": action_sizes}
    drawn = {
        name: np.stack([rng.integers(size, size=steps) for size in sizes], axis=1)
        for name, sizes in columns.items()
    }
    return EpisodeBatch(
        offsets=np.concatenate([[0], np.cumsum(lengths)]),
        rewards=rng.random(steps) * (rng.random(steps) < 0.7),
        behaviour=rng.uniform(0.2, 1.0, size=(steps, len(action_sizes))),
        final_observations=np.zeros((len(lengths), len(action_sizes))),
        terminated=np.ones(len(lengths)),
        **drawn,
    )


def random_team(rng, nodes, action_sizes, observation_sizes) -> tuple[Controller, ...]:
    return tuple(
        random_controller(z, a, o, rng)
        for z, a, o in zip(nodes, action_sizes, observation_sizes, strict=True)
    )


def random_model(rng, n_states=4, action_sizes=(2,), observation_sizes=(3,), terminal=True):
    """A model whose last state is terminal, with rewards >= 0."""
    n_actions, n_seen = int(np.prod(action_sizes)), int(np.prod(observation_sizes))
    transition = rng.dirichlet(np.ones(n_states), size=(n_actions, n_states))
    reward = rng.random((n_actions, n_states, n_states, n_seen))
    flags = np.zeros(n_states, dtype=bool)
    if terminal:
        flags[-1] = True
        transition[:, -1] = np.eye(n_states)[-1]
        reward[:, -1] = 0.0
    start = np.ones(n_states) * ~flags
    return TabularModel(
        transition,
        rng.dirichlet(np.ones(n_seen), size=(n_actions, n_states)),
        reward,
        start / start.sum(),
        0.9,
        terminal=flags,
        action_sizes=action_sizes,
        observation_sizes=observation_sizes,
    )


def copying_model(discount=0.9):
    """Reward 1 for doing what was last seen, a fair coin: 1 node earns half, 2 nodes all of it."""
    transition = np.full((2, 2, 2), 0.5)
    reward = np.zeros((2, 2, 2, 2))
    for action in range(2):
        reward[action, action] = 1.0
    sight = np.broadcast_to(np.eye(2), (2, 2, 2))
    return TabularModel(transition, sight, reward, [0.5, 0.5], discount)


def rewritten(path, change):
    """A policy file with its arrays and its description changed by `change(arrays, meta)`."""
    with np.load(path) as archive:
        arrays = dict(archive)
    meta = json.loads(arrays["meta"].tobytes())
    change(arrays, meta)
    arrays["meta"] = np.frombuffer(json.dumps(meta).encode(), dtype=np.uint8)
    np.savez(path, **arrays)
    return path
