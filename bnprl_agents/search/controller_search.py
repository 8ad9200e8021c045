"""Search for the best deterministic controllers of a team, from a simulator alone."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from bnprl_agents.agent import Metrics
from bnprl_agents.controllers.controller import Controller, uniform_controller
from bnprl_agents.controllers.learner import ControllerAgent
from bnprl_agents.episodes import BoolArray, EpisodeBatch
from bnprl_agents.policy_files import Arrays
from bnprl_agents.search.best_response import respond_in_turn
from bnprl_agents.search.climbing import BATCH, Climber
from bnprl_agents.search.leaderboard import Leaderboard
from bnprl_agents.search.looking_around import LOOKS, observations_met
from bnprl_agents.search.memory import MemoryShape, random_tables, remembering_more, shapes
from bnprl_agents.search.moves import ACT, BRANCH, REDIRECT
from bnprl_agents.search.roles import shared_roles
from bnprl_agents.search.settings import ControllerSearchConfig
from bnprl_agents.search.simulator import (
    BudgetedSimulator,
    BudgetSpentError,
    TeamSimulator,
    UInt64Array,
    simulator_of,
)
from bnprl_agents.search.tables import DecisionTables
from bnprl_agents.search.walking import kicked, walk
from bnprl_agents.training import Budget, Progress

SHARES = {"explore": 1, "walk": 3, "refine": 1, "polish": 1}
"""Parts of the simulated steps that each activity gets."""


class ControllerSearch(ControllerAgent):
    """Local search over deterministic controllers, scored by simulated episodes.

    Four activities share the simulated steps by `SHARES`. *Explore*: a random memory (a clock's
    phase and the last observations, `MemoryShape`) with random actions; in half of the cases the
    agents respond to each other in turn, each by value iteration on what it met while exploring,
    until nobody gains; then single actions are climbed. *Walk*: within one memory an agent's
    actions are disturbed and all respond again. *Refine*: the best restart becomes free
    controllers, whose every action and successor is climbed, new nodes included. *Polish*: a good
    team is disturbed, or its nodes split by the last observation, and is refined again. All
    comparisons are paired on common random numbers, and candidates race by successive halving.
    It needs a simulator that can be reset by seeds, and never sees a model's tables;
    `train` makes one of the environment.

    Related: Amato, Bernstein and Zilberstein, JAAMAS 21, 2010 (controllers for Dec-POMDPs);
    Pajarinen and Peltonen, NIPS 2011 (periodic controllers); Ng and Jordan, UAI 2000 (common
    random numbers, PEGASUS); Lourenco, Martin and Stutzle 2003 (iterated local search).

    Attributes:
        elites: refined teams, best first.
        restarts: climbed restarts and walks that wait for refinement, best first.
        walks: where the walk within each memory has come, best first.
        known_again: how many of the last restarts and walks came to known values only. Refinement
            waits for `candidates` restarts, or for so many that bring nothing new.
        spent: simulated steps of each activity.
    """

    Config = ControllerSearchConfig
    config: ControllerSearchConfig

    def __init__(
        self,
        observation_space: Any,
        action_space: Any,
        config: Any = None,
        *,
        discount: float,
        seed: int,
    ) -> None:
        super().__init__(observation_space, action_space, config, discount=discount, seed=seed)
        self.roles, members = shared_roles(
            self.spaces.action_sizes, self.spaces.observation_sizes, self.config.largest_team
        )
        self.role_actions = np.array(self.spaces.action_sizes)[members]
        self.role_observations = np.array(self.spaces.observation_sizes)[members]
        self.judges = self._seeds(self.config.judge_seeds)
        sizes = (self.config.nodes, int(self.role_observations.max()))
        self.seen: BoolArray = np.zeros((len(members), sizes[1]), dtype=np.bool_)
        self.restarts = Leaderboard.empty(self.roles, *sizes)
        self.walks = Leaderboard.empty(self.roles, *sizes)
        self.elites = Leaderboard.empty(self.roles, *sizes)
        self.known_again = 0
        self.spent = dict.fromkeys(SHARES, 0)

    @property
    def batch_episodes(self) -> int:
        """One: the first finished episode tells that `learn` refuses episodes."""
        return 1

    def initial_controllers(self) -> tuple[Controller, ...]:
        """One node with uniform actions."""
        return tuple(
            map(uniform_controller, self.spaces.action_sizes, self.spaces.observation_sizes)
        )

    def learn(self, episodes: EpisodeBatch) -> Metrics:
        """Refuse: episodes alone cannot be replayed.

        Raises:
            RuntimeError: always.
        """
        raise RuntimeError(
            f"ControllerSearch cannot learn from {episodes.n_episodes} recorded episodes: call "
            "improve(simulator), or train(), which makes a simulator of the environment"
        )

    def train_in(self, env: Any, budget: Budget, seed: int) -> Iterator[Progress]:
        """Improve on a simulator of the environment; see `Agent.train_in`.

        Raises:
            ValueError: as `simulator_of`.
        """
        return self._improving(simulator_of(env, self.discount), budget)

    def _improving(self, simulator: TeamSimulator, budget: Budget) -> Iterator[Progress]:
        """Improve until a simulation would pass the budget; an episode counts its whole horizon."""
        limit = budget.steps or (budget.episodes or 0) * simulator.horizon
        budgeted = BudgetedSimulator(simulator, limit)
        try:
            while True:
                metrics = self.improve(budgeted, limit - simulator.steps)
                yield Progress(simulator.episodes, simulator.steps, metrics)
        except BudgetSpentError:
            yield Progress(simulator.episodes, simulator.steps)

    def first_update_episodes(self, env: Any) -> int:
        """Return those of looking around, a heat of all moves on all seeds, and two judgements."""
        seeds = LOOKS + BATCH * self.config.explore_seeds + 2 * self.config.judge_seeds
        return seeds * simulator_of(env, self.discount).copies

    def improve(self, simulator: TeamSimulator, steps: int) -> Metrics:
        """Spend some steps on the activity that has had the fewest, and adopt the best team.

        Args:
            simulator: of the environment; all randomness comes from seeds drawn here.
            steps: within which a climb is broken off, so that what it found can be judged.

        Returns:
            value: judged value of the controllers; nodes: of the largest one; and for each
            activity `<name>_steps`, which it has had so far.

        Raises:
            ValueError: the simulator has other action or observation sizes than the agent.
        """
        self._check_fit(simulator)
        begin = simulator.steps
        if not self.seen.any():
            self.seen = observations_met(
                simulator,
                self.roles,
                self.role_actions,
                self.seen.shape[1],
                self.config.nodes,
                self.rng,
            )
        activity = self._next_activity()
        act = {
            "explore": self._explore,
            "walk": self._walk,
            "refine": self._refine,
            "polish": self._polish,
        }[activity]
        act(simulator, begin + steps - 2 * self.config.judge_seeds * simulator.horizon)
        self.spent[activity] += simulator.steps - begin
        board = self.elites if self.elites.values.size else self.restarts
        self.controllers = board.teams.candidate(0).controllers(
            self.spaces.action_sizes, self.spaces.observation_sizes
        )
        self.explore = tuple(np.zeros(c.n_nodes) for c in self.controllers)
        return {
            "value": float(board.values[0]),
            "nodes": float(max(c.n_nodes for c in self.controllers)),
            **{f"{name}_steps": float(taken) for name, taken in self.spent.items()},
        }

    def _next_activity(self) -> str:
        possible = ["explore"]
        if self.role_actions.size == self.roles.size:  # agents that share tables cannot respond
            possible.append("walk")
        full = self.restarts.values.size == self.config.candidates
        if full or (self.restarts.values.size and self.known_again >= self.config.candidates):
            possible.append("refine")
        if self.elites.values.size:
            possible.append("polish")
        return min(possible, key=lambda name: self.spent[name] / SHARES[name])

    def _explore(self, simulator: TeamSimulator, limit: int) -> None:
        """Climb the actions of a random memory; keep the result if it is among the best."""
        label = int(self.rng.integers(len(self._shapes())))
        if self.restarts.labels.size and self.rng.random() < 0.5:
            label = int(self.rng.choice(self.restarts.labels))
        team = self._random_team(label)
        team = self._climbed(simulator, team, (ACT,), self.config.explore_seeds, limit)
        self._keep(simulator, team, label)

    def _walk(self, simulator: TeamSimulator, limit: int) -> None:
        """Walk on within one memory; keep the best on the way if it is among the best restarts."""
        walking = self.walks.labels
        fresh = np.setdiff1d(np.arange(len(self._shapes())), walking)
        if fresh.size:
            label = int(self.rng.choice(fresh))
            team = self._random_team(label)
        else:  # the best walk, or any of the better half
            half = 1 if self.rng.random() < 0.5 else (walking.size + 1) // 2
            rank = int(self.rng.integers(half))
            label, team = int(walking[rank]), self.walks.teams.candidate(rank)
        seeds = self._seeds(self.config.explore_seeds)
        here, best = walk(simulator, team, seeds, self.discount, self.rng)
        self.walks = self.walks.moved(here.team, here.value, label)
        self._keep(simulator, best.team, label)

    def _keep(self, simulator: TeamSimulator, team: DecisionTables, label: int) -> None:
        """Judge a climbed restart; keep it if it is among the best."""
        value = self._judged(simulator, team, self.config.judge_seeds // 8)
        restarts = self.restarts.added(team, value, label, self.config.candidates)
        self.known_again = self.known_again + 1 if restarts is self.restarts else 0
        self.restarts = restarts

    def _refine(self, simulator: TeamSimulator, limit: int) -> None:
        """Climb everything of the best restart, which leaves the restarts."""
        label = int(self.restarts.labels[0])
        team = self._refined(simulator, self.restarts.teams.candidate(0), limit)
        self.restarts = self.restarts.without(0)
        value = self._judged(simulator, team, self.config.judge_seeds)
        self.elites = self.elites.added(team, value, label, self.config.elites)

    def _polish(self, simulator: TeamSimulator, limit: int) -> None:
        """Disturb a good team, or let it remember more, and climb again; keep what is better."""
        rank = min(int(self.rng.geometric(0.5)), self.elites.values.size) - 1
        label = int(self.elites.labels[rank])
        team = self.elites.teams.candidate(rank)
        grows = self.rng.random() < 0.5
        if grows:
            team = remembering_more(team)
        else:
            team = kicked(simulator, team, self.role_actions, self.config.kicks, self.rng)
        team = self._refined(simulator, team, limit)
        value = self._judged(simulator, team, self.config.judge_seeds)
        if value > self.elites.values[rank]:
            self.elites = self.elites.without(rank).added(team, value, label, self.config.elites)

    def _refined(
        self, simulator: TeamSimulator, team: DecisionTables, limit: int
    ) -> DecisionTables:
        kinds = (ACT, REDIRECT, BRANCH)
        return self._climbed(simulator, team, kinds, self.config.refine_seeds, limit)

    def _climbed(
        self,
        simulator: TeamSimulator,
        team: DecisionTables,
        kinds: tuple[int, ...],
        size: int,
        limit: int,
    ) -> DecisionTables:
        """Climb by some kinds of moves, in half of the cases after responses in turn.

        Responses change much at once, but lead most starts to the same few equilibria.
        """
        seeds = self._seeds(size)
        if self.rng.random() < 0.5:
            team = respond_in_turn(simulator, team, seeds, self.discount, self.rng)
        climber = Climber(simulator, self.role_actions, kinds, self.config.patience, limit)
        return climber.climb(team, seeds, self.rng)

    def _judged(self, simulator: TeamSimulator, team: DecisionTables, seeds: int) -> float:
        """Mean return on the seeds that judge every team."""
        return float(simulator.returns(team, self.judges[: max(1, seeds)]).mean())

    def _random_team(self, label: int) -> DecisionTables:
        """Random actions on the memory of a label."""
        shape = self._shapes()[label]
        return random_tables(
            shape, self.roles, self.role_actions, self.seen, self.config.nodes, self.rng
        )

    def _shapes(self) -> list[MemoryShape]:
        return shapes(
            int(self.seen.sum(axis=1).max()),
            self.config.longest_period,
            self.config.widest_window,
            self.config.nodes,
        )

    def _seeds(self, size: int) -> UInt64Array:
        return self.rng.integers(2**64, size=size, dtype=np.uint64)

    def _check_fit(self, simulator: TeamSimulator) -> None:
        for name in ("action_sizes", "observation_sizes"):
            wanted, found = getattr(self.spaces, name), getattr(simulator, name)
            if wanted != found:
                raise ValueError(f"simulator: {name} {found}, the agent has {wanted}")

    def state_arrays(self) -> Arrays:
        """Controllers, teams, judging seeds and the observations met."""
        own = {"judges": self.judges, "met": self.seen}
        boards = self.restarts.state_arrays("restarts") | self.elites.state_arrays("elites")
        boards |= self.walks.state_arrays("walks")
        return super().state_arrays() | own | boards

    def counters(self) -> dict[str, Any]:
        """How many restarts brought nothing new, and the steps spent on each activity."""
        return {"known_again": self.known_again, "spent": self.spent}

    def restore(self, arrays: Arrays, counters: dict[str, Any]) -> None:
        """Take over a saved state; see `Agent.restore`."""
        super().restore(arrays, counters)
        self.judges, self.seen = arrays["judges"], arrays["met"]
        self.restarts = self.restarts.restored("restarts", arrays, self.role_actions)
        self.walks = self.walks.restored("walks", arrays, self.role_actions)
        self.elites = self.elites.restored("elites", arrays, self.role_actions)
        self.known_again = int(counters["known_again"])
        self.spent = {name: int(counters["spent"][name]) for name in SHARES}
