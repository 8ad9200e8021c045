"""The radial kernel with a bandwidth for every dimension."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from bnprl_agents.episodes import FloatArray


@dataclass(frozen=True)
class RadialKernel:
    """k(x, z) = amplitude exp(-1/2 sum_d (x_d - z_d)^2 / bandwidth_d^2).

    Attributes:
        bandwidth: for each of D dimensions, the distance over which values stay alike; a
            dimension with a large bandwidth is irrelevant.
        amplitude: k(x, x), the prior variance.

    Raises:
        ValueError: a bandwidth or the amplitude is not positive and finite.
    """

    bandwidth: tuple[float, ...]
    amplitude: float = 1.0

    def __post_init__(self) -> None:
        check_bandwidth(self.bandwidth)
        check_positive("amplitude", self.amplitude)

    def scaled(self, points: npt.ArrayLike) -> FloatArray:
        """Return points (n, D) in units of the bandwidths, where the kernel is isotropic."""
        return np.ascontiguousarray(np.asarray(points, dtype=np.float64) / self.bandwidth)

    def __call__(self, x: npt.ArrayLike, z: npt.ArrayLike) -> FloatArray:
        """Return the matrix (n, m) of the kernel between points (n, D) and (m, D)."""
        matrix: FloatArray = gram(self.scaled(x), self.scaled(z), self.amplitude)
        return matrix


def broadcast_bandwidth(bandwidth: Sequence[float], dimensions: int) -> tuple[float, ...]:
    """Return one bandwidth for each dimension; a single one serves all.

    Raises:
        ValueError: there are neither one nor as many as dimensions.
    """
    if len(bandwidth) not in (1, dimensions):
        raise ValueError(
            f"bandwidth: {len(bandwidth)} values, must be one or {dimensions}, one a dimension"
        )
    return tuple(float(b) for b in bandwidth) * (dimensions if len(bandwidth) == 1 else 1)


def check_bandwidth(bandwidth: Sequence[float]) -> None:
    """Check that every bandwidth is positive and finite, and that there is one.

    Raises:
        ValueError: one is not.
    """
    for value in bandwidth:
        check_positive("bandwidth", value)
    if not bandwidth:
        raise ValueError("bandwidth: (), must have at least one value")


def check_positive(name: str, value: float) -> None:
    """Check that a number is positive and finite.

    Raises:
        ValueError: it is not.
    """
    if not 0.0 < value < math.inf:
        raise ValueError(f"{name}: {value}, must be positive and finite")


@njit(cache=True)
def radial(x, z, amplitude):  # type: ignore[no-untyped-def]
    """Return k(x, z) of two scaled points (D,)."""
    square = 0.0
    for d in range(x.size):
        square += (x[d] - z[d]) ** 2
    return amplitude * math.exp(-0.5 * square)


@njit(cache=True)
def gram(x, z, amplitude):  # type: ignore[no-untyped-def]
    """Return the matrix (n, m) of the kernel between scaled points (n, D) and (m, D)."""
    matrix = np.empty((x.shape[0], z.shape[0]))
    for i in range(x.shape[0]):
        for j in range(z.shape[0]):
            matrix[i, j] = radial(x[i], z[j], amplitude)
    return matrix
