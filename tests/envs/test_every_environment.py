"""What holds of every id and every way to make it: checks of the libraries, ends, bad input."""

import re
import warnings

import gymnasium as gym
import numpy as np
import pettingzoo
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from pettingzoo.test import parallel_api_test

import bnprl_envs

OPTIONS = {
    "bnprl/Gridworld-v0": [{"rows": 1, "columns": 2}, {"rows": 3, "columns": 7, "slip": 0.0}],
    "bnprl/InvertedPendulum-v0": [{"noise": 0.0}],
    "bnprl/PuddleWorld-v0": [{"uniform_start": True}, {"noise": 0.0}, {"noise": 1.0}],
    "bnprl/MeetingGrid-v0": [{"size": 2}],
    "bnprl/GridTraffic-v0": [
        {"rows": 1, "columns": 1},
        {"rows": 2, "columns": 3, "capacity": 1, "discharge": 2},
        {"rows": 2, "columns": 2, "arrival_rate": 0.0, "discount": 1.0},
    ],
    **{
        f"bnprl/{name}-v0": [{"resetting": True}]
        for name in ("CheeseMaze", "Grid4x4", "NoisyMaze1D", "Hallway", "Hallway2", "Tag")
    },
}
"""Arguments of the constructors; those of no id here take none but the limits."""
BAD_OPTIONS = {
    "resetting": [("yes", "True or False"), (1, "True or False"), (None, "True or False")],
    "rows": [(0, "an integer, at least 1"), (2.5, "an integer, at least 1")],
    "columns": [(-1, "an integer, at least 1"), ("3", "an integer, at least 1")],
    "slip": [(1.0, "[0, 1)"), (-0.1, "[0, 1)"), ("0", "[0, 1)")],
    "noise": [(-1.0, "[0, "), (100.0, "[0, "), (np.nan, "[0, "), ("much", "[0, ")],
    "uniform_start": [("no", "True or False"), (0, "True or False")],
    "size": [(1, "2 or 3"), (4, "2 or 3"), ("3", "2 or 3")],
    "capacity": [(0, "an integer, at least 1"), (1.5, "an integer, at least 1")],
    "discharge": [(0, "an integer, at least 1")],
    "arrival_rate": [(1.5, "[0, 1]"), (-0.5, "[0, 1]"), ("half", "[0, 1]"), (np.nan, "[0, 1]")],
    "discount": [(0.0, "(0, 1]"), (1.5, "(0, 1]"), ("0.9", "(0, 1]")],
    "max_episode_steps": [(0, "an integer, at least 1"), (2.5, "an integer, at least 1")],
    "render_mode": [("ascii", "None")],
}
LIMITS = ("max_episode_steps", "render_mode")
IDS = bnprl_envs.environment_ids()
FORMS = [(id, options) for id in IDS for options in ({}, *OPTIONS.get(id, ()))]
BAD = [
    (id, name, value, allowed)
    for id in IDS
    for name in dict.fromkeys([*(o for options in OPTIONS.get(id, ()) for o in options), *LIMITS])
    for value, allowed in BAD_OPTIONS[name]
]


def parallel(id):
    return bnprl_envs.entry(id).kind.startswith("parallel")


def make(id, **arguments):
    """Return one copy, made by its class and not by a library."""
    entry = bnprl_envs.entry(id)
    if entry.kind == "tabular":
        return bnprl_envs.TabularEnv(id, **arguments)
    if entry.kind == "parallel-tabular":
        return bnprl_envs.TabularParallelEnv(id, **arguments)
    return getattr(bnprl_envs, entry.factory.split(":")[1])(**arguments)


def make_batch(id, copies, **arguments):
    """Return a native batch whose copies wait for `reset` when they are over."""
    if id == "bnprl/GridTraffic-v0":
        return bnprl_envs.GridTrafficBatch(copies, **arguments)
    if parallel(id):
        return bnprl_envs.TabularParallelBatch(id, copies, **arguments)
    return gym.make_vec(id, num_envs=copies, autoreset_mode="Disabled", **arguments)


def act(env, action=0):
    """Take one action, every agent the same."""
    if hasattr(env, "possible_agents"):
        return env.step(dict.fromkeys(env.possible_agents, action))
    return env.step(action)


@pytest.mark.parametrize(("id", "options"), FORMS)
def test_the_libraries_find_nothing_wrong(id, options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if parallel(id):
            parallel_api_test(pettingzoo.make("parallel", id, **options), num_cycles=110)
            parallel_api_test(make(id, max_episode_steps=3, **options), num_cycles=20)
        else:
            check_env(gym.make(id, **options).unwrapped)
            check_env(make(id, max_episode_steps=3, **options), skip_render_check=True)


@pytest.mark.parametrize(("id", "options"), FORMS)
def test_the_limit_truncates_and_only_then(id, options):
    env = make(id, max_episode_steps=4, **options)
    env.reset(seed=0)
    for step in range(1, 5):
        _, _, terminated, truncated, _ = act(env)
        if parallel(id):
            terminated, truncated = set(terminated.values()), set(truncated.values())
            assert len(terminated) == len(truncated) == 1
            (terminated,), (truncated,) = terminated, truncated
        assert truncated == (step == 4 and not terminated)
        if terminated:
            break
    batch = make_batch(id, 50, max_episode_steps=4, **options)
    batch.reset(seed=0)
    over = np.zeros(50, dtype=bool)
    for step in range(1, 5):
        _, _, terminated, truncated, _ = batch.step(np.zeros(batch.action_space.shape, dtype=int))
        assert not (terminated & truncated).any()
        if step < 4:
            assert not truncated.any()
            over |= terminated
            if terminated.any():
                batch.reset(options={"reset_mask": terminated})
    assert truncated[~over & ~terminated].all()  # copies begun anew have steps left


# --- bad input --------------------------------------------------------------------------------


@pytest.mark.parametrize(("id", "name", "value", "allowed"), BAD)
def test_arguments_out_of_range(id, name, value, allowed):
    message = rf"^{name}: {re.escape(repr(value))}, must .*{re.escape(allowed)}"
    with pytest.raises(ValueError, match=message) as error:
        make(id, **{name: value})
    assert "\n" not in str(error.value)
    with pytest.raises(ValueError, match=message):
        make_batch(id, 2, **{name: value})


@pytest.mark.parametrize("id", IDS)
def test_unknown_arguments(id):
    with pytest.raises(TypeError, match="nonsense"):
        make(id, nonsense=1)


@pytest.mark.parametrize("count", [0, -1, 2.5])
@pytest.mark.parametrize("id", IDS)
def test_numbers_of_copies(id, count):
    with pytest.raises(ValueError, match=rf"(copies|num_envs): {count}, must be an integer, at"):
        make_batch(id, count)


@pytest.mark.parametrize("action", [-1, 99, 0.5, None, "up", np.array([0, 1]), np.nan])
@pytest.mark.parametrize("id", IDS)
def test_actions_outside_the_space(id, action):
    env = make(id)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"^action .* is not an integer in \[0, \d+\]$"):
        act(env, action)
    act(env)  # and nothing has happened


@pytest.mark.parametrize("id", [id for id in IDS if parallel(id)])
def test_actions_of_the_wrong_agents(id):
    env = make(id)
    env.reset(seed=0)
    actions = dict.fromkeys(env.agents, 0)
    with pytest.raises(ValueError, match=r"^actions: agent_1 is missing, every agent must act"):
        env.step({agent: 0 for agent in env.agents if agent != "agent_1"})
    with pytest.raises(ValueError, match=r"^actions: there is no agent 'agent_x', only agent_0 to"):
        env.step(actions | {"agent_x": 0})
    with pytest.raises(ValueError, match=r"^actions: list, must be a dict from agent to action"):
        env.step([0] * len(actions))
    env.step(actions)


@pytest.mark.parametrize("id", IDS)
def test_actions_of_a_batch(id):
    batch = make_batch(id, 3)
    batch.reset(seed=0)
    good = np.zeros(batch.action_space.shape, dtype=int)
    wrong = good.copy()
    wrong[1] = 99
    with pytest.raises(ValueError, match=r"action 99 of .*copy 1 is not in \[0, \d+\]"):
        batch.step(wrong)
    for actions in (good[:2], good + 0.5, None, good[0], np.full(good.shape, "up")):
        with pytest.raises(ValueError, match=r"^actions: shape \(.*\) of .*, must be \(3,.*of int"):
            batch.step(actions)
    batch.step(good)


@pytest.mark.parametrize("id", IDS)
def test_steps_before_reset_and_after_the_end(id):
    env, batch = make(id, max_episode_steps=1), make_batch(id, 2, max_episode_steps=1)
    actions = np.zeros(batch.action_space.shape, dtype=int)
    for _ in range(2):
        with pytest.raises(ResetNeeded, match=r"call reset\(\) first"):
            act(env)
        env.reset(seed=0)
        act(env)
    with pytest.raises(ResetNeeded, match=r"call reset\(\) first"):
        batch.step(actions)
    batch.reset(seed=0)
    batch.step(actions)
    with pytest.raises(ResetNeeded, match="copy 0 has finished: reset it with"):
        batch.step(actions)


@pytest.mark.parametrize(
    "id", [id for id in IDS if "class" not in bnprl_envs.entry(id).kind and not parallel(id)]
)
def test_a_terminal_state_with_an_exit(id):
    model = bnprl_envs.model(id)
    if model.terminal.any():
        model = bnprl_envs.model(id, **({"resetting": True} if "Grid" not in id else {}))
    _, state, end = model.support
    leaving = int(state[(state != end) & ~model.terminal[state]][0])
    terminal = model.terminal | (np.arange(model.n_states) == leaving)
    words = model.names.states
    with pytest.raises(
        ValueError,
        match=rf"^terminal: state '{words[leaving]}' has an exit to '.*'; it must keep itself",
    ):
        model.replace(terminal=terminal)


@pytest.mark.parametrize("id", IDS)
def test_the_state_before_reset(id):
    env = make(id)
    with pytest.raises(ResetNeeded):
        _ = env.state() if parallel(id) else env.state
