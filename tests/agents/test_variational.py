"""Variational Bayes: closed forms, the bound by brute force, schedules."""

import itertools

import gymnasium as gym
import numpy as np
import pytest

from bnprl_agents.controllers.controller import Controller
from bnprl_agents.controllers.dirichlet import (
    DirichletPrior,
    dirichlet_divergence,
    geometric_mean,
)
from bnprl_agents.controllers.messages import Counts, forward, soft_counts
from bnprl_agents.controllers.rollout import rollout
from bnprl_agents.controllers.value import controller_value
from bnprl_agents.controllers.variational import VariationalBayes, VariationalBayesConfig
from bnprl_agents.controllers.weighting import by_return, by_reward
from bnprl_agents.episodes import EpisodeBatch
from tests.agents.cases import copying_model, random_episodes, random_team

DISCOUNT = 0.9
SIZES = (2, 3), (3, 2)
TEAM = (
    {"a": gym.spaces.Discrete(3), "b": gym.spaces.Discrete(2)},
    {"a": gym.spaces.Discrete(2), "b": gym.spaces.Discrete(3)},
)
COPYING = gym.spaces.Discrete(3), gym.spaces.Discrete(2)


def learner(spaces=TEAM, **settings):
    config = VariationalBayesConfig(**({"nodes": 3, "schedule": "batch"} | settings))
    return VariationalBayes(*spaces, config, discount=DISCOUNT, seed=1)


def test_closed_forms_of_dirichlet_rows():
    # psi(1) - psi(2) = -1, psi(2) - psi(3) = -1/2, psi(1) - psi(3) = -3/2
    np.testing.assert_allclose(geometric_mean(np.array([[1.0, 1.0]])), np.exp([[-1.0, -1.0]]))
    np.testing.assert_allclose(geometric_mean(np.array([2.0, 1.0])), np.exp([-0.5, -1.5]))
    # integral of 2 x ln(2 x) over [0, 1]
    wanted = np.log(2.0) - 0.5
    assert dirichlet_divergence(np.array([2.0, 1.0]), np.ones(2)) == pytest.approx(wanted)
    assert dirichlet_divergence(np.full((4, 3), 0.3), np.full((4, 3), 0.3)) == 0.0


def evidence(posterior, counts):
    """What the M-step maximises: E_q ln p(counts | theta) - KL."""
    tables = zip(counts, vars(posterior.geometric).values(), strict=True)
    return sum(float(np.sum(c * np.log(g))) for c, g in tables) - posterior.divergence


def test_no_other_dirichlet_posterior_is_better():
    rng = np.random.default_rng(0)
    prior = DirichletPrior(np.full(3, 0.4), np.full(2, 0.7))
    counts = Counts(rng.random((2, 3)), 3 * rng.random((3, 2)), rng.random((2, 2, 3, 3)))
    best = prior.update(counts, None)
    for name, table in counts._asdict().items():
        added = table + getattr(prior, "actions" if name == "action" else "nodes")
        np.testing.assert_allclose(best.parameters[name], added)
    for _ in range(20):
        moved = {name: p * rng.uniform(0.8, 1.25, p.shape) for name, p in best.parameters.items()}
        assert evidence(prior.restore(best.mean, moved), counts) < evidence(best, counts)


def enumerated_bound(episodes, geometric):
    """The data's part of (6.2) with explicit node paths, at the best q(z) and nu."""
    terms = []
    for begin, end in itertools.pairwise(episodes.offsets):
        for t in range(begin, end):
            earned = episodes.rewards[t] * DISCOUNT ** (t - begin)
            ratio = 1.0 / np.prod(episodes.behaviour[begin : t + 1])
            for n, c in enumerate(geometric):
                seen, done = episodes.observations[:, n], episodes.actions[:, n]
                total = 0.0
                for path in itertools.product(range(c.n_nodes), repeat=t - begin + 1):
                    p = c.initial[seen[begin], path[0]] * c.action[path[0], done[begin]]
                    for tau in range(1, len(path)):
                        now = begin + tau
                        move = c.successor[done[now - 1], seen[now], path[tau - 1], path[tau]]
                        p *= move * c.action[path[tau], done[now]]
                    total += p
                ratio *= total
            terms.append(earned * ratio)
    nu = np.array(terms) / np.sum(terms)
    kept = nu > 0.0
    # sum of nu ln(r p / nu), the expected log joint plus the entropies, is ln of the mean
    return np.sum(
        nu[kept] * (np.log(np.array(terms)[kept] / episodes.n_episodes) - np.log(nu[kept]))
    )


def test_the_bound_equals_the_one_over_explicit_paths():
    rng = np.random.default_rng(1)
    episodes = random_episodes(rng, (3, 2, 4), *SIZES)
    agent = learner(nodes=2, evidence_scale=2.5)
    geometric = [p.geometric for p in agent.posteriors]
    divergence = sum(p.divergence for p in agent.posteriors)
    found = agent.learn(episodes)["bound"]
    assert found == pytest.approx(2.5 * enumerated_bound(episodes, geometric) - divergence)


@pytest.mark.parametrize("scale", [0.0, 1.0])
@pytest.mark.parametrize("weighting", ["reward", "return"])
@pytest.mark.parametrize("inner", [1, 3])
def test_the_bound_never_falls_on_the_same_episodes(scale, weighting, inner):
    rng = np.random.default_rng(2)
    episodes = random_episodes(rng, tuple(rng.integers(1, 8, size=30)), *SIZES)
    agent = learner(evidence_scale=scale, weighting=weighting, inner_iterations=inner)
    bounds = np.array([agent.learn(episodes)["bound"] for _ in range(25)])
    assert (np.diff(bounds) >= -1e-9 * np.abs(bounds[1:])).all()
    assert bounds[-1] > bounds[0] + 0.1


def test_evidence_accumulates_with_the_episodes_only_where_wanted():
    rng = np.random.default_rng(3)
    batches = [random_episodes(rng, (3, 4), *SIZES) for _ in range(6)]
    totals = {}
    for scale in (1.0, 0.0):
        agent = learner(evidence_scale=scale, schedule="online", batch_episodes=2)
        for batch in batches:
            agent.learn(batch)
        totals[scale] = agent.posteriors[0].parameters["initial"].sum()
    assert totals[1.0] == pytest.approx(1.0 + 3 * 1.0)  # the evidence and three rows' priors
    assert totals[0.0] == pytest.approx(12.0 + 3 * 1.0)


def test_online_after_one_pass_comes_close_to_batch():
    rng = np.random.default_rng(4)
    model, blind, explore = copying_model(), blind_team(), [np.ones(1)]
    parts = [
        rollout(model, blind, episodes=25, horizon=3, rng=rng, explore=explore) for _ in range(100)
    ]
    whole = EpisodeBatch.concatenate(parts)
    values = {}
    for schedule, batches in (("online", parts), ("batch", [whole] * 30)):
        agent = learner(COPYING, schedule=schedule, batch_episodes=25)
        for batch in batches:
            agent.learn(batch)
        values[schedule] = soft_counts(whole, agent.controllers[0], DISCOUNT)[0]
    uniform = soft_counts(whole, blind[0], DISCOUNT)[0]
    assert values["batch"] > 1.5 * uniform
    assert values["online"] - uniform > 0.9 * (values["batch"] - uniform)


def blind_team():
    """One node with uniform actions."""
    return (Controller(np.ones((3, 1)), np.full((1, 2), 0.5), np.ones((2, 3, 1, 1))),)


def trained_value(schedule, **settings):
    model, rng = copying_model(), np.random.default_rng(5)
    agent = learner(COPYING, nodes=4, batch_episodes=100, schedule=schedule, **settings)
    for _ in range(80):
        agent.learn(
            rollout(
                model, agent.controllers, episodes=100, horizon=20, rng=rng, explore=agent.explore
            )
        )
    return controller_value(model, agent.controllers, DISCOUNT)


@pytest.mark.parametrize("schedule", ["batch", "online"])
def test_learns_to_use_its_memory(schedule):
    assert trained_value(schedule) > 7.0  # one node earns 5, the best controller 9.5


def test_evidence_of_one_episode_is_drowned_by_the_prior():
    assert trained_value("batch", evidence_scale=1.0) == pytest.approx(5.0, abs=0.1)


def test_weights_by_return_ignore_shifts_and_fade_with_the_discount():
    rng = np.random.default_rng(6)
    episodes = random_episodes(rng, (3, 3, 3), (2,), (4,))
    (controller,) = random_team(rng, (2,), (2,), (4,))
    likelihood = [forward(episodes, 0, controller).likelihood]
    found = by_return(episodes, likelihood, DISCOUNT, 2.0)
    returns = episodes.returns(DISCOUNT)
    wanted = np.exp(2.0 * (returns - returns.mean()) / returns.std())
    fading = np.array([1.0, DISCOUNT, DISCOUNT**2])
    shares = np.outer(wanted / wanted.sum(), fading / fading.sum())
    np.testing.assert_allclose(found.shares, shares.ravel())
    log_so_far = np.log(likelihood[0]).reshape(3, 3).cumsum(axis=1)
    assert found.fit == pytest.approx(np.sum(shares * log_so_far))
    episodes.rewards[:] -= 7.0
    shifted = by_return(episodes, likelihood, DISCOUNT, 2.0)
    np.testing.assert_allclose(shifted.shares, found.shares)
    with pytest.raises(ValueError, match="rewards"):
        by_reward(episodes, likelihood, DISCOUNT)


def test_equal_returns_say_nothing():
    rng = np.random.default_rng(7)
    episodes = random_episodes(rng, (2, 2), *SIZES)
    episodes.rewards[:] = -1.0
    agent = learner(weighting="return")
    before = agent.controllers
    assert agent.learn(episodes)["unchanged"] == 1.0
    assert agent.controllers is before


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"schedule": "daily"}, "schedule: 'daily', must be"),
        ({"evidence_scale": -1.0}, "evidence_scale: -1"),
        ({"node_prior": 0.0}, "node_prior"),
        ({"action_prior": np.inf}, "action_prior"),
        ({"weighting": "rank"}, "weighting: 'rank', must be"),
        ({"weighting": "return", "batch_episodes": 1}, "batch_episodes: 1, must be at least 2"),
        ({"temperature": 0.0}, "temperature"),
        ({"rate_exponent": 0.5}, "rate_exponent"),
    ],
)
def test_settings_out_of_range(settings, message):
    with pytest.raises(ValueError, match=message):
        VariationalBayesConfig(**settings)
