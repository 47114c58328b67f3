import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from modsim3d.core.random_streams import normals
from modsim3d.detector.draws import choose, cumulative, poisson_quantile
from modsim3d.detector.truncation import MAX_DIMENSIONS, sobol_points


def test_poisson_quantile_is_scipys_and_that_step_at_a_step_of_the_distribution() -> None:
    u = np.random.default_rng(3).random(3000)
    u[:2] = 0.0, 1 - 2.0**-53
    mean = np.repeat([1e-9, 0.1, 1.0, 7.5, 300.0, 9000.0], 500)
    assert np.array_equal(poisson_quantile(u, mean), np.maximum(stats.poisson.ppf(u, mean), 0))
    k, mean = (grid.ravel() for grid in np.meshgrid(np.arange(40), [0.5, 3.0, 20.0]))
    u = stats.poisson.cdf(k, mean)
    below_one = u < 1 - 1e-9
    assert np.array_equal(poisson_quantile(u[below_one], mean[below_one]), k[below_one])
    assert poisson_quantile(np.array([0.0, 0.999]), np.zeros(2)).tolist() == [0, 0]


def test_normals_are_finite_at_both_ends() -> None:
    assert np.all(np.abs(normals(np.array([0.0, 1 - 2.0**-53]))) < 9)
    assert normals(np.array([0.5, 0.975])).round(6).tolist() == [0, 1.959964]


def test_what_has_probability_zero_is_never_chosen_and_a_distribution_function_ends_at_one_exactly() -> None:
    distribution = cumulative(np.array([0.0, 0.1, 0.2, 0.0, 0.7, 0.0]))
    uniforms = np.array([0.0, 0.05, 0.1, 0.2999, 0.3001, 1 - 2.0**-53])
    assert choose(distribution, uniforms).tolist() == [1, 1, 2, 2, 4, 4]
    assert cumulative(np.full(10, 0.1))[-1] == 1


@pytest.mark.parametrize("dimensions", range(1, MAX_DIMENSIONS + 1))
@pytest.mark.parametrize("count", [1, 2, 1024])
def test_points_are_those_of_scipy(dimensions: int, count: int) -> None:
    ours = sobol_points(dimensions, count, np.random.default_rng(7).spawn(1)[0])
    np.testing.assert_array_equal(ours, qmc.Sobol(dimensions, rng=np.random.default_rng(7)).random(count))
