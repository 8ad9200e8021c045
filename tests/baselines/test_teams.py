"""Teams end to end: agents, Stable-Baselines3's learners, evaluation and the command line."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pettingzoo
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import TimeLimit

from baselines.cli import main
from baselines.contenders import contender
from baselines.environment import EnvironmentSpec
from baselines.evaluation import evaluate
from baselines.learners import build_learner, load_policy
from baselines.sb3 import SB3Learner
from baselines.sb3_independent import IndependentPPO
from baselines.sb3_settings import (
    IndependentPPOSettings,
    PPOSettings,
    SharedPPOSettings,
    SharedRecurrentPPOSettings,
)
from baselines.sb3_vec_env import Encoder, SB3VecEnv
from bnprl_agents.random_agent import RandomAgent
from bnprl_envs import ParallelBatch, TabularParallelBatch, model, write_model
from bnprl_envs.registry import entry
from bnprl_envs.team import joint_space
from tests.baselines import pairs
from tests.baselines.interruption import finish, kill_after, lines, summary
from tests.baselines.test_sb3 import CORRIDOR, Corridor

HALLWAY = EnvironmentSpec("bnprl/Hallway-v0")
RECYCLING = EnvironmentSpec("bnprl/RecyclingRobots-v0")
PAIR = EnvironmentSpec("tests.baselines.pairs:test/Pair-v0", {"discount": 1.0})
TINY: dict[str, Any] = {"n_envs": 4, "n_steps": 16, "batch_size": 32, "n_epochs": 2}
TEAMS = (
    ("ppo-shared", SharedPPOSettings(**TINY, frame_stack=2)),
    ("ppo-independent", IndependentPPOSettings(**TINY, frame_stack=2)),
    ("recurrent-ppo-shared", SharedRecurrentPPOSettings(**TINY, lstm_units=8)),
)
learners = pytest.mark.parametrize(("name", "settings"), TEAMS, ids=[name for name, _ in TEAMS])


def test_random_is_worth_what_the_registry_says() -> None:
    env = RECYCLING.make_vec(1)
    spaces = {"agent_0": 3, "agent_1": 3}
    learner: Any = build_learner(contender("random"), RECYCLING, None, seed=0)
    assert {k: int(v.n) for k, v in learner.agent.observation_space.items()} == spaces
    compiled = evaluate(learner.policy, RECYCLING, episodes=4_000, seed=0)
    stepwise = evaluate(learner.policy, RECYCLING, episodes=2_000, seed=0, deterministic=False)
    assert compiled.exact == pytest.approx(entry(RECYCLING.id).references[0].value, abs=1e-5)
    for result in (compiled, stepwise):
        error = result.returns.std() / np.sqrt(len(result.returns))
        assert result.returns.mean() == pytest.approx(compiled.exact, abs=4 * error)
    assert (RECYCLING.horizon, RECYCLING.discount) == (100, 0.9)
    assert env.num_envs == 1


def test_a_model_file_of_a_team_is_an_environment(tmp_path: Path) -> None:
    path = tmp_path / "robots.dpomdp"
    write_model(model(RECYCLING.id), path)
    spec = EnvironmentSpec(str(path))
    assert isinstance(spec.make_vec(2), TabularParallelBatch)
    learner = build_learner(contender("random"), spec, None, seed=0)
    result = evaluate(learner.policy, spec, episodes=10, seed=0)
    assert result.exact == pytest.approx(entry(RECYCLING.id).references[0].value, abs=1e-5)


def test_traffic_is_stepped() -> None:
    spec = EnvironmentSpec(
        "bnprl/GridTraffic-v0", {"rows": 2, "columns": 2, "max_episode_steps": 20}
    )
    settings = dataclasses.replace(contender("batch-em").settings, nodes=2, batch_episodes=10)
    learner = build_learner(contender("batch-em"), spec, settings, seed=0)
    progress = list(learner.learn(episodes=32))
    assert progress[-1].episodes == 32
    assert progress[0].metrics
    result = evaluate(learner.policy, spec, episodes=10, seed=0)
    assert (result.lengths == 20).all()
    assert result.exact is None


def test_encoder_gives_each_agent_a_row() -> None:
    space = joint_space(pairs.Pair().spaces[agent][0] for agent in ("left", "right"))
    encoder = Encoder(space, frame_stack=2, indexed=True)
    first = encoder.encode(np.array([[1, 2]]))
    assert first.tolist() == [[0, 0, 0, 0, 1, 0, 1, 0], [0, 0, 0, 0, 0, 1, 0, 1]]
    second = encoder.encode(np.array([[0, 1]]), first)
    assert second.tolist() == [[0, 1, 0, 1, 0, 0, 1, 0], [0, 0, 1, 0, 1, 0, 0, 1]]
    begun = encoder.encode(np.array([[0, 1]]), first, np.array([True]))
    assert begun.tolist() == [[0, 0, 0, 1, 0, 0, 1, 0], [0, 0, 0, 0, 1, 0, 0, 1]]


def test_agents_are_copies_that_earn_the_teams_reward() -> None:
    batch = ParallelBatch(pairs.Pair, 3)
    env = SB3VecEnv(batch, Encoder(batch.single_observation_space))
    env.seed(0)
    seen = env.reset()
    assert env.num_envs == 6
    for _ in range(4):
        named = seen.argmax(axis=1)
        named[1::2] = 3  # never right
        seen, reward, done, infos = env.step(named)
        assert reward.tolist() == [0.5] * 6
    assert done.all()
    assert [info["episode"]["r"] for info in infos] == [2.0] * 6
    assert all(info["TimeLimit.truncated"] for info in infos)
    assert (env.steps, env.episodes) == (12, 3)


@learners
def test_learns_evaluates_saves_and_predicts_dicts(
    name: str, settings: Any, tmp_path: Path
) -> None:
    learner = build_learner(contender(name), RECYCLING, settings, seed=1)
    slices = list(learner.learn(steps=200))
    assert [progress.steps for progress in slices] == [64, 128, 192]
    assert "train/loss" in slices[-1].metrics
    learner.save(tmp_path / "policy.npz")
    loaded: Any = load_policy(tmp_path / "policy.npz")
    ours = evaluate(learner.policy, RECYCLING, episodes=5, seed=2)
    theirs = evaluate(loaded, RECYCLING, episodes=5, seed=2)
    assert (ours.returns == theirs.returns).all()

    env = pettingzoo.make("parallel", RECYCLING.id)
    observation, _ = env.reset(seed=0)
    state = None
    for _ in range(3):
        array = np.array([[observation["agent_0"], observation["agent_1"]]])
        wanted, _ = loaded.predict(array, state, deterministic=True)
        backwards = dict(reversed(observation.items()))
        action, state = loaded.predict(backwards, state, deterministic=True)
        assert action == dict(zip(env.possible_agents, wanted[0], strict=True))
        observation, *_ = env.step(action)


@learners
def test_the_seed_fixes_the_run_and_looking_changes_nothing(name: str, settings: Any) -> None:
    def run(seed: int, look: bool) -> Any:
        learner = build_learner(contender(name), RECYCLING, settings, seed)
        for _ in learner.learn(steps=128):
            if look:
                evaluate(learner.policy, RECYCLING, episodes=2, seed=0)
        return evaluate(learner.policy, RECYCLING, episodes=5, seed=2).returns.tolist()

    assert run(5, False) == run(5, True)
    assert run(5, False) != run(6, False)


def limited() -> Any:
    return TimeLimit(Corridor(), 5)


def test_independent_ppo_with_one_agent_is_ppo(monkeypatch: pytest.MonkeyPatch) -> None:
    numbers = TINY | {"frame_stack": 2}

    def corridors(make_vec: Any) -> None:
        monkeypatch.setattr(EnvironmentSpec, "make_vec", lambda self, n, mode="": make_vec(n))

    corridors(lambda n: SyncVectorEnv([limited] * n, autoreset_mode=AutoresetMode.DISABLED))
    alone = SB3Learner(CORRIDOR, PPOSettings(**numbers, scale_rewards=True), seed=3)
    slices = list(alone.learn(steps=256))
    corridors(lambda n: ParallelBatch(lambda: pairs.Alone(Corridor()), n))
    team = IndependentPPO(CORRIDOR, IndependentPPOSettings(**numbers), seed=3)
    assert [p.episodes for p in team.learn(steps=256)] == [p.episodes for p in slices]
    ours, theirs = (x.policy.networks[0].state_dict() for x in (team, alone))
    assert all((weight == theirs[name]).all() for name, weight in ours.items())


def test_independent_policies_serve_agents_of_different_sizes(tmp_path: Path) -> None:
    settings = IndependentPPOSettings(**(TINY | {"n_epochs": 10}), frame_stack=1)
    learner = build_learner(contender("ppo-independent"), PAIR, settings, seed=0)
    before = evaluate(learner.policy, PAIR, episodes=100, seed=0).returns.mean()
    for _ in learner.learn(steps=3_000):
        pass
    after = evaluate(learner.policy, PAIR, episodes=100, seed=0).returns.mean()
    assert before < 2.2  # of 4
    assert after > 3.2
    learner.save(tmp_path / "pair.npz")
    loaded: Any = load_policy(tmp_path / "pair.npz")
    assert loaded.action_space == {a: pairs.Pair().action_space(a) for a in ("left", "right")}


@pytest.mark.parametrize(
    ("name", "environment", "reason"),
    [
        ("ppo-shared", PAIR, "agents have 2 or 4 actions, .*; ppo-independent serves them"),
        ("ppo", RECYCLING, "it has several agents; ppo-shared"),
        ("ppo-independent", HALLWAY, "it has one agent; ppo"),
        ("dqn", RECYCLING, "it has several agents"),
    ],
)
def test_what_a_learner_cannot_serve_is_refused(
    name: str, environment: EnvironmentSpec, reason: str
) -> None:
    with pytest.raises(ValueError, match=f"{environment.id}: {reason}"):
        build_learner(contender(name), environment, None, seed=0)


def test_arrays_and_dicts_are_the_same_to_an_agent() -> None:
    batch = TabularParallelBatch("bnprl/DecTiger-v0", 3)
    learner: Any = build_learner(contender("random"), EnvironmentSpec("bnprl/DecTiger-v0"), None, 0)
    agent: RandomAgent = learner.agent
    seen, _ = batch.reset(seed=0)
    agent.reset(seen)
    actions = agent.act(seen)
    assert actions.shape == (3, 2)
    generator = agent.predict_rng.bit_generator.state
    wanted, _ = agent.predict(seen)
    agent.predict_rng.bit_generator.state = generator
    columns = {f"agent_{n}": seen[:, n] for n in range(2)}
    found, _ = agent.predict(columns)
    assert (np.stack([found["agent_0"], found["agent_1"]], axis=1) == wanted).all()
    one, _ = agent.predict(seen[0])
    assert one.shape == (2,)
    with pytest.raises(ValueError, match="observation: 3 of agent 1 lies outside"):
        agent.predict(np.array([[0, 3]]))


COMPARE = [
    "compare",
    RECYCLING.id,
    *("--agents", "online-em", "batch-em", "random", "--seeds", "2"),
    *("--set", "online-em.reward_shift=4", "batch-em.reward_shift=4"),
    *("batch-em.batch_episodes=50", "online-em.nodes=4", "batch-em.nodes=4"),
    *("--episodes", "300", "--eval-episodes", "100", "--eval-points", "6", "--no-progress"),
]


def test_a_killed_comparison_of_a_team_resumes_to_the_same_summary(tmp_path: Path) -> None:
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    assert main([*COMPARE, "--jobs", "1", "--out", str(whole)]) == 0
    rows = {row["agent"]: row for row in summary(whole)["rows"]}
    assert rows["random"]["reference"]  # the last of two of this name
    for name in ("online-em", "batch-em"):
        assert rows[name]["seeds"] == 2
        assert rows[name]["exact"] is not None
        assert not rows[name]["reference"]
    assert rows["best known"]["mean"] == rows["best memoryless"]["mean"] == 31.929134
    assert rows["dissertation"]["source"].startswith("source dissertation: DEC-SBPR")
    arguments = [*COMPARE, "--jobs", "1", "--out", str(killed)]
    assert 4 <= kill_after(arguments, killed, 4, timeout=120) < sum(lines(whole).values())
    finish(arguments, timeout=300)
    assert summary(killed) == summary(whole)


def test_a_users_own_team_is_compared_by_its_module(tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ["compare", PAIR.id, "--agents", "batch-em", "--seeds", "1", "--episodes", "48"]
    small = ["--eval-episodes", "20", "--eval-points", "1", "--no-progress", "--jobs", "1"]
    assert main([*arguments, *small, "--out", str(out)]) == 0
    (row,) = json.loads((out / "summary.json").read_bytes())["rows"]
    assert row["episodes"] == 48
    evaluate_again = ["evaluate", str(out), "--episodes", "10", "--no-progress"]
    assert main(evaluate_again) == 2  # a folder alone imports nothing
    assert main([*evaluate_again, "--env", PAIR.id]) == 0


@pytest.mark.parametrize(
    ("id", "reason"),
    [
        ("test/Rivals-v0", "a team earns one reward"),
        ("test/Leavers-v0", "agents must all end together"),
        ("test/Latecomers-v0", "agents must not come and go"),
        ("test/Painters-v0", "test/Painters-v0: observation space of right"),
        ("no.such.module:Team-v0", "no.such.module:Team-v0: cannot import no.such.module"),
        ("test/Broken-v0", "test/Broken-v0: cannot be made: RuntimeError: out of paint ("),
        ("test/Pairs-v0", "did you mean test/Pair-v0"),
    ],
)
def test_teams_that_cannot_be_served_are_refused_before_anything_is_written(
    id: str, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    train = ["train", id, "--agent", "random", "--episodes", "10", "--out", str(out)]
    assert main(train) == 2
    shown = capsys.readouterr().err
    assert reason in shown
    assert shown.count("\n") == 1
    assert not out.exists()
