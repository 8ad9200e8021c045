"""The sparse online Gaussian process against GPyTorch and scikit-learn, and its own growth.

`python -m baselines.benchmarks.gaussian_process` prints the table and exits 1 on a miss. One step
is a prediction and an update with 100 basis points in two dimensions. GPyTorch's exact process gets
the new data by `set_train_data` and predicts, scikit-learn's is fitted again and predicts; neither
may change its hyper-parameters. The second part is our own: the cost of a budget of 400 over that
of 100, the memory after many steps, and that P K = I after 100,000 updates.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable

import gpytorch
import numpy as np
import torch
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF

from baselines.benchmarks.contest import ROUNDS, Contest, run_contests
from bnprl_agents.episodes import FloatArray
from bnprl_agents.gaussian_process.kernels import RadialKernel
from bnprl_agents.gaussian_process.sparse_gp import SparseGP

POINTS, BANDWIDTH, NOISE = 100, 0.1, 0.1
WANTED = {"GPyTorch": 20.0, "scikit-learn": 10.0}
GROWTH = 20.0
"""Largest ratio of a step's cost at a budget of 400 to that at 100."""
UPDATES, ACCURACY = 100_000, 1e-6


def full_process(budget: int) -> tuple[SparseGP, FloatArray]:
    """Return a process whose basis is full, and points at which it goes on."""
    rng = np.random.default_rng(0)
    kernel = RadialKernel((BANDWIDTH * np.sqrt(POINTS / budget),) * 2)
    gp = SparseGP(kernel, NOISE, budget, tolerance=1e-3)
    for point in rng.random((20 * budget, 2)):
        gp.update(point, float(np.sin(6.0 * point[0])))
    if len(gp) != budget:
        raise RuntimeError(f"only {len(gp)} of {budget} basis points are in use")
    return gp, rng.random((1000, 2))


def our_step(budget: int = POINTS) -> Callable[[], float]:
    """Return work: predict at a point, then learn it."""
    gp, points = full_process(budget)

    def work() -> float:
        for point in points:
            gp.predict(point)
            gp.update(point, 0.5)
        return float(len(points))

    return work


class ExactGP(gpytorch.models.ExactGP):  # type: ignore[misc]
    """GPyTorch's exact process with the same kernel."""

    def __init__(self, x: torch.Tensor, y: torch.Tensor) -> None:
        likelihood = gpytorch.likelihoods.GaussianLikelihood()
        super().__init__(x, y, likelihood)
        self.mean_module = gpytorch.means.ZeroMean()
        self.covar_module = gpytorch.kernels.RBFKernel()
        self.covar_module.lengthscale = BANDWIDTH
        likelihood.noise = NOISE

    def forward(self, x: torch.Tensor) -> gpytorch.distributions.MultivariateNormal:
        """Return the prior at points."""
        return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))


def gpytorch_step() -> Callable[[], float]:
    """Return work: replace the data, predict mean and variance at one point."""
    torch.set_num_threads(1)
    x, y = torch.rand(POINTS, 2), torch.rand(POINTS)
    model = ExactGP(x, y).eval()
    at = torch.rand(1, 2)

    def work() -> float:
        with torch.no_grad():
            model.set_train_data(x, y, strict=False)
            found = model(at)
            _ = found.mean, found.variance
        return 1.0

    return work


def sklearn_step() -> Callable[[], float]:
    """Return work: fit again, predict mean and deviation at one point."""
    rng = np.random.default_rng(0)
    x, y, at = rng.random((POINTS, 2)), rng.random(POINTS), rng.random((1, 2))
    model = GaussianProcessRegressor(RBF(BANDWIDTH), alpha=NOISE, optimizer=None)

    def work() -> float:
        model.fit(x, y)
        model.predict(at, return_std=True)
        return 1.0

    return work


def growth() -> float:
    """Return the median ratio, over rounds, of a step's CPU time at budgets of 400 and 100."""
    steps = [our_step(budget) for budget in (4 * POINTS, POINTS)]
    ratios = []
    for _ in range(ROUNDS):
        seconds = []
        for work in steps:
            begin = time.process_time()
            work()
            seconds.append(time.process_time() - begin)
        ratios.append(seconds[0] / seconds[1])
    return float(np.median(ratios))


def drift(updates: int) -> tuple[float, bool, bool]:
    """Return max |P K - I|, whether C and P are symmetric, whether the memory stayed the same."""
    rng = np.random.default_rng(0)
    gp = SparseGP(RadialKernel((BANDWIDTH, BANDWIDTH)), NOISE, POINTS)
    before = sum(array.nbytes for array in gp.basis)
    for point, target in zip(rng.random((updates, 2)), rng.normal(size=updates), strict=True):
        gp.update(point, target)
    error = np.abs(gp.precision @ gp.kernel(gp.points, gp.points) - np.eye(len(gp))).max()
    symmetric = all((m == m.T).all() for m in (gp.precision, gp.covariance))
    return float(error), symmetric, sum(array.nbytes for array in gp.basis) == before


def main() -> int:
    """Run the contests and the checks; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=2.0, help="a side and contest")
    parser.add_argument("--updates", type=int, default=UPDATES, help="of the check of drift")
    options = parser.parse_args()
    peers = {"GPyTorch": gpytorch_step(), "scikit-learn": sklearn_step()}
    contests = [
        Contest(f"online step / {name}, 100 points", our_step(), peer, WANTED[name])
        for name, peer in peers.items()
    ]
    passed = run_contests(contests, options.seconds)
    ratio = growth()
    print(f"budget 400 / budget 100, CPU time of a step: {ratio:.1f}, wanted at most {GROWTH:g}")
    error, symmetric, constant = drift(options.updates)
    print(
        f"after {options.updates:,} updates at budget {POINTS}: max |PK - I| = {error:.1e}, wanted "
        f"at most {ACCURACY:g}; symmetric: {symmetric}; memory unchanged: {constant}"
    )
    passed &= ratio <= GROWTH and error <= ACCURACY and symmetric and constant
    print("pass" if passed else "FAIL")
    return 0 if passed else 1


if __name__ == "__main__":
    warnings.filterwarnings("ignore")
    sys.exit(main())
