"""Checks of what constructors and `step` are given, shared by the environments."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real
from operator import index
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode

from bnprl_envs.tables import BoolArray

IntArray = npt.NDArray[np.int64]


def checked_count(name: str, value: int) -> int:
    """Return a count of things.

    Raises:
        ValueError: it is no integer, or below 1.
    """
    try:
        number = index(value)
    except TypeError:
        number = 0
    if number < 1:
        raise ValueError(f"{name}: {value!r}, must be an integer, at least 1")
    return number


def checked_limit(limit: int | None, name: str = "max_episode_steps") -> int | None:
    """Return the number of steps of an episode, None for no limit.

    Raises:
        ValueError: it is neither None nor an integer of at least 1.
    """
    return None if limit is None else checked_count(name, limit)


def checked_probability(name: str, value: float) -> float:
    """Return a probability.

    Raises:
        ValueError: it is no number in [0, 1].
    """
    if not isinstance(value, Real) or not 0.0 <= value <= 1.0:
        raise ValueError(f"{name}: {value!r}, must lie in [0, 1]")
    return float(value)


def checked_discount(discount: float) -> float:
    """Return the factor of the values.

    Raises:
        ValueError: it is no number in (0, 1].
    """
    if not isinstance(discount, Real) or not 0.0 < discount <= 1.0:
        raise ValueError(f"discount: {discount!r}, must lie in (0, 1]")
    return float(discount)


def checked_flag(name: str, value: bool) -> bool:
    """Return a flag.

    Raises:
        ValueError: it is neither True nor False.
    """
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name}: {value!r}, must be True or False")
    return bool(value)


def check_render_mode(render_mode: str | None) -> None:
    """Check the mode of a batch, which is not drawn.

    Raises:
        ValueError: it is not None.
    """
    if render_mode is not None:
        raise ValueError(
            f"render_mode: {render_mode!r}, must be None: batches are not drawn, one copy is"
        )


def checked_render_mode(render_mode: str | None, modes: Sequence[str]) -> str | None:
    """Return the mode of an environment that can be looked at.

    Raises:
        ValueError: it is neither None nor one of `modes`.
    """
    if render_mode is not None and render_mode not in modes:
        allowed = ", ".join(map(repr, modes))
        raise ValueError(f"render_mode: {render_mode!r}, must be None or one of {allowed}")
    return render_mode


def checked_autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """Return the mode.

    Raises:
        ValueError: there is no mode of that name.
    """
    try:
        return AutoresetMode(mode)
    except ValueError:
        allowed = ", ".join(repr(known.value) for known in AutoresetMode)
        raise ValueError(f"autoreset_mode: {mode!r}, must be one of {allowed}") from None


def checked_noise(noise: float, largest: float) -> float:
    """Return the size of a noise.

    Raises:
        ValueError: it is no number in [0, largest].
    """
    if not isinstance(noise, Real) or not 0.0 <= noise <= largest:
        raise ValueError(f"noise: {noise!r}, must lie in [0, {largest:g}]")
    return float(noise)


def checked_action(action: Any, n_actions: int) -> int:
    """Return the action as an int.

    Raises:
        ValueError: it is not an integer in {0, ..., n_actions - 1}.
    """
    try:
        number = index(action)
    except TypeError:
        number = -1
    if not 0 <= number < n_actions:
        raise ValueError(f"action {action!r} is not an integer in [0, {n_actions - 1}]")
    return number


def checked_actions(actions: npt.ArrayLike, n_actions: int, ignored: BoolArray) -> IntArray:
    """Return the actions of a batch as a contiguous int64 array; ignored ones may be anything.

    Args:
        actions: (copies,) integers.
        n_actions: A.
        ignored: (copies,) whether the action of a copy does not matter.

    Raises:
        ValueError: another shape or type, or an action is not one; the message names the copy.
    """
    array = np.asarray(actions)
    if array.shape != ignored.shape or array.dtype.kind not in "iu":
        raise ValueError(
            f"actions: shape {array.shape} of {array.dtype}, must be ({ignored.size},) of integers"
        )
    array = np.ascontiguousarray(array, dtype=np.int64)
    wrong = array.view(np.uint64) >= n_actions  # negative ones are huge
    if wrong.any():
        wrong &= ~ignored
        if wrong.any():
            copy = int(np.argmax(wrong))
            raise ValueError(f"action {array[copy]} of copy {copy} is not in [0, {n_actions - 1}]")
    return array


def checked_mask(mask: Any, num_envs: int) -> BoolArray:
    """Return the `reset_mask` of a batch.

    Raises:
        TypeError: it is no array of booleans.
        ValueError: it has another shape or chooses no copy.
    """
    if not isinstance(mask, np.ndarray) or mask.dtype != np.bool_:
        kind = mask.dtype if isinstance(mask, np.ndarray) else type(mask).__name__
        raise TypeError(f"options['reset_mask'] must be an array of bool, got {kind}")
    if mask.shape != (num_envs,):
        raise ValueError(f"options['reset_mask']: shape {mask.shape}, must be ({num_envs},)")
    if not mask.any():
        raise ValueError("options['reset_mask'] chooses no copy; at least one must be True")
    return mask
