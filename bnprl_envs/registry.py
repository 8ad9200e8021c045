"""The one table of environments: id, factory, horizon, discount, reference values.

A new benchmark is one file in `bnprl_envs.benchmarks` and one entry here.
"""

from __future__ import annotations

from typing import Any

from bnprl_envs.model import TabularModel
from bnprl_envs.registration import Entry, Kind, Reference, build, find, register
from bnprl_envs.registration import scene as entry_scene
from bnprl_envs.rendering.scene import Scene

__all__ = [
    "Entry",
    "Kind",
    "Reference",
    "entry",
    "environment_ids",
    "model",
    "register_environments",
    "scene",
]

_EXACT = "exact: computed from the model"
_SEARCH = "computed: search over memoryless policies of the model"
_BOUNDS = "computed: point-based bounds of the model"
_FIB = "computed: fast informed bound of the model"
_BELIEFS = "exact: value iteration over the reachable beliefs"
_SEQUENCES = "exact: search over the sequences of actions"
_DISSERTATION = "source dissertation: online EM, 50,000 episodes"
_COORDINATES = "computed: coordinate ascent over deterministic memoryless joint policies"
_BEST_KNOWN = "best known: FB-HSVI on the published file"
_CERTIFIED = "FB-HSVI on the published file: its value and certified gap"
_CENTRALISED = "exact: the team as one agent that sees the state"
_DEC_SBPR = "source dissertation: DEC-SBPR, Table 6.2"
_MCEM = "Wu et al. 2013, as given in the source dissertation's Table 6.2"
_MC_JESP = "MC-JESP on the simulator alone (2023), best of 20 runs"
_ONE_QUEUE = "exact: the queues' chain; lines are alike"


def _solved(value: float, source: str) -> tuple[Reference, Reference]:
    """Return an optimum that is known: both of its bounds."""
    return Reference("lower", value, source), Reference("upper", value, source)


_ENTRIES = (
    Entry(
        id="bnprl/Gridworld-v0",
        summary="walk across an open grid whose cells are seen",
        factory="bnprl_envs.benchmarks.gridworld:gridworld",
        horizon=200,
        discount=0.9,
        references=(Reference("random", 0.020083, _EXACT), *_solved(0.437831, _EXACT)),
    ),
    Entry(
        id="bnprl/InvertedPendulum-v0",
        summary="keep a pole upright on a cart that is pushed",
        factory="bnprl_envs.inverted_pendulum:InvertedPendulumEnv",
        vector_factory="bnprl_envs.inverted_pendulum:InvertedPendulumVectorEnv",
        horizon=3000,
        discount=0.95,
        kind="class",
        references=(
            Reference("random", -1.3219, "simulated: 1,000,000 episodes, standard error 0.0002"),
            Reference(
                "lower",
                0.078,
                "simulated: push against angle + 0.15 s velocity where beyond 0.04, "
                "20,000 episodes, standard error 0.0004",
            ),
        ),
    ),
    Entry(
        id="bnprl/PuddleWorld-v0",
        summary="cross a square to its far corner around two puddles",
        factory="bnprl_envs.puddle_world:PuddleWorldEnv",
        vector_factory="bnprl_envs.puddle_world:PuddleWorldVectorEnv",
        horizon=1000,
        discount=0.99,
        kind="class",
        references=(
            Reference("random", -225.5, "simulated: 300,000 episodes, standard error 0.3"),
            Reference(
                "lower",
                -30.02,
                "simulated: east until x = 0.9, then north, 50,000 episodes, standard error 0.005",
            ),
        ),
    ),
    Entry(
        id="bnprl/BairdStar-v0",
        summary="seven states without rewards on which linear Q-learning diverges",
        factory="bnprl_envs.benchmarks.baird_star:baird_star",
        horizon=1000,
        discount=0.99,
        references=(Reference("random", 0.0, _EXACT), *_solved(0.0, _EXACT)),
    ),
    Entry(
        id="bnprl/ThreeNodes-v0",
        summary="three nodes without rewards on which fitted Q-iteration may diverge",
        factory="bnprl_envs.benchmarks.three_nodes:three_nodes",
        horizon=100,
        discount=0.9999,
        references=(Reference("random", 0.0, _EXACT), *_solved(0.0, _EXACT)),
    ),
    Entry(
        id="bnprl/Shuttle-v0",
        summary="shuttle docks backwards at two space stations in turn",
        factory="bnprl_envs.benchmarks.shuttle:shuttle",
        horizon=251,
        discount=0.95,
        references=(
            Reference("random", -4.06186, _EXACT),
            Reference("memoryless", 18.923360, _SEARCH),
            Reference("lower", 32.88972, _BOUNDS),
            Reference("upper", 32.889725, _FIB),
        ),
    ),
    Entry(
        id="bnprl/CheeseMaze-v0",
        summary="mouse looks for the cheese among cells that look alike",
        factory="bnprl_envs.benchmarks.cheese_maze:cheese_maze",
        horizon=251,
        discount=0.95,
        references=(
            Reference("random", 0.203640, _EXACT),
            Reference("memoryless", 0.719342, _SEARCH),
            *_solved(0.824174, _BELIEFS),
        ),
    ),
    Entry(
        id="bnprl/Grid4x4-v0",
        summary="find the corner of an open grid without seeing anything",
        factory="bnprl_envs.benchmarks.grid4x4:grid4x4",
        horizon=251,
        discount=0.95,
        references=(
            Reference("random", 0.310105, _EXACT),
            Reference("memoryless", 0.826041, _SEARCH),
            *_solved(0.854384, _BELIEFS),
        ),
    ),
    Entry(
        id="bnprl/NoisyMaze1D-v0",
        summary="find one of four cells in a row with noisy moves, without seeing anything",
        factory="bnprl_envs.benchmarks.noisy_maze:noisy_maze_1d",
        horizon=251,
        discount=0.75,
        references=(
            Reference("random", 0.610753, _EXACT),
            Reference("memoryless", 0.690012, _SEARCH),
            *_solved(0.731050, _SEQUENCES),
        ),
    ),
    Entry(
        id="bnprl/Tiger-v0",
        summary="listen for the tiger, then open the other door",
        factory="bnprl_envs.benchmarks.tiger:tiger",
        horizon=251,
        discount=0.95,
        references=(
            Reference("random", -606.666667, _EXACT),
            Reference("memoryless", -20.0, _SEARCH),
            *_solved(19.371368, _BELIEFS),
        ),
    ),
    Entry(
        id="bnprl/Hallway-v0",
        summary="robot with noisy wall sensors looks for one room of an office corridor",
        factory="bnprl_envs.benchmarks.hallway:hallway",
        horizon=251,
        discount=0.95,
        references=(
            Reference("random", 0.042233, _EXACT),
            Reference("memoryless", 0.3756, _SEARCH),
            Reference("lower", 0.514, _BOUNDS),
            Reference("upper", 0.558, _BOUNDS),
            Reference("dissertation", 0.3, _DISSERTATION),
        ),
    ),
    Entry(
        id="bnprl/Hallway2-v0",
        summary="robot with noisy wall sensors looks for one room of a building without landmarks",
        factory="bnprl_envs.benchmarks.hallway:hallway2",
        horizon=251,
        discount=0.95,
        references=(
            Reference("random", 0.026485, _EXACT),
            Reference("memoryless", 0.206136, _SEARCH),
            Reference("lower", 0.32687, _BOUNDS),
            Reference("upper", 0.517134, _FIB),
        ),
    ),
    Entry(
        id="bnprl/Tag-v0",
        summary="robot hunts an opponent that it sees only when they share a cell",
        factory="bnprl_envs.benchmarks.tag:tag",
        horizon=251,
        discount=0.95,
        references=(
            Reference("random", -53.760587, _EXACT),
            Reference("memoryless", -15.1, _SEARCH),
            Reference("lower", -6.20, _BOUNDS),
            Reference("dissertation", -8.0, _DISSERTATION),
        ),
    ),
    Entry(
        id="bnprl/DecTiger-v0",
        summary="two agents listen for a tiger, and must open the same door without speaking",
        factory="bnprl_envs.benchmarks.dec_tiger:dec_tiger",
        horizon=100,
        discount=0.9,
        references=(
            Reference("random", -462.222222, _EXACT),
            Reference("memoryless", -20.0, _COORDINATES),
            Reference("lower", 13.448, _BEST_KNOWN),
            Reference("upper", 13.449, _CERTIFIED),
            Reference("dissertation", -19.14, _DEC_SBPR),
            Reference("mcem", -32.31, _MCEM),
            Reference("mc-jesp", 13.44, _MC_JESP),
        ),
        kind="parallel-tabular",
    ),
    Entry(
        id="bnprl/BroadcastChannel-v0",
        summary="two senders share a line that carries one message at a time",
        factory="bnprl_envs.benchmarks.broadcast_channel:broadcast_channel",
        horizon=100,
        discount=0.9,
        references=(
            Reference("random", 3.180518, _EXACT),
            Reference("memoryless", 9.19, _COORDINATES),
            Reference("lower", 9.271, _BEST_KNOWN),
            Reference("upper", 9.274, _CERTIFIED),
            Reference("dissertation", 9.2, _DEC_SBPR),
            Reference("mcem", 9.15, _MCEM),
        ),
        kind="parallel-tabular",
    ),
    Entry(
        id="bnprl/RecyclingRobots-v0",
        summary="two robots collect cans, big ones together, and must not run out of battery",
        factory="bnprl_envs.benchmarks.recycling_robots:recycling_robots",
        horizon=100,
        discount=0.9,
        references=(
            Reference("random", 6.361766, _EXACT),
            Reference("memoryless", 31.929134, _COORDINATES),
            Reference("lower", 31.929134, _COORDINATES),
            Reference("upper", 31.931, _CERTIFIED),
            Reference("dissertation", 31.26, _DEC_SBPR),
            Reference("mcem", 30.78, _MCEM),
            Reference("mc-jesp", 31.92, _MC_JESP),
        ),
        kind="parallel-tabular",
    ),
    Entry(
        id="bnprl/MeetingGrid-v0",
        summary="two robots that do not see each other try to meet in a corner",
        factory="bnprl_envs.benchmarks.meeting_grid:meeting_grid",
        horizon=100,
        discount=0.9,
        references=(
            Reference("random", 0.144916, _EXACT),
            Reference("memoryless", 5.819876, _COORDINATES),
            Reference("lower", 5.819876, _COORDINATES),
            Reference("upper", 5.947212, _CENTRALISED),
            Reference("mc-jesp", 5.81, _MC_JESP),
        ),
        kind="parallel-tabular",
    ),
    Entry(
        id="bnprl/BoxPushing-v0",
        summary="two robots push a small box each, or better a large one together",
        factory="bnprl_envs.benchmarks.box_pushing:box_pushing",
        horizon=100,
        discount=0.9,
        references=(
            Reference("random", -8.931549, _EXACT),
            Reference("memoryless", 183.190148, _COORDINATES),
            Reference("lower", 224.43, _BEST_KNOWN),
            Reference("upper", 242.235831, _CENTRALISED),
            Reference("dissertation", 77.65, _DEC_SBPR),
            Reference("mcem", 59.95, _MCEM),
            Reference("mc-jesp", 223.84, _MC_JESP),
        ),
        kind="parallel-tabular",
    ),
    Entry(
        id="bnprl/MarsRovers-v0",
        summary="two rovers experiment at four sites, at two of them best with both drills",
        factory="bnprl_envs.benchmarks.mars_rovers:mars_rovers",
        horizon=100,
        discount=0.9,
        references=(
            Reference("random", -13.289684, _EXACT),
            Reference("memoryless", 21.710312, _COORDINATES),
            Reference("lower", 26.94, _BEST_KNOWN),
            Reference("upper", 27.77, _CERTIFIED),
            Reference("dissertation", 20.62, _DEC_SBPR),
            Reference("mcem", 8.16, _MCEM),
            Reference("mc-jesp", 26.45, _MC_JESP),
        ),
        kind="parallel-tabular",
    ),
    Entry(
        id="bnprl/GridTraffic-v0",
        summary="a hundred traffic lights must agree on a direction without speaking",
        factory="bnprl_envs.grid_traffic:GridTraffic",
        horizon=100,
        discount=0.9,
        references=(
            Reference("random", 0.159778, _ONE_QUEUE),
            Reference("always-horizontal", 45.0, _ONE_QUEUE),
            Reference("alternating", 73.205503, _ONE_QUEUE),
        ),
        kind="parallel-class",
    ),
)

_TABLE = {row.id: row for row in _ENTRIES}


def environment_ids() -> tuple[str, ...]:
    """Return every registered id, in the order of the table."""
    return tuple(_TABLE)


def entry(id: str) -> Entry:
    """Return the entry of an id.

    Raises:
        ValueError: there is no such id; the message names near misses.
    """
    return find(_TABLE, id)


def model(id: str, **arguments: Any) -> TabularModel:
    """Return the model behind an id.

    Models are immutable, so equal calls may return the same object.

    Args:
        id: for example "bnprl/Hallway-v0".
        **arguments: of the benchmark's function, for example `resetting=True`.

    Raises:
        ValueError: the id is unknown (near misses are named), has no tables, or an argument is
            out of range.
        TypeError: the benchmark does not take such an argument.
    """
    return build(entry(id), arguments)


def scene(id: str, **arguments: Any) -> Scene | None:
    """Return how the states of a model look; None where its benchmark does not say.

    Args:
        id: for example "bnprl/Hallway-v0".
        **arguments: of the benchmark's function, for example `resetting=True`.

    Raises:
        ValueError: the id is unknown (near misses are named), or an argument is out of range.
        TypeError: the benchmark does not take such an argument.
    """
    return entry_scene(entry(id), arguments)


def register_environments() -> None:
    """Register every entry with Gymnasium or PettingZoo; ids already there are left alone."""
    for row in _ENTRIES:
        register(row)
