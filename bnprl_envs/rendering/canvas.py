"""A drawing surface in pixels: Pillow, smoothed by drawing at twice the size."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from bnprl_envs.rendering import theme

if TYPE_CHECKING:
    from bnprl_envs.rendering.scene import Moment

Point = tuple[float, float]
Key = tuple[str, str, str]
"""Of the legend: a shape ("circle", "diamond" or "square"), its colour, and a word."""

_SCALE = 2  # of what is drawn, before it is reduced; text is drawn last and needs no smoothing


class Canvas:
    """A picture in the making. Coordinates are pixels from the upper left corner.

    Args:
        shape: height and width, and anything after them.
    """

    def __init__(self, shape: tuple[int, ...] = theme.FRAME_SHAPE) -> None:
        self.height, self.width = shape[:2]
        size = (_SCALE * self.width, _SCALE * self.height)
        self._image = Image.new("RGB", size, theme.PAPER)
        self._draw = ImageDraw.Draw(self._image)
        self._texts: list[tuple[Point, str, float, str, str]] = []

    def rectangle(
        self,
        corner: Point,
        size: Point,
        fill: str | None,
        outline: str | None = None,
        width: float = 1.0,
        radius: float = 0.0,
    ) -> None:
        """Draw a rectangle from its upper left corner and its size."""
        x, y = corner
        box = _scaled([corner, (x + size[0], y + size[1])])
        edge = round(_SCALE * width) if outline else 0
        self._draw.rounded_rectangle(box, _SCALE * radius, fill, outline, edge)

    def circle(
        self,
        centre: Point,
        radius: float,
        fill: str | None,
        outline: str | None = None,
        width: float = 1.0,
    ) -> None:
        """Draw a circle."""
        x, y = centre
        box = _scaled([(x - radius, y - radius), (x + radius, y + radius)])
        self._draw.ellipse(box, fill, outline, round(_SCALE * width) if outline else 0)

    def polygon(self, points: Iterable[Point], fill: str, outline: str | None = None) -> None:
        """Draw a filled polygon."""
        corners = _scaled(points)
        self._draw.polygon(corners, fill)
        if outline is not None:
            self._draw.line([*corners, corners[0]], outline, _SCALE, joint="curve")

    def line(self, points: Iterable[Point], colour: str, width: float = 1.0) -> None:
        """Draw a line through points, with round ends."""
        corners = _scaled(points)
        self._draw.line(corners, colour, round(_SCALE * width), joint="curve")
        if width > 2:
            for x, y in (corners[0], corners[-1]):
                r = _SCALE * width / 2 - 0.5
                self._draw.ellipse([(x - r, y - r), (x + r, y + r)], colour)

    def arrow(
        self,
        start: Point,
        end: Point,
        colour: str,
        width: float = 2.0,
        bend: float = 0.0,
        dashed: bool = False,
    ) -> None:
        """Draw an arrow; `bend` moves its middle to the left by so much of its length."""
        (x0, y0), (x1, y1) = start, end
        middle = ((x0 + x1) / 2 + bend * (y1 - y0), (y0 + y1) / 2 - bend * (x1 - x0))
        control = (2 * middle[0] - (x0 + x1) / 2, 2 * middle[1] - (y0 + y1) / 2)
        head = np.array([x1 - control[0], y1 - control[1]])
        head = head / max(float(np.hypot(*head)), 1e-9) * (4.0 + 2.5 * width)
        base = np.array(end) - head
        t = np.linspace(0.0, 1.0, 25)[:, None]
        points = (1 - t) ** 2 * start + 2 * t * (1 - t) * np.array(control) + t**2 * base
        curve = [_point(point) for point in points]
        if dashed:
            for k in range(0, 25, 3):
                self.line(curve[k : k + 3], colour, width)
        else:
            self.line(curve if bend else [curve[0], curve[-1]], colour, width)
        side = np.array([-head[1], head[0]]) / 2
        self.polygon([end, _point(base + side), _point(base - side)], colour)

    def text(
        self,
        place: Point,
        words: str,
        size: float = theme.TEXT,
        colour: str = theme.INK,
        anchor: str = "mm",
        width: float | None = None,
    ) -> None:
        """Write words, above everything that is drawn.

        Args:
            place: of the anchor.
            words: one line.
            size: of the font, in pixels.
            colour: of the words.
            anchor: Pillow's two letters: l, m, r horizontally; t (a), m, b (d) vertically.
            width: pixels; longer words are cut and end in three dots.
        """
        if width is not None and _font(size).getlength(words) > width:
            while words and _font(size).getlength(words + "...") > width:
                words = words[:-1]
            words += "..."
        self._texts.append((place, words, size, colour, anchor))

    def image(self, pixels: npt.NDArray[np.uint8], corner: Point, size: Point) -> None:
        """Draw an array (rows, columns, 3), each entry as a rectangle."""
        width, height = round(_SCALE * size[0]), round(_SCALE * size[1])
        picture = Image.fromarray(pixels).resize((width, height), Image.Resampling.NEAREST)
        self._image.paste(picture, (round(_SCALE * corner[0]), round(_SCALE * corner[1])))

    def legend(self, keys: Sequence[Key]) -> None:
        """Say above the scene what shapes and colours mean."""
        x, y = theme.SCENE_BOX[0], theme.LEGEND_HEIGHT / 2
        for shape, colour, words in keys:
            self.mark((x + 7, y), 7, shape, colour)
            self.text((x + 20, y), words, theme.SMALL, anchor="lm")
            x += 40 + _font(theme.SMALL).getlength(words)

    def mark(self, centre: Point, radius: float, shape: str, colour: str) -> None:
        """Draw a small shape: a circle, a diamond or a square."""
        x, y = centre
        if shape == "circle":
            self.circle(centre, radius, colour)
        elif shape == "diamond":
            r = 1.15 * radius
            self.polygon([(x, y - r), (x + r, y), (x, y + r), (x - r, y)], colour)
        else:
            self.rectangle((x - radius, y - radius), (2 * radius, 2 * radius), colour, radius=2)

    def status(self, moment: Moment) -> None:
        """Write below the scene the step, the reward, and what the agents did and saw."""
        from bnprl_envs.rendering.scene import reward_text

        top, width = self.height - theme.STATUS_HEIGHT, self.width
        self.rectangle((0, top), (width, theme.STATUS_HEIGHT), theme.PANEL)
        self.rectangle((0, top), (width, 1), theme.LINE)
        left = theme.SCENE_BOX[0]
        self.text((left, top + 19), f"step {moment.step}", anchor="lm")
        self.text((left + 110, top + 19), f"reward {reward_text(moment)}", anchor="lm")
        hidden = len(moment.doings) - theme.STATUS_AGENTS
        if hidden > 0:
            words = f"and {hidden} more agent{'s' * (hidden > 1)}"
            self.text((width - 10, top + 19), words, colour=theme.FAINT, anchor="rm")
        for row, doing in enumerate(moment.doings[: theme.STATUS_AGENTS]):
            y = top + 46 + 24 * row
            self.text((left, y), doing.agent, colour=theme.FAINT, anchor="lm", width=105)
            for x, label, words in ((110, "action", doing.action), (360, "saw", doing.observation)):
                self.text((left + x, y), label, colour=theme.FAINT, anchor="lm")
                start = left + x + 8 + _font(theme.TEXT).getlength(label)
                end = left + 352 if label == "action" else width - 10
                self.text((start, y), words, anchor="lm", width=end - start)

    def array(self) -> npt.NDArray[np.uint8]:
        """Return the finished picture (height, width, 3)."""
        picture = self._image.reduce(_SCALE)
        draw = ImageDraw.Draw(picture)
        for place, words, size, colour, anchor in self._texts:
            draw.text(place, words, colour, _font(size), anchor)
        return np.asarray(picture).copy()


@lru_cache(maxsize=32)
def _font(size: float) -> ImageFont.FreeTypeFont:
    font = ImageFont.load_default(size)
    if not isinstance(font, ImageFont.FreeTypeFont):
        raise ImportError("Pillow was built without FreeType, which writes the words in pictures")
    return font


def _scaled(points: Iterable[Point]) -> list[Point]:
    return [(_SCALE * x, _SCALE * y) for x, y in points]


def _point(array: npt.NDArray[np.float64]) -> Point:
    return float(array[0]), float(array[1])
