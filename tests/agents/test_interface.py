"""The shared interface: acting, recording, predicting, saving, training."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from bnprl_agents.agent import load
from bnprl_agents.belief.predictive_actor_critic import (
    PredictiveActorCritic,
    PredictiveActorCriticConfig,
)
from bnprl_agents.controllers.actor_critic import ActorCritic, ActorCriticConfig
from bnprl_agents.controllers.em import BatchEM, BatchEMConfig
from bnprl_agents.controllers.infinite import InfiniteRPR
from bnprl_agents.controllers.infinite_settings import InfiniteRPRConfig
from bnprl_agents.controllers.learner import NegativeRewardError
from bnprl_agents.controllers.mcem import MonteCarloEM, MonteCarloEMConfig
from bnprl_agents.controllers.online_em import OnlineEM, OnlineEMConfig
from bnprl_agents.controllers.stick_breaking import StickBreaking, StickBreakingConfig
from bnprl_agents.controllers.variational import VariationalBayes, VariationalBayesConfig
from bnprl_agents.history_agent import smallest_reward
from bnprl_agents.policy_files import PolicyFileError
from bnprl_agents.random_agent import RandomAgent
from bnprl_agents.training import Progress, train
from bnprl_envs.model import TabularModel
from bnprl_envs.tabular_vector import TabularVectorEnv
from tests.agents.cases import random_episodes, rewritten

SPACES = gym.spaces.Discrete(3), gym.spaces.Discrete(2)
every_agent = pytest.mark.parametrize(
    "agent_class",
    [
        RandomAgent,
        BatchEM,
        OnlineEM,
        VariationalBayes,
        StickBreaking,
        InfiniteRPR,
        MonteCarloEM,
        ActorCritic,
        PredictiveActorCritic,
    ],
)


class Corridor(gym.Env):
    """Reward 1 and the end after two actions 1 in a row; truncated after 6 steps."""

    observation_space, action_space = SPACES

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.time = self.run = 0
        return 2, {}

    def step(self, action):
        self.time += 1
        self.run = self.run + 1 if action == 1 else 0
        ended = self.run == 2
        return int(action), float(ended), ended, self.time == 6 and not ended, {}


def corridors(n):
    return SyncVectorEnv([Corridor] * n, autoreset_mode=AutoresetMode.DISABLED)


def online(seed=0, **settings):
    config = OnlineEMConfig(**({"nodes": 3, "batch_episodes": 8} | settings))
    return OnlineEM(*SPACES, config, discount=0.9, seed=seed)


@every_agent
def test_a_scalar_is_a_batch_of_one_and_comes_back_as_a_scalar(agent_class):
    env, agent = Corridor(), agent_class(*SPACES, discount=0.9, seed=0)
    observation, _ = env.reset(seed=0)
    agent.reset(observation)
    action = agent.act(observation)
    assert isinstance(action, int)
    observation, reward, terminated, truncated, _ = env.step(action)
    agent.observe(action, reward, observation, terminated, truncated)
    assert agent.update() == {}
    action, _ = agent.predict(observation)
    assert isinstance(action, int)


def test_teams_exchange_dicts():
    observation_space = {"a": gym.spaces.Discrete(3), "b": gym.spaces.Discrete(2)}
    action_space = {"a": gym.spaces.Discrete(2), "b": gym.spaces.Discrete(4)}
    agent = OnlineEM(
        observation_space,
        action_space,
        OnlineEMConfig(nodes=2, batch_episodes=1),
        discount=0.9,
        seed=0,
    )
    agent.reset({"a": 2, "b": 1})
    action = agent.act({"a": 2, "b": 1})
    assert set(action) == {"a", "b"}
    assert action["b"] in action_space["b"]
    shared = (
        {"a": 1.0, "b": 1.0},
        {"a": 0, "b": 1},
        {"a": True, "b": True},
        {"a": False, "b": False},
    )
    agent.observe(action, *shared)
    assert agent.update()["return_mean"] == 1.0
    batch = {"a": np.array([2, 0]), "b": np.array([1, 0])}
    actions, state = agent.predict(batch)
    assert actions["a"].shape == (2,)
    again, _ = agent.predict(batch, state, np.array([True, False]))
    assert set(again) == {"a", "b"}


def test_a_reward_that_differs_between_agents_is_refused():
    spaces = {"a": gym.spaces.Discrete(2), "b": gym.spaces.Discrete(2)}
    agent = RandomAgent(spaces, spaces, discount=0.9, seed=0)
    agent.reset({"a": 0, "b": 0})
    no = {"a": False, "b": False}
    with pytest.raises(ValueError, match="reward: differs between agents"):
        agent.observe({"a": 0, "b": 0}, {"a": 0.0, "b": 1.0}, {"a": 0, "b": 0}, no, no)


def test_the_whole_collection_reaches_update_with_true_next_observations():
    env, agent = corridors(3), online(batch_episodes=5)
    seen = []
    agent.learn = lambda episodes: seen.append(episodes) or {"learned": 1.0}
    for progress in train(agent, env, seed=0, episodes=40):
        assert progress.episodes >= 0
    for batch in seen:
        assert (batch.observations[batch.offsets[:-1], 0] == 2).all()
        later = np.delete(np.arange(batch.n_steps), batch.offsets[:-1])
        np.testing.assert_array_equal(batch.observations[later, 0], batch.actions[later - 1, 0])
        last = batch.offsets[1:] - 1
        np.testing.assert_array_equal(batch.final_observations[:, 0], batch.actions[last, 0])
        np.testing.assert_array_equal(batch.terminated, batch.rewards[last] == 1.0)
        assert (batch.lengths[~batch.terminated] == 6).all()
    assert sum(batch.n_episodes for batch in seen) >= 40 - 7


def test_training_improves_the_policy():
    agent = online(batch_episodes=20)
    returns = [
        p.metrics["return_mean"]
        for p in train(agent, corridors(8), seed=0, episodes=2000)
        if p.metrics
    ]
    assert np.mean(returns[-5:]) > 0.87 > 0.8 > np.mean(returns[:3])


@pytest.mark.parametrize("budget", [{}, {"episodes": 1, "steps": 1}, {"steps": 0}])
def test_the_budget_is_one_positive_number(budget):
    with pytest.raises(ValueError, match="give one of them"):
        next(iter(train(online(), corridors(1), seed=0, **budget)))


def test_autoreset_must_be_off():
    with pytest.raises(ValueError, match="autoreset_mode"):
        train(online(), SyncVectorEnv([Corridor]), seed=0, steps=10)


def test_the_steps_budget_is_never_exceeded():
    *_, last = train(online(), corridors(4), seed=0, steps=1001)
    assert 997 < last.steps <= 1001


def test_the_last_smaller_batch_of_a_stepwise_budget_is_learned_from():
    agent, seen = online(batch_episodes=1000), []
    agent.learn = lambda episodes: seen.append(episodes.n_episodes) or {"learned": 1.0}
    *_, last = train(agent, corridors(4), seed=0, steps=200)
    assert last.metrics == {"learned": 1.0}
    assert seen == [last.episodes]
    assert last.steps == 200


def small_model(reward=1.0):
    """One state that ends with probability .5 a step."""
    transition = np.array([[[0.5, 0.5], [0.0, 1.0]]] * 2)
    rewards = np.zeros((2, 2, 2, 1))
    rewards[1, 0] = reward
    return TabularModel(
        transition, np.ones((2, 2, 1)), rewards, [1.0, 0.0], 0.9, terminal=[False, True]
    )


def small_agent(**settings):
    spaces = gym.spaces.Discrete(2), gym.spaces.Discrete(2)
    config = OnlineEMConfig(**({"nodes": 2, "batch_episodes": 10} | settings))
    return OnlineEM(*spaces, config, discount=0.9, seed=0)


def compiled(model, agent, **budget):
    env = TabularVectorEnv(model, 1, max_episode_steps=20, autoreset_mode="Disabled")
    return list(train(agent, env, seed=0, **budget))


@pytest.mark.parametrize("steps", [3, 50, 1001])
def test_the_compiled_path_uses_the_steps_budget_up_to_an_episode(steps):
    agent = small_agent()
    *_, last = compiled(small_model(), agent, steps=steps)
    assert steps - 20 < last.steps <= steps
    assert agent.episodes == last.episodes > 0
    assert last.metrics


def test_a_budget_that_holds_no_episode_teaches_nothing():
    model = small_model().replace(terminal=[False, False])
    assert compiled(model, small_agent(), steps=19) == [Progress(0, 0, reward=0.0)]


def test_negative_rewards_are_refused_before_anything_is_run():
    env_model = small_model(reward=-2.5)
    with pytest.raises(NegativeRewardError, match=r"reward_shift=2\.5 would do") as refused:
        compiled(env_model, small_agent(), steps=100)
    assert refused.value.shift == 2.5
    assert compiled(env_model, small_agent(reward_shift=2.5), steps=100)[-1].metrics


def test_a_discount_of_1_needs_a_horizon():
    endless, limited = (
        TabularVectorEnv(small_model(), 2, max_episode_steps=limit, autoreset_mode="Disabled")
        for limit in (None, 3)
    )
    spaces = endless.single_observation_space, endless.single_action_space
    agent = OnlineEM(*spaces, discount=1.0, seed=0)
    with pytest.raises(ValueError, match="discount: 1, but the environment has no horizon"):
        train(agent, endless, seed=0, episodes=1)
    assert list(train(agent, limited, seed=0, episodes=1))


def test_a_shift_with_a_discount_of_1_is_refused_where_episodes_end():
    agent = OnlineEM(*SPACES, OnlineEMConfig(reward_shift=1.0), discount=1.0, seed=0)
    episodes = random_episodes(np.random.default_rng(0), (3, 2), (2,), (3,))
    episodes.terminated[:] = True
    with pytest.raises(ValueError, match="reward_shift: 1, with a discount of 1"):
        agent.learn(episodes)


def test_a_negative_reward_is_refused_at_the_first_step():
    agent = online()
    agent.reset(2)
    with pytest.raises(NegativeRewardError, match=r"reward: -1, .* reward_shift=1 would do"):
        agent.observe(agent.act(2), -1.0, 0, False, False)
    RandomAgent(*SPACES, discount=0.9, seed=0).check_reward(-1.0)


def test_only_rewards_that_can_be_earned_count():
    reward = np.zeros((1, 2, 2, 2))
    reward[:, 0, :, 1] = -5.0  # with an observation that is never made
    model = TabularModel(
        [[[0.5, 0.5], [0.0, 1.0]]],
        [[[1.0, 0.0], [1.0, 0.0]]],
        reward,
        [1.0, 0.0],
        0.9,
        terminal=[False, True],
    )
    assert smallest_reward(model) == 0.0


@pytest.mark.parametrize("bad", [1.5, np.nan, np.array([0.0, 0.5]), "one"])
def test_observations_that_are_no_integers_are_refused(bad):
    agent = online()
    with pytest.raises(ValueError, match=r"observation: .* must be an integer"):
        agent.reset(bad)
    agent.reset(1.0)


def test_predict_filters_the_history_and_restarts_where_told():
    agent = online()
    controller = agent.controllers[0]
    _, state = agent.predict(np.array([2, 2]), deterministic=True)
    action = state.action[:, 0].copy()
    _, later = agent.predict(np.array([0, 1]), state, np.array([False, True]), deterministic=True)
    wanted = controller.advance(controller.begin(np.array([2, 2])), action, np.array([0, 1]))
    np.testing.assert_allclose(later.belief[0], wanted[0])
    np.testing.assert_allclose(later.belief[1], controller.begin(np.array([1]))[0])
    np.testing.assert_allclose(state.belief, controller.begin(np.array([2, 2])))


def test_predict_does_not_disturb_learning():
    def actions(peek):
        agent, env = online(), corridors(2)
        observation, _ = env.reset(seed=0)
        agent.reset(observation)
        if peek:
            agent.predict(observation)
        return agent.act(observation).tolist()

    assert actions(True) == actions(False)


def test_acting_needs_a_running_episode():
    agent = online()
    with pytest.raises(RuntimeError, match="reset"):
        agent.act(0)
    agent.reset(2)
    agent.observe(0, 0.0, 0, True, False)
    with pytest.raises(RuntimeError, match="reset"):
        agent.act(0)


def test_bad_spaces_and_values_are_refused():
    box = gym.spaces.Box(0.0, 1.0, (2,))
    with pytest.raises(ValueError, match=r"observation_space: Box.*discretise"):
        OnlineEM(box, SPACES[1], discount=0.9, seed=0)
    with pytest.raises(ValueError, match="same agents"):
        OnlineEM({"a": SPACES[0]}, {"b": SPACES[1]}, discount=0.9, seed=0)
    with pytest.raises(ValueError, match=r"discount: 0\.0"):
        OnlineEM(*SPACES, discount=0.0, seed=0)
    with pytest.raises(ValueError, match="config: BatchEMConfig, must be OnlineEMConfig"):
        OnlineEM(*SPACES, BatchEMConfig(), discount=0.9, seed=0)
    agent = online()
    with pytest.raises(ValueError, match="observation: 3 of agent 0 lies outside"):
        agent.reset(3)
    agent.reset(2)
    with pytest.raises(ValueError, match="action: -1"):
        agent.observe(-1, 0.0, 0, False, False)
    with pytest.raises(ValueError, match="reward: nan"):
        agent.observe(1, np.nan, 0, False, False)


def history(agent, env, observation, steps):
    """Act, observe and update; return everything that could differ."""
    trace = []
    for _ in range(steps):
        action = agent.act(observation)
        observation, reward, terminated, truncated, _ = env.step(action)
        agent.observe(action, reward, observation, terminated, truncated)
        trace.append((action.tolist(), agent.update()))
        ended = terminated | truncated
        if ended.any():
            observation, _ = env.reset(options={"reset_mask": ended})
            agent.reset(observation, ended)
    return observation, trace


@pytest.mark.parametrize(
    ("agent_class", "config"),
    [
        (RandomAgent, None),
        (BatchEM, BatchEMConfig(nodes=3, batch_episodes=7)),
        (OnlineEM, OnlineEMConfig(nodes=3, batch_episodes=7)),
        (ActorCritic, ActorCriticConfig(nodes=3, batch_steps=20)),
        (VariationalBayes, VariationalBayesConfig(nodes=3, batch_episodes=7)),
        (StickBreaking, StickBreakingConfig(nodes=3, batch_episodes=7)),
        (InfiniteRPR, InfiniteRPRConfig(nodes=6, initial_nodes=3, batch_episodes=7)),
        (MonteCarloEM, MonteCarloEMConfig(nodes=3, batch_episodes=7)),
        (PredictiveActorCritic, PredictiveActorCriticConfig(states=3, batch_steps=20)),
    ],
)
def test_a_loaded_agent_goes_on_bit_for_bit(agent_class, config, tmp_path):
    agent, env = agent_class(*SPACES, config, discount=0.9, seed=0), corridors(3)
    observation, _ = env.reset(seed=0)
    agent.reset(observation)
    observation, _ = history(agent, env, observation, 50)
    agent.save(tmp_path / "policy.npz")
    twin = load(tmp_path / "policy.npz")
    assert twin.config == agent.config
    predicted = [a.predict(observation)[0].tolist() for a in (agent, twin)]
    assert predicted[0] == predicted[1]
    traces = []
    for either in (agent, twin):
        env = SyncVectorEnv([Corridor] * 3, autoreset_mode=AutoresetMode.DISABLED)
        fresh, _ = env.reset(seed=1)
        either.reset(fresh)
        traces.append(history(either, env, fresh, 60)[1])
    assert traces[0] == traces[1]


def test_an_episode_under_way_survives_saving(tmp_path):
    agent = online(batch_episodes=1)
    agent.reset(2)
    agent.observe(1, 0.0, 1, False, False)
    agent.save(tmp_path / "policy.npz")
    twin = load(tmp_path / "policy.npz")
    for either in (agent, twin):
        either.observe(1, 1.0, 1, True, False)
    assert agent.update() == twin.update() != {}
    np.testing.assert_array_equal(agent.controllers[0].successor, twin.controllers[0].successor)


@pytest.mark.parametrize("content", [b"", b"not a zip", b"\x80\x04N.", b"PK\x03\x04broken"])
def test_files_that_hold_no_policy(tmp_path, content):
    path = tmp_path / "policy.npz"
    path.write_bytes(content)
    with pytest.raises(PolicyFileError, match=r"policy\.npz: not a bnprl policy file"):
        load(path)


def tampered(tmp_path, change):
    path = tmp_path / "policy.npz"
    online().save(path)
    return rewritten(path, change)


@pytest.mark.parametrize(
    "change",
    [
        lambda arrays, meta: meta.update(agent="os.system"),
        lambda arrays, meta: meta.update(version=99),
        lambda arrays, meta: meta["config"].update(surprise=1),
        lambda arrays, meta: meta["observation_space"].update(n=7),
        lambda arrays, meta: arrays.pop("action_0"),
        lambda arrays, meta: arrays.update(action_0=np.array([{}], dtype=object)),
        lambda arrays, meta: arrays.update(action_0=arrays["action_0"] * 2),
        lambda arrays, meta: arrays.update(action_0=arrays["action_0"] * np.nan),
        lambda arrays, meta: arrays.update(action_0=arrays["action_0"].astype(complex)),
        lambda arrays, meta: arrays.update(action_0=arrays["action_0"].astype(str)),
        lambda arrays, meta: meta["rng"]["state"].update(state=10**60),
        lambda arrays, meta: meta["counters"].update(updates=[]),
        lambda arrays, meta: meta["counters"].clear(),
    ],
)
def test_tampered_policies_are_refused(tmp_path, change):
    with pytest.raises(PolicyFileError, match="not a bnprl policy file"):
        load(tampered(tmp_path, change))
