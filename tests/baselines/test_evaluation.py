"""Which environment, and the one evaluation: unbiased, reproducible, the same for everybody."""

from __future__ import annotations

import dataclasses
import json
import pickle
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from baselines import evaluation
from baselines.environment import EnvironmentSpec
from baselines.evaluation import evaluate
from bnprl_agents.controllers.em import BatchEM, BatchEMConfig
from bnprl_agents.controllers.value import controller_value
from bnprl_agents.random_agent import RandomAgent

HALLWAY = EnvironmentSpec("bnprl/Hallway-v0")

COIN_FILE = """discount: 0.5
values: reward
states: heads tails
actions: toss
observations: only
start: uniform
T: * uniform
O: * uniform
R: * : heads : * : * 1
"""


class ShortOrLong(gym.Env[int, int]):
    """A fair coin, shown at the start: 1 step that pays 0, or 20 steps of which the last pays 1."""

    observation_space: ClassVar[Any] = gym.spaces.Discrete(2)
    action_space: ClassVar[Any] = gym.spaces.Discrete(2)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed)
        self.long = int(self.np_random.integers(2))
        self.left = 20 if self.long else 1
        return self.long, {}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        self.left -= 1
        return self.long, float(self.long and self.left == 0), self.left == 0, False, {}


@pytest.fixture(scope="module", autouse=True)
def _register() -> Any:
    gym.register("test/ShortOrLong-v0", entry_point=ShortOrLong)
    yield
    del gym.registry["test/ShortOrLong-v0"]


COIN = EnvironmentSpec("test/ShortOrLong-v0", {"discount": 1.0})


class Still:
    """Always action 0; remembers what it was given."""

    def __init__(self) -> None:
        self.deterministic: set[bool] = set()
        self.starts = 0

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic=False
    ) -> tuple[Any, Any]:
        self.deterministic.add(deterministic)
        self.starts += int(np.sum(episode_start))
        return np.zeros(len(observation), dtype=np.int64), state


class Namesake(Still):
    """Has what this suite's agents call so, but means something else."""

    policy = controllers = greedy_policy = np.zeros((5, 5))


class OnlyPredict:
    """Hides a controller agent's controllers, so that its `predict` is run step by step."""

    def __init__(self, agent: Any) -> None:
        self.predict = agent.predict


def controller_agent(seed: int = 0) -> BatchEM:
    env = HALLWAY.make_vec(1)
    return BatchEM(
        env.single_observation_space,
        env.single_action_space,
        BatchEMConfig(nodes=3),
        discount=0.95,
        seed=seed,
    )


def first_finished(episodes: int, copies: int) -> float:
    """The estimate that evaluation must not make: mean return of the first episodes to finish."""
    env, returns = COIN.make_vec(copies, "SameStep"), []
    env.reset(seed=1)
    value = np.zeros(copies)
    while len(returns) < episodes:
        _, reward, terminated, truncated, _ = env.step(np.zeros(copies, dtype=np.int64))
        value += reward
        done = terminated | truncated
        returns += value[done].tolist()
        value[done] = 0.0
    return float(np.mean(returns[:episodes]))


def test_short_episodes_are_not_favoured(monkeypatch: pytest.MonkeyPatch) -> None:
    naive = first_finished(episodes=200, copies=200)
    assert naive < 0.35  # the trap is real: the true mean is 0.5
    for copies in (1000, 200, 70):
        monkeypatch.setattr(evaluation, "COPIES", copies)
        result = evaluate(Still(), COIN, episodes=600, seed=1)
        assert result.returns.shape == result.lengths.shape == (600,)
        assert result.returns.mean() == pytest.approx(0.5, abs=4 * 0.5 / np.sqrt(600))
        assert (result.lengths == np.where(result.returns > 0, 20, 1)).all()
        assert result.exact is None


def test_every_copy_gives_its_quota_when_episodes_do_not_divide(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(evaluation, "COPIES", 4)
    result = evaluate(Still(), COIN, episodes=11, seed=0)
    assert (result.lengths > 0).all()
    assert len(evaluate(Still(), COIN, episodes=3, seed=0).returns) == 3


def test_returns_are_discounted_from_each_episodes_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluation, "COPIES", 3)
    result = evaluate(Still(), EnvironmentSpec(COIN.id, {"discount": 0.9}), episodes=40, seed=0)
    assert set(np.round(result.returns, 12)) == {0.0, round(0.9**19, 12)}


def test_predict_is_told_of_every_start_and_of_the_mode() -> None:
    policy = Still()
    evaluate(policy, COIN, episodes=50, seed=0)
    assert policy.starts >= 50
    assert policy.deterministic == {False}
    evaluate(policy, COIN, episodes=2, seed=0, deterministic=True)
    assert policy.deterministic == {False, True}


def test_compiled_and_stepwise_evaluation_agree_with_the_exact_value() -> None:
    agent = controller_agent()
    compiled = evaluate(agent, HALLWAY, episodes=20_000, seed=1)
    stepwise = evaluate(OnlyPredict(agent), HALLWAY, episodes=6_000, seed=1)
    model = HALLWAY.model()
    assert model is not None
    assert compiled.exact == pytest.approx(controller_value(model, agent.controllers, 0.95))
    assert stepwise.exact is None
    for result in (compiled, stepwise):
        error = result.returns.std() / np.sqrt(len(result.returns))
        assert result.returns.mean() == pytest.approx(compiled.exact, abs=4 * error)
    lengths = np.hypot(
        compiled.lengths.std() / np.sqrt(20_000), stepwise.lengths.std() / np.sqrt(6_000)
    )
    assert compiled.lengths.mean() == pytest.approx(stepwise.lengths.mean(), abs=4 * lengths)


def test_deterministic_controllers_are_another_policy_and_have_no_exact_value() -> None:
    result = evaluate(controller_agent(), HALLWAY, episodes=50, seed=1, deterministic=True)
    assert result.exact is None


@pytest.mark.parametrize("id", ["bnprl/Hallway-v0", "bnprl/Gridworld-v0"])
def test_an_agent_of_ones_own_may_have_any_attributes(id: str) -> None:
    environment = EnvironmentSpec(id)
    result = evaluate(Namesake(), environment, episodes=5, seed=0)
    assert result.exact is None
    assert (result.returns == evaluate(Still(), environment, episodes=5, seed=0).returns).all()


@pytest.mark.parametrize("hidden", [False, True])
def test_same_seed_same_result_and_the_agent_is_left_alone(
    hidden: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    agent = controller_agent()
    policy = agent
    if hidden:  # step by step
        monkeypatch.setattr(EnvironmentSpec, "model", lambda self: None)
        monkeypatch.setattr(EnvironmentSpec, "discount", 0.95)
        monkeypatch.setattr(EnvironmentSpec, "make_vec", lambda self, n: _hallway(n))
    before = (agent.rng.bit_generator.state, agent.predict_rng.bit_generator.state)
    first = evaluate(policy, HALLWAY, episodes=30, seed=3)
    evaluate(policy, HALLWAY, episodes=7, seed=8)
    again = evaluate(policy, HALLWAY, episodes=30, seed=3)
    assert (first.returns == again.returns).all()
    assert (first.lengths == again.lengths).all()
    other = evaluate(policy, HALLWAY, episodes=30, seed=4)
    assert (first.lengths != other.lengths).any()
    assert before == (agent.rng.bit_generator.state, agent.predict_rng.bit_generator.state)


def _hallway(num_envs: int) -> Any:
    return gym.make_vec("bnprl/Hallway-v0", num_envs=num_envs, autoreset_mode="Disabled")


def test_an_endless_episode_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(evaluation, "LONGEST", 10)
    with pytest.raises(ValueError, match="an episode of 10 steps has not ended"):
        evaluate(Still(), COIN, episodes=20, seed=0)


def test_the_random_agent_looks_at_no_box() -> None:
    spec = EnvironmentSpec("CartPole-v1")
    env = spec.make_vec(1)
    spaces = env.single_observation_space, env.single_action_space
    agent = RandomAgent(*spaces, discount=0.99, seed=0)
    assert agent.predict(np.zeros(4))[0] in (0, 1)
    assert agent.predict(np.zeros((5, 4)))[0].shape == (5,)
    assert 10.0 < evaluate(agent, spec, episodes=100, seed=0).lengths.mean() < 40.0


def test_random_agent_runs_everywhere_discrete() -> None:
    spec = EnvironmentSpec("FrozenLake-v1")
    env = spec.make_vec(1)
    agent = RandomAgent(
        env.single_observation_space, env.single_action_space, discount=0.99, seed=0
    )
    result = evaluate(agent, spec, episodes=200, seed=0)
    assert 0.0 <= result.returns.mean() < 0.1
    assert result.lengths.max() <= 100


def test_no_episodes_are_refused() -> None:
    with pytest.raises(ValueError, match="episodes: 0"):
        evaluate(Still(), COIN, episodes=0, seed=0)


@pytest.mark.parametrize("mode", ["Disabled", "SameStep", "NextStep"])
@pytest.mark.parametrize("id", ["bnprl/Hallway-v0", "FrozenLake-v1"])
def test_copies_are_made_in_the_mode_asked_for(id: str, mode: str) -> None:
    env = EnvironmentSpec(id).make_vec(3, mode)
    assert env.num_envs == 3
    assert env.metadata["autoreset_mode"] is AutoresetMode(mode)


def test_spec_is_data() -> None:
    spec = EnvironmentSpec("bnprl/Hallway-v0", {"resetting": True, "max_episode_steps": 20})
    text = json.dumps(dataclasses.asdict(spec))
    assert EnvironmentSpec(**json.loads(text)) == spec
    assert pickle.loads(pickle.dumps(spec)) == spec


def test_horizon_and_discount() -> None:
    assert (HALLWAY.horizon, HALLWAY.discount) == (251, 0.95)
    other = EnvironmentSpec("bnprl/Hallway-v0", {"max_episode_steps": 9, "discount": 0.5})
    assert (other.horizon, other.discount) == (9, 0.5)
    model = other.model()
    assert model is not None
    assert model.discount == 0.5
    assert evaluate(controller_agent(), other, episodes=20, seed=0).lengths.max() == 9
    lake = EnvironmentSpec("FrozenLake-v1")
    assert (lake.horizon, lake.discount, lake.model()) == (100, 0.99, None)
    with pytest.raises(ValueError, match="discount: 2"):
        _ = EnvironmentSpec("FrozenLake-v1", {"discount": 2}).discount


def test_keywords_reach_the_environment() -> None:
    resetting = EnvironmentSpec("bnprl/Hallway-v0", {"resetting": True}).model()
    assert resetting is not None
    assert not resetting.terminal.any()
    still = EnvironmentSpec("FrozenLake-v1", {"is_slippery": False, "max_episode_steps": 3})
    result = evaluate(Still(), still, episodes=4, seed=0)
    assert result.lengths.tolist() == [3, 3, 3, 3]


@pytest.mark.parametrize("id", ["bnprl/Hallway-v0", "FrozenLake-v1"])
def test_keywords_that_are_not_taken_are_one_clear_error(id: str) -> None:
    with pytest.raises(ValueError, match=f"{id}: .*colour"):
        EnvironmentSpec(id, {"colour": 3}).make_vec(1)


def test_model_files_are_environments(tmp_path: Any) -> None:
    path = tmp_path / "coin.POMDP"
    path.write_text(COIN_FILE)
    spec = EnvironmentSpec(str(path))
    assert (spec.horizon, spec.discount) == (251, 0.5)
    env = spec.make_vec(2)
    agent = RandomAgent(env.single_observation_space, env.single_action_space, discount=0.5, seed=0)
    result = evaluate(agent, spec, episodes=2_000, seed=0)
    assert result.exact == pytest.approx(1.0)  # half a point a step, 0.5 + 0.25 + ...
    assert result.returns.mean() == pytest.approx(1.0, abs=0.06)
    path.write_text(COIN_FILE.replace("discount: 0.5", "discount: 0.25"))
    assert spec.discount == 0.25
    with pytest.raises(ValueError, match="colour"):
        EnvironmentSpec(str(path), {"colour": 3}).model()


def test_unknown_environments_are_refused_with_near_misses(tmp_path: Any) -> None:
    for id, hint in (
        ("bnprl/Halway-v0", "bnprl/Hallway-v0"),
        ("hallway", "bnprl/Hallway-v0"),
        ("FrozenLake-v9", "FrozenLake-v1"),
    ):
        for use in (
            lambda spec: spec.model(),
            lambda spec: spec.horizon,
            lambda spec: spec.discount,
            lambda spec: spec.make_vec(1),
        ):
            with pytest.raises(ValueError, match=f"unknown environment.*did you mean.*{hint}"):
                use(EnvironmentSpec(id))
    with pytest.raises(ValueError, match="no such model file"):
        EnvironmentSpec(str(tmp_path / "none.pomdp")).make_vec(1)
    broken = tmp_path / "broken.pomdp"
    broken.write_text("states: nonsense nonsense nonsense")
    with pytest.raises(ValueError, match=r"broken\.pomdp"):
        EnvironmentSpec(str(broken)).make_vec(1)
