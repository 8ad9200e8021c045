"""The page of an experiment: its table, curves, settings and the command that made it."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from string import Template
from typing import Any

from baselines import web_page
from baselines.experiment import Entry
from baselines.report import caption, pair_table, table
from baselines.study import Study

_BODY = Template("""<p>$caption</p>
$table
$pairs
<h2>Learning curves</h2>
$curves
<p class="faint">Bands are pointwise 95% intervals over seeds. Seconds count training, not
evaluation; a run that has spent its budget keeps its final value until the slowest has. Dotted
lines are reference values.</p>
<h2>Budget and evaluation</h2>
$budget
<h2>Settings</h2>
$settings
$sources
<h2>Versions</h2>
$versions
<h2>The command that remakes this page</h2>
<pre>$commands</pre>
""")


def page(study: Study, summary: Mapping[str, Any], light: bytes, dark: bytes) -> str:
    """Return the page as HTML.

    Args:
        study: the experiment with its versions and commands.
        summary: its table.
        light: the curves (PNG) on a light ground.
        dark: the same on a dark one.
    """
    cells = table(summary)
    references = [row["reference"] for row in summary["rows"]]
    body = _BODY.substitute(
        caption=escape(caption(summary)),
        table=web_page.table("results", cells, references),
        pairs=_pairs(summary),
        curves=web_page.picture(
            light,
            dark,
            "Learning curves over environment steps and over seconds: "
            + "; ".join(f"{row[0]} ends at {row[1]}" for row in cells[1:]),
        ),
        budget=web_page.definitions(_budget(study) | _used(summary)),
        settings="\n".join(_settings(entry) for entry in study.experiment.entries),
        sources=_sources(summary),
        versions=web_page.definitions(study.versions),
        commands=escape("\n".join(study.commands)),
    )
    names = ", ".join(entry.name for entry in study.experiment.entries)
    return web_page.document(f"{summary['env']}: {names}", body)


def _pairs(summary: Mapping[str, Any]) -> str:
    """Return the table of who beats whom, nothing where there is one contender."""
    cells = pair_table(summary["pairs"])
    if len(cells) == 1:
        return ""
    return (
        "<details><summary>Head to head</summary>\n<p>Means over runs, the probability that a run "
        "of the one beats a run of the other, and a two-sided permutation test corrected for the "
        f"number of pairs.</p>\n{web_page.table('pairs', cells)}</details>"
    )


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
    body = web_page.definitions(entry.settings) if entry.settings else "<p>No settings.</p>"
    summary = f"{escape(entry.name + learner)}: {escape(entry.learner.summary)}"
    return f"<details><summary>{summary}</summary>{body}</details>"


def _sources(summary: Mapping[str, Any]) -> str:
    found = {row["agent"]: row["source"] for row in summary["rows"] if row["reference"]}
    return f"<h2>Reference values</h2>{web_page.definitions(found)}" if found else ""
