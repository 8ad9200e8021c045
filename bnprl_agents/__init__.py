"""Agents that learn Bayesian nonparametric policies and value functions."""

from bnprl_agents.agent import Agent, load
from bnprl_agents.belief.predictive_actor_critic import (
    PredictiveActorCritic,
    PredictiveActorCriticConfig,
)
from bnprl_agents.controllers.actor_critic import ActorCritic, ActorCriticConfig
from bnprl_agents.controllers.controller import Controller, random_controller
from bnprl_agents.controllers.em import BatchEM, BatchEMConfig
from bnprl_agents.controllers.infinite import InfiniteRPR
from bnprl_agents.controllers.infinite_settings import InfiniteRPRConfig
from bnprl_agents.controllers.mcem import MonteCarloEM, MonteCarloEMConfig
from bnprl_agents.controllers.messages import Counts, soft_counts
from bnprl_agents.controllers.online_em import OnlineEM, OnlineEMConfig
from bnprl_agents.controllers.rollout import rollout
from bnprl_agents.controllers.scoring import simulated_returns
from bnprl_agents.controllers.stick_breaking import StickBreaking, StickBreakingConfig
from bnprl_agents.controllers.value import controller_value
from bnprl_agents.controllers.variational import VariationalBayes, VariationalBayesConfig
from bnprl_agents.episodes import EpisodeBatch
from bnprl_agents.gaussian_process.gp_fitted_q import GPFittedQ, GPFittedQConfig
from bnprl_agents.gaussian_process.gp_q import GPQ, GPQConfig, OptimisticGPQConfig
from bnprl_agents.gaussian_process.kernels import RadialKernel
from bnprl_agents.gaussian_process.sparse_gp import SparseGP
from bnprl_agents.policy_files import PolicyFileError
from bnprl_agents.q_learning.linear_q import GQ, GQConfig, LinearQ, LinearQConfig
from bnprl_agents.q_learning.tabular_q import TabularQ, TabularQConfig
from bnprl_agents.random_agent import RandomAgent, RandomConfig
from bnprl_agents.search.controller_search import ControllerSearch
from bnprl_agents.search.settings import ControllerSearchConfig
from bnprl_agents.search.simulator import TeamSimulator, simulator_of
from bnprl_agents.training import Progress, train

__all__ = [
    "GPQ",
    "GQ",
    "ActorCritic",
    "ActorCriticConfig",
    "Agent",
    "BatchEM",
    "BatchEMConfig",
    "Controller",
    "ControllerSearch",
    "ControllerSearchConfig",
    "Counts",
    "EpisodeBatch",
    "GPFittedQ",
    "GPFittedQConfig",
    "GPQConfig",
    "GQConfig",
    "InfiniteRPR",
    "InfiniteRPRConfig",
    "LinearQ",
    "LinearQConfig",
    "MonteCarloEM",
    "MonteCarloEMConfig",
    "OnlineEM",
    "OnlineEMConfig",
    "OptimisticGPQConfig",
    "PolicyFileError",
    "PredictiveActorCritic",
    "PredictiveActorCriticConfig",
    "Progress",
    "RadialKernel",
    "RandomAgent",
    "RandomConfig",
    "SparseGP",
    "StickBreaking",
    "StickBreakingConfig",
    "TabularQ",
    "TabularQConfig",
    "TeamSimulator",
    "VariationalBayes",
    "VariationalBayesConfig",
    "controller_value",
    "load",
    "random_controller",
    "rollout",
    "simulated_returns",
    "simulator_of",
    "soft_counts",
    "train",
]
