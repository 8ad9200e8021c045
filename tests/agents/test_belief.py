"""Actor-critic on a learned belief: gradients, filter, likelihood, resuming, learning."""

import itertools
import json

import gymnasium as gym
import numpy as np
import pytest

from baselines.benchmarks.pomdp_learners import Goal, run
from bnprl_agents.agent import load
from bnprl_agents.belief.filtering import Sequences, filter_gradient, run_filter
from bnprl_agents.belief.gradient import (
    Surrogate,
    filtered,
    policy_gradient,
    prediction_gradient,
)
from bnprl_agents.belief.policy import FilterLogits, random_logits
from bnprl_agents.belief.predictive_actor_critic import (
    PredictiveActorCritic,
    PredictiveActorCriticConfig,
)
from bnprl_agents.belief.rollout import belief_rollout
from tests.agents.cases import random_episodes, random_model

STATES, MEMORY, ACTIONS, OBSERVATIONS = 3, 2, 2, 3
SPACES = gym.spaces.Discrete(OBSERVATIONS), gym.spaces.Discrete(ACTIONS)
EVERY = np.arange(3)


def case(seed=0):
    rng = np.random.default_rng(seed)
    episodes = random_episodes(rng, (4, 1, 5), (ACTIONS,), (OBSERVATIONS,))
    ends = np.array([True, False, False])
    episodes = type(episodes)(**(vars(episodes) | {"terminated": ends}))
    return rng, episodes, random_logits(STATES, MEMORY, ACTIONS, OBSERVATIONS, rng)


def beliefs_of(episodes, policy):
    """Of model and memory, before each action."""
    return np.concatenate([way.before for way in filtered(Sequences.of(episodes), policy)], axis=1)


def likelihood_of(episodes, model, k):
    """Sum over all paths of hidden states; the policy's factors left out."""
    begin, end = episodes.offsets[k], episodes.offsets[k + 1]
    seen = [*episodes.observations[begin:end, 0], episodes.final_observations[k, 0]]
    actions = episodes.actions[begin:end, 0]
    length = len(actions) + (not episodes.terminated[k])
    total = 0.0
    for path in itertools.product(range(STATES), repeat=length):
        p = model.initial[seen[0], path[0]]
        for t in range(length - 1):
            i, j = path[t], path[t + 1]
            p *= model.transition[actions[t], i, j] * model.emission[seen[t + 1], j]
        if episodes.terminated[k]:
            p *= model.termination[actions[-1], path[-1]]
        total += p
    return total


def test_the_likelihood_is_the_sum_over_all_paths():
    _, episodes, logits = case()
    model = logits.policy().model
    for k in EVERY:
        some, rows = Sequences.of(episodes).chosen(np.array([k]))
        found, *_ = prediction_gradient(some, model, np.zeros((ACTIONS, STATES)), 1.0, 1.0)
        assert found * rows.size == pytest.approx(np.log(likelihood_of(episodes, model, k)))


def test_chosen_sequences_are_those_of_the_chosen_episodes():
    _, episodes, _ = case()
    some, rows = Sequences.of(episodes).chosen(np.array([2, 0]))
    assert rows.tolist() == [*range(5, 10), *range(4)]
    joined = type(episodes).concatenate([episodes.between(2, 3), episodes.first(1)])
    for found, wanted in zip(some, Sequences.of(joined), strict=True):
        assert found.tolist() == wanted.tolist()


def assert_slope(table, gradient, objective):
    """Compare a gradient by a table with central differences of objective(table)."""
    for index in np.ndindex(table.shape):
        step = np.zeros_like(table)
        step[index] = 1e-5
        numeric = (objective(table + step) - objective(table - step)) / 2e-5
        assert gradient[index] == pytest.approx(numeric, abs=1e-7)


def surrogate_of(episodes, logits, surrogate):
    """The policy's objective a step, written with the acting filter."""
    policy = logits.policy()
    p = policy.action_probabilities(beliefs_of(episodes, policy), episodes.observations[:, 0])
    taken = np.take_along_axis(p, episodes.actions, axis=1)[:, 0]
    total = (taken / surrogate.behaviour * surrogate.advantage).sum()
    total += surrogate.barrier * np.log(p).mean(axis=1).sum()
    return (total - surrogate.entropy * (p * np.log(p)).sum()) / episodes.n_steps


def test_the_policys_gradient_is_that_of_finite_differences():
    rng, episodes, logits = case(1)
    logits = logits._replace(
        action=rng.normal(size=logits.action.shape), sight=rng.normal(size=logits.sight.shape)
    )
    surrogate = Surrogate(rng.normal(size=10), episodes.behaviour[:, 0], 1e9, 0.3, 0.2)
    gradient = policy_gradient(Sequences.of(episodes), logits.policy(), surrogate)
    for name, slope in gradient._asdict().items():
        assert_slope(
            getattr(logits, name),
            slope,
            lambda x, name=name: surrogate_of(episodes, logits._replace(**{name: x}), surrogate),
        )


def test_the_predictions_gradient_is_that_of_finite_differences():
    rng, episodes, logits = case(1)
    sequences, means = Sequences.of(episodes), rng.normal(size=(ACTIONS, STATES))
    _, gradient, by_reward = prediction_gradient(sequences, logits.policy().model, means, 2.0, 0.7)

    def quality(model, means):
        likelihood = sum(np.log(likelihood_of(episodes, model.filter(), k)) for k in EVERY)
        before = run_filter(sequences, model.filter()).before
        expected = (before * means[sequences.actions]).sum(axis=1)
        misses = ((episodes.rewards / 2.0 - expected) ** 2).sum() / 2.0
        return 0.7 * (likelihood - misses) / episodes.n_steps

    for name, slope in gradient._asdict().items():
        assert_slope(
            getattr(logits.model, name),
            slope,
            lambda x, name=name: quality(logits.model._replace(**{name: x}), means),
        )
    assert_slope(means, by_reward, lambda x: quality(logits.model, x))


def test_without_objectives_nothing_moves():
    _, episodes, logits = case(1)
    sequences, model = Sequences.of(episodes), logits.policy().model
    way = run_filter(sequences, model)
    gradient = filter_gradient(sequences, model, way, np.zeros_like(way.before), 0.0)
    assert isinstance(gradient, FilterLogits)
    assert all((table == 0.0).all() for table in gradient)


def test_a_step_beyond_the_clip_does_not_count():
    _, episodes, logits = case(2)
    sequences, policy = Sequences.of(episodes), logits.policy()
    tiny = np.full(10, 1e-3)  # every ratio is far over 1 + clip
    surrogate = Surrogate(np.ones(10), tiny, 0.2, 0.0, 0.0)
    assert all((table == 0.0).all() for table in policy_gradient(sequences, policy, surrogate))
    against = surrogate._replace(advantage=-np.ones(10))
    assert np.abs(policy_gradient(sequences, policy, against).action).max() > 0.0


def test_compiled_and_acting_filter_agree():
    _, episodes, logits = case(3)
    policy, before = logits.policy(), beliefs_of(episodes, logits.policy())
    model, memory = filtered(Sequences.of(episodes), policy)
    final = np.concatenate([model.final, memory.final], axis=1)
    for k in (1, 2):
        begin, end = episodes.offsets[k], episodes.offsets[k + 1]
        belief = policy.begin(episodes.observations[begin : begin + 1, 0])
        for t in range(begin, end):
            assert before[t] == pytest.approx(belief[0], abs=1e-4)
            after = (
                episodes.observations[t + 1, 0]
                if t + 1 < end
                else episodes.final_observations[k, 0]
            )
            belief = policy.advance(belief, episodes.actions[t], np.array([after]))
        assert final[k] == pytest.approx(belief[0], abs=1e-4)
    assert (final[0] == 0.0).all()


def test_the_rollout_records_the_probabilities_of_the_policy():
    rng = np.random.default_rng(0)
    model = random_model(rng, action_sizes=(ACTIONS,), observation_sizes=(OBSERVATIONS - 1,))
    logits = random_logits(STATES, MEMORY, ACTIONS, OBSERVATIONS, rng)
    policy = logits._replace(
        action=rng.normal(size=logits.action.shape), sight=rng.normal(size=logits.sight.shape)
    ).policy()
    batch = belief_rollout(model, policy, episodes=150, horizon=20, rng=rng)
    p = policy.action_probabilities(beliefs_of(batch, policy), batch.observations[:, 0])
    assert batch.behaviour == pytest.approx(np.take_along_axis(p, batch.actions, axis=1))
    shares = [(batch.actions[:, 0] == a).mean() for a in range(ACTIONS)]
    assert shares == pytest.approx(p.mean(axis=0), abs=0.06)
    with pytest.raises(ValueError, match="policy: 2 actions and 3 observations"):
        belief_rollout(random_model(rng), policy, episodes=1, horizon=1, rng=rng)


def small(seed=0, **settings):
    config = PredictiveActorCriticConfig(
        **({"states": 4, "memory": 3, "batch_steps": 60, "minibatch_steps": 30} | settings)
    )
    return PredictiveActorCritic(*SPACES, config, discount=0.9, seed=seed)


def test_a_saved_agent_goes_on_bit_for_bit(tmp_path):
    model = random_model(
        np.random.default_rng(0), action_sizes=(ACTIONS,), observation_sizes=(OBSERVATIONS - 1,)
    )
    batches = [
        small().sample(model, episodes=9, horizon=7, rng=np.random.default_rng(n)) for n in range(4)
    ]
    agent = small(division_steps=60)
    agent.reset(np.array([2, 2]))
    for batch in batches[:2]:
        agent.learn(batch)
    agent.save(tmp_path / "agent.npz")
    again = load(tmp_path / "agent.npz")
    for one in (agent, again):
        for batch in batches[2:]:
            one.learn(batch)
    for name, array in agent.state_arrays().items():
        assert (array == again.state_arrays()[name]).all(), name
    assert json.dumps(agent.counters()) == json.dumps(again.counters())
    seen = np.array([0, 2])
    assert (agent.act(seen) == again.act(seen)).all()


def test_likelihood_alone_rises_on_fixed_data():
    model = random_model(
        np.random.default_rng(1), action_sizes=(ACTIONS,), observation_sizes=(OBSERVATIONS - 1,)
    )
    agent = small(learning_rate=0.01)
    batch = agent.sample(model, episodes=60, horizon=20, rng=np.random.default_rng(0))
    found = [agent.learn(batch)["log_likelihood"] for _ in range(12)]
    assert np.mean(found[-3:]) > np.mean(found[:3]) + 0.05


def test_without_predictions_there_is_no_likelihood_to_report():
    model = random_model(
        np.random.default_rng(1), action_sizes=(ACTIONS,), observation_sizes=(OBSERVATIONS - 1,)
    )
    agent = small(prediction=0.0)
    batch = agent.sample(model, episodes=9, horizon=7, rng=np.random.default_rng(0))
    assert agent.learn(batch).keys() == {"return_mean", "advantage_scale"}


def test_bad_input_is_refused():
    for settings in (
        {"states": 0},
        {"division_steps": 0},
        {"clip": 0.0},
        {"prediction": -1.0},
        {"return_decay": 1.5},
    ):
        with pytest.raises(ValueError, match=next(iter(settings))):
            PredictiveActorCriticConfig(**settings)
    team = {"a": SPACES[0]}, {"a": SPACES[1]}
    with pytest.raises(ValueError, match="several agents"):
        PredictiveActorCritic(*team, discount=0.9, seed=0)


def test_hallway_beats_the_best_memoryless_policy_within_40_000_steps():
    (score,) = run("predictive-actor-critic", "bnprl/Hallway-v0", 0, goals=(Goal(40_000, 0.0),))
    assert score.value > 0.3756 + 0.02
