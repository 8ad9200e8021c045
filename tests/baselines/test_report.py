from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from matplotlib.cbook import is_math_text
from matplotlib.figure import Figure
from scipy.stats import sem, t

from baselines.curves import LIGHT, draw_curves, on_one_grid, plain
from baselines.environment import EnvironmentSpec
from baselines.experiment import Entry, Experiment
from baselines.files import parse_json
from baselines.records import RecordError, RunFiles, open_log
from baselines.report import summarise, write_report
from baselines.study import open_study, read_runs
from tests.baselines.fakes import FakeSettings, experiment, install, record


@pytest.fixture(autouse=True)
def fake(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch)


def write_runs(folder: Path, name: str, finals: list[dict[str, Any]]) -> None:
    for seed, final in enumerate(finals):
        with open_log(RunFiles(folder, name, seed).records) as log:
            early = {"episodes": 50, "steps": 200, "train_seconds": 0.5, "return_mean": 0.1}
            log.append(record(contender=name, seed=seed, final=False, **early))
            log.append(record(contender=name, seed=seed, **final))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    chosen = experiment(Entry.of("fake"), Entry.of("random"), seeds=3)
    open_study(tmp_path, chosen, "bnprl compare X --agents '<b>'")
    means = [(1.0, 0.9), (2.0, 1.9), (4.0, 4.1)]
    finals = [{"return_mean": m, "exact_value": e, "steps": 300} for m, e in means]
    write_runs(tmp_path, "fake", finals)
    write_runs(tmp_path, "random", [{"final": False}])
    return tmp_path


def rows(chosen: Experiment, folder: Path) -> dict[tuple[str, bool], dict[str, Any]]:
    found = summarise(chosen, read_runs(chosen, folder))["rows"]
    return {(row["agent"], row["reference"]): row for row in found}


def test_the_summary_is_over_seeds_by_final_evaluations(folder: Path) -> None:
    summary = write_report(folder)
    assert summary == parse_json((folder / "summary.json").read_bytes())
    assert summary["env"] == "bnprl/Hallway-v0"
    assert summary["metric"] == "mean discounted return"
    assert summary["unfinished_runs"] == 3
    assert summary["failed_runs"] == {}
    row = summary["rows"][0]
    assert row["agent"] == "fake"
    assert row["mean"] == pytest.approx(7 / 3)
    assert (row["ci_low"], row["ci_high"]) == t.interval(0.95, 2, 7 / 3, sem([1.0, 2.0, 4.0]))
    assert row["exact"] == pytest.approx(2.3)
    assert row["exact_ci_low"] < 0.9 < 4.1 < row["exact_ci_high"]
    assert (row["seeds"], row["steps"], row["episodes"]) == (3, 300, 100)
    assert row["train_seconds"] == 1.5


def test_failed_runs_are_named_with_the_reason_of_the_first(folder: Path) -> None:
    for seed, reason in ((1, "ValueError: <broken>"), (2, "OSError: full")):
        files = RunFiles(folder, "random", seed)
        files.error.write_text(f"Traceback\n  somewhere\n{reason}\n")
    RunFiles(folder, "fake", 0).error.write_text("of a run that was finished later")
    summary = write_report(folder)
    assert summary["failed_runs"] == {
        "random/1": "ValueError: <broken>",
        "random/2": "OSError: full",
    }
    words = "not finished: 3; failed: random/1, random/2 (ValueError: <broken>)."
    assert words in (folder / "summary.md").read_text()
    assert words.replace("<", "&lt;").replace(">", "&gt;") in (folder / "report.html").read_text()


def test_unfinished_contenders_have_an_empty_row(folder: Path) -> None:
    row = write_report(folder)["rows"][1]
    assert (row["agent"], row["mean"], row["seeds"]) == ("random", None, 0)


def test_references_are_the_registrys(folder: Path) -> None:
    found = [row for row in write_report(folder)["rows"] if row["reference"]]
    assert {row["agent"] for row in found} >= {"random", "best memoryless", "best known"}
    assert found[0]["mean"] == 0.042233
    assert found[0]["ci_low"] is None
    variant = Experiment(
        EnvironmentSpec("bnprl/Hallway-v0", {"resetting": True}), (Entry.of("fake"),), steps=9
    )
    assert not any(reference for _, reference in rows(variant, folder))


def test_one_seed_has_no_interval_and_a_missing_exact_value_no_cell(tmp_path: Path) -> None:
    chosen = experiment(seeds=2)
    write_runs(tmp_path, "fake", [{"exact_value": 1.0}])
    row = rows(chosen, tmp_path)["fake", False]
    assert (row["mean"], row["ci_low"], row["ci_high"]) == (0.25, None, None)
    assert (row["exact"], row["exact_ci_low"]) == (1.0, None)
    write_runs(tmp_path, "fake", [{"exact_value": 1.0}, {"exact_value": None}])
    assert rows(chosen, tmp_path)["fake", False]["exact"] is None


def test_the_markdown_table(folder: Path) -> None:
    write_report(folder)
    lines = (folder / "summary.md").read_text().splitlines()
    assert lines[0] == "# bnprl/Hallway-v0"
    assert "| fake | 2.333 | −1.461 to 6.128 | 2.300 | 3 | 300 | 100 | 1.5 |" in lines
    assert "| random | – | – | – | – | – | – | – |" in lines
    assert any(line.startswith("| best known (reference) | 0.515 |") for line in lines)
    assert len({line.count("|") for line in lines if line.startswith("|")}) == 1


class Page(HTMLParser):
    """Collects what a page refers to, and checks that its elements are closed."""

    def __init__(self) -> None:
        super().__init__()
        self.sources: list[str] = []
        self.open: list[str] = []
        self.cells: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag not in ("link", "iframe", "b")
        self.sources += [value or "" for key, value in attrs if key in ("src", "srcset", "href")]
        if tag not in ("meta", "source", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "td":
            self.cells.append(data)


def test_the_page_is_self_contained_and_complete(folder: Path) -> None:
    write_report(folder)
    text = (folder / "report.html").read_text()
    page = Page()
    page.feed(text)
    assert page.open == []
    assert len(page.sources) == 2
    assert all(source.startswith("data:image/png;base64,") for source in page.sources)
    assert not re.search(r"https?://|url\(|@import", text)
    assert "bnprl compare X --agents &#x27;&lt;b&gt;&#x27;" in text
    assert page.cells[:3] == ["fake", "2.333", "−1.461 to 6.128"]
    for part in ("prefers-color-scheme: dark", "<dt>gain</dt><dd>1.0</dd>", "<dt>numpy</dt>"):
        assert part in text
    assert "width=device-width" in text


def test_names_from_outside_cannot_become_markup(tmp_path: Path) -> None:
    chosen = Experiment(
        EnvironmentSpec("<script>alert(1)</script>.POMDP"), (Entry.of("fake"),), steps=5
    )
    open_study(tmp_path, chosen, "</pre><script>")
    write_report(tmp_path)
    text = (tmp_path / "report.html").read_text()
    assert text.count("<script>") == 1
    assert "&lt;script&gt;alert(1)" in text


def test_names_from_outside_are_drawn_as_they_are(tmp_path: Path) -> None:
    chosen = Experiment(EnvironmentSpec("$_$/$^$.POMDP"), (Entry.of("fake"),), steps=5)
    open_study(tmp_path, chosen, "bnprl compare")
    write_runs(tmp_path, "fake", [{}])
    write_report(tmp_path)
    for text in ("$_$", r"a\$b$", "one $", "none"):
        assert not is_math_text(plain(text))
        assert plain(text).replace(r"\$", "$") == text  # as Matplotlib does


def test_files_replace_each_other_and_nothing_else_is_left(folder: Path) -> None:
    first = write_report(folder)
    names = sorted(path.name for path in folder.iterdir())
    assert names == [
        "curves.png",
        "experiment.json",
        "report.html",
        "runs",
        "summary.json",
        "summary.md",
    ]
    assert write_report(folder) == first
    assert (folder / "curves.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_a_folder_without_experiment_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="holds no experiment"):
        write_report(tmp_path)


def test_a_curve_lasts_as_long_as_its_slowest_run() -> None:
    times = [(1.0, 3.0, 4.0), (2.0, 6.0, 10.0)]
    runs = [
        [record(train_seconds=t, return_mean=t * scale) for t in of_run]
        for of_run, scale in zip(times, (1.0, 10.0), strict=True)
    ]
    grid, values = on_one_grid(runs, "train_seconds", lambda record: record.return_mean)
    assert (grid[0], grid[-1]) == (2.0, 10.0)
    assert values[:, 0] == pytest.approx([2.0, 20.0])
    assert values[:, -1] == pytest.approx([4.0, 100.0])
    assert (values[0][grid >= 4.0] == 4.0).all()


def test_the_curves_show_every_finished_contender(monkeypatch: pytest.MonkeyPatch) -> None:
    figures: list[Figure] = []
    save = Figure.savefig

    def keep(figure: Figure, *arguments: Any, **options: Any) -> None:
        figures.append(figure)
        save(figure, *arguments, **options)

    monkeypatch.setattr(Figure, "savefig", keep)
    curve = [
        record(episodes=e, steps=5 * e, train_seconds=e / 100, return_mean=e / 10, final=e == 40)
        for e in (10, 20, 40)
    ]
    curve.insert(2, record(steps=200, return_mean=99.0, final=False))  # the same policy, again
    other = [record(steps=200, train_seconds=99.0, return_mean=9.0)]
    chosen = experiment(Entry.of("fake"), Entry.of("fake", FakeSettings(), "once"))
    curves = {"fake": [curve, curve], "once": [other], "none": []}
    picture = draw_curves(chosen, curves, [{"agent": "best known", "mean": 8.0}], LIGHT)
    assert picture.startswith(b"\x89PNG")
    left, right = figures[0].axes
    lines = {str(line.get_label()): line for line in left.lines}
    assert lines["fake"].get_xdata()[0] == 50  # type: ignore[index]
    assert lines["fake"].get_ydata()[-1] == pytest.approx(4.0)  # type: ignore[index]
    assert [text.get_text() for text in figures[0].legends[0].get_texts()] == ["fake", "once"]
    assert right.get_xscale() == "log"  # 99 seconds against 0.4
    assert right.texts[0].get_text() == " best known 8"
    assert len(picture) > 10_000
