import numpy as np
import pettingzoo
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from pettingzoo.test import parallel_api_test

import bnprl_envs
from bnprl_envs import GridTraffic, GridTrafficBatch, longer_queue
from bnprl_envs.grid_traffic import HORIZONTAL, VERTICAL

ID = "bnprl/GridTraffic-v0"
OPTIONS = [
    {},
    {"rows": 1, "columns": 1},
    {"rows": 3, "columns": 2},
    {"rows": 2, "columns": 2, "capacity": 1},
    {"rows": 2, "columns": 2, "arrival_rate": 0.0},
    {"rows": 2, "columns": 2, "arrival_rate": 1, "discharge": 3},
    {"rows": 2, "columns": 2, "discount": 0.5, "max_episode_steps": 7},
    {"rows": 2, "columns": 2, "max_cycles": 7},
]


def every(env, action):
    return dict.fromkeys(env.possible_agents, action)


# --- the environment --------------------------------------------------------------------------


@pytest.mark.parametrize("options", OPTIONS)
def test_pettingzoo_checks(options):
    parallel_api_test(pettingzoo.make("parallel", ID, **options), num_cycles=150)
    parallel_api_test(GridTraffic(**options), num_cycles=150)


def test_pettingzoo_makes_it():
    env, entry = pettingzoo.make("parallel", ID), bnprl_envs.entry(ID)
    assert type(env) is GridTraffic
    assert pettingzoo.spec("parallel", ID).max_cycles == entry.horizon == env.max_episode_steps
    assert env.discount == entry.discount == 0.9
    assert env.possible_agents == [f"agent_{n}" for n in range(100)]
    assert env.action_space("agent_7").n == 2
    assert env.observation_space("agent_7").n == 100
    assert env.observation_space("agent_7") is env.observation_space("agent_7")
    with pytest.raises(ValueError, match="GridTraffic-v0 has no tables"):
        bnprl_envs.model(ID)


def test_a_certain_course():
    env = GridTraffic(rows=2, columns=3, capacity=2, arrival_rate=1.0, max_episode_steps=6)
    observations, infos = env.reset(seed=0)
    assert observations == every(env, 0)
    assert infos == every(env, {})
    assert env.state().tolist() == [0, 0, 0, 0, 0]
    observations, rewards, terminations, truncations, infos = env.step(every(env, HORIZONTAL))
    assert env.state().tolist() == [1, 1, 1, 1, 1]  # units arrive after the discharge
    assert observations == every(env, 1 * 3 + 1)
    assert all(type(o) is np.int64 for o in observations.values())
    assert rewards == every(env, 0.0)
    assert terminations == truncations == every(env, False)
    assert infos == every(env, {"lost": 0})
    rewards = env.step(every(env, HORIZONTAL))[1]
    assert rewards == every(env, 2.0)  # both rows
    assert env.state().tolist() == [1, 1, 2, 2, 2]
    _, rewards, _, _, infos = env.step(every(env, VERTICAL))
    assert rewards == every(env, 3.0)  # three columns
    assert env.state().tolist() == [2, 2, 2, 2, 2]
    assert infos == every(env, {"lost": 0})
    mixed = every(env, HORIZONTAL) | {"agent_4": VERTICAL}  # row 1 is shut by its middle agent
    observations, rewards, _, _, infos = env.step(mixed)
    assert rewards == every(env, 1.0)
    assert infos == every(env, {"lost": 4})
    assert observations == every(env, 2 * 3 + 2)
    mixed = every(env, HORIZONTAL) | {"agent_1": VERTICAL, "agent_4": VERTICAL}  # column 1 opens
    assert env.step(mixed)[1] == every(env, 1.0)
    *_, truncations, _ = env.step(every(env, HORIZONTAL))
    assert truncations == every(env, True)
    assert env.agents == []


def test_discharge_and_the_order_of_agents():
    env = GridTraffic(rows=2, columns=2, capacity=5, arrival_rate=1.0, discharge=3)
    env.reset()
    for _ in range(4):
        env.step(every(env, HORIZONTAL))
    assert env.state().tolist() == [1, 1, 4, 4]
    # Row 1 alone is shut, by agent 2 (row 1, column 0).
    observations, rewards, *_ = env.step(every(env, HORIZONTAL) | {"agent_2": VERTICAL})
    assert rewards["agent_0"] == 1.0
    assert env.state().tolist() == [1, 2, 5, 5]
    assert observations == {"agent_0": 11, "agent_1": 11, "agent_2": 17, "agent_3": 17}
    assert env.step(every(env, VERTICAL))[1] == every(env, 6.0)
    assert env.state().tolist() == [2, 3, 3, 3]


def test_a_seed_fixes_whole_episodes():
    def episodes(env, seed):
        rng = np.random.default_rng(5)
        record = [env.reset(seed=seed)]
        for _ in range(3):
            while env.agents:
                # Mostly agreed, so that units pass.
                action = int(rng.integers(2))
                record.append((env.step(every(env, action)), env.state().tolist()))
            record.append(env.reset())
        return record

    env = GridTraffic(rows=4, columns=3, max_episode_steps=30)
    one = episodes(env, 11)
    assert len(one) == 1 + 3 * 31
    assert episodes(GridTraffic(rows=4, columns=3, max_episode_steps=30), 11) == one
    assert episodes(env, 11) == one
    assert episodes(env, 12) != one


def test_limits():
    assert GridTraffic().max_episode_steps == 100
    assert GridTraffic(max_cycles=None).max_episode_steps is None
    assert pettingzoo.make("parallel", ID, max_cycles=5).max_episode_steps == 5
    assert pettingzoo.make("parallel", ID, max_episode_steps=6).max_episode_steps == 6


def test_bad_actions_and_steps_without_an_episode():
    env = GridTraffic(rows=2, columns=2, max_episode_steps=1)
    with pytest.raises(ResetNeeded):
        env.step(every(env, 0))
    with pytest.raises(ResetNeeded):
        env.state()
    env.reset()
    with pytest.raises(ValueError, match=r"action 2 of agent_3 is not an integer in \[0, 1\]"):
        env.step(every(env, 0) | {"agent_3": 2})
    with pytest.raises(ValueError, match="agent_1 is missing"):
        env.step({"agent_0": 0, "agent_2": 0, "agent_3": 0})
    env.step(every(env, 0))
    with pytest.raises(ResetNeeded):
        env.step(every(env, 0))


@pytest.mark.parametrize("make", [GridTraffic, GridTrafficBatch])
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"rows": 0}, "rows: 0, must be an integer, at least 1"),
        ({"columns": 2.5}, r"columns: 2\.5, must be an integer, at least 1"),
        ({"capacity": 0}, "capacity: 0, must be an integer, at least 1"),
        ({"discharge": "1"}, "discharge: '1', must be an integer, at least 1"),
        ({"arrival_rate": 1.5}, r"arrival_rate: 1\.5, must lie in \[0, 1\]"),
        ({"arrival_rate": float("nan")}, r"arrival_rate: nan, must lie in \[0, 1\]"),
        ({"discount": 0.0}, r"discount: 0\.0, must lie in \(0, 1\]"),
        ({"max_episode_steps": 0}, "max_episode_steps: 0, must be an integer, at least 1"),
        ({"render_mode": "ascii"}, "render_mode: 'ascii'"),
    ],
)
def test_bad_constructions(make, arguments, message):
    with pytest.raises(ValueError, match=message):
        make(**arguments)


def test_ten_thousand_agents():
    env = GridTraffic(rows=100, columns=100)
    observations, _ = env.reset(seed=0)
    assert len(observations) == 10_000
    for _ in range(3):
        observations, rewards, *_ = env.step(every(env, HORIZONTAL))
    assert rewards["agent_0"] == rewards["agent_9999"] > 20
    queues = env.state()
    assert observations["agent_4217"] == queues[42] * 10 + queues[100 + 17]


# --- the batch and its numbers ----------------------------------------------------------------


def random_actions(seen, t, rng):
    return rng.integers(2, size=seen.shape)


def always_horizontal(seen, t, rng):
    return np.zeros_like(seen)


def with_the_longer_queue(seen, t, rng):
    return longer_queue(seen)


def alternating(seen, t, rng):
    return np.full_like(seen, t % 2)


def rewards_of(policy, copies=2000):
    """Return the rewards (100 steps, copies) of a policy."""
    batch, rng = GridTrafficBatch(copies), np.random.default_rng(1)
    seen, _ = batch.reset(seed=0)
    rewards = []
    for t in range(100):
        seen, reward, *_ = batch.step(policy(seen, t, rng))
        rewards.append(reward)
    return np.array(rewards)


@pytest.mark.parametrize(
    ("policy", "units"),
    [
        (random_actions, 0.02),
        (always_horizontal, 4.94),
        (with_the_longer_queue, 4.37),
        (alternating, 9.15),
    ],
)
def test_units_a_step_over_100_steps(policy, units):
    copies = 300 if policy is random_actions else 2000
    means = rewards_of(policy, copies).mean(axis=0)
    error = means.std() / np.sqrt(copies)
    assert abs(means.mean() - units) < 4 * error + 0.005  # the figures have two digits


@pytest.mark.parametrize(
    ("policy", "name"),
    [(always_horizontal, "always horizontal"), (alternating, "lower")],
)
def test_the_registered_references(policy, name):
    returns = 0.9 ** np.arange(100) @ rewards_of(policy)
    value = {r.name: r.value for r in bnprl_envs.entry(ID).references}[name]
    error = returns.std() / np.sqrt(returns.size) + 100 * 0.9**100
    assert abs(returns.mean() - value) < 4 * error


def open_queue(chance, t_max=400, discount=0.9, capacity=9, arrival_rate=0.5):
    """Return the discounted units through one queue that is open with this chance at each step."""
    levels, total = np.eye(capacity + 1)[0], 0.0
    for t in range(t_max):
        total += discount**t * chance(t) * levels[1:].sum()
        after = (1 - chance(t)) * levels
        after[:-1] += chance(t) * levels[1:]
        after[0] += chance(t) * levels[0]
        levels = (1 - arrival_rate) * after
        levels[1:] += arrival_rate * after[:-1]
        levels[-1] += arrival_rate * after[-1]
    return total


def test_the_registered_references_are_exact():
    values = {r.name: r.value for r in bnprl_envs.entry(ID).references}
    # By linearity: 20 queues alike, each open only if its ten agents happen to agree.
    assert 20 * open_queue(lambda t: 2.0**-10) == pytest.approx(values["random"], abs=1e-6)
    assert 10 * open_queue(lambda t: 1.0) == pytest.approx(values["always horizontal"], abs=1e-6)
    turns = [open_queue(lambda t, k=k: float(t % 2 == k)) for k in range(2)]
    assert 10 * sum(turns) == pytest.approx(values["lower"], abs=1e-6)


def test_arrivals():
    batch = GridTrafficBatch(4000, rows=2, columns=3, arrival_rate=0.3, max_episode_steps=None)
    batch.reset(seed=0)
    red = np.array([[0, 1, 0, 1, 0, 1]] * 4000)
    red[:, 3:] = [1, 0, 0]  # every row and every column has both kinds, so that nothing passes
    lost = np.zeros(4000)
    for _ in range(60):
        _, reward, _, _, info = batch.step(red)
        assert not reward.any()
        lost += info["lost"]
    waiting = batch.queues.sum(axis=1)
    total = (waiting + lost).sum()
    mean, deviation = 4000 * 5 * 60 * 0.3, np.sqrt(4000 * 5 * 60 * 0.3 * 0.7)
    assert abs(total - mean) < 4 * deviation
    assert batch.queues.max() == 9
    assert lost.min() > 0


def test_the_batch_is_the_environment_where_all_is_certain():
    options = {"rows": 2, "columns": 3, "capacity": 3, "arrival_rate": 1.0}
    env, batch = GridTraffic(**options), GridTrafficBatch(4, **options)
    rng = np.random.default_rng(0)
    seen, many = env.reset()[0], batch.reset()[0]
    while env.agents:
        actions = rng.integers(2, size=6) if rng.random() < 0.5 else np.full(6, rng.integers(2))
        seen, reward, _, truncated, info = env.step(dict(zip(env.agents, actions, strict=True)))
        many, rewards, terminations, truncations, infos = batch.step(np.tile(actions, (4, 1)))
        np.testing.assert_array_equal(many, [list(seen.values())] * 4)
        assert rewards.tolist() == [reward["agent_0"]] * 4
        assert truncations.tolist() == [truncated["agent_0"]] * 4
        assert infos["lost"].tolist() == [info["agent_0"]["lost"]] * 4
        assert not terminations.any()
        np.testing.assert_array_equal(batch.queues, [env.state()] * 4)


def test_batch_types_masks_and_determinism():
    batch = GridTrafficBatch(3, rows=2, columns=2, max_episode_steps=2)
    assert batch.metadata["autoreset_mode"] is AutoresetMode.DISABLED
    assert batch.action_space.shape == batch.observation_space.shape == (3, 4)
    shut = np.zeros((3, 4), dtype=int)
    with pytest.raises(ResetNeeded):
        batch.step(shut)
    with pytest.raises(ResetNeeded):
        batch.reset(options={"reset_mask": np.array([True, False, False])})
    batch.reset(seed=1)
    *arrays, info = batch.step(shut)
    assert [a.dtype for a in arrays] == [np.int64, np.float64, np.bool_, np.bool_]
    assert info["lost"].shape == (3,)
    seen, _ = batch.reset(options={"reset_mask": np.array([False, True, False])})
    assert not seen[1].any()
    np.testing.assert_array_equal(seen[[0, 2]], arrays[0][[0, 2]])
    truncated = batch.step(shut)[3]
    assert truncated.tolist() == [True, False, True]
    with pytest.raises(ResetNeeded, match="copy 0 has finished"):
        batch.step(shut)
    batch.reset(options={"reset_mask": truncated})
    with pytest.raises(ValueError, match=r"action 2 of agent_3 in copy 1 is not in \[0, 1\]"):
        batch.step([[0, 0, 0, 0], [0, 0, 0, 2], [0, 0, 0, 0]])
    batch.reset(seed=1)
    for one, other in zip(arrays, batch.step(shut)[:4], strict=True):
        np.testing.assert_array_equal(one, other)


def test_longer_queue():
    assert longer_queue([0, 11, 12, 21, 90, 9]).tolist() == [0, 0, 1, 0, 0, 1]
    assert longer_queue(5, capacity=2) == VERTICAL
    assert longer_queue(np.array([[3]]), capacity=2).tolist() == [[HORIZONTAL]]
