"""Figure 3.2: GPQ against tabular, fixed-basis and gradient-corrected Q-learning, and deep RL.

The settings are the best found on parts of the grids of appendix 3.7.1, with 2 to 36 other seeds.
"""

from __future__ import annotations

from baselines.environment import EnvironmentSpec
from baselines.experiment import Entry, Experiment
from baselines.reproduction import EXACT, LENGTH, RETURN, Comparison, Reproduction

SLOW_RATES = {"rate_exponent": 0.1, "exploration_exponent": 0.1}
GRID = {"grid_columns": 5, "bandwidth": [0.5]}
GRIDWORLD = (
    Entry("gpq", "gpq", GRID | {"budget": 25, "exploration_exponent": 0.1}),
    Entry("gpq-optimistic", "gpq-optimistic", GRID | {"budget": 25, "amplitude": 0.1}),
    Entry("tabular-q", "tabular-q", SLOW_RATES),
    Entry("linear-q", "linear-q", GRID | SLOW_RATES),
    Entry("gq", "gq", GRID | SLOW_RATES),
)

RANGE = {"low": [-1.6, -5.0], "high": [1.6, 5.0]}
"""Of angle and velocity: where the bases and cells lie, and of what the bandwidths are shares."""
GPQ_PENDULUM = RANGE | {"bandwidth": [0.08]}
LINEAR_PENDULUM = RANGE | {"bases": 10, "exploration_exponent": 0.3}
PENDULUM = (
    Entry("gpq", "gpq", GPQ_PENDULUM | {"exploration_exponent": 0.1}),
    Entry(
        "gpq-optimistic",
        "gpq-optimistic",
        GPQ_PENDULUM | {"noise": 0.001, "amplitude": 0.01, "prior_mean": -0.6},
    ),
    Entry(
        "tabular-q",
        "tabular-q",
        RANGE | {"bins": 10, "rate_exponent": 0.1, "exploration_exponent": 0.5},
    ),
    Entry("linear-q", "linear-q", LINEAR_PENDULUM | {"rate_exponent": 0.1}),
    Entry("gq", "gq", LINEAR_PENDULUM | {"rate_exponent": 0.3}),
)
EARLY = tuple(entry for entry in PENDULUM if entry.name != "tabular-q")
"""Contenders that balance at times within the first 200 steps."""
DEEP_PENDULUM = (
    Entry(
        "dqn",
        "dqn",
        {"n_envs": 1, "learning_starts": 200, "train_freq": 1, "gradient_steps": 1},
    ),
    Entry("ppo", "ppo", {"n_envs": 8, "n_steps": 64, "batch_size": 128, "n_epochs": 10}),
)

GPQ_PUDDLES = {"bandwidth": [0.05], "budget": 400}
WORST = {"bases": 20, "bandwidth": [0.1]} | SLOW_RATES
PUDDLES = (
    Entry(
        "gpq",
        "gpq",
        GPQ_PUDDLES | {"noise": 0.1, "forgetting": 0.98, "exploration_exponent": 0.5},
    ),
    Entry(
        "gpq-optimistic",
        "gpq-optimistic",
        GPQ_PUDDLES | {"noise": 0.01, "amplitude": 0.1, "forgetting": 0.98},
    ),
    Entry("gpq-as-printed", "gpq", GPQ_PUDDLES | {"bandwidth": [0.1], "noise": 1.0}),
    Entry("tabular-q", "tabular-q", {"bins": 10} | SLOW_RATES),
    Entry(
        "linear-q",
        "linear-q",
        {"bases": 10, "bandwidth": [0.05], "rate_exponent": 0.1, "exploration_exponent": 0.3},
    ),
    Entry("linear-q-worst", "linear-q", WORST),
    Entry(
        "gq", "gq", {"bases": 10, "bandwidth": [0.1], "rate_exponent": 0.5, "correction_rate": 0.01}
    ),
    Entry("gq-worst", "gq", WORST),
)
DEEP_PUDDLES = (
    Entry("dqn", "dqn", {"exploration_fraction": 0.5}),
    Entry("ppo", "ppo", {}),
)


def contest(
    world: str, entries: tuple[Entry, ...], *, eval_episodes: int = 100, **sizes: int
) -> Experiment:
    """Return the experiment of contenders in one of the three worlds; sizes as in `Experiment`."""
    environment = EnvironmentSpec(f"bnprl/{world}-v0")
    return Experiment(environment, entries, eval_episodes=eval_episodes, **sizes)


REPRODUCTION = Reproduction(
    title="Figure 3.2: discounted reward while learning",
    panels=(
        Comparison(
            "gridworld",
            "Gridworld",
            contest("Gridworld", GRIDWORLD, steps=1000, seeds=20, eval_episodes=20, eval_points=50),
            {"seeds": 5, "eval_points": 20},
            EXACT,
        ),
        Comparison(
            "pendulum",
            "Inverted pendulum",
            contest("InvertedPendulum", PENDULUM, steps=1000, seeds=20, eval_points=5),
            {"seeds": 2, "eval_episodes": 10},
            LENGTH,
        ),
        Comparison(
            "pendulum-early",
            "The first steps of the same runs",
            contest("InvertedPendulum", EARLY, steps=200, seeds=20, eval_points=10),
            {"seeds": 2, "eval_episodes": 10, "eval_points": 4},
            LENGTH,
        ),
        Comparison(
            "pendulum-deep",
            "Inverted pendulum, deep RL: longer, 3 seeds",
            contest("InvertedPendulum", DEEP_PENDULUM, steps=2048, seeds=3, eval_points=4),
            {"seeds": 1, "eval_episodes": 10},
            LENGTH,
        ),
        Comparison(
            "puddles",
            "Puddle world",
            contest("PuddleWorld", PUDDLES, steps=60_000, seeds=5, eval_points=6),
            {"seeds": 1, "steps": 15_000, "eval_points": 3, "eval_episodes": 10},
            RETURN,
            logarithmic=True,
        ),
        Comparison(
            "puddles-deep",
            "Puddle world, deep RL: 2 seeds",
            contest("PuddleWorld", DEEP_PUDDLES, steps=20_480, seeds=2, eval_points=5),
            {"seeds": 1, "steps": 4096, "eval_points": 2, "eval_episodes": 10},
            RETURN,
        ),
    ),
    notes=(
        "In the puddle world GPQ forgets (C shrinks before each measurement), and on the pendulum "
        "the optimist's prior mean is not 0, which are not in the source. Without forgetting, "
        "gpq-as-printed, all targets weigh alike and the first, bootstrapped from nothing, hold "
        "the values back: the discount is .99, and the goal 36 steps away.",
        "There both have a bandwidth of .05, as the best fixed bases do; at .1 some seeds end in "
        "loops. The optimist's amplitude is small, since its bonus is backed up and must not hide "
        "what a step costs.",
        "On the pendulum only a fall costs, 1: a prior mean of 0 is as hopeful as can be, and the "
        "optimist then tries what is no use.",
        "Learners of action values are evaluated greedily, PPO as the stochastic policy that it "
        "learns; all of them apart from training.",
        "The source gives its figures as pictures, without numbers.",
    ),
)
