"""The figure of a reproduction: one pair of axes for each panel, means with bands over runs."""

from __future__ import annotations

import io
import zlib
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from baselines.curves import COLOURS, MARKERS, STYLES, dress, thousands
from baselines.reproduction import Comparison, Computation, Lines, Reproduction
from baselines.statistics import mean_band

INK, PAPER = "#1f2328", "#ffffff"
COLUMNS = 3
LARGEST = 1e12
"""Beyond, a diverging line is cut off at the top of the axes."""


def draw(reproduction: Reproduction, lines: Sequence[Lines]) -> bytes:
    """Return the picture (PNG).

    Args:
        reproduction: what the panels are called.
        lines: of each panel.
    """
    n = len(reproduction.panels)
    columns = min(n, COLUMNS)
    rows = -(-n // columns)
    figure = Figure(
        figsize=(1.5 + 4.6 * columns, 4.6 * rows), facecolor=PAPER, layout="constrained"
    )
    every = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in every[n:]:
        axes.set_visible(False)
    for axes, panel, found in zip(every, reproduction.panels, lines, strict=False):
        draw_panel(axes, panel, found)
    figure.suptitle(reproduction.title, color=INK, fontsize=13)
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=130, metadata={"Software": None})
    return picture.getvalue()


def draw_panel(axes: Axes, panel: Comparison | Computation, lines: Lines) -> None:
    """Draw the lines of a panel and its references."""
    for index, (label, (x, y)) in enumerate(lines.items()):
        colour = COLOURS[index % len(COLOURS)]
        seed = zlib.crc32(label.encode())
        mean, low, high = mean_band(np.clip(y, -LARGEST, LARGEST), seed=seed)
        axes.fill_between(x, low, high, color=colour, alpha=0.18, linewidth=0)
        axes.plot(
            x,
            mean,
            STYLES[index // len(COLOURS) % len(STYLES)],
            color=colour,
            label=label,
            linewidth=1.8,
            marker=MARKERS[index % len(MARKERS)],
            markersize=5,
            markevery=max(1, len(x) // 8),
        )
    for reference in panel.references:
        axes.axhline(reference.value, color=INK, linewidth=0.9, linestyle=(0, (1, 2)), alpha=0.75)
    dress(axes, INK, PAPER)
    axes.set_title(panel.title, color=INK, fontsize=11)
    if panel.logarithmic:
        axes.set_yscale("log")
    axes.set_ylabel(panel.y if isinstance(panel, Computation) else panel.measure.label)
    axes.set_xlabel(panel.x if isinstance(panel, Computation) else "environment steps of training")
    axes.xaxis.set_major_formatter(lambda value, _: thousands(value))
    if lines:
        axes.legend(frameon=False, fontsize=8, labelcolor=INK)
