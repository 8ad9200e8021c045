"""The M-step, the schedules and the exploration of the EM learners."""

import gymnasium as gym
import numpy as np
import pytest

from bnprl_agents.controllers.controller import Controller
from bnprl_agents.controllers.em import BatchEM, BatchEMConfig
from bnprl_agents.controllers.exploration import exploration_suffices, exploring_probability
from bnprl_agents.controllers.filtering import mean_before_acting
from bnprl_agents.controllers.infinite import InfiniteRPR
from bnprl_agents.controllers.learner import shifted
from bnprl_agents.controllers.messages import forward, reward_shares, soft_counts
from bnprl_agents.controllers.nested_em import inner_em
from bnprl_agents.controllers.online_em import OnlineEM, OnlineEMConfig
from bnprl_agents.controllers.priors import MaximumLikelihood, maximise
from bnprl_agents.controllers.rollout import rollout
from bnprl_agents.controllers.schedules import blended_value
from bnprl_agents.controllers.value import controller_value
from bnprl_agents.controllers.variational import VariationalBayes
from bnprl_agents.episodes import EpisodeBatch
from tests.agents.cases import random_episodes, random_model, random_team

DISCOUNT = 0.9
SPACES = gym.spaces.Discrete(4), gym.spaces.Discrete(2)


def test_maximise_normalises_and_keeps_rows_without_evidence():
    rng = np.random.default_rng(0)
    episodes = random_episodes(rng, (3, 2), (2,), (4,))
    (controller,) = random_team(rng, (3,), (2,), (4,))
    _, counts = soft_counts(episodes, controller, DISCOUNT)
    improved = maximise(counts, controller)
    for name, table in vars(improved).items():
        np.testing.assert_allclose(table.sum(axis=-1), 1.0)
        empty = getattr(counts, name).sum(axis=-1) == 0.0
        np.testing.assert_array_equal(table[empty], getattr(controller, name)[empty])
        filled = getattr(counts, name)[~empty]
        np.testing.assert_allclose(table[~empty], filled / filled.sum(axis=-1, keepdims=True))
    assert (counts.successor.sum(axis=-1) == 0.0).any(), "the case has rows without evidence"


@pytest.mark.parametrize("seed", range(3))
def test_em_never_lowers_the_empirical_value(seed):
    rng = np.random.default_rng(seed)
    sizes = (2, 3), (3, 2)
    episodes = random_episodes(rng, tuple(rng.integers(1, 8, size=30)), *sizes)
    em = MaximumLikelihood()
    team, values = [em.around(c) for c in random_team(rng, (3, 2), *sizes)], []
    for _ in range(15):
        messages = [forward(episodes, n, p.geometric) for n, p in enumerate(team)]
        value, nu = reward_shares(episodes, [m.likelihood for m in messages], DISCOUNT)
        values.append(value)
        team, _ = inner_em(episodes, team, messages, nu, 3, lambda _, s, old: em.update(s, old))
    assert (np.diff(values) >= -1e-12 * np.abs(values[1:])).all()
    assert values[-1] > 1.2 * values[0]


def test_value_of_on_policy_data_converges_to_the_exact_value():
    rng = np.random.default_rng(1)
    model = random_model(rng)
    team = random_team(rng, (2,), (2,), (4,))
    explore = [np.array([0.5, 0.2])]
    episodes = rollout(model, team, episodes=40_000, horizon=100, rng=rng, explore=explore)
    value, _ = soft_counts(episodes, team, DISCOUNT)
    assert value == pytest.approx(controller_value(model, team, DISCOUNT), rel=0.03)


def test_exploration_follows_the_beta_distribution():
    rng = np.random.default_rng(2)
    drawn = np.array([exploring_probability(np.array([0.0, 6.0]), 2.0, rng) for _ in range(4000)])
    assert (drawn[:, 0] == 1.0).all()
    assert drawn[:, 1].mean() == pytest.approx(2.0 / 8.0, abs=0.01)


def test_the_share_that_explores_is_that_of_the_behaviour():
    two_nodes = Controller(
        np.full((4, 2), 0.5), np.array([[1.0, 0.0], [0.5, 0.5]]), np.ones((2, 4, 2, 2)) / 2
    )
    agent = BatchEM(*SPACES, BatchEMConfig(nodes=2), discount=0.9, seed=0)
    episodes = random_episodes(np.random.default_rng(3), (1,) * 8, (2,), (4,))
    for team, explore, share in ((two_nodes, [0.2, 0.8], 0.5), (blind(0), [1.0], 1.0)):
        agent.begin_at([team])
        agent.explore = (np.array(explore),)
        messages = [forward(episodes, 0, team)]
        assert agent.exploring_share(episodes, messages) == pytest.approx(share)


def test_compiled_and_acting_filter_agree():
    rng = np.random.default_rng(4)
    episodes = random_episodes(rng, (6, 5), (2,), (4,))
    free, never = random_team(rng, (3, 3), (2, 2), (4, 4))
    never = Controller(never.initial, np.eye(2)[[0, 0, 0]], never.successor)
    assert (episodes.actions[:4, 0] == 1).any(), "the case has actions that cannot be taken"
    quantity, wanted = rng.random(3), []
    for controller in (free, never):
        for one in (episodes.between(0, 1), episodes.between(1, 2)):
            belief = controller.begin(one.observations[:1, 0])
            wanted.append(belief @ quantity)
            for action, seen in zip(one.actions[:-1, 0], one.observations[1:, 0], strict=True):
                belief = controller.advance(belief, np.array([action]), np.array([seen]))
                wanted.append(belief @ quantity)
    found = [
        mean_before_acting(episodes, 0, c, forward(episodes, 0, c), quantity) for c in (free, never)
    ]
    np.testing.assert_allclose(np.concatenate(found), np.concatenate(wanted))


def test_stopping_rule():
    # threshold (1 - .9) * .5 / 2 = .025
    assert exploration_suffices(0.024, 0.9, 0.5, 2.0)
    assert not exploration_suffices(0.026, 0.9, 0.5, 2.0)
    assert not exploration_suffices(1.0, 0.9, 0.5, 0.0)


def test_shift_leaves_the_differences_between_policies_alone():
    rng = np.random.default_rng(3)
    episodes = random_episodes(rng, (2, 5), (2,), (4,))
    moved = shifted(episodes, 3.0, DISCOUNT)
    difference = moved.returns(DISCOUNT) - episodes.returns(DISCOUNT)
    np.testing.assert_allclose(difference, 3.0 / (1.0 - DISCOUNT))


@pytest.mark.parametrize("learner", [BatchEM, OnlineEM])
def test_learns_on_a_small_model(learner):
    rng = np.random.default_rng(5)
    model = random_model(rng)
    agent = learner(*SPACES, learner.Config(nodes=4, batch_episodes=100), discount=0.9, seed=0)
    before = controller_value(model, agent.controllers, 0.9)
    for _ in range(40):
        agent.learn(
            rollout(
                model, agent.controllers, episodes=100, horizon=50, rng=rng, explore=agent.explore
            )
        )
    best_blind = max(controller_value(model, blind(action), 0.9) for action in range(2))
    assert controller_value(model, agent.controllers, 0.9) > max(before, best_blind)


def blind(action):
    (controller,) = random_team(np.random.default_rng(0), (1,), (2,), (4,))
    return type(controller)(controller.initial, np.eye(2)[[action]], controller.successor)


def test_online_blends_with_the_saved_statistics_once_an_update():
    rng = np.random.default_rng(5)
    config = OnlineEMConfig(nodes=2, batch_episodes=2, inner_iterations=4)
    agent = OnlineEM(*SPACES, config, discount=0.9, seed=0)
    agent.learn(random_episodes(rng, (3, 4), (2,), (4,)))
    saved, value, rate = agent.statistics[0].action.copy(), agent.value, (1 + 2 / 10) ** -0.6
    silent = random_episodes(rng, (3, 4), (2,), (4,))
    silent.rewards[:] = 0.0
    policy = agent.controllers
    assert agent.learn(silent)["unchanged"] == 1.0
    np.testing.assert_allclose(agent.statistics[0].action, saved)
    assert agent.value == pytest.approx((1 - rate) * value)
    for before, after in zip(policy, agent.controllers, strict=True):
        np.testing.assert_allclose(after.action, before.action)


@pytest.mark.parametrize("agent_class", [BatchEM, OnlineEM, VariationalBayes, InfiniteRPR])
def test_episodes_without_reward_leave_the_policy_unchanged_and_say_so(agent_class):
    silent = random_episodes(np.random.default_rng(5), (3, 4), (2,), (4,))
    silent.rewards[:] = 0.0
    agent = agent_class(*SPACES, discount=0.9, seed=0)
    before = agent.controllers[0]
    assert agent.learn(silent)["unchanged"] == 1.0
    for name, table in vars(before).items():
        np.testing.assert_array_equal(getattr(agent.controllers[0], name), table)


def test_batch_keeps_all_episodes_where_told():
    rng = np.random.default_rng(6)
    batches = [random_episodes(rng, (3, 4), (2,), (4,)) for _ in range(3)]
    kept, one = (
        BatchEM(
            *SPACES, BatchEMConfig(nodes=2, batch_episodes=n, keep=n == 2), discount=0.9, seed=0
        )
        for n in (2, 6)
    )
    for batch in batches:
        before = kept.controllers
        kept.learn(batch)
    one.begin_at(before)
    one.learn(EpisodeBatch.concatenate(batches))
    assert kept.kept is not None
    assert kept.kept.n_episodes == 6
    for name, table in vars(one.controllers[0]).items():
        np.testing.assert_allclose(getattr(kept.controllers[0], name), table)


def test_a_part_of_a_batch_moves_the_learners_part_of_the_way():
    rng = np.random.default_rng(6)
    half = random_episodes(rng, (3, 4), (2,), (4,))
    whole, part = (
        BatchEM(*SPACES, BatchEMConfig(nodes=2, batch_episodes=k), discount=0.9, seed=0)
        for k in (2, 4)
    )
    before = part.controllers[0].successor.copy()
    for agent in (whole, part):
        agent.learn(half)
    wanted = (before + whole.controllers[0].successor) / 2
    np.testing.assert_allclose(part.controllers[0].successor, wanted)
    whole, part = (
        OnlineEM(*SPACES, OnlineEMConfig(nodes=2, batch_episodes=k), discount=0.9, seed=0)
        for k in (2, 4)
    )
    for agent in (whole, part):
        agent.learn(half)
    np.testing.assert_allclose(part.statistics[0].action, whole.statistics[0].action)
    np.testing.assert_allclose(part.value, whole.value / 2)


def test_statistics_blend_in_proportion_to_the_values():
    # (1 - .25) 8 + .25 * 40 = 16, of which the new batch has 10
    log_value, share = blended_value(np.log(8.0), np.log(40.0), 0.25)
    assert np.exp(log_value) == pytest.approx(16.0)
    assert share == pytest.approx(10.0 / 16.0)
    assert blended_value(-np.inf, np.log(3.0), 0.5) == pytest.approx((np.log(1.5), 1.0))
    assert blended_value(2.0, 900.0, 1.0) == (900.0, 1.0)


def test_importance_ratios_beyond_the_floating_range_are_learned_from():
    rng = np.random.default_rng(7)
    episodes = random_episodes(rng, (400, 300), (2,), (4,))
    episodes.behaviour[:] = 0.01
    agent = OnlineEM(*SPACES, OnlineEMConfig(nodes=2), discount=0.9, seed=0)
    for _ in range(3):
        agent.learn(episodes)
    assert 709.0 < agent.log_value < np.inf
    assert np.isfinite(agent.controllers[0].successor).all()


def test_online_stops_when_exploring_is_negligible():
    rng = np.random.default_rng(6)
    agent = OnlineEM(*SPACES, OnlineEMConfig(nodes=2, tolerance=100.0), discount=0.9, seed=0)
    for _ in range(2):
        agent.learn(random_episodes(rng, (3, 4), (2,), (4,)))
    policy = agent.controllers
    assert agent.learn(random_episodes(rng, (3, 4), (2,), (4,))) == {"stopped": 1.0}
    assert agent.controllers is policy


def test_online_does_not_stop_where_nothing_has_been_earned():
    rng = np.random.default_rng(6)
    agent = OnlineEM(*SPACES, OnlineEMConfig(nodes=2, tolerance=0.1), discount=0.9, seed=0)
    for earned in (0.0, 0.0, 1.0):
        episodes = random_episodes(rng, (3, 4), (2,), (4,))
        episodes.rewards[:] *= earned
        assert "stopped" not in agent.learn(episodes)
    assert agent.value > 0.0


def test_no_bound_is_reported_where_it_is_infinite():
    agent = BatchEM(*SPACES, BatchEMConfig(nodes=1, weighting="return"), discount=0.9, seed=0)
    agent.begin_at([blind(0)])
    metrics = agent.learn(random_episodes(np.random.default_rng(6), (3, 4), (2,), (4,)))
    assert "bound" not in metrics
    assert np.isfinite(list(metrics.values())).all()


def test_fixed_behaviour_stays_uniform():
    rng = np.random.default_rng(7)
    agent = OnlineEM(*SPACES, OnlineEMConfig(nodes=2, behaviour="uniform"), discount=0.9, seed=0)
    agent.learn(random_episodes(rng, (3, 4), (2,), (4,)))
    np.testing.assert_array_equal(agent.explore[0], 1.0)


@pytest.mark.parametrize(
    ("config", "settings", "message"),
    [
        (BatchEMConfig, {"nodes": 0}, "nodes: 0, must be at least 1"),
        (OnlineEMConfig, {"rate_exponent": 0.5}, r"rate_exponent: 0\.5"),
        (OnlineEMConfig, {"rate_offset": 0.0}, "rate_offset"),
        (OnlineEMConfig, {"behaviour": "greedy"}, "behaviour: 'greedy', must be"),
        (OnlineEMConfig, {"tolerance": -1.0}, "tolerance"),
        (BatchEMConfig, {"exploration_prior": 0.0}, "exploration_prior"),
        (BatchEMConfig, {"reward_shift": np.inf}, "reward_shift"),
        (BatchEMConfig, {"reward_shift": -1.0}, "reward_shift: -1.0, must be"),
        (BatchEMConfig, {"keep": True, "weighting": "linear"}, "weighting: 'linear', must be"),
    ],
)
def test_settings_out_of_range(config, settings, message):
    with pytest.raises(ValueError, match=message):
        config(**settings)
