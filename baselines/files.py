"""Files and folders that survive a crash, a second command and a stranger's hand."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

try:
    import fcntl
except ImportError:  # not a POSIX system
    fcntl = None  # type: ignore[assignment]

WINDOWS_DEVICES = {"CON", "PRN", "AUX", "NUL"} | {
    f"{d}{i}" for d in ("COM", "LPT") for i in range(10)
}
"""Names that no file there may have, whatever follows a dot."""


class FolderInUseError(RuntimeError):
    """Another command is writing to the same folder."""


def parse_json(text: bytes) -> Any:
    """Return the JSON value of a text, None if it is not JSON or holds NaN or an infinity.

    A number too large for a float, such as 1e400, is an infinity.
    """
    try:
        return json.loads(text, parse_constant=_finite, parse_float=_finite)
    except (ValueError, RecursionError):
        return None


def _finite(text: str) -> float:
    """Return a number, or raise ValueError."""
    if not math.isfinite(value := float(text)):
        raise ValueError(f"{text} is not JSON")
    return value


def check_name(name: str) -> str:
    """Return a name that may become a folder, on every system.

    Raises:
        ValueError: it may not.
    """
    if name.endswith(".") or name.partition(".")[0].upper() in WINDOWS_DEVICES:
        raise ValueError(f"name {name!r}: Windows has no folder of this name")
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._+-]{0,99}", name):
        raise ValueError(f"name {name!r}: letters, digits and . _ + - only, at most 100")
    return name


def write_atomic(path: Path, data: str | bytes) -> None:
    """Write a file that appears by rename, whole or not at all.

    Raises:
        OSError: it cannot be written; the error names it.
    """
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with partial.open("wb") as file:
            file.write(data.encode() if isinstance(data, str) else data)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        partial.unlink(missing_ok=True)


@contextlib.contextmanager
def folder_lock(folder: Path) -> Iterator[None]:
    """Hold a folder against other commands; the lock dies with the process.

    Raises:
        FolderInUseError: another process holds it.
        OSError: the folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / ".lock").open("ab") as file:
        if not lock_file(file, wait=False):
            raise FolderInUseError(f"{folder}: another bnprl command is writing to this folder")
        yield


def lock_file(file: BinaryIO, *, wait: bool) -> bool:
    """Lock a file until it is closed; always true where the system has no `flock`."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    return True
