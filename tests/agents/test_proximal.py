"""What the actor-critics share: Adam, advantages, the critic, batches, the clip."""

import itertools
from typing import NamedTuple

import numpy as np
import pytest

from bnprl_agents.proximal.adam import Adam
from bnprl_agents.proximal.advantages import advantages, judged, standardised
from bnprl_agents.proximal.config import ProximalConfig, clipped_pull
from bnprl_agents.proximal.critic import Cells, Critic, Histories, history_cells
from bnprl_agents.softmax import softmax, softmax_gradient
from tests.agents.cases import random_episodes

SIZES = (2,), (4,)


class Pair(NamedTuple):
    """Two tables of different shape."""

    row: np.ndarray
    table: np.ndarray


def pair(seed=0):
    rng = np.random.default_rng(seed)
    return Pair(rng.normal(size=3), rng.normal(size=(2, 4)))


def test_adam_moves_by_its_rate_at_first():
    tables = pair()
    gradient = Pair(*(np.full_like(table, -3.0) for table in tables))
    moved, moments = Adam.begin(tables).ascend(tables, gradient, 0.1)
    assert moments.updates == 1
    for before, after in zip(tables, moved, strict=True):
        np.testing.assert_allclose(after, before - 0.1)


def test_the_second_step_of_adam_by_hand():
    tables, moments = pair(), Adam.begin(pair())
    gradients = pair(1), pair(2)
    for gradient in gradients:
        tables, moments = moments.ascend(tables, gradient, 0.1, square_memory=0.99, tiny=1e-3)
    first, second = (gradient.row for gradient in gradients)
    mean = (0.1 * 0.9 * first + 0.1 * second) / (1 - 0.9**2)
    square = (0.01 * 0.99 * first**2 + 0.01 * second**2) / (1 - 0.99**2)
    wanted = pair().row + 0.1 * first / (np.abs(first) + 1e-3)
    wanted += 0.1 * mean / (np.sqrt(square) + 1e-3)
    np.testing.assert_allclose(tables.row, wanted)


def test_decay_pulls_tables_to_zero():
    tables = pair()
    nothing = Pair(*map(np.zeros_like, tables))
    moved, _ = Adam.begin(tables).ascend(tables, nothing, 0.1, decay=0.5)
    for before, after in zip(tables, moved, strict=True):
        np.testing.assert_allclose(after, 0.95 * before)


def test_cells_tell_last_action_and_observation():
    episodes = random_episodes(np.random.default_rng(0), (3, 2), *SIZES)
    cells = history_cells(episodes, 0, 2, 4)
    o, a = episodes.observations[:, 0], episodes.actions[:, 0]
    wanted = [8 + o[0], 4 * a[0] + o[1], 4 * a[1] + o[2], 8 + o[3], 4 * a[3] + o[4]]
    np.testing.assert_array_equal(cells.before, wanted)
    last = episodes.final_observations[:, 0]
    np.testing.assert_array_equal(cells.final, [4 * a[2] + last[0], 4 * a[4] + last[1]])


def test_advantages_by_hand():
    episodes = random_episodes(np.random.default_rng(0), (2, 1), *SIZES)
    episodes.rewards[:] = [1.0, 2.0, 4.0]
    episodes.terminated[:] = [True, False]
    values = np.array([3.0, 5.0, 7.0]), np.array([100.0, 8.0])
    found = advantages(episodes, values, 0.5, 0.8, np.array([1.0, 0.25, 1.0]))
    # ends: 2 - 5 and 4 + .5 * 8 - 7; before: 1 + .5 * 5 - 3 + .5 * .8 * .25 * (2 - 5)
    np.testing.assert_allclose(found, [0.2, -3.0, 1.0])


def test_critic_recovers_a_linear_value_and_shares_it_with_unseen_cells():
    rng = np.random.default_rng(0)
    belief = rng.dirichlet(np.ones(3), size=400)
    cells, weights = rng.integers(2, size=400), np.array([1.0, -2.0, 5.0])
    histories = Histories(belief, belief[:2], Cells(cells, cells[:2]))
    critic = Critic.begin(3, 3).fitted(histories, belief @ weights, 0.9, 1e-6)
    np.testing.assert_allclose(critic.weights, np.tile(weights, (3, 1)), atol=1e-5)
    again = critic.fitted(histories, belief @ weights, 0.5, 1e-6)
    np.testing.assert_allclose(again.precision, 1.5 * critic.precision)
    before, final = critic.values(histories)
    np.testing.assert_allclose(before, belief @ weights, atol=1e-5)
    np.testing.assert_allclose(final, before[:2])


def one_cell(episodes):
    """Cell 0 for every history."""
    return Cells(np.zeros(episodes.n_steps, int), np.zeros(episodes.n_episodes, int))


def test_the_critic_of_a_single_cell_is_ridge_regression_on_fading_evidence():
    rng = np.random.default_rng(0)
    episodes = random_episodes(rng, (30, 20), *SIZES)
    x, y = rng.dirichlet(np.ones(3), size=50), rng.normal(size=50)
    histories = Histories(x, x[:2], one_cell(episodes))
    critic = Critic.begin(1, 3).fitted(histories, y, 0.5, 2.0).fitted(histories, y, 0.5, 2.0)
    wanted = np.linalg.solve(1.5 * x.T @ x + 2.0 * np.eye(3), 1.5 * x.T @ y)
    np.testing.assert_allclose(critic.weights, [wanted])


def test_the_judged_critic_forgets_only_once_a_batch_and_bootstraps_on_itself():
    rng = np.random.default_rng(0)
    episodes = random_episodes(rng, (4, 6), *SIZES)
    belief = rng.dirichlet(np.ones(3), size=10)
    histories = Histories(belief, belief[:2], one_cell(episodes))
    config, on_policy = ProximalConfig(critic_memory=0.5, return_decay=0.0), np.ones(10)
    old = Critic.begin(1, 3).fitted(histories, np.ones(10), 1.0, 1.0)
    critic, advantage = judged(old, episodes, histories, on_policy, config, discount=0.9, ridge=1.0)
    np.testing.assert_allclose(critic.precision, 1.5 * old.precision)
    wanted = old
    for _ in range(2):  # one-step returns
        values = wanted.values(histories)
        delta = advantages(episodes, values, 0.9, 0.0, on_policy)
        wanted = old.fitted(histories, values[0] + delta, 0.5, 1.0)
    np.testing.assert_allclose(critic.weights, wanted.weights)
    by_it = advantages(episodes, critic.values(histories), 0.9, 0.8, on_policy)
    np.testing.assert_allclose(advantage, by_it)


def test_standardised_advantages_have_mean_0_and_a_running_scale():
    rng = np.random.default_rng(0)
    advantage, weight = 5.0 + 3.0 * rng.normal(size=50), rng.uniform(0.5, 1.5, size=50)
    first, scale = standardised(advantage, weight, 0.0)
    assert np.average(first, weights=weight) == pytest.approx(0.0, abs=1e-12)
    assert np.average(first**2, weights=weight) == pytest.approx(1.0)
    again, blended = standardised(advantage, weight, 10.0)
    assert blended == pytest.approx(0.9 * 10.0 + 0.1 * scale)
    np.testing.assert_allclose(again * blended, first * scale)
    np.testing.assert_array_equal(standardised(np.zeros(4), np.ones(4), 0.0)[0], np.zeros(4))


def test_every_pass_visits_every_episode_once():
    rng = np.random.default_rng(0)
    episodes = random_episodes(rng, (5,) * 12, *SIZES)
    config = ProximalConfig(minibatch_steps=20, epochs=2)
    pieces = list(config.minibatches(episodes, rng))
    assert [piece.size for piece in pieces] == [4] * 6
    passes = np.concatenate(pieces).reshape(2, 12)
    np.testing.assert_array_equal(np.sort(passes, axis=1), [np.arange(12)] * 2)
    assert (passes[0] != passes[1]).any()
    assert config.batch_episodes(5.0) == round(1024 / 5)
    assert config.batch_episodes(1e6) == 1


def test_the_pull_is_the_slope_of_the_clipped_surrogate():
    for ratio, advantage in itertools.product((0.5, 0.79, 0.81, 1.0, 1.19, 1.21), (-2.0, 3.0)):
        low, high = (
            min(r * advantage, np.clip(r, 0.8, 1.2) * advantage)
            for r in (ratio * np.exp(-1e-6), ratio * np.exp(1e-6))
        )
        assert clipped_pull(ratio, advantage, 0.2) == pytest.approx((high - low) / 2e-6, abs=1e-6)


def test_softmax_survives_large_logits_and_has_its_gradient():
    np.testing.assert_allclose(softmax(np.array([1e4, 0.0])), [1.0, 0.0])
    rng = np.random.default_rng(0)
    logits, weights = rng.normal(size=(2, 4)), rng.normal(size=(2, 4))
    found = softmax_gradient(softmax(logits), weights)
    for index in np.ndindex(logits.shape):
        step = np.zeros_like(logits)
        step[index] = 1e-6
        change = (softmax(logits + step) - softmax(logits - step)) * weights
        assert found[index] == pytest.approx(change.sum() / 2e-6, abs=1e-8)
