"""Figure 3.6: the puddle world with budgets (or cells) of 100 and of 400."""

from __future__ import annotations

from baselines.environment import EnvironmentSpec
from baselines.experiment import Experiment
from baselines.experiments.figure_3_2 import PUDDLES
from baselines.experiments.figure_3_4 import sized
from baselines.reproduction import RETURN, Comparison, Reproduction

REPRODUCTION = Reproduction(
    title="Figure 3.6: puddle world under different budgets",
    panels=tuple(
        Comparison(
            f"budget-{side * side}",
            f"budget {side * side}",
            Experiment(
                EnvironmentSpec("bnprl/PuddleWorld-v0"),
                sized(PUDDLES, side),
                steps=60_000,
                seeds=3,
                eval_episodes=100,
                eval_points=6,
            ),
            quick={"seeds": 1, "steps": 15_000, "eval_points": 3, "eval_episodes": 10},
            measure=RETURN,
        )
        for side in (10, 20)
    ),
    notes=("All other settings are those of figure 3.2.",),
)
