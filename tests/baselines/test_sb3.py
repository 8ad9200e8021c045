"""Stable-Baselines3 behind our interface: what the adapter says, and that slicing is harmless."""

from __future__ import annotations

import dataclasses
import json
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecCheckNan, VecNormalize

from baselines.environment import EnvironmentSpec
from baselines.evaluation import evaluate
from baselines.sb3 import SB3Learner, load_sb3_policy
from baselines.sb3_settings import A2CSettings, DQNSettings, PPOSettings, RecurrentPPOSettings
from baselines.sb3_vec_env import Encoder, SB3VecEnv
from bnprl_agents.policy_files import PolicyFileError


class Corridor(gym.Env[int, int]):
    """Four cells; action 1 goes right, 0 stays; the last cell ends the episode and pays 1."""

    observation_space: ClassVar[Any] = gym.spaces.Discrete(4)
    action_space: ClassVar[Any] = gym.spaces.Discrete(2)
    resets: ClassVar[int] = 0

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed)
        type(self).resets += 1
        self.cell = 0
        return 0, {}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        self.cell += int(action)
        return self.cell, float(self.cell == 3), self.cell == 3, False, {}


@pytest.fixture(scope="module", autouse=True)
def _register() -> Any:
    gym.register("test/Corridor-v0", entry_point=Corridor, max_episode_steps=5)
    yield
    del gym.registry["test/Corridor-v0"]


CORRIDOR = EnvironmentSpec("test/Corridor-v0", {"discount": 0.9})
TINY = (
    A2CSettings(n_envs=4, n_steps=8, frame_stack=2),
    PPOSettings(n_envs=4, n_steps=16, batch_size=32, n_epochs=2, frame_stack=2),
    RecurrentPPOSettings(n_envs=4, n_steps=16, batch_size=32, n_epochs=1, lstm_units=8),
    DQNSettings(n_envs=4, learning_starts=50, batch_size=16, buffer_size=500, frame_stack=2),
)
algorithms = pytest.mark.parametrize("settings", TINY, ids=lambda s: type(s).__name__)


def one_hot(*cells: int | None) -> list[float]:
    """Concatenated one-hot vectors of four; None is the time before the episode."""
    return [float(cell == k) for cell in cells for k in range(4)]


def adapter(frame_stack: int, copies: int = 2) -> SB3VecEnv:
    env = SyncVectorEnv(
        [lambda: gym.make("test/Corridor-v0") for _ in range(copies)],
        autoreset_mode=AutoresetMode.DISABLED,
    )
    return SB3VecEnv(env, Encoder(env.single_observation_space, frame_stack))


def weights(learner: SB3Learner) -> dict[str, Any]:
    return {name: w.numpy().copy() for name, w in learner.policy.networks[0].state_dict().items()}


def test_adapter_divides_rewards_by_the_spread_of_returns() -> None:
    batch = SyncVectorEnv(
        [lambda: gym.make("test/Corridor-v0") for _ in range(4)],
        autoreset_mode=AutoresetMode.DISABLED,
    )
    env, raw = SB3VecEnv(batch, Encoder(batch.single_observation_space), 0.9), adapter(1, copies=4)
    reference = VecNormalize(raw, norm_obs=False, gamma=0.9, clip_reward=np.inf)
    env.reset(), reference.reset()
    for _ in range(12):
        actions = np.array([1, 0, 1, 1])
        np.testing.assert_allclose(env.step(actions)[1], reference.step(actions)[1], rtol=1e-6)


def test_adapter_stacks_reports_ends_and_begins_anew() -> None:
    env = adapter(frame_stack=2)
    assert env.reset().tolist() == [one_hot(None, 0), one_hot(None, 0)]
    env.step(np.array([1, 0]))
    stack, _, done, infos = env.step(np.array([1, 1]))
    assert stack.tolist() == [one_hot(1, 2), one_hot(0, 1)]
    assert not done.any()
    assert infos == [{}, {}]

    stack, reward, done, infos = env.step(np.array([1, 0]))
    assert done.tolist() == [True, False]
    assert reward.tolist() == [1.0, 0.0]
    assert infos[0]["terminal_observation"].tolist() == one_hot(2, 3)
    assert infos[0]["TimeLimit.truncated"] is False
    assert infos[0]["episode"] == {"r": 1.0, "l": 3}
    assert infos[1] == {}
    assert stack.tolist() == [one_hot(None, 0), one_hot(1, 1)]

    env.step(np.array([0, 0]))
    stack, reward, done, infos = env.step(np.array([1, 0]))
    assert done.tolist() == [False, True]
    assert infos[1]["terminal_observation"].tolist() == one_hot(1, 1)
    assert infos[1]["TimeLimit.truncated"] is True
    assert infos[1]["episode"] == {"r": 0.0, "l": 5}
    assert stack.tolist() == [one_hot(0, 1), one_hot(None, 0)]
    assert (env.steps, env.episodes) == (10, 2)


def test_terminating_at_the_time_limit_is_no_truncation() -> None:
    env = adapter(frame_stack=1, copies=1)
    env.reset()
    for action in (0, 0, 1, 1):
        env.step(np.array([action]))
    _, _, done, infos = env.step(np.array([1]))
    assert done[0]
    assert infos[0]["TimeLimit.truncated"] is False


def test_adapter_returns_arrays_that_it_does_not_change_later() -> None:
    env = adapter(frame_stack=2)
    first = env.reset()
    kept = first.copy()
    for _ in range(6):
        env.step(np.array([1, 1]))
    assert (first == kept).all()


def test_adapter_refuses_an_environment_that_resets_itself() -> None:
    env = SyncVectorEnv([Corridor])
    with pytest.raises(ValueError, match="DISABLED"):
        SB3VecEnv(env, Encoder(env.single_observation_space))


def test_adapter_seeds_the_environment_at_the_next_reset_only() -> None:
    env = adapter(frame_stack=1)
    env.seed(7)
    env.reset()
    drawn = [g.random() for g in env.env.unwrapped.np_random]  # type: ignore[attr-defined]
    env.reset()
    again = [g.random() for g in env.env.unwrapped.np_random]  # type: ignore[attr-defined]
    assert drawn == [np.random.default_rng(seed).random() for seed in (7, 8)]
    assert again != drawn


def test_encoder_passes_a_box_on_and_respects_where_discrete_starts() -> None:
    box = gym.spaces.Box(-1.0, 1.0, (3,), np.float32)
    assert Encoder(box, 4).space is box
    observation = np.ones((2, 3), np.float32)
    assert Encoder(box, 4).encode(observation) is observation
    encoder = Encoder(gym.spaces.Discrete(3, start=5))
    assert encoder.encode(np.array([5, 7])).tolist() == [[1, 0, 0], [0, 0, 1]]
    with pytest.raises(ValueError, match="Discrete or Box"):
        Encoder(gym.spaces.MultiBinary(2))


@algorithms
def test_slices_go_on_where_the_last_one_stopped(settings: Any) -> None:
    Corridor.resets = 0
    learner = SB3Learner(CORRIDOR, settings, seed=1)
    slices = list(learner.learn(steps=4 * settings.rollout_steps))
    assert len(slices) == 4
    assert [p.steps for p in slices] == [settings.rollout_steps * (k + 1) for k in range(4)]
    assert Corridor.resets == settings.n_envs + slices[-1].episodes
    assert slices[-1].metrics["rollout/ep_rew_mean"] >= 0.0
    assert all(isinstance(value, float) for value in slices[-1].metrics.values())
    json.dumps(slices[-1].metrics, allow_nan=False)


@algorithms
def test_same_seed_same_weights_and_evaluating_changes_nothing(settings: Any) -> None:
    finals = []
    for seed, look in ((3, False), (3, True), (4, False)):
        learner = SB3Learner(CORRIDOR, settings, seed=seed)
        for _ in learner.learn(steps=2 * settings.rollout_steps):
            if look:
                evaluate(learner.policy, CORRIDOR, episodes=5, seed=0)
        finals.append(weights(learner))
    first, looked, other = finals
    assert all((first[name] == looked[name]).all() for name in first)
    assert any((first[name] != other[name]).any() for name in first)


@pytest.mark.parametrize("budget", [{"steps": 8_000}, {"episodes": 1_900}])
def test_epsilon_falls_over_the_whole_budget(budget: dict[str, int]) -> None:
    settings = DQNSettings(
        learning_starts=10**6, exploration_fraction=0.5, exploration_final=0.1
    )  # no gradient step: quick
    learner = SB3Learner(CORRIDOR, settings, seed=0)
    seen = 0
    for progress in learner.learn(**budget):
        spent = (
            progress.steps / budget["steps"]
            if "steps" in budget
            else progress.episodes / budget["episodes"]
        )
        wanted = max(0.1, 1.0 - 0.9 * spent / 0.5)
        assert learner._models[0].exploration_rate == pytest.approx(wanted)
        seen += 0.2 < wanted < 0.8
    assert seen >= 2


def test_episode_budget_stops_after_the_rollout_that_reaches_it() -> None:
    learner = SB3Learner(CORRIDOR, TINY[1], seed=0)
    slices = list(learner.learn(episodes=40))
    assert slices[-2].episodes < 40 <= slices[-1].episodes


def test_step_budget_is_never_passed() -> None:
    settings = TINY[1]
    *_, last = SB3Learner(CORRIDOR, settings, seed=0).learn(steps=int(2.9 * settings.rollout_steps))
    assert last.steps == 2 * settings.rollout_steps


def test_bad_budgets_are_refused_at_once() -> None:
    learner = SB3Learner(CORRIDOR, TINY[1], seed=0)
    for budget in ({}, {"episodes": 5, "steps": 500}, {"episodes": 0}):
        with pytest.raises(ValueError, match="give one of them"):
            learner.learn(**budget)
    with pytest.raises(ValueError, match="one rollout of 64"):
        learner.learn(steps=63)
    learner.learn(steps=64)
    with pytest.raises(RuntimeError, match="once"):
        learner.learn(steps=64)


def test_ppo_learns_the_corridor() -> None:
    learner = SB3Learner(CORRIDOR, dataclasses.replace(TINY[1], n_epochs=5), seed=0)
    before = evaluate(learner.policy, CORRIDOR, episodes=200, seed=0).returns.mean()
    for _ in learner.learn(steps=3_000):
        pass
    after = evaluate(learner.policy, CORRIDOR, episodes=200, seed=0).returns.mean()
    assert before < 0.6
    assert after > 0.75  # at best 0.81


@algorithms
def test_saved_policy_predicts_what_the_learned_one_does(settings: Any, tmp_path: Any) -> None:
    learner = SB3Learner(CORRIDOR, settings, seed=2)
    for _ in learner.learn(steps=2 * settings.rollout_steps):
        pass
    learner.save(tmp_path / "policy.npz")
    loaded = load_sb3_policy(tmp_path / "policy.npz")
    assert [path.name for path in tmp_path.iterdir()] == ["policy.npz"]
    kept = weights(learner)
    assert all((kept[k] == w.numpy()).all() for k, w in loaded.networks[0].state_dict().items())
    ours = evaluate(learner.policy, CORRIDOR, episodes=30, seed=5)
    theirs = evaluate(loaded, CORRIDOR, episodes=30, seed=5)
    assert (ours.returns == theirs.returns).all()
    assert (ours.lengths == theirs.lengths).all()


def test_a_policy_is_refused_in_an_environment_of_other_spaces() -> None:
    learner = SB3Learner(CORRIDOR, TINY[1], seed=2)
    with pytest.raises(ValueError, match="the policy's observation_space is Discrete"):
        evaluate(learner.policy, EnvironmentSpec("bnprl/Hallway-v0"), episodes=2, seed=0)


def discrete(n: int) -> dict[str, Any]:
    return {"type": "Discrete", "n": n, "start": 0}


def test_damaged_policy_files_are_refused(tmp_path: Any) -> None:
    learner = SB3Learner(CORRIDOR, TINY[1], seed=2)
    path = tmp_path / "policy.npz"
    learner.save(path)
    data = path.read_bytes()
    with np.load(path) as archive:
        arrays = dict(archive)
    name = next(name for name in arrays if name != "meta")
    count = sum(array.size for array in arrays.values())
    for content in (b"", b"not a zip", data[: len(data) // 2]):
        path.write_bytes(content)
        with pytest.raises(PolicyFileError, match=r"policy\.npz"):
            load_sb3_policy(path)
    meta = json.loads(arrays["meta"].tobytes())
    for change, reason in (
        ({"settings_type": "TRPOSettings"}, "TRPOSettings"),
        ({"format": "else"}, "format 'else'"),
        ({"settings": {"units": 3}}, "unexpected keyword"),
        ({"settings": {"hidden_units": 10**6}}, "weights are too few"),
        ({"observation_space": discrete(10**9)}, "weights are too few"),
        ({"observation_space": discrete(count // 2)}, "weights are too few"),
        ({"action_space": discrete(10**9)}, "weights are too few"),
        ({"action_space": discrete(count // 2)}, "weights are too few"),
    ):
        text = np.frombuffer(json.dumps(meta | change).encode(), dtype=np.uint8)
        np.savez(path, **(arrays | {"meta": text}))
        with pytest.raises(PolicyFileError, match=reason):
            load_sb3_policy(path)
    np.savez(path, **(arrays | {name: np.zeros(3)}))
    with pytest.raises(PolicyFileError, match="loading state_dict"):
        load_sb3_policy(path)
    np.savez(path, **(arrays | {name: np.array([{}])}))  # would be a pickle
    with pytest.raises(PolicyFileError):
        load_sb3_policy(path)


@algorithms
def test_predict_begins_anew_copy_by_copy(settings: Any) -> None:
    policy = SB3Learner(CORRIDOR, settings, seed=0).policy
    _, state = policy.predict(np.array([0, 0]), None, None, deterministic=True)
    _, state = policy.predict(np.array([1, 1]), state, np.zeros(2, bool), deterministic=True)
    start = np.array([True, False])
    _, (stack, (memory,)) = policy.predict(np.array([0, 2]), state, start, deterministic=True)
    _, (fresh, (fresh_memory,)) = policy.predict(np.array([0]), None, None, deterministic=True)
    assert (stack[0] == fresh[0]).all()
    if settings.frame_stack == 2:
        assert stack.tolist() == [one_hot(None, 0), one_hot(1, 2)]
    else:
        for part, fresh_part in zip(memory, fresh_memory, strict=True):
            assert part[:, 0] == pytest.approx(fresh_part[:, 0])
            assert np.abs(part[:, 1] - fresh_part[:, 0]).max() > 1e-6


def test_predict_takes_a_scalar() -> None:
    policy = SB3Learner(CORRIDOR, TINY[1], seed=0).policy
    action, state = policy.predict(0)
    assert np.ndim(action) == 0
    action, _ = policy.predict(1, state, False)
    assert action in (0, 1)


def test_stable_baselines_own_checks_and_evaluation_agree() -> None:
    learner = SB3Learner(CORRIDOR, TINY[1], seed=0)
    for _ in learner.learn(steps=640):
        pass
    env = VecCheckNan(adapter(frame_stack=2, copies=4), raise_exception=True)
    theirs, lengths = evaluate_policy(
        learner._models[0], env, n_eval_episodes=20, deterministic=True, return_episode_rewards=True
    )
    ours = evaluate(
        learner.policy,
        EnvironmentSpec(CORRIDOR.id, {"discount": 1.0}),
        episodes=20,
        seed=0,
        deterministic=True,
    )
    assert sorted(theirs) == sorted(ours.returns)
    assert sorted(lengths) == sorted(ours.lengths)


def test_tensorboard_log_is_written(tmp_path: Any) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    learner = SB3Learner(CORRIDOR, TINY[1], seed=0, tensorboard=tmp_path)
    for _ in learner.learn(steps=4 * 64):
        pass
    assert len(list(tmp_path.iterdir())) == 1  # one log, however many slices
    log = EventAccumulator(str(tmp_path))
    log.Reload()
    assert [event.step for event in log.Scalars("rollout/ep_rew_mean")] == [64, 128, 192, 256]


def test_spaces_that_an_algorithm_cannot_serve_are_refused() -> None:
    with pytest.raises(ValueError, match="Pendulum-v1: action space"):
        SB3Learner(EnvironmentSpec("Pendulum-v1"), TINY[3], seed=0)


def test_settings_out_of_range_are_refused() -> None:
    with pytest.raises(ValueError, match="n_envs: 0"):
        PPOSettings(n_envs=0)
    with pytest.raises(ValueError, match="learning_rate"):
        A2CSettings(learning_rate=0.0)
    with pytest.raises(ValueError, match="exploration_fraction"):
        DQNSettings(exploration_fraction=0.0)


def test_stable_baselines3_makes_the_environment_by_its_id() -> None:
    env = make_vec_env("bnprl/Hallway-v0", n_envs=2, seed=0)
    assert env.reset().tolist() == [21, 21]
