"""What the strong learners reach, as tables made from the records in baselines/results.

`python docs/learners.py` writes the page docs/experiments/learners.md and the tables of the README,
between its two marks; a test holds the README to them.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from baselines.benchmarks import pomdp_learners, team_learners, time_to_value
from baselines.benchmarks.run_records import Score
from baselines.report import DASH, markdown_table, number
from baselines.statistics import mean_interval
from bnprl_envs import registry

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "baselines" / "results"
BEGIN, END = "<!-- learners: begin -->", "<!-- learners: end -->"
ITS_METHODS = ("online-em", "batch-em", "infinite-rpr", "stick-breaking")
HEADER = ["environment", "steps", "mean", "95% interval", "best seed", "seeds", "best memoryless"]
HEADER += ["best known", "CPU seconds a seed"]


def rows(path: Path) -> list[dict[str, Any]]:
    """Return the records of a file of JSON lines, none where there is no file."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.is_file() else []


def pomdp_table() -> list[list[str]]:
    """Return the table of the learner of POMDPs, header first: a row for each goal."""
    found: dict[tuple[str, int], list[dict[str, Any]]] = defaultdict(list)
    for record in rows(RESULTS / "pomdp-learners" / "records.jsonl"):
        run = record["run"]
        if run["agent"] != pomdp_learners.AGENT:
            continue
        for goal, score in zip(run["goals"], record["scores"], strict=True):
            found[run["environment"], goal].append(score)
    ordered = [
        (env, goal.steps)
        for env, goals in pomdp_learners.GOALS.items()
        for goal in goals
        if (env, goal.steps) in found
    ]
    return [HEADER, *(row(env, steps, found[env, steps]) for env, steps in ordered)]


def team_table() -> list[list[str]]:
    """Return the table of the search for teams, header first."""
    found: dict[tuple[str, int], list[dict[str, Any]]] = defaultdict(list)
    for record in rows(RESULTS / "team-learners" / "records.jsonl"):
        run = record["run"]
        if run["agent"] == team_learners.AGENT:
            found[run["environment"], run["steps"]] += record["scores"]
    ordered = [(each.name, each.steps) for each in team_learners.PROBLEMS]
    return [HEADER, *(row(*each, found[each]) for each in ordered if each in found)]


def deep_table(shares: Sequence[float]) -> list[list[str]]:
    """Return steps and seconds until shares of the way to the best known value, header first."""
    curves: dict[tuple[str, str], list[list[Score]]] = defaultdict(list)
    for record in rows(RESULTS / "time-to-value" / "records.jsonl"):
        run = record["run"]
        curves[run["environment"], run["agent"]].append([Score(**s) for s in record["scores"]])
    table = [["environment", "share", "value", *time_to_value.AGENTS]]
    for env in time_to_value.BUDGETS:
        for share, value in zip(time_to_value.SHARES, time_to_value.thresholds(env), strict=True):
            if share in shares:
                when = (reached(curves[env, name], value) for name in time_to_value.AGENTS)
                name = env.removeprefix("bnprl/").removesuffix("-v0")
                table.append([name, f"{share:.0%}", number(value, ".4g"), *when])
    return table


def reached(curves: Sequence[Sequence[Score]], value: float) -> str:
    """Return median steps and seconds, or the mean value at the end of those that never come."""
    if not curves:
        return DASH
    steps, seconds = time_to_value.typical(curves, value)
    if np.isfinite(steps):
        return f"{steps:,.0f} ({number(seconds, '.1f')} s)"
    last = float(np.mean([scores[-1].value for scores in curves]))
    return f"never; {number(last, '.3g')} after {number(curves[0][-1].steps, ',')}"


def source_table() -> list[list[str]]:
    """Return a row for each panel of returns or rewards that the source has numbers for.

    What the source calls its own, and the best of what else it lists; the same of the runs here.
    """
    table = [["", "measure", "its methods, here", "its methods, there", "best here", "best there"]]
    for path in sorted(RESULTS.glob("[ft]*/summary.json")):
        summary = json.loads(path.read_text("utf-8"))
        for panel in summary["panels"]:
            if not panel["measure"].startswith(("seconds", "nodes")):
                found = compared(panel["rows"])
                name = f"{summary['title'].split(':')[0]}, {panel['title']}"
                table += [[name, panel["measure"], *found]] if found else []
    return table


def compared(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Return the four best rows, or nothing where the source has none of its own."""
    here = [row for row in rows if row["source"] is None]
    there = [row for row in rows if row["source"] and "issertation" in row["source"]]
    its = [row for row in here if its_method(row["agent"])]
    own = [row for row in there if row["agent"].startswith(("dissertation", "RPR", "online EM"))]
    if not (its and own):
        return []
    best = (max(each, key=lambda row: row["mean"]) for each in (its, own, here, there))
    return [f"{number(row['mean'], '.4g')} ({row['agent']})" for row in best]


def its_method(name: str) -> bool:
    """Whether the source has it; by number of nodes, figure 4.2 compares nothing else."""
    return name.startswith(ITS_METHODS) or name.endswith(" nodes")


def row(env: str, steps: int, scores: Sequence[dict[str, Any]]) -> list[str]:
    """Return the cells of one environment at a budget of environment steps."""
    values = [score["value"] for score in scores]
    interval = mean_interval(values)
    known = known_values(env)
    low, high = number(interval.low, ".4g"), number(interval.high, ".4g")
    return [
        env.removeprefix("bnprl/").removesuffix("-v0"),
        number(steps, ","),
        number(interval.mean, ".4g"),
        DASH if interval.low is None else f"{low} to {high}",
        number(max(values), ".4g"),
        number(len(values), ","),
        number(known.get("memoryless"), ".4g"),
        number(known.get("lower"), ".4g"),
        number(float(np.mean([score["seconds"] for score in scores])), ".0f"),
    ]


def known_values(env: str) -> dict[str, float]:
    """Return what the registry knows; of a model file the goal, its best memoryless value."""
    if env in (pomdp_learners.PARCELS, pomdp_learners.MACHINE):
        return {"memoryless": pomdp_learners.GOALS[env][0].value}
    if env not in registry.environment_ids() or not registry.entry(env).kind.endswith("tabular"):
        return {}  # grid traffic is scored in other units
    return {reference.name: reference.value for reference in registry.entry(env).references}


def tables(shares: Sequence[float] = time_to_value.SHARES) -> str:
    """Return the tables with what they are of; deep learners at some shares of the way alone."""
    return f"""`predictive-actor-critic`, one agent, from episodes alone
(`python -m baselines.benchmarks.pomdp_learners`):

{markdown_table(pomdp_table())}

`controller-search`, teams, from a simulator alone (`python -m baselines.benchmarks.team_learners`);
grid traffic in units that pass in a step:

{markdown_table(team_table())}

Beside deep learners (`python -m baselines.benchmarks.time_to_value`): environment steps and, in
brackets, processor seconds until a policy has gone a share of the way from random play to the best
known value; medians of three seeds:

{markdown_table(deep_table(shares))}

Beside the source, from the kept records of `bnprl reproduce`, whose settings stand in each
`experiment.json` and whose differences in the notes of each experiment's page; "ours" is
`predictive-actor-critic`:

{markdown_table(source_table())}

Every row of the first three tables is of the same default settings. Simulated values, those of the
first table and of grid traffic, may be above an optimum by chance."""


def with_tables(readme: str) -> str:
    """Return the README with the tables between its marks."""
    before, _, rest = readme.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{tables([0.9])}\n{END}{after}"


def write_page(folder: Path) -> None:
    """Write the page."""
    folder.mkdir(exist_ok=True)
    (folder / "learners.md").write_text(f"# What the learners reach\n\n{tables()}\n", "utf-8")


if __name__ == "__main__":
    write_page(ROOT / "docs" / "experiments")
    path = ROOT / "README.md"
    path.write_text(with_tables(path.read_text("utf-8")), "utf-8")
