"""Environments for reinforcement learning, exact where the model is known.

Importing this package registers every id of `bnprl_envs.registry` with Gymnasium or PettingZoo:
`gym.make("bnprl/Hallway-v0")`, `gym.make_vec("bnprl/Hallway-v0", num_envs=64)`,
`pettingzoo.make("parallel", "bnprl/DecTiger-v0")`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from bnprl_envs.model import Names, TabularModel
from bnprl_envs.model_files import ModelFileError, read_model, write_model
from bnprl_envs.registry import entry, environment_ids, model, register_environments
from bnprl_envs.tabular import TabularEnv

if TYPE_CHECKING:
    from bnprl_envs.grid_traffic import GridTraffic, GridTrafficBatch, longer_queue
    from bnprl_envs.inverted_pendulum import InvertedPendulumEnv, InvertedPendulumVectorEnv
    from bnprl_envs.parallel_batch import ParallelBatch
    from bnprl_envs.puddle_world import PuddleWorldEnv, PuddleWorldVectorEnv
    from bnprl_envs.tabular_parallel import TabularParallelBatch, TabularParallelEnv
    from bnprl_envs.tabular_vector import TabularVectorEnv

__all__ = [
    "GridTraffic",
    "GridTrafficBatch",
    "InvertedPendulumEnv",
    "InvertedPendulumVectorEnv",
    "ModelFileError",
    "Names",
    "ParallelBatch",
    "PuddleWorldEnv",
    "PuddleWorldVectorEnv",
    "TabularEnv",
    "TabularModel",
    "TabularParallelBatch",
    "TabularParallelEnv",
    "TabularVectorEnv",
    "entry",
    "environment_ids",
    "longer_queue",
    "model",
    "read_model",
    "write_model",
]

_LAZY = {  # name -> module, imported on request: numba takes longer than all the rest
    "GridTraffic": "grid_traffic",
    "GridTrafficBatch": "grid_traffic",
    "InvertedPendulumEnv": "inverted_pendulum",
    "InvertedPendulumVectorEnv": "inverted_pendulum",
    "ParallelBatch": "parallel_batch",
    "PuddleWorldEnv": "puddle_world",
    "PuddleWorldVectorEnv": "puddle_world",
    "TabularParallelBatch": "tabular_parallel",
    "TabularParallelEnv": "tabular_parallel",
    "TabularVectorEnv": "tabular_vector",
    "longer_queue": "grid_traffic",
}

register_environments()


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(f"bnprl_envs.{_LAZY[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
