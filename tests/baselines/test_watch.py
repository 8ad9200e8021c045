from __future__ import annotations

import sys
from itertools import pairwise
from pathlib import Path

import gymnasium as gym
import numpy as np
import pettingzoo
import pytest
from PIL import Image, ImageSequence

import bnprl_envs
from baselines.cli import main
from baselines.environment import EnvironmentSpec
from baselines.watch import make_env
from baselines.watch_pictures import beside, beside_as_text
from bnprl_agents.random_agent import RandomAgent
from bnprl_envs.rendering import FRAME_SHAPE
from tests.baselines import pairs

TIGER, DEC_TIGER, HALLWAY = "bnprl/Tiger-v0", "bnprl/DecTiger-v0", "bnprl/Hallway-v0"


def policy_file(path: Path, id: str = TIGER) -> str:
    if id == DEC_TIGER:
        env = pettingzoo.make("parallel", id)
        agent = RandomAgent(env.observation_spaces, env.action_spaces, discount=0.9, seed=0)
    else:
        single = gym.make(id)
        agent = RandomAgent(single.observation_space, single.action_space, discount=0.9, seed=0)
    agent.save(path / "policy.npz")
    return str(path / "policy.npz")


def text_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["watch", *arguments]) == 0
    shown: str = capsys.readouterr().out
    return shown


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(["watch", *arguments]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.count("\n") == 1
    return shown.err.removeprefix("bnprl: error: ").rstrip("\n")


def frames_of(path: Path) -> list[np.ndarray]:
    with Image.open(path) as animation:
        assert animation.format == "GIF"
        return [np.asarray(f.convert("RGB")) for f in ImageSequence.Iterator(animation)]


@pytest.mark.parametrize("id", [TIGER, DEC_TIGER])
@pytest.mark.parametrize("given", [True, False])
def test_a_gif_has_a_frame_for_every_step(
    id: str, given: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = ["--policy", policy_file(tmp_path, id)] if given else []
    gif = tmp_path / "episode.gif"
    options = [id, *policy, "--episodes", "2", "--steps", "4", "--gif", str(gif), "--no-progress"]
    assert text_of(capsys, *options) == f"{gif}: 10 frames\n"
    frames = frames_of(gif)
    assert len(frames) == 2 * (1 + 4)
    assert {frame.shape for frame in frames} == {(480, 840, 3)}
    assert all((one != other).any() for one, other in pairwise(frames))
    assert [path.name for path in tmp_path.iterdir() if "partial" in path.name] == []
    first = gif.read_bytes()
    text_of(capsys, *options)
    assert gif.read_bytes() == first  # the seed fixes everything
    text_of(capsys, *options, "--seed", "1")
    assert gif.read_bytes() != first


def test_a_gif_shows_what_the_environment_renders(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gif = tmp_path / "gridworld.gif"  # its start is fixed
    text_of(capsys, "bnprl/Gridworld-v0", "--steps", "1", "--gif", str(gif), "--no-progress")
    env = gym.make("bnprl/Gridworld-v0", render_mode="rgb_array")
    env.reset(seed=0)
    expected = np.asarray(env.render()).astype(int)
    shown = frames_of(gif)[0][:, : FRAME_SHAPE[1]].astype(int)
    assert np.abs(shown - expected).max() < 16  # a GIF has 256 colours


def test_text_shows_every_step_the_return_and_the_nodes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shown = text_of(capsys, TIGER, "--policy", policy_file(tmp_path), "--steps", "5")
    blocks = shown.strip().split("\n\n left")
    assert len(blocks) == 6
    value, rewards = 0.0, []
    for step, block in enumerate(blocks):
        assert f"step {step} " in block
        assert "nodes of agent_0: 0 1.00" in block
        if step:
            rewards.append(float(block.split("reward ")[1].split("\n")[0]))
            value += 0.95 ** (step - 1) * rewards[-1]
        assert f"discounted return {value:.3f}" in block
    assert set(rewards) <= {-1.0, -100.0, 10.0}


@pytest.mark.parametrize("id", bnprl_envs.environment_ids())
def test_random_actions_in_every_environment(id: str, capsys: pytest.CaptureFixture[str]) -> None:
    shown = text_of(capsys, id, "--steps", "2", "--episodes", "2")
    assert "episode 2   discounted return" in shown
    assert shown == text_of(capsys, id, "--steps", "2", "--episodes", "2")


def test_a_model_file_is_watched_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for id, name in ((TIGER, "tiger.POMDP"), (DEC_TIGER, "tiger.dpomdp")):
        bnprl_envs.write_model(bnprl_envs.model(id), tmp_path / name)
        assert "state tiger-" in text_of(capsys, str(tmp_path / name), "--steps", "1")


def test_the_belief_is_the_exact_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = [HALLWAY, "--steps", "2", "--no-progress", "--gif"]
    text_of(capsys, *options, str(tmp_path / "plain.gif"))
    text_of(capsys, *options, str(tmp_path / "belief.gif"), "--belief")
    plain, believed = (frames_of(tmp_path / f"{name}.gif")[0] for name in ("plain", "belief"))
    scene = (slice(40, 380), slice(0, 640))  # at the start the belief is over 14 of 15 cells
    assert (plain[scene] != believed[scene]).any(axis=2).mean() > 0.05


def test_a_window(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert text_of(capsys, TIGER, "--human", "--steps", "1") == ""
    monkeypatch.setitem(sys.modules, "pygame", None)
    assert refused(capsys, TIGER, "--human").endswith('pip install "bnprl[human]"')


def test_environments_of_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert refused(capsys, "CartPole-v1") == "CartPole-v1 renders as human, rgb_array, not ansi"
    assert "FHFH" in text_of(capsys, "FrozenLake-v1", "--steps", "1")
    with pytest.raises(ValueError, match="did you mean bnprl/Tiger-v0"):
        make_env(EnvironmentSpec("bnprl/Tigr-v0"), "ansi")


def test_teams_of_others(capsys: pytest.CaptureFixture[str]) -> None:
    shown = text_of(capsys, f"{pairs.__name__}:test/Drawn-v0")
    assert [f"ansi after {step} of 4 steps" in shown for step in range(6)] == [True] * 5 + [False]
    assert refused(capsys, "test/Pair-v0") == "test/Pair-v0 renders as nothing, not ansi"
    broken = refused(capsys, "test/Broken-v0")
    assert broken.startswith("test/Broken-v0: cannot be made: RuntimeError: out of paint (")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["bnprl/Tigr-v0"], "unknown environment 'bnprl/Tigr-v0'; did you mean bnprl/Tiger-v0"),
        ([TIGER, "--episodes", "0"], "--episodes: 0, must be at least 1"),
        ([TIGER, "--steps", "0"], "--steps: 0, must be at least 1"),
        ([TIGER, "--seed", "-1"], "--seed: -1, must be at least 0"),
        ([TIGER, "--policy", "nowhere.npz"], "nowhere.npz: No such file"),
        ([TIGER, "--gif", "nowhere/x.gif"], "--gif: there is no folder"),
        ([TIGER, "--gif", "x.gif", "--human"], "--gif, --human: give one of them"),
        ([DEC_TIGER, "--belief"], "--belief needs one agent"),
        (["bnprl/Gridworld-v0", "--belief"], "--belief needs one agent"),
        (["bnprl/PuddleWorld-v0", "--belief"], "--belief needs one agent"),
    ],
)
def test_bad_input_is_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert message in refused(capsys, *arguments)


def test_a_policy_for_other_spaces_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = policy_file(tmp_path)
    assert "the policy's observation_space is Discrete(3), the environment's is Discrete(22)" in (
        refused(capsys, HALLWAY, "--policy", path)
    )
    assert "the policy's observation_space" in refused(capsys, DEC_TIGER, "--policy", path)


def test_the_strip_grows_with_the_probability_of_a_node() -> None:
    picture = np.zeros(FRAME_SHAPE, dtype=np.uint8)
    painted = []
    for chance in (0.0, 0.5, 1.0):
        whole = beside(picture, 1, 0.0, (np.array([chance, 1.0 - chance]),))
        assert whole.shape == (480, 840, 3)
        blue = (whole == (0x00, 0x72, 0xB2)).all(axis=2)
        painted.append(int(blue[126:138].sum()))  # the first node's bar
    assert painted[0] == 0
    assert painted[2] == pytest.approx(2 * painted[1], rel=0.05)
    many = beside(picture, 1, -1234.5678, (np.full(60, 1 / 60), np.full(60, 1 / 60)))
    assert many.shape == (480, 840, 3)
    lines = beside_as_text(2, 1.5, (np.array([0.25, 0.75]),)).split("\n")
    assert lines == ["episode 2   discounted return 1.500", "nodes of agent_0: 1 0.75, 0 0.25"]
