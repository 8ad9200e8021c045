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

_TOP, _WIDTH, _HEIGHT = 78.0, 150.0, 190.0


@dataclass(frozen=True, eq=False)
class Gauges(Scene):
    """Two agents with a gauge each.

    Attributes:
        name: what the gauges measure.
        levels: (S, 2) how full each is, in [0, 1].
        words: (S, 2) the level in a word.
        links: what the last joint action did between the agents, in words; a strong line where
            it ends in "!".
    """

    name: str
    levels: npt.NDArray[np.float64]
    words: npt.NDArray[np.str_]
    links: Mapping[tuple[int, ...], str] = field(default_factory=dict)

    def draw(self, canvas: Canvas, moment: Moment) -> None:
        """Draw the gauges and what the agents last did."""
        xs = [160.0, 480.0]
        if self.links:
            self._draw_link(canvas, moment, xs)
        for n, (x, doing) in enumerate(zip(xs, moment.doings, strict=True)):
            level, colour = float(self.levels[moment.state, n]), theme.agent_colour(n)
            left, room = x - _WIDTH / 2, _HEIGHT - 16
            canvas.text((x, _TOP - 20), doing.agent)
            canvas.rectangle((left, _TOP), (_WIDTH, _HEIGHT), theme.FLOOR, theme.INK, 2, radius=8)
            if level > 0:
                canvas.rectangle(
                    (left + 8, _TOP + 8 + room * (1 - level)),
                    (_WIDTH - 16, room * level),
                    theme.blend(colour, theme.PAPER, 0.75),
                    radius=4,
                )
            y = _TOP + _HEIGHT / 2
            plate = 64 + 6 * len(self.words[moment.state, n])
            canvas.rectangle((x - plate / 2, y - 15), (plate, 30), theme.PAPER, radius=6)
            canvas.text((x, y), str(self.words[moment.state, n]))
            does = doing.action.replace("-", " ")
            canvas.text((x, _TOP + _HEIGHT + 28), does if moment.actions else "")
        canvas.legend(
            [
                ("square", theme.agent_colour(n), f"{self.name} of {d.agent}")
                for n, d in enumerate(moment.doings)
            ]
        )

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

    def _draw_link(self, canvas: Canvas, moment: Moment, xs: list[float]) -> None:
        y = _TOP + _HEIGHT / 2
        words = self.links.get(moment.actions, "")
        loud = words.endswith("!")
        colour = theme.DANGER if loud else theme.GOAL if words else theme.LINE
        canvas.line([(xs[0], y), (xs[1], y)], colour, 6 if words else 3)
        canvas.text((sum(xs) / 2, y - 18), words)
