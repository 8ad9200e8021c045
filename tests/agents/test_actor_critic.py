"""The policy gradient through the node filter, and the learner built on it."""

import gymnasium as gym
import numpy as np
import pytest

from bnprl_agents.agent import load
from bnprl_agents.controllers.actor_critic import ActorCritic, ActorCriticConfig
from bnprl_agents.controllers.additive import AdditiveLogits, factorised, random_logits
from bnprl_agents.controllers.gradient import Surrogate, filter_beliefs, surrogate_gradient
from bnprl_agents.controllers.messages import forward
from bnprl_agents.controllers.rollout import rollout
from bnprl_agents.controllers.value import controller_value
from bnprl_envs import model
from tests.agents.cases import random_episodes, random_model

SPACES = gym.spaces.Discrete(4), gym.spaces.Discrete(2)
SIZES = (2,), (4,)


def case(seed):
    """A random controller, its logits, episodes, and a surrogate around another policy."""
    rng = np.random.default_rng(seed)
    logits = random_logits(3, 2, 4, 1.0, rng)
    logits = logits._replace(action=10.0 * logits.action)
    episodes = random_episodes(rng, (4, 1, 6), *SIZES)
    likelihood = filter_beliefs(episodes, 0, factorised(logits)).likelihood
    surrogate = Surrogate(
        advantage=rng.normal(size=11),
        log_old=np.log(likelihood) + rng.normal(scale=0.3, size=11),
        weight=rng.uniform(0.5, 1.5, size=11),
        clip=0.2,
        entropy=0.3,
        bonus=rng.normal(size=3),
    )
    return logits, episodes, surrogate


def objective(logits, episodes, surrogate, chosen):
    """The surrogate as its docstring defines it."""
    controller = logits.controller()
    beliefs = filter_beliefs(episodes, 0, factorised(logits))
    p = beliefs.belief @ controller.action
    ratio = beliefs.likelihood / np.exp(surrogate.log_old)
    clipped = np.clip(ratio, 1 - surrogate.clip, 1 + surrogate.clip)
    gain = np.minimum(ratio * surrogate.advantage, clipped * surrogate.advantage)
    gain -= surrogate.entropy * (p * np.log(p)).sum(axis=1)
    gain += beliefs.belief @ surrogate.bonus
    rows = np.concatenate([np.arange(*episodes.offsets[k : k + 2]) for k in chosen])
    return float((surrogate.weight * gain)[rows].sum())


@pytest.mark.parametrize("seed", range(3))
def test_gradient_equals_finite_differences(seed):
    logits, episodes, surrogate = case(seed)
    chosen = np.array([2, 0]) if seed else np.arange(3)
    gradient = surrogate_gradient(episodes, 0, factorised(logits), surrogate, chosen).gradient
    for field in AdditiveLogits._fields:
        numeric = np.zeros_like(getattr(logits, field))
        for index in np.ndindex(numeric.shape):
            sides = []
            for step in (1e-6, -1e-6):
                moved = getattr(logits, field).copy()
                moved[index] += step
                sides.append(
                    objective(logits._replace(**{field: moved}), episodes, surrogate, chosen)
                )
            numeric[index] = (sides[0] - sides[1]) / 2e-6
        assert np.abs(numeric).max() > 1e-4
        np.testing.assert_allclose(getattr(gradient, field), numeric, atol=1e-7)


def test_some_steps_of_the_case_are_clipped():
    for seed in range(3):
        logits, episodes, surrogate = case(seed)
        likelihood = filter_beliefs(episodes, 0, factorised(logits)).likelihood
        ratio = likelihood / np.exp(surrogate.log_old)
        far = np.where(surrogate.advantage > 0, ratio > 1.2, ratio < 0.8)
        assert 0 < far.sum() < far.size


def test_the_filter_agrees_with_the_e_step():
    logits, episodes, _ = case(0)
    controller = logits.controller()
    beliefs = filter_beliefs(episodes, 0, factorised(logits))
    messages = forward(episodes, 0, controller)
    np.testing.assert_allclose(beliefs.likelihood, messages.likelihood)
    chosen = controller.action[:, episodes.actions[:, 0]].T
    np.testing.assert_allclose(
        beliefs.belief * chosen / beliefs.likelihood[:, None], messages.alpha
    )
    np.testing.assert_allclose(beliefs.final.sum(axis=1), 1.0)


def test_report_of_the_ascent():
    logits, episodes, surrogate = case(0)
    controller = logits.controller()
    chosen = np.array([0, 2])
    rows = np.r_[0:4, 5:11]
    ascent = surrogate_gradient(episodes, 0, factorised(logits), surrogate, chosen)
    beliefs = filter_beliefs(episodes, 0, factorised(logits))
    p = (beliefs.belief @ controller.action)[rows]
    ratio = beliefs.likelihood[rows] / np.exp(surrogate.log_old[rows])
    assert ascent.steps == 10
    assert ascent.entropy == pytest.approx(-(p * np.log(p)).sum(axis=1).mean())
    assert ascent.divergence == pytest.approx((ratio - 1 - np.log(ratio)).mean())


def test_factors_are_the_controller():
    logits = random_logits(3, 2, 4, 1.0, np.random.default_rng(0))
    controller, factors = logits.controller(), factorised(logits)
    product = factors.move[:, None] * factors.sight[:, None] / factors.norm[..., None]
    np.testing.assert_allclose(product, controller.successor)
    np.testing.assert_allclose(factors.action.T, controller.action)
    np.testing.assert_allclose(factors.initial, controller.initial)


def test_a_batch_without_rewards_leaves_the_policy_unchanged_and_says_so():
    agent = ActorCritic(*SPACES, discount=0.9, seed=0)
    episodes = random_episodes(np.random.default_rng(0), (3, 4), *SIZES)
    episodes.rewards[:] = 0.0
    before = agent.controllers
    assert agent.learn(episodes) == {"return_mean": 0.0, "rewardless": 1.0}
    assert agent.controllers is before


def test_learns_what_needs_memory():
    # a memoryless policy earns at most .720 here, the optimum is .824
    maze = model("bnprl/CheeseMaze-v0")
    spaces = gym.spaces.Discrete(maze.n_observations + 1), gym.spaces.Discrete(maze.n_actions)
    agent = ActorCritic(*spaces, ActorCriticConfig(nodes=10), discount=0.95, seed=0)
    rng, steps = np.random.default_rng(0), 0
    while steps < 150_000:
        batch = rollout(
            maze, agent.controllers, episodes=agent.batch_episodes, horizon=251, rng=rng
        )
        steps += batch.n_steps
        agent.learn(batch)
    assert controller_value(maze, agent.controllers, 0.95) > 0.74


def test_negative_rewards_need_no_shift_and_scale_does_not_matter():
    rng = np.random.default_rng(0)
    problem = random_model(rng)
    twins = [ActorCritic(*SPACES, discount=0.9, seed=1) for _ in range(2)]
    for _ in range(3):
        batch = rollout(problem, twins[0].controllers, episodes=20, horizon=30, rng=rng)
        scaled = type(batch)(**(vars(batch) | {"rewards": -128.0 * batch.rewards}))
        plain = type(batch)(**(vars(batch) | {"rewards": -batch.rewards}))
        for agent, episodes in zip(twins, (plain, scaled), strict=True):
            agent.learn(episodes)
        np.testing.assert_allclose(
            twins[0].controllers[0].successor, twins[1].controllers[0].successor, atol=1e-8
        )


def test_a_loaded_learner_goes_on_bit_for_bit(tmp_path):
    rng = np.random.default_rng(0)
    agent = ActorCritic(*SPACES, ActorCriticConfig(nodes=3), discount=0.9, seed=0)
    agent.learn(random_episodes(rng, (3, 4, 5), *SIZES))
    agent.save(tmp_path / "policy.npz")
    twin = load(tmp_path / "policy.npz")
    assert twin.batch_episodes == agent.batch_episodes
    for _ in range(2):
        batch = random_episodes(rng, (6, 4, 5), *SIZES)
        assert agent.learn(batch) == twin.learn(batch)
    for name, table in vars(agent.controllers[0]).items():
        np.testing.assert_array_equal(table, getattr(twin.controllers[0], name))


def test_a_damaged_file_is_refused():
    agent = ActorCritic(*SPACES, ActorCriticConfig(nodes=3), discount=0.9, seed=0)
    arrays = agent.state_arrays()
    arrays["critic_weights_0"] = arrays["critic_weights_0"][:-1]
    with pytest.raises(ValueError, match=r"critic_weights_0: shape \(11, 3\), must be \(12, 3\)"):
        agent.restore(arrays, agent.counters())


def test_a_team_learns_a_controller_each():
    team = {"a": gym.spaces.Discrete(4), "b": gym.spaces.Discrete(3)}
    actions = {"a": gym.spaces.Discrete(2), "b": gym.spaces.Discrete(3)}
    agent = ActorCritic(team, actions, ActorCriticConfig(nodes=3), discount=0.9, seed=0)
    before = agent.controllers
    episodes = random_episodes(np.random.default_rng(0), (3, 4), (2, 3), (4, 3))
    metrics = agent.learn(episodes)
    assert set(metrics) == {"return_mean", "divergence", "entropy"}
    for old, new in zip(before, agent.controllers, strict=True):
        assert np.abs(new.successor - old.successor).max() > 0.0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"nodes": 0}, "nodes: 0, must be at least 1"),
        ({"clip": 0.0}, r"clip: 0\.0, must be positive"),
        ({"entropy": -0.1}, r"entropy: -0\.1"),
        ({"advantage_decay": 1.5}, r"advantage_decay: 1\.5, must lie in \[0, 1\]"),
        ({"learning_rate": np.inf}, "learning_rate: inf"),
    ],
)
def test_settings_out_of_range(settings, message):
    with pytest.raises(ValueError, match=message):
        ActorCriticConfig(**settings)
