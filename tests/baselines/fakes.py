"""A contender whose returns are known, for tests of what surrounds contenders."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from baselines.contenders import CONTENDERS, Contender
from baselines.environment import EnvironmentSpec
from baselines.evaluation import Evaluation
from baselines.experiment import Entry, Experiment
from baselines.records import Record
from bnprl_agents.training import Progress


@dataclass(frozen=True)
class FakeSettings:
    """Settings of the fake."""

    gain: float = 1.0
    """What an episode adds to the return."""
    update: int = 10
    """Episodes between two updates."""
    fail: bool = False
    """Whether training fails halfway."""
    shape: tuple[int, ...] = (4, 2)
    """A setting that JSON holds as a list."""
    limit: float | str | None = None
    """A setting whose default does not tell its type."""


class FakeLearner:
    """Learns nothing, but its evaluations rise with its episodes."""

    policy_suffix = ".npz"

    def __init__(
        self, environment: EnvironmentSpec, settings: FakeSettings, seed: int, tensorboard: Any
    ) -> None:
        self.settings, self.seed, self.level = settings, seed, 0.0

    @property
    def policy(self) -> FakeLearner:
        return self

    def predict(self, *_: Any) -> Any:
        raise AssertionError("fake_evaluate does not call it")

    def learn(self, *, episodes: int | None, steps: int | None) -> Iterator[Progress]:
        budget = episodes or (steps or 0) // 5
        for done in range(self.settings.update, budget + 1, self.settings.update):
            if self.settings.fail and done > budget // 2:
                raise RuntimeError("the fake fails")
            self.level = self.settings.gain * done + self.seed % 7
            yield Progress(done, 5 * done, {"level": self.level, "bad": float("nan")})

    def save(self, path: Path) -> None:
        Path(path).write_bytes(b"fake")


def fake_evaluate(
    policy: Any, environment: EnvironmentSpec, *, episodes: int, seed: int
) -> Evaluation:
    returns = policy.level + np.random.default_rng(seed).normal(size=episodes)
    return Evaluation(returns, np.full(episodes, 5), 5.0 * returns)


def install(monkeypatch: Any) -> None:
    """Make the contender "fake" known in this process."""
    fake = Contender(
        "fake",
        "a fake",
        "sb3",
        "tests.baselines.fakes:FakeSettings",
        "tests.baselines.fakes:FakeLearner",
    )
    monkeypatch.setitem(CONTENDERS, "fake", fake)
    monkeypatch.setattr("baselines.execution.evaluate", fake_evaluate)


def experiment(*entries: Entry, **changes: Any) -> Experiment:
    values: dict[str, Any] = {"episodes": 100, "seeds": 2, "eval_episodes": 20, "eval_points": 4}
    return Experiment(
        EnvironmentSpec("bnprl/Hallway-v0"), entries or (Entry.of("fake"),), **(values | changes)
    )


def record(**changes: Any) -> Record:
    values: dict[str, Any] = {
        "contender": "fake",
        "seed": 0,
        "episodes": 100,
        "steps": 500,
        "train_seconds": 1.5,
        "eval_seconds": 0.5,
        "return_mean": 0.25,
        "return_std": 0.1,
        "length_mean": 5.0,
        "eval_episodes": 20,
        "exact_value": None,
        "metrics": {"level": 1.0},
        "final": True,
    }
    return Record(**(values | changes))
