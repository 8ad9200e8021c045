"""What plain stick-breaking reaches on the five problems of the dissertation's Table 6.2.

`bnprl reproduce table-6.2 --out DIR` makes the records; `python -m
baselines.benchmarks.stick_breaking DIR` prints exact values at discount .9 beside the source's and
exits 1 where a mean stays below it. Without DIR it judges the records that are kept in the
repository. The settings of each problem are in `baselines.experiments.table_6_2`.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from baselines.records import Record
from baselines.report import finished_runs
from baselines.reproduction import EXACT, Comparison, find
from baselines.statistics import mean_interval
from baselines.study import read_runs

KEPT = Path(__file__).parent.parent / "results" / "table-6.2"


def values_and_nodes(runs: Sequence[Sequence[Record]]) -> tuple[list[float], list[float]]:
    """Return the exact values of each run's policy and the mean nodes in use of its agents."""
    last = [run[-1] for run in runs]
    values = [record.exact_value for record in last if record.exact_value is not None]
    return values, [record.metrics["nodes"] for record in last]


def judge(panel: Comparison, folder: Path) -> bool:
    """Print one problem's line; return whether the mean reaches the source's value."""
    source = next(r.value for r in panel.references if r.name == "dissertation")
    runs = finished_runs(read_runs(panel.experiment, folder / panel.name))["stick-breaking"]
    values, nodes = values_and_nodes(runs)
    if not values:
        print(f"{panel.title:18} {source:7.2f}  no finished runs: FAIL")
        return False
    mean = mean_interval(np.array(values), seed=0)
    interval = "" if mean.low is None else f"{mean.low:8.2f} to {mean.high:.2f}"
    reached = mean.mean >= source
    seconds = np.mean([run[-1].train_seconds for run in runs])
    print(
        f"{panel.title:18} {source:7.2f} {mean.mean:8.2f} {interval:>20} {max(values):8.2f} "
        f"{min(values):8.2f} {len(values):6} {np.mean(nodes):6.1f} {seconds:8.1f}  "
        f"{'pass' if reached else 'FAIL'}"
    )
    return reached


def main(arguments: list[str] | None = None) -> int:
    """Judge every problem's records; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=KEPT, help="of `reproduce`")
    folder = parser.parse_args(arguments).folder
    print(
        f"{'problem':18} {'source':>7} {'mean':>8} {'95% interval':>20} {'best':>8} {'worst':>8} "
        f"{'seeds':>6} {'nodes':>6} {'seconds':>8}"
    )
    panels = [
        panel
        for panel in find("table-6.2").panels
        if isinstance(panel, Comparison) and panel.measure is EXACT
    ]
    reached = [judge(panel, folder) for panel in panels]
    return 0 if all(reached) else 1


if __name__ == "__main__":
    sys.exit(main())
