"""The figure of a reproduction: one pair of axes for each panel, means with bands over runs."""

from __future__ import annotations

import io
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogLocator, NullFormatter, SymmetricalLogLocator

from baselines.curves import COLOURS, MARKERS, STYLES, Ground, dress, plain, thousands
from baselines.reproduction import Comparison, Computation, Lines, Reproduction
from baselines.statistics import mean_band

X_LABELS = {"steps": "environment steps of training", "episodes": "episodes of training"}
LARGEST = 1e12
"""Beyond, a diverging line is cut off at the top of the axes."""
WIDE_RANGE = 100.0
"""Ratio of the means beside each other from which their axis is logarithmic."""
LINEAR = 10.0
"""Up to which a logarithmic axis is linear, if some numbers are negative."""


def draw(
    reproduction: Reproduction,
    lines: Sequence[Lines],
    tables: Sequence[Mapping[str, Any]],
    ground: Ground,
) -> bytes:
    """Return the picture (PNG) of curves.

    Args:
        reproduction: what the panels are called.
        lines: of each panel.
        tables: of each panel its rows, whose references are drawn where they are near the curves.
        ground: what it is drawn on.
    """
    n = len(reproduction.panels)
    columns = min(n, reproduction.columns)
    rows = -(-n // columns)
    width = 1.5 + 4.6 * columns
    figure = Figure(figsize=(width, 4.6 * rows), facecolor=ground.paper, layout="constrained")
    every = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in every[n:]:
        axes.set_visible(False)
    labels = list(dict.fromkeys(label for found in lines for label in found))
    handles: dict[str, Any] = {}
    for axes, panel, found, table in zip(every, reproduction.panels, lines, tables, strict=False):
        handles |= draw_panel(axes, panel, found, labels, ground)
        known = [row for row in table["rows"] if row["source"] is not None]
        draw_references(axes, known, ground)
    figure.legend(
        handles.values(),
        [plain(label) for label in handles],
        loc="outside lower center",
        ncols=max(1, min(4, len(handles), int(width / _legend_width(labels)))),
        frameon=False,
        labelcolor=ground.ink,
        handlelength=3.0,
    )
    figure.suptitle(plain(reproduction.title), color=ground.ink, fontsize=13)
    return _png(figure)


def _legend_width(labels: Sequence[str]) -> float:
    """Inches that a column of a legend of these labels takes."""
    return 1.0 + 0.09 * max(map(len, labels), default=0)


def draw_references(axes: Axes, rows: Sequence[Mapping[str, Any]], ground: Ground) -> None:
    """Draw horizontal lines with their names, those far from the curves left out.

    Lines too close for a name each have theirs together above the highest.
    """
    low, high = axes.get_ylim()
    room = 0.5 * (high - low)
    named: dict[float, str] = {}
    for row in sorted(rows, key=lambda row: float(row["mean"])):
        value = float(row["mean"])
        if low - room <= value <= high + room and (value > 0.0 or axes.get_yscale() != "log"):
            axes.axhline(value, color=ground.ink, linewidth=0.9, linestyle=(0, (1, 2)), alpha=0.75)
            near = max(named, default=-np.inf)
            together = [named.pop(near)] if value - near < 0.045 * (high - low) else []
            named[value] = ", ".join([*together, row["agent"]])
    for value, text in named.items():
        axes.annotate(
            plain(text),
            (0.005, value),
            xycoords=("axes fraction", "data"),
            va="bottom",
            fontsize=6.5,
            color=ground.ink,
            path_effects=[withStroke(linewidth=2.0, foreground=ground.paper)],
        )


def draw_table(
    reproduction: Reproduction, tables: Sequence[Mapping[str, Any]], ground: Ground
) -> bytes:
    """Return the picture (PNG) of last values side by side, references below contenders.

    Args:
        reproduction: what the whole is called.
        tables: of each panel its title, its measure and its rows.
        ground: what it is drawn on.
    """
    every_row = [row for panel in tables for row in panel["rows"]]
    labels = list(dict.fromkeys(row["agent"] for row in every_row if row["source"] is None))
    tallest = max(len(panel["rows"]) for panel in tables)
    columns = min(len(tables), reproduction.columns)
    rows = -(-len(tables) // columns)
    figure = Figure(
        figsize=(5.2 * columns, rows * (1.3 + 0.27 * tallest)),
        facecolor=ground.paper,
        layout="constrained",
    )
    every = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes in every[len(tables) :]:
        axes.set_visible(False)
    for axes, panel in zip(every, tables, strict=False):
        _draw_values(axes, panel["rows"], labels, ground)
        axes.set_title(plain(panel["title"]), color=ground.ink, fontsize=11)
        axes.set_xlabel(plain(panel["measure"]))
    figure.suptitle(plain(reproduction.title), color=ground.ink, fontsize=13)
    return _png(figure)


def _draw_values(
    axes: Axes, rows: Sequence[Mapping[str, Any]], labels: Sequence[str], ground: Ground
) -> None:
    """Draw one mean a line with its interval, coloured by its label; references are hollow."""
    for y, row in enumerate(rows):
        known = row["source"] is not None
        colour = ground.ink if known else COLOURS[labels.index(row["agent"]) % len(COLOURS)]
        if row["ci_low"] is not None:
            axes.plot([row["ci_low"], row["ci_high"]], [y, y], color=colour, linewidth=2.5)
        axes.plot(
            row["mean"],
            y,
            "D" if known else "o",
            color=colour,
            markerfacecolor=ground.paper if known else colour,
            markersize=6,
        )
    dress(axes, ground)
    means = [row["mean"] for row in rows]
    if min(means) > 0.0 and max(means) > WIDE_RANGE * min(means):
        axes.set_xscale("log", nonpositive="clip")
    else:
        axes.locator_params(axis="x", nbins=6)
    axes.xaxis.set_major_formatter(lambda value, _: thousands(value))
    names = [plain(row["agent"]) for row in rows]
    axes.set_yticks(range(len(rows)), names, fontsize=8, color=ground.ink)
    axes.set_ylim(len(rows) - 0.4, -0.6)


def _png(figure: Figure) -> bytes:
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=130, metadata={"Software": None})
    return picture.getvalue()


def draw_panel(
    axes: Axes,
    panel: Comparison | Computation,
    lines: Lines,
    labels: Sequence[str],
    ground: Ground,
) -> dict[str, Any]:
    """Draw the lines of a panel, each as its place among the labels of all panels says.

    Returns:
        Label -> what a legend shows of it.
    """
    handles = {}
    for label, (x, y) in lines.items():
        index = labels.index(label)
        colour = COLOURS[index % len(COLOURS)]
        seed = zlib.crc32(label.encode())
        mean, low, high = mean_band(np.clip(y, -LARGEST, LARGEST), seed=seed)
        if len(x) == 1:
            axes.errorbar(x, mean, [mean - low, high - mean], color=colour, capsize=4)
        axes.fill_between(x, low, high, color=colour, alpha=0.18, linewidth=0)
        (handles[label],) = axes.plot(
            x,
            mean,
            STYLES[index // len(COLOURS) % len(STYLES)],
            color=colour,
            linewidth=1.8,
            marker=MARKERS[index % len(MARKERS)],
            markersize=5,
            markevery=max(1, len(x) // 8),
        )
    dress(axes, ground)
    axes.set_title(plain(panel.title), color=ground.ink, fontsize=11)
    if panel.logarithmic:
        _logarithmic_upwards(axes, min((float(y.min()) for _, y in lines.values()), default=1.0))
    axes.set_ylabel(panel.y if isinstance(panel, Computation) else panel.measure.label)
    axes.set_xlabel(panel.x if isinstance(panel, Computation) else X_LABELS[panel.x])
    if isinstance(panel, Comparison) and panel.logarithmic_x:
        _logarithmic_across(axes)
    axes.xaxis.set_major_formatter(lambda value, _: thousands(value))
    return handles


def _logarithmic_upwards(axes: Axes, smallest: float) -> None:
    """Make the vertical axis logarithmic; below 0 so too, linear only where numbers are small."""
    if smallest >= 0.0:
        axes.set_yscale("log")
        return
    axes.set_yscale("symlog", linthresh=LINEAR)
    axes.yaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=LINEAR, subs=(1, 2, 5)))
    axes.yaxis.set_major_formatter(lambda value, _: thousands(value).replace("-", "\N{MINUS SIGN}"))


def _logarithmic_across(axes: Axes) -> None:
    """Make the horizontal axis logarithmic, with labels between powers of ten if it is short."""
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    few = high < 500.0 * low
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if few else (1.0,)))
    axes.xaxis.set_minor_formatter(NullFormatter())
