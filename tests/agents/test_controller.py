import numpy as np
import pytest

from bnprl_agents.controllers.controller import Controller, normalised, random_controller


@pytest.fixture
def controller():
    return random_controller(3, 2, 4, np.random.default_rng(0))


def test_filter_is_bayes_rule_by_hand():
    controller = Controller(
        initial=[[0.5, 0.5]],
        action=[[0.2, 0.8], [0.6, 0.4]],
        successor=np.array([[[[0.9, 0.1], [0.3, 0.7]]]] * 2),
    )
    belief = controller.begin(np.array([0]))
    np.testing.assert_allclose(belief, [[0.5, 0.5]])
    np.testing.assert_allclose(controller.action_probabilities(belief), [[0.4, 0.6]])
    after = controller.advance(belief, np.array([0]), np.array([0]))
    # p(z | a=0) = (.25, .75); times successor: (.25*.9 + .75*.3, .25*.1 + .75*.7)
    np.testing.assert_allclose(after, [[0.45, 0.55]])


def test_beliefs_stay_distributions(controller):
    rng = np.random.default_rng(1)
    belief = controller.begin(rng.integers(4, size=5))
    for _ in range(20):
        belief = controller.advance(belief, rng.integers(2, size=5), rng.integers(4, size=5))
        np.testing.assert_allclose(belief.sum(axis=1), 1.0)


def test_impossible_history_gives_the_uniform_distribution(controller):
    never = Controller(controller.initial, np.eye(2)[[0, 0, 0]], controller.successor)
    after = never.advance(never.begin(np.array([0])), np.array([1]), np.array([0]))
    np.testing.assert_allclose(after, 1 / 3)


def test_normalised_turns_a_row_of_zeros_uniform():
    np.testing.assert_allclose(
        normalised(np.array([[0.0, 0.0], [1.0, 3.0]])), [[0.5, 0.5], [0.25, 0.75]]
    )


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("initial", np.ones((3, 3)) / 3, r"initial: shape \(3, 3\), must be \(4, 3\)"),
        ("action", -np.ones((3, 2)), "action: holds a negative"),
        ("action", np.full((3, 2), np.nan), "action: holds a negative or non-finite"),
        (
            "successor",
            np.ones((2, 4, 3, 2)),
            r"successor: shape \(2, 4, 3, 2\), must be \(2, O, 3, 3\)",
        ),
        ("successor", np.ones((2, 4)), "successor: shape .* must have 4 axes"),
    ],
)
def test_malformed_tables_are_refused(controller, field, value, message):
    with pytest.raises(ValueError, match=message):
        Controller(**(vars(controller) | {field: value}))
