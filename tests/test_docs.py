"""The pages of the environments say everything that the suite promises, for every id."""

import importlib.util
import json
import re
from pathlib import Path

import pytest
from PIL import Image

import bnprl_envs

DOCS = Path(__file__).parents[1] / "docs"
WRITTEN = sorted(
    path for path in DOCS.rglob("*.md") if path.parent.name not in ("environments", "experiments")
)
README = DOCS.parent / "README.md"
SECTIONS = (
    "Description",
    "Action Space",
    "Observation Space",
    "Rewards",
    "Starting State",
    "Episode End",
    "Arguments",
    "References",
    "Version History",
    "Values",
    "Episodes",
)


def script(name):
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def generate():
    return script("generate")


def blocks(path):
    """The Python of a page, in one piece."""
    return "\n".join(re.findall(r"^```python\n(.*?)^```", path.read_text(), re.M | re.S))


@pytest.mark.parametrize(
    "path", [p for p in (*WRITTEN, README) if blocks(p)], ids=lambda path: path.name
)
def test_what_a_page_shows_runs(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("mine.POMDP").write_text(
        "discount: 0.9\nvalues: reward\nstates: 2\nactions: 2\nobservations: 2\n"
        "T: * identity\nO: * uniform\nR: 0 : 0 : * : * 1.0\n"
    )
    exec(compile(blocks(path), str(path), "exec"), {"__name__": "page"})


def test_an_experiments_page_has_its_kept_numbers(tmp_path):
    experiments = script("experiments")
    rows = [
        {"agent": "ours", "mean": 0.5, "ci_low": 0.4, "ci_high": 0.6, "median": 0.5, "seeds": 3}
        | {"x": 100.0, "source": None},
        {"agent": "printed", "mean": 0.25, "ci_low": None, "ci_high": None, "median": 0.25}
        | {"seeds": 1, "x": None, "source": "Table 1"},
    ]
    panel = {"name": "p", "title": "Panel", "measure": "|value|", "x": "steps", "rows": rows}
    summary = {"shape": "table", "command": "bnprl reproduce figure-3.1", "panels": [panel]}
    assert "No full run is kept yet" in experiments.page("figure-3.1", tmp_path)
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    text = experiments.page("figure-3.1", tmp_path)
    assert "| Panel | 0.5 ± 0.1 | 0.25 |" in text
    assert "| ours | 0.5 | 0.4 to 0.6 | 0.5 | 3 | 100 |" in text
    assert "figure-3.1.md" in experiments.listing(["figure-3.1"])


@pytest.mark.parametrize("id", bnprl_envs.environment_ids())
def test_a_page_has_every_section_and_reference(generate, id):
    entry = bnprl_envs.entry(id)
    episode = generate.Episode(1.25, 7, [])
    text = generate.page(entry, "a policy", episode, episode)
    headings = [line[3:] for line in text.splitlines() if line.startswith("## ")]
    assert headings == list(SECTIONS)
    for reference in entry.references:
        assert f"| {reference.value:.9g} | {reference.source} |" in text
    assert "Args:" not in text
    assert "it earned 1.25 in 7 steps" in text


@pytest.mark.parametrize("name", ["Tiger", "Gridworld", "RecyclingRobots", "PuddleWorld"])
def test_a_good_policy_is_better_than_a_random_one(generate, name, monkeypatch, tmp_path):
    monkeypatch.setattr(generate, "PLANNING_SECONDS", 0.2)
    monkeypatch.setattr(generate, "FRAMES", 3)
    entry = bnprl_envs.entry(f"bnprl/{name}-v0")
    good = generate.play(entry, generate.good_policy(entry)[1])
    random = generate.play(entry, generate.random_policy(entry))
    assert good.value > random.value
    assert len(good.frames) == 3
    generate.save_picture(good, tmp_path / "good.gif")
    with Image.open(tmp_path / "good.gif") as picture:
        assert picture.n_frames > 1


def test_the_readme_has_the_kept_numbers():
    learners = script("learners")
    readme = README.read_text("utf-8")
    assert readme.count(learners.BEGIN) == readme.count(learners.END) == 1
    assert learners.with_tables(readme) == readme, "run python docs/learners.py"
    for table in (learners.team_table(), learners.deep_table([0.9]), learners.source_table()):
        header, *body = table
        assert len(body) >= 5
        assert {len(row) for row in body} == {len(header)}


def test_the_table_of_one_learner_leaves_others_out(tmp_path, monkeypatch):
    learners = script("learners")
    monkeypatch.setattr(learners, "RESULTS", tmp_path)
    (tmp_path / "pomdp-learners").mkdir()
    with (tmp_path / "pomdp-learners" / "records.jsonl").open("w") as file:
        for agent, value in (("predictive-actor-critic", 0.8), ("actor-critic", 0.2)):
            run = {"agent": agent, "environment": "bnprl/CheeseMaze-v0", "goals": [100_000]}
            score = {"steps": 99_000, "value": value, "seconds": 1.0}
            file.write(json.dumps({"run": run, "scores": [score]}) + "\n")
    _, row = learners.pomdp_table()
    assert row[:3] == ["CheeseMaze", "100,000", "0.8"]
