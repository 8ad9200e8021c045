"""Environments for reinforcement learning, exact where the model is known.

Importing this package registers every id of `bnprl_envs.registry` with Gymnasium:
`gym.make("bnprl/Hallway-v0")`, `gym.make_vec("bnprl/Hallway-v0", num_envs=64)`.
"""

from typing import TYPE_CHECKING, Any

from bnprl_envs.model import Names, TabularModel
from bnprl_envs.model_files import ModelFileError, read_model, write_model
from bnprl_envs.registry import entry, environment_ids, model, register_environments
from bnprl_envs.tabular import TabularEnv

if TYPE_CHECKING:
    from bnprl_envs.tabular_vector import TabularVectorEnv

__all__ = [
    "ModelFileError",
    "Names",
    "TabularEnv",
    "TabularModel",
    "TabularVectorEnv",
    "entry",
    "environment_ids",
    "model",
    "read_model",
    "write_model",
]

register_environments()


def __getattr__(name: str) -> Any:
    if name == "TabularVectorEnv":  # imports numba, which takes longer than all the rest
        from bnprl_envs.tabular_vector import TabularVectorEnv

        return TabularVectorEnv
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
