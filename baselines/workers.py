"""What runs are spread over: processes here, or a cluster of Dask or Ray, all through joblib."""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import joblib

from baselines.contenders import MissingExtraError

BREAKS = 3
"""Times that an engine may break, as when a worker of it is killed, before that is an error."""

Item = TypeVar("Item")
Result = TypeVar("Result")

_log = logging.getLogger(__name__)


class EngineError(RuntimeError):
    """An engine that cannot be reached, or that broke again and again."""


@dataclass(frozen=True)
class Workers:
    """What runs are spread over.

    Attributes:
        jobs: runs at the same time; on a cluster that is there already it decides.
        engine: "joblib" (processes here), "ray" or "dask".
        address: of a cluster that is there already; without it one is started here.

    Raises:
        ValueError: fewer than one job, or an address for the processes here.
    """

    jobs: int = 1
    engine: Literal["joblib", "ray", "dask"] = "joblib"
    address: str | None = None

    def __post_init__(self) -> None:
        if self.jobs < 1:
            raise ValueError(f"--jobs: {self.jobs}, must be at least 1")
        if self.address is not None and self.engine == "joblib":
            raise ValueError("--address: wants --engine ray or --engine dask")

    def map(
        self,
        do: Callable[[Item], Result],
        items: Sequence[Item],
        finished: Callable[[Item], bool],
    ) -> list[Result | None]:
        """Do every item, going on when the engine breaks with those that are not finished.

        Args:
            do: what raises nothing of its own, so that what is raised is the engine's.
            items: what it is done to.
            finished: whether an item needs no more of it.

        Returns:
            The results in order; None of an item that was finished when its engine broke.

        Raises:
            EngineError: the engine cannot be reached, or broke more than `BREAKS` times.
            MissingExtraError: it is not installed.
        """
        results: list[Result | None] = [None] * len(items)
        for breaks in range(BREAKS + 1):
            left = [i for i, item in enumerate(items) if not finished(item)]
            try:
                with _backend(self, len(left)):
                    done = joblib.Parallel()(joblib.delayed(do)(items[i]) for i in left)
                for i, result in zip(left, done, strict=True):
                    results[i] = result
                break
            except (MissingExtraError, EngineError):
                raise
            except Exception as error:
                if breaks == BREAKS:
                    raise EngineError(f"{self.engine}: {error or type(error).__name__}") from error
                _log.warning("%s broke (%s); going on", self.engine, type(error).__name__)
        return results


@contextlib.contextmanager
def _backend(workers: Workers, n_items: int) -> Iterator[None]:
    """Choose joblib's backend for the block."""
    jobs = max(1, min(workers.jobs, n_items))
    everywhere = jobs if workers.address is None else -1
    if workers.engine == "dask":
        with _dask_client(workers.address, jobs), joblib.parallel_config("dask"):
            yield
    elif workers.engine == "ray":
        with _ray_cluster(workers.address, jobs), joblib.parallel_config("ray", n_jobs=everywhere):
            yield
    else:
        # loky renews a worker whose memory has grown, and goes on
        warnings.filterwarnings("ignore", "A worker stopped while some jobs")
        with joblib.parallel_config("loky", n_jobs=jobs, inner_max_num_threads=1):
            yield


def _dask_client(address: str | None, jobs: int) -> Any:
    distributed = _optional("dask.distributed", "dask")
    if address is None:
        return distributed.Client(n_workers=jobs, threads_per_worker=1, dashboard_address=None)
    try:
        return distributed.Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        raise EngineError(f"--address {address}: no Dask scheduler answers there") from error


@contextlib.contextmanager
def _ray_cluster(address: str | None, jobs: int) -> Iterator[None]:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # Ray would tell its makers
    register = _optional("ray.util.joblib", "ray").register_ray
    ray = importlib.import_module("ray")
    size = {"num_cpus": jobs} if address is None else {"address": address}
    try:
        ray.init(log_to_driver=False, include_dashboard=False, **size)
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise EngineError(f"--address {address}: no Ray cluster answers there") from error
    register()
    try:
        yield
    finally:
        ray.shutdown()


def _optional(module: str, extra: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError(
            f'{extra} cannot be imported ({error}): pip install "bnprl[{extra}]"'
        ) from error
