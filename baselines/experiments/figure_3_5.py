"""Figure 3.5: steps to the goal of the puddle world with 400 bases; fixed ones diverge."""

from __future__ import annotations

from baselines.experiments.figure_3_2 import PUDDLES, contest
from baselines.reproduction import LENGTH, Comparison, Reproduction, learner_metric

ENTRIES = tuple(
    entry for entry in PUDDLES if entry.contender.startswith("gpq") or entry.name.endswith("worst")
)
EXPERIMENT = contest("PuddleWorld", ENTRIES, steps=20_000, seeds=3, eval_points=4, eval_episodes=50)
QUICK = {"seeds": 1, "steps": 15_000, "eval_points": 3, "eval_episodes": 10}

REPRODUCTION = Reproduction(
    title="Figure 3.5: puddle world, 400 bases",
    panels=(
        Comparison("steps", "steps to the goal", EXPERIMENT, QUICK, LENGTH),
        Comparison(
            "steps",
            "errors: where they explode, learning has diverged",
            EXPERIMENT,
            QUICK,
            learner_metric("mean |temporal difference|", "td_error"),
            logarithmic=True,
        ),
    ),
    notes=(
        "Both panels are of the same runs. Bandwidths are .1, but .05 for gpq and gpq-optimistic, "
        "as in figure 3.2.",
    ),
)
