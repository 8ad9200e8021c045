"""What `bnprl watch` puts beside an environment's picture, and how it becomes a GIF."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from baselines.files import write_atomic
from bnprl_envs.rendering import theme
from bnprl_envs.rendering.canvas import Canvas
from bnprl_envs.tables import FloatArray

Frame = npt.NDArray[np.uint8]

_WIDTH = 200
_COLOURS = 128


def beside(picture: Frame, episode: int, value: float, nodes: Sequence[FloatArray]) -> Frame:
    """Return a picture with a strip at its right: the return so far and the controllers' nodes.

    Args:
        picture: (height, width, 3).
        episode: which, from 1.
        value: discounted return so far.
        nodes: (Z,) node distribution of each agent.

    Returns:
        (height, width + 200, 3).
    """
    canvas = Canvas((picture.shape[0], _WIDTH))
    canvas.rectangle((0, 0), (_WIDTH, picture.shape[0]), theme.PANEL)
    canvas.rectangle((0, 0), (1, picture.shape[0]), theme.LINE)
    canvas.text((16, 20), f"episode {episode}", anchor="lm")
    canvas.text((16, 46), "discounted return", theme.SMALL, theme.FAINT, anchor="lm")
    canvas.text((16, 72), f"{value:.3f}", theme.LARGE, anchor="lm")
    room = (picture.shape[0] - 100) / max(len(nodes), 1)
    for n, distribution in enumerate(nodes):
        _draw_nodes(canvas, 100 + n * room, room, n, distribution)
    return np.concatenate([picture, canvas.array()], axis=1)


def beside_as_text(episode: int, value: float, nodes: Sequence[FloatArray]) -> str:
    """Return the same as lines of text."""
    lines = [f"episode {episode}   discounted return {value:.3f}"]
    for n, distribution in enumerate(nodes):
        shown = ", ".join(f"{z} {distribution[z]:.2f}" for z in _likely(distribution)[:4])
        lines.append(f"nodes of agent_{n}: {shown}")
    return "\n".join(lines)


def write_gif(path: Path, frames: Iterable[tuple[Frame, int]]) -> int:
    """Write an animation, which appears by rename.

    Args:
        path: of the file.
        frames: pictures of one shape, and how long each is shown, ms.

    Returns:
        The number of frames.

    Raises:
        OSError: the file cannot be written.
    """
    images, durations = [], []
    for frame, duration in frames:
        images.append(Image.fromarray(frame).quantize(_COLOURS, Image.Quantize.MAXCOVERAGE))
        durations.append(duration)
    data = io.BytesIO()
    images[0].save(
        data,
        "GIF",
        save_all=True,
        append_images=images[1:],
        duration=durations,
        loop=0,
    )
    write_atomic(path, data.getvalue())
    return len(images)


def _draw_nodes(
    canvas: Canvas, top: float, room: float, agent: int, distribution: FloatArray
) -> None:
    likely = _likely(distribution)[: int((room - 34) // 16)]  # as many as there is room for
    canvas.text((16, top + 8), f"nodes of agent_{agent}", theme.SMALL, theme.FAINT, anchor="lm")
    for row, node in enumerate(sorted(likely)):
        y = top + 26 + 16 * row
        canvas.text((34, y + 6), str(node), 12.0, anchor="rm")
        canvas.rectangle((40, y), (_WIDTH - 56, 12), theme.PAPER)
        width = (_WIDTH - 56) * float(distribution[node])
        if width >= 1:
            canvas.rectangle((40, y), (width, 12), theme.agent_colour(agent))


def _likely(distribution: FloatArray) -> list[int]:
    """Return the nodes, the most probable first."""
    order: list[int] = np.argsort(-distribution, kind="stable").tolist()
    return order
