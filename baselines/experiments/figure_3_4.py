"""Figure 3.4: the pendulum with budgets (or cells) of 36 and of 100."""

from __future__ import annotations

from dataclasses import replace

from baselines.experiment import Entry
from baselines.experiments.figure_3_2 import PENDULUM, contest
from baselines.reproduction import LENGTH, Comparison, Reproduction

SIZE_SETTING = {
    "gpq": "budget",
    "gpq-optimistic": "budget",
    "tabular-q": "bins",
    "linear-q": "bases",
    "gq": "bases",
}
"""Contender -> the setting that holds its size: of a basis, or along each of two dimensions."""


def sized(entries: tuple[Entry, ...], side: int) -> tuple[Entry, ...]:
    """Return those contenders that have a size, in the size side x side."""
    return tuple(
        replace(
            entry,
            settings=entry.settings | {setting: side * side if setting == "budget" else side},
        )
        for entry in entries
        if (setting := SIZE_SETTING.get(entry.contender)) and not entry.name.endswith("worst")
    )


REPRODUCTION = Reproduction(
    title="Figure 3.4: inverted pendulum under different budgets",
    panels=tuple(
        Comparison(
            f"budget-{side * side}",
            f"budget {side * side}",
            contest("InvertedPendulum", sized(PENDULUM, side), steps=1000, seeds=5, eval_points=5),
            {"seeds": 2, "eval_episodes": 10},
            LENGTH,
        )
        for side in (6, 10)
    ),
    notes=("All other settings are those of figure 3.2.",),
)
