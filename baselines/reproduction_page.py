"""The page of reproductions: of each table or figure its picture, its numbers and what to know."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from baselines import web_page
from baselines.report import name_failures
from baselines.reproduction_tables import cells, side_by_side
from baselines.statistics import FEW


def page(title: str, summaries: Mapping[Path, Mapping[str, Any]]) -> str:
    """Return the page as HTML.

    Args:
        title: its heading.
        summaries: folder of a reproduction, where its figure is -> what its summary.json says.
    """
    sections = [
        _section(folder, summary, headed=len(summaries) > 1)
        for folder, summary in summaries.items()
    ]
    listing = "".join(
        f'<li><a href="#{escape(summary["experiment"])}">{escape(summary["title"])}</a></li>'
        for summary in summaries.values()
    )
    contents = f"<ul>{listing}</ul>\n" if len(summaries) > 1 else ""
    return web_page.document(title, contents + "\n".join(sections))


def _section(folder: Path, summary: Mapping[str, Any], *, headed: bool) -> str:
    name = escape(summary["experiment"])
    title = escape(summary["title"])
    heading = f"<h2>{title}</h2>" if headed else ""
    size = (
        "<p>Quick size: far fewer seeds and steps than the notes speak of.</p>"
        if summary["quick"]
        else ""
    )
    failed = (
        f"<p>Runs that {escape(name_failures(summary['failed_runs']))}.</p>"
        if summary["failed_runs"]
        else ""
    )
    picture = web_page.picture(
        (folder / "figure.png").read_bytes(),
        (folder / "figure-dark.png").read_bytes(),
        f"{summary['title']}; its numbers are in the tables",
    )
    notes = "\n".join(f"<p>{web_page.prose(note)}</p>" for note in summary["notes"])
    return f"""<section id="{name}">
{heading}{size}{failed}
{picture}
{notes}
{_tables(name, summary)}
<p class="faint">Italic: numbers of the source and of the registry. Intervals are of 95%
over seeds, Student's where they are fewer than {FEW}, else the bootstrap's.</p>
<pre>{escape(summary["command"])}</pre>
</section>"""


def _tables(name: str, summary: Mapping[str, Any]) -> str:
    """Return one table of everything where that is the shape, and each panel's below it."""
    panels: Sequence[Mapping[str, Any]] = summary["panels"]
    found = []
    if summary["shape"] == "table":
        found.append(web_page.table(f"{name}-all", side_by_side(panels)))
    for panel in panels:
        flags = [row["source"] is not None for row in panel["rows"]]
        table = web_page.table(f"{name}-{panel['name']}", cells(panel["rows"], panel["x"]), flags)
        heading = f"{escape(panel['title'])}: {escape(panel['measure'])}"
        found.append(f"<details><summary>{heading}</summary>{table}</details>")
    return "\n".join(found)
