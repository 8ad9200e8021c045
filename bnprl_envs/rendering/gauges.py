"""Agents side by side, each with something that is full or empty, and a line between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from bnprl_envs.rendering import theme
from bnprl_envs.rendering.scene import Moment, Scene

if TYPE_CHECKING:
    from bnprl_envs.rendering.canvas import Canvas

_CENTRES = (160.0, 480.0)
_TOP, _WIDTH, _HEIGHT = 78.0, 150.0, 190.0
_MIDDLE = _TOP + _HEIGHT / 2


@dataclass(frozen=True, eq=False)
class Gauges(Scene):
    """Two agents with a gauge each.

    Attributes:
        name: what the gauges measure.
        levels: (S, 2) how full each is, in [0, 1].
        words: (S, 2) the level in a word.
        links: what the last joint action did between the agents, in words; "!" at the end of
            what went wrong.
    """

    name: str
    levels: npt.NDArray[np.float64]
    words: npt.NDArray[np.str_]
    links: Mapping[tuple[int, ...], str] = field(default_factory=dict)

    def draw(self, canvas: Canvas, moment: Moment) -> None:
        """Draw the gauges and what the agents last did."""
        if self.links:
            self._draw_link(canvas, moment)
        for n in range(len(_CENTRES)):
            self._draw_gauge(canvas, moment, n)
        keys = [
            ("square", theme.agent_colour(n), f"{self.name} of {doing.agent}")
            for n, doing in enumerate(moment.doings)
        ]
        if moment.belief is not None:
            keys.append(("square", theme.BELIEF, "expected by the belief"))
        canvas.legend(keys)

    def text(self, moment: Moment) -> str:
        """Return one bar an agent, and what went on between them."""
        lines = []
        for n, doing in enumerate(moment.doings):
            full = round(6 * float(self.levels[moment.state, n]))
            bar = "#" * full + "." * (6 - full)
            lines.append(f"{doing.agent} {self.name} [{bar}] {self.words[moment.state, n]}")
        if moment.actions in self.links:
            lines.append(self.links[moment.actions])
        return "\n".join(lines)

    def _draw_gauge(self, canvas: Canvas, moment: Moment, n: int) -> None:
        x, doing, colour = _CENTRES[n], moment.doings[n], theme.agent_colour(n)
        level, word = float(self.levels[moment.state, n]), str(self.words[moment.state, n])
        left, bottom, room = x - _WIDTH / 2, _TOP + _HEIGHT - 8, _HEIGHT - 16
        canvas.text((x, _TOP - 20), doing.agent)
        canvas.rectangle((left, _TOP), (_WIDTH, _HEIGHT), theme.FLOOR, theme.INK, 2, radius=8)
        if level > 0:
            corner, size = (left + 8, bottom - room * level), (_WIDTH - 16, room * level)
            canvas.rectangle(corner, size, theme.blend(colour, theme.PAPER, 0.75), radius=4)
        if moment.belief is not None:
            y = bottom - room * float(np.asarray(moment.belief) @ self.levels[:, n])
            canvas.line([(left - 12, y), (left + _WIDTH + 12, y)], theme.BELIEF, 5)
        plate = 64 + 6 * len(word)
        canvas.rectangle((x - plate / 2, _MIDDLE - 15), (plate, 30), theme.PAPER, radius=6)
        canvas.text((x, _MIDDLE), word)
        if moment.actions:
            canvas.text((x, _TOP + _HEIGHT + 28), doing.action.replace("-", " "))

    def _draw_link(self, canvas: Canvas, moment: Moment) -> None:
        words = self.links.get(moment.actions, "")
        colour = theme.DANGER if words.endswith("!") else theme.GOAL if words else theme.LINE
        canvas.line([(x, _MIDDLE) for x in _CENTRES], colour, 6 if words else 3)
        canvas.text((sum(_CENTRES) / 2, _MIDDLE - 18), words)
