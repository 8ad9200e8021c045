"""The shell of every page: self-contained, for phone and desk, light and dark, tables that sort."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Mapping, Sequence
from html import escape
from string import Template
from typing import Any

_PAGE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>$title</title>
<style>
:root { --ink: #1f2328; --faint: #59636e; --paper: #ffffff; --panel: #f6f8fa; --line: #d1d9e0;
  --accent: #0072b2; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e6e6e6; --faint: #9aa4ae; --paper: #16181c; --panel: #1f2329; --line: #3a4048;
    --accent: #56b4e9; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 66rem; padding: 1.5rem 1rem 4rem; color: var(--ink);
  background: var(--paper); font: 16px/1.5 system-ui, sans-serif; }
h1 { font-size: 1.6rem; margin: 0 0 .5rem; overflow-wrap: anywhere; }
h2 { font-size: 1.15rem; margin: 2.2rem 0 .6rem; }
p { margin: 0 0 1rem; max-width: 46rem; }
p.faint, .reference td { color: var(--faint); }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { padding: .4rem .7rem; text-align: right; white-space: nowrap;
  border-bottom: 1px solid var(--line); }
th:first-child, td:first-child { text-align: left; }
thead button { all: unset; cursor: pointer; font-weight: 600; }
thead button:hover, thead button:focus-visible { color: var(--accent);
  text-decoration: underline; }
tr.reference td { font-style: italic; }
.wide img { min-width: 42rem; margin-bottom: .8rem; }
img { width: 100%; height: auto; display: block; border-radius: 6px; }
pre { background: var(--panel); border: 1px solid var(--line); border-radius: 6px;
  padding: .8rem 1rem; overflow-x: auto; font-size: .875rem; }
code { background: var(--panel); font-size: .9em; overflow-wrap: anywhere; }
details { border: 1px solid var(--line); border-radius: 6px; margin: 0 0 .6rem;
  padding: .5rem .9rem; background: var(--panel); }
summary { cursor: pointer; font-weight: 600; }
dl { display: grid; grid-template-columns: minmax(8rem, max-content) 1fr; gap: .2rem 1.2rem;
  margin: .6rem 0 .3rem; font-size: .92rem; }
dt { color: var(--faint); } dd { margin: 0; overflow-wrap: anywhere; }
</style>
</head>
<body>
<h1>$title</h1>
$body
<script>
document.querySelectorAll("table").forEach(table => {
  const body = table.tBodies[0];
  table.querySelectorAll("thead button").forEach((button, column) => {
    let falling = false;
    const value = row => {
      const text = row.cells[column].textContent.replace(/,/g, "").replace(/\u2212/g, "-");
      const number = parseFloat(text);
      return Number.isNaN(number) ? text : number;
    };
    button.addEventListener("click", () => {
      falling = !falling;
      [...body.rows].sort((one, two) => {
        const a = value(one), b = value(two);
        if (typeof a !== typeof b) return typeof a === "number" ? -1 : 1;
        return (a < b ? -1 : a > b ? 1 : 0) * (falling ? -1 : 1);
      }).forEach(row => body.append(row));
    });
  });
});
</script>
</body>
</html>
""")


def document(title: str, body: str) -> str:
    """Return a page.

    Args:
        title: as text; also its heading.
        body: as HTML.
    """
    return _PAGE.substitute(title=escape(title), body=body)


def table(
    name: str, cells: Sequence[Sequence[str]], references: Sequence[bool] | None = None
) -> str:
    """Return a table that is sorted by the column whose header is clicked.

    Args:
        name: its id, unique in the page.
        cells: header, then rows, as text.
        references: of each row whether it is not of this experiment.
    """
    header, *rows = cells
    head = "".join(f'<th scope="col"><button>{escape(cell)}</button></th>' for cell in header)
    flags = references or [False] * len(rows)
    body = "\n".join(_row(row, flag) for row, flag in zip(rows, flags, strict=True))
    return (
        f'<div class="scroll"><table id="{escape(name)}"><thead><tr>{head}</tr></thead>\n'
        f"<tbody>\n{body}\n</tbody></table></div>"
    )


def _row(cells: Sequence[str], reference: bool) -> str:
    kind = ' class="reference"' if reference else ""
    return f"<tr{kind}>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>"


def prose(text: str) -> str:
    """Return text as HTML, with code where it has that between backticks."""
    return re.sub("`([^`]+)`", r"<code>\1</code>", escape(text))


def picture(light: bytes, dark: bytes, alternative: str) -> str:
    """Return a picture that is part of the page, scrolled sideways where the page is narrow.

    Args:
        light: the picture (PNG) on a light ground.
        dark: the same on a dark one.
        alternative: says in words what it shows.
    """
    return (
        '<div class="scroll wide"><picture>'
        f'<source media="(prefers-color-scheme: dark)" srcset="{_data(dark)}">\n'
        f'<img src="{_data(light)}" alt="{escape(alternative)}"></picture></div>'
    )


def _data(picture: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(picture).decode()}"


def definitions(pairs: Mapping[str, Any]) -> str:
    """Return names with their values as a list of definitions."""
    terms = (
        f"<dt>{escape(str(name))}</dt><dd>{escape(_text(value))}</dd>"
        for name, value in pairs.items()
    )
    return f"<dl>{''.join(terms)}</dl>"


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
