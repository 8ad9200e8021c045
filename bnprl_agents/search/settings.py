"""Settings of the search for controllers."""

from __future__ import annotations

from dataclasses import dataclass

from bnprl_agents.settings import Settings

MOST = 1_000_000
"""Of every setting: a policy file may come from anybody, and its seeds are drawn to read it."""


@dataclass(frozen=True)
class ControllerSearchConfig(Settings):
    """Settings of `ControllerSearch`; the same serve every problem of the suite."""

    nodes: int = 64
    """Largest number of nodes of a controller."""
    longest_period: int = 6
    """Longest period of the clock that a restart may remember."""
    widest_window: int = 2
    """Most observations that a restart may remember."""
    explore_seeds: int = 128
    """Episodes on which the actions of a restart are climbed."""
    refine_seeds: int = 512
    """Episodes on which whole controllers are climbed."""
    judge_seeds: int = 4096
    """Episodes on which finished climbs are compared; restarts by an eighth of them."""
    candidates: int = 16
    """Best restarts that are kept for refinement, which waits for so many."""
    elites: int = 4
    """Best refined teams that are kept for polishing."""
    patience: int = 1024
    """Moves in a row that may fail before a climb of whole controllers ends."""
    kicks: int = 3
    """Most random moves with which polishing begins."""
    largest_team: int = 8
    """Agents of a larger team share one controller where their spaces are equal."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, value in vars(self).items():
            least = 0 if name == "widest_window" else 1
            if not least <= value <= MOST:
                raise ValueError(f"{name}: {value}, must be at least {least} and at most {MOST:,}")
