"""The self-contained page of an experiment: no file beside it, no request to anywhere."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from html import escape
from string import Template
from typing import Any

from baselines.experiment import Entry
from baselines.report import caption, pair_table, table
from baselines.study import Study

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
img { width: 100%; height: auto; display: block; border-radius: 6px; }
pre { background: var(--panel); border: 1px solid var(--line); border-radius: 6px;
  padding: .8rem 1rem; overflow-x: auto; font-size: .875rem; }
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
<p>$caption</p>
<div class="scroll"><table id="results">
<thead><tr>$header</tr></thead>
<tbody>
$rows
</tbody>
</table></div>
$pairs
<h2>Learning curves</h2>
<picture><source media="(prefers-color-scheme: dark)" srcset="$dark">
<img src="$light" alt="Learning curves over environment steps and over seconds: $alternative">
</picture>
<p class="faint">Bands are pointwise 95% intervals over seeds. Seconds count training, not
evaluation; a run that has spent its budget keeps its final value until the slowest has. Dotted
lines are reference values.</p>
<h2>Budget and evaluation</h2>
<dl>$budget</dl>
<h2>Settings</h2>
$settings
$sources
<h2>Versions</h2>
<dl>$versions</dl>
<h2>The command that remakes this page</h2>
<pre>$commands</pre>
<script>
document.querySelectorAll("#results thead button").forEach((button, column) => {
  let falling = false;
  button.addEventListener("click", () => {
    const body = document.querySelector("#results tbody");
    const value = row => {
      const text = row.cells[column].textContent.replace(/,/g, "").replace(/\u2212/g, "-");
      const number = parseFloat(text);
      return Number.isNaN(number) ? text : number;
    };
    falling = !falling;
    [...body.rows].sort((one, two) => {
      const a = value(one), b = value(two);
      if (typeof a !== typeof b) return typeof a === "number" ? -1 : 1;
      return (a < b ? -1 : a > b ? 1 : 0) * (falling ? -1 : 1);
    }).forEach(row => body.append(row));
  });
});
</script>
</body>
</html>
""")


def page(study: Study, summary: Mapping[str, Any], light: bytes, dark: bytes) -> str:
    """Return the page as HTML.

    Args:
        study: the experiment with its versions and commands.
        summary: its table.
        light: the curves (PNG) on a light ground.
        dark: the same on a dark one.
    """
    header, *rows = table(summary)
    flags = [row["reference"] for row in summary["rows"]]
    return _PAGE.substitute(
        title=escape(f"{summary['env']}: {', '.join(e.name for e in study.experiment.entries)}"),
        caption=escape(caption(summary)),
        header="".join(f'<th scope="col"><button>{escape(cell)}</button></th>' for cell in header),
        rows="\n".join(_row(cells, flag) for cells, flag in zip(rows, flags, strict=True)),
        pairs=_pairs(summary),
        light=_data(light),
        dark=_data(dark),
        alternative=escape("; ".join(f"{cells[0]} ends at {cells[1]}" for cells in rows)),
        budget=_definitions(_budget(study) | _used(summary)),
        settings="\n".join(_settings(entry) for entry in study.experiment.entries),
        sources=_sources(summary),
        versions=_definitions(study.versions),
        commands=escape("\n".join(study.commands)),
    )


def _pairs(summary: Mapping[str, Any]) -> str:
    """Return the table of who beats whom, nothing where there is one contender."""
    header, *rows = pair_table(summary["pairs"])
    if not rows:
        return ""
    head = "".join(f'<th scope="col">{escape(cell)}</th>' for cell in header)
    body = "\n".join(_row(cells, False) for cells in rows)
    return (
        "<details><summary>Head to head</summary>\n<p>Means over runs, the probability that a run "
        "of the one beats a run of the other, and a two-sided permutation test corrected for the "
        f'number of pairs.</p>\n<div class="scroll"><table id="pairs"><thead><tr>{head}</tr>'
        f"</thead>\n<tbody>\n{body}\n</tbody></table></div></details>"
    )


def _row(cells: list[str], reference: bool) -> str:
    kind = ' class="reference"' if reference else ""
    return f"<tr{kind}>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>"


def _data(picture: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(picture).decode()}"


def _definitions(pairs: Mapping[str, Any]) -> str:
    return "".join(
        f"<dt>{escape(str(name))}</dt><dd>{escape(_text(value))}</dd>"
        for name, value in pairs.items()
    )


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _budget(study: Study) -> dict[str, Any]:
    experiment = study.experiment
    return {
        "environment": experiment.environment.id,
        **experiment.environment.kwargs,
        f"training {experiment.unit} per run": f"{experiment.budget:,}",
        "seeds per agent": experiment.seeds,
        "root seed": experiment.root_seed,
        "evaluations per run": experiment.eval_points,
        "episodes per evaluation": f"{experiment.eval_episodes:,}",
    }


def _used(summary: Mapping[str, Any]) -> dict[str, str]:
    """Return how much of the budget each contender used, the mean over its seeds."""
    (unit, budget), *_ = summary["budget"].items()
    return {
        f"{unit} used by {row['agent']}": f"{row[unit]:,.0f} ({row[unit] / budget:.1%})"
        for row in summary["rows"]
        if row[unit] is not None
    }


def _settings(entry: Entry) -> str:
    learner = "" if entry.name == entry.contender else f" ({entry.contender})"
    body = f"<dl>{_definitions(entry.settings)}</dl>" if entry.settings else "<p>No settings.</p>"
    summary = f"{escape(entry.name + learner)}: {escape(entry.learner.summary)}"
    return f"<details><summary>{summary}</summary>{body}</details>"


def _sources(summary: Mapping[str, Any]) -> str:
    found = {row["agent"]: row["source"] for row in summary["rows"] if row["reference"]}
    return f"<h2>Reference values</h2><dl>{_definitions(found)}</dl>" if found else ""
