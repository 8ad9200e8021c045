from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from gymnasium.spaces import Discrete

from baselines.cli import main
from baselines.contenders import CONTENDERS
from baselines.experiment import Entry
from baselines.files import folder_lock
from baselines.records import RunFiles, open_log, read_records
from baselines.study import open_study
from bnprl_agents import RandomAgent
from tests.baselines.fakes import experiment, install, record
from tests.baselines.interruption import ROOT, command, finish, kill_after, lines, summary

HALLWAY = "bnprl/Hallway-v0"
SMALL = ["--episodes", "200", "--eval-episodes", "50", "--eval-points", "2", "--no-progress"]


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command that must fail with exit code 2; return its one line without the prefix."""
    assert main(arguments) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("bnprl: error: ")
    assert shown.err.count("\n") == 1
    return shown.err.removeprefix("bnprl: error: ").rstrip("\n")


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys, baselines.cli as cli\n"
        "try: cli.main(['--help'])\n"
        "except SystemExit as end: assert end.code == 0\n"
        "heavy = {'numpy', 'numba', 'scipy', 'matplotlib', 'torch', 'gymnasium', 'joblib'}\n"
        "assert not heavy & sys.modules.keys(), heavy & sys.modules.keys()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for name in ("list", "train", "evaluate", "compare", "report"):
        assert name in done.stdout


def test_version_and_lists(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("bnprl ")
    assert main(["list", "envs"]) == 0
    assert [HALLWAY, "robot"] in [line.split()[:2] for line in capsys.readouterr().out.splitlines()]
    assert main(["list", "agents"]) == 0
    assert {line.split()[0] for line in capsys.readouterr().out.splitlines()} >= {
        "online-em",
        "ppo",
    }
    assert main(["list", "experiments"]) == 0
    assert capsys.readouterr().out.count("\n") >= 1


@pytest.mark.parametrize("agent", list(CONTENDERS))
def test_every_agents_settings_are_flags(agent: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(["train", "--agent", agent, "--help"])
    assert end.value.code == 0
    shown = capsys.readouterr().out
    for name in vars(CONTENDERS[agent].settings):
        assert f"--{name.replace('_', '-')}" in shown


def test_train_evaluate_report(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    train = ["train", HALLWAY, "--agent=online-em", "--nodes", "3", "--seed", "7", *SMALL]
    assert main([*train, "--out", str(out)]) == 0
    assert "online-em" in capsys.readouterr().out
    description = json.loads((out / "experiment.json").read_bytes())
    assert description["entries"][0]["settings"]["nodes"] == 3
    assert description["commands"] == [f"bnprl {' '.join([*train, '--out', str(out)])}"]
    final = RunFiles(out, "online-em", 0).read().lines[-1]
    assert final.final
    assert final.exact_value is not None

    assert main(["evaluate", str(out), "--episodes", "500", "--no-progress"]) == 0
    cells = capsys.readouterr().out.splitlines()[-1].split()
    assert cells[0] == "online-em"
    assert float(cells[-1]) == pytest.approx(final.exact_value, abs=1e-3)
    low, high = float(cells[2]), float(cells[4])
    assert low < float(cells[1]) < high
    policy = RunFiles(out, "online-em", 0).policy(".npz")
    alone = tmp_path / "policy.npz"
    alone.write_bytes(policy.read_bytes())
    assert main(["evaluate", str(policy), "--episodes", "500", "--no-progress"]) == 0
    here = capsys.readouterr().out.splitlines()[-1].split()[1:]
    assert here == cells[1:]
    elsewhere = ["evaluate", str(alone), "--env", HALLWAY, "--episodes", "500", "--no-progress"]
    assert main(elsewhere) == 0
    assert capsys.readouterr().out.splitlines()[-1].split()[1:] == cells[1:]
    assert "--env ID" in refused(capsys, "evaluate", str(alone))

    summary = (out / "summary.json").read_bytes()
    (out / "summary.json").unlink()
    assert main(["report", str(out)]) == 0
    assert (out / "summary.json").read_bytes() == summary
    capsys.readouterr()
    assert "online-em.nodes is 3 there, 4 here" in refused(
        capsys, *[part.replace("3", "4") for part in train], "--out", str(out)
    )
    with folder_lock(out):
        assert "another bnprl command" in refused(capsys, *train, "--out", str(out))


def test_a_model_file_is_an_environment(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = tmp_path / "two.POMDP"
    model.write_text(
        "discount: 0.9\nvalues: reward\nstates: 2\nactions: 2\nobservations: 2\nstart: uniform\n"
        "T: * uniform\nO: * identity\nR: 0 : 0 : * : * 1.0\n"
    )
    out = str(tmp_path / "out")
    assert main(["train", str(model), "--agent", "random", *SMALL, "--out", out]) == 0
    capsys.readouterr()
    text = model.read_text()
    model.write_text(text.replace("uniform\nO", "0.5 0.4\nO").replace("T: *", "T: * : 0"))
    message = refused(capsys, "train", str(model), "--agent", "random", *SMALL, "--out", out)
    assert str(model) in message
    assert "sum" in message
    model.write_text(text.replace("R: 0", "R: nine"))
    message = refused(capsys, "train", str(model), "--agent", "random", *SMALL, "--out", out)
    assert message.startswith(f"{model}:9: ")


EM = ["compare", HALLWAY, "--agents", "online-em", *SMALL]


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (
            ["train", "bnprl/Halway-v0", "--agent", "random", *SMALL],
            "did you mean bnprl/Hallway-v0",
        ),
        (["compare", "Hallway", "--agents", "random", *SMALL], "did you mean bnprl/Hallway-v0"),
        (["compare", "bnprl/DecTiger-v0", "--agents", "ppo", *SMALL], "has several agents"),
        (["train", HALLWAY, "--agent", "ppo-shared", *SMALL], "has one agent; ppo"),
        (["train", "no/such.POMDP", "--agent", "random", *SMALL], "no such model file"),
        (["train", HALLWAY, "--agent", "onlin-em", *SMALL], "did you mean online-em"),
        (["compare", HALLWAY, "--agents", "random", "pppo", *SMALL], "did you mean ppo"),
        (["compare", HALLWAY, "--agents", "random", "random", *SMALL], "given twice"),
        (["train", HALLWAY, "--agent", "random"], "exactly one of --episodes and --steps"),
        (["train", HALLWAY, "--agent", "random", *SMALL, "--steps", "5"], "exactly one of"),
        (["train", HALLWAY, "--agent", "random", "--steps", "0"], "--steps: 0"),
        (["train", HALLWAY, "--agent", "random", "--steps", "5", "--seed", "-1"], "--seed: -1"),
        (["train", HALLWAY, "--agent", "online-em", "--nodes", "0", *SMALL], "nodes"),
        (["compare", HALLWAY, "--agents", "random", *SMALL, "--seeds", "0"], "--seeds: 0"),
        (["compare", HALLWAY, "--agents", "random", *SMALL, "--jobs", "0"], "--jobs: 0"),
        (["train", HALLWAY, "--agent", "ppo", "--steps", "9"], "one rollout of 2048"),
        (["compare", HALLWAY, "--agents", "ppo", "--steps", "9"], "one rollout of 2048"),
        (["train", "bnprl/Tag-v0", "--agent", "batch-em", *SMALL], "; give --reward-shift 10"),
        (
            ["compare", "bnprl/Tag-v0", "--agents", "online-em", *SMALL],
            "; give --set online-em.reward_shift=10",
        ),
        ([*EM, "--set", "nodes=3"], "must be AGENT.FIELD=VALUE, AGENT one of online-em"),
        ([*EM, "--set", "online-em.noddes=3"], "did you mean nodes"),
        ([*EM, "--set", "online-em.nodes=many"], "'many' must be a whole number"),
        ([*EM, "--set", "online-em.nodes=2", "online-em.nodes=3"], "nodes: is given 2 times"),
        ([*EM, "--set", "online-em.nodes=0"], "nodes: 0, must be at least 1"),
    ],
)
def test_bad_arguments_write_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], reason: str
) -> None:
    out = tmp_path / "out"
    assert reason in refused(capsys, *arguments, "--out", str(out))
    assert not out.exists()


COMPLETE = ["--agents", "ppo", "--out", "x"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "a command is missing: list, train, evaluate"),
        (["trian"], "unknown command 'trian'; did you mean train?"),
        (["--hlp"], "unknown option --hlp; did you mean --help?"),
        (["train"], "train: missing ID, --agent, --out; see bnprl train --help"),
        (["compare", HALLWAY, "--agents", "ppo"], "compare: missing --out; see"),
        (["compare", HALLWAY, "--agent", "ppo"], "unknown option --agent; did you mean --agents"),
        (["compare", HALLWAY, "--stepz", "10"], "unknown option --stepz; did you mean --steps"),
        (["compare", HALLWAY, "--no-progres"], "did you mean --no-progress"),
        (["train", HALLWAY, "--agent=online-em", "--nods=3"], "--nods; did you mean --nodes"),
        (["compare", HALLWAY, *COMPLETE, "--steps", "many"], "--steps: 'many' is no whole number"),
        (["compare", HALLWAY, *COMPLETE, "--seeds", "1.5"], "--seeds: '1.5' is no whole number"),
        (["bounds", HALLWAY, "--seconds", "soon"], "--seconds: 'soon' is no number"),
        (["bounds", HALLWAY, "--discount", "x"], "--discount: 'x' is no number"),
        (["compare", HALLWAY, *COMPLETE, "--steps"], "missing value for argument '--steps'"),
        (["compare", HALLWAY, *COMPLETE, "--engine", "spark"], "invalid choice 'spark'"),
        (["list", "x"], "invalid choice 'x' for argument 'what'"),
        (["report", "a", "b"], "unrecognized options: b"),
    ],
)
def test_what_cannot_be_parsed_is_said_in_one_line(
    capsys: pytest.CaptureFixture[str], arguments: list[str], message: str
) -> None:
    assert message in refused(capsys, *arguments)


def test_a_budget_without_an_episode_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    out = tmp_path / "out"
    arguments = ["compare", HALLWAY, "--agents", "online-em", "--steps", "1", "--seeds", "2"]
    assert main([*arguments, "--no-progress", "--jobs", "1", "--out", str(out)]) == 0
    capsys.readouterr()
    (warning,) = caplog.messages
    assert re.fullmatch(
        r"online-em learned nothing in [12] of 2 runs: "
        r"no update fits in a budget of 1 steps; 4,016 are enough",
        warning,
    )
    assert "steps used by online-em</dt>" in (out / "report.html").read_text()


def test_what_the_search_is_told_to_be_enough_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
) -> None:
    settings = ["--explore-seeds", "16", "--judge-seeds", "32"]
    train = ["train", "bnprl/Tiger-v0", "--agent", "controller-search", *settings]
    small = ["--no-progress", "--eval-points", "1", "--eval-episodes", "5"]
    assert main([*train, *small, "--episodes", "2", "--out", str(tmp_path / "few")]) == 0
    (warning,) = caplog.messages
    enough = warning.rpartition("; ")[2].removesuffix(" are enough")
    assert enough == "832"
    assert main([*train, *small, "--episodes", enough, "--out", str(tmp_path / "enough")]) == 0
    assert caplog.messages == [warning]
    capsys.readouterr()


def test_errors_come_before_the_table_and_the_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    install(monkeypatch)
    monkeypatch.setattr("baselines.commands.check_sb3", lambda *_: None)
    monkeypatch.setattr(sys, "stderr", sys.stdout)
    arguments = ["compare", HALLWAY, "--agents", "fake", "--set", "fake.fail=true"]
    assert main([*arguments, *SMALL, "--seeds", "2", "--jobs", "1", "--out", str(tmp_path)]) == 1
    first, second, *_, last = capsys.readouterr().out.splitlines()
    assert "failed: fake/0, fake/1 (RuntimeError: the fake fails)" in first
    assert second.startswith("agent  ")
    assert last == f"report: {tmp_path / 'report.html'}"


def test_folders_and_files_that_are_not_what_they_should_be(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "file"
    file.write_text("not a policy")
    train = ["train", HALLWAY, "--agent", "random", *SMALL, "--out"]
    assert str(file) in refused(capsys, *train, str(file))
    assert str(file) in refused(capsys, *train, str(file / "below"))
    assert f"{file}: not a bnprl policy file" in refused(capsys, "evaluate", str(file))
    assert "no such file or folder" in refused(capsys, "evaluate", str(tmp_path / "none"))
    assert "holds no experiment" in refused(capsys, "evaluate", str(tmp_path))
    assert "holds no experiment" in refused(capsys, "report", str(tmp_path))
    assert "there is no such folder" in refused(capsys, "report", str(tmp_path / "none"))
    assert not (tmp_path / "none").exists()
    assert "--episodes: 0" in refused(capsys, "evaluate", str(tmp_path), "--episodes", "0")
    study = tmp_path / "study"
    study.mkdir()
    open_study(study, experiment(Entry.of("random")), "command")
    assert "holds no policy of a finished run yet" in refused(capsys, "evaluate", str(study))
    for seed in (0, 1):
        files = RunFiles(study, "random", seed)
        with open_log(files.records) as log:
            log.append(record(contender="random", seed=seed))
        policy = files.policy(".npz")
        RandomAgent(Discrete(22), Discrete(5), discount=0.95, seed=seed).save(policy)
    policy.write_bytes(b"damaged")
    assert main(["evaluate", str(study), "--episodes", "10", "--no-progress"]) == 1
    shown = capsys.readouterr()
    assert "random" in shown.out
    assert shown.err.startswith(f"bnprl: error: {policy}: not a bnprl policy file")
    damaged = RunFiles(study, "random", 0).records
    damaged.write_bytes(b"{}\n{}\n")
    assert f"{damaged}:1: " in refused(capsys, "report", str(study))
    assert damaged.read_bytes() == b"{}\n{}\n"
    assert "episodes is 100 there, 200 here" in refused(capsys, *train, str(study))


COMPARE = ["compare", HALLWAY, "--agents", "online-em", "batch-em", "random", "--seeds", "2"]
BUDGET = ["--episodes", "600", "--eval-episodes", "100", "--eval-points", "6", "--no-progress"]


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    out = tmp_path_factory.mktemp("whole") / "out"
    assert main([*COMPARE, *BUDGET, "--jobs", "1", "--out", str(out)]) == 0
    return summary(out)


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_killed_comparison_resumes_to_the_same_summary(
    tmp_path: Path, jobs: str, uninterrupted: dict[str, Any]
) -> None:
    out = tmp_path / "out"
    arguments = [*COMPARE, *BUDGET, "--jobs", jobs, "--out", str(out)]
    for n_lines in (8,) if jobs == "1" else (2, 8, 15):
        assert n_lines <= kill_after(arguments, out, n_lines, timeout=120) < 30
    finished = [path for path in out.glob("runs/*/*.jsonl") if read_records(path).finished]
    stamps = {path: path.stat().st_mtime_ns for path in finished}
    finish(arguments, timeout=300)
    assert summary(out) == uninterrupted
    assert {path: path.stat().st_mtime_ns for path in finished} == stamps
    assert len(lines(out)) == 6


@pytest.mark.skipif(os.name != "posix", reason="limits of a process")
def test_a_full_disk_fails_in_one_line_and_resumes(
    tmp_path: Path, uninterrupted: dict[str, Any]
) -> None:
    import resource

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (2**12, 2**12))

    out = tmp_path / "out"
    arguments = [*COMPARE, *BUDGET, "--jobs", "1", "--out", str(out)]
    _, shown = command(*arguments, preexec_fn=limit).communicate(timeout=240)
    assert shown.splitlines()[-1].startswith("bnprl: error: ")
    assert "Traceback" not in shown
    finish(arguments, timeout=300)
    assert summary(out) == uninterrupted


def heed_interrupts() -> None:
    """Undo what a shell does to what it runs in the background, this test maybe."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.skipif(os.name != "posix", reason="signals of a terminal")
@pytest.mark.parametrize(("number", "whom"), [(signal.SIGINT, "killpg"), (signal.SIGTERM, "kill")])
def test_an_interrupt_says_how_to_go_on(tmp_path: Path, number: int, whom: str) -> None:
    out = tmp_path / "out"
    budget = ["--episodes", "100000", "--eval-episodes", "100", "--eval-points", "100"]  # minutes
    arguments = [*COMPARE, *budget, "--no-progress", "--jobs", "2", "--out", str(out)]
    process = command(*arguments, start_new_session=True, preexec_fn=heed_interrupts)
    deadline = time.monotonic() + 60
    while not sum(lines(out).values()) and time.monotonic() < deadline:
        time.sleep(0.01)
    getattr(os, whom)(
        process.pid, number
    )  # what a terminal does on Ctrl-C, and a scheduler at a job's end
    _, shown = process.communicate(timeout=30)
    assert process.returncode == 128 + number
    assert shown == "bnprl: interrupted; the same command resumes\n"


@pytest.mark.skipif(os.name != "posix", reason="pipes")
@pytest.mark.parametrize("given", [["--help"], ["list", "envs"]])
def test_a_closed_pipe_ends_without_a_word(given: list[str]) -> None:
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [sys.executable, "-m", "baselines.cli", *given],
        cwd=ROOT,
        stdout=writing,
        stderr=subprocess.PIPE,
        check=False,
    )
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, b"")
