"""PettingZoo environments of a user's own; importing this module registers them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pettingzoo
from gymnasium.spaces import Box, Discrete


class Pair(pettingzoo.ParallelEnv):
    """Each agent sees a number and should name it: half a point for each that does.

    They have different numbers of observations and actions. Truncated after 4 steps.
    """

    metadata: dict[str, Any] = {"name": "pair"}  # noqa: RUF012

    def __init__(self, max_cycles: int = 4) -> None:
        self.max_cycles = max_cycles
        self.possible_agents = ["left", "right"]
        self.agents: list[str] = []
        self.sizes = {"left": 2, "right": 3}
        self.spaces = {
            "left": (Discrete(2), Discrete(2)),
            "right": (Discrete(3), Discrete(4)),
        }

    def observation_space(self, agent: str) -> Any:
        return self.spaces[agent][0]

    def action_space(self, agent: str) -> Any:
        return self.spaces[agent][1]

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        if seed is not None:
            self.rng = np.random.default_rng(seed)
        self.elapsed = 0
        self.agents = self.possible_agents.copy()
        return self._look(), {agent: {} for agent in self.agents}

    def step(self, actions: dict[str, int]) -> Any:
        right = sum(0.5 for agent in self.agents if actions[agent] == self.seen[agent])
        self.elapsed += 1
        over = self.elapsed == self.max_cycles
        agents = self.agents
        if over:
            self.agents = []
        return (
            self._look(),
            dict.fromkeys(agents, right),
            dict.fromkeys(agents, False),
            dict.fromkeys(agents, over),
            {agent: {} for agent in agents},
        )

    def _look(self) -> dict[str, int]:
        self.seen = {a: int(self.rng.integers(self.sizes[a])) for a in self.possible_agents}
        return self.seen.copy()


class Rivals(Pair):
    """The third step pays the left one only."""

    def step(self, actions: dict[str, int]) -> Any:
        seen, rewards, *others = super().step(actions)
        return seen, rewards | {"left": 9.0 if self.elapsed == 3 else rewards["left"]}, *others


class Leavers(Pair):
    """The right one leaves after the second step."""

    def step(self, actions: dict[str, int]) -> Any:
        seen, rewards, ended, cut, infos = super().step(actions)
        return seen, rewards, ended | {"right": self.elapsed == 2}, cut, infos


class Latecomers(Pair):
    """The right one is not there at first."""

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        seen, infos = super().reset(seed)
        return {"left": seen["left"]}, infos


class Painters(Pair):
    """The right one sees a picture."""

    def __init__(self, max_cycles: int = 4) -> None:
        super().__init__(max_cycles)
        self.spaces["right"] = (Box(0.0, 1.0, (2, 2)), Discrete(4))


class Drawn(Pair):
    """Can be looked at."""

    metadata: dict[str, Any] = {"name": "drawn", "render_modes": ["ansi"]}  # noqa: RUF012

    def __init__(self, max_cycles: int = 4, render_mode: str | None = None) -> None:
        super().__init__(max_cycles)
        self.render_mode = render_mode

    def render(self) -> str:
        return f"{self.render_mode} after {self.elapsed} of {self.max_cycles} steps"


class Broken(Pair):
    """Cannot be made."""

    def __init__(self, max_cycles: int = 4) -> None:
        raise RuntimeError("out of paint")


class Alone(pettingzoo.ParallelEnv):
    """A Gymnasium environment as a team of one, truncated after 5 steps."""

    metadata: dict[str, Any] = {"name": "alone"}  # noqa: RUF012

    def __init__(self, env: Any) -> None:
        self.env = env
        self.possible_agents = ["only"]

    def observation_space(self, agent: str) -> Any:
        return self.env.observation_space

    def action_space(self, agent: str) -> Any:
        return self.env.action_space

    def reset(self, seed: int | None = None, options: Any = None) -> Any:
        self.elapsed = 0
        return {"only": self.env.reset(seed=seed)[0]}, {"only": {}}

    def step(self, actions: dict[str, int]) -> Any:
        self.elapsed += 1
        seen, reward, ended, _, info = self.env.step(actions["only"])
        cut = self.elapsed == 5 and not ended
        return {"only": seen}, {"only": reward}, {"only": ended}, {"only": cut}, {"only": info}


for cls in (Pair, Rivals, Leavers, Latecomers, Painters, Drawn, Broken):
    if f"test/{cls.__name__}-v0" not in pettingzoo.parallel_registry:
        pettingzoo.register("parallel", f"test/{cls.__name__}-v0", cls, max_cycles=4)
