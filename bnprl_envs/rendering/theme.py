"""The one table of colours and sizes that every picture uses.

The strong colours are those of Okabe and Ito (2008), which people with any common colour vision
tell apart; what they mean is always said by a shape or a word too.
"""

from __future__ import annotations

FRAME_SHAPE = (480, 640, 3)
"""Height, width and channels of every frame."""
LEGEND_HEIGHT = 34
STATUS_HEIGHT = 92
STATUS_AGENTS = 2
"""Agents that the status has lines for."""
SCENE_BOX = (20.0, 36.0, 620.0, 378.0)
"""Left, top, right and bottom of the room for the scene, in pixels."""

PAPER = "#ffffff"
INK = "#222222"
FAINT = "#6b6f76"
LINE = "#b9bdc4"
DONE = "#d9dbe0"
PANEL = "#f1f2f4"
WALL = "#4a4e57"
FLOOR = "#fafaf7"

GOAL = "#009e73"
DANGER = "#d55e00"
BELIEF = "#cc79a7"
WATER = "#56b4e9"
BOX = "#8c6a00"
AGENTS = ("#0072b2", "#e69f00")
"""By turns, the first agent first."""

TEXT = 15.0
SMALL = 13.0
LARGE = 22.0


def agent_colour(index: int) -> str:
    """Return the colour of an agent."""
    return AGENTS[index % len(AGENTS)]


def blend(colour: str, ground: str, share: float) -> str:
    """Return the colour that `share` (0 to 1) of `colour` over `ground` makes."""
    pairs = zip(_channels(colour), _channels(ground), strict=True)
    return "#" + "".join(f"{round(share * c + (1 - share) * g):02x}" for c, g in pairs)


def _channels(colour: str) -> tuple[int, ...]:
    return tuple(bytes.fromhex(colour[1:]))
