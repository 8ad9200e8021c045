"""A square with puddles, the goal in its far corner, and the way walked so far."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from bnprl_envs.rendering import theme
from bnprl_envs.rendering.scene import Moment, Scene

if TYPE_CHECKING:
    from bnprl_envs.rendering.canvas import Canvas, Point

_SHADES = ((1.0, 0.3), (2 / 3, 0.6), (1 / 3, 0.9))  # share of the radius, strength of the colour
_CELLS = 20  # of a side, in plain text


@dataclass(frozen=True, eq=False)
class Puddles(Scene):
    """The state is a point of the unit square, x to the right and y upwards.

    Attributes:
        axes: x, y of both ends of each puddle's axis.
        radius: of the puddles about their axes.
        goal: x + y from which on a point is in the goal.
    """

    axes: Sequence[tuple[float, float, float, float]]
    radius: float
    goal: float

    def draw(self, canvas: Canvas, moment: Moment) -> None:
        """Draw puddles by depth, the goal, the path and the agent."""
        left, top, side = _view()
        canvas.rectangle((left - 8, top - 8), (side + 16, side + 16), theme.WALL, radius=8)
        canvas.rectangle((left, top), (side, side), theme.FLOOR)
        for share, strength in _SHADES:
            colour = theme.blend(theme.WATER, theme.FLOOR, strength)
            for x0, y0, x1, y1 in self.axes:
                ends = [_place((x0, y0)), _place((x1, y1))]
                canvas.line(ends, colour, 2 * self.radius * share * side)
        corner = [(1.0, self.goal - 1.0), (1.0, 1.0), (self.goal - 1.0, 1.0)]
        canvas.polygon(map(_place, corner), theme.GOAL)
        if len(moment.trail) > 1:
            canvas.line([_place((x, y)) for x, y in moment.trail], theme.FAINT, 2)
        canvas.circle(_place(moment.state), 9, theme.agent_colour(0), theme.PAPER, 2)
        canvas.legend(
            [
                ("circle", theme.agent_colour(0), "agent"),
                ("square", theme.FAINT, "path"),
                ("square", theme.WATER, "puddle, darker where deeper"),
                ("square", theme.GOAL, "goal"),
            ]
        )

    def text(self, moment: Moment) -> str:
        """Return the square as cells, R the agent, ~ puddles, G the goal; and where R is."""
        column, row = (min(int(_CELLS * float(z)), _CELLS - 1) for z in moment.state)
        lines = []
        for y in reversed(range(_CELLS)):
            points = [((x + 0.5) / _CELLS, (y + 0.5) / _CELLS) for x in range(_CELLS)]
            marks = [self._mark(point) for point in points]
            if y == row:
                marks[column] = "R"
            lines.append("#" + "".join(marks) + "#")
        edge = "#" * (_CELLS + 2)
        across, up = moment.state[0], moment.state[1]
        return "\n".join([edge, *lines, edge, f"x {across:.3f}  y {up:.3f}"])

    def _mark(self, point: Point) -> str:
        if sum(point) >= self.goal:
            return "G"
        return "~" if any(_distance(point, axis) < self.radius for axis in self.axes) else "."


def _view() -> tuple[float, float, float]:
    """Return left, top and side of the square on a canvas."""
    left, top, right, bottom = theme.SCENE_BOX
    side = bottom - top - 20
    return (left + right - side) / 2, top + 10, side


def _place(point: Sequence[float]) -> Point:
    left, top, side = _view()
    return left + side * float(point[0]), top + side * (1.0 - float(point[1]))


def _distance(point: Point, axis: tuple[float, float, float, float]) -> float:
    """Return the distance of a point from a segment."""
    (x, y), (x0, y0, x1, y1) = point, axis
    along = ((x - x0) * (x1 - x0) + (y - y0) * (y1 - y0)) / ((x1 - x0) ** 2 + (y1 - y0) ** 2)
    along = min(max(along, 0.0), 1.0)
    return math.hypot(x - x0 - along * (x1 - x0), y - y0 - along * (y1 - y0))
