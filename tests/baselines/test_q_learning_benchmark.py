"""How the claims of chapter 3 are judged by records."""

import numpy as np
import pytest

from baselines.benchmarks import q_learning
from baselines.records import Record


def record(steps, *, seed=0, length=0.0, exact=None, value=0.0, final=False, **metrics):
    return Record("one", seed, 1, steps, 0.0, 0.0, value, 0.0, length, 1, exact, metrics, final)


def test_the_first_evaluation_that_reaches_a_goal_counts():
    runs = [
        [record(100, length=10.0), record(200, length=2950.0), record(300, length=10.0)],
        [record(100, length=10.0), record(200, length=20.0)],
    ]
    assert q_learning.first_steps(runs, q_learning.balanced).tolist() == [200.0, np.inf]


def test_medians_bear_seeds_that_never_reach_it():
    assert q_learning.median_interval(np.array([3.0, 1.0, np.inf, 2.0]))[0] == 3.0
    median, low, high = q_learning.median_interval(np.arange(20.0))
    assert low < median < high
    assert q_learning.median_interval(np.full(5, np.inf)) == (np.inf, np.inf, np.inf)


@pytest.mark.parametrize(
    ("metrics", "expected"),
    [
        ({}, False),
        ({"td_error": 40.0, "diverged": 0.0}, False),
        ({"td_error": 5000.0}, True),
        ({"td_error": 0.0, "diverged": 1.0}, True),
    ],
)
def test_divergence(metrics, expected):
    assert q_learning.diverged(record(1, **metrics)) is expected


def test_a_claim_that_does_not_hold_fails(capsys):
    good = [[record(100, exact=0.4378)]]
    late = [[record(100, exact=0.1), record(200, exact=0.4378)]]
    assert q_learning.judge_gridworld({"gpq": late, "gpq-optimistic": good})
    assert not q_learning.judge_gridworld({"gpq": good, "gpq-optimistic": late})
    assert not q_learning.judge_gridworld({"gpq": [[record(1, exact=0.4)]], "gpq-optimistic": good})
    assert "FAIL  gpq reaches 0.4378 on every seed: 0 of 1" in capsys.readouterr().out


def test_records_are_wanted(tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        q_learning.main([str(tmp_path)])
    assert stopped.value.code == 2
    assert "no finished run of gpq" in capsys.readouterr().err


def test_runs_get_the_evaluations_of_their_first_steps():
    whole = {"one": [[record(200), record(400, length=2950.0)]], "two": [[record(200)]]}
    early = {"one": [[record(20), record(40, length=2990.0)]]}
    found = q_learning.joined(whole, early)
    assert [r.steps for r in found["one"][0]] == [20, 40, 200, 400]
    assert q_learning.first_steps(found["one"], q_learning.balanced).tolist() == [40.0]
    assert found["two"] == whole["two"]
