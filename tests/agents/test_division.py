"""The division of a belief's states: nothing changes but that the halves may grow apart."""

import numpy as np
import pytest

from bnprl_agents.belief import division
from bnprl_agents.belief.division import copied, divided
from bnprl_agents.belief.filtering import Sequences, run_filter
from bnprl_agents.belief.gradient import filtered
from bnprl_agents.belief.policy import random_logits
from bnprl_agents.episodes import EpisodeBatch
from bnprl_agents.proximal.actor import Actor
from bnprl_agents.proximal.critic import Cells, Histories
from tests.agents.cases import random_episodes

STATES, MEMORY, ACTIONS, OBSERVATIONS = 4, 2, 2, 3
UNUSED = 2


def never_entered(rng):
    """Logits in which no episode ever enters one state."""
    logits = random_logits(STATES, MEMORY, ACTIONS, OBSERVATIONS, rng)
    logits.initial[:, UNUSED] = -80.0
    logits.transition[..., UNUSED] = -80.0
    tables = ("action", "sight", "reward")
    return logits._replace(**{t: rng.normal(size=getattr(logits, t).shape) for t in tables})


def histories(episodes, policy):
    ways = filtered(Sequences.of(episodes), policy)
    return Histories(
        *(
            np.concatenate([getattr(way, name) for way in ways], axis=1)
            for name in ("before", "final")
        ),
        Cells(episodes.observations[:, 0], episodes.final_observations[:, 0]),
    )


@pytest.fixture
def case():
    rng = np.random.default_rng(0)
    episodes = random_episodes(rng, (4, 1, 5, 6), (ACTIONS,), (OBSERVATIONS,))
    episodes = EpisodeBatch(**(vars(episodes) | {"terminated": np.array([True, False] * 2)}))
    actor = Actor.begin(never_entered(rng), OBSERVATIONS, STATES + MEMORY)
    seen = histories(episodes, actor.logits.policy())
    critic = actor.critic.fitted(seen, rng.normal(size=episodes.n_steps), 0.9, 1e-6)
    return episodes, actor._replace(critic=critic), seen.before[:, :STATES].mean(axis=0)


def test_without_noise_policy_predictions_and_values_stay(case, monkeypatch):
    monkeypatch.setattr(division, "APART", 0.0)
    episodes, actor, use = case
    after = divided(actor, use, np.random.default_rng(0))
    old, new = actor.logits.policy(), after.logits.policy()
    before, seen = histories(episodes, old), histories(episodes, new)
    state = int(use.argmax())
    np.testing.assert_allclose(seen.before[:, state], before.before[:, state] / 2, atol=1e-9)
    np.testing.assert_allclose(seen.before[:, UNUSED], seen.before[:, state])
    sequences = Sequences.of(episodes)
    likelihoods = [run_filter(sequences, policy.model).likelihood for policy in (old, new)]
    np.testing.assert_allclose(*likelihoods)
    shares = [
        policy.action_probabilities(way.before, episodes.observations[:, 0])
        for policy, way in ((old, before), (new, seen))
    ]
    np.testing.assert_allclose(*shares)
    values = [a.critic.values(way)[0] for a, way in ((actor, before), (after, seen))]
    np.testing.assert_allclose(*values, atol=1e-9)


def test_the_critics_evidence_is_that_of_the_new_beliefs(case, monkeypatch):
    monkeypatch.setattr(division, "APART", 0.0)
    episodes, actor, use = case
    after = divided(actor, use, np.random.default_rng(0))
    seen = histories(episodes, after.logits.policy())
    targets = np.random.default_rng(1).normal(size=episodes.n_steps)
    nothing = actor.critic._replace(
        precision=0.0 * actor.critic.precision, moment=0.0 * actor.critic.moment
    )
    old = nothing.fitted(histories(episodes, actor.logits.policy()), targets, 0.9, 1.0)
    found, wanted = (
        old.divided(int(use.argmax()), UNUSED),
        nothing.fitted(seen, targets, 0.9, 1.0),
    )
    np.testing.assert_allclose(found.precision, wanted.precision, atol=1e-9)
    np.testing.assert_allclose(found.moment, wanted.moment, atol=1e-9)


def test_noise_sets_the_halves_apart(case):
    _, actor, use = case
    logits = divided(actor, use, np.random.default_rng(0)).logits
    state = int(use.argmax())
    assert (logits.emission[UNUSED] != logits.emission[state]).all()
    np.testing.assert_allclose(logits.emission[UNUSED], logits.emission[state], atol=0.5)
    np.testing.assert_array_equal(logits.action[UNUSED], logits.action[state])
    np.testing.assert_array_equal(logits.memory_emission, actor.logits.memory_emission)


def test_where_every_state_is_used_nothing_is_divided(case):
    _, actor, _ = case
    rng = np.random.default_rng(0)
    assert divided(actor, np.array([0.4, 0.2, 0.2, 0.2]), rng) is actor
    assert rng.random() == np.random.default_rng(0).random()


def test_moments_are_copied_too(case):
    _, actor, _ = case
    moved = copied(actor.logits, 0, 3)
    np.testing.assert_array_equal(moved.transition[:, 3, 3], actor.logits.transition[:, 0, 0])
    np.testing.assert_array_equal(moved.transition[:, 1, 3], actor.logits.transition[:, 1, 0])
    np.testing.assert_array_equal(moved.reward[:, 3], actor.logits.reward[:, 0])
    np.testing.assert_array_equal(moved.transition[:, :3, :3], actor.logits.transition[:, :3, :3])
