"""Figure 3.6: the puddle world with budgets (or cells) of 100 and of 400."""

from __future__ import annotations

from baselines.experiments.figure_3_2 import PUDDLES, contest
from baselines.experiments.figure_3_4 import sized
from baselines.reproduction import RETURN, Comparison, Reproduction

REPRODUCTION = Reproduction(
    title="Figure 3.6: puddle world under different budgets",
    panels=tuple(
        Comparison(
            f"budget-{side * side}",
            f"budget {side * side}",
            contest(
                "PuddleWorld",
                sized(PUDDLES, side),
                steps=20_000,
                seeds=10,
                eval_points=2,
                eval_episodes=50,
            ),
            {"seeds": 1, "steps": 15_000, "eval_points": 3, "eval_episodes": 10},
            RETURN,
        )
        for side in (10, 20)
    ),
    notes=(
        "All other settings are those of figure 3.2. GPQ's bandwidth of .05 suits 400 basis points "
        "an action; 100 do not cover the square.",
    ),
)
