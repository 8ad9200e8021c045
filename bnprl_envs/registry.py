"""The one table of environments: id, factory, horizon, discount.

A new benchmark is one file in `bnprl_envs.benchmarks`, one entry here, and the values that are
known of it in `bnprl_envs.references`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from bnprl_envs.model import TabularModel
from bnprl_envs.references import REFERENCES, Reference
from bnprl_envs.registration import Entry, Kind, build, find, register
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

_ENTRIES = (
    Entry(
        id="bnprl/Gridworld-v0",
        summary="walk across an open grid whose cells are seen",
        factory="bnprl_envs.benchmarks.gridworld:gridworld",
        horizon=200,
        discount=0.9,
    ),
    Entry(
        id="bnprl/InvertedPendulum-v0",
        summary="keep a pole upright on a cart that is pushed",
        factory="bnprl_envs.inverted_pendulum:InvertedPendulumEnv",
        vector_factory="bnprl_envs.inverted_pendulum:InvertedPendulumVectorEnv",
        horizon=3000,
        discount=0.95,
        kind="class",
    ),
    Entry(
        id="bnprl/PuddleWorld-v0",
        summary="cross a square to its far corner around two puddles",
        factory="bnprl_envs.puddle_world:PuddleWorldEnv",
        vector_factory="bnprl_envs.puddle_world:PuddleWorldVectorEnv",
        horizon=1000,
        discount=0.99,
        kind="class",
    ),
    Entry(
        id="bnprl/BairdStar-v0",
        summary="seven states without rewards on which linear Q-learning diverges",
        factory="bnprl_envs.benchmarks.baird_star:baird_star",
        horizon=1000,
        discount=0.99,
    ),
    Entry(
        id="bnprl/ThreeNodes-v0",
        summary="three nodes without rewards on which fitted Q-iteration may diverge",
        factory="bnprl_envs.benchmarks.three_nodes:three_nodes",
        horizon=100,
        discount=0.9999,
    ),
    Entry(
        id="bnprl/Shuttle-v0",
        summary="shuttle docks backwards at two space stations in turn",
        factory="bnprl_envs.benchmarks.shuttle:shuttle",
        horizon=251,
        discount=0.95,
    ),
    Entry(
        id="bnprl/CheeseMaze-v0",
        summary="mouse looks for the cheese among cells that look alike",
        factory="bnprl_envs.benchmarks.cheese_maze:cheese_maze",
        horizon=251,
        discount=0.95,
    ),
    Entry(
        id="bnprl/Grid4x4-v0",
        summary="find the corner of an open grid without seeing anything",
        factory="bnprl_envs.benchmarks.grid4x4:grid4x4",
        horizon=251,
        discount=0.95,
    ),
    Entry(
        id="bnprl/NoisyMaze1D-v0",
        summary="find one of four cells in a row with noisy moves, without seeing anything",
        factory="bnprl_envs.benchmarks.noisy_maze:noisy_maze_1d",
        horizon=251,
        discount=0.75,
    ),
    Entry(
        id="bnprl/Tiger-v0",
        summary="listen for the tiger, then open the other door",
        factory="bnprl_envs.benchmarks.tiger:tiger",
        horizon=251,
        discount=0.95,
    ),
    Entry(
        id="bnprl/Hallway-v0",
        summary="robot with noisy wall sensors looks for one room of an office corridor",
        factory="bnprl_envs.benchmarks.hallway:hallway",
        horizon=251,
        discount=0.95,
    ),
    Entry(
        id="bnprl/Hallway2-v0",
        summary="robot with noisy wall sensors looks for one room of a building without landmarks",
        factory="bnprl_envs.benchmarks.hallway:hallway2",
        horizon=251,
        discount=0.95,
    ),
    Entry(
        id="bnprl/Tag-v0",
        summary="robot hunts an opponent that it sees only when they share a cell",
        factory="bnprl_envs.benchmarks.tag:tag",
        horizon=251,
        discount=0.95,
    ),
    Entry(
        id="bnprl/DecTiger-v0",
        summary="two agents listen for a tiger, and must open the same door without speaking",
        factory="bnprl_envs.benchmarks.dec_tiger:dec_tiger",
        horizon=100,
        discount=0.9,
        kind="parallel-tabular",
    ),
    Entry(
        id="bnprl/BroadcastChannel-v0",
        summary="two senders share a line that carries one message at a time",
        factory="bnprl_envs.benchmarks.broadcast_channel:broadcast_channel",
        horizon=100,
        discount=0.9,
        kind="parallel-tabular",
    ),
    Entry(
        id="bnprl/RecyclingRobots-v0",
        summary="two robots collect cans, big ones together, and must not run out of battery",
        factory="bnprl_envs.benchmarks.recycling_robots:recycling_robots",
        horizon=100,
        discount=0.9,
        kind="parallel-tabular",
    ),
    Entry(
        id="bnprl/MeetingGrid-v0",
        summary="two robots that do not see each other try to meet in a corner",
        factory="bnprl_envs.benchmarks.meeting_grid:meeting_grid",
        horizon=100,
        discount=0.9,
        kind="parallel-tabular",
    ),
    Entry(
        id="bnprl/BoxPushing-v0",
        summary="two robots push a small box each, or better a large one together",
        factory="bnprl_envs.benchmarks.box_pushing:box_pushing",
        horizon=100,
        discount=0.9,
        kind="parallel-tabular",
    ),
    Entry(
        id="bnprl/MarsRovers-v0",
        summary="two rovers experiment at four sites, at two of them best with both drills",
        factory="bnprl_envs.benchmarks.mars_rovers:mars_rovers",
        horizon=100,
        discount=0.9,
        kind="parallel-tabular",
    ),
    Entry(
        id="bnprl/GridTraffic-v0",
        summary="a hundred traffic lights must agree on a direction without speaking",
        factory="bnprl_envs.grid_traffic:GridTraffic",
        vector_factory="bnprl_envs.grid_traffic_batch:GridTrafficBatch",
        horizon=100,
        discount=0.9,
        kind="parallel-class",
    ),
)

_TABLE = {row.id: replace(row, references=REFERENCES[row.id]) for row in _ENTRIES}


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
