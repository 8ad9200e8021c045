"""What the learners of action values share, and what sets each of them apart."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from bnprl_agents.agent import load
from bnprl_agents.features import Features
from bnprl_agents.gaussian_process.gp_fitted_q import GPFittedQ, GPFittedQConfig
from bnprl_agents.gaussian_process.gp_q import GPQ, GPQConfig, OptimisticGPQConfig
from bnprl_agents.gaussian_process.kernels import RadialKernel
from bnprl_agents.gaussian_process.sparse_gp import SparseGP
from bnprl_agents.policy_files import PolicyFileError
from bnprl_agents.q_learning.linear_q import GQ, GQConfig, LinearQ, LinearQConfig
from bnprl_agents.q_learning.tabular_q import TabularQ, TabularQConfig
from bnprl_agents.training import Budget, step_copies, train
from bnprl_envs import model
from bnprl_envs.inverted_pendulum import InvertedPendulumVectorEnv
from bnprl_envs.planning import policy_value
from bnprl_envs.puddle_world import PuddleWorldVectorEnv
from bnprl_envs.tabular_vector import TabularVectorEnv

SQUARE = gym.spaces.Box(0.0, 1.0, (2,), np.float64)
ACTIONS = gym.spaces.Discrete(3, start=1)
CASES = {
    "gpq": (GPQ, GPQConfig(bandwidth=(0.3,), budget=20)),
    "joint": (GPQ, GPQConfig(bandwidth=(0.3, 0.3, 1.0), budget=40, inputs="joint")),
    "selecting": (GPQ, GPQConfig(bandwidth=(0.3,), budget=20, select_after=30)),
    "optimistic": (GPQ, OptimisticGPQConfig(bandwidth=(0.3,), budget=20)),
    "fitted": (GPFittedQ, GPFittedQConfig(bandwidth=(0.3,), fit_every=20, capacity=60)),
    "tabular": (TabularQ, TabularQConfig(bins=4)),
    "linear": (LinearQ, LinearQConfig(bases=4, bandwidth=(0.3,))),
    "gq": (GQ, GQConfig(bases=4, bandwidth=(0.3,))),
}
every = pytest.mark.parametrize("case", CASES)


def build(case, seed=0, observation_space=SQUARE, action_space=ACTIONS, **changes):
    agent_class, config = CASES[case]
    config = type(config)(**(vars(config) | changes))
    return agent_class(observation_space, action_space, config, discount=0.9, seed=seed)


class Walk(gym.Env):
    """Walk along a line to its end at 1; truncated after 20 steps."""

    observation_space, action_space = SQUARE, ACTIONS

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.place, self.time = self.np_random.random(2) * 0.5, 0
        return self.place.copy(), {}

    def step(self, action):
        self.time += 1
        self.place[0] = np.clip(self.place[0] + 0.2 * (action - 2), 0.0, 1.0)
        ended = bool(self.place[0] == 1.0)
        return self.place.copy(), float(ended), ended, self.time == 20 and not ended, {}


def walks(n):
    return SyncVectorEnv([Walk] * n, autoreset_mode=AutoresetMode.DISABLED)


def run(agent, env, steps, seed=0):
    """Act, observe and update; return everything that could differ."""
    observation, _ = env.reset(seed=seed)
    agent.reset(observation)
    trace = []
    for _ in range(steps):
        action = agent.act(observation)
        observation, reward, terminated, truncated, _ = env.step(action)
        agent.observe(action, reward, observation, terminated, truncated)
        trace.append((np.asarray(action).tolist(), agent.update()))
        ended = terminated | truncated
        if ended.any():
            observation, _ = env.reset(options={"reset_mask": ended})
            agent.reset(observation, ended)
    return trace


@every
def test_a_scalar_is_a_batch_of_one_and_comes_back_as_a_scalar(case):
    env, agent = Walk(), build(case)
    observation, _ = env.reset(seed=0)
    agent.reset(observation)
    action = agent.act(observation)
    assert isinstance(action, int)
    observation, reward, terminated, truncated, _ = env.step(action)
    agent.observe(action, reward, observation, terminated, truncated)
    agent.update()
    assert agent.update() == {}
    action, state = agent.predict(observation)
    assert isinstance(action, int)
    assert action in ACTIONS
    assert state is None
    assert agent.predict(np.stack([observation] * 3))[0].shape == (3,)


@every
def test_equal_seeds_learn_equal_things_and_predicting_does_not_disturb(case):
    agents = [build(case, seed=5) for _ in range(2)]
    agents[1].predict(np.full((4, 2), 0.5))
    assert run(agents[0], walks(2), 60) == run(agents[1], walks(2), 60)


@every
@pytest.mark.parametrize("steps", [10, 50])
def test_a_loaded_agent_goes_on_bit_for_bit(case, steps, tmp_path):
    agent = build(case)
    run(agent, walks(3), steps)
    agent.save(tmp_path / "policy.npz")
    twin = load(tmp_path / "policy.npz")
    points = np.random.default_rng(0).random((20, 2))
    np.testing.assert_array_equal(agent.action_values(points), twin.action_values(points))
    assert run(agent, walks(3), 50, seed=1) == run(twin, walks(3), 50, seed=1)
    np.testing.assert_array_equal(agent.action_values(points), twin.action_values(points))


@every
def test_an_observation_under_way_survives_saving(case, tmp_path):
    agent = build(case)
    agent.reset(np.array([0.5, 0.5]))
    agent.observe(1, 1.0, np.array([0.7, 0.5]), False, False)
    agent.save(tmp_path / "policy.npz")
    twin = load(tmp_path / "policy.npz")
    assert agent.update() == twin.update()
    np.testing.assert_array_equal(agent.action_values([0.5, 0.5]), twin.action_values([0.5, 0.5]))


@every
def test_one_transition_is_learned(case):
    """Termination earns its reward alone; truncation is bootstrapped."""
    if case == "fitted":
        pytest.skip("fits batches; see test_gp_fitted_q")
    ends = {}
    for terminated in (True, False):
        agent = build(case)
        agent.reset(np.array([0.5, 0.5]))
        agent.observe(2, 1.0, np.array([0.5, 0.5]), True, False)
        agent.update()
        before = agent.action_values([0.5, 0.5])[0]
        assert before.argmax() == 1
        agent.reset(np.array([0.1, 0.1]))
        agent.observe(1, 0.0, np.array([0.5, 0.5]), terminated, not terminated)
        agent.update()
        ends[terminated] = agent.action_values([0.1, 0.1])[0, 0]
    assert ends[False] > ends[True]


@every
def test_bad_spaces(case):
    for action_space in (SQUARE, gym.spaces.MultiDiscrete([2, 2])):
        with pytest.raises(ValueError, match="action_space: "):
            build(case, action_space=action_space)
    with pytest.raises(ValueError, match="observation_space: "):
        build(case, observation_space=gym.spaces.MultiBinary(3))


@every
def test_bad_values_are_refused_before_anything_is_learned(case):
    agent = build(case)
    with pytest.raises(RuntimeError, match="call reset"):
        agent.act(np.zeros(2))
    with pytest.raises(ValueError, match="observation: nan, must be finite"):
        agent.reset(np.array([np.nan, 0.0]))
    agent.reset(np.zeros(2))
    with pytest.raises(ValueError, match="reward: inf, must be finite"):
        agent.observe(1, np.inf, np.zeros(2), False, False)
    with pytest.raises(ValueError, match="observation: inf"):
        agent.observe(1, 0.0, np.array([np.inf, 0.0]), False, False)
    with pytest.raises(ValueError, match="action: 0 lies outside"):
        agent.observe(0, 0.0, np.zeros(2), False, False)
    assert agent.update() == {}


@every
def test_infinite_bounds_are_refused(case):
    space = gym.spaces.Box(-np.inf, np.inf, (2,), np.float64)
    with pytest.raises(ValueError, match="infinite bounds; give low and high"):
        build(case, observation_space=space)
    agent = build(case, observation_space=space, low=(0.0, 0.0), high=(1.0, 1.0))
    assert agent.action_values([5.0, 5.0]).shape == (1, 3)


@pytest.mark.parametrize(
    ("config", "settings"),
    [
        (GPQConfig, {"bandwidth": (0.0,)}),
        (GPQConfig, {"noise": -1.0}),
        (GPQConfig, {"amplitude": np.inf}),
        (GPQConfig, {"budget": 0}),
        (GPQConfig, {"forgetting": 0.0}),
        (GPQConfig, {"exploration": "greedy"}),
        (GPQConfig, {"exploration_exponent": -0.1}),
        (GPQConfig, {"select_after": -1}),
        (GPQConfig, {"prior_mean": np.nan}),
        (LinearQConfig, {"bases": 0}),
        (LinearQConfig, {"initial_rate": 0.0}),
        (GQConfig, {"correction_rate": 0.0}),
        (TabularQConfig, {"bins": 0}),
        (TabularQConfig, {"rate_exponent": -1.0}),
    ],
)
def test_bad_settings(config, settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        config(**settings)


def test_gpq_is_a_process_for_each_action():
    """Against `SparseGP` fed the same targets."""
    agent = build("gpq", budget=10)
    rng = np.random.default_rng(0)
    kernel = RadialKernel((0.3, 0.3))
    processes = [SparseGP(kernel, 0.1, budget=10, tolerance=1e-3) for _ in range(3)]
    agent.reset(rng.random(2))
    here = agent._points[0].copy()
    for _ in range(100):
        action, reward, there = int(rng.integers(3)), rng.normal(), rng.random(2)
        target = reward + 0.9 * max(p.predict(there)[0][0] for p in processes)
        processes[action].update(here, target)
        agent.observe(action + 1, reward, there, False, False)
        agent.update()
        here = there
    at = rng.random((10, 2))
    for action, process in enumerate(processes):
        mean, variance = process.predict(at)
        np.testing.assert_allclose(agent.values(at)[:, action], mean, atol=1e-10)
        np.testing.assert_allclose(agent.variances(at)[:, action], variance, atol=1e-10)
        assert len(agent.basis_points()[action]) == len(process) <= 10


@pytest.mark.parametrize("case", ["gpq", "joint"])
def test_a_prior_mean_shifts_the_values(case):
    """As if every reward were larger by (1 - gamma) times the mean's negative, and an end by it."""
    rng = np.random.default_rng(0)
    agents = [build(case), build(case, prior_mean=-5.0)]
    for _ in range(60):
        here, there, ended = rng.random(2), rng.random(2), rng.random() < 0.2
        action, reward = int(rng.integers(1, 4)), rng.normal()
        for agent, shift in zip(agents, (5.0, 0.0), strict=True):
            agent.reset(here)
            earned = reward + shift * (1.0 if ended else 1.0 - 0.9)
            agent.observe(action, earned, there, ended, False)
            agent.update()
    at = rng.random((10, 2))
    np.testing.assert_allclose(agents[1].values(at), agents[0].values(at) - 5.0)
    np.testing.assert_allclose(agents[1].variances(at), agents[0].variances(at))


def test_the_optimist_adds_two_variances():
    agent = build("optimistic")
    run(agent, walks(1), 30)
    at = np.random.default_rng(0).random((5, 2))
    wanted = agent.values(at) + 2.0 * agent.variances(at)
    np.testing.assert_allclose(agent.behaviour_values(at), wanted)
    assert agent.exploring_probability() == 0.0


def test_exploration_falls_with_the_steps():
    agent = build("gpq", exploration_exponent=0.5)
    assert agent.exploring_probability() == 1.0
    run(agent, walks(1), 15)
    assert agent.exploring_probability() == pytest.approx(0.25)


def test_ties_are_broken_at_random_but_the_first_wins_where_it_is_deterministic():
    agent = build("tabular")
    seen = np.full((100, 2), 0.5)
    assert set(agent.predict(seen)[0].tolist()) == {1, 2, 3}
    assert set(agent.predict(seen, deterministic=True)[0].tolist()) == {1}
    np.testing.assert_allclose(agent.greedy_policy(seen[:1]), 1 / 3)


def test_selection_changes_the_kernel_once():
    agent = build("selecting")
    run(agent, walks(1), 29)
    assert agent.prior.noise == 0.1
    run(agent, walks(1), 1)
    chosen = agent.prior
    assert chosen.noise != 0.1
    run(agent, walks(1), 10)
    assert agent.prior is chosen


def test_tables_and_bases_by_hand():
    agent = build("tabular", initial_rate=0.5, rate_exponent=1.0)
    agent.reset(np.array([0.3, 0.9]))
    agent.observe(1, 1.0, np.array([0.3, 0.9]), False, False)
    agent.update()
    agent.observe(1, 1.0, np.array([0.3, 0.9]), False, False)
    agent.update()
    wanted = 0.5 + 0.25 * (1.0 + 0.9 * 0.5 - 0.5)
    assert agent.action_values([0.26, 0.76])[0, 0] == pytest.approx(wanted)
    assert np.count_nonzero(agent.table) == 1
    linear = build("linear", bases=1, bandwidth=(0.5,))
    linear.reset(np.array([0.5, 0.5]))
    linear.observe(2, 1.0, np.array([1.0, 0.5]), True, False)
    linear.update()
    wanted = 0.5 * np.exp(-0.5)
    assert linear.action_values([1.0, 0.5])[0] == pytest.approx([0.0, wanted, 0.0])


def test_outer_cells_go_on_beyond():
    agent = build("tabular")
    agent.table[:, 0] = np.arange(16)
    far = np.array([1.0, 2.0, 1e19, 1e300, 1.7e308])
    for x, column in ((far, 3.0), (-far, 0.0)):
        seen = np.stack([x, np.full(5, 0.3)], axis=1)
        assert agent.action_values(seen)[:, 0].tolist() == [column + 4.0] * 5


@pytest.mark.parametrize("columns", [0, 5])
def test_a_discrete_observation_is_its_own_cell_whatever_the_grid(columns):
    space = gym.spaces.Discrete(23, start=1)
    agent = build("tabular", observation_space=space, grid_columns=columns)
    agent.table[:, 0] = np.arange(len(agent.table))
    assert agent.action_values(np.arange(1, 24))[:, 0].tolist() == list(range(23))


def test_a_table_of_many_values_needs_no_more_than_the_table():
    agent = build("tabular", observation_space=gym.spaces.Discrete(10**6))
    agent.reset(10**6 - 1)
    agent.observe(1, 1.0, 3, True, False)
    agent.update()
    assert np.argwhere(agent.table).tolist() == [[10**6 - 1, 0]]
    assert agent._points.shape == (1, 1)


def test_gq_by_hand():
    """Two transitions on one basis at the point itself: phi = phi_t = 1."""
    agent = build("gq", bases=1, correction_rate=0.5, rate_exponent=0.0)
    agent.reset(np.array([0.5, 0.5]))
    agent.observe(1, 1.0, np.array([0.5, 0.5]), False, False)
    agent.update()  # delta = 1: w = .5, v = .5 * .5
    assert (agent.weights[0, 0], agent.correction[0, 0]) == pytest.approx((0.5, 0.25))
    agent.observe(1, 1.0, np.array([0.5, 0.5]), False, False)
    agent.update()
    delta = 1.0 + 0.9 * 0.5 - 0.5
    assert agent.weights[0, 0] == pytest.approx(0.5 + 0.5 * delta - 0.5 * 0.9 * 0.25)
    assert agent.correction[0, 0] == pytest.approx(0.25 + 0.5 * 0.5 * (delta - 0.25))


def test_divergence_stops_learning_with_finite_weights():
    agent = build("linear", bases=15, bandwidth=(0.3,), rate_exponent=0.0)
    trace = run(agent, walks(1), 3000)
    assert trace[-1][1]["diverged"] == 1.0
    assert np.isfinite(agent.weights).all()
    assert np.isfinite(agent.action_values(np.random.default_rng(0).random((9, 2)))).all()


def test_features():
    assert Features(SQUARE)([0.25, 1.0]).tolist() == [[0.25, 1.0]]
    box = gym.spaces.Box(np.array([-1.0, 0.0]), np.array([3.0, 7.0]), dtype=np.float64)
    assert Features(box)([0.0, 14.0]).tolist() == [[0.25, 2.0]]
    cells = Features(gym.spaces.Discrete(6, start=1), grid_columns=3)
    assert cells(np.array([1, 5])).tolist() == [[0.0, 0.0], [1.0, 1.0]]
    assert cells.points.tolist() == [[0, 0], [0, 1], [0, 2], [1, 0], [1, 1], [1, 2]]
    assert cells.high.tolist() == [1.0, 2.0]
    line = Features(gym.spaces.Discrete(3), grid_columns=10**30)
    assert line.points.tolist() == [[0.0, 0.0], [0.0, 1.0], [0.0, 2.0]]
    assert Features(gym.spaces.Discrete(3))(2).tolist() == [[0.0, 0.0, 1.0]]
    assert Features(gym.spaces.Discrete(3, start=1), numbered=True)([3, 1]).tolist() == [[2.0], [0]]
    for arguments in ({"low": (1.0, 1.0)}, {"low": (0.0,)}, {"grid_columns": 2}):
        with pytest.raises(ValueError, match=r"low|grid_columns"):
            Features(SQUARE, **arguments)
    with pytest.raises(ValueError, match="must be an integer"):
        cells(1.5)
    with pytest.raises(ValueError, match="lies outside"):
        cells(7)


@pytest.mark.parametrize("case", ["gpq", "optimistic", "fitted", "tabular", "linear", "gq"])
@pytest.mark.parametrize("discrete", [True, False])
def test_discrete_observations_with_and_without_a_grid(case, discrete):
    columns = 0 if discrete else 5
    agent = build(
        case,
        observation_space=gym.spaces.Discrete(25),
        action_space=gym.spaces.Discrete(4),
        grid_columns=columns,
        **({} if case == "tabular" else {"bandwidth": (0.5,)}),
    )
    env = TabularVectorEnv("bnprl/Gridworld-v0", 2, autoreset_mode="Disabled")
    assert run(agent, env, 30)
    assert agent.action_values(np.arange(25)).shape == (25, 4)


GRID = model("bnprl/Gridworld-v0")


def gridworld():
    return TabularVectorEnv(
        "bnprl/Gridworld-v0", 1, max_episode_steps=200, autoreset_mode="Disabled"
    )


def learned_gridworld(case, seed, steps=2500):
    settings = {} if case == "tabular" else {"bandwidth": (0.5,)}
    if case == "optimistic":
        settings |= {"amplitude": 0.1, "budget": 25}
    if case == "gpq":
        settings |= {"budget": 25, "exploration_exponent": 0.1}
    agent = build(
        case,
        seed,
        gym.spaces.Discrete(25),
        gym.spaces.Discrete(4),
        grid_columns=5,
        **settings,
    )
    for _ in train(agent, gridworld(), seed=seed, steps=steps):
        pass
    return policy_value(GRID, agent.greedy_policy(np.arange(25)))


@pytest.mark.parametrize("case", ["gpq", "optimistic", "tabular", "linear", "gq"])
def test_the_optimal_policy_of_gridworld_is_learned(case):
    for seed in range(3):
        assert learned_gridworld(case, seed) == pytest.approx(0.4378, abs=1e-4)


def test_compiled_and_stepped_training_agree_in_law():
    """Mean temporal difference of 40 seeds after the same steps."""
    errors = {}
    for compiled in (True, False):
        last = []
        for seed in range(40):
            env = InvertedPendulumVectorEnv(1, max_episode_steps=30, autoreset_mode="Disabled")
            agent = build(
                "tabular",
                seed,
                env.single_observation_space,
                env.single_action_space,
                low=(-1.6, -5.0),
                high=(1.6, 5.0),
            )
            loop = train(agent, env, seed=seed, steps=200)
            if not compiled:
                loop = step_copies(agent, env, Budget(steps=200), seed)
            *_, progress = loop
            assert progress.steps == agent.steps == 200
            last.append(agent.table.sum())
        errors[compiled] = np.array(last)
    one, other = errors[True], errors[False]
    spread = np.sqrt(one.var() / one.size + other.var() / other.size)
    assert abs(one.mean() - other.mean()) < 4 * spread


@pytest.mark.parametrize("budget", [{"steps": 100}, {"episodes": 3}])
def test_compiled_budgets_and_worlds(budget):
    for env in (PuddleWorldVectorEnv(1, True, max_episode_steps=40, autoreset_mode="Disabled"),):
        agent = build("tabular", 0, env.single_observation_space, env.single_action_space)
        *_, last = train(agent, env, seed=0, **budget)
        assert last.steps == agent.steps
        assert last.steps == budget.get("steps", last.steps) <= 120
        assert last.episodes == budget.get("episodes", last.episodes)


@pytest.mark.parametrize(
    "change",
    [
        lambda arrays: arrays.update(basis_size=arrays["basis_size"] + 100),
        lambda arrays: arrays.update(basis_weights=arrays["basis_weights"] * np.nan),
        lambda arrays: arrays.update(hyperparameters=np.array([1.0, -1.0])),
        lambda arrays: arrays.pop("basis_kernel"),
        lambda arrays: arrays.update(points=np.zeros((1, 7))),
    ],
)
def test_tampered_policies_are_refused(change, tmp_path):
    agent = build("gpq")
    run(agent, walks(1), 10)
    path = tmp_path / "policy.npz"
    agent.save(path)
    with np.load(path) as archive:
        arrays = dict(archive)
    change(arrays)
    np.savez(path, **arrays)
    with pytest.raises(PolicyFileError, match="not a bnprl policy file"):
        load(path)
