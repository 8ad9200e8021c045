"""The benchmark of the learners of controllers."""

from baselines.benchmarks import pomdp_learners
from baselines.benchmarks.pomdp_learners import Goal, Score, report, run

MAZE = "bnprl/NoisyMaze1D-v0"


def test_every_goal_is_scored_by_controllers_learned_within_it():
    goals = (Goal(2_000, 0.0), Goal(30_000, 0.0))
    early, late = run("actor-critic", MAZE, 0, goals=goals)
    assert 0 < early.steps <= 2_000 < late.steps <= 30_000
    assert early.seconds <= late.seconds
    assert 0.61 < late.value <= 0.7311  # random play and the optimum


def test_report_fails_where_a_mean_falls_short(monkeypatch, capsys):
    monkeypatch.setitem(pomdp_learners.GOALS, MAZE, (Goal(10, 0.5),))
    assert report(MAZE, [[Score(9, 0.4, 1.0)], [Score(9, 0.6, 1.0)]])
    assert not report(MAZE, [[Score(9, 0.4, 1.0)], [Score(9, 0.5, 1.0)]])
    assert [line.split()[-1] for line in capsys.readouterr().out.splitlines()] == ["pass", "FAIL"]
