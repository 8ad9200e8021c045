"""Two doors, one of which hides a tiger, and who listens before them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bnprl_envs.rendering import theme
from bnprl_envs.rendering.scene import Moment, Scene

if TYPE_CHECKING:
    from bnprl_envs.rendering.canvas import Canvas, Point

_SIDES = ("left", "right")
_DOORS = ((170.0, 52.0), (360.0, 52.0))  # upper left corners
_SIZE = (110.0, 150.0)
_FEET = 318.0  # where the agents stand


@dataclass(frozen=True, eq=False)
class Doors(Scene):
    """The tiger is behind the left door in state 0, behind the right one in state 1.

    Attributes:
        opens: the action that opens the left and the right door.
    """

    opens: tuple[int, int]

    def draw(self, canvas: Canvas, moment: Moment) -> None:
        """Draw the doors as if one could see through them, the agents, and what they heard."""
        for side in range(2):
            self._draw_door(canvas, moment, side)
        gap = 300.0
        for n in range(len(moment.doings)):
            x = canvas.width / 2 + gap * (n - (len(moment.doings) - 1) / 2)
            self._draw_agent(canvas, moment, n, x)
        keys = [("circle", theme.agent_colour(n), d.agent) for n, d in enumerate(moment.doings)]
        keys.append(("circle", theme.DANGER, "tiger"))
        if self._opened(moment):
            keys.append(("square", theme.GOAL, "opened; the tiger is placed anew"))
        if moment.belief is not None:
            keys.append(("square", theme.BELIEF, "belief"))
        canvas.legend(keys)

    def text(self, moment: Moment) -> str:
        """Return both doors, T for the tiger, and an open door without its front."""
        inside = ["T" if moment.state == side else " " for side in range(2)]
        doors = [
            f"/ {mark} /" if side in self._opened(moment) else f"[ {mark} ]"
            for side, mark in enumerate(inside)
        ]
        return f" left   right\n{doors[0]}   {doors[1]}"

    def _opened(self, moment: Moment) -> list[int]:
        """Return which doors the last actions opened."""
        return [side for side in range(2) if self.opens[side] in moment.actions]

    def _draw_door(self, canvas: Canvas, moment: Moment, side: int) -> None:
        (x, y), (width, height) = _DOORS[side], _SIZE
        opened = side in self._opened(moment)
        frame = theme.GOAL if opened else theme.WALL
        wood = theme.FLOOR if opened else theme.blend(theme.BOX, theme.PAPER, 0.35)
        canvas.rectangle((x - 8, y - 8), (width + 16, height + 8), frame, radius=6)
        canvas.rectangle((x, y), (width, height), wood)
        if not opened:
            canvas.circle((x + (width - 14 if side == 0 else 14), y + 0.7 * height), 5, theme.INK)
        if moment.state == side:
            _draw_tiger(canvas, (x + width / 2, y + height / 2), 34)
        below = _SIDES[side]
        if moment.belief is not None:
            chance = float(np.asarray(moment.belief)[side])
            below = f"{below}  {chance:.2f}"
            canvas.rectangle((x, y + height + 30), (width, 10), theme.PANEL)
            canvas.rectangle((x, y + height + 30), (width * chance, 10), theme.BELIEF)
        canvas.text((x + width / 2, y + height + 15), below)

    def _draw_agent(self, canvas: Canvas, moment: Moment, n: int, x: float) -> None:
        """Draw an agent that says what it did or heard."""
        colour = theme.agent_colour(n)
        bubble, width = theme.blend(colour, theme.PAPER, 0.25), 176.0
        canvas.circle((x, _FEET), 20, colour)
        canvas.text((x, _FEET + 34), moment.doings[n].agent, theme.SMALL)
        canvas.polygon([(x - 7, _FEET - 36), (x + 7, _FEET - 36), (x, _FEET - 25)], bubble)
        canvas.rectangle((x - width / 2, _FEET - 62), (width, 27), bubble, radius=8)
        canvas.text((x, _FEET - 48.5), self._says(moment, n), width=width - 12)

    def _says(self, moment: Moment, n: int) -> str:
        if not moment.actions:
            return "nothing heard yet"
        if moment.actions[n] in self.opens:
            return f"opens the {_SIDES[self.opens.index(moment.actions[n])]} door"
        return f"hears {moment.doings[n].observation.replace('-', ' ')}"


def _draw_tiger(canvas: Canvas, centre: Point, radius: float) -> None:
    """Draw a tiger's head."""

    def at(x: float, y: float) -> Point:
        return centre[0] + radius * x, centre[1] + radius * y

    for x in (-0.7, 0.7):
        canvas.circle(at(x, -0.75), 0.32 * radius, theme.DANGER)
    canvas.circle(centre, radius, theme.DANGER)
    for way in (-1, 1):
        canvas.circle(at(0.38 * way, -0.1), 0.12 * radius, theme.INK)
        for y in (0.1, 0.35):
            canvas.line([at(0.95 * way, y), at(0.6 * way, y + 0.05)], theme.INK, 2.5)
    for x in (-0.25, 0.0, 0.25):
        canvas.line([at(x, -0.92), at(0.8 * x, -0.55)], theme.INK, 2.5)
    canvas.polygon([at(-0.15, 0.2), at(0.15, 0.2), at(0.0, 0.4)], theme.INK)
