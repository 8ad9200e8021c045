"""Ready-made experiments: found, complete, run, resumed and drawn."""

import json

import gymnasium as gym
import numpy as np
import pytest
from matplotlib.figure import Figure

from baselines import cli, reproduction
from baselines.curves import LIGHT
from baselines.environment import EnvironmentSpec
from baselines.experiment import Entry, Experiment
from baselines.experiments import figure_3_5
from baselines.experiments.figure_3_3 import largest_values
from baselines.figures import draw_panel, draw_references
from baselines.reproduction import (
    EXACT,
    LENGTH,
    REWARD_PER_STEP,
    Comparison,
    Computation,
    Reproduction,
)
from bnprl_agents import LinearQ
from bnprl_envs.registry import Reference
from tests.baselines.fakes import record

TINY = Reproduction(
    title="tiny",
    panels=(
        Comparison(
            "grid",
            "a grid",
            Experiment(
                EnvironmentSpec("bnprl/Gridworld-v0"),
                (Entry("tabular", "tabular-q", {}), Entry("linear", "linear-q", {})),
                steps=10**9,
                seeds=50,
            ),
            quick={"steps": 300, "seeds": 2, "eval_points": 3, "eval_episodes": 5},
            measure=EXACT,
            labels={"tabular": "a table"},
        ),
        Comparison(
            "grid",
            "the same runs",
            Experiment(
                EnvironmentSpec("bnprl/Gridworld-v0"),
                (Entry("tabular", "tabular-q", {}), Entry("linear", "linear-q", {})),
                steps=10**9,
                seeds=50,
            ),
            quick={"steps": 300, "seeds": 2, "eval_points": 3, "eval_episodes": 5},
            measure=LENGTH,
        ),
        Computation(
            "line",
            "a line",
            lambda quick: {"one": (np.arange(3.0), np.array([[1.0, 2.0, 4.0]]))},
            x="x",
            y="y",
            logarithmic=True,
        ),
    ),
    notes=("a note",),
)


def test_names_and_listing(capsys):
    assert {f"figure-3.{n}" for n in range(1, 7)} <= set(reproduction.names())
    assert cli.main(["list", "experiments"]) == 0
    assert "figure-3.1  Figure 3.1: batch GP fitted Q-iteration" in capsys.readouterr().out


@pytest.mark.parametrize("name", reproduction.names())
def test_every_experiment_can_be_built_in_both_sizes(name):
    found = reproduction.find(name)
    assert reproduction.summary(reproduction.names()[name]).endswith(".")
    for panel in found.panels:
        if isinstance(panel, Comparison):
            for quick in (True, False):
                for experiment in panel.sized(quick).values():
                    for entry in experiment.entries:
                        entry.build_settings()


def test_an_unknown_name(capsys):
    assert cli.main(["reproduce", "figure-3.9"]) == 2
    assert "unknown experiment 'figure-3.9'; did you mean figure-3." in capsys.readouterr().err


def test_panels_are_run_resumed_and_reported(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("baselines.reproduce.find", lambda name: TINY)
    command = ["reproduce", "tiny", "--quick", "--out", str(tmp_path), "--jobs", "1"]
    assert cli.main([*command, "--no-progress"]) == 0
    first = json.loads((tmp_path / "summary.json").read_text())
    records = tmp_path / "grid" / "runs" / "tabular" / "0.jsonl"
    before = records.read_bytes(), records.stat().st_mtime_ns
    assert cli.main([*command, "--no-progress"]) == 0
    assert (records.read_bytes(), records.stat().st_mtime_ns) == before
    assert json.loads((tmp_path / "summary.json").read_text()) == first
    (tmp_path / "figure.png").unlink()
    (tmp_path / "summary.json").write_text('{"experiment": "tiny", "quick": true}')
    assert cli.main(["report", str(tmp_path)]) == 0
    assert json.loads((tmp_path / "summary.json").read_text()) == first
    grid, same, line = first["panels"]
    agents = [row["agent"] for row in grid["rows"]]
    assert agents[:2] == ["a table", "linear"]
    assert "random" in agents
    assert 0.0 <= grid["rows"][0]["mean"] <= 0.4379
    assert grid["rows"][0]["seeds"] == 2
    assert same["measure"] == LENGTH.label
    assert line["rows"][0]["mean"] == 4.0
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
    text = (tmp_path / "summary.md").read_text()
    assert "# tiny (quick size" in text
    assert "| one | 4 |" in text
    assert "| 300 |" in text  # steps used
    assert "a note" in text
    assert "figure: " in capsys.readouterr().out


def test_failed_runs_are_named_on_the_page(tmp_path, monkeypatch):
    monkeypatch.setattr("baselines.reproduce.find", lambda name: TINY)
    assert cli.main(["reproduce", "tiny", "--quick", "--out", str(tmp_path)]) == 0
    assert "failed:" not in (tmp_path / "report.html").read_text()
    run = tmp_path / "grid" / "runs" / "linear" / "1.jsonl"
    run.write_bytes(b"")
    run.with_name("1.error.txt").write_text("Traceback\nMemoryError: no <room>\n")
    assert cli.main(["report", str(tmp_path)]) == 0
    reason = "failed: grid/linear/1 (MemoryError: no "
    assert f"{reason}<room>)" in (tmp_path / "summary.md").read_text()
    assert f"{reason}&lt;room&gt;)" in (tmp_path / "report.html").read_text()


def test_all_experiments_are_one_page(tmp_path, monkeypatch):
    line = Reproduction("<line>", TINY.panels[2:], notes=("1 < 2, as `a < b` says",))
    both = Reproduction("lines in a table", line.panels, shape="table")
    monkeypatch.setattr(
        "baselines.reproduce.names", lambda: {"figure-1.1": None, "table-1.2": None}
    )
    monkeypatch.setattr("baselines.reproduce.find", {"figure-1.1": line, "table-1.2": both}.get)
    assert cli.main(["reproduce", "--all", "--quick", "--out", str(tmp_path)]) == 0
    page = (tmp_path / "report.html").read_text()
    assert page.count("<section") == 2
    assert "&lt;line&gt;" in page
    assert page.count("<h2>&lt;line&gt;</h2>") == 1
    assert "1 &lt; 2, as <code>a &lt; b</code> says" in page
    assert "bnprl reproduce figure-1.1 --quick" in page
    alone = (tmp_path / "table-1.2" / "report.html").read_text()
    assert alone.count(">lines in a table<") == 2  # title and heading
    (tmp_path / "table-1.2" / "figure.png").unlink()
    assert cli.main(["report", str(tmp_path / "table-1.2")]) == 0
    assert (tmp_path / "table-1.2" / "figure.png").is_file()
    for wrong in ([], ["figure-1.1", "--all"]):
        assert cli.main(["reproduce", *wrong]) == 2


def test_a_table_has_a_row_for_each_environment(tmp_path, monkeypatch, capsys):
    small = {"seeds": 2, "eval_points": 1, "eval_episodes": 5}
    panels = tuple(
        Comparison(
            name,
            name.title(),
            Experiment(EnvironmentSpec(id), (Entry("random", "random", {}),), steps=200, seeds=9),
            quick=small,
            slow=Experiment(EnvironmentSpec(id), (Entry("late", "random", {}),), steps=100),
            slow_quick=small | {"seeds": 1},
            measure=REWARD_PER_STEP,
            references=(Reference("the source's", 0.25, "a table"),),
            computed=lambda name=name: (Reference(f"best on {name}", 0.5, "a search"),),
        )
        for name, id in (("maze", "bnprl/CheeseMaze-v0"), ("grid", "bnprl/Grid4x4-v0"))
    )
    tiny = Reproduction("tiny", panels, shape="table")
    monkeypatch.setattr("baselines.reproduce.find", lambda name: tiny)
    command = ["reproduce", "tiny", "--quick", "--out", str(tmp_path), "--jobs", "1"]
    assert cli.main([*command, "--no-progress"]) == 0
    maze, grid = json.loads((tmp_path / "summary.json").read_text())["panels"]
    ours, late, *_ = maze["rows"]
    assert (ours["agent"], ours["seeds"]) == ("random", 2)
    assert 0.0 <= late["x"] < ours["x"] <= 200.0
    assert (late["agent"], late["seeds"], late["ci_low"]) == ("late", 1, None)
    assert 0.0 < ours["mean"] < 0.25  # a reward of 1 at the goal, which is some steps away
    assert [row["agent"] for row in grid["rows"][2:]] == ["the source's", "best on grid"]
    text = (tmp_path / "summary.md").read_text()
    assert "|  | random | late | the source's | best on maze | best on grid |" in text
    (row,) = (line for line in text.splitlines() if line.startswith("| Maze |"))
    assert " ± " in row
    assert row.endswith("| 0.25 | 0.5 | – |")
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")


def test_numbers_that_a_record_lacks_are_none():
    assert REWARD_PER_STEP.of(record(reward_mean=1.0, length_mean=0.0)) is None
    assert figure_3_5.error(record(metrics={})) is None
    assert figure_3_5.error(record(metrics={"td_error": 0.5})) == 0.5
    assert figure_3_5.error(record(metrics={"diverged": 1.0})) == figure_3_5.DIVERGED


@pytest.mark.parametrize(("last", "scale"), [(1000.0, "log"), (-1000.0, "symlog")])
def test_a_logarithmic_axis_takes_negative_numbers(last, scale):
    axes = Figure().subplots()
    lines = {"one": (np.arange(2.0), np.array([[30.0, last]]))}
    draw_panel(axes, TINY.panels[2], lines, ["one"], LIGHT)
    assert axes.get_yscale() == scale
    low, high = axes.get_ylim()
    assert low <= last <= high


def test_references_too_close_for_a_name_each_are_named_above_the_highest():
    axes = Figure().subplots()
    axes.set_ylim(0.0, 100.0)
    rows = [{"agent": name, "mean": mean} for name, mean in (("c", 53), ("a", 10), ("b", 50))]
    draw_references(axes, rows, LIGHT)
    assert {text.get_text(): text.xy[1] for text in axes.texts} == {"a": 10.0, "b, c": 53.0}


def test_the_star_diverges_on_fixed_bases_only():
    lines = largest_values(True)
    _, fixed = lines["Q-learning on fixed bases"]
    _, ours = lines["GPQ"]
    assert (fixed[:, -1] > 2 * fixed[:, 0]).all()
    assert (ours[:, -1] < ours[:, 0]).all()
    assert (ours < 10.0).all()


def test_plot_draws_values_and_refuses_what_has_none(tmp_path, capsys):
    for agent in ("gpq", "predictive-actor-critic"):
        arguments = [
            "train",
            "bnprl/Gridworld-v0",
            "--agent",
            agent,
            "--out",
            str(tmp_path / agent),
        ]
        settings = ["--grid-columns", "5"] if agent == "gpq" else []
        sizes = ["--steps", "200", "--eval-points", "1", "--eval-episodes", "5", "--no-progress"]
        assert cli.main([*arguments, *settings, *sizes]) == 0
    policy = tmp_path / "gpq" / "runs" / "gpq" / "0.policy.npz"
    assert cli.main(["plot", str(policy)]) == 0
    assert policy.with_suffix(".png").read_bytes().startswith(b"\x89PNG")
    agent = "predictive-actor-critic"
    other = tmp_path / agent / "runs" / agent / "0.policy.npz"
    assert cli.main(["plot", str(other)]) == 2
    assert "holds neither action values nor controllers" in capsys.readouterr().err


def test_plot_names_axes_and_actions_as_the_environment_does(tmp_path, monkeypatch):
    env = gym.make("bnprl/InvertedPendulum-v0")
    policy = tmp_path / "policy.npz"
    LinearQ(env.observation_space, env.action_space, discount=0.95, seed=0).save(policy)
    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, *_, **__: drawn.extend(figure.axes))
    assert cli.main(["plot", str(policy), "--env", "bnprl/InvertedPendulum-v0"]) == 0
    values, greedy, _ = drawn
    assert {axes.get_xlabel() for axes in (values, greedy)} == {"angle"}
    assert {axes.get_ylabel() for axes in (values, greedy)} == {"velocity"}
    words = [text.get_text() for text in greedy.get_legend().get_texts()]
    assert words == ["push left", "no push", "push right"]
    assert cli.main(["plot", str(policy)]) == 0  # the environment is not known
    assert drawn[3].get_xlabel() == "observation 0"
