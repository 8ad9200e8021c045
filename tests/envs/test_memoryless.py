"""Memoryless policies: exact values, both searches, against enumeration and published figures."""

import itertools
import os
from pathlib import Path

import numpy as np
import pytest

import bnprl_envs
from bnprl_envs.benchmarks.hallway import hallway
from bnprl_envs.memoryless import (
    memoryless_joint_policy,
    memoryless_value,
)
from bnprl_envs.model import TabularModel
from bnprl_envs.planning import random_value
from bnprl_envs.stochastic_memoryless import stochastic_memoryless_policy
from bnprl_envs.tabular import TabularEnv

BOX_PUSHING = Path(os.environ.get("BNPRL_REFERENCE_MODELS", "")) / "boxPushingUAI07.dpomdp"


def registered(name, **arguments):
    id = f"bnprl/{name}-v0"
    if id not in bnprl_envs.environment_ids():
        pytest.skip(f"{id} is not registered")
    return bnprl_envs.model(id, **arguments)


def team_model(seed, agents=2, terminal=False):
    """Three states; each agent has two actions and two observations."""
    random = np.random.default_rng(seed)
    size = 2**agents
    transition = random.dirichlet(np.full(3, 0.5), size=(size, 3))
    reward = random.normal(size=(size, 3, 3, size))
    flags, start = np.zeros(3, dtype=bool), random.dirichlet(np.ones(3))
    if terminal:
        flags[2], start = True, np.array([0.3, 0.7, 0.0])
        transition[:, 2], reward[:, 2] = np.eye(3)[2], 0.0
    observation = random.dirichlet(np.full(size, 0.5), size=(size, 3))
    observation[0, 0] = observation[1, 0]  # two actions share what is seen in one state
    return TabularModel(
        transition, observation, reward, start, 0.8, flags, (2,) * agents, (2,) * agents
    )


def chain_value(model, policy):
    """Value of pi(a | o) (O + 1, A) by the chain over states and last observations."""
    n_seen = model.n_observations + 1
    moves = np.einsum("oa,ast,atp->sotp", policy, model.transition, model.observation)
    chain = np.zeros((model.n_states, n_seen, model.n_states, n_seen))
    chain[..., :-1] = moves
    size = model.n_states * n_seen
    reward = (policy @ model.expected_reward).T.ravel()
    value = np.linalg.solve(np.eye(size) - model.discount * chain.reshape(size, size), reward)
    return model.start @ value.reshape(model.n_states, n_seen)[:, -1]


def joint_policy(tables):
    """Joint pi(a | o) of two agents' tables (O_i + 1, A_i)."""
    first, second = tables
    seen = np.einsum("oa,pb->opab", first[:-1], second[:-1]).reshape(4, 4)
    return np.vstack([seen, np.kron(first[-1], second[-1])])


class TestValue:
    @pytest.mark.parametrize("seed", range(3))
    def test_stochastic_team(self, seed):
        model = team_model(seed)
        tables = np.random.default_rng(seed).dirichlet(np.ones(2), size=(2, 3))
        wanted = chain_value(model, joint_policy(tables))
        assert memoryless_value(model, list(tables)) == pytest.approx(wanted, abs=1e-12)

    def test_uniform_is_random(self):
        model = hallway()
        value = memoryless_value(model, [np.full((22, 5), 0.2)])
        assert value == pytest.approx(random_value(model), abs=1e-9)

    @pytest.mark.parametrize(
        ("name", "policies", "value"),
        [
            ("RecyclingRobots", [[1, 0, 2], [1, 0, 2]], 31.9291),
            ("BroadcastChannel", [[0, 0, 1], [1, 1, 0]], 9.190),
            ("BoxPushing", [[2, 0, 0, 2, 2, 2], [2, 1, 1, 2, 2, 2]], 183.1901),
            ("MarsRovers", [[4, 5, 5, 5, 1, 3, 5, 0, 1], [4, 5, 5, 4, 3, 3, 0, 5, 5]], 21.7103),
            ("MarsRovers", [[4, 1, 5, 2, 3, 3, 3, 4, 4], [4, 5, 5, 5, 1, 3, 1, 0, 4]], 23.8298),
            (
                "MeetingGrid",
                [[4, 2, 2, 0, 2, 2, 0, 0, 2, 2], [4, 2, 2, 0, 0, 2, 0, 0, 2, 0]],
                5.8199,
            ),
        ],
    )
    def test_known_policies(self, name, policies, value):
        found = memoryless_value(registered(name), policies, 0.9)
        assert found == pytest.approx(value, abs=1e-4)

    @pytest.mark.parametrize(
        ("policies", "message"),
        [
            ([[0] * 22, [0] * 22], "policies: 2 of them"),
            ([[0] * 21], r"agent 0 has shape \(21,\), must be \(22,\) of integers or \(22, 5\)"),
            ([[5] * 22], r"agent 0 has actions outside \[0, 5\)"),
            ([np.full((22, 5), 0.3)], "agent 0 has a row that is no distribution"),
        ],
    )
    def test_bad_policies(self, policies, message):
        with pytest.raises(ValueError, match=message):
            memoryless_value(hallway(), policies)

    @pytest.mark.skipif(not BOX_PUSHING.is_file(), reason="BNPRL_REFERENCE_MODELS has no such file")
    def test_box_pushing_by_the_file(self):
        """One row of the file differs from the rule, and this policy passes there."""
        model, policies = (
            bnprl_envs.read_model(BOX_PUSHING),
            [[2, 0, 0, 2, 2, 2], [2, 1, 1, 2, 2, 2]],
        )
        assert memoryless_value(model, policies, 0.9) == pytest.approx(181.984894, abs=1e-6)


class TestDeterministic:
    @pytest.mark.parametrize("terminal", [False, True])
    @pytest.mark.parametrize("seed", range(3))
    def test_the_best_of_all(self, seed, terminal):
        model = team_model(seed, terminal=terminal)
        best = max(
            chain_value(model, joint_policy(np.eye(2)[np.array(actions).reshape(2, 3)]))
            for actions in itertools.product(range(2), repeat=6)
        )
        policies, value = memoryless_joint_policy(model, restarts=60)
        assert value == pytest.approx(best, abs=1e-9)
        assert memoryless_value(model, policies) == value

    @pytest.mark.parametrize(
        ("name", "restarts", "value"),
        [
            ("DecTiger", 50, -20),
            ("RecyclingRobots", 50, 31.9291),
            ("BroadcastChannel", 50, 9.190),
            ("MeetingGrid", 100, 5.8199),
            ("BoxPushing", 1500, 183.1901),
        ],
    )
    def test_figures_of_the_benchmarks(self, name, restarts, value):
        found = memoryless_joint_policy(registered(name), restarts=restarts, discount=0.9)
        assert found.value > value - 1e-3

    def test_tag_is_caught_without_memory(self):
        model = registered("Tag")
        policies, value = memoryless_joint_policy(model, restarts=10)
        env = TabularEnv(model, max_episode_steps=251)
        env.reset(seed=1)
        returns = [episode(env, policies[0]) for _ in range(300)]
        error = np.std(returns) / np.sqrt(len(returns))
        assert value > -13
        assert np.mean(returns) == pytest.approx(value, abs=3 * error)

    def test_the_end(self):
        model = team_model(0)
        seen = []
        memoryless_joint_policy(
            model,
            restarts=None,
            seconds=60,
            on_progress=lambda used, value: seen.append((used, value)),
        )
        used, values = zip(*seen, strict=True)
        assert len(seen) == 10 * 2**6  # ten times the number of policies
        assert list(used) == sorted(used)
        assert list(values) == sorted(values)

    def test_a_seed_fixes_the_search(self):
        first, again = (memoryless_joint_policy(hallway(), restarts=2, seed=3) for _ in range(2))
        assert first == again
        assert first != memoryless_joint_policy(hallway(), restarts=2, seed=4)

    def test_bad_arguments(self):
        with pytest.raises(ValueError, match="restarts: 0, must be at least 1"):
            memoryless_joint_policy(hallway(), restarts=0)
        with pytest.raises(ValueError, match="restarts: None"):
            memoryless_joint_policy(hallway(), restarts=None)
        with pytest.raises(ValueError, match="seconds: -1"):
            memoryless_joint_policy(hallway(), seconds=-1)
        with pytest.raises(ValueError, match="discount: 1"):
            memoryless_joint_policy(hallway(), discount=1.0)
        observed = TabularModel([np.eye(2)], None, np.zeros(1), [0.5, 0.5], 0.9)
        with pytest.raises(ValueError, match="fully observed"):
            memoryless_joint_policy(observed)


def episode(env, actions):
    """Discounted return of one episode of a memoryless policy."""
    observation, _ = env.reset()
    total, factor, finished = 0.0, 1.0, False
    while not finished:
        observation, reward, terminated, truncated, _ = env.step(actions[observation])
        total += factor * reward
        factor *= env.discount
        finished = terminated or truncated
    return total


class TestStochastic:
    @pytest.mark.parametrize("seed", range(3))
    def test_a_local_optimum_above_the_deterministic(self, seed):
        model = team_model(seed, agents=1)
        policy, value = stochastic_memoryless_policy(model, restarts=4)
        assert value == pytest.approx(chain_value(model, policy), abs=1e-12)
        assert value >= memoryless_joint_policy(model, restarts=20).value - 1e-6
        random = np.random.default_rng(seed)
        for _ in range(200):  # nothing nearby is better
            other = policy * np.exp(0.05 * random.normal(size=policy.shape))
            other /= other.sum(axis=1, keepdims=True)
            assert chain_value(model, other) <= value + 1e-8

    def test_hallway(self):
        found = stochastic_memoryless_policy(hallway(), restarts=2)
        assert found.probabilities.shape == (22, 5)
        np.testing.assert_allclose(found.probabilities.sum(axis=1), 1)
        assert found.value > 0.3756
        assert memoryless_value(hallway(), [found.probabilities]) == pytest.approx(found.value)

    def test_going_on_from_a_policy_loses_nothing(self):
        model = hallway()
        policies, value = memoryless_joint_policy(model, restarts=1)
        found = stochastic_memoryless_policy(model, restarts=1, initial=policies[0])
        assert found.value > value + 1e-4
        with pytest.raises(ValueError, match=r"agent 0 has shape \(2,\)"):
            stochastic_memoryless_policy(model, initial=[0, 0])

    def test_randomness_helps_in_the_noisy_maze(self):
        model = registered("NoisyMaze1D")
        best = memoryless_joint_policy(model, restarts=20).value
        found = stochastic_memoryless_policy(model, restarts=3).value
        assert found > best + 0.01
        assert found == pytest.approx(0.690012, abs=1e-5)

    def test_time_and_progress(self):
        seen = []
        stochastic_memoryless_policy(
            hallway(),
            restarts=None,
            seconds=0.3,
            on_progress=lambda used, value: seen.append((used, value)),
        )
        used, values = zip(*seen, strict=True)
        assert list(used) == sorted(used)
        assert list(values) == sorted(values)
        assert used[-1] >= 0.3

    def test_bad_arguments(self):
        with pytest.raises(ValueError, match="model: 2 agents, must be one"):
            stochastic_memoryless_policy(team_model(0))
        with pytest.raises(ValueError, match="restarts: 0"):
            stochastic_memoryless_policy(hallway(), restarts=0)
