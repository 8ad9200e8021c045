"""The tables of a reproduction, from its summary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from baselines.report import DASH, markdown_table, name_failures, number

Row = Mapping[str, Any]


def cells(rows: Sequence[Row], x: str) -> list[list[str]]:
    """Return the cells of a panel's table, header first, as people read them."""
    header = ["agent", "mean", "95% interval", "median", "seeds", x]
    return [header, *(_cells(row) for row in rows)]


def _cells(row: Row) -> list[str]:
    low, high = _short(row["ci_low"]), _short(row["ci_high"])
    reference = row["source"] is not None
    return [
        f"{row['agent']} (reference)" if reference else row["agent"],
        _short(row["mean"]),
        DASH if row["ci_low"] is None else f"{low} to {high}",
        DASH if reference else _short(row["median"]),
        DASH if reference else number(row["seeds"], ",.0f"),
        number(row["x"], ",.0f"),
    ]


def side_by_side(tables: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    """Return all panels in one table: a row each, first the contenders, then the references."""
    of_panel = [{row["agent"]: row for row in panel["rows"]} for panel in tables]
    every = [row for panel in tables for row in panel["rows"]]
    ours = [row["agent"] for row in every if row["source"] is None]
    known = [row["agent"] for row in every if row["source"] is not None]
    columns = list(dict.fromkeys(ours + known))
    body = [
        [panel["title"], *(_value(rows.get(column)) for column in columns)]
        for panel, rows in zip(tables, of_panel, strict=True)
    ]
    return [["", *columns], *body]


def _value(row: Row | None) -> str:
    """Return a mean with half the width of its interval, as far as there are any."""
    if row is None:
        return DASH
    if row["ci_low"] is None:
        return _short(row["mean"])
    return f"{_short(row['mean'])} ± {_short((row['ci_high'] - row['ci_low']) / 2, 2)}"


def _short(value: float | None, digits: int = 4) -> str:
    """Return a number in so many digits, a large one whole."""
    large = value is not None and abs(value) >= min(1000.0, 10.0**digits - 0.5)
    return number(value, ",.0f" if large else f".{digits}g")


def markdown(summary: Mapping[str, Any]) -> str:
    """Return the whole as Markdown."""
    size = " (quick size: far fewer seeds and steps than the notes speak of)" * summary["quick"]
    text = [f"# {summary['title']}{size}", "", "![figure](figure.png)", ""]
    if summary["failed_runs"]:
        text += [f"Runs that {name_failures(summary['failed_runs'])}.", ""]
    if summary["shape"] == "table":
        text += [markdown_table(side_by_side(summary["panels"])), ""]
    for panel in summary["panels"]:
        rows = markdown_table(cells(panel["rows"], panel["x"]))
        text += [f"## {panel['title']}: {panel['measure']}", "", rows, ""]
    return "\n".join([*text, *(f"{note}\n" for note in summary["notes"])])
