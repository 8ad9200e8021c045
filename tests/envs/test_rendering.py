import subprocess
import sys
import warnings

import gymnasium as gym
import numpy as np
import pettingzoo
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test
from PIL import Image, ImageDraw

import bnprl_envs
from bnprl_envs import GridTraffic, TabularEnv, TabularParallelEnv
from bnprl_envs.planning import belief_update
from bnprl_envs.rendering import FRAME_SHAPE, RENDER_MODES, Doing, Moment, frame, theme
from bnprl_envs.rendering import canvas as canvas_module
from tests.agents.cases import random_model

IDS = bnprl_envs.environment_ids()
PARALLEL = [id for id in IDS if bnprl_envs.entry(id).kind.startswith("parallel")]
SINGLE = [id for id in IDS if id not in PARALLEL]
TABULAR = [id for id in IDS if bnprl_envs.entry(id).kind.endswith("tabular")]
MARKS = {  # in the text of the first state
    "Gridworld": ["G", "R"],
    "InvertedPendulum": ["O", "|", "push"],
    "PuddleWorld": ["G", "R", "~"],
    "BairdStar": ["["],
    "ThreeNodes": ["["],
    "Shuttle": ["G", "S<"],
    "CheeseMaze": ["G", "R", "#"],
    "Grid4x4": ["G", "R"],
    "NoisyMaze1D": ["G", "R"],
    "Tiger": ["T", "left", "right"],
    "Hallway": ["G", "R", "#"],
    "Hallway2": ["G", "R", "#"],
    "Tag": ["R", "O", "#"],
    "DecTiger": ["T", "agent_0", "agent_1"],
    "BroadcastChannel": ["agent_0 buffer [######] message", "agent_1"],
    "RecyclingRobots": ["agent_0 battery [######] high", "agent_1"],
    "MeetingGrid": ["G", "0", "1"],
    "BoxPushing": ["G", "b", "B", "0>", "1<"],
    "MarsRovers": ["01"],
    "GridTraffic": ["100 agents", " 0"],
}


def make(id, render_mode, **arguments):
    if id in PARALLEL:
        return pettingzoo.make("parallel", id, render_mode=render_mode, **arguments)
    return gym.make(id, render_mode=render_mode, **arguments)


def act(env):
    if hasattr(env, "possible_agents"):
        return env.step({agent: env.action_space(agent).sample() for agent in env.agents})
    return env.step(env.action_space.sample())


def state(env):
    state = env.unwrapped.state
    return np.array(state() if callable(state) else state)


def until_the_state_changes(env):
    before = state(env)
    for _ in range(200):
        act(env)
        if not np.array_equal(state(env), before):
            return
    raise AssertionError("the state never changed")


def shown(model, state, belief=None):
    doings = tuple(Doing(agent, "-", "-") for agent in model.names.agents)
    return Moment(state, 0, (), None, doings, belief)


# --- every environment in every mode ----------------------------------------------------------


@pytest.mark.parametrize("id", IDS)
def test_frames_have_the_declared_shape_and_change_with_the_state(id):
    env = make(id, "rgb_array")
    env.reset(seed=1)
    first, again = env.render(), env.render()
    assert first.dtype == np.uint8
    assert first.shape == env.metadata["render_shape"] == FRAME_SHAPE
    assert env.metadata["render_fps"] > 0
    assert (first == again).all()
    assert first is not again
    until_the_state_changes(env)
    second = env.render()
    scene = slice(0, FRAME_SHAPE[0] - theme.STATUS_HEIGHT)
    assert second.shape == FRAME_SHAPE
    assert (first[scene] != second[scene]).any()
    assert (first[scene.stop :] != second[scene.stop :]).any()  # the step, at least


@pytest.mark.parametrize("id", IDS)
def test_text_names_marks_step_reward_actions_and_observations(id):
    env = make(id, "ansi")
    env.reset(seed=0)
    text = env.render()
    assert isinstance(text, str)
    for mark in MARKS[id.removeprefix("bnprl/").removesuffix("-v0")]:
        assert mark in text
    assert "step 0   reward -" in text
    until_the_state_changes(env)
    later = env.render()
    assert later.split("step")[0] != text.split("step")[0]
    assert "action" in later
    assert "saw" in later


@pytest.mark.parametrize("id", IDS)
def test_the_window_shows_the_frame_after_every_step(id):
    import pygame

    env, twin = make(id, "human"), make(id, "rgb_array")
    for each in (env, twin):
        each.reset(seed=3)
        each.step(dict.fromkeys(each.agents, 0) if id in PARALLEL else 0)
        if each is env:
            surface = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
    assert (surface == twin.render()).all()
    assert env.render() is None
    env.close()
    env.close()
    assert not pygame.display.get_init()


@pytest.mark.parametrize("id", SINGLE)
def test_gymnasium_checks_in_every_mode(id):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gym.make(id, render_mode="rgb_array").unwrapped)  # renders every declared mode


@pytest.mark.parametrize("mode", RENDER_MODES[:2])
@pytest.mark.parametrize("id", PARALLEL)
def test_pettingzoo_checks_in_every_mode(id, mode):
    env = make(id, mode)
    parallel_api_test(env, num_cycles=20)
    assert env.metadata["render_modes"] == list(RENDER_MODES)
    env.reset(seed=0)
    assert type(env.render()) is {"ansi": str, "rgb_array": np.ndarray}[mode]


def test_pettingzoo_checks_with_a_window():
    parallel_api_test(make("bnprl/DecTiger-v0", "human"), num_cycles=3)


# --- what is in the pictures ------------------------------------------------------------------


@pytest.mark.parametrize("id", TABULAR)
def test_every_state_looks_different(id):
    model, scene = bnprl_envs.model(id), bnprl_envs.registry.scene(id)
    assert scene is not None
    assert len({scene.text(shown(model, s)) for s in range(model.n_states)}) == model.n_states
    some = range(0, model.n_states, max(1, model.n_states // 12))
    assert len({frame(scene, shown(model, s)).tobytes() for s in some}) == len(some)


@pytest.mark.parametrize(
    ("id", "arguments"),
    [
        *((id, {}) for id in IDS),
        ("bnprl/MeetingGrid-v0", {"size": 2}),
        ("bnprl/Gridworld-v0", {"rows": 1, "columns": 2}),
        ("bnprl/Gridworld-v0", {"rows": 30, "columns": 40}),
        ("bnprl/GridTraffic-v0", {"rows": 1, "columns": 1}),
        ("bnprl/GridTraffic-v0", {"rows": 100, "columns": 100, "capacity": 120}),
        ("bnprl/GridTraffic-v0", {"rows": 3, "columns": 30}),
    ],
)
def test_no_label_is_clipped(id, arguments, monkeypatch):
    written = []
    draw_text = ImageDraw.ImageDraw.text

    def text(self, place, words, fill, font, anchor):
        written.append((words, self.textbbox(place, words, font, anchor)))
        draw_text(self, place, words, fill, font, anchor)

    monkeypatch.setattr(ImageDraw.ImageDraw, "text", text)
    env = make(id, "rgb_array", **arguments)
    env.reset(seed=0)
    for _ in range(6):
        env.render()
        if id in PARALLEL:
            if not env.agents:
                break
            act(env)
        elif act(env)[2]:
            break
    height, width, _ = FRAME_SHAPE
    for words, (left, top, right, bottom) in written:
        assert not words.endswith("...")
        assert 0 <= left < right <= width or not words
        assert 0 <= top <= bottom <= height
    assert len(written) >= 12


def test_text_has_contrast():
    def luminance(colour):
        c = np.array(list(bytes.fromhex(colour[1:]))) / 255
        return np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4) @ (
            0.2126,
            0.7152,
            0.0722,
        )

    def contrast(one, other):
        low, high = sorted((luminance(one), luminance(other)))
        return (high + 0.05) / (low + 0.05)

    for ground in (theme.PAPER, theme.PANEL, theme.FLOOR, theme.DONE):
        assert contrast(theme.INK, ground) > 7
    for words, ground in (
        (theme.FAINT, theme.PANEL),
        (theme.PAPER, theme.BOX),
        (theme.PAPER, theme.agent_colour(0)),
        (theme.INK, theme.BELIEF),
        (theme.INK, theme.blend(theme.GOAL, theme.FLOOR, 0.3)),
    ):
        assert contrast(words, ground) > 4.5


def test_a_robot_and_the_goal_stand_where_the_plan_says():
    env = TabularEnv("bnprl/Grid4x4-v0", render_mode="rgb_array")
    seen = set()
    for seed in range(60):
        env.reset(seed=seed)
        picture, plan = env.render(), env._scene
        x, y = plan._view().corner(plan.cells[env.state])
        middle = picture[round(y + plan._view().side / 2), round(x + plan._view().side / 2)]
        assert middle.tolist() == list(bytes.fromhex(theme.agent_colour(0)[1:]))
        seen.add(env.state)
    assert len(seen) > 10


# --- beliefs ----------------------------------------------------------------------------------


def test_a_belief_shades_the_cells_by_their_chance():
    env = TabularEnv("bnprl/Hallway-v0", render_mode="rgb_array")
    env.reset(seed=0)
    plain = env.render()
    belief = np.zeros(60)
    belief[[4, 5, 6]] = 0.25  # three ways to face in cell 1
    belief[8] = 0.25
    env.belief = belief
    plan = env._scene
    assert plan.cell_belief(env._moment())[:4].tolist() == [0.0, 0.75, 0.25, 0.0]
    shaded = env.render()
    colours = []
    for cell in range(4):
        x, y = (round(z + 4) for z in plan._view().corner(plan.cells[cell]))
        colours.append(shaded[y, x].astype(int))
        assert (shaded[y, x] == plain[y, x]).all() == (cell in (0, 3))
    pink = np.array(list(bytes.fromhex(theme.BELIEF[1:])))
    assert np.abs(colours[1] - pink).sum() < np.abs(colours[2] - pink).sum()
    env.reset(seed=0)
    assert env.belief is None
    assert (env.render() == plain).all()


@pytest.mark.parametrize("id", ["bnprl/Tiger-v0", "bnprl/Tag-v0", "bnprl/Shuttle-v0"])
def test_an_exact_belief_can_be_shown_at_every_step(id):
    env = TabularEnv(id, render_mode="rgb_array")
    env.reset(seed=0)
    belief = env.model.start
    for _ in range(5):
        plain = env.render()
        env.belief = belief
        assert (env.render() != plain).any()
        observation, *_ = env.step(0)
        belief, _ = belief_update(env.model, belief, 0, observation)
        env.belief = None


def test_a_belief_of_another_shape_is_refused():
    for env in (
        TabularEnv("bnprl/Tiger-v0", render_mode="ansi"),
        TabularParallelEnv("bnprl/DecTiger-v0", render_mode="ansi"),
    ):
        env.reset(seed=0)
        env.belief = np.ones(3) / 3
        with pytest.raises(ValueError, match=r"belief: shape \(3,\), must be \(2,\)"):
            env.render()


# --- any other model --------------------------------------------------------------------------


def test_a_model_without_a_layout_is_a_card():
    for env in (
        TabularEnv(bnprl_envs.model("bnprl/Tag-v0"), render_mode="ansi"),
        TabularParallelEnv(bnprl_envs.model("bnprl/DecTiger-v0"), render_mode="ansi"),
    ):
        env.reset(seed=0)
        act(env)
        assert f"state {env.model.names.states[int(state(env))]}" in env.render()
        env.render_mode = "rgb_array"
        plain = env.render()
        env.belief = env.model.start
        assert (env.render() != plain).any()


def test_long_words_are_cut():
    canvas = canvas_module.Canvas((40, 100))
    canvas.text((5, 20), "a very long word that does not fit", anchor="lm", width=80)
    picture = canvas.array()
    assert (picture[:, 90:] == 255).all()
    assert (picture[:, 60:88] < 255).any()


# --- constructors and imports -----------------------------------------------------------------


def test_render_without_a_mode_warns():
    env = TabularEnv("bnprl/Tiger-v0")
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="no render_mode was given"):
        assert env.render() is None


def test_render_before_reset_is_refused():
    for env in (
        TabularEnv("bnprl/Tiger-v0", render_mode="ansi"),
        TabularParallelEnv("bnprl/DecTiger-v0", render_mode="ansi"),
        GridTraffic(render_mode="ansi"),
        bnprl_envs.PuddleWorldEnv(render_mode="ansi"),
    ):
        with pytest.raises(ResetNeeded):
            env.render()


def test_unknown_modes_and_batches_are_refused():
    with pytest.raises(ValueError, match="'svg', must be None or one of 'ansi', 'rgb_array', 'hum"):
        TabularEnv("bnprl/Tiger-v0", render_mode="svg")
    with pytest.raises(ValueError, match="batches are not drawn"):
        bnprl_envs.TabularVectorEnv("bnprl/Tiger-v0", 2, render_mode="rgb_array")
    assert bnprl_envs.TabularVectorEnv.metadata["render_modes"] == []


def test_a_missing_pygame_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    env = TabularEnv("bnprl/Tiger-v0", render_mode="human")
    with pytest.raises(ImportError, match=r'pip install "bnprl\[human\]"'):
        env.reset(seed=0)


def test_pixels_need_no_pygame_and_environments_no_pillow():
    code = (
        "import sys, bnprl_envs\n"
        "env = bnprl_envs.TabularEnv('bnprl/Hallway-v0', render_mode='rgb_array')\n"
        "env.reset(seed=0); env.step(1)\n"
        "assert not {'PIL', 'pygame', 'matplotlib'} & sys.modules.keys()\n"
        "env.render()\n"
        "assert not {'pygame', 'matplotlib'} & sys.modules.keys()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_gymnasium_records_videos_of_it(tmp_path):
    env = gym.wrappers.RenderCollection(make("bnprl/Hallway-v0", "rgb_array"))
    env.reset(seed=0)
    for _ in range(3):
        act(env)
    pictures = env.render()
    Image.fromarray(pictures[-1]).save(tmp_path / "last.png")
    assert len(pictures) == 4
    assert all(picture.shape == FRAME_SHAPE for picture in pictures)


def test_the_status_of_many_agents_stays_within_the_picture(monkeypatch):
    written = {}
    write = canvas_module.Canvas.text

    def keep(canvas, place, words, *args, **kwargs):
        written[words] = place
        write(canvas, place, words, *args, **kwargs)

    monkeypatch.setattr(canvas_module.Canvas, "text", keep)
    sizes = {"action_sizes": (2, 2, 2), "observation_sizes": (2, 2, 2)}
    model = random_model(np.random.default_rng(0), **sizes)
    env = TabularParallelEnv(model, render_mode="rgb_array")
    env.reset(seed=0)
    env.step(dict.fromkeys(env.agents, 0))
    picture = env.render()
    assert "and 1 more agent" in written
    assert all(0 <= y < picture.shape[0] for _, y in written.values())
