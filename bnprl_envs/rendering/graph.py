"""Graphs: a node a state, arrows for what the actions do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from bnprl_envs.rendering import theme
from bnprl_envs.rendering.scene import Moment, Scene

if TYPE_CHECKING:
    from bnprl_envs.rendering.canvas import Canvas, Point

_RADIUS = 30.0


class Edge(NamedTuple):
    """An arrow between two states.

    Attributes:
        start: a state.
        end: a state.
        action: that leads there.
        bend: how far its middle is off to the left, as a share of its length.
    """

    start: int
    end: int
    action: int
    bend: float = 0.0


@dataclass(frozen=True, eq=False)
class Graph(Scene):
    """States as nodes; arrows that the last step may have taken are strong, odd actions' dashed.

    Attributes:
        positions: (x, y) of each state, in [-1, 1], y upwards.
        labels: a short word for each state.
        edges: arrows.
        actions: a name for each action.
    """

    positions: Sequence[tuple[float, float]]
    labels: Sequence[str]
    edges: Sequence[Edge]
    actions: Sequence[str]

    def draw(self, canvas: Canvas, moment: Moment) -> None:
        """Draw the arrows, the nodes, and the state that is occupied."""
        for edge in self.edges:
            taken = edge.action in moment.actions and edge.end == moment.state
            self._draw_edge(canvas, edge, taken)
        for state, label in enumerate(self.labels):
            here = state == moment.state
            fill = theme.agent_colour(0) if here else theme.FLOOR
            place = self._place(state)
            canvas.circle(place, _RADIUS, fill, theme.INK, 2)
            canvas.text(place, label, colour=theme.PAPER if here else theme.INK)
        canvas.legend(
            [
                ("circle", theme.agent_colour(0), "state"),
                *(("square", _colour(k), name) for k, name in enumerate(self.actions)),
            ]
        )

    def text(self, moment: Moment) -> str:
        """Return all states in a row, the occupied one in brackets."""
        return " ".join(
            f"[{label}]" if state == moment.state else f" {label} "
            for state, label in enumerate(self.labels)
        )

    def _place(self, state: int) -> Point:
        left, top, right, bottom = theme.SCENE_BOX
        x, y = self.positions[state]
        margin = _RADIUS + 6
        return (
            (left + right) / 2 + x * ((right - left) / 2 - margin),
            (top + bottom) / 2 - y * ((bottom - top) / 2 - margin),
        )

    def _draw_edge(self, canvas: Canvas, edge: Edge, taken: bool) -> None:
        (x0, y0), (x1, y1) = self._place(edge.start), self._place(edge.end)
        length = max(((x1 - x0) ** 2 + (y1 - y0) ** 2) ** 0.5, 1e-9)
        along, aside = ((x1 - x0) / length, (y1 - y0) / length), edge.bend * _RADIUS
        side = (along[1] * aside, -along[0] * aside)
        gap = _RADIUS + 4
        start = (x0 + gap * along[0] + side[0], y0 + gap * along[1] + side[1])
        end = (x1 - gap * along[0] + side[0], y1 - gap * along[1] + side[1])
        colour = _colour(edge.action)
        faded = colour if taken else theme.blend(colour, theme.PAPER, 0.45)
        width, dashed = 4.0 if taken else 2.0, edge.action % 2 == 1
        canvas.arrow(start, end, faded, width, edge.bend / 2, dashed)


def _colour(action: int) -> str:
    return (theme.GOAL, theme.DANGER, theme.BELIEF)[action % 3]
