"""Policy files: one `.npz` archive of plain arrays and one JSON text.

Nothing in a file is executed, no pickle is read, and the memory that reading takes is bounded.
"""

from __future__ import annotations

import contextlib
import errno
import io
import json
import math
import os
import tokenize
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt

Arrays = dict[str, npt.NDArray[Any]]

FILE_LIMIT = 2**31
"""Largest size in bytes of an unpacked policy file."""

INFINITE = {"Infinity": "inf", "-Infinity": "-inf"}
"""How the infinite ends of a Box are written, which are no JSON: first, and now as texts."""

_DAMAGE = (
    ValueError,
    LookupError,
    ArithmeticError,
    TypeError,
    AttributeError,
    EOFError,
    MemoryError,
    RuntimeError,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)
"""What reading a file that holds something else can raise."""


class PolicyFileError(ValueError):
    """A file that does not hold a policy; the message is one line, `FILE: reason`."""


def write_policy(path: str | os.PathLike[str], meta: dict[str, Any], arrays: Arrays) -> None:
    """Write a policy file, which appears by atomic rename.

    Raises:
        ValueError: the description holds a number that is not finite.
        OSError: the file cannot be written.
    """
    text = np.frombuffer(json.dumps(meta, allow_nan=False).encode(), dtype=np.uint8)
    target = Path(path)
    if not target.parent.is_dir():
        raise FileNotFoundError(errno.ENOENT, f"there is no folder {target.parent}", str(target))
    partial = target.with_name(f".{target.name}.{os.getpid()}.partial")
    try:
        with partial.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, meta=text, **arrays)
        partial.replace(target)
    finally:
        partial.unlink(missing_ok=True)


def read_policy(path: str | os.PathLike[str]) -> tuple[dict[str, Any], Arrays]:
    """Read the JSON text and the arrays of a policy file.

    Raises:
        PolicyFileError: the file is no such archive, or unpacks to more than `FILE_LIMIT` bytes.
        OSError: the file cannot be read.
    """
    data = Path(path).read_bytes()
    with refusing_damage(path):
        arrays = _read_archive(data)
        if "meta" not in arrays:
            raise ValueError("it has no description, the array 'meta'")
        meta = json.loads(
            arrays.pop("meta").tobytes(), parse_constant=INFINITE.__getitem__, parse_float=_finite
        )
        if not isinstance(meta, dict):
            raise ValueError("its description is not a JSON object")
    return meta, arrays


@contextlib.contextmanager
def refusing_damage(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turn whatever a damaged file makes its reader raise into one clear error.

    Raises:
        PolicyFileError: names the file and the reason.
    """
    try:
        with np.errstate(invalid="raise"):  # what fits no integer
            yield
    except PolicyFileError:
        raise
    except _DAMAGE as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise PolicyFileError(f"{path}: not a bnprl policy file ({reason})") from error


def describe_space(space: Any) -> Any:
    """Return a Discrete or Box space, or a dict of them, as JSON values.

    Raises:
        ValueError: another kind of space.
    """
    if isinstance(space, Mapping) and not isinstance(space, gym.Space):
        return {"agents": {name: describe_space(part) for name, part in space.items()}}
    if isinstance(space, gym.spaces.Discrete):
        return {"type": "Discrete", "n": int(space.n), "start": int(space.start)}
    if isinstance(space, gym.spaces.Box):
        low, high = _ends(space.low), _ends(space.high)
        return {"type": "Box", "low": low, "high": high, "dtype": str(space.dtype)}
    raise ValueError(f"space {space} cannot be saved: Discrete and Box can")


def build_space(text: Any) -> Any:
    """Return the space that `describe_space` described.

    Raises:
        ValueError: the description is of no such space.
    """
    if "agents" in text:
        return {name: build_space(part) for name, part in text["agents"].items()}
    if text["type"] == "Discrete":
        return gym.spaces.Discrete(text["n"], start=text["start"])
    if text["type"] == "Box":
        dtype = np.dtype(text["dtype"])
        low, high = np.array(text["low"], dtype=dtype), np.array(text["high"], dtype=dtype)
        return gym.spaces.Box(low, high, dtype=dtype.type)
    raise ValueError(f"unknown space {text['type']!r}")


def taken(arrays: Arrays, name: str, shape: tuple[int, ...]) -> npt.NDArray[np.float64]:
    """Return a finite float array of a policy file.

    Raises:
        ValueError: it has another shape, or holds something that is not finite.
    """
    array = np.array(arrays[name], dtype=np.float64)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"{name}: shape {array.shape}, must be {shape} and finite")
    return array


def number(name: str, value: Any, least: float = -math.inf) -> float:
    """Return a number of a policy file's description.

    Raises:
        ValueError: it is none, or below the least that is allowed.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not value >= least:
        raise ValueError(f"{name}: {value!r}, must be a number, at least {least}")
    return float(value)


def count(name: str, value: Any) -> int:
    """Return how often something happened, by a policy file's description.

    Raises:
        ValueError: it is no whole number, or negative.
    """
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**53:
        raise ValueError(f"{name}: {value!r}, must be a whole number, not negative")
    return value


def _finite(text: str) -> float:
    value = float(text)
    if math.isinf(value):
        raise ValueError(f"{text} is not finite")
    return value


def _ends(values: npt.NDArray[Any]) -> Any:
    """A Box's ends as nested lists of numbers, of which infinite ones are texts."""
    if values.ndim:
        return [_ends(part) for part in values]
    return values.item() if np.isfinite(values) else str(float(values))


def _read_archive(data: bytes) -> Arrays:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        size = sum(info.file_size for info in archive.infolist())
        if size > FILE_LIMIT:
            raise ValueError(f"unpacks to {size:,} bytes, more than {FILE_LIMIT:,}")
        for info in archive.infolist():
            with archive.open(info) as member:
                _check_header(info, member)
    with np.load(io.BytesIO(data), allow_pickle=False) as members:
        arrays = {name: members[name] for name in members.files}
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise ValueError(f"{name!r} holds {array[~np.isfinite(array)][0]}")
    return arrays


def _check_header(info: zipfile.ZipInfo, member: IO[bytes]) -> None:
    """Refuse an array whose header promises more than its member holds."""
    version = np.lib.format.read_magic(member)
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(member)
    elif version == (2, 0):
        shape, _, dtype = np.lib.format.read_array_header_2_0(member)
    else:
        raise ValueError(f"array format {version} in {info.filename!r}")
    if dtype.kind not in "biuf" or math.prod(shape) * dtype.itemsize > info.file_size:
        raise ValueError(f"array {info.filename!r} of shape {shape}, {dtype} is not plain data")
