"""What a picture is made of: a scene, which knows how states look, and a moment to be shown."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bnprl_envs.tables import FloatArray

if TYPE_CHECKING:
    from bnprl_envs.rendering.canvas import Canvas


class Doing(NamedTuple):
    """What one agent (or all, in one line) last did and saw, in words."""

    agent: str
    action: str
    observation: str


@dataclass(frozen=True)
class Moment:
    """An environment at one step.

    Attributes:
        state: the true state: an index, or an array.
        step: steps since the episode began.
        actions: the last action of each agent; none before the first step.
        reward: the last one; None before the first step.
        doings: one line an agent.
        belief: (S,) distribution of the state that a policy holds, if it says so.
        trail: the states since the episode began, where the environment keeps them.
    """

    state: Any
    step: int
    actions: tuple[int, ...]
    reward: float | None
    doings: tuple[Doing, ...]
    belief: FloatArray | None = None
    trail: tuple[Any, ...] = ()


class Scene(ABC):
    """How the states of one environment look."""

    @abstractmethod
    def draw(self, canvas: Canvas, moment: Moment) -> None:
        """Draw the state into the canvas's room for the scene."""

    @abstractmethod
    def text(self, moment: Moment) -> str:
        """Return the state as lines of plain text."""


def frame(scene: Scene, moment: Moment) -> npt.NDArray[np.uint8]:
    """Return the picture of a moment, uint8 of shape `FRAME_SHAPE`."""
    from bnprl_envs.rendering.canvas import Canvas  # Pillow, only where something is drawn

    canvas = Canvas()
    scene.draw(canvas, moment)
    canvas.status(moment)
    return canvas.array()


def as_text(scene: Scene, moment: Moment) -> str:
    """Return a moment as lines of plain text: the scene, and what was done and seen."""
    lines = [scene.text(moment), "", f"step {moment.step}   reward {reward_text(moment)}"]
    width = max(len(doing.agent) for doing in moment.doings)
    action = max(len(doing.action) for doing in moment.doings)
    for doing in moment.doings:
        lines.append(
            f"{doing.agent:<{width}}  action {doing.action:<{action}}  saw {doing.observation}"
        )
    return "\n".join(lines)


def reward_text(moment: Moment) -> str:
    """Return the last reward in a few digits, a dash before the first step."""
    return "-" if moment.reward is None else f"{moment.reward:.4g}"
