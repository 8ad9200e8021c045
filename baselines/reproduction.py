"""Ready-made experiments: what a file of `baselines.experiments` holds, and how it is found.

A file `figure_3_2.py` is the experiment `figure-3.2`. The first line of its docstring is its line
in the listing, and it defines `REPRODUCTION`: panels, each of them a comparison of contenders in an
environment or a computation, with the numbers of the source beside them.
"""

from __future__ import annotations

import ast
import dataclasses
import difflib
import importlib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from baselines.experiment import Experiment
from baselines.files import check_name
from baselines.records import Record
from baselines.report import REFERENCE_NAMES
from bnprl_envs import registry
from bnprl_envs.registry import Reference

FOLDER = Path(__file__).parent / "experiments"

Lines = dict[str, tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]]
"""Label -> x (points,) and y (runs, points)."""


@dataclass(frozen=True)
class Measure:
    """One number of an evaluation.

    Attributes:
        label: what axes and tables call it.
        of: record -> the number, or None where it does not exist.
    """

    label: str
    of: Callable[[Record], float | None]


RETURN = Measure("mean discounted return", lambda record: record.return_mean)
EXACT = Measure("exact discounted return", lambda record: record.exact_value)
LENGTH = Measure("mean steps of an episode", lambda record: record.length_mean)
SECONDS = Measure("seconds of training", lambda record: record.train_seconds)
EARNED = Measure("sum of rewards while learning", lambda record: record.train_reward)
RETURNED = Measure("mean return of all episodes so far", lambda record: record.train_return)
REWARD = Measure("mean sum of an episode's rewards", lambda record: record.reward_mean)
REWARD_PER_STEP = Measure(
    "mean reward per step",
    lambda record: (
        record.reward_mean / record.length_mean
        if record.reward_mean is not None and record.length_mean
        else None
    ),
)


def learner_metric(label: str, name: str) -> Measure:
    """Return the measure of a number that learners report by this name."""
    return Measure(label, lambda record: record.metrics.get(name))


@dataclass(frozen=True)
class Comparison:
    """A panel: contenders in one environment.

    Attributes:
        name: of its folder.
        title: above its axes and table.
        experiment: at full size.
        quick: fields of the experiment -> their values with --quick, which should take two minutes
            on two cores for all panels together.
        measure: what is drawn and tabulated.
        slow: contenders that get fewer seeds or steps than the others; tables say how many.
        slow_quick: fields of that experiment -> their values with --quick.
        references: numbers to hold it against: the source's, best known ones.
        computed: returns more of them, where finding them takes a moment.
        x: what the horizontal axis counts.
        logarithmic: the axis of the measure.
        logarithmic_x: the horizontal axis.
        labels: contender -> what the figure and the tables call it, if not by its name.
    """

    name: str
    title: str
    experiment: Experiment
    quick: Mapping[str, Any]
    measure: Measure = RETURN
    slow: Experiment | None = None
    slow_quick: Mapping[str, Any] = field(default_factory=dict)
    references: tuple[Reference, ...] = ()
    computed: Callable[[], tuple[Reference, ...]] | None = None
    x: Literal["steps", "episodes"] = "steps"
    logarithmic: bool = False
    logarithmic_x: bool = False
    labels: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_name(self.name)

    def sized(self, quick: bool) -> dict[str, Experiment]:
        """Return the experiments in the size wanted, each by the name of its folder."""
        sizes = [(self.name, self.experiment, self.quick)]
        if self.slow is not None:
            sizes.append((f"{self.name}-slow", self.slow, self.slow_quick))
        return {
            folder: dataclasses.replace(experiment, **changes) if quick else experiment
            for folder, experiment, changes in sizes
        }


@dataclass(frozen=True)
class Computation:
    """A panel: lines that are computed at once, too quickly to be kept in records.

    Attributes:
        name: in the summary.
        title: above its axes and table.
        compute: quick -> lines; the last point of each is tabulated.
        x: label of the axis.
        y: label of the other axis.
        references: numbers to hold it against.
        logarithmic: the axis y.
    """

    name: str
    title: str
    compute: Callable[[bool], Lines]
    x: str
    y: str
    references: tuple[Reference, ...] = ()
    logarithmic: bool = False


@dataclass(frozen=True)
class Reproduction:
    """A table or figure of the source.

    Attributes:
        title: of the whole.
        panels: in the order of drawing.
        notes: what to know when reading it, one sentence or more each.
        shape: "figure" draws each panel's curves. "table" makes one table, each panel a row and
            each contender or reference a column, and draws the last values side by side.
        columns: of panels in the picture, at most.
    """

    title: str
    panels: tuple[Comparison | Computation, ...]
    notes: tuple[str, ...] = field(default=())
    shape: Literal["figure", "table"] = "figure"
    columns: int = 3


def registered(id: str) -> tuple[Reference, ...]:
    """Return what the registry knows of an environment, for a panel of one of its variants."""
    known = registry.entry(id).references
    return tuple(
        dataclasses.replace(each, name=REFERENCE_NAMES.get(each.name, each.name)) for each in known
    )


def names() -> dict[str, Path]:
    """Return every experiment's name and file, in order."""
    files = sorted(FOLDER.glob("[a-z]*.py"))
    return {_name(path.stem): path for path in files}


def summary(path: Path) -> str:
    """Return the first line of a file's docstring, without running it."""
    return (ast.get_docstring(ast.parse(path.read_text())) or "").partition("\n")[0]


def find(name: str) -> Reproduction:
    """Return the experiment of a name.

    Raises:
        ValueError: there is none; near misses are named.
    """
    known = names()
    if name not in known:
        near = difflib.get_close_matches(name.lower(), known, n=3)
        hint = f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(known)}"
        raise ValueError(f"unknown experiment {name!r}; {hint}")
    module = importlib.import_module(f"baselines.experiments.{known[name].stem}")
    found: Reproduction = module.REPRODUCTION
    return found


def _name(stem: str) -> str:
    """Return figure-3.2 for figure_3_2."""
    return re.sub(r"^(figure|table)_(\d+)_(\d+)", r"\1-\2.\3", stem).replace("_", "-")
