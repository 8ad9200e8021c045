"""Any PettingZoo environment of a team as arrays: the same episodes, and who is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Discrete

from bnprl_envs import GridTrafficBatch, ParallelBatch, TabularParallelBatch, TabularParallelEnv
from bnprl_envs.team import agent_spaces
from tests.baselines import pairs


def dec_tiger() -> TabularParallelEnv:
    return TabularParallelEnv("bnprl/DecTiger-v0", max_episode_steps=3)


def test_the_copies_horizon_is_the_batchs() -> None:
    assert ParallelBatch(dec_tiger, 2).max_episode_steps == 3
    assert ParallelBatch(lambda: pairs.Pair(max_cycles=7), 2).max_episode_steps == 7


def test_columns_are_the_episodes_of_the_copies() -> None:
    batch, envs = ParallelBatch(dec_tiger, 2), [dec_tiger(), dec_tiger()]
    rng = np.random.default_rng(0)
    seen, _ = batch.reset(seed=5)
    dicts = [env.reset(seed=5 + copy)[0] for copy, env in enumerate(envs)]
    for _ in range(3):
        assert seen.tolist() == [[int(part) for part in each.values()] for each in dicts]
        actions = rng.integers(3, size=(2, 2))
        seen, rewards, terminated, truncated, _ = batch.step(actions)
        steps = [
            env.step(dict(zip(env.possible_agents, row, strict=True)))
            for env, row in zip(envs, actions.tolist(), strict=True)
        ]
        dicts = [step[0] for step in steps]
        assert rewards.tolist() == [step[1]["agent_0"] for step in steps]
    assert truncated.all()
    assert not terminated.any()
    mask = np.array([False, True])
    again, _ = batch.reset(options={"reset_mask": mask})
    assert (again[0] == seen[0]).all()
    assert again[1].tolist() == [2, 2]  # the null observation


@pytest.mark.parametrize(
    "make",
    [
        lambda: TabularParallelBatch("bnprl/DecTiger-v0", 4),
        lambda: ParallelBatch(dec_tiger, 4),
    ],
)
def test_an_agents_spaces_are_those_of_pettingzoo(make: Any) -> None:
    env, batch = dec_tiger(), make()
    assert agent_spaces(batch) == (env.observation_spaces, env.action_spaces)


def test_an_agents_spaces_elsewhere() -> None:
    observation, action = agent_spaces(ParallelBatch(pairs.Pair))
    assert observation == {"left": Discrete(2), "right": Discrete(3)}
    assert action == {"left": Discrete(2), "right": Discrete(4)}
    observation, _ = agent_spaces(GridTrafficBatch(rows=2, columns=2, capacity=3))
    assert observation == {f"agent_{n}": Discrete(16) for n in range(4)}


@pytest.mark.parametrize(
    ("cls", "reason"),
    [
        (pairs.Rivals, r"reward: 9.0 of left, 0\.[05] of right, but a team earns one reward"),
        (pairs.Leavers, "terminated: False of left, True of right, but agents must all end"),
        (pairs.Latecomers, "no observation of right: agents must not come and go"),
        (pairs.Painters, r"observation space of right: Box.*must be Discrete"),
    ],
)
def test_agents_that_are_no_team_are_refused(cls: Any, reason: str) -> None:
    def play() -> None:
        batch = ParallelBatch(cls, 2)
        batch.reset(seed=0)
        for _ in range(4):
            batch.step(np.array([[0, 3], [0, 3]]))

    with pytest.raises(ValueError, match=reason):
        play()
