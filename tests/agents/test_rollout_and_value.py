"""The exact value and the compiled rollout check each other and dense algebra."""

import itertools

import numpy as np
import pytest
import scipy.stats

from bnprl_agents.controllers import rollout as rollout_module
from bnprl_agents.controllers.controller import Controller
from bnprl_agents.controllers.rollout import rollout
from bnprl_agents.controllers.scoring import simulated_returns
from bnprl_agents.controllers.value import controller_value
from tests.agents.cases import random_model, random_team

TEAM = {"action_sizes": (2, 3), "observation_sizes": (2, 3)}


def dense_value(model, team, discount):
    """The value by writing out the whole joint chain over (state, nodes)."""
    nodes = list(itertools.product(*(range(c.n_nodes) for c in team)))
    index = {(s, z): i for i, (s, z) in enumerate(itertools.product(range(model.n_states), nodes))}
    chain, reward = np.zeros((len(index), len(index))), np.zeros(len(index))
    for (s, z), row in index.items():
        if model.terminal[s]:
            continue
        for ja, s2, jo in itertools.product(*map(range, model.observation.shape)):
            a, o = (
                np.unravel_index(ja, model.action_sizes),
                np.unravel_index(jo, model.observation_sizes),
            )
            p = model.transition[ja, s, s2] * model.observation[ja, s2, jo]
            p *= np.prod([c.action[zn, an] for c, zn, an in zip(team, z, a, strict=True)])
            reward[row] += (
                p
                * np.broadcast_to(model.reward, (*model.transition.shape, model.n_observations))[
                    ja, s, s2, jo
                ]
            )
            for z2 in nodes:
                move = [
                    c.successor[an, on, i, j]
                    for c, an, on, i, j in zip(team, a, o, z, z2, strict=True)
                ]
                chain[row, index[s2, z2]] += p * np.prod(move)
    value = np.linalg.solve(np.eye(len(index)) - discount * chain, reward)
    total = 0.0
    for (s, z), row in index.items():
        begin = [c.initial[-1, zn] for c, zn in zip(team, z, strict=True)]
        total += model.start[s] * np.prod(begin) * value[row]
    return total


@pytest.mark.parametrize("terminal", [True, False])
def test_value_equals_the_dense_joint_chain(terminal):
    rng = np.random.default_rng(0)
    model = random_model(rng, 3, **TEAM, terminal=terminal)
    team = random_team(rng, (2, 3), (2, 3), (3, 4))
    assert controller_value(model, team, 0.9) == pytest.approx(
        dense_value(model, team, 0.9), abs=1e-9
    )


def test_value_of_a_fully_observed_model():
    rng = np.random.default_rng(1)
    model = random_model(rng, 4, (2,), (4,))
    mdp = model.replace(observation=None, reward=model.expected_reward[..., None, None])
    (policy,) = random_team(rng, (1,), (2,), (4,))
    p = policy.action[0]
    chain = np.einsum("a,ast->st", p, mdp.transition)
    wanted = model.start @ np.linalg.solve(np.eye(4) - 0.9 * chain, p @ model.expected_reward)
    assert controller_value(mdp, policy, 0.9) == pytest.approx(wanted)


def test_simulated_return_agrees_with_the_exact_value():
    rng = np.random.default_rng(2)
    model = random_model(rng, 4, **TEAM)
    team = random_team(rng, (3, 2), (2, 3), (3, 4))
    episodes = rollout(model, team, episodes=40_000, horizon=200, rng=rng)
    returns = episodes.returns(0.9)
    error = returns.std() / np.sqrt(returns.size)
    assert abs(returns.mean() - controller_value(model, team, 0.9)) < 4 * error


def test_scored_return_agrees_with_the_exact_value():
    rng = np.random.default_rng(2)
    model = random_model(rng, 4, **TEAM)
    team = random_team(rng, (3, 2), (2, 3), (3, 4))
    returns, lengths = simulated_returns(
        model, team, episodes=40_000, horizon=200, discount=0.9, rng=rng
    )
    error = returns.std() / np.sqrt(returns.size)
    assert abs(returns.mean() - controller_value(model, team, 0.9)) < 4 * error
    assert 1 <= lengths.min() < lengths.max() <= 200


def test_scoring_and_rollout_have_one_law():
    """With observations that matter for the reward and a controller that needs its memory."""
    rng = np.random.default_rng(8)
    model = random_model(rng, 4)
    (controller,) = random_team(rng, (3,), (2,), (4,))
    rolled = rollout(model, controller, episodes=20_000, horizon=6, rng=rng)
    scored, lengths = simulated_returns(
        model, controller, episodes=20_000, horizon=6, discount=0.9, rng=rng
    )
    assert scipy.stats.ks_2samp(rolled.returns(0.9), scored).pvalue > 1e-3
    counts = [np.bincount(x, minlength=7)[1:] for x in (rolled.lengths, lengths)]
    assert scipy.stats.chi2_contingency(counts).pvalue > 1e-3


@pytest.mark.parametrize("simulate", [rollout, simulated_returns])
def test_threads_do_not_change_the_result(simulate, monkeypatch):
    model = random_model(np.random.default_rng(5), 4)
    team = random_team(np.random.default_rng(6), (3,), (2,), (4,))
    discount = {"discount": 0.9} if simulate is simulated_returns else {}

    def sampled(threads):
        monkeypatch.setattr(rollout_module, "get_num_threads", lambda: threads)
        rng = np.random.default_rng(0)
        out = simulate(model, team, episodes=300, horizon=9, rng=rng, **discount)
        return (out.rewards if simulate is rollout else out[0]).tolist(), rng.random()

    assert sampled(1) == sampled(4)


def test_episodes_end_at_the_terminal_state_or_the_horizon():
    rng = np.random.default_rng(3)
    model = random_model(rng, 4)
    (controller,) = random_team(rng, (2,), (2,), (4,))
    episodes = rollout(model, controller, episodes=500, horizon=3, rng=rng)
    assert episodes.lengths.max() == 3
    assert (episodes.lengths[~episodes.terminated] == 3).all()
    assert 0 < episodes.terminated.sum() < 500
    first = episodes.observations[episodes.offsets[:-1], 0]
    assert (first == 3).all(), "the null observation comes first"
    later = np.delete(episodes.observations[:, 0], episodes.offsets[:-1])
    assert (later < 3).all(), "and never again"


def test_recorded_behaviour_is_the_mixture_with_exploration():
    rng = np.random.default_rng(4)
    model = random_model(rng, 4)
    (controller,) = random_team(rng, (3,), (2,), (4,))
    explore = np.array([0.0, 0.5, 1.0])
    episodes = rollout(model, controller, episodes=200, horizon=10, rng=rng, explore=[explore])
    for k in range(20):
        belief = None
        for row in range(episodes.offsets[k], episodes.offsets[k + 1]):
            seen = episodes.observations[row]
            belief = (
                controller.begin(seen)
                if belief is None
                else controller.advance(belief, episodes.actions[row - 1], seen)
            )
            exploring = (belief @ explore)[0]
            wanted = (1 - exploring) * controller.action_probabilities(belief) + exploring / 2
            assert episodes.behaviour[row, 0] == pytest.approx(wanted[0, episodes.actions[row, 0]])


def test_rollouts_of_one_seed_are_equal_and_of_two_differ():
    model = random_model(np.random.default_rng(5), 4)
    team = random_team(np.random.default_rng(6), (3,), (2,), (4,))

    def actions(seed):
        rng = np.random.default_rng(seed)
        return rollout(model, team, episodes=50, horizon=9, rng=rng).actions.tolist()

    assert actions(0) == actions(0) != actions(1)


def test_misfits_are_refused():
    rng = np.random.default_rng(7)
    model = random_model(rng, 4)
    (fits,) = random_team(rng, (2,), (2,), (4,))
    (short,) = random_team(rng, (2,), (2,), (3,))
    with pytest.raises(ValueError, match=r"agent 0: 2 actions and 3 observations.* has 2 and 4"):
        rollout(model, short, episodes=1, horizon=1, rng=rng)
    with pytest.raises(ValueError, match="2 controllers for 1 agents"):
        controller_value(model, [fits, fits], 0.9)
    with pytest.raises(ValueError, match="horizon: 0"):
        rollout(model, fits, episodes=1, horizon=0, rng=rng)
    halved = Controller(fits.initial, fits.action / 2, fits.successor)
    with pytest.raises(ValueError, match=r"a row of action is off 1 by 0\.5"):
        controller_value(model, halved, 0.9)
    with pytest.raises(ValueError, match=r"discount: 1\.0"):
        controller_value(model, fits, 1.0)


def test_a_fully_observed_team_is_refused():
    rng = np.random.default_rng(3)
    model = random_model(rng, 4, (2, 2), (2, 2), terminal=False)
    seen = model.replace(observation=None, reward=model.expected_reward[..., None, None])
    team = random_team(rng, (2, 2), (2, 2), (2, 2))
    with pytest.raises(ValueError, match="fully observed model of 2 agents"):
        rollout(seen, team, episodes=1, horizon=2, rng=rng)
    with pytest.raises(ValueError, match="fully observed model of 2 agents"):
        controller_value(seen, team, 0.9)
