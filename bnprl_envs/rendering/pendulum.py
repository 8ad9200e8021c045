"""A pole on a cart, seen from the side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from bnprl_envs.rendering import theme
from bnprl_envs.rendering.scene import Moment, Scene

if TYPE_CHECKING:
    from bnprl_envs.rendering.canvas import Canvas, Point

_PIVOT = (320.0, 262.0)
_POLE = 190.0
_TRACK = 318.0
_COLUMNS = 41  # of the scale in plain text, an odd number


@dataclass(frozen=True, eq=False)
class Pendulum(Scene):
    """The state is the angle from the vertical, to the right positive, and its velocity.

    Attributes:
        fallen: angle at which the pole has fallen, rad.
        pushes: force of each action, N, to the right positive.
    """

    fallen: float
    pushes: Sequence[float]

    def draw(self, canvas: Canvas, moment: Moment) -> None:
        """Draw the limits, the cart with its push, and the pole."""
        angle = float(moment.state[0])
        x, y = _PIVOT
        for way in (-1, 1):
            limit = _tip(way * self.fallen)
            canvas.line([_PIVOT, limit], theme.blend(theme.DANGER, theme.PAPER, 0.5), 2)
            canvas.text((limit[0], limit[1] - 14), "fallen", theme.SMALL, theme.DANGER)
        canvas.line([_PIVOT, _tip(0.0)], theme.LINE, 2)
        canvas.line([(40, _TRACK), (600, _TRACK)], theme.WALL, 3)
        for wheel in (-38, 38):
            canvas.circle((x + wheel, _TRACK - 11), 11, theme.INK)
        canvas.rectangle((x - 65, y - 8), (130, 42), theme.WALL, radius=6)
        canvas.line([_PIVOT, _tip(angle)], theme.agent_colour(0), 12)
        canvas.circle(_tip(angle), 11, theme.agent_colour(0))
        canvas.circle(_PIVOT, 7, theme.PAPER, theme.INK, 2)
        self._draw_push(canvas, moment)
        canvas.legend(
            [
                ("square", theme.agent_colour(0), "pole"),
                ("square", theme.agent_colour(1), "push"),
                ("square", theme.LINE, "vertical"),
            ]
        )

    def text(self, moment: Moment) -> str:
        """Return a scale of angles with the pole as O, the vertical as |, and the push."""
        middle = _COLUMNS // 2
        share = float(moment.state[0]) / self.fallen
        scale = ["."] * _COLUMNS
        scale[middle] = "|"
        scale[middle + round(middle * min(max(share, -1.0), 1.0))] = "O"
        force = self._force(moment)
        arrow = "-->" if force > 0 else "<--" if force < 0 else "   "
        ends = f"angle {-self.fallen:.2f} [{''.join(scale)}] {self.fallen:.2f}"
        return f"{ends}\npole {float(moment.state[0]):+.4f} rad, push {arrow} {force:+.0f} N"

    def _force(self, moment: Moment) -> float:
        return self.pushes[moment.actions[0]] if moment.actions else 0.0

    def _draw_push(self, canvas: Canvas, moment: Moment) -> None:
        force = self._force(moment)
        if force:
            way = math.copysign(1.0, force)
            (x, _), y = _PIVOT, _TRACK + 30
            canvas.arrow((x - way * 60, y), (x + way * 60, y), theme.agent_colour(1), 6)
            canvas.text((x - way * 88, y), f"{abs(force):.0f} N")


def _tip(angle: float) -> Point:
    return _PIVOT[0] + _POLE * math.sin(angle), _PIVOT[1] - _POLE * math.cos(angle)
