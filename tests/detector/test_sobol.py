"""Sobol's points against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import qmc

from modsim3d.detector.truncation import MAX_DIMENSIONS, sobol_points


@pytest.mark.parametrize("dimensions", range(1, MAX_DIMENSIONS + 1))
@pytest.mark.parametrize("count", [1, 2, 1024])
def test_points_are_those_of_scipy(dimensions: int, count: int) -> None:
    ours = sobol_points(dimensions, count, np.random.default_rng(7).spawn(1)[0])
    np.testing.assert_array_equal(ours, qmc.Sobol(dimensions, rng=np.random.default_rng(7)).random(count))
