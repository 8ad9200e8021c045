"""Figure 3.5: steps to the goal of the puddle world with 400 bases; fixed ones diverge."""

from __future__ import annotations

from baselines.experiments.figure_3_2 import PUDDLES, contest
from baselines.records import Record
from baselines.reproduction import LENGTH, Comparison, Measure, Reproduction

ENTRIES = tuple(
    entry for entry in PUDDLES if entry.contender.startswith("gpq") or entry.name.endswith("worst")
)
EXPERIMENT = contest(
    "PuddleWorld", ENTRIES, steps=20_000, seeds=10, eval_points=4, eval_episodes=50
)
DIVERGED = 1e6
"""Error shown for a learner whose values grow without bound; no return is as large."""
QUICK = {"seeds": 1, "steps": 15_000, "eval_points": 3, "eval_episodes": 10}


def error(record: Record) -> float | None:
    """Return the mean absolute temporal difference; `DIVERGED` if larger or learning stopped."""
    found = DIVERGED if record.metrics.get("diverged") else record.metrics.get("td_error")
    return None if found is None else min(found, DIVERGED)


REPRODUCTION = Reproduction(
    title="Figure 3.5: puddle world, 400 bases",
    panels=(
        Comparison("steps", "steps to the goal", EXPERIMENT, QUICK, LENGTH),
        Comparison(
            "steps",
            "errors; a million where learning has diverged",
            EXPERIMENT,
            QUICK,
            Measure("mean |temporal difference|", error),
            logarithmic=True,
        ),
    ),
    notes=(
        "Both panels are of the same runs. Bandwidths are .1, but .05 for gpq and gpq-optimistic, "
        "as in figure 3.2.",
        "A learner that has diverged stops, and its error is shown as a million.",
    ),
)
