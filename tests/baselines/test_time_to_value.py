"""The benchmark of how soon policies are good."""

import numpy as np
import pytest

from baselines.benchmarks import time_to_value
from baselines.benchmarks.run_records import Score
from baselines.benchmarks.time_to_value import (
    POINTS,
    SOONER,
    curve,
    main,
    points,
    race,
    reached,
    thresholds,
    typical,
)

MAZE = "bnprl/NoisyMaze1D-v0"
CURVES = [
    [Score(10, 0.5, 1.0), Score(20, 0.7, 2.0), Score(40, 0.6, 4.0)],
    [Score(12, 0.4, 1.0), Score(30, 0.7, 3.0)],
    [Score(12, 0.4, 1.0), Score(30, 0.6, 3.0)],
]


def test_a_value_is_reached_where_it_first_is():
    assert reached(CURVES[0], 0.65) == Score(20, 0.7, 2.0)
    assert reached(CURVES[0], 0.8) is None
    assert typical(CURVES, 0.65) == (30.0, 3.0)
    assert typical(CURVES[1:], 0.65) == (np.inf, np.inf)


def test_thresholds_lie_between_random_play_and_the_best_known_value():
    assert thresholds("bnprl/Tag-v0")[0] == pytest.approx(-53.760587 + 0.8 * (53.760587 - 6.002))


def test_a_curve_is_scored_within_its_budget_and_again_at_more_steps():
    scores = curve("predictive-actor-critic", MAZE, 0, 30_000)
    steps = [score.steps for score in scores]
    assert len(steps) == SOONER + POINTS
    assert steps == sorted(steps)
    assert steps[SOONER] <= 1_200
    assert 27_000 < steps[-1] <= 30_000
    assert 0.61 < scores[-1].value < 0.74


def test_the_table_names_who_gets_there_and_who_never_does(monkeypatch, tmp_path, capsys):
    made = []

    def fake(name, env, seed, steps, *, shown):
        made.append((name, seed))
        return [Score(9, 0.73 if name == "ppo" else 0.62, 1.5)]

    monkeypatch.setattr(time_to_value, "curve", fake)
    call = ["--agents", "ppo", "random", "--environments", MAZE, "--seeds", "2"]
    call += ["--out", str(tmp_path / "records.jsonl"), "--no-progress"]
    assert main(call) == main(call) == 0
    assert made == [("ppo", 0), ("ppo", 1), ("random", 0), ("random", 1)]
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert lines[1] == [MAZE, "80%", "0.7070", "ppo", "9", "1.5", "2/2", "0.7300"]
    assert lines[2][3:] == ["random", "never", "0/2", "0.6200"]


def test_points_are_a_geometric_series_up_to_the_budget():
    assert points(100_000, POINTS)[0] == 4_000
    assert points(100_000, SOONER + POINTS)[SOONER:] == points(100_000, POINTS)
    ratios = np.array(points(10**9, 8)[1:]) / points(10**9, 8)[:-1]
    np.testing.assert_allclose(ratios, 25 ** (1 / 9), rtol=1e-6)


@pytest.mark.parametrize(
    ("value", "seconds", "verdicts"),
    [(0.4, 1.0, ["pass", "pass"]), (0.3, 1.0, ["pass", "FAIL"]), (0.4, 1.3, ["FAIL", "pass"])],
)
def test_the_race_is_won_at_every_budget_or_lost(value, seconds, verdicts, capsys):
    ours = [[Score(9, 0.2, seconds), Score(19, value, 2 * seconds)]] * 2
    rivals = [
        [Score(10, 0.1, 10.0), Score(20, 0.3, 28.0)],
        [Score(10, 0.3, 14.0), Score(20, 0.4, 28.0)],
    ]
    won = race({"predictive-actor-critic": ours, "recurrent-ppo": rivals})
    assert won == ("FAIL" not in verdicts)
    lines = capsys.readouterr().out.splitlines()[3:5]
    assert [line.split()[-1] for line in lines] == verdicts


def test_what_was_reached_sooner_counts_at_later_budgets(capsys):
    ours = [[Score(9, 0.3, 1.0), Score(19, 0.4, 9.0)]]
    rivals = [[Score(10, 0.1, 10.0), Score(20, 0.3, 20.0)]]
    assert race({"predictive-actor-critic": ours, "recurrent-ppo": rivals})
    last = capsys.readouterr().out.splitlines()[4]
    assert last.split() == ["20", "0.3000", "20.0", "9", "0.3000", "1.0", "20.0", "pass"]
