"""How the cost of learning grows with the number of agents and the length of episodes.

`python -m baselines.benchmarks.team_scaling` times `StickBreaking.learn` on recorded episodes of 2
to 1,000 agents, prints CPU microseconds for each agent and episode, and seconds by T; it exits 1
where the cost for each agent and episode differs by more than half between team sizes, or where
doubling T costs more than 2.5 times as much. Then `ControllerSearch` learns grid traffic of 10,000
agents, and the largest memory of the process is shown.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time

import numpy as np

from bnprl_agents import ControllerSearch, StickBreaking, train
from bnprl_agents.controllers.stick_breaking import StickBreakingConfig
from bnprl_agents.episodes import EpisodeBatch
from bnprl_envs import GridTrafficBatch
from bnprl_envs.names import agent_names
from bnprl_envs.team import agent_spaces, team_spaces

ACTIONS, OBSERVATIONS, EPISODES, STEPS = 3, 5, 100, 50
TEAMS = (2, 10, 100, 1000)
SPREAD, DOUBLING = 1.5, 2.5
"""Largest ratio of costs between team sizes, and of a doubling of T."""
