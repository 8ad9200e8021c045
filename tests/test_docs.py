"""The pages of the environments say everything that the suite promises, for every id."""

import importlib.util
from pathlib import Path

import pytest
from PIL import Image

import bnprl_envs

SCRIPT = Path(__file__).parents[1] / "docs" / "generate.py"
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


@pytest.fixture(scope="module")
def generate():
    spec = importlib.util.spec_from_file_location("generate", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


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
