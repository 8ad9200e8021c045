"""The single-agent tabular benchmarks: golden values, sizes, structure, files, both views."""

import os
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order

import bnprl_envs
from bnprl_envs import TabularEnv, TabularVectorEnv
from bnprl_envs.benchmarks.baird_star import baird_star
from bnprl_envs.benchmarks.cheese_maze import cheese_maze
from bnprl_envs.benchmarks.grid4x4 import grid4x4
from bnprl_envs.benchmarks.gridworld import gridworld
from bnprl_envs.benchmarks.hallway import hallway2
from bnprl_envs.benchmarks.noisy_maze import noisy_maze_1d
from bnprl_envs.benchmarks.shuttle import shuttle
from bnprl_envs.benchmarks.three_nodes import three_nodes
from bnprl_envs.benchmarks.tiger import tiger
from bnprl_envs.planning import mdp_value, optimal_value, random_value

REFERENCE = Path(os.environ.get("BNPRL_REFERENCE_MODELS", "nowhere"))
TABULAR = [
    id
    for id in bnprl_envs.environment_ids()
    if bnprl_envs.entry(id).kind == "tabular" and bnprl_envs.model(id).n_agents == 1
]
MAZES = ("CheeseMaze", "Grid4x4", "NoisyMaze1D", "Hallway", "Hallway2", "Tag")
FORMS = [
    *((id, {}) for id in TABULAR),
    *((f"bnprl/{name}-v0", {"resetting": True}) for name in MAZES),
    ("bnprl/Gridworld-v0", {"rows": 1, "columns": 2}),
    ("bnprl/Gridworld-v0", {"rows": 3, "columns": 7, "slip": 0.0}),
]
EPISODIC = [form for form in FORMS if bnprl_envs.model(form[0], **form[1]).terminal.any()]


def row(table, *index):
    """Return the non-zero entries of a row."""
    values = table[index]
    return {int(k): pytest.approx(values[k], abs=1e-12) for k in np.flatnonzero(values)}


# --- values and sizes -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "random", "mdp", "tolerance"),
    [
        (shuttle(), -4.061860, 32.889725, 1e-6),
        (cheese_maze(), 0.203640, 0.864632, 1e-6),
        (cheese_maze(resetting=True), 0.249493, 3.936065, 1e-6),
        (grid4x4(), 0.310105, 0.895661, 1e-6),
        (grid4x4(resetting=True), 0.430623, 4.673038, 1e-6),
        (noisy_maze_1d(), 0.610753, 0.873288, 1e-6),
        (noisy_maze_1d(resetting=True), 0.930385, 1.716450, 1e-6),
        (tiger(), -606.666667, 200.0, 1e-6),
        (hallway2(), 0.026483, 0.576245, 2e-5),
        (hallway2(resetting=True), 0.027132, 1.200664, 3e-5),  # of a file with a rounded start
        (hallway2(), 0.026485, 0.576252, 1e-6),
        (hallway2(resetting=True), 0.027133, 1.200692, 1e-6),
        (gridworld(), 0.020083, 0.437831, 1e-6),
        (baird_star(), 0.0, 0.0, 0.0),
        (three_nodes(), 0.0, 0.0, 0.0),
    ],
    ids=repr,
)
def test_golden_values(model, random, mdp, tolerance):
    assert random_value(model) == pytest.approx(random, rel=0, abs=tolerance)
    assert model.start @ mdp_value(model) == pytest.approx(mdp, rel=0, abs=tolerance)


def test_hallway2_with_the_rounded_start_of_its_file():
    start = np.where(hallway2().terminal, 0.0, 0.011363)
    start[0] = 0.011419
    model = hallway2(resetting=True)
    transition = model.transition.copy()
    transition[:, hallway2().terminal] = start
    rounded = model.replace(start=start, transition=transition)
    assert random_value(rounded) == pytest.approx(0.027132, rel=0, abs=1e-6)
    assert start @ mdp_value(rounded) == pytest.approx(1.200664, rel=0, abs=1e-6)


@pytest.mark.parametrize(
    ("model", "sizes", "start", "reachable"),
    [
        (shuttle(), (8, 3, 5), {7: 1.0}, 8),
        (cheese_maze(resetting=True), (11, 4, 7), dict.fromkeys(range(10), 0.1), 11),
        (grid4x4(resetting=True), (16, 4, 2), dict.fromkeys(range(15), 1 / 15), 16),
        (noisy_maze_1d(resetting=True), (4, 2, 2), dict.fromkeys(range(3), 1 / 3), 4),
        (tiger(), (2, 3, 2), {0: 0.5, 1: 0.5}, 2),
        (
            hallway2(resetting=True),
            (92, 5, 17),
            dict.fromkeys((*range(68), *range(72, 92)), 1 / 88),
            90,
        ),
        (gridworld(), (25, 4, 25), {20: 1.0}, 25),
        (baird_star(), (7, 2, 7), dict.fromkeys(range(7), 1 / 7), 7),
        (three_nodes(), (3, 3, 3), dict.fromkeys(range(3), 1 / 3), 3),
    ],
    ids=repr,
)
def test_sizes_start_and_reachable_states(model, sizes, start, reachable):
    assert (model.n_states, model.n_actions, model.n_observations) == sizes
    assert row(model.start) == start
    graph = csr_array(np.vstack([np.append(0.0, model.start), _with_source(model)]))
    assert breadth_first_order(graph, 0)[0].size - 1 == reachable


def _with_source(model):
    """Return which state follows which (S, 1 + S), a source that has no way in coming first."""
    return np.insert(model.transition.sum(axis=0), 0, 0.0, axis=1)


def belief_optimum(model, decimals=10):
    """Return the optimal value of a POMDP with finitely many reachable beliefs."""
    index, beliefs, entries = {tuple(model.start.round(decimals)): 0}, [model.start], []
    for k, belief in enumerate(beliefs):  # which grows
        for action in range(model.n_actions):
            joint = (belief @ model.transition[action])[:, None] * model.observation[action]
            for end in joint[~model.terminal].T:
                if end.sum() < 1e-14:
                    continue
                after = np.zeros(model.n_states)
                after[~model.terminal] = end / end.sum()
                number = index.setdefault(tuple(after.round(decimals)), len(beliefs))
                if number == len(beliefs):
                    beliefs.append(after)
                entries.append((action, k, number, end.sum()))
    action, k, number, chance = np.array(entries).T
    cells = (action * len(beliefs) + k).astype(int), number.astype(int)
    rows = csr_array((chance, cells), shape=(model.n_actions * len(beliefs), len(beliefs)))
    reward = model.expected_reward @ np.array(beliefs).T
    return len(beliefs), optimal_value(rows, reward, model.discount)[0]


@pytest.mark.parametrize(
    ("model", "beliefs", "value"),
    [
        (cheese_maze(resetting=True), 16, 3.48620682),
        (cheese_maze(), 15, 0.824174),
        (grid4x4(resetting=True), 887, 3.73227331),
        (grid4x4(), 886, 0.854384),
        (tiger(), 29, 19.371368),  # equal to 10 digits after 14 sounds more on one side
    ],
    ids=repr,
)
def test_optima_over_the_reachable_beliefs(model, beliefs, value):
    assert belief_optimum(model) == (beliefs, pytest.approx(value, rel=0, abs=1e-6))


def test_the_optimum_of_the_noisy_maze():
    """Nothing is seen before the goal: branch and bound over the sequences of actions."""
    model = noisy_maze_1d()
    moves, reward = model.transition[:, :3, :3], model.expected_reward[:, :3]
    reach, earned, bound = model.start[None, :3], np.zeros(1), mdp_value(model)[:3]
    for step in range(20):
        gain = 0.75**step * (reach @ reward.T)
        earned = (earned[:, None] + gain).T.ravel()
        reach = np.concatenate([reach @ move for move in moves])
        upper = earned + 0.75 ** (step + 1) * reach @ bound
        kept = upper >= earned.max()
        reach, earned = reach[kept], earned[kept]
    best = earned.max()
    assert best <= upper.max() < best + 1e-8
    assert best == pytest.approx(0.731050, rel=0, abs=1e-6)
    # One step in the goal, then all begins anew: V = D + discount^2 D V.
    assert best / (1 - 0.75**2 * best) == pytest.approx(1.2416248, rel=0, abs=1e-6)


# --- reference files --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "name", "tolerance"),
    [
        (shuttle(), "shuttle.95.POMDP", 1e-9),
        (cheese_maze(resetting=True), "cheese.95.POMDP", 1e-9),
        (grid4x4(resetting=True), "4x4.95.POMDP", 1e-6),
        (noisy_maze_1d(resetting=True), "1d.noisy.POMDP", 1e-6),
        (tiger(), "tiger.95.POMDP", 1e-9),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_equals_the_reference_file(model, name, tolerance):
    if not (REFERENCE / name).is_file():
        pytest.skip(f"BNPRL_REFERENCE_MODELS has no {name}")
    file = bnprl_envs.read_model(REFERENCE / name)
    assert file.discount == model.discount
    for table in ("transition", "observation", "start", "expected_reward"):
        np.testing.assert_allclose(
            getattr(model, table), getattr(file, table), rtol=0, atol=tolerance, err_msg=table
        )
    # R(a, s, s', o) itself, wherever s' and o are possible.
    shape = (model.n_actions, model.n_states, model.n_states, model.n_observations)
    possible = (model.transition[..., None] * model.observation[:, None]) > 0
    ours, theirs = (np.broadcast_to(m.reward, shape)[possible] for m in (model, file))
    np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize(("id", "arguments"), FORMS)
def test_a_file_gives_the_model_back(tmp_path, id, arguments):
    model = bnprl_envs.model(id, **arguments)
    bnprl_envs.write_model(model, tmp_path / "model.pomdp")
    file = bnprl_envs.read_model(tmp_path / "model.pomdp")
    for table in ("transition", "observation", "start", "terminal", "support_reward"):
        np.testing.assert_array_equal(getattr(file, table), getattr(model, table), err_msg=table)
    assert (file.discount, file.fully_observed) == (model.discount, model.fully_observed)
    assert (file.names.states, file.names.actions, file.names.observations) == (
        model.names.states,
        model.names.actions,
        model.names.observations,
    )


# --- both views -------------------------------------------------------------------------------


@pytest.mark.parametrize(("id", "arguments"), FORMS)
def test_gymnasium_checks(id, arguments):
    check_env(gym.make(id, **arguments).unwrapped)
    env = gym.make(id, max_episode_steps=3, **arguments)
    assert env.observation_space.contains(env.reset(seed=0)[0])


@pytest.mark.parametrize(("id", "arguments"), FORMS)
def test_the_native_batch(id, arguments):
    entry = bnprl_envs.entry(id)
    for mode in AutoresetMode:
        envs = gym.make_vec(id, num_envs=4, autoreset_mode=mode, max_episode_steps=7, **arguments)
        assert type(envs) is TabularVectorEnv
        assert (envs.discount, envs.metadata["autoreset_mode"]) == (entry.discount, mode)
        observations, _ = envs.reset(seed=0)
        assert envs.observation_space.contains(observations)
        truncations = 0
        envs.action_space.seed(0)
        for _ in range(20):
            observations, rewards, terminated, truncated, _ = envs.step(envs.action_space.sample())
            assert envs.observation_space.contains(observations)
            assert np.isfinite(rewards).all()
            truncations += truncated.sum()
            done = terminated | truncated
            if mode is AutoresetMode.DISABLED and done.any():
                envs.reset(options={"reset_mask": done})
        assert truncations or envs.model.terminal.any()


def test_which_forms_end():
    continuing = {id for id, arguments in FORMS} - {id for id, _ in EPISODIC}
    assert continuing == {f"bnprl/{x}-v0" for x in ("BairdStar", "ThreeNodes", "Shuttle", "Tiger")}
    assert not any(arguments.get("resetting") for _, arguments in EPISODIC)


@pytest.mark.parametrize(("id", "arguments"), FORMS)
def test_no_episode_begins_at_its_end(id, arguments):
    model = bnprl_envs.model(id, **arguments)
    assert not model.start[model.terminal].any()
    # The continuing form begins where the episodic one does.
    assert "resetting" not in arguments or np.array_equal(model.start, bnprl_envs.model(id).start)


@pytest.mark.parametrize(("id", "arguments"), EPISODIC)
def test_the_goal_on_the_last_step_terminates(id, arguments):
    model = bnprl_envs.model(id, **arguments)
    entering = model.transition[:, :, model.terminal].sum(axis=2) * ~model.terminal
    action, state = np.unravel_index(entering.argmax(), entering.shape)
    before = model.replace(start=np.arange(model.n_states) == state)
    env = TabularEnv(before, max_episode_steps=1)
    env.reset(seed=0)
    endings = set()
    for _ in range(60):
        terminated, truncated = env.step(action)[2:4]
        endings.add((terminated, truncated))
        env.reset()
    certain = entering[action, state] > 1 - 1e-12
    assert endings == ({(True, False)} if certain else {(True, False), (False, True)})
    envs = TabularVectorEnv(before, 60, max_episode_steps=1)
    envs.reset(seed=0)
    _, _, terminated, truncated, _ = envs.step(np.full(60, action))
    assert terminated.any()
    np.testing.assert_array_equal(truncated, ~terminated)
