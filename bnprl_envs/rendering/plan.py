"""Plans: cells and walls seen from above, and what stands in them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from bnprl_envs.rendering import theme
from bnprl_envs.rendering.scene import Moment, Scene
from bnprl_envs.tables import BoolArray, FloatArray

if TYPE_CHECKING:
    from bnprl_envs.rendering.canvas import Canvas, Key, Point

IntArray = npt.NDArray[np.int64]
Cell = tuple[int, int]

_STEP = ((0, -1), (1, 0), (0, 1), (-1, 0))  # (x, y) of north, east, south, west, y downwards
_LARGEST_CELL = 140.0


@dataclass(frozen=True, eq=False)
class Piece:
    """Something that stands in a cell.

    Attributes:
        name: in the legend.
        kind: how it looks.
        places: (S,) index of its cell in each state; -1 where it is nowhere.
        headings: (S,) where it faces, 0 to 3 for north, east, south, west; None: nowhere.
        sign: one letter, for text.
        agent: which agent's colour it has.
        span: columns that it covers.
    """

    name: str
    kind: Literal["robot", "opponent", "box"]
    places: IntArray
    headings: IntArray | None = None
    sign: str = "R"
    agent: int = 0
    span: int = 1

    @property
    def colour(self) -> str:
        """Its colour."""
        fixed = {"opponent": theme.DANGER, "box": theme.BOX}
        return fixed.get(self.kind, theme.agent_colour(self.agent))


class _View(NamedTuple):
    """Where the cells are on a canvas."""

    left: float
    top: float
    side: float

    def corner(self, cell: Cell) -> Point:
        return self.left + self.side * cell[1], self.top + self.side * cell[0]


@dataclass(frozen=True, eq=False)
class Plan(Scene):
    """A floor plan; what is no cell is wall.

    Attributes:
        cells: (row, column) of each cell, row 0 the northernmost.
        pieces: what stands there.
        goals: indices of the cells that are a goal.
        labels: words for some of the cells.
        done: (S, cells) whether a cell is finished with.
        notes: words for some of the states.
        believed: which piece's place a belief is about.
    """

    cells: Sequence[Cell]
    pieces: Sequence[Piece]
    goals: Collection[int] = ()
    labels: Mapping[int, str] = field(default_factory=dict)
    done: BoolArray | None = None
    notes: Mapping[int, str] = field(default_factory=dict)
    believed: int = 0

    def draw(self, canvas: Canvas, moment: Moment) -> None:
        """Draw walls, cells, belief, goals and pieces."""
        view = self._view()
        rows, columns = self._size()
        side = view.side
        border = min(8.0, 0.25 * side)
        canvas.rectangle(
            (view.left - border, view.top - border),
            (columns * side + 2 * border, rows * side + 2 * border),
            theme.WALL,
            radius=border,
        )
        belief = self.cell_belief(moment)
        for k in range(len(self.cells)):
            self._draw_cell(canvas, view, k, moment.state, 0.0 if belief is None else belief[k])
        for piece, cell, shift in self._standing(moment.state):
            _draw_piece(canvas, view, piece, self.cells[cell], moment.state, shift)
        canvas.legend([*self._keys(belief is not None)])
        if note := self.notes.get(moment.state):
            right, middle = theme.SCENE_BOX[2], theme.LEGEND_HEIGHT / 2
            canvas.text((right, middle), note, theme.TEXT, anchor="rm")

    def text(self, moment: Moment) -> str:
        """Return walls as #, free cells as ., goals as G, finished cells as x, and the pieces."""
        rows, columns = self._size()
        standing = [(piece, cell) for piece, cell, _ in self._standing(moment.state)]
        words = {
            cell: self._mark(k, moment.state)
            + "".join(_sign(piece, moment.state) for piece, at in standing if at == k)
            for k, cell in enumerate(self.cells)
        }
        width = max(3, *map(len, words.values()))
        wall = "#" * width
        lines = [
            "".join(
                wall if (r, c) not in words else f"{words[r, c] or '.':^{width}}"
                for c in range(columns)
            )
            for r in range(rows)
        ]
        edge = "#" * (columns * width + 2)
        note = self.notes.get(moment.state)
        return "\n".join([edge, *(f"#{line}#" for line in lines), edge, *([note] if note else [])])

    def cell_belief(self, moment: Moment) -> FloatArray | None:
        """Return the chance (cells,) that the piece is in each cell; None without a belief."""
        if moment.belief is None:
            return None
        places = self.pieces[self.believed].places
        somewhere = places >= 0
        chances = np.zeros(len(self.cells))
        np.add.at(chances, places[somewhere], np.asarray(moment.belief)[somewhere])
        return chances

    def _size(self) -> tuple[int, int]:
        rows, columns = zip(*self.cells, strict=True)
        return max(rows) + 1, max(columns) + 1

    def _view(self) -> _View:
        """Return the largest view that fits, in the middle of the room."""
        left, top, right, bottom = theme.SCENE_BOX
        rows, columns = self._size()
        margin = 10.0
        side = min(
            (right - left - 2 * margin) / columns, (bottom - top - 2 * margin) / rows, _LARGEST_CELL
        )
        return _View((left + right - side * columns) / 2, (top + bottom - side * rows) / 2, side)

    def _draw_cell(self, canvas: Canvas, view: _View, k: int, state: int, belief: float) -> None:
        (x, y), side = view.corner(self.cells[k]), view.side
        goal, done = k in self.goals, self.done is not None and bool(self.done[state, k])
        ground = theme.blend(theme.GOAL, theme.FLOOR, 0.3) if goal else theme.FLOOR
        ground = theme.DONE if done else ground
        fill = theme.blend(theme.BELIEF, ground, belief**0.5)  # small chances still show
        canvas.rectangle((x, y), (side, side), fill, theme.LINE, width=1 if side > 12 else 0.5)
        if goal:
            _draw_flag(canvas, (x + 0.5 * side, y + 0.5 * side), 0.32 * side)
        if done:
            tick = [(0.72, 0.84), (0.79, 0.91), (0.91, 0.75)]
            canvas.line([(x + side * a, y + side * b) for a, b in tick], theme.INK, 0.03 * side)
        if label := self.labels.get(k):
            size = min(theme.SMALL, max(10.0, 0.2 * side))
            canvas.text((x + 4, y + 3), label, size, anchor="la", width=side - 6)

    def _standing(self, state: int) -> Iterator[tuple[Piece, int, float]]:
        """Yield pieces and their cells, and how far beside the middle, in sides of a cell."""
        places = [int(piece.places[state]) for piece in self.pieces]
        for k, (piece, cell) in enumerate(zip(self.pieces, places, strict=True)):
            if cell >= 0:
                sharing = places.count(cell)
                rank = places[:k].count(cell)
                yield piece, cell, 0.46 * (rank - (sharing - 1) / 2)

    def _mark(self, k: int, state: int) -> str:
        done = self.done is not None and bool(self.done[state, k])
        return "G" * (k in self.goals) + "x" * done

    def _keys(self, belief: bool) -> Iterator[Key]:
        for piece in self.pieces:
            if piece.kind != "box":  # a box bears its name
                shape = "diamond" if piece.kind == "opponent" else "circle"
                yield shape, piece.colour, piece.name
        if self.goals:
            yield "square", theme.blend(theme.GOAL, theme.FLOOR, 0.55), "goal"
        if self.done is not None:
            yield "square", theme.DONE, "finished"
        if belief:
            yield "square", theme.BELIEF, f"belief about the {self.pieces[self.believed].name}"


def _sign(piece: Piece, state: int) -> str:
    """Return the letter of a piece and an arrow where it faces."""
    if piece.headings is None:
        return piece.sign
    return piece.sign + "^>v<"[piece.headings[state]]


def _draw_flag(canvas: Canvas, centre: Point, size: float) -> None:
    x, y = centre
    pole = x - 0.45 * size
    canvas.line([(pole, y - size), (pole, y + size)], theme.GOAL, max(1.5, 0.1 * size))
    canvas.polygon([(pole, y - size), (pole + 1.3 * size, y - 0.5 * size), (pole, y)], theme.GOAL)


def _draw_piece(
    canvas: Canvas, view: _View, piece: Piece, cell: Cell, state: int, shift: float
) -> None:
    (x, y), side = view.corner(cell), view.side
    if piece.kind == "box":
        gap = 0.12 * side
        size = (piece.span * side - 2 * gap, side - 2 * gap)
        canvas.rectangle((x + gap, y + gap), size, piece.colour, theme.INK, 1.5, radius=4)
        words = (x + piece.span * side / 2, y + side / 2)
        canvas.text(words, piece.name, min(theme.TEXT, 0.2 * side), theme.PAPER, width=size[0])
        return
    centre = (x + (0.5 + shift) * side, y + 0.5 * side)
    radius = (0.2 if shift else 0.3) * side
    if piece.kind == "opponent":
        canvas.mark(centre, radius, "diamond", theme.PAPER)
        canvas.mark(centre, radius - 1.5, "diamond", piece.colour)
        return
    canvas.circle(centre, radius, piece.colour, theme.PAPER, max(1.0, 0.06 * radius))
    if piece.headings is not None:
        _draw_heading(canvas, centre, radius, int(piece.headings[state]))


def _draw_heading(canvas: Canvas, centre: Point, radius: float, heading: int) -> None:
    """Draw a pointer inside a round robot towards where it faces."""
    x, y = centre
    ahead, side = _STEP[heading], _STEP[(heading + 1) % 4]
    canvas.polygon(
        [
            (x + radius * (a * ahead[0] + s * side[0]), y + radius * (a * ahead[1] + s * side[1]))
            for a, s in ((0.8, 0.0), (-0.4, 0.55), (-0.1, 0.0), (-0.4, -0.55))
        ],
        theme.PAPER,
    )
