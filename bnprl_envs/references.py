"""What is known of each environment: values to hold a learner against, and where they come from.

A computed value names the command that gives it again. A search with a time limit finds the same
or better on a faster machine. Values of the literature are of the same model at the same
discount, but for box pushing's, which are of its published file: one row of that departs from the
rule.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Reference:
    """A published or computed discounted value to hold a learner against.

    Attributes:
        name: what has this value: "random", "memoryless" (best memoryless policy), "lower" and
            "upper" (bounds of the optimum; "lower" is the best known policy), "dissertation", or
            the name of a learner or policy.
        value: expected discounted return from the start distribution.
        source: where the number comes from.
        policy: where a deterministic memoryless policy has this value, for each agent its action
            after each of its own observations, and last the first action.
    """

    name: str
    value: float
    source: str
    policy: tuple[tuple[int, ...], ...] = ()


_EXACT = "exact: bnprl bounds"
_10_S = "search: bnprl bounds --seconds 10"
_100_S = "search: bnprl bounds --seconds 100"
_FIB = "fast informed bound: bnprl bounds"
_LISTED = "exact value of the listed policy, found by bnprl bounds --seconds {}"
_BELIEFS = "exact over the reachable beliefs: pytest tests/envs/test_benchmarks.py"
_DISSERTATION = "source dissertation: online EM, 50,000 episodes"
_BEST_KNOWN = "best known: FB-HSVI on the published file"
_SEARCHED = "exact value of the best of 10 seeds: python -m baselines.benchmarks.team_learners"
_CERTIFIED = "FB-HSVI on the published file: its value and certified gap"
_CENTRALISED = "exact: bnprl bounds, the team as one agent that sees the state"
_DEC_SBPR = "source dissertation: DEC-SBPR, Table 6.2"
_MCEM = "Wu et al. 2013, as given in the source dissertation's Table 6.2"
_MC_JESP = "MC-JESP on the simulator alone (2023), best of 20 runs"
_ONE_QUEUE = "exact, the queues' chain: pytest tests/envs/test_grid_traffic.py"
_SIMULATED = "{}, simulated: bnprl bounds --seconds 60, standard error {}"


def _solved(value: float, source: str) -> tuple[Reference, Reference]:
    """Return an optimum that is known: both of its bounds."""
    return Reference("lower", value, source), Reference("upper", value, source)


def _listed(
    value: float, seconds: int, *policy: tuple[int, ...], name: str = "memoryless"
) -> Reference:
    """Return a deterministic memoryless policy, found in some seconds, with its exact value."""
    return Reference(name, value, _LISTED.format(seconds), policy)


REFERENCES: dict[str, tuple[Reference, ...]] = {
    "bnprl/Gridworld-v0": (Reference("random", 0.020083, _EXACT), *_solved(0.437831, _EXACT)),
    "bnprl/InvertedPendulum-v0": (
        Reference("random", -1.3219, _SIMULATED.format("uniform", 0.0002)),
        Reference("lower", 0.079, _SIMULATED.format("hand_coded.balance", 0.0006)),
    ),
    "bnprl/PuddleWorld-v0": (
        Reference("random", -226.0, _SIMULATED.format("uniform", 0.9)),
        Reference("lower", -30.011, _SIMULATED.format("hand_coded.go_around", 0.002)),
    ),
    "bnprl/BairdStar-v0": (Reference("random", 0.0, _EXACT), *_solved(0.0, _EXACT)),
    "bnprl/ThreeNodes-v0": (Reference("random", 0.0, _EXACT), *_solved(0.0, _EXACT)),
    "bnprl/Shuttle-v0": (
        Reference("random", -4.06186, _EXACT),
        Reference("memoryless", 18.923360, _10_S),
        Reference("lower", 32.88972, "search: bnprl bounds --seconds 60"),
        Reference("upper", 32.889725, _FIB),
    ),
    "bnprl/CheeseMaze-v0": (
        Reference("random", 0.203640, _EXACT),
        Reference("memoryless", 0.719342, _10_S),
        *_solved(0.824174, _BELIEFS),
    ),
    "bnprl/Grid4x4-v0": (
        Reference("random", 0.310105, _EXACT),
        Reference("memoryless", 0.826041, _10_S),
        *_solved(0.854384, _BELIEFS),
    ),
    "bnprl/NoisyMaze1D-v0": (
        Reference("random", 0.610753, _EXACT),
        Reference("memoryless", 0.690012, _10_S),
        *_solved(0.731050, "exact over action sequences: pytest tests/envs/test_benchmarks.py"),
    ),
    "bnprl/Tiger-v0": (
        Reference("random", -606.666667, _EXACT),
        Reference("memoryless", -20.0, _10_S),
        *_solved(19.371368, _BELIEFS),
    ),
    "bnprl/Hallway-v0": (
        Reference("random", 0.042233, _EXACT),
        Reference("memoryless", 0.376129, _100_S),
        Reference("lower", 0.5155, _100_S),
        Reference("upper", 0.587888, _FIB),
        Reference("dissertation", 0.3, _DISSERTATION),
    ),
    "bnprl/Hallway2-v0": (
        Reference("random", 0.026485, _EXACT),
        Reference("memoryless", 0.206135, _100_S),
        Reference("lower", 0.3249, _100_S),
        Reference("upper", 0.517134, _FIB),
    ),
    "bnprl/Tag-v0": (
        Reference("random", -53.760587, _EXACT),
        _listed(
            -6.669900,
            240,
            tuple(map(int, "0333333333222220122102120142141")),
        ),
        Reference("lower", -6.002, "search: bnprl bounds --seconds 240"),
        Reference("upper", 0.327226, _FIB),
        Reference("dissertation", -8.0, _DISSERTATION),
    ),
    "bnprl/DecTiger-v0": (
        Reference("random", -462.222222, _EXACT),
        _listed(-20.0, 10, (0, 0, 0), (0, 0, 0)),
        Reference("lower", 13.448, _BEST_KNOWN),
        Reference("upper", 13.449, _CERTIFIED),
        Reference("dissertation", -19.14, _DEC_SBPR),
        Reference("mcem", -32.31, _MCEM),
        Reference("mc-jesp", 13.44, _MC_JESP),
    ),
    "bnprl/BroadcastChannel-v0": (
        Reference("random", 3.180518, _EXACT),
        _listed(9.19, 10, (0, 0, 1), (1, 1, 0)),
        Reference("lower", 9.271, _BEST_KNOWN),
        Reference("upper", 9.274, _CERTIFIED),
        Reference("dissertation", 9.2, _DEC_SBPR),
        Reference("mcem", 9.15, _MCEM),
    ),
    "bnprl/RecyclingRobots-v0": (
        Reference("random", 6.361766, _EXACT),
        *(_listed(31.929134, 10, (1, 0, 2), (1, 0, 2), name=n) for n in ("memoryless", "lower")),
        Reference("upper", 31.931, _CERTIFIED),
        Reference("dissertation", 31.26, _DEC_SBPR),
        Reference("mcem", 30.78, _MCEM),
        Reference("mc-jesp", 31.92, _MC_JESP),
    ),
    "bnprl/MeetingGrid-v0": (
        Reference("random", 0.144916, _EXACT),
        *(
            _listed(
                5.819876,
                10,
                (4, 2, 2, 0, 2, 2, 0, 0, 2, 2),
                (4, 2, 2, 0, 0, 2, 0, 0, 2, 0),
                name=name,
            )
            for name in ("memoryless", "lower")
        ),
        Reference("upper", 5.947212, _CENTRALISED),
        Reference("mc-jesp", 5.81, _MC_JESP),
    ),
    "bnprl/BoxPushing-v0": (
        Reference("random", -8.931549, _EXACT),
        _listed(183.190148, 10, (2, 0, 0, 2, 2, 2), (2, 1, 1, 2, 2, 2)),
        Reference("lower", 224.777564, _SEARCHED),
        Reference("upper", 231.405293, _FIB),
        Reference("dissertation", 77.65, _DEC_SBPR),
        Reference("mcem", 59.95, _MCEM),
        Reference("mc-jesp", 223.84, _MC_JESP),
    ),
    "bnprl/MarsRovers-v0": (
        Reference("random", -13.289684, _EXACT),
        _listed(23.830150, 240, (4, 5, 5, 0, 1, 3, 3, 0, 4), (4, 5, 5, 5, 3, 3, 1, 2, 4)),
        Reference("lower", 26.94, _BEST_KNOWN),
        Reference("upper", 27.77, _CERTIFIED),
        Reference("dissertation", 20.62, _DEC_SBPR),
        Reference("mcem", 8.16, _MCEM),
        Reference("mc-jesp", 26.45, _MC_JESP),
    ),
    "bnprl/GridTraffic-v0": (
        Reference("random", 0.159778, _ONE_QUEUE),
        Reference("always horizontal", 45.0, _ONE_QUEUE),
        Reference("longer queue", 26.31, _SIMULATED.format("hand_coded.follow_longer_queue", 0.01)),
        Reference("lower", 73.205503, _ONE_QUEUE),
    ),
}
