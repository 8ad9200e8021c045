"""Every learner by name: built, run and saved through one interface."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from baselines.contenders import CONTENDERS, MissingExtraError, contender
from baselines.environment import EnvironmentSpec
from baselines.evaluation import evaluate
from baselines.learners import build_learner, load_policy
from bnprl_agents.policy_files import PolicyFileError

HALLWAY = EnvironmentSpec("bnprl/Hallway-v0", {"max_episode_steps": 15})
LAKE = EnvironmentSpec("FrozenLake-v1", {"discount": 0.9})
SMALL: dict[str, dict[str, Any]] = {
    "online-em": {"nodes": 4, "batch_episodes": 10},
    "batch-em": {"nodes": 4, "batch_episodes": 10},
    "variational": {"nodes": 4, "batch_episodes": 10},
    "stick-breaking": {"nodes": 4, "batch_episodes": 10},
    "infinite-rpr": {"nodes": 6, "initial_nodes": 3, "batch_episodes": 10},
    "mcem": {"nodes": 4, "batch_episodes": 10},
    "gpq": {"budget": 20},
    "gpq-optimistic": {"budget": 20},
    "gp-fitted-q": {"capacity": 100, "sweeps": 20, "fit_every": 500},
    "dqn": {"n_envs": 4, "learning_starts": 100, "buffer_size": 2_000, "batch_size": 16},
    "ppo": {"n_envs": 4, "n_steps": 32, "batch_size": 64},
    "a2c": {"n_envs": 4},
    "recurrent-ppo": {"n_envs": 4, "n_steps": 32, "batch_size": 64, "lstm_units": 8},
    "ppo-shared": {"n_envs": 4, "n_steps": 32, "batch_size": 64},
    "ppo-independent": {"n_envs": 4, "n_steps": 32, "batch_size": 64},
    "recurrent-ppo-shared": {"n_envs": 4, "n_steps": 32, "batch_size": 64, "lstm_units": 8},
}
TEAM = EnvironmentSpec("bnprl/BroadcastChannel-v0", {"max_episode_steps": 15})
TEAM_ONLY = ("ppo-shared", "ppo-independent", "recurrent-ppo-shared")
SERVED = [
    *((name, place) for name in CONTENDERS if name not in TEAM_ONLY for place in (HALLWAY, LAKE)),
    *((name, TEAM) for name in ("online-em", "batch-em", "random", *TEAM_ONLY)),
]
names = pytest.mark.parametrize("name", CONTENDERS)


def small(name: str) -> Any:
    return dataclasses.replace(contender(name).settings, **SMALL.get(name, {}))


@names
def test_numbers_that_are_none_are_refused_in_one_line(name: str) -> None:
    settings = contender(name).settings
    words = {int: ("a whole number", ("x", None, 2.5, True)), float: ("a number", ("x", None))}
    for field in dataclasses.fields(settings):
        wanted, wrong = words.get(type(field.default), ("", ()))
        for value in wrong:
            line = f"^{field.name}: {value!r}, must be {wanted}$"
            with pytest.raises(ValueError, match=line):
                dataclasses.replace(settings, **{field.name: value})


@names
def test_contender_is_complete(name: str) -> None:
    entry = contender(name)
    assert entry.name == name
    assert entry.summary
    assert "\n" not in entry.summary
    settings: Any = entry.settings
    assert dataclasses.is_dataclass(settings)
    assert type(settings).__dataclass_params__.frozen  # type: ignore[union-attr]
    assert settings == type(settings)()


@pytest.mark.parametrize(("name", "environment"), SERVED, ids=lambda x: getattr(x, "id", x))
def test_learns_evaluates_saves_and_loads(
    name: str, environment: EnvironmentSpec, tmp_path: Any
) -> None:
    learner = build_learner(contender(name), environment, small(name), seed=1)
    totals = [(p.episodes, p.steps) for p in learner.learn(steps=2_000)]
    assert totals == sorted(totals)
    assert 1_000 < totals[-1][1] <= 2_000
    path = tmp_path / f"policy{learner.policy_suffix}"
    learner.save(path)
    ours = evaluate(learner.policy, environment, episodes=20, seed=2)
    theirs = evaluate(load_policy(path), environment, episodes=20, seed=2)
    assert (ours.returns == theirs.returns).all()
    assert (ours.exact is None) == (theirs.exact is None)


@pytest.mark.parametrize("name", ["batch-em", "ppo"])
def test_the_seed_fixes_the_run(name: str) -> None:
    def run(seed: int) -> Any:
        learner = build_learner(contender(name), HALLWAY, small(name), seed)
        progress = list(learner.learn(episodes=40))
        return progress, evaluate(learner.policy, HALLWAY, episodes=20, seed=2).lengths.tolist()

    assert run(5) == run(5)
    assert run(5) != run(6)


def test_defaults_are_used_where_no_settings_are_given() -> None:
    learner: Any = build_learner(contender("ppo"), HALLWAY, None, seed=0)
    assert learner.settings == contender("ppo").settings


def test_settings_of_another_learner_are_refused() -> None:
    with pytest.raises(ValueError, match=r"PPOSettings, but a2c has A2CSettings"):
        build_learner(contender("a2c"), HALLWAY, contender("ppo").settings, seed=0)


def test_unknown_names_are_refused_with_near_misses() -> None:
    with pytest.raises(ValueError, match="unknown agent 'recurent-ppo'; did you mean recurrent-pp"):
        contender("recurent-ppo")
    with pytest.raises(ValueError, match="known: online-em"):
        contender("zzzz")


@pytest.mark.parametrize(
    ("name", "id"),
    [("batch-em", "CartPole-v1"), ("batch-em", "Pendulum-v1"), ("dqn", "Pendulum-v1")],
)
def test_environments_that_cannot_be_served_are_refused(name: str, id: str) -> None:
    with pytest.raises(ValueError, match=f"{id}: .*Discrete"):
        build_learner(contender(name), EnvironmentSpec(id), None, seed=0)


def test_continuous_observations_and_actions_reach_sb3_unchanged() -> None:
    for name, id in (("dqn", "CartPole-v1"), ("ppo", "Pendulum-v1")):
        spec = EnvironmentSpec(id)
        learner = build_learner(contender(name), spec, small(name), seed=0)
        for _ in learner.learn(steps=1_100):
            pass
        assert np.isfinite(evaluate(learner.policy, spec, episodes=2, seed=0).returns).all()


def test_a_missing_extra_is_one_clear_line(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in [name for name in sys.modules if name.startswith("baselines.sb3")]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    assert contender("ppo").settings.n_envs == 16  # the defaults can be shown all the same
    with pytest.raises(MissingExtraError, match=r'pip install "bnprl\[baselines\]"') as caught:
        build_learner(contender("ppo"), HALLWAY, None, seed=0)
    assert "\n" not in str(caught.value)


def test_listing_contenders_does_not_import_torch() -> None:
    code = (
        "import sys, baselines.contenders as c; "
        "[e.settings for e in c.CONTENDERS.values()]; "
        "sys.exit(any(m in sys.modules for m in ('torch', 'stable_baselines3')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_files_that_hold_no_policy_are_refused(tmp_path: Any) -> None:
    path = tmp_path / "x.npz"
    path.write_bytes(b"nothing")
    with pytest.raises(PolicyFileError, match=r"x\.npz"):
        load_policy(path)
    np.savez(path, a=np.zeros(2))
    with pytest.raises(PolicyFileError, match=r"x\.npz"):
        load_policy(path)
    with pytest.raises(FileNotFoundError):
        load_policy(tmp_path / "none.npz")
