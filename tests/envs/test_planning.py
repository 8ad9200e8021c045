"""Bounds and values against known numbers, and against brute force on tiny random models."""

import itertools
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import csr_array

import bnprl_envs
from bnprl_envs.benchmarks.hallway import hallway
from bnprl_envs.model import TabularModel
from bnprl_envs.planning import (
    belief_update,
    blind_values,
    blind_vectors,
    fib,
    finite_horizon_value,
    mdp_value,
    q_mdp,
    random_value,
)
from bnprl_envs.point_based import point_based_lower_bound
from bnprl_envs.tabular import TabularEnv

REFERENCE = os.environ.get("BNPRL_REFERENCE_MODELS")

# Uniformly random, best blind action, MDP, QMDP, FIB; None where no figure is known.
RESETTING = {
    "Shuttle": (-4.061860, 0, 32.889725, 32.889725, 32.889725),
    "CheeseMaze": (0.249493, 0.236647, 3.936065, 3.789942, 3.521567),
    "Grid4x4": (0.430623, 0.229566, 4.673038, 4.623429, 4.425300),
    "NoisyMaze1D": (0.930385, 1.028432, 1.716450, 1.574792, 1.458570),
    "Tiger": (-606.666667, -20, 200, 189, 87.179487),
    "Hallway": (0.043907, 0.047236, 1.535781, 1.458985, 1.289373),
    "Hallway2": (0.027132, 0.028749, 1.200664, 1.140633, 0.981811),
    "Tag": (-54.225602, -20, 2.154262, 0.819274, None),
}
EPISODIC = {
    "CheeseMaze": (0.203640, None, 0.864632, 0.832534, None),
    "Grid4x4": (0.310105, None, 0.895661, 0.886153, None),
    "NoisyMaze1D": (0.610753, None, 0.873288, 0.801216, None),
    "Hallway": (0.042233, None, 0.643651, 0.611468, None),
    "Hallway2": (0.026483, None, 0.576245, 0.547434, None),
    "Tag": (-53.760587, None, 2.154262, 0.819274, None),
}
JOINT = {  # at discount .9
    "DecTiger": (-462.2222, None, 200, 178, 84.210527),
    "BroadcastChannel": (3.180518, None, 9.730996, 9.730996, 9.383955),
    "RecyclingRobots": (6.361766, None, 33.847871, 33.847871, 33.847871),
    "MeetingGrid": (0.144916, None, 5.947212, 5.947212, 5.947212),
    "BoxPushing": (-8.931549, None, 242.235831, 242.235831, 231.405293),  # by rule
    "MarsRovers": (-13.289684, None, 29.164567, 29.164567, 29.164567),
}
JOINT_95 = {  # at discount .95
    "DecTiger": (-924.4444, None, 400, 378, 174.358975),
    "BroadcastChannel": (6.017032, None, 19.295228, 19.295228, 18.566716),
    "MeetingGrid": (0.377834, None, 15.362644, 15.362644, 15.362644),
    "BoxPushing": (-21.004299, None, 507.708708, 507.708708, 486.194585),
    "MarsRovers": (-25.520818, None, 57.823988, 57.823988, 57.823988),
}
FILES = {
    "shuttle.95.POMDP": (0.95, RESETTING["Shuttle"]),
    "cheese.95.POMDP": (0.95, RESETTING["CheeseMaze"]),
    "4x4.95.POMDP": (0.95, RESETTING["Grid4x4"]),
    "1d.noisy.POMDP": (0.75, RESETTING["NoisyMaze1D"]),
    "tiger.95.POMDP": (0.95, RESETTING["Tiger"]),
    "Hallway.pomdp": (0.95, (0.043907, 0.047236, 1.535773, 1.458985, 1.289373)),
    "TagAvoid.pomdp": (0.95, (-54.221799, -20, 2.160487, 0.826421, 0.329491)),
    "dectiger.dpomdp": (0.9, JOINT["DecTiger"]),
    "broadcastChannel.dpomdp": (0.9, JOINT["BroadcastChannel"]),
    "recycling.dpomdp": (0.9, JOINT["RecyclingRobots"]),
    "boxPushingUAI07.dpomdp": (0.9, (-8.933261, None, 242.235831, 242.235831, 231.405293)),
    "Mars.dpomdp": (0.9, JOINT["MarsRovers"]),
}
TRUNCATED = {"Hallway": 2e-5, "Hallway2": 3e-5}  # figures from files that truncate observations


def registered(name, **arguments):
    id = f"bnprl/{name}-v0"
    if id not in bnprl_envs.environment_ids():
        pytest.skip(f"{id} is not registered")
    return bnprl_envs.model(id, **arguments)


def bounds(model, discount=None):
    start = model.start
    return (
        random_value(model, discount),
        blind_values(model, discount).max(),
        start @ mdp_value(model, discount),
        (q_mdp(model, discount) @ start).max(),
        (fib(model, discount) @ start).max(),
    )


def assert_golden(model, golden, discount=None, tolerance=3e-6):
    names = ("random", "blind", "MDP", "QMDP", "FIB")
    for name, value, wanted in zip(names, bounds(model, discount), golden, strict=True):
        if wanted is not None:
            digits = 1e-4 if wanted in (-462.2222, -924.4444) else tolerance
            assert value == pytest.approx(wanted, abs=digits), name


class TestGoldenValues:
    def test_tiger_with_its_other_discount(self):
        assert_golden(registered("Tiger"), (-121.333333, -4, 40, 29, 14.857143), 0.75)

    @pytest.mark.parametrize("name", RESETTING)
    def test_resetting(self, name):
        arguments = {} if name in ("Shuttle", "Tiger") else {"resetting": True}
        model = registered(name, **arguments)
        assert_golden(model, RESETTING[name], tolerance=TRUNCATED.get(name, 3e-6))

    @pytest.mark.parametrize("name", EPISODIC)
    def test_episodic(self, name):
        assert_golden(registered(name), EPISODIC[name], tolerance=TRUNCATED.get(name, 3e-6))

    @pytest.mark.parametrize("name", JOINT)
    def test_joint(self, name):
        assert_golden(registered(name), JOINT[name], 0.9)

    @pytest.mark.parametrize("name", JOINT_95)
    def test_joint_with_another_discount(self, name):
        assert_golden(registered(name), JOINT_95[name], 0.95)

    def test_meeting_on_the_small_grid(self):
        model = registered("MeetingGrid", size=2)
        assert_golden(model, (2.196709, None, 8.904858, 8.904858, 8.508573), 0.9)

    @pytest.mark.skipif(not REFERENCE, reason="BNPRL_REFERENCE_MODELS does not name a folder")
    @pytest.mark.parametrize("file", FILES)
    def test_files(self, file):
        discount, golden = FILES[file]
        path = Path(REFERENCE) / file
        if not path.is_file():
            pytest.skip(f"no {file}")
        assert_golden(bnprl_envs.read_model(path), golden, discount)


HORIZONS = (1, 2, 3, 4, 5, 10, 20)
FINITE = {
    "DecTiger": ([-416 / 9 * h for h in HORIZONS], [20 * h for h in HORIZONS]),
    "BroadcastChannel": (
        (0.5, 0.875, 1.1987, 1.4997, 1.7904, 3.2086, 6.0317),
        (1, 2, 2.991, 3.9747, 4.9525, 9.7856, 19.3448),
    ),
    "RecyclingRobots": (
        (1.8889, 2.6763, 3.2087, 3.6817, 4.1408, 6.4166, 10.9657),
        (5, 7.29, 11.1225, 14.0696, 17.5309, 33.8208, 66.5526),
    ),
    "MeetingGrid": (
        (0, 0, 0.0021, 0.0085, 0.0195, 0.1172, 0.3607),
        (0, 0, 0.1332, 0.4459, 0.9439, 4.8819, 14.6289),
    ),
    "BoxPushing": (None, (-0.2, 17.6, 66.81, 106.4306, 118.772, 244.8495, 511.1306)),
    "MarsRovers": (
        (-1.7167, -3.123, -4.5364, -5.9197, -7.2657, -13.5636, -25.626),
        (6, 5.8, 9.38, 10.8702, 14.3856, 28.6133, 57.5156),
    ),
}


class TestFiniteHorizon:
    @pytest.mark.parametrize("name", FINITE)
    def test_golden_values(self, name):
        model = registered(name)
        for uniform, row in zip((True, False), FINITE[name], strict=True):
            for horizon, wanted in zip(HORIZONS, row or (), strict=False):
                value = finite_horizon_value(model, horizon, uniform=uniform)
                assert model.start @ value == pytest.approx(wanted, abs=6e-5), (uniform, horizon)

    def test_long_horizon_is_the_infinite_one(self):
        model = hallway()
        value = finite_horizon_value(model, 600, discount=0.95)
        np.testing.assert_allclose(value, mdp_value(model), atol=1e-9)

    def test_bad_arguments(self):
        with pytest.raises(ValueError, match="horizon: -1"):
            finite_horizon_value(hallway(), -1)
        with pytest.raises(ValueError, match=r"discount: 1\.5"):
            finite_horizon_value(hallway(), 1, discount=1.5)


def tiger():
    """The tiger: states left, right; actions listen, open left, open right."""
    listen, reset = np.eye(2), np.full((2, 2), 0.5)
    ears = [[0.85, 0.15], [0.15, 0.85]]
    reward = [[-1, -1], [-100, 10], [10, -100]]
    return TabularModel(
        [listen, reset, reset],
        [ears, reset, reset],
        np.array(reward)[:, :, None, None],
        [0.5, 0.5],
        0.95,
    )


class TestBeliefUpdate:
    def test_tiger_by_hand(self):
        belief, probability = belief_update(tiger(), [0.5, 0.5], 0, 0)
        np.testing.assert_allclose(belief, [0.85, 0.15])
        assert probability == pytest.approx(0.5)
        belief, probability = belief_update(tiger(), belief, 0, 0)
        np.testing.assert_allclose(belief, [0.7225 / 0.745, 0.0225 / 0.745])
        assert probability == pytest.approx(0.745)
        belief, probability = belief_update(tiger(), belief, 1, 1)
        np.testing.assert_allclose(belief, [0.5, 0.5])
        assert probability == pytest.approx(0.5)

    def test_observations_exhaust_the_future(self):
        model = random_model(3)
        belief = np.array([0.2, 0.3, 0.5])
        for action in range(model.n_actions):
            updates = [belief_update(model, belief, action, o) for o in range(2)]
            mean = sum(after * probability for after, probability in updates)
            np.testing.assert_allclose(mean, belief @ model.transition[action])

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (([1.0], 0, 0), r"belief: shape \(1,\), must be \(2,\)"),
            (([0.5, 0.6], 0, 0), "belief: sums to 1.1"),
            (([1.5, -0.5], 0, 0), r"belief: holds -0\.5, must be a distribution"),
            (([0.5, 0.5], 3, 0), r"action: 3, must lie in \[0, 3\)"),
            (([0.5, 0.5], 0, -1), r"observation: -1, must lie in \[0, 2\)"),
        ],
    )
    def test_bad_arguments(self, arguments, message):
        with pytest.raises(ValueError, match=message):
            belief_update(tiger(), *arguments)

    def test_impossible_observation(self):
        model = hallway()
        with pytest.raises(ValueError, match="observation: 20 is impossible after action 0"):
            belief_update(model, model.start, 0, 20)


def random_model(seed, discount=0.4, terminal=False):
    """Three states, two actions, two observations, everything random; some zeros."""
    random = np.random.default_rng(seed)
    transition = random.dirichlet(np.full(3, 0.5), size=(2, 3))
    transition[transition < 0.1] = 0.0
    transition /= transition.sum(axis=2, keepdims=True)
    observation = random.dirichlet(np.ones(2), size=(2, 3))
    reward = random.normal(size=(2, 3, 3, 2))
    flags = np.zeros(3, dtype=bool)
    start = random.dirichlet(np.ones(3))
    if terminal:
        flags[2] = True
        transition[:, 2] = np.eye(3)[2]
        reward[:, 2] = 0.0
        start = np.array([0.6, 0.4, 0.0])
    return TabularModel(transition, observation, reward, start, discount, terminal=flags)


def tree_value(model, belief, depth, leaf):
    """Best value of a belief by trying everything; `leaf` values the last beliefs."""
    if depth == 0:
        return leaf(belief)
    best = -np.inf
    for action in range(model.n_actions):
        value = belief @ model.expected_reward[action]
        for observation in range(model.n_observations):
            joint = belief @ model.transition[action] * model.observation[action][:, observation]
            if (chance := joint.sum()) > 0:
                after = tree_value(model, joint / chance, depth - 1, leaf)
                value += model.discount * chance * after
        best = max(best, value)
    return best


@pytest.mark.parametrize("terminal", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_bounds_enclose_the_best_tree(seed, terminal):
    model = random_model(seed, terminal=terminal)
    worst = min(0.0, model.expected_reward.min()) / (1 - model.discount)
    low = tree_value(model, model.start, 5, lambda belief: worst)
    high = tree_value(model, model.start, 5, lambda belief: belief @ mdp_value(model))
    found = point_based_lower_bound(model, seconds=1)
    _, blind, mdp, qmdp, informed = bounds(model)
    assert high - low < 0.25
    assert low - 1e-6 <= found.value <= high + 1e-9
    assert blind <= found.value + 1e-9
    assert found.value - 1e-9 <= informed <= qmdp + 1e-9 <= mdp + 2e-9
    assert informed >= low
    for vectors in (blind_vectors(model), fib(model), q_mdp(model), found.vectors):
        np.testing.assert_allclose(vectors[:, model.terminal], 0, atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_informed_bound_solves_its_equation(seed):
    model = random_model(seed, discount=0.9)
    vectors = fib(model)
    for action, state in itertools.product(range(2), range(3)):
        total = 0.0
        for observation in range(2):
            joint = model.transition[action, state] * model.observation[action][:, observation]
            total += (vectors @ joint).max()
        expected = model.expected_reward[action, state] + 0.9 * total
        assert vectors[action, state] == pytest.approx(expected, abs=1e-8)


class TestPointBased:
    @pytest.mark.parametrize(
        ("name", "value", "tolerance"),
        [
            ("CheeseMaze", 3.48620682, 1e-3),
            ("Grid4x4", 3.73227331, 1e-1),
            ("NoisyMaze1D", 1.2416248, 1e-5),
        ],
    )
    def test_exact_values_are_enclosed(self, name, value, tolerance):
        model = registered(name, resetting=True)
        found = point_based_lower_bound(model, seconds=5)
        assert value - tolerance <= found.value <= value + 1e-7
        assert (fib(model) @ model.start).max() >= value

    def test_tiger(self):
        assert 19.3 < point_based_lower_bound(tiger(), seconds=2).value < 19.3715

    def test_hallway(self):
        found = point_based_lower_bound(hallway(), seconds=2)
        assert 0.45 < found.value < 0.558
        assert found.value == pytest.approx((found.vectors @ hallway().start).max())

    def test_the_policy_earns_what_it_promises(self):
        model = hallway()
        found = point_based_lower_bound(model, seconds=1)
        env = TabularEnv(model, max_episode_steps=251)
        env.reset(seed=3)
        returns = [episode(env, found) for _ in range(80)]
        error = np.std(returns) / np.sqrt(len(returns))
        assert np.mean(returns) > found.value - 3 * error
        assert np.mean(returns) < (fib(model) @ model.start).max() + 3 * error

    def test_many_agents_count_as_one(self):
        model = registered("RecyclingRobots")
        found = point_based_lower_bound(model, seconds=1, discount=0.9)
        assert found.value == pytest.approx(33.847871, abs=1e-5)  # jointly observable

    def test_progress_never_falls(self):
        seen = []
        found = point_based_lower_bound(
            hallway(), seconds=0.5, on_progress=lambda used, value: seen.append((used, value))
        )
        used, values = np.array(seen).T
        assert (np.diff(used) > 0).all()
        assert (np.diff(values) >= -1e-12).all()
        assert found.value == values[-1]

    def test_seeds_differ_and_repeat(self):
        model = random_model(0)  # small enough to end by itself
        first, again = (point_based_lower_bound(model, seconds=0.1, seed=5) for _ in range(2))
        assert first.value == pytest.approx(again.value, abs=1e-6)

    def test_bad_arguments(self):
        with pytest.raises(ValueError, match="seconds: 0, must be over 0"):
            point_based_lower_bound(tiger(), seconds=0)
        with pytest.raises(ValueError, match="discount"):
            point_based_lower_bound(tiger(), seconds=1, discount=1.0)
        observed = TabularModel([np.eye(2)], None, np.zeros(1), [0.5, 0.5], 0.9)
        with pytest.raises(ValueError, match="fully observed"):
            point_based_lower_bound(observed, seconds=1)


def episode(env, policy):
    """Discounted return of one episode of a policy on beliefs."""
    env.reset()
    belief, total, factor, finished = env.model.start, 0.0, 1.0, False
    while not finished:
        action = policy.act(belief)
        observation, reward, terminated, truncated, _ = env.step(action)
        total += factor * reward
        factor *= env.discount
        belief, _ = belief_update(env.model, belief, action, observation)
        finished = terminated or truncated
    return total


@pytest.mark.parametrize("tool", [random_value, blind_values, mdp_value, q_mdp, fib])
def test_an_infinite_horizon_needs_a_discount_below_one(tool):
    with pytest.raises(ValueError, match=r"discount: 1\.0"):
        tool(hallway().replace(discount=1.0))
    with pytest.raises(ValueError, match=r"discount: -0\.1"):
        tool(hallway(), -0.1)


def test_ten_thousand_states():
    n_states, random = 10_000, np.random.default_rng(0)

    def rows(width, columns):
        ends = random.integers(columns, size=(2 * n_states, width))
        return csr_array(
            (np.full(ends.size, 1 / width), ends.ravel(), np.arange(2 * n_states + 1) * width),
            shape=(2 * n_states, columns),
        )

    reward = random.random((2, n_states))[:, :, None, None]
    start = np.full(n_states, 1 / n_states)
    model = TabularModel(rows(10, n_states), rows(3, 20), reward, start, 0.9)
    uniform, blind, mdp, qmdp, informed = bounds(model)
    found = point_based_lower_bound(model, seconds=0.5)
    assert blind - 1e-9 <= found.value <= informed + 1e-9 <= qmdp + 2e-9 <= mdp + 3e-9
    assert uniform < mdp
