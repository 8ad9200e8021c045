"""`bnprl bounds`: how good an answer can be, computed from the model or simulated without one."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from baselines.environment import EnvironmentSpec
from baselines.report import DASH, REFERENCE_NAMES, number
from baselines.usage import usage_errors
from bnprl_envs import memoryless, planning, registry
from bnprl_envs.model import TabularModel
from bnprl_envs.tables import FloatArray

if TYPE_CHECKING:
    from baselines.options import Bounds

Progress = Callable[[float, float], None]
"""Called with the seconds used and the best value so far."""

COPIES = 1000
"""Episodes simulated at a time."""
_TIMED = "{desc} {percentage:3.0f}%|{bar}| {n:.0f}/{total:g} s{postfix}"


@dataclass(frozen=True)
class Line:
    """One value to compute.

    Attributes:
        name: what it is the value of.
        kind: how it relates to the optimum.
        reference: name of the registry's value to show beside it; "" for none.
        compute: returns the value, or the returns (n,) of simulated episodes.
        timed: whether it takes the seconds given.
    """

    name: str
    kind: str
    reference: str
    compute: Callable[[Progress], float | FloatArray]
    timed: bool = False


def print_bounds(options: Bounds) -> int:
    """Compute the values of an environment or model file and print them as a table."""
    with usage_errors():
        if not 0.0 < options.seconds < math.inf:
            raise ValueError(f"--seconds: {options.seconds}, must be over 0 and finite")
        if options.seed < 0:
            raise ValueError(f"--seed: {options.seed}, must be at least 0")
        lines, discount = _lines(options)
    values = {line: _compute(line, options) for line in lines}
    errors = ", ± standard errors" if any("simulated" in line.kind for line in lines) else ""
    print(f"{options.id}: expected discounted return, discount {discount:g}{errors}")
    _print_table(_table(values, _references(options.id, discount)))
    return 0


def exact_lines(model: TabularModel) -> list[Line]:
    """Return what is computed to the end: simple policies and upper bounds."""
    start = model.start
    one = model.n_agents == 1
    lines = [
        Line("random", "policy", "random", lambda _: planning.random_value(model)),
        Line("best blind action", "policy", "", lambda _: planning.blind_values(model).max()),
        Line(
            "MDP" if one else "MMDP",
            "exact" if model.fully_observed else "upper bound",
            "upper" if model.fully_observed else "",
            lambda _: float(start @ planning.mdp_value(model)),
        ),
    ]
    if not model.fully_observed:
        lines += [
            Line("QMDP", "upper bound", "", lambda _: (planning.q_mdp(model) @ start).max()),
            Line("FIB", "upper bound", "upper", lambda _: (planning.fib(model) @ start).max()),
        ]
    return lines


def search_lines(model: TabularModel, seconds: float, seed: int) -> list[Line]:
    """Return what is searched as long as there is time; a fully observed model needs nothing.

    They are to be computed in this order: the last search goes on from the one before.
    """

    def point_based(progress: Progress) -> float:
        from bnprl_envs.point_based import point_based_lower_bound

        return point_based_lower_bound(
            model, seconds=seconds, seed=seed, on_progress=progress
        ).value

    found: list[memoryless.JointPolicy] = []

    def deterministic(progress: Progress) -> float:
        found.append(
            memoryless.memoryless_joint_policy(
                model, restarts=None, seconds=seconds, seed=seed, on_progress=progress
            )
        )
        return found[-1].value

    def stochastic(progress: Progress) -> float:
        from bnprl_envs.stochastic_memoryless import stochastic_memoryless_policy

        return stochastic_memoryless_policy(
            model,
            restarts=None,
            seconds=seconds,
            seed=seed,
            initial=found[-1].policies[0],
            on_progress=progress,
        ).value

    if model.fully_observed:
        return []
    best = "best memoryless, deterministic"
    if model.n_agents > 1:
        return [
            Line("point-based", "lower bound if centralised", "", point_based, timed=True),
            Line(best, "policy", "memoryless", deterministic, timed=True),
        ]
    return [
        Line("point-based", "lower bound", "lower", point_based, timed=True),
        Line(best, "policy", "", deterministic, timed=True),
        Line("best memoryless, stochastic", "policy", "memoryless", stochastic, timed=True),
    ]


def simulated_lines(id: str, seconds: float, seed: int) -> list[Line]:
    """Return policies that a person writes down, to be run as often as there is time."""
    from bnprl_envs import hand_coded

    envs = hand_coded.make_batch(id, COPIES)

    def simulate(policy: hand_coded.Policy, progress: Progress) -> FloatArray:
        rng, began = np.random.default_rng(seed), time.perf_counter()
        returns: list[FloatArray] = []
        used = 0.0
        while not returns or used < seconds:
            returns.append(hand_coded.simulated_returns(envs, policy, rng))
            used = time.perf_counter() - began
            progress(used, float(np.mean(returns)))
        return np.concatenate(returns)

    best = list(hand_coded.POLICIES[id])[-1]
    policies = {"random": hand_coded.uniform_policy(envs), **hand_coded.POLICIES[id]}
    return [
        Line(
            name,
            "policy, simulated",
            "lower" if name == best else name,
            partial(simulate, policy),
            timed=True,
        )
        for name, policy in policies.items()
    ]


def _lines(options: Bounds) -> tuple[list[Line], float]:
    """Return what to compute of an environment or file, and its discount.

    Raises:
        ValueError: there is nothing to compute from, or the discount does not fit.
        OSError: the model file cannot be read.
    """
    if options.id in registry.environment_ids():
        entry = registry.entry(options.id)
        if entry.kind in ("class", "parallel-class"):
            if options.discount not in (None, entry.discount):
                raise ValueError(
                    f"--discount: {options.discount}, {options.id} is simulated with "
                    f"{entry.discount:g}"
                )
            return simulated_lines(options.id, options.seconds, options.seed), entry.discount
    model = _solvable(options.id, options.discount)
    searches = search_lines(model, options.seconds, options.seed)
    return [*exact_lines(model), *searches], model.discount


def _solvable(id: str, discount: float | None) -> TabularModel:
    """Return the model, with another discount if one is given.

    Raises:
        ValueError: there is none, or its discount gives an infinite horizon no value.
        OSError: the model file cannot be read.
    """
    known = id in registry.environment_ids()
    model = registry.model(id) if known else EnvironmentSpec(id).model()
    if model is None:
        raise ValueError(f"{id} has no tables: there is nothing to compute from")
    if discount is not None:
        model = model.replace(discount=discount)
    if not model.discount < 1.0:
        raise ValueError(
            f"discount: {model.discount:g}, an infinite horizon needs one below 1; "
            "give one with --discount"
        )
    return model


def _compute(line: Line, options: Bounds) -> FloatArray:
    """Return the value (1,), or the returns of simulated episodes (n,)."""
    with tqdm(
        total=options.seconds if line.timed else None,
        desc=line.name,
        bar_format=_TIMED if line.timed else "{desc} ...",
        leave=False,
        disable=not options.progress,
    ) as bar:

        def progress(used: float, value: float) -> None:
            bar.set_postfix_str(number(value, ".5f"), refresh=False)
            bar.update(min(used, options.seconds) - bar.n)

        return np.atleast_1d(line.compute(progress))


def _references(id: str, discount: float) -> dict[str, registry.Reference]:
    """Return what the registry knows of this environment with this discount."""
    if id not in registry.environment_ids() or registry.entry(id).discount != discount:
        return {}
    return {reference.name: reference for reference in registry.entry(id).references}


def _table(
    values: dict[Line, FloatArray], references: dict[str, registry.Reference]
) -> list[list[str]]:
    """Return the cells, header first; references without a line come last."""
    rows = [["", "kind", "value", *(["reference", "source"] if references else [])]]
    left = dict(references)
    for line, value in values.items():
        rows.append([line.name, line.kind, _value_cell(value)])
        if references:
            rows[-1] += _reference_cells(left.pop(line.reference, None))
    return rows + [
        [REFERENCE_NAMES.get(name, name), "reference", DASH, *_reference_cells(reference)]
        for name, reference in left.items()
    ]


def _value_cell(value: FloatArray) -> str:
    """Return a value, or the mean of some returns with its standard error."""
    mean = number(float(value.mean()), ".5f")
    if value.size == 1:
        return mean
    return f"{mean} ± {value.std(ddof=1) / math.sqrt(value.size):.2g}"


def _reference_cells(reference: registry.Reference | None) -> list[str]:
    if reference is None:
        return [DASH, ""]
    return [number(reference.value, ".9g"), reference.source]


def _print_table(rows: list[list[str]]) -> None:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = [
            cell.rjust(width) if column in (2, 3) else cell.ljust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        print("  ".join(cells).rstrip())
