"""The search over deterministic controllers: its parts, what it may see, what it reaches."""

import gymnasium as gym
import numpy as np
import pytest
from pettingzoo import ParallelEnv

import bnprl_envs
from bnprl_agents import ControllerSearch, ControllerSearchConfig, controller_value, load, train
from bnprl_agents.policy_files import PolicyFileError
from bnprl_agents.search.best_response import best_response, estimates, respond_in_turn
from bnprl_agents.search.climbing import race
from bnprl_agents.search.leaderboard import Leaderboard
from bnprl_agents.search.memory import MemoryShape, random_tables, remembering_more, shapes
from bnprl_agents.search.moves import ACT, BRANCH, REDIRECT, apply_moves, list_moves
from bnprl_agents.search.roles import shared_roles
from bnprl_agents.search.simulator import CUT, OVER, simulator_of
from bnprl_agents.search.stepwise_simulator import StepwiseSimulator
from bnprl_agents.search.tables import DecisionTables
from bnprl_agents.search.tabular_simulator import TabularSimulator
from bnprl_agents.search.walking import walk
from bnprl_envs import (
    GridTraffic,
    GridTrafficBatch,
    TabularModel,
    TabularParallelBatch,
    TabularParallelEnv,
)
from tests.agents.cases import random_model

SMALL = ControllerSearchConfig(
    nodes=8, explore_seeds=32, refine_seeds=64, judge_seeds=256, candidates=2, patience=64
)


def seeds(size, seed=0):
    return np.random.default_rng(seed).integers(2**64, size=size, dtype=np.uint64)


def random_teams(rng, model, candidates, nodes):
    """Candidates with random tables for a model, the null observation included."""
    sizes = np.array(model.action_sizes)
    n_seen = max(model.observation_sizes) + 1
    return DecisionTables(
        np.arange(sizes.size),
        rng.integers(sizes[:, None], size=(candidates, sizes.size, nodes)).astype(np.int32),
        rng.integers(nodes, size=(candidates, sizes.size, nodes + 1, n_seen)).astype(np.int32),
    )


def agent_for(env, config=SMALL, seed=0):
    return ControllerSearch(
        env.observation_spaces, env.action_spaces, config, discount=0.9, seed=seed
    )


def simulate(model):
    return TabularSimulator(model, discount=0.9, max_episode_steps=100)


@pytest.fixture
def uneven():
    """A model whose agents have different numbers of actions and observations."""
    rng = np.random.default_rng(3)
    return random_model(rng, action_sizes=(2, 3), observation_sizes=(3, 2))


def test_simulated_returns_agree_with_the_exact_value_of_the_same_tables(uneven):
    teams = random_teams(np.random.default_rng(0), uneven, 3, 4)
    simulator = simulate(uneven)
    returns = simulator.returns(teams, seeds(20_000))
    for b in range(3):
        team = teams.candidate(b).controllers(simulator.action_sizes, simulator.observation_sizes)
        exact = controller_value(uneven, team, 0.9)
        error = returns[b].std() / np.sqrt(returns.shape[1])
        assert abs(returns[b].mean() - exact) < 4 * error + 0.01
    assert simulator.episodes == 60_000
    assert 0 < simulator.steps < 60_000 * simulator.horizon


def test_a_seed_fixes_the_world_and_candidates_share_it(uneven):
    teams = random_teams(np.random.default_rng(0), uneven, 1, 4)
    doubled = teams.candidates([0, 0])
    returns = simulate(uneven).returns(doubled, seeds(50))
    np.testing.assert_array_equal(returns[0], returns[1])
    np.testing.assert_array_equal(
        returns[:, 10:20], simulate(uneven).returns(doubled, seeds(50)[10:20])
    )


def test_visits_count_every_discounted_step_once(uneven):
    model = uneven.replace(
        terminal=None, reward=0.0, transition=np.full((6, 4, 4), 0.25), start=np.full(4, 0.25)
    )
    simulator = simulate(model)
    visits = simulator.visits(random_teams(np.random.default_rng(0), model, 1, 4), seeds(10))
    total = (1 - 0.9**simulator.horizon) / (1 - 0.9)
    np.testing.assert_allclose(visits.sum(axis=(1, 2)), total)
    np.testing.assert_allclose(visits[:, -1].sum(axis=1), 1.0)  # the start row, once an episode


def test_the_stepwise_simulator_agrees_in_law_with_the_compiled_one(uneven):
    teams = random_teams(np.random.default_rng(1), uneven, 1, 3)
    compiled = simulate(uneven).returns(teams, seeds(4000))[0]
    batch = TabularParallelBatch(uneven, 200, max_episode_steps=100)
    stepwise = StepwiseSimulator(batch, discount=0.9, max_episode_steps=100)
    means = stepwise.returns(teams, seeds(20))[0]
    error = np.hypot(compiled.std() / np.sqrt(4000), means.std() / np.sqrt(20))
    assert abs(means.mean() - compiled.mean()) < 4 * error
    assert stepwise.episodes == 4000


def test_shapes_of_memory():
    assert MemoryShape(1, 2).nodes(2) == 7
    assert MemoryShape(3, 2).nodes(2) == 7
    assert MemoryShape(2, 0).nodes(100) == 2
    assert MemoryShape(1, 2) not in shapes(9, 3, 2, 64)
    assert len(set(shapes(2, 6, 2, 64))) == len(shapes(2, 6, 2, 64))


def test_a_marked_clock_tells_how_long_the_mark_was_not_seen():
    seen = np.array([[True, True, True, False]])
    shape = MemoryShape(4, 1, 5)  # the mark is observation 5 modulo 3
    team = random_tables(shape, np.zeros(1, int), np.array([2]), seen, 16, np.random.default_rng(0))
    assert team.reachable().sum() == shape.nodes(3) == 8
    successor = team.successor[0, 0]

    def node(*observations):
        where = team.start
        for o in observations:
            where = successor[where, o]
        return where

    assert node(3, 0) != node(3, 0, 0) != node(3, 0, 0, 0) == node(3, 0, 0, 0, 0)
    assert node(3, 0, 1) == node(3, 1, 1) == node(3, 1, 0, 2, 0, 1)
    assert node(3, 0, 2) == node(3, 0, 0, 1, 2)
    assert shape._replace(mark=2) in shapes(3, 4, 1, 8)
    assert shape._replace(mark=2) not in shapes(3, 4, 1, 7)


def test_memory_of_a_period_is_what_was_seen_since_it_began():
    seen = np.array([[True, True, False]])
    team = random_tables(
        MemoryShape(3, 2), np.zeros(1, int), np.array([2]), seen, 8, np.random.default_rng(0)
    )
    successor, nodes = team.successor[0, 0], set()
    assert team.reachable().sum() == 7
    for first in (0, 1):
        for second in (0, 1):
            node = successor[successor[successor[team.start, 2], first], second]
            nodes.add(int(node))
            assert successor[node, 0] == successor[node, 1] == successor[team.start, 2]
    assert len(nodes) == 4


def test_remembering_more_changes_no_decision(uneven):
    simulator = simulate(uneven)
    team = random_tables(
        MemoryShape(2, 1),
        np.arange(2),
        np.array([2, 3]),
        np.array([[True] * 3 + [False], [True] * 2 + [False] * 2]),
        32,
        np.random.default_rng(0),
    )
    more = remembering_more(team)
    assert (more.reachable().sum(axis=1) > team.reachable().sum(axis=1)).all()
    np.testing.assert_array_equal(
        simulator.returns(more, seeds(50)), simulator.returns(team, seeds(50))
    )
    sizes = simulator.action_sizes, simulator.observation_sizes
    for left, right in zip(more.controllers(*sizes), team.controllers(*sizes), strict=True):
        assert left.n_nodes == right.n_nodes <= 4
    cramped = random_teams(np.random.default_rng(0), uneven, 1, 4)  # agent 0 would need more
    np.testing.assert_array_equal(
        remembering_more(cramped).successor[:, 0], cramped.successor[:, 0]
    )


def test_moves_change_what_they_say():
    rng = np.random.default_rng(0)
    team = random_tables(
        MemoryShape(1, 1), np.arange(2), np.array([2, 3]), np.ones((2, 2), bool), 5, rng
    )
    visits = np.zeros(team.successor.shape[1:])
    visits[0, team.start, 0] = 1.0
    visits[1, 0, 1] = 2.0
    act, weight = list_moves(team, visits, np.array([2, 3]), (ACT,))
    assert act[:, :3].tolist() == [[ACT, 0, 0], [ACT, 1, 2], [ACT, 1, 2]]
    assert weight.tolist() == [1.0, 2.0, 2.0]
    redirect, _ = list_moves(team, visits, np.array([2, 3]), (REDIRECT,))
    assert redirect[:, 1:].tolist() == [[0, 5, 0, 1], [0, 5, 0, 2], [1, 0, 1, 0], [1, 0, 1, 1]]
    branch, _ = list_moves(team, visits, np.array([2, 3]), (BRANCH,))
    changed = apply_moves(team, branch)
    assert len(changed.action) == len(branch) == 3
    for b, (_, role, node, seen, target) in enumerate(branch.tolist()):
        old, new = team.successor[0, role, node, seen], changed.successor[b, role, node, seen]
        assert new == 3
        assert changed.action[b, role, new] == target != team.action[0, role, old]
        np.testing.assert_array_equal(changed.successor[b, role, new], team.successor[0, role, old])
        assert changed.candidate(b).reachable()[role].sum() == 4


def test_a_race_is_won_by_the_best_and_by_nobody_among_equals():
    model = bnprl_envs.model("bnprl/RecyclingRobots-v0")
    teams = random_teams(np.random.default_rng(0), model, 40, 3)
    simulator = simulate(model)
    means = simulator.returns(teams, seeds(512)).mean(axis=1)
    order = np.argsort(means)
    base = simulator.returns(teams.candidate(order[20]), seeds(512))[0]
    best, returns = race(simulator, teams, base, seeds(512))
    assert returns.mean() >= means[order[-3]]
    np.testing.assert_allclose(returns.mean(), means[best])
    same = teams.candidates([order[20]] * 4)
    assert race(simulator, same, base, seeds(512)) is None


class Blind:
    """Passes on what `TeamSimulator` promises, and nothing else exists on it."""

    def __init__(self, simulator):
        allowed = {"action_sizes", "observation_sizes", "horizon", "copies", "episodes", "steps"}
        self._get = lambda name: getattr(simulator, name) if name in allowed else None
        self.returns, self.visits = simulator.returns, simulator.visits
        self.experience = simulator.experience

    def __getattr__(self, name):
        value = self._get(name)
        if value is None:
            raise AssertionError(f"the search looked at {name}")
        return value


def test_the_search_sees_what_a_simulator_shows_only(uneven):
    env = TabularParallelEnv(uneven, max_cycles=100)
    learned = []
    for wrap in (Blind, lambda simulator: simulator):
        agent, simulator = agent_for(env), wrap(simulate(uneven))
        values = [agent.improve(simulator, 100_000)["value"] for _ in range(6)]
        learned.append((values, agent.controllers))
    assert learned[0][0] == learned[1][0]
    for left, right in zip(learned[0][1], learned[1][1], strict=True):
        np.testing.assert_array_equal(left.successor, right.successor)


def test_the_search_reaches_the_best_known_value_of_recycling():
    env = TabularParallelEnv("bnprl/RecyclingRobots-v0")
    agent = agent_for(env, ControllerSearchConfig(), seed=1)
    batch = TabularParallelBatch("bnprl/RecyclingRobots-v0", max_episode_steps=100)
    assert controller_value(batch.model, agent.controllers, 0.9) < 7.0  # uniformly random
    *_, last = train(agent, batch, seed=0, steps=12_000_000)
    assert controller_value(batch.model, agent.controllers, 0.9) > 31.5
    assert 9_000_000 < last.steps <= 12_000_000


def test_a_single_agent_is_a_team_of_one():
    env = gym.make_vec("bnprl/Tiger-v0", num_envs=1, autoreset_mode="Disabled")
    agent = ControllerSearch(
        env.single_observation_space, env.single_action_space, SMALL, discount=0.95, seed=0
    )
    for _ in train(agent, env, seed=0, episodes=60_000):
        pass
    model = bnprl_envs.model("bnprl/Tiger-v0")
    assert controller_value(model, agent.controllers, 0.95) > 0.0  # always listening: -20


def test_a_large_team_shares_one_controller_and_agrees_unspoken():
    team = GridTraffic(rows=3, columns=4)
    agent = agent_for(team, ControllerSearchConfig(explore_seeds=64, judge_seeds=512))
    batch = GridTrafficBatch(1, rows=3, columns=4)
    values = [p.metrics["value"] for p in train(agent, batch, seed=0, steps=600_000) if p.metrics]
    assert all(c.action is agent.controllers[0].action for c in agent.controllers)
    always = DecisionTables(np.zeros(12, int), np.zeros((1, 1, 1), np.int32), FLAT)
    horizontal = simulator_of(batch, 0.9).returns(always, seeds(512)).mean()
    assert values[-1] > 1.3 * horizontal


FLAT = np.zeros((1, 1, 2, 100), np.int32)
"""Successors of one node that sees a hundred observations."""


def test_the_compiled_traffic_agrees_in_law_with_the_environment():
    rng = np.random.default_rng(0)
    env = GridTrafficBatch(100, rows=2, columns=3, capacity=2, arrival_rate=0.4, discharge=2)
    teams = DecisionTables(
        np.array([0, 0, 1, 1, 0, 1]),
        rng.integers(2, size=(1, 2, 3)).astype(np.int32),
        rng.integers(3, size=(1, 2, 4, 9)).astype(np.int32),
    )
    compiled, stepwise = (
        simulator_of(env, 0.9),
        StepwiseSimulator(env, discount=0.9, max_episode_steps=100),
    )
    ours, theirs = compiled.returns(teams, seeds(4000))[0], stepwise.returns(teams, seeds(20))[0]
    error = np.hypot(ours.std() / np.sqrt(4000), theirs.std() / np.sqrt(20))
    assert ours.std() > 0.0
    assert abs(ours.mean() - theirs.mean()) < 4 * error
    visits = [s.visits(teams, seeds(k)) for s, k in ((compiled, 4000), (stepwise, 20))]
    np.testing.assert_allclose(visits[0], visits[1], atol=0.25)
    np.testing.assert_allclose(visits[0].sum(), visits[1].sum(), rtol=1e-12)
    followed = [
        s.experience(teams, 4, 0.5, seeds(k))[0] / k for s, k in ((compiled, 4000), (stepwise, 20))
    ]
    np.testing.assert_allclose(followed[0], followed[1] / 100, atol=0.25)
    assert followed[0].sum() == pytest.approx(compiled.horizon)
    assert [followed[0][..., what].sum() for what in (OVER, CUT)] == [0.0, 1.0]


def test_experience_estimates_the_model_of_a_lone_agent():
    model = random_model(np.random.default_rng(0), terminal=False, observation_sizes=(4,))
    model = model.replace(observation=np.tile(np.eye(4), (2, 1, 1)))  # it sees the state
    simulator = simulate(model)
    seen = np.array([[True] * 4 + [False]])
    team = random_tables(
        MemoryShape(1, 1), np.zeros(1, int), np.array([2]), seen, 5, np.random.default_rng(0)
    )
    followed, earned = simulator.experience(team, 0, 0.5, seeds(2000))
    states = team.successor[0, 0, 0, :4]  # the node of each state
    reward, chance = (estimate[states] for estimate in estimates(followed, earned))
    np.testing.assert_allclose(chance[..., :4].transpose(1, 0, 2), model.transition, atol=0.05)
    np.testing.assert_allclose(reward.T, model.expected_reward, atol=0.05)
    response = best_response(team, 0, followed, earned, 0.9, simulator.horizon)
    sweeps = np.zeros(4)
    for _ in range(300):
        quality = model.expected_reward + 0.9 * model.transition @ sweeps
        sweeps = quality.max(axis=0)
    assert response.action[0, 0, states].tolist() == quality.argmax(axis=0).tolist()


def leaving_or_staying(leaves, reward):
    """One place, and what lies behind it: how likely each of two actions leaves, and earns."""
    stay = 1.0 - np.array(leaves)
    return TabularModel(
        transition=np.stack([np.stack([stay, 1.0 - stay], axis=1), [[0.0, 1.0]] * 2], axis=1),
        observation=np.ones((2, 2, 1)),
        reward=np.outer(reward, [1.0, 0.0])[:, :, None, None],
        start=np.array([1.0, 0.0]),
        terminal=np.array([False, True]),
        discount=0.9,
        action_sizes=(2,),
        observation_sizes=(1,),
    )


ONE_NODE = DecisionTables(
    np.zeros(1, int), np.zeros((1, 1, 1), np.int32), np.zeros((1, 1, 2, 2), np.int32)
)


@pytest.fixture(params=["compiled", "stepwise"])
def simulated(request):
    """Makes a simulator of a model and a horizon."""

    def make(model, horizon):
        if request.param == "compiled":
            return TabularSimulator(model, discount=0.9, max_episode_steps=horizon)
        batch = TabularParallelBatch(model, 20, max_episode_steps=horizon)
        return StepwiseSimulator(batch, discount=0.9, max_episode_steps=horizon)

    return make


def test_an_action_that_ends_the_episode_is_a_response_like_any_other(simulated):
    simulator = simulated(leaving_or_staying((0.0, 1.0), (0.1, 10.0)), 100)
    followed, earned = simulator.experience(ONE_NODE, 0, 0.5, seeds(50))
    assert best_response(ONE_NODE, 0, followed, earned, 0.9, 100).action.tolist() == [[[1]]]
    assert followed[0, 1, :-2].sum() == 0.0  # no decision follows it
    assert followed[0, 1, OVER] + followed[0, :, CUT].sum() == simulator.episodes


@pytest.mark.parametrize("horizon", [1, 2, 12])
@pytest.mark.parametrize("leaves", [0.0, 0.5])
def test_estimates_are_of_all_actions_wherever_episodes_end(simulated, horizon, leaves):
    simulator = simulated(leaving_or_staying((leaves, leaves), (2.0, 2.0)), horizon)
    begun = seeds(4000 // simulator.copies)
    reward, chance = estimates(*simulator.experience(ONE_NODE, 0, 0.5, begun))
    np.testing.assert_array_equal(reward, 2.0)
    if horizon == 1:  # nothing is known to follow
        assert (chance == 0.0).all()
    else:
        np.testing.assert_allclose(chance.sum(axis=2), 1.0 - leaves, atol=0.12 * leaves)


def test_responses_in_turn_never_lose():
    model = bnprl_envs.model("bnprl/MarsRovers-v0")
    simulator = simulate(model)
    seen = np.ones((2, 9), dtype=bool)
    rng = np.random.default_rng(0)
    team = random_tables(MemoryShape(1, 1), np.arange(2), np.array([6, 6]), seen, 16, rng)
    after = respond_in_turn(simulator, team, seeds(128), 0.9, rng)
    before, found = (simulator.returns(t, seeds(128)).mean() for t in (team, after))
    assert found > before + 5.0


def test_a_walk_leaves_where_nobody_gains_alone():
    """In the meeting of two at two doors each alone prefers the door that the other goes to."""
    reward = np.diag([1.0, 2.0]).reshape(4, 1, 1, 1) - 0.5
    model = TabularModel(
        transition=np.ones((4, 1, 1)),
        observation=np.ones((4, 1, 1)),
        reward=reward,
        start=np.ones(1),
        discount=0.9,
        action_sizes=(2, 2),
        observation_sizes=(1, 1),
    )
    simulator, rng = simulate(model), np.random.default_rng(0)
    worse = DecisionTables(
        np.arange(2), np.zeros((1, 2, 1), np.int32), np.zeros((1, 2, 2, 2), np.int32)
    )
    stays = respond_in_turn(simulator, worse, seeds(8), 0.9, rng)
    assert stays.action.tolist() == [[[0], [0]]]
    here, best = walk(simulator, worse, seeds(8), 0.9, rng)
    assert here.team.action.tolist() == best.team.action.tolist() == [[[1], [1]]]
    assert best.value == simulator.returns(best.team, seeds(8)).mean()


def test_a_leaderboard_does_not_look_at_the_scale_of_rewards():
    board = Leaderboard.empty(np.zeros(1, int), 1, 2)
    for value in (3e-9, 1e-9, 2e-9, 2e-9):
        board = board.added(ONE_NODE, value, 0, 4)
    assert board.values.tolist() == [3e-9, 2e-9, 1e-9]


def test_a_world_with_few_values_is_refined_too():
    model = leaving_or_staying((1.0, 1.0), (1.0, 2.0))
    agent = agent_for(TabularParallelEnv(model, max_cycles=10))
    simulator = simulate(model)
    for _ in range(6):
        metrics = agent.improve(simulator, 100_000)
    assert metrics["value"] == agent.elites.values[0] == 2.0
    assert all(agent.spent.values())


def test_roles():
    roles, members = shared_roles([2, 2, 3], [4, 4, 4], largest_team=2)
    assert roles.tolist() == [0, 0, 1]
    assert members.tolist() == [0, 2]
    assert shared_roles([2, 2], [4, 4], largest_team=2)[0].tolist() == [0, 1]


def test_a_loaded_search_goes_on_bit_for_bit(uneven, tmp_path):
    env = TabularParallelEnv(uneven, max_cycles=100)
    agent = agent_for(env)
    for _ in range(5):
        agent.improve(simulate(uneven), 100_000)
    agent.save(tmp_path / "policy.npz")
    twin = load(tmp_path / "policy.npz")
    for _ in range(5):
        assert agent.improve(simulate(uneven), 100_000) == twin.improve(simulate(uneven), 100_000)


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("walks_successor", 8, "holds a node that does not exist"),
        ("restarts_action", 2, "holds an action that does not exist"),  # of the first agent
        ("elites_action", -1, "holds an action that does not exist"),
    ],
)
def test_tables_that_point_nowhere_are_refused(uneven, tmp_path, name, value, reason):
    agent = agent_for(TabularParallelEnv(uneven, max_cycles=100))
    while not (agent.restarts.values.size and agent.elites.values.size and agent.walks.values.size):
        agent.improve(simulate(uneven), 100_000)
    agent.save(tmp_path / "policy.npz")
    with np.load(tmp_path / "policy.npz") as archive:
        arrays = dict(archive)
    arrays[name][0, 0].flat[0] = value
    np.savez(tmp_path / "policy.npz", **arrays)
    with pytest.raises(PolicyFileError, match=f"{name}: {reason}"):
        load(tmp_path / "policy.npz")


class Quarrel(ParallelEnv):
    """Two agents whose rewards differ, or of whom one leaves."""

    metadata = {}  # noqa: RUF012
    possible_agents = ["a", "b"]  # noqa: RUF012
    max_episode_steps = 5

    def __init__(self, leaves):
        self.leaves = leaves
        self.observation_spaces = self.action_spaces = {
            name: gym.spaces.Discrete(2) for name in self.possible_agents
        }

    def observation_space(self, agent):
        return self.observation_spaces[agent]

    action_space = observation_space

    def reset(self, seed=None, options=None):
        return {"a": 0, "b": 0}, {}

    def step(self, actions):
        present = ["a"] if self.leaves else ["a", "b"]
        flags = dict.fromkeys(present, False)
        return dict.fromkeys(present, 0), {"a": 1.0, "b": 2.0}, flags, flags, {}


@pytest.mark.parametrize(
    ("leaves", "reason"),
    [(False, "reward: differs between agents"), (True, r"\['b'\] come and go")],
)
def test_teams_that_are_none_are_refused(leaves, reason):
    env = Quarrel(leaves)
    agent = agent_for(env)
    with pytest.raises(ValueError, match=reason):
        next(iter(train(agent, env, seed=0, steps=100)))


def test_bad_input_is_refused(uneven):
    env = TabularParallelEnv(uneven, max_cycles=100)
    agent = agent_for(env)
    with pytest.raises(
        ValueError, match=r"simulator: action_sizes \(3, 3\), the agent has \(2, 3\)"
    ):
        agent.improve(simulate(bnprl_envs.model("bnprl/DecTiger-v0")), 100)
    with pytest.raises(ValueError, match="nodes: 0, must be at least 1"):
        ControllerSearchConfig(nodes=0)
    with pytest.raises(ValueError, match=r"judge_seeds: 30000000, must be .* at most 1,000,000"):
        ControllerSearchConfig(judge_seeds=30_000_000)
    with pytest.raises(ValueError, match="but the search needs one: max_episode_steps"):
        simulator_of(TabularParallelBatch(uneven), 0.9)
    agent.reset({"agent_0": 3, "agent_1": 2})
    actions = agent.act({"agent_0": 3, "agent_1": 2})
    agent.observe(
        actions,
        {"agent_0": 1.0, "agent_1": 1.0},
        {"agent_0": 0, "agent_1": 0},
        {"agent_0": True, "agent_1": True},
        {"agent_0": False, "agent_1": False},
    )
    with pytest.raises(RuntimeError, match="cannot learn from 1 recorded episodes"):
        agent.update()
