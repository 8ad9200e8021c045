"""Scalars in TensorBoard's format."""

from __future__ import annotations

import contextlib
import importlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from baselines.contenders import MissingExtraError

Write = Callable[[str, Mapping[str, float], int], None]
"""Writes named numbers under a heading at a number of environment steps."""


@contextlib.contextmanager
def scalar_writer(folder: Path | None) -> Iterator[Write]:
    """Open a log for the block; without a folder nothing is written.

    Raises:
        MissingExtraError: TensorBoard is not installed.
    """
    if folder is None:
        yield lambda heading, numbers, steps: None
        return
    try:
        writer = importlib.import_module("tensorboard.summary").Writer(str(folder))
    except ImportError as error:
        raise MissingExtraError(
            'tensorboard is not installed: pip install "bnprl[baselines]"'
        ) from error

    def write(heading: str, numbers: Mapping[str, float], steps: int) -> None:
        for name, number in numbers.items():
            writer.add_scalar(f"{heading}/{name}", number, steps)

    try:
        yield write
    finally:
        writer.close()
