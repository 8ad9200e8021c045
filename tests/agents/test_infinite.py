"""The HDP's Gibbs steps, node paths, and the learner whose nodes are born and dropped."""

import itertools
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from bnprl_agents.controllers.episode_pool import Behaviour, EpisodePool, log_probability
from bnprl_agents.controllers.hdp import (
    sample_row_concentration,
    sample_tables,
    sample_top_concentration,
    sample_weights,
)
from bnprl_agents.controllers.hierarchy import (
    Hierarchy,
    among,
    embedded,
    first_hierarchy,
    only,
    resampled,
    shared_out,
)
from bnprl_agents.controllers.infinite import InfiniteRPR
from bnprl_agents.controllers.infinite_settings import InfiniteRPRConfig
from bnprl_agents.controllers.learner import NegativeRewardError
from bnprl_agents.controllers.mcem import (
    MonteCarloEM,
    MonteCarloEMConfig,
    confidence_width,
    last_possible,
    rewards_from,
)
from bnprl_agents.controllers.messages import Counts, backward, forward, running_sum, soft_counts
from bnprl_agents.controllers.paths import path_counts, reward_steps, sample_paths
from bnprl_agents.controllers.rollout import rollout
from bnprl_agents.controllers.value import controller_value
from bnprl_agents.controllers.weighting import by_reward
from bnprl_agents.training import Budget, step_copies
from bnprl_envs.tabular_vector import TabularVectorEnv
from tests.agents.cases import copying_model, random_episodes, random_team

DISCOUNT = 0.9
COPYING = gym.spaces.Discrete(3), gym.spaces.Discrete(2)
PRIOR = (3.0, 1.5)


def stirling(customers):
    """Unsigned Stirling numbers of the first kind, one row."""
    row = [1]
    for n in range(1, customers + 1):
        row = [
            (row[m - 1] if m else 0) + (n - 1) * (row[m] if m < len(row) else 0)
            for m in range(n + 1)
        ]
    return np.array(row, dtype=float)


def test_tables_follow_the_stirling_numbers():
    rng = np.random.default_rng(0)
    weights = np.array([0.7, 2.5])
    counts = np.tile([4.2, 5.0], (40_000, 1))
    drawn = sample_tables(counts, weights, rng)
    for column, weight in enumerate(weights):  # ceil(4.2) = 5 customers, and 5
        p = stirling(5) * weight ** np.arange(6)
        found = np.bincount(drawn[:, column], minlength=6) / len(drawn)
        np.testing.assert_allclose(found, p / p.sum(), atol=0.012)


def test_tables_of_many_customers():
    rng = np.random.default_rng(1)
    drawn = sample_tables(np.full((4000, 1), 5000.0), np.array([1.5]), rng)
    openings = 1.5 / (1.5 + np.arange(5000))
    assert drawn.mean() == pytest.approx(openings.sum(), abs=0.2)
    assert drawn.var() == pytest.approx((openings * (1.0 - openings)).sum(), rel=0.12)
    assert (sample_tables(np.zeros((3, 1)), np.ones(1), rng) == 0).all()


def draw_rows(beta, alpha, top, totals, rng):
    """Rows of Chinese-restaurant counts; the last weight stands for nodes not yet seen."""
    beta, counts = list(beta), np.zeros((len(totals), len(beta) - 1))
    for row, total in enumerate(totals):
        for _ in range(total):
            n_nodes = len(beta) - 1
            p = alpha * np.array(beta)
            p[:n_nodes] += counts[row, :n_nodes]
            node = min(int(np.searchsorted(p.cumsum(), rng.random() * p.sum())), n_nodes)
            if node == n_nodes:
                part = rng.beta(1.0, top)
                beta[-1:] = [beta[-1] * part, beta[-1] * (1.0 - part)]
                counts = np.hstack([counts, np.zeros((len(totals), 1))])
            counts[row, node] += 1
    return np.array(beta), counts


def test_geweke_the_hdp_sampler_leaves_the_prior_invariant():
    """Alternating data | parameters and parameters | data must return the priors' moments."""
    rng = np.random.default_rng(2)
    totals, alpha, top, beta = (6, 3, 8), 2.0, 2.0, np.ones(1)
    chain = []
    for _ in range(2500):
        beta, counts = draw_rows(beta, alpha, top, totals, rng)
        held = counts.sum(axis=0) > 0.0
        counts, weights = counts[:, held], beta[:-1][held]
        tables = sample_tables(counts, alpha * weights, rng)
        beta = sample_weights(tables.sum(axis=0), top, rng)
        alpha = sample_row_concentration(alpha, counts.sum(axis=1), int(tables.sum()), PRIOR, rng)
        top = sample_top_concentration(top, int(held.sum()), int(tables.sum()), PRIOR, rng)
        chain.append((alpha, top, held.sum()))
    direct = []
    for _ in range(1500):
        alpha, top = (rng.gamma(PRIOR[0], 1.0 / PRIOR[1]) for _ in range(2))
        _, counts = draw_rows(np.ones(1), alpha, top, totals, rng)
        direct.append((alpha, top, counts.shape[1]))
    chain, direct = np.array(chain[200:]), np.array(direct)
    blocks = chain[: len(chain) // 50 * 50].reshape(-1, 50, 3).mean(axis=1)
    error = np.hypot(
        blocks.std(axis=0) / np.sqrt(len(blocks)), direct.std(axis=0) / np.sqrt(len(direct))
    )
    difference = chain.mean(axis=0) - direct.mean(axis=0)
    assert (np.abs(difference) < 4.5 * error).all(), (difference, error)
    spread = chain.std(axis=0) / direct.std(axis=0)
    assert ((spread > 0.85) & (spread < 1.15)).all(), spread


def test_sampled_paths_agree_with_the_soft_counts():
    rng = np.random.default_rng(3)
    episodes = random_episodes(rng, (4, 1, 3), (2,), (3,))
    (controller,) = random_team(rng, (3,), (2,), (3,))
    message = forward(episodes, 0, controller)
    shares = by_reward(episodes, [message.likelihood], DISCOUNT).shares
    exact = backward(episodes, 0, controller, message, shares)
    mean = Counts(*(np.zeros_like(table) for table in exact))
    draws = 4000
    for _ in range(draws):
        last, weights = reward_steps(episodes, shares, rng)
        nodes = sample_paths(episodes, 0, controller, message, last, rng)
        counts = path_counts(episodes, 0, controller, nodes, weights)
        mean = Counts(*(m + c / draws for m, c in zip(mean, counts, strict=True)))
    for found, wanted in zip(mean, exact, strict=True):
        np.testing.assert_allclose(found, wanted, atol=0.02)


def test_a_special_state_that_is_occupied_becomes_a_node_and_an_empty_node_goes():
    rng = np.random.default_rng(4)
    hierarchy = first_hierarchy(room=5, nodes=2)
    assert hierarchy.special == 2
    assert hierarchy.active.tolist() == [0, 1, 2]
    counts = Counts(np.zeros((1, 5)), np.zeros((5, 2)), np.zeros((2, 1, 5, 5)))
    counts.initial[0, [0, 2]] = 3.0
    counts.successor[0, 0, 2, 0] = 4.0
    found = resampled(hierarchy, counts, np.array([True, False, True, False, False]), rng)
    assert found.occupied.tolist() == [True, False, True, False, False]
    assert found.special == 1
    assert found.weights[3:].tolist() == [0.0, 0.0]
    assert found.weights.sum() == pytest.approx(1.0)
    full = resampled(hierarchy, counts, np.ones(5, dtype=bool), rng)
    assert full.special is None


def test_an_active_node_keeps_some_weight_where_its_draw_is_zero():
    counts = Counts(np.zeros((1, 4)), np.zeros((4, 2)), np.zeros((2, 1, 4, 4)))
    counts.initial[0, 0] = 9.0  # no table serves the second node
    hierarchy = replace(first_hierarchy(room=4, nodes=2), top=1e-9)
    occupied = np.array([True, True, False, False])
    found = resampled(hierarchy, counts, occupied, np.random.default_rng(0))
    assert (found.weights[found.active] > 0.0).all()
    assert found.weights[1] == found.weights[2] == 1e-12


def test_rewards_are_shared_out_among_the_nodes_that_were_visited_before_them():
    agent, model = learner(), copying_model(DISCOUNT)
    assert sum(agent.occupancies(None)[0]) == 0.0
    rng = np.random.default_rng(0)
    agent.learn(agent.sample(model, episodes=30, horizon=5, rng=rng))
    (occupancy,) = agent.occupancies(None)
    assert occupancy.sum() == pytest.approx(30.0)
    visits = agent.statistics[0].action.sum(axis=1)
    np.testing.assert_allclose(occupancy / 30.0, visits / visits.sum())


def learner(**settings):
    config = InfiniteRPRConfig(**({"nodes": 8, "initial_nodes": 3} | settings))
    return InfiniteRPR(*COPYING, config, discount=DISCOUNT, seed=1)


@pytest.mark.parametrize("schedule", ["batch", "online"])
def test_it_learns_to_use_its_memory(schedule):
    model, rng = copying_model(), np.random.default_rng(5)
    agent = learner(schedule=schedule, batch_episodes=50)
    for _ in range(40 if schedule == "online" else 15):
        metrics = agent.learn(
            rollout(
                model, agent.controllers, episodes=50, horizon=5, rng=rng, explore=agent.explore
            )
        )
    assert controller_value(model, agent.controllers, DISCOUNT) > 6.5  # one node earns 5
    assert metrics["nodes"] >= 2
    special = agent.priors[0].hierarchy.special
    assert special is None or agent.explore[0][special] == 1.0


def test_all_episodes_are_kept_by_the_batch_schedule_alone():
    rng = np.random.default_rng(6)
    for schedule, kept in (("batch", 6), ("online", None)):
        agent = learner(schedule=schedule)
        for _ in range(3):
            agent.learn(random_episodes(rng, (2, 3), (2,), (3,)))
        assert (agent.pool.episodes and agent.pool.episodes.n_episodes) == kept


def test_a_pool_weighs_against_the_mixture_of_what_collected_it():
    model, rng = copying_model(), np.random.default_rng(9)
    teams = [random_team(rng, (3,), (2,), (3,)) for _ in range(2)]
    explore = [(rng.random(3),) for _ in range(2)]
    batches = [
        rollout(model, team, episodes=k, horizon=4, rng=rng, explore=e)
        for team, e, k in zip(teams, explore, (6, 2), strict=True)
    ]
    behaviours = [Behaviour(t, e, k) for t, e, k in zip(teams, explore, (6, 2), strict=True)]
    pool = EpisodePool()
    for batch, behaviour in zip(batches, behaviours, strict=True):
        own = running_sum(batch.offsets, np.log(batch.behaviour[:, 0]))
        np.testing.assert_allclose(log_probability(batch, behaviour), own, atol=1e-5)
        pool.add(batch, behaviour)
    found = running_sum(pool.episodes.offsets, np.log(pool.episodes.behaviour[:, 0]))
    p, q = (np.exp(log_probability(pool.episodes, b)) for b in behaviours)
    np.testing.assert_allclose(np.exp(found), (6 * p + 2 * q) / 8)
    foreign = replace(batches[0], behaviour=np.full_like(batches[0].behaviour, 0.9))
    pool.add(foreign, behaviours[0])
    np.testing.assert_allclose(pool.episodes.behaviour[-foreign.n_steps :], 0.9)
    again = EpisodePool.restored(
        pool.state_arrays(), model.action_sizes, (model.observation_sizes[0] + 1,)
    )
    for one in (pool, again):
        one.add(batches[1], behaviours[1])
    np.testing.assert_array_equal(pool.episodes.behaviour, again.episodes.behaviour)


def test_a_pool_weighs_each_episode_against_the_mixture_or_as_recorded():
    model, rng = copying_model(), np.random.default_rng(9)
    team, explore = random_team(rng, (3,), (2,), (3,)), (rng.random(3),)
    own = rollout(model, team, episodes=3, horizon=4, rng=rng, explore=explore)
    recorded = own.behaviour.copy()
    recorded[:4] = 0.9  # the first episode began under another policy
    pool = EpisodePool()
    pool.add(replace(own, behaviour=recorded), Behaviour(team, explore, 3))
    assert [b.episodes for b in pool.behaviours] == [2]
    np.testing.assert_allclose(pool.episodes.behaviour, recorded, rtol=1e-5)


def test_episodes_of_its_preferred_copies_are_weighed_against_the_mixture():
    agent = learner(batch_episodes=4, outer_iterations=1, divisions=0)
    env = TabularVectorEnv(
        copying_model(), agent.preferred_copies, max_episode_steps=5, autoreset_mode="Disabled"
    )
    list(step_copies(agent, env, Budget(episodes=12), seed=0))
    assert [b.episodes for b in agent.pool.behaviours] == [4, 4, 4]


def test_some_node_is_kept_where_none_has_its_share():
    agent = learner(node_share=0.9, outer_iterations=1)
    episodes = random_episodes(np.random.default_rng(6), (3,) * 30, (2,), (3,))
    for _ in range(2):
        assert agent.learn(episodes)["nodes"] >= 1.0


def test_a_division_keeps_the_counts_and_the_weights():
    rng = np.random.default_rng(10)
    hierarchy = first_hierarchy(room=4, nodes=2)
    grown = hierarchy.divided(1)
    assert grown.occupied.tolist() == [True, True, True, False]
    np.testing.assert_allclose(grown.weights, [1 / 3, 1 / 6, 1 / 6, 1 / 3])
    with pytest.raises(ValueError, match="no room"):
        grown.divided(0).divided(0)
    counts = Counts(rng.random((3, 4)), rng.random((4, 2)), rng.random((2, 3, 4, 4)))
    counts = only(counts, hierarchy.occupied.astype(float))
    shared = shared_out(counts, 1, 2, rng)
    np.testing.assert_allclose(shared.initial.sum(), counts.initial.sum())
    np.testing.assert_allclose(shared.action[1] + shared.action[2], counts.action[1])
    np.testing.assert_allclose(
        shared.successor[:, :, 1:3].sum(axis=2)[..., 1:3].sum(axis=-1), counts.successor[:, :, 1, 1]
    )
    nodes = np.array([0, 2])
    whole = embedded(among(shared, nodes), nodes, 4)
    assert whole.action[1].sum() == 0.0
    np.testing.assert_array_equal(whole.successor[:, :, 2, 0], shared.successor[:, :, 2, 0])


def test_rows_of_controllers_are_proper_whatever_was_born_or_dropped():
    rng = np.random.default_rng(7)
    agent = learner(nodes=5, initial_nodes=1)
    for _ in range(10):
        agent.learn(random_episodes(rng, (4, 6, 2), (2,), (3,)))
        for table in vars(agent.controllers[0]).values():
            np.testing.assert_allclose(table.sum(axis=-1), 1.0)
        hierarchy = agent.priors[0].hierarchy
        assert replace(hierarchy).special == hierarchy.special
        assert isinstance(hierarchy, Hierarchy)


def test_rewards_from_a_step_on():
    rng = np.random.default_rng(8)
    episodes = random_episodes(rng, (3, 2), (2,), (3,))
    wanted = []
    for begin, end in itertools.pairwise(episodes.offsets):
        earned = episodes.rewards[begin:end] * DISCOUNT ** np.arange(end - begin)
        wanted += [earned[t:].sum() for t in range(end - begin)]
    np.testing.assert_allclose(rewards_from(episodes, DISCOUNT), wanted)
    likelihood = np.array([0.5, 0.0, 0.0, 0.3, 0.2])
    assert last_possible(episodes, likelihood).tolist() == [0, 4]


def test_nodes_explore_by_the_width_of_the_bound():
    width = confidence_width(np.array([0.0, 1.0, 99.0]), 0.5)
    np.testing.assert_allclose(width, [1.0, 1.0, 0.5 * np.sqrt(np.log(100.0) / 99.0)])


def test_monte_carlo_em_approaches_em_on_many_episodes():
    rng = np.random.default_rng(9)
    model = copying_model()
    agent = MonteCarloEM(*COPYING, MonteCarloEMConfig(nodes=2), discount=DISCOUNT, seed=0)
    episodes = rollout(model, agent.controllers, episodes=30_000, horizon=4, rng=rng)
    _, wanted = soft_counts(episodes, agent.controllers[0], DISCOUNT)
    agent.learn(episodes)
    for name, table in vars(agent.controllers[0]).items():
        counts = getattr(wanted, name)
        total = counts.sum(axis=-1, keepdims=True)
        seen = total[..., 0] > 0.01 * total.max()
        np.testing.assert_allclose(
            table[seen], (counts / np.where(total, total, 1.0))[seen], atol=0.05
        )


def test_monte_carlo_em_refuses_negative_rewards():
    episodes = random_episodes(np.random.default_rng(8), (3, 2), (2,), (3,))
    episodes.rewards[1] = -2.0
    agent = MonteCarloEM(*COPYING, MonteCarloEMConfig(nodes=2), discount=DISCOUNT, seed=0)
    with pytest.raises(NegativeRewardError, match="reward_shift=2 would do"):
        agent.learn(episodes)


@pytest.mark.parametrize(
    ("config", "settings", "message"),
    [
        (InfiniteRPRConfig, {"initial_nodes": 30}, "initial_nodes: 30, must lie in"),
        (InfiniteRPRConfig, {"node_share": 1.0}, "node_share"),
        (InfiniteRPRConfig, {"schedule": "never"}, "schedule"),
        (InfiniteRPRConfig, {"weighting": "return"}, "weighting: 'return', must be"),
        (MonteCarloEMConfig, {"nodes": 0}, "nodes: 0"),
        (MonteCarloEMConfig, {"confidence": -1.0}, "confidence"),
        (MonteCarloEMConfig, {"successor_concentration": 0.0}, "successor_concentration"),
        (MonteCarloEMConfig, {"reward_shift": np.nan}, "reward_shift"),
        (MonteCarloEMConfig, {"reward_shift": -1.0}, "reward_shift"),
    ],
)
def test_settings_out_of_range(config, settings, message):
    with pytest.raises(ValueError, match=message):
        config(**settings)
