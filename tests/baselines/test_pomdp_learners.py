"""The benchmark of the learners of POMDPs."""

import json
from functools import partial

import pytest

from baselines.benchmarks import pomdp_learners
from baselines.benchmarks.pomdp_learners import (
    GOALS,
    MACHINE,
    PARCELS,
    Goal,
    described,
    main,
    report,
    run,
    spec_of,
)
from baselines.benchmarks.run_records import Records, Run, Score
from bnprl_envs.memoryless import memoryless_joint_policy
from bnprl_envs.stochastic_memoryless import stochastic_memoryless_policy

MAZE = "bnprl/NoisyMaze1D-v0"
AGENTS = "actor-critic", "predictive-actor-critic"


@pytest.mark.parametrize("agent", AGENTS)
def test_every_goal_is_scored_by_a_policy_learned_within_it(agent):
    goals = (Goal(2_000, 0.0), Goal(30_000, 0.0))
    early, late = run(agent, MAZE, 0, goals=goals)
    assert 0 < early.steps <= 2_000 < late.steps <= 30_000
    assert early.seconds <= late.seconds
    assert 0.61 < late.value <= 0.7311 + 0.01  # random play and the optimum, simulated


def test_agents_without_a_policy_to_hold_are_refused():
    with pytest.raises(ValueError, match="agent: 'tabular-q' learns neither"):
        run("tabular-q", MAZE, 0)


def test_report_fails_where_a_mean_falls_short(monkeypatch, capsys):
    monkeypatch.setitem(pomdp_learners.GOALS, MAZE, (Goal(10, 0.5),))
    assert report("us", MAZE, [[Score(9, 0.4, 1.0)], [Score(9, 0.6, 1.0)]])
    assert not report("us", MAZE, [[Score(9, 0.4, 1.0)], [Score(9, 0.5, 1.0)]])
    assert not report("us", MAZE, [[Score(9, 0.4, 1.0)]])
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert [line[-1] for line in lines] == ["pass", "FAIL", "FAIL"]
    assert lines[0][4:7] == ["0.5000", "-0.7706,", "1.7706"]  # half is t(1) = 12.7 times .1


@pytest.fixture
def runs(monkeypatch):
    """The runs that were made, each instead of a real one."""
    made = []

    def fake(name, env, seed, *, shown):
        made.append((name, seed))
        return [Score(9, 0.5 + 0.1 * seed, 1.0)]

    monkeypatch.setattr(pomdp_learners, "run", fake)
    monkeypatch.setitem(pomdp_learners.GOALS, MAZE, (Goal(10, 0.55),))
    return made


def test_finished_runs_are_not_run_again_and_a_torn_line_is(runs, tmp_path, capsys):
    path = tmp_path / "folder" / "records.jsonl"
    call = [
        "--agents",
        *AGENTS,
        "--environments",
        MAZE,
        "--seeds",
        "2",
        "--out",
        str(path),
        "--no-progress",
    ]
    assert main(call) == 0
    assert runs == [(name, seed) for name in AGENTS for seed in (0, 1)]
    first = capsys.readouterr().out
    assert main(call) == 0
    assert (len(runs), capsys.readouterr().out) == (4, first)
    path.write_bytes(path.read_bytes()[:-5])
    assert main(call) == 0
    assert runs[4:] == [(AGENTS[1], 1)]
    assert [json.loads(line)["run"]["seed"] for line in path.read_text().splitlines()] == [0, 1] * 2


def test_a_run_to_other_goals_is_another(runs, monkeypatch, tmp_path):
    path = tmp_path / "records.jsonl"
    Records(path).of(described("actor-critic", MAZE, 0))
    monkeypatch.setitem(pomdp_learners.GOALS, MAZE, (Goal(20, 0.55),))
    Records(path).of(described("actor-critic", MAZE, 0))
    Records(path).of(described("actor-critic", MAZE, 0))
    assert len(runs) == 2


def test_several_processes_make_the_same_records(tmp_path):
    runs = [Run({"seed": seed}, partial(squares, seed)) for seed in range(5)]
    together, alone = Records(tmp_path / "together.jsonl"), Records(None)
    together.of(runs[3])
    together.prepare(runs, jobs=2)
    assert [together.of(run) for run in runs] == [alone.of(run) for run in runs]
    assert Records(tmp_path / "together.jsonl").known == together.known
    assert len((tmp_path / "together.jsonl").read_text().splitlines()) == 5


def squares(seed: int) -> list[Score]:
    return [Score(seed, seed**2, 0.5)]


def test_a_file_of_something_else_is_refused(tmp_path):
    path = tmp_path / "records.jsonl"
    path.write_text('{"seed": 1}\n')
    with pytest.raises(ValueError, match=r"records\.jsonl:1: no record of a run"):
        Records(path)


def test_the_best_memoryless_policies_of_the_files_are_the_goals():
    model = spec_of(PARCELS).model()
    assert model is not None
    found = memoryless_joint_policy(model, restarts=5, seconds=None, seed=0).value
    assert GOALS[PARCELS][0].value == pytest.approx(found, abs=1e-5)
    machine = spec_of(MACHINE).model()
    assert machine is not None
    assert memoryless_joint_policy(machine, restarts=5, seconds=None, seed=0).value < 7.0
    stochastic = stochastic_memoryless_policy(machine, restarts=5, seconds=None, seed=0).value
    assert GOALS[MACHINE][0].value == pytest.approx(stochastic, abs=1e-3)
