import numpy as np
import pytest
from scipy.sparse import csr_array

from bnprl_envs import Names, TabularModel
from bnprl_envs.planning import mdp_value, random_value
from bnprl_envs.sampling import alias_table, draw


def arrays(**changes):
    """Return the constructor arguments of a valid model: S = 2, A = 2, O = 3."""
    return {
        "transition": np.array([[[0.5, 0.5], [0.0, 1.0]], [[0.1, 0.9], [0.3, 0.7]]]),
        "observation": np.array([[[0.2, 0.3, 0.5], [1.0, 0.0, 0.0]]] * 2),
        "reward": np.zeros((1, 1, 1, 1)),
        "start": [0.25, 0.75],
        "discount": 0.9,
    } | changes


def with_row(table, action, state, row):
    table = arrays()[table].copy()
    table[action, state] = row
    return table


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"discount": 0.0}, r"discount: 0.0, must lie in \(0, 1\]"),
        ({"discount": 1.5}, r"discount: 1.5"),
        ({"start": [0.5, 0.6]}, r"start: sums to 1.1, must be 1 within 1e-05"),
        ({"start": [[0.5, 0.5]]}, r"start: shape \(1, 2\), must be \(S,\)"),
        (
            {"transition": with_row("transition", 1, 0, [0.5, 0.4])},
            r"transition row of action '1', state '0': sums to 0.9",
        ),
        (
            {"transition": with_row("transition", 1, 1, [1.5, -0.5])},
            r"transition row of action '1', state '1': probability -0.5 is negative",
        ),
        (
            {"observation": with_row("observation", 0, 1, [np.nan, 0, 1])},
            r"observation row of action '0', state '1': probability nan is not finite",
        ),
        ({"transition": np.eye(2)}, r"transition: shape \(2, 2\), must be \(A, 2, ...\)"),
        ({"observation": np.ones((1, 2, 1))}, r"observation: 1 actions, but transition has 2"),
        ({"reward": np.zeros(4)}, r"reward: shape \(4,\) does not broadcast"),
        ({"reward": np.inf}, r"reward: holds NaN or infinity"),
        ({"reward": -1e101}, r"reward: holds ±1e\+101, must lie within ±1e\+100"),
        ({"action_sizes": (2, 2)}, r"action_sizes: \(2, 2\), must be positive with product 2"),
        ({"observation_sizes": (2,)}, r"observation_sizes: \(2,\)"),
        ({"terminal": [True]}, r"terminal: shape \(1,\), must be \(2,\)"),
        ({"terminal": [True, False]}, r"terminal: state '0' has an exit to '1'"),
        ({"names": Names(("a",), (("b",),), (("c",),), ("d",))}, r"names: "),
    ],
)
def test_validation_names_table_and_row(changes, message):
    with pytest.raises(ValueError, match=message):
        TabularModel(**arrays(**changes))


def test_a_terminal_state_must_earn_nothing():
    absorbing = np.array([[[0.5, 0.5], [0.0, 1.0]]] * 2)
    good = arrays(transition=absorbing, terminal=[False, True])
    TabularModel(**good)
    with pytest.raises(ValueError, match="state '1' has a reward; it must earn 0"):
        TabularModel(**good | {"reward": np.ones((1, 1, 1, 1))})


def test_rows_slightly_off_one_are_normalised():
    model = TabularModel(**arrays(start=[0.250004, 0.75]))
    assert model.start.sum() == pytest.approx(1.0, abs=1e-15)


def test_sparse_and_dense_tables_make_the_same_model():
    rng = np.random.default_rng(0)
    dense = arrays(reward=rng.normal(size=(2, 2, 2, 1)))
    sparse = dense | {
        "transition": csr_array(dense["transition"].reshape(4, 2)),
        "observation": csr_array(dense["observation"].reshape(4, 3)),
        "reward": csr_array(dense["reward"].reshape(4, 2)),
    }
    one, other = TabularModel(**dense), TabularModel(**sparse)
    for table in ("transition", "observation", "expected_reward", "support_reward"):
        np.testing.assert_array_equal(getattr(one, table), getattr(other, table))


def test_expected_reward_sums_over_end_states_and_observations():
    rng = np.random.default_rng(1)
    reward = rng.normal(size=(2, 2, 2, 3))
    model = TabularModel(**arrays(reward=reward))
    expected = np.einsum("ast,ato,asto->as", model.transition, model.observation, reward)
    np.testing.assert_allclose(model.expected_reward, expected, atol=1e-14)


def test_a_model_cannot_be_changed():
    model = TabularModel(**arrays())
    with pytest.raises(AttributeError, match="immutable"):
        model.discount = 0.5
    for array in (model.start, model.terminal, model.transition, model.transition_rows.data):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0
    changed = model.replace(discount=0.5)
    assert (model.discount, changed.discount) == (0.9, 0.5)


def test_the_tables_given_are_not_touched():
    given = arrays()
    TabularModel(**given)
    given["transition"][0, 0] = 7.0  # still writable, and the caller's own


def test_values_agree_with_dense_linear_solves():
    rng = np.random.default_rng(5)
    transition = rng.dirichlet(np.ones(6), (3, 6))
    reward = 100 * rng.normal(size=(3, 6, 6, 1))
    model = TabularModel(transition, None, reward, rng.dirichlet(np.ones(6)), 0.99)

    def value(policy):
        """Return V of a (S, A) policy."""
        moves = np.einsum("sa,ast->st", policy, transition)
        earned = np.einsum("sa,as->s", policy, model.expected_reward)
        return np.linalg.solve(np.eye(6) - 0.99 * moves, earned)

    uniform = model.start @ value(np.full((6, 3), 1 / 3))
    assert random_value(model) == pytest.approx(uniform, rel=0, abs=1e-8)
    policies = (np.eye(3)[list(choice)] for choice in np.ndindex((3,) * 6))
    best = np.max([value(policy) for policy in policies], axis=0)
    np.testing.assert_allclose(mdp_value(model), best, rtol=0, atol=1e-8)


def test_values_take_another_discount_below_one():
    model = TabularModel(**arrays(reward=1.0, discount=1.0))
    assert random_value(model, discount=0.9) == pytest.approx(10.0, abs=1e-9)
    np.testing.assert_allclose(mdp_value(model, discount=0.5), 2.0, rtol=0, atol=1e-10)
    for function in (random_value, mdp_value):
        with pytest.raises(ValueError, match=r"discount: 1\.0, an infinite horizon needs"):
            function(model)


def sparse_rows(rng, n_rows=40, n_columns=12):
    """Return random rows with one to twelve entries, some of them tiny."""
    dense = rng.dirichlet(np.full(n_columns, 0.2), n_rows)
    dense[dense < 1e-3] = 0.0
    dense[0] = np.eye(n_columns)[3]
    dense[1] = 1 / n_columns
    dense[2, :2] = 1e-9
    return csr_array(dense / dense.sum(axis=1, keepdims=True))


def test_an_alias_table_holds_exactly_its_rows():
    rows = sparse_rows(np.random.default_rng(2))
    table = alias_table(rows)
    implied = np.zeros(rows.shape)
    for row in range(rows.shape[0]):
        begin, end = table.first[row], table.first[row + 1]
        for k in range(begin, end):
            assert begin <= table.alias[k] < end
            assert 0.0 <= table.threshold[k] <= 1.0
            implied[row, table.outcome[k]] += table.threshold[k] / (end - begin)
            implied[row, table.outcome[table.alias[k]]] += (1 - table.threshold[k]) / (end - begin)
    np.testing.assert_allclose(implied, rows.toarray(), rtol=0, atol=1e-12)


def test_draw_spends_the_unit_interval_as_the_rows_say():
    rows = sparse_rows(np.random.default_rng(3))
    table = alias_table(rows)
    grid = (np.arange(20_000) + 0.5) / 20_000
    for row in (0, 1, 5, rows.shape[0] - 1):
        outcomes = [table.outcome[draw(table, row, uniform)] for uniform in grid]
        shares = np.bincount(outcomes, minlength=rows.shape[1]) / grid.size
        np.testing.assert_allclose(shares, rows.toarray()[row], rtol=0, atol=24 / grid.size)


@pytest.mark.parametrize("uniform", [0.0, np.nextafter(1.0, 0.0)])
def test_draw_stays_in_its_row_at_the_ends(uniform):
    rows = sparse_rows(np.random.default_rng(4))
    table = alias_table(rows)
    for row in range(rows.shape[0]):
        assert table.first[row] <= draw(table, row, uniform) < table.first[row + 1]
