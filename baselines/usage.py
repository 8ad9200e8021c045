"""The one kind of error that the command line shows as one line and exit code 2."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator


class UsageError(Exception):
    """Something the user can put right; the message is one line."""


@contextlib.contextmanager
def usage_errors(*kinds: type[Exception]) -> Iterator[None]:
    """Turn errors within the block into a `UsageError`: the system's and these kinds.

    Without kinds: what bad input raises, values and missing packages.
    """
    bad = kinds or (ValueError, ImportError)
    try:
        yield
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        raise UsageError(f"{where}{error.strerror or error}") from error
    except bad as error:
        raise UsageError(" ".join(str(error).split())) from error
