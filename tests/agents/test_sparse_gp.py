"""The sparse online process against the exact one, its algebra, and the choice of its kernel."""

import numpy as np
import pytest
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import check_grad

from bnprl_agents.gaussian_process.kernels import RadialKernel
from bnprl_agents.gaussian_process.marginal_likelihood import (
    log_marginal_likelihood,
    select_hyperparameters,
)
from bnprl_agents.gaussian_process.sparse_gp import SparseGP

NOISE = 0.1


def learned(kernel, x, y, **settings):
    gp = SparseGP(kernel, NOISE, **settings)
    for point, target in zip(x, y, strict=True):
        gp.update(point, target)
    return gp


def exact_posterior(kernel, noise, x, y, at):
    """Mean and variance of the exact Gaussian process; (3.2), (3.3) less the noise's variance."""
    factor = cho_factor(kernel(x, x) + noise * np.eye(len(x)))
    cross = kernel(at, x)
    explained = np.einsum("ij,ji->i", cross, cho_solve(factor, cross.T))
    return cross @ cho_solve(factor, y), kernel.amplitude - explained


def kernel_matrix(gp):
    return gp.kernel(gp.points, gp.points)


@pytest.mark.parametrize("bandwidth", [0.05, 0.1])
def test_without_a_budget_it_is_the_exact_process(bandwidth):
    rng = np.random.default_rng(0)
    x, y, at = rng.random((200, 2)), rng.normal(size=200), rng.random((50, 2))
    kernel = RadialKernel((bandwidth, bandwidth))
    gp = learned(kernel, x, y)
    assert len(gp) == 200
    for ours, exact in zip(gp.predict(at), exact_posterior(kernel, NOISE, x, y, at), strict=True):
        np.testing.assert_allclose(ours, exact, atol=1e-8)


def test_it_is_close_to_the_exact_process_where_the_kernel_matrix_is_singular():
    rng = np.random.default_rng(0)
    x, at = rng.random((200, 2)), rng.random((50, 2))
    y = np.sin(4 * x[:, 0]) + x[:, 1] + np.sqrt(NOISE) * rng.normal(size=200)
    kernel = RadialKernel((0.3, 0.3))
    gp = learned(kernel, x, y)
    assert len(gp) < 200
    mean, variance = exact_posterior(kernel, NOISE, x, y, at)
    np.testing.assert_allclose(gp.predict(at)[0], mean, atol=0.02)
    np.testing.assert_allclose(gp.predict(at)[1], variance, atol=1e-3)


def test_the_first_two_measurements_by_hand():
    gp = SparseGP(RadialKernel((1.0,), amplitude=2.0), noise=0.5)
    gp.update([0.0], 1.0)
    mean, variance = gp.predict([[0.0]])
    assert mean[0] == pytest.approx(2.0 / 2.5)
    assert variance[0] == pytest.approx(2.0 - 4.0 / 2.5)
    gp.update([0.0], 1.0)  # the same place: nothing new
    assert len(gp) == 1
    assert gp.predict([[0.0]])[0][0] == pytest.approx(2.0 / (2.0 + 0.5 / 2))


@pytest.mark.parametrize(
    ("bandwidth", "tolerance"), [(0.1, 0.0), (0.3, 0.0), (1.0, 0.0), (0.2, 1e-3)]
)
def test_nothing_drifts_within_a_budget(bandwidth, tolerance):
    rng = np.random.default_rng(1)
    kernel = RadialKernel((bandwidth, bandwidth), amplitude=3.0)
    gp = learned(
        kernel, rng.random((4000, 2)), rng.normal(size=4000), budget=50, tolerance=tolerance
    )
    assert len(gp) <= 50
    np.testing.assert_array_equal(gp.precision, gp.precision.T)
    np.testing.assert_array_equal(gp.covariance, gp.covariance.T)
    np.testing.assert_allclose(gp.precision @ kernel_matrix(gp), np.eye(len(gp)), atol=1e-6)
    _, variance = gp.predict(rng.random((200, 2)))
    assert (variance >= 0.0).all()
    assert (variance <= 3.0 + 1e-9).all()


def test_a_process_that_forgets_follows_its_newest_measurements():
    """In one place: C shrinks, so that the variance before is forgetting v + (1 - forgetting) k."""
    gp = SparseGP(RadialKernel((1.0,)), noise=1.0, forgetting=0.5)
    wanted_mean, wanted_variance = 0.0, 1.0
    for target in (4.0, 1.0, 1.0):
        before = 0.5 * wanted_variance + 0.5
        wanted_mean += before / (1.0 + before) * (target - wanted_mean)
        wanted_variance = before / (1.0 + before)
        gp.update([0.0], target)
        assert gp.predict([[0.0]])[0][0] == pytest.approx(wanted_mean)
        assert gp.predict([[0.0]])[1][0] == pytest.approx(wanted_variance)


def test_the_least_valuable_point_is_removed():
    gp = SparseGP(RadialKernel((0.1,)), NOISE, budget=2)
    for place, value in ((0.0, 5.0), (1.0, 0.01), (2.0, 5.0)):
        gp.update([place], value)
    assert sorted(gp.points.ravel().tolist()) == pytest.approx([0.0, 2.0])


def test_removing_a_redundant_point_changes_nothing():
    rng = np.random.default_rng(2)
    x, y = rng.random((30, 2)), rng.normal(size=30)
    one = learned(RadialKernel((0.3, 0.3)), x, y, budget=30, tolerance=1e-3)
    m = len(one)
    again = learned(RadialKernel((0.3, 0.3)), x, y, budget=m, tolerance=1e-3)
    np.testing.assert_array_equal(one.predict(x)[0], again.predict(x)[0])


def test_the_size_of_its_memory_does_not_grow():
    gp = SparseGP(RadialKernel((0.1, 0.1)), NOISE, budget=20)
    before = [array.nbytes for array in gp.basis]
    rng = np.random.default_rng(0)
    for point in rng.random((500, 2)):
        gp.update(point, 1.0)
    assert [array.nbytes for array in gp.basis] == before


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: RadialKernel((0.0,)), r"bandwidth: 0\.0"),
        (lambda: RadialKernel((0.1, np.nan)), "bandwidth: nan"),
        (lambda: RadialKernel(()), "bandwidth: "),
        (lambda: RadialKernel((0.1,), amplitude=-1.0), r"amplitude: -1\.0"),
        (lambda: SparseGP(RadialKernel((0.1,)), 0.0), r"noise: 0\.0"),
        (lambda: SparseGP(RadialKernel((0.1,)), 0.1, budget=0), "budget: 0"),
        (lambda: SparseGP(RadialKernel((0.1,)), 0.1, tolerance=1.0), r"tolerance: 1\.0"),
        (lambda: SparseGP(RadialKernel((0.1,)), 0.1).update([np.inf], 0.0), "finite"),
        (lambda: SparseGP(RadialKernel((0.1,)), 0.1).update([0.0], np.nan), "target: nan"),
        (lambda: SparseGP(RadialKernel((0.1,)), 0.1).predict([[0.0, 1.0]]), "shape"),
    ],
)
def test_bad_arguments(build, message):
    with pytest.raises(ValueError, match=message):
        build()


def test_the_gradient_of_the_marginal_likelihood():
    rng = np.random.default_rng(0)
    x, y = rng.random((15, 2)), rng.normal(size=15)

    def split(logs):
        *bandwidth, amplitude, noise = np.exp(logs)
        return log_marginal_likelihood(RadialKernel(tuple(bandwidth), amplitude), noise, x, y)

    begin = np.log([0.3, 0.6, 1.5, 0.2])
    assert check_grad(lambda v: split(v)[0], lambda v: split(v)[1], begin) < 1e-4


def test_the_marginal_likelihood_of_one_measurement_by_hand():
    value, _ = log_marginal_likelihood(RadialKernel((1.0,), 2.0), 1.0, [[0.0]], [3.0])
    assert value == pytest.approx(-0.5 * 9 / 3 - 0.5 * np.log(2 * np.pi * 3))


def test_selection_finds_what_is_relevant():
    rng = np.random.default_rng(0)
    x = rng.random((80, 2))
    y = np.sin(6 * x[:, 0]) + 0.1 * rng.normal(size=80)
    kernel, noise = select_hyperparameters(RadialKernel((0.5, 0.5)), 0.5, x, y)
    assert kernel.bandwidth[0] < 0.6
    assert kernel.bandwidth[1] > 4 * kernel.bandwidth[0]
    assert 0.003 < noise < 0.03
