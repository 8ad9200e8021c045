"""The E-step against the literal enumeration of node paths."""

import itertools
import time

import numpy as np
import pytest

from bnprl_agents.controllers.controller import Controller
from bnprl_agents.controllers.messages import Counts, soft_counts
from tests.agents.cases import random_episodes, random_team

SIZES = {"action_sizes": (2, 3), "observation_sizes": (3, 2)}
DISCOUNT = 0.9


def path_probabilities(controller, observations, actions):
    """Joint probability of the actions and every node path z_0..z_t."""
    for path in itertools.product(range(controller.n_nodes), repeat=len(actions)):
        p = controller.initial[observations[0], path[0]] * controller.action[path[0], actions[0]]
        for t in range(1, len(actions)):
            p *= controller.successor[actions[t - 1], observations[t], path[t - 1], path[t]]
            p *= controller.action[path[t], actions[t]]
        yield path, p


def enumerated_counts(episodes, team, discount):
    """Value and counts by summing over k, t and all paths, with no recursion at all."""
    weighted, value = [], 0.0
    for k in range(episodes.n_episodes):
        rows = slice(episodes.offsets[k], episodes.offsets[k + 1])
        seen, done = episodes.observations[rows], episodes.actions[rows]
        for t, reward in enumerate(episodes.rewards[rows]):
            paths = [
                dict(path_probabilities(c, seen[: t + 1, n], done[: t + 1, n]))
                for n, c in enumerate(team)
            ]
            ratio = np.prod([sum(p.values()) for p in paths])
            ratio /= episodes.behaviour[rows][: t + 1].prod()
            weight = discount**t * reward * ratio
            value += weight / episodes.n_episodes
            if weight > 0.0:
                weighted.append((weight, seen, done, paths))
    counts = [Counts(*(np.zeros_like(table) for table in vars(c).values())) for c in team]
    for weight, seen, done, paths in weighted:
        for n, count in enumerate(counts):
            total = sum(paths[n].values())
            for path, p in paths[n].items():
                share = weight / value * p / total
                count.initial[seen[0, n], path[0]] += share
                for tau, z in enumerate(path):
                    count.action[z, done[tau, n]] += share
                for tau in range(len(path) - 1):
                    move = done[tau, n], seen[tau + 1, n], path[tau], path[tau + 1]
                    count.successor[move] += share
    return value, counts


@pytest.mark.parametrize("seed", range(5))
def test_equals_enumeration_of_node_paths(seed):
    rng = np.random.default_rng(seed)
    episodes = random_episodes(rng, (4, 1, 3, 5), **SIZES)
    team = random_team(rng, (3, 2), **SIZES)
    value, counts = soft_counts(episodes, team, DISCOUNT)
    expected_value, expected = enumerated_counts(episodes, team, DISCOUNT)
    assert value == pytest.approx(expected_value, rel=1e-12)
    for count, wanted in zip(counts, expected, strict=True):
        for name, table in wanted._asdict().items():
            np.testing.assert_allclose(getattr(count, name), table, rtol=0, atol=1e-10)


def test_under_normalised_parameters_keep_their_scale():
    """Variational Bayes passes rows that sum to less than 1; that belongs to the likelihood."""
    rng = np.random.default_rng(7)
    episodes = random_episodes(rng, (3, 4), **SIZES)
    team = tuple(
        Controller(0.9 * c.initial, 0.8 * c.action, 0.7 * c.successor)
        for c in random_team(rng, (2, 2), **SIZES)
    )
    value, counts = soft_counts(episodes, team, DISCOUNT)
    expected_value, expected = enumerated_counts(episodes, team, DISCOUNT)
    assert value == pytest.approx(expected_value, rel=1e-12)
    np.testing.assert_allclose(counts[1].successor, expected[1].successor, atol=1e-10)


def test_counts_add_up():
    rng = np.random.default_rng(1)
    episodes = random_episodes(rng, (6, 9, 2), **SIZES)
    _, counts = soft_counts(episodes, random_team(rng, (4, 3), **SIZES), DISCOUNT)
    for count in counts:
        assert count.initial.sum() == pytest.approx(episodes.n_episodes)
        moved_from = count.successor.sum(axis=(0, 1, 3))
        visited = count.action.sum(axis=1)
        assert (moved_from <= visited + 1e-12).all()
        arrived = count.initial.sum(axis=0) + count.successor.sum(axis=(0, 1, 2))
        np.testing.assert_allclose(arrived, visited)


def test_one_controller_comes_back_bare():
    rng = np.random.default_rng(2)
    episodes = random_episodes(rng, (3, 3), (2,), (3,))
    (controller,) = random_team(rng, (2,), (2,), (3,))
    value, count = soft_counts(episodes, controller, DISCOUNT)
    team_value, (team_count,) = soft_counts(episodes, [controller], DISCOUNT)
    assert value == team_value
    np.testing.assert_array_equal(count.action, team_count.action)


def test_impossible_action_carries_no_weight():
    rng = np.random.default_rng(3)
    episodes = random_episodes(rng, (5, 5), (2,), (2,))
    (free,) = random_team(rng, (3,), (2,), (2,))
    never_one = Controller(free.initial, np.eye(2)[[0, 0, 0]], free.successor)
    value, count = soft_counts(episodes, never_one, DISCOUNT)
    expected_value, (expected,) = enumerated_counts(episodes, (never_one,), DISCOUNT)
    assert value == pytest.approx(expected_value)
    assert count.action[:, 1].sum() == 0.0
    np.testing.assert_allclose(count.action, expected.action, atol=1e-10)


def test_no_reward_gives_zero_counts_not_nan():
    rng = np.random.default_rng(4)
    episodes = random_episodes(rng, (3,), (2,), (2,))
    episodes.rewards[:] = 0.0
    value, count = soft_counts(episodes, random_team(rng, (2,), (2,), (2,))[0], DISCOUNT)
    assert value == 0.0
    assert all((table == 0.0).all() for table in count)


def test_huge_importance_ratios_stay_finite():
    rng = np.random.default_rng(5)
    episodes = random_episodes(rng, (900,), (2,), (2,))
    episodes.behaviour[:] = 1e-3
    value, count = soft_counts(episodes, random_team(rng, (2,), (2,), (2,))[0], 1.0)
    assert value == np.inf
    assert count.initial.sum() == pytest.approx(1.0)
    assert np.isfinite(count.successor).all()


def test_bad_input_is_refused_in_one_line():
    rng = np.random.default_rng(6)
    episodes = random_episodes(rng, (3,), (2,), (2,))
    small, large = (random_team(rng, (2,), (a,), (o,))[0] for a, o in ((2, 1), (2, 2)))
    with pytest.raises(ValueError, match="observations: found 0 to 1, must lie in 0 to 0"):
        soft_counts(episodes, small, DISCOUNT)
    with pytest.raises(ValueError, match="2 controllers for 1 agents"):
        soft_counts(episodes, [large, large], DISCOUNT)
    episodes.rewards[0] = -1.0
    with pytest.raises(ValueError, match=r"smallest is -1\.0.*reward_shift"):
        soft_counts(episodes, large, DISCOUNT)


def test_time_is_linear_in_the_steps_with_dense_rewards():
    rng = np.random.default_rng(8)
    (controller,) = random_team(rng, (20,), (3,), (4,))

    def seconds(length):
        episodes = random_episodes(rng, (length,) * 40, (3,), (4,))
        episodes.rewards[:] = 1.0
        soft_counts(episodes, controller, DISCOUNT)
        best = np.inf
        for _ in range(7):
            begin = time.process_time()
            soft_counts(episodes, controller, DISCOUNT)
            best = min(best, time.process_time() - begin)
        return best

    assert min(seconds(400) / seconds(200) for _ in range(3)) < 2.5
