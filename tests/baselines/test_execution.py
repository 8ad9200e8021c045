from __future__ import annotations

import dataclasses
import json
import logging
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import pytest
from gymnasium.envs.registration import EnvSpec

from baselines import evaluation
from baselines.contenders import MissingExtraError, contender
from baselines.environment import EnvironmentSpec
from baselines.execution import WARM_UP_STEPS, _warm_up, execute
from baselines.experiment import Entry, Experiment, configured_entries
from baselines.learners import build_learner
from baselines.progress_bar import STARTING, budget_used, progress_bar
from baselines.records import RecordError, RunFiles
from baselines.study import load_study, open_study
from baselines.workers import Workers
from bnprl_agents.training import Progress
from tests.baselines.fakes import FakeSettings, experiment, fake_evaluate, install


@pytest.fixture(autouse=True)
def fake(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch)


def run(folder: Path, chosen: Experiment, **options: Any) -> list[RunFiles]:
    return execute(chosen, folder, options.pop("workers", Workers()), progress=False, **options)


def values(folder: Path, name: str = "fake", seed: int = 0) -> list[dict[str, Any]]:
    """The lines of a run without its times."""
    lines = RunFiles(folder, name, seed).read().lines
    return [
        dataclasses.asdict(dataclasses.replace(line, train_seconds=0.0, eval_seconds=0.0))
        for line in lines
    ]


def test_a_run_is_recorded_at_each_point(tmp_path: Path) -> None:
    assert run(tmp_path, experiment()) == []
    lines = RunFiles(tmp_path, "fake", 1).read().lines
    # updates come every 10 episodes: the first at or past 25, 50, 75, and the end
    assert [line.episodes for line in lines] == [30, 50, 80, 100]
    assert [line.steps for line in lines] == [150, 250, 400, 500]
    assert [line.final for line in lines] == [False, False, False, True]
    assert [line.seed for line in lines] == [1] * 4
    assert lines[-1].return_mean == pytest.approx(100, abs=8)
    assert lines[-1].eval_episodes == 20
    assert lines[0].metrics.keys() == {"level"}  # JSON has no NaN
    times = [line.train_seconds for line in lines]
    assert times == sorted(times)
    assert RunFiles(tmp_path, "fake", 1).policy(".npz").read_bytes() == b"fake"
    assert sorted(path.name for path in (tmp_path / "runs" / "fake").iterdir()) == [
        "0.jsonl",
        "0.policy.npz",
        "1.jsonl",
        "1.policy.npz",
    ]


def test_a_finished_run_without_its_policy_is_done_again(tmp_path: Path) -> None:
    run(tmp_path, experiment())
    before, policy = values(tmp_path), RunFiles(tmp_path, "fake", 0).policy(".npz")
    kept = RunFiles(tmp_path, "fake", 1).records.stat().st_mtime_ns
    policy.unlink()
    run(tmp_path, experiment())
    assert policy.read_bytes() == b"fake"
    assert values(tmp_path) == before
    assert RunFiles(tmp_path, "fake", 1).records.stat().st_mtime_ns == kept


class Endless(gym.Env[int, int]):
    """Its episodes never end; nobody should wait for that."""

    observation_space: ClassVar[Any] = gym.spaces.Discrete(2)
    action_space: ClassVar[Any] = gym.spaces.Discrete(2)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[int, dict[str, Any]]:
        self.elapsed = 0
        return 0, {}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        self.elapsed += 1
        assert self.elapsed < 1000
        return 0, 1.0, False, False, {}


def test_episodes_that_never_end_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("baselines.execution.evaluate", evaluation.evaluate)
    monkeypatch.setattr(evaluation, "LONGEST", 10)
    monkeypatch.setitem(gym.registry, "Endless-v0", EnvSpec("Endless-v0", entry_point=Endless))
    chosen = experiment(Entry.of("random"), seeds=1, episodes=None, steps=100)
    (failed,) = run(
        tmp_path, dataclasses.replace(chosen, environment=EnvironmentSpec("Endless-v0"))
    )
    assert failed.failure().startswith("ValueError: Endless-v0: an episode of 10 steps has not")


@pytest.mark.parametrize(
    ("name", "id"),
    [
        ("online-em", "bnprl/Hallway-v0"),
        ("batch-em", "FrozenLake-v1"),
        ("gpq", "bnprl/InvertedPendulum-v0"),
        ("gp-fitted-q", "bnprl/InvertedPendulum-v0"),
    ],
)
def test_a_warm_up_ends_with_the_first_update(name: str, id: str) -> None:
    learner, seen = build_learner(contender(name), EnvironmentSpec(id), None, seed=0), []
    learn = learner.learn

    def follow(**budget: Any) -> Iterator[Progress]:
        for progress in learn(**budget):
            seen.append(progress)
            yield progress

    learner.learn = follow  # type: ignore[method-assign]
    _warm_up(learner, WARM_UP_STEPS)
    assert [bool(progress.metrics) for progress in seen] == [True]


def test_a_budget_of_steps_counts_steps(tmp_path: Path) -> None:
    run(tmp_path, experiment(episodes=None, steps=500))
    assert [line["steps"] for line in values(tmp_path)] == [150, 250, 400, 500]


def test_an_update_past_several_points_is_evaluated_once(tmp_path: Path) -> None:
    run(tmp_path, experiment(Entry.of("fake", FakeSettings(update=60)), episodes=120))
    assert [line["episodes"] for line in values(tmp_path)] == [60, 120]


def test_seeds_are_distinct_and_fixed() -> None:
    chosen = experiment()
    seeds = {
        (name, index): chosen.run_seeds(name, index)[0]
        for name in ("fake", "other")
        for index in range(50)
    }
    assert len(set(seeds.values())) == 100
    assert max(seeds.values()) < 2**31
    assert seeds["fake", 0] == experiment(seeds=9).run_seeds("fake", 0)[0]
    assert seeds["fake", 0] != experiment(root_seed=1).run_seeds("fake", 0)[0]
    assert seeds["fake", 0] == 2104907526  # old records can be extended by later versions


def test_a_finished_run_is_not_touched_and_an_unfinished_one_is_redone(tmp_path: Path) -> None:
    run(tmp_path / "whole", experiment())
    run(tmp_path / "torn", experiment())
    finished = RunFiles(tmp_path / "torn", "fake", 0).records
    stamp, text = finished.stat().st_mtime_ns, finished.read_bytes()
    broken = RunFiles(tmp_path / "torn", "fake", 1).records
    broken.write_bytes(broken.read_bytes()[:-10])
    run(tmp_path / "torn", experiment())
    assert (finished.stat().st_mtime_ns, finished.read_bytes()) == (stamp, text)
    for seed in (0, 1):
        assert values(tmp_path / "torn", seed=seed) == values(tmp_path / "whole", seed=seed)


def test_a_torn_line_is_cut_off_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run(tmp_path, experiment())
    path = RunFiles(tmp_path, "fake", 0).records
    text = path.read_bytes()
    path.write_bytes(text + b'{"contender')
    with caplog.at_level(logging.WARNING):
        run(tmp_path, experiment())
    assert [entry.getMessage() for entry in caplog.records] == [f"{path}:5: torn last line dropped"]
    assert path.read_bytes() == text


def test_damage_is_named_before_anything_runs(tmp_path: Path) -> None:
    run(tmp_path, experiment(seeds=1))
    path = RunFiles(tmp_path, "fake", 0).records
    path.write_bytes(b"{}\n" + path.read_bytes())
    with pytest.raises(RecordError, match=r"0\.jsonl:1: key .* is missing"):
        run(tmp_path, experiment(seeds=2))
    assert not RunFiles(tmp_path, "fake", 1).records.exists()


def test_a_failure_does_not_stop_the_others(tmp_path: Path) -> None:
    entries = (Entry.of("fake", FakeSettings(fail=True), "bad"), Entry.of("fake"))
    failed = run(tmp_path, experiment(*entries))
    assert [files.name for files in failed] == ["bad/0", "bad/1"]
    assert "RuntimeError: the fake fails" in failed[0].error.read_text()
    assert not failed[0].read().finished
    assert RunFiles(tmp_path, "fake", 1).read().finished
    failed[0].records.unlink()
    mended = (Entry.of("fake", FakeSettings(), "bad"), Entry.of("fake"))
    assert run(tmp_path, experiment(*mended)) == []
    assert not failed[0].error.exists()


def test_contenders_and_seeds_can_be_added(tmp_path: Path) -> None:
    more = (Entry.of("fake", FakeSettings(gain=2.0), "better"), Entry.of("fake"))
    open_study(tmp_path, experiment(seeds=3), "first")
    study = open_study(tmp_path, experiment(*more, seeds=2), "second")
    assert [entry.name for entry in study.experiment.entries] == ["fake", "better"]
    assert study.experiment.seeds == 3
    assert study.commands == ("first", "second")
    assert load_study(tmp_path).experiment == study.experiment
    assert study.experiment.entry("better").build_settings() == FakeSettings(gain=2.0)
    assert open_study(tmp_path, experiment(), "first").commands == ("first", "second")


def test_another_experiment_is_refused_by_the_field_that_differs(tmp_path: Path) -> None:
    open_study(tmp_path, experiment(), "command")
    before = (tmp_path / "experiment.json").read_bytes()
    changed = Entry.of("fake", FakeSettings(gain=3.0))
    for other, reason in (
        (experiment(changed), r"fake\.gain is 1\.0 there, 3\.0 here"),
        (experiment(episodes=200), "episodes is 100 there, 200 here"),
        (experiment(root_seed=1), "root_seed is 0 there, 1 here"),
        (experiment(eval_points=5), "eval_points is 4 there, 5 here"),
        (
            dataclasses.replace(experiment(), environment=EnvironmentSpec("bnprl/Tag-v0")),
            'environment is .*"bnprl/Hallway-v0".* there, .*"bnprl/Tag-v0"',
        ),
    ):
        with pytest.raises(ValueError, match=reason):
            open_study(tmp_path, other, "command")
    assert (tmp_path / "experiment.json").read_bytes() == before


def test_a_changed_model_file_is_another_experiment(tmp_path: Path) -> None:
    model = tmp_path / "model.POMDP"
    model.write_text("one")
    chosen = dataclasses.replace(experiment(), environment=EnvironmentSpec(str(model)))
    open_study(tmp_path, chosen, "command")
    model.write_text("two")
    with pytest.raises(ValueError, match="model_sha256"):
        open_study(tmp_path, chosen, "command")


@pytest.mark.parametrize(
    "text", [b"", b"[]", b"{}", b'{"environment": 3}', b"\xff", b"[" * 100_000, b'{"entries": []}']
)
def test_a_damaged_experiment_is_named(tmp_path: Path, text: bytes) -> None:
    (tmp_path / "experiment.json").write_bytes(text)
    with pytest.raises(RecordError, match=r"experiment\.json: not an experiment"):
        load_study(tmp_path)


@pytest.mark.parametrize(
    ("environment", "reason"),
    [
        ({"id": 3}, "environment 3: must be a name"),
        ({"id": "bnprl/Tiger-v0", "kwargs": [1]}, "Tiger-v0: kwargs must be an object of keywords"),
        ({"id": "bnprl/Tiger-v0", "kwargs": {"discount": "1"}}, "discount: '1', must lie in"),
    ],
)
def test_an_environment_of_other_types_is_refused(
    tmp_path: Path, environment: dict[str, Any], reason: str
) -> None:
    values = experiment().to_json() | {"commands": [], "versions": {}, "environment": environment}
    (tmp_path / "experiment.json").write_text(json.dumps(values))
    with pytest.raises(RecordError, match=reason):
        load_study(tmp_path)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"episodes": None}, "exactly one of --episodes and --steps"),
        ({"steps": 5}, "exactly one of --episodes and --steps"),
        ({"episodes": 0}, "--episodes: 0"),
        ({"episodes": None, "steps": -1}, "--steps: -1"),
        ({"seeds": 0}, "--seeds: 0"),
        ({"eval_episodes": 0}, "--eval-episodes: 0"),
        ({"eval_points": -2}, "--eval-points: -2"),
        ({"root_seed": -1}, "--seed: -1"),
        ({"seeds": 1.5}, "--seeds: 1.5"),
    ],
)
def test_numbers_out_of_range_are_named(changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        experiment(**changes)


def test_settings_are_assigned_by_name() -> None:
    (entry,) = configured_entries(["fake"], ["fake.gain=3"])
    assert entry.build_settings() == FakeSettings(gain=3.0)
    (gpq,) = configured_entries(["gpq"], ["gpq.noise=.5", "gpq.low=[-.1]"])
    assert (gpq.settings["noise"], gpq.settings["low"]) == (0.5, [-0.1])
    sizes = configured_entries(["fake"], ["fake.shape=8,16"])[0].build_settings().shape
    assert (sizes, [type(size) for size in sizes]) == ((8, 16), [int, int])
    for text, value in (("0.5", 0.5), ("2", 2), ("none", "none")):
        (entry,) = configured_entries(["fake"], [f"fake.limit={text}"])
        assert entry.settings["limit"] == value
    for text, number in (("0.1", 0.1), ("auto", "auto")):
        (entry,) = configured_entries(["gp-fitted-q"], [f"gp-fitted-q.regularization={text}"])
        assert entry.build_settings().regularization == number
    with pytest.raises(ValueError, match=r"gpq.bandwidth=.1,x: '.1,x' must be a list of numbers"):
        configured_entries(["gpq"], ["gpq.bandwidth=.1,x"])
    with pytest.raises(ValueError, match="given twice"):
        configured_entries(["fake", "fake"], [])


def test_entries_are_checked() -> None:
    with pytest.raises(ValueError, match="unknown agent 'fak'; did you mean fake"):
        Entry("x", "fak", {})
    with pytest.raises(ValueError, match="unknown setting 'gian'; did you mean gain"):
        Entry("x", "fake", {"gian": 1.0})
    with pytest.raises(ValueError, match="agent 'fake' is given twice"):
        experiment(Entry.of("fake"), Entry.of("fake"))


def test_many_entries_take_linear_time_up_to_a_limit() -> None:
    begin = time.process_time()
    entries = [Entry(f"fake-{k}", "fake", {}) for k in range(20_001)]
    experiment(*entries[:20_000], seeds=5)
    assert time.process_time() - begin < 5
    with pytest.raises(ValueError, match="100,005 runs, the limit is 100,000"):
        experiment(*entries, seeds=5)


@pytest.mark.parametrize("engine", ["ray", "dask"])
def test_a_missing_engine_says_what_to_install(
    tmp_path: Path, engine: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("ray", "dask", "dask.distributed", "ray.util.joblib"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtraError, match=rf'pip install "bnprl\[{engine}\]"'):
        run(tmp_path, experiment(), workers=Workers(engine=engine))


def test_the_bar_follows_the_records(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    execute(experiment(), tmp_path, Workers(), progress=True)
    shown = capsys.readouterr().err
    assert "2/2 runs" in shown
    assert "200/200" in shown
    assert run(tmp_path, experiment()) == []
    assert capsys.readouterr().err == ""


def test_the_bar_moves_between_evaluations(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    chosen, seen = experiment(seeds=1), []
    files = RunFiles(tmp_path, "fake", 0)

    def look(policy: Any, *arguments: Any, **options: Any) -> evaluation.Evaluation:
        seen.append((budget_used(chosen, files), len(files.read().lines)))
        return fake_evaluate(policy, *arguments, **options)

    files.progress.parent.mkdir(parents=True)
    files.progress.write_text("77")  # of a command that was killed
    monkeypatch.setattr("baselines.execution.evaluate", look)
    monkeypatch.setattr("baselines.execution.POLL_SECONDS", 0.0)
    assert run(tmp_path, chosen) == []
    # the last update is no end before it is evaluated
    assert seen == [(30, 0), (50, 1), (80, 2), (99, 3)]
    assert budget_used(chosen, files) == 100
    assert not files.progress.exists()


def test_the_bar_says_that_a_run_is_starting(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with progress_bar(experiment(), (RunFiles(tmp_path, "fake", 0),), shown=True):
        pass
    first, *_, last = capsys.readouterr().err.strip().split("\r")
    assert first.startswith(STARTING)
    assert not last.startswith(STARTING)


def test_tensorboard_gets_evaluations_and_metrics(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    chosen = experiment(Entry.of("random"), seeds=1, episodes=300)
    monkeypatch.setattr("baselines.execution.evaluate", evaluation.evaluate)
    assert run(tmp_path, chosen, tensorboard=True) == []
    events = EventAccumulator(str(tmp_path / "tensorboard" / "random" / "0"))
    events.Reload()
    tags = events.Tags()["tensors"]
    assert {"evaluation/return_mean", "training/return_mean"} <= set(tags)
    assert [e.step for e in events.Tensors("evaluation/return_mean")] == sorted(
        line.steps for line in RunFiles(tmp_path, "random", 0).read().lines
    )
