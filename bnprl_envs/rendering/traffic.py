"""Crossing lines of traffic: a light at each crossing, a queue at each line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from bnprl_envs.rendering import theme
from bnprl_envs.rendering.scene import Moment, Scene

if TYPE_CHECKING:
    from bnprl_envs.rendering.canvas import Canvas

BoolArray = npt.NDArray[np.bool_]

_ROOM_FOR_QUEUES = (120.0, 84.0)  # left of the rows, above the columns
_LARGEST_CELL = 60.0
_SMALLEST_GLYPH = 7.0  # side of a cell below which lights are drawn as pixels
_SMALLEST_NUMBER = 12.0


class _View(NamedTuple):
    left: float
    top: float
    side: float


@dataclass(frozen=True, eq=False)
class Traffic(Scene):
    """The state is the number of units waiting at each line, rows first.

    Attributes:
        rows: of the grid.
        columns: of the grid.
        capacity: of a queue.
        vertical: the action that lets the column pass.
    """

    rows: int
    columns: int
    capacity: int
    vertical: int

    def draw(self, canvas: Canvas, moment: Moment) -> None:
        """Draw queues, open lines and lights."""
        view = self._view()
        opened = self._opened(moment)
        for line in range(self.rows + self.columns):
            self._draw_line(canvas, view, line, int(moment.state[line]), bool(opened[line]))
        if moment.actions:
            self._draw_lights(canvas, view, self._upright(moment))
        canvas.legend(
            [
                ("square", theme.agent_colour(0), "light along its row"),
                ("square", theme.agent_colour(1), "along its column"),
                ("square", theme.DANGER, "queue"),
                ("square", theme.GOAL, "open line"),
            ]
        )

    def text(self, moment: Moment) -> str:
        """Return queues as numbers, lights as - and |, and * at the end of an open line."""
        width = len(str(self.capacity)) + 1
        row_queues, column_queues = np.split(moment.state, [self.rows])
        opened = self._opened(moment)
        lights = np.full((self.rows, self.columns), ".")
        if moment.actions:
            lights = np.where(self._upright(moment), "|", "-")
        lines = [" " * (width + 1) + "".join(f"{queue:>{width}}" for queue in column_queues)]
        for row, queue in enumerate(row_queues):
            marks = "".join(f"{mark:>{width}}" for mark in lights[row])
            lines.append(f"{queue:>{width}} {marks}{' *' if opened[row] else ''}")
        ends = "".join(f"{'*' if shut else ' ':>{width}}" for shut in opened[self.rows :])
        return "\n".join([*lines, f"{'':{width + 1}}{ends}"])

    def _upright(self, moment: Moment) -> BoolArray:
        actions = np.array(moment.actions).reshape(self.rows, self.columns)
        return np.asarray(actions == self.vertical)

    def _opened(self, moment: Moment) -> BoolArray:
        """Return which lines (rows + columns,) let traffic pass in the last step."""
        if not moment.actions:
            return np.zeros(self.rows + self.columns, dtype=np.bool_)
        upright = self._upright(moment)
        return np.concatenate([~upright.any(axis=1), upright.all(axis=0)])

    def _view(self) -> _View:
        left, top, right, bottom = theme.SCENE_BOX
        aside, above = _ROOM_FOR_QUEUES
        side = min(
            (right - left - aside - 20) / self.columns,
            (bottom - top - above - 16) / self.rows,
            _LARGEST_CELL,
        )
        width, height = aside + side * self.columns, above + side * self.rows
        return _View((left + right - width) / 2 + aside, (top + bottom - height) / 2 + above, side)

    def _draw_line(self, canvas: Canvas, view: _View, line: int, queue: int, opened: bool) -> None:
        """Draw one road and the queue that waits before it, a row's at the left."""
        across = line >= self.rows
        k = line - self.rows if across else line
        begin, length = (
            (view.top, self.rows * view.side) if across else (view.left, self.columns * view.side)
        )
        place = (view.left if across else view.top) + (k + 0.5) * view.side
        reach = (_ROOM_FOR_QUEUES[1 if across else 0] - 36) * queue / self.capacity
        thick = 0.6 * view.side

        def turned(along: float, aside: float) -> tuple[float, float]:
            return (aside, along) if across else (along, aside)

        colour = theme.GOAL if opened else theme.LINE
        ends = [turned(begin - 4, place), turned(begin + length + 8, place)]
        canvas.line(ends, colour, max(1.0, 0.16 * view.side) if opened else 1)
        if queue:
            canvas.rectangle(
                turned(begin - 8 - reach, place - thick / 2), turned(reach, thick), theme.DANGER
            )
        if view.side >= _SMALLEST_NUMBER:
            size = min(theme.SMALL, 0.8 * view.side)
            canvas.text(turned(begin - 18 - reach, place), str(queue), size)

    def _draw_lights(self, canvas: Canvas, view: _View, upright: BoolArray) -> None:
        side = view.side
        if side < _SMALLEST_GLYPH:
            colours = np.array([list(bytes.fromhex(c[1:])) for c in theme.AGENTS], dtype=np.uint8)
            size = (side * self.columns, side * self.rows)
            canvas.image(colours[upright.astype(np.int64)], (view.left, view.top), size)
            return
        for (row, column), vertical in np.ndenumerate(upright):
            x, y = view.left + (column + 0.5) * side, view.top + (row + 0.5) * side
            width, height = (0.24 * side, 0.76 * side)[:: 1 if vertical else -1]
            corner = (x - width / 2, y - height / 2)
            canvas.rectangle(corner, (width, height), theme.agent_colour(int(vertical)), radius=2)
