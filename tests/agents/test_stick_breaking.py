"""Stick-breaking priors: closed forms, the corrected updates, the bound, no collapse."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from scipy import stats

from bnprl_agents.agent import load
from bnprl_agents.controllers.controller import random_controller
from bnprl_agents.controllers.initialisation import (
    Graph,
    controllers_from_episodes,
    controllers_of_observations,
    history_tree,
)
from bnprl_agents.controllers.messages import Counts
from bnprl_agents.controllers.priors import node_count
from bnprl_agents.controllers.rollout import rollout
from bnprl_agents.controllers.stick_breaking import StickBreaking, StickBreakingConfig
from bnprl_agents.controllers.stick_breaking_prior import StickBreakingPrior
from bnprl_agents.controllers.sticks import (
    Sticks,
    geometric_rows,
    mean_rows,
    stick_divergence,
    sticks_around,
    tails,
    updated_sticks,
)
from bnprl_agents.controllers.value import controller_value
from bnprl_agents.controllers.weighting import by_return
from bnprl_agents.episodes import EpisodeBatch
from bnprl_agents.training import train
from bnprl_envs.tabular_vector import TabularVectorEnv
from tests.agents.cases import copying_model, random_episodes, random_team

DISCOUNT = 0.9
SIZES = (2, 3), (3, 2)
TEAM = (
    {"a": gym.spaces.Discrete(3), "b": gym.spaces.Discrete(2)},
    {"a": gym.spaces.Discrete(2), "b": gym.spaces.Discrete(3)},
)
COPYING = gym.spaces.Discrete(3), gym.spaces.Discrete(2)
READINGS = {"rate": 1e-6, "scale": 1e6}


def learner(spaces=TEAM, **settings):
    config = StickBreakingConfig(**({"nodes": 4, "weighting": "reward"} | settings))
    return StickBreaking(*spaces, config, discount=DISCOUNT, seed=1)


def random_sticks(rng, shape):
    return Sticks(*(rng.uniform(0.3, 4.0, size=shape) for _ in range(3)))


def test_tails_sum_what_comes_later():
    np.testing.assert_allclose(tails(np.array([[1.0, 2.0, 4.0, 8.0]])), [[14.0, 12.0, 8.0]])


def test_means_of_rows_against_samples():
    rng = np.random.default_rng(0)
    sticks = random_sticks(rng, (3,))
    v = rng.beta(sticks.first, sticks.second, size=(200_000, 3))
    one = np.ones((len(v), 1))
    rows = np.hstack([v, one]) * np.cumprod(np.hstack([one, 1.0 - v]), axis=1)
    np.testing.assert_allclose(mean_rows(sticks), rows.mean(axis=0), atol=0.003)
    geometric = np.exp(np.log(rows).mean(axis=0))
    np.testing.assert_allclose(geometric_rows(sticks), geometric, rtol=0.02)
    assert mean_rows(sticks).sum() == pytest.approx(1.0)


def test_sticks_around_rows_have_them_as_their_mean():
    rows = np.random.default_rng(1).dirichlet(np.ones(5), size=(2, 3))
    np.testing.assert_allclose(mean_rows(sticks_around(rows, 7.0, 0.1)), rows)


def test_divergence_against_samples():
    rng = np.random.default_rng(2)
    sticks, shape, rate = random_sticks(rng, (1,)), 0.6, 0.8
    v = rng.beta(sticks.first, sticks.second, size=400_000)
    sigma = rng.gamma(shape + 1.0, 1.0 / sticks.rate, size=v.size)
    q = stats.beta(sticks.first, sticks.second).logpdf(v) + stats.gamma(
        shape + 1.0, scale=1.0 / sticks.rate
    ).logpdf(sigma)
    p = stats.beta(1.0, sigma).logpdf(v) + stats.gamma(shape, scale=1.0 / rate).logpdf(sigma)
    error = (q - p).std() / np.sqrt(v.size)
    assert stick_divergence(sticks, shape, rate) == pytest.approx((q - p).mean(), abs=4.0 * error)


@pytest.mark.parametrize("rate", READINGS.values(), ids=READINGS)
def test_no_other_sticks_are_better(rate):
    """The corrected tail sums: any slip of an index would leave something to gain."""
    rng = np.random.default_rng(3)
    counts, shape = 3.0 * rng.random((2, 4)), 0.1

    def evidence(sticks):
        return np.sum(counts * np.log(geometric_rows(sticks))) - stick_divergence(
            sticks, shape, rate
        )

    best = updated_sticks(counts, random_sticks(rng, (2, 3)), shape, rate, iterations=3000)
    for _ in range(40):
        moved = Sticks(*(part * rng.uniform(0.9, 1.1, part.shape) for part in best))
        assert evidence(moved) < evidence(best)


def test_one_update_by_hand():
    # psi(2) - psi(3) = -1/2: a stick with count 1, nothing after it, and E Sigma = 1.1 / .55 = 2
    old = Sticks(np.ones(1), np.ones(1), np.array([0.55]))
    found = updated_sticks(np.array([0.0, 0.0]), old, shape=0.1, rate=0.2, iterations=1)
    assert (found.first[0], found.second[0]) == pytest.approx((1.0, 2.0))
    assert found.rate[0] == pytest.approx(0.2 + 0.5)
    found = updated_sticks(np.array([2.0, 3.0]), old, shape=0.1, rate=0.2, iterations=1)
    assert (found.first[0], found.second[0]) == pytest.approx((3.0, 5.0))


def test_rows_without_evidence_keep_their_posterior():
    rng = np.random.default_rng(4)
    prior = StickBreakingPrior(np.full(2, 0.5), 0.1, 1e-6, row_evidence=1e-3)
    old = prior.around(random_controller(3, 2, 4, rng))
    counts = Counts(np.zeros((4, 3)), np.ones((3, 2)), np.zeros((2, 4, 3, 3)))
    counts.initial[1] = 1.0
    counts.successor[1, 2, 0] = (0.0, 5.0, 0.0)
    new = prior.update(counts, old)
    changed = np.abs(new.mean.successor - old.mean.successor).max(axis=-1) > 1e-12
    assert np.argwhere(changed).tolist() == [[1, 2, 0]]
    assert new.mean.successor[1, 2, 0].argmax() == 1
    assert np.abs(new.mean.initial - old.mean.initial).max(axis=-1).argmax() == 1


@pytest.mark.parametrize("reading", READINGS)
@pytest.mark.parametrize("weighting", ["reward", "return", "linear"])
@pytest.mark.parametrize("scale", [0.0, 1.0])
def test_the_bound_never_falls_on_the_same_episodes(reading, weighting, scale):
    rng = np.random.default_rng(5)
    episodes = random_episodes(rng, tuple(rng.integers(1, 8, size=30)), *SIZES)
    agent = learner(
        hyper_reading=reading,
        weighting=weighting,
        temperature=1.0,
        evidence_scale=scale,
        initialisation="random",
    )
    bounds = np.array([agent.learn(episodes)["bound"] for _ in range(40)])
    assert (np.diff(bounds) >= -1e-9 * np.abs(bounds[1:])).all()
    assert bounds[-1] > bounds[0] + 0.1


@pytest.mark.parametrize("reading", READINGS)
@pytest.mark.parametrize("schedule", ["batch", "online"])
def test_it_does_not_collapse_where_memory_pays(reading, schedule):
    model, rng = copying_model(), np.random.default_rng(6)
    agent = learner(COPYING, nodes=6, batch_episodes=100, schedule=schedule, hyper_reading=reading)
    for _ in range(100):
        metrics = agent.learn(
            rollout(
                model, agent.controllers, episodes=100, horizon=20, rng=rng, explore=agent.explore
            )
        )
    assert metrics["nodes"] >= 2
    assert controller_value(model, agent.controllers, DISCOUNT) > 6.5  # one node earns 5


def test_it_uses_one_node_where_memory_does_not_pay():
    rng = np.random.default_rng(7)
    model = copying_model()
    paid = np.zeros((2, 2, 2, 2))
    paid[1] = 1.0
    model = model.replace(reward=paid)
    agent = learner(COPYING, nodes=6, batch_episodes=100, hyper_reading="scale")
    for _ in range(30):
        metrics = agent.learn(
            rollout(
                model, agent.controllers, episodes=100, horizon=50, rng=rng, explore=agent.explore
            )
        )
    assert controller_value(model, agent.controllers, DISCOUNT) > 9.8
    assert metrics["nodes"] <= 3


def test_nodes_are_counted_by_their_part_of_the_reward():
    action = np.array([[3.0, 1.0], [0.0, 0.02], [0.0, 0.0]])
    counts = Counts(np.zeros((1, 3)), action, np.zeros((1, 1, 3, 3)))
    assert [node_count(counts, share) for share in (0.0, 0.001, 0.01)] == [2, 2, 1]


def test_the_tree_of_histories_is_merged_from_its_leaves():
    # two ways to the same last step: (a=0, o=0) and (a=1, o=1), then (a=2, o=0) with reward 1
    runs = [[(0, 0, 0.0), (2, 0, 1.0)], [(1, 1, 0.0), (2, 0, 1.0)], [(1, 0, 0.0), (2, 0, 5.0)]]
    graph = Graph(history_tree(runs, 2))
    assert len(graph.nodes) == 3  # the root, what leads to reward 1, what leads to reward 5
    root = graph.nodes[0]
    ways = {step: graph.index(after) for step, (_, after) in root.next.items()}
    assert ways[0, 0] == ways[1, 1] != ways[1, 0]
    assert root.actions == {0: 1, 1: 2}
    assert len(Graph(history_tree(runs, 1)).nodes) == 1


def test_controllers_from_episodes_repeat_the_best_one():
    rng = np.random.default_rng(8)
    episodes = random_episodes(rng, (3, 3, 3), (3, 2), (4, 3))
    episodes.rewards[:] = 0.0
    episodes.rewards[3:6] = 1.0
    team = random_team(rng, (4, 4), (3, 2), (4, 3))
    seeded = controllers_from_episodes(episodes, team, DISCOUNT, keep=1)
    for n, controller in enumerate(seeded):
        for table in vars(controller).values():
            np.testing.assert_allclose(table.sum(axis=-1), 1.0)
        belief = controller.begin(episodes.observations[[3], n])
        for t in range(3, 6):
            action = episodes.actions[[t], n]
            assert controller.action_probabilities(belief)[0, action[0]] > 0.7
            if t < 5:
                belief = controller.advance(belief, action, episodes.observations[[t + 1], n])


def test_the_history_graph_fits_the_controller():
    rng = np.random.default_rng(9)
    episodes = random_episodes(rng, (40,) * 20, (3,), (4,))
    (controller,) = controllers_from_episodes(
        episodes, random_team(rng, (7,), (3,), (4,)), DISCOUNT, keep=10
    )
    assert controller.n_nodes == 7


def test_learning_can_begin_from_good_episodes():
    rng = np.random.default_rng(10)
    episodes = random_episodes(rng, (3,) * 40, *SIZES)
    seeded, drawn = learner(initialisation="episodes"), learner()
    values = [agent.learn(episodes)["value"] for agent in (seeded, drawn)]
    assert values[0] > values[1]
    again = seeded.controllers
    seeded.learn(EpisodeBatch(**vars(episodes)))
    assert not np.array_equal(again[0].action, seeded.controllers[0].action)


def test_nodes_begin_as_last_observations():
    rng = np.random.default_rng(11)
    drawn = random_team(rng, (3, 6), (2, 2), (5, 4))
    for controller in controllers_of_observations(drawn):
        for rows in (controller.initial, controller.successor):
            np.testing.assert_allclose(rows.sum(axis=-1), 1.0)
        o = np.arange(controller.n_observations)
        assert (controller.initial[o, o % controller.n_nodes] > 0.97).all()
        assert (controller.successor[:, o, :, o % controller.n_nodes] > 0.97).all()


def test_linear_weights_are_those_of_the_return_above_a_baseline():
    rng = np.random.default_rng(12)
    episodes = random_episodes(rng, (1,) * 4, (2,), (2,))
    episodes.rewards[:] = (0.0, 1.0, 1.0, 6.0)  # mean 2, spread sqrt(5.5)
    shares = by_return(episodes, [np.ones(4)], DISCOUNT, 1.5, linear=True).shares
    above = np.maximum(episodes.rewards - 2.0 + np.sqrt(5.5) / 1.5, 0.0)
    np.testing.assert_allclose(shares, above / above.sum())


def test_the_best_of_several_starts_goes_on():
    model, rng = copying_model(), np.random.default_rng(13)
    agent = learner(COPYING, starts=3, start_updates=2, initialisation="random")
    ends = []
    for update in range(1, 7):
        drawn = rollout(model, agent.controllers, episodes=50, horizon=10, rng=rng)
        agent.learn(drawn)
        if update in (2, 4):
            assert agent.best is not None
            ends.append(agent.best)
            assert all((explore == 1.0).all() for explore in agent.explore)
    assert ends[1].earned >= ends[0].earned
    assert (agent.posteriors is ends[1].posteriors) == (agent.earned <= ends[1].earned)
    assert agent.best is None


@pytest.mark.parametrize("updates", [2, 3])
def test_a_budget_that_ends_too_early_goes_on_with_the_best_start(updates):
    model, rng = copying_model(), np.random.default_rng(13)
    agent = learner(COPYING, starts=3, start_updates=2, initialisation="random")
    for update in range(updates):
        drawn = rollout(model, agent.controllers, episodes=50, horizon=10, rng=rng)
        agent.learn(replace(drawn, rewards=drawn.rewards * (update < 2)))
    best = agent.best
    assert agent.posteriors is not best.posteriors
    assert agent.finish() == {}
    assert agent.posteriors is best.posteriors
    assert agent.earned == best.earned


def test_the_compiled_path_goes_on_with_the_best_start_too():
    env = TabularVectorEnv(copying_model(), 1, max_episode_steps=10, autoreset_mode="Disabled")
    agent = learner(COPYING, starts=2, start_updates=1, batch_episodes=20)
    list(train(agent, env, seed=0, episodes=20))
    assert agent.posteriors is agent.best.posteriors


def test_rows_that_are_nearly_deterministic_have_finite_bounds():
    agent = learner(nodes=6, successor_concentration=1e-3, initialisation="random")
    episodes = random_episodes(np.random.default_rng(15), (3,) * 40, *SIZES)
    for _ in range(2):
        metrics = agent.learn(episodes)
        assert "bound" in metrics
        assert np.isfinite(list(metrics.values())).all()


def test_starts_go_on_from_a_file(tmp_path):
    rng = np.random.default_rng(14)
    episodes = random_episodes(rng, (3,) * 40, *SIZES)
    agent = learner(starts=2, start_updates=3)
    for _ in range(4):
        agent.learn(episodes)
    agent.save(tmp_path / "agent.npz")
    again = load(tmp_path / "agent.npz")
    for _ in range(3):
        assert agent.learn(episodes) == again.learn(episodes)
    for one, other in zip(agent.controllers, again.controllers, strict=True):
        np.testing.assert_array_equal(one.successor, other.successor)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"starts": 0}, "starts: 0"),
        ({"starts": 2, "schedule": "online"}, "starts: 2, must be 1"),
        ({"hyper_shape": 0.0}, "hyper_shape"),
        ({"hyper_second": np.inf}, "hyper_second"),
        ({"hyper_reading": "mean"}, "hyper_reading: 'mean', must be"),
        ({"initialisation": "zero"}, "initialisation: 'zero', must be"),
        ({"initial_episodes": 0}, "initial_episodes: 0"),
        ({"row_evidence": -1.0}, "row_evidence"),
        ({"node_share": 1.0}, "node_share"),
    ],
)
def test_settings_out_of_range(settings, message):
    with pytest.raises(ValueError, match=message):
        StickBreakingConfig(**settings)
