"""Batch fitted Q-iteration: divergence and convergence on three nodes, and as an agent."""

import gymnasium as gym
import numpy as np
import pytest

from baselines.experiments.figure_3_1 import largest_errors
from bnprl_agents.gaussian_process.fitted_q_iteration import (
    ActionKernel,
    FittedProcess,
    fitted_q_iteration,
    sufficient_regularization,
)
from bnprl_agents.gaussian_process.gp_fitted_q import GPFittedQ, GPFittedQConfig
from bnprl_agents.gaussian_process.kernels import RadialKernel
from bnprl_agents.training import train
from bnprl_envs import model
from bnprl_envs.planning import policy_value
from bnprl_envs.tabular_vector import TabularVectorEnv


@pytest.fixture(scope="module")
def growth():
    lines = largest_errors(True)
    return {
        label.split()[2].strip(","): (y[0], y[0, 1:] / y[0, :-1]) for label, (_, y) in lines.items()
    }


def test_too_little_noise_diverges(growth):
    error, factor = growth["0.1"]
    assert factor[0] == pytest.approx(1.0224, abs=5e-5)
    assert factor[10:] == pytest.approx(1.0195, abs=5e-4)
    assert error[-1] > 5.0


@pytest.mark.parametrize("noise", ["1", "auto"])
def test_enough_noise_converges(growth, noise):
    error, factor = growth[noise]
    assert (factor < 0.97).all()
    assert error[-1] < 1e-4


def test_auto_is_a_contraction_whatever_the_data():
    rng = np.random.default_rng(0)
    for _ in range(5):
        n = 40
        points, actions = rng.random((n, 2)), rng.integers(3, size=n)
        kernel = ActionKernel(RadialKernel((0.5, 0.5)), joint=False)
        process = FittedProcess(kernel, points, actions, "auto")
        fit = fitted_q_iteration(
            process,
            rng.normal(size=n),
            rng.random((n, 2)),
            rng.random(n) < 0.1,
            10 * rng.normal(size=(n, 3)),
            discount=0.9999,
            sweeps=300,
            precision=1e-9,
        )
        assert not fit.diverged
        assert fit.changes[-1] <= 1e-9


def test_theorem_4_by_hand():
    gram = np.array([[2.0, 0.5, 0.0], [0.5, 2.0, 1.0], [0.0, 1.0, 2.0]])
    assert sufficient_regularization(gram) == pytest.approx(2 * (3.5 - 2.0))


def three_nodes_agent(steps=100, **settings):
    config = GPFittedQConfig(
        bandwidth=(1.0,),
        inputs="joint",
        grid_columns=3,
        initial_value=1.0,
        fit_every=50,
        **settings,
    )
    env = TabularVectorEnv(
        "bnprl/ThreeNodes-v0", 1, max_episode_steps=100, autoreset_mode="Disabled"
    )
    agent = GPFittedQ(
        env.single_observation_space, env.single_action_space, config, discount=0.9999, seed=0
    )
    metrics = [p.metrics for p in train(agent, env, seed=0, steps=steps) if p.metrics]
    return agent, metrics


def test_divergence_is_reported_and_nothing_bad_is_kept():
    agent, metrics = three_nodes_agent(regularization=0.5)
    assert metrics[-1]["diverged"] == 1.0
    assert np.isfinite(agent.action_values(np.arange(3))).all()


def test_auto_learns_on_three_nodes():
    agent, metrics = three_nodes_agent()
    assert metrics[-1]["diverged"] == 0.0
    assert np.abs(agent.action_values(np.arange(3))).max() < 0.5


def test_the_last_transitions_are_fitted_when_the_budget_ends():
    agent, metrics = three_nodes_agent(steps=20)
    assert len(metrics) == 1
    assert (agent.action_values(np.arange(3)) != 1.0).any()
    assert agent.finish() == {}  # nothing is pending


def test_too_small_a_regularization_is_refused_where_tuples_repeat():
    with pytest.raises(ValueError, match="regularization: 1e-17, too small for tuples that repeat"):
        three_nodes_agent(regularization=1e-17)


def test_it_learns_gridworld():
    env = TabularVectorEnv(
        "bnprl/Gridworld-v0", 1, max_episode_steps=200, autoreset_mode="Disabled"
    )
    config = GPFittedQConfig(
        regularization=0.01, bandwidth=(0.3,), grid_columns=5, fit_every=200, capacity=600
    )
    agent = GPFittedQ(
        env.single_observation_space, env.single_action_space, config, discount=0.9, seed=0
    )
    for _ in train(agent, env, seed=0, steps=1000):
        pass
    world = model("bnprl/Gridworld-v0")
    assert policy_value(world, agent.greedy_policy(np.arange(25))) == pytest.approx(
        0.4378, abs=1e-4
    )


@pytest.mark.parametrize(
    "settings",
    [
        {"regularization": 0.0},
        {"regularization": "none"},
        {"sweeps": 0},
        {"capacity": 0},
        {"initial_value": np.inf},
        {"bandwidth": (-1.0,)},
        {"inputs": "both"},
    ],
)
def test_bad_settings(settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        GPFittedQConfig(**settings)


def test_bandwidths_must_fit_the_dimensions():
    with pytest.raises(ValueError, match="bandwidth: 3 values, must be one or 2"):
        GPFittedQ(
            gym.spaces.Box(0.0, 1.0, (2,)),
            gym.spaces.Discrete(2),
            GPFittedQConfig(bandwidth=(1.0, 1.0, 1.0)),
            discount=0.9,
            seed=0,
        )
