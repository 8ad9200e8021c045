"""A card of labels: how any model looks, whatever it is about."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bnprl_envs.rendering import theme
from bnprl_envs.rendering.scene import Moment, Scene, reward_text

if TYPE_CHECKING:
    from bnprl_envs.rendering.canvas import Canvas

_ROWS = 6
"""States of a belief that are shown, the most probable ones."""


@dataclass(frozen=True, eq=False)
class Card(Scene):
    """State, observation, action and reward as words.

    Attributes:
        states: one name a state (S).
    """

    states: Sequence[str]

    def draw(self, canvas: Canvas, moment: Moment) -> None:
        """Draw four fields, or the state and the most probable states of the belief."""
        left, top, right, bottom = theme.SCENE_BOX
        fields = [("true state", self._state(moment), theme.GOAL)]
        if moment.belief is None:
            fields += [
                ("observation", _joined([d.observation for d in moment.doings]), theme.WATER),
                ("action", _joined([d.action for d in moment.doings]), theme.agent_colour(0)),
                ("reward", reward_text(moment), theme.agent_colour(1)),
            ]
        height = (bottom - top) / 4
        for row, (name, words, colour) in enumerate(fields):
            y, tall = top + row * height, height - 12
            canvas.rectangle((left, y), (right - left, tall), theme.PANEL, radius=6)
            canvas.rectangle((left, y), (8, tall), colour)
            canvas.text((left + 24, y + tall / 2), name, colour=theme.FAINT, anchor="lm")
            canvas.text(
                (left + 140, y + tall / 2),
                words,
                theme.LARGE,
                anchor="lm",
                width=right - left - 160,
            )
        if moment.belief is not None:
            self._draw_belief(canvas, moment, top + height + 8)

    def text(self, moment: Moment) -> str:
        """Return the state's name."""
        return f"state {self._state(moment)}"

    def _state(self, moment: Moment) -> str:
        return f"{self.states[moment.state]}  ({moment.state} of 0 to {len(self.states) - 1})"

    def _draw_belief(self, canvas: Canvas, moment: Moment, top: float) -> None:
        left, _, right, bottom = theme.SCENE_BOX
        belief = np.asarray(moment.belief)
        pitch = (bottom - top - 24) / _ROWS
        canvas.text((left, top + 8), "belief: the most probable states", anchor="lm")
        for row, state in enumerate(np.argsort(-belief, kind="stable")[:_ROWS].tolist()):
            y = top + 24 + row * pitch
            start, room = left + 210, right - left - 270
            canvas.text((left, y + pitch / 2), self.states[state], anchor="lm", width=200)
            canvas.rectangle((start, y + 5), (room, pitch - 10), theme.PANEL)
            canvas.rectangle((start, y + 5), (room * belief[state], pitch - 10), theme.BELIEF)
            canvas.text((right, y + pitch / 2), f"{belief[state]:.2f}", anchor="rm")


def _joined(words: Sequence[str]) -> str:
    return ", ".join(words)
