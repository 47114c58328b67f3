"""Functions on arrays, against a loop over their rows."""

import numpy as np
import pytest

from modsim3d.core.arrays import distinct, occurring, run_starts


@pytest.mark.parametrize("count", [0, 1, 40])
def test_runs_start_where_a_row_differs_from_the_one_before(count: int) -> None:
    one, other = np.random.default_rng(count).integers(0, 2, (2, count))
    rows = list(zip(one.tolist(), other.tolist(), strict=True))
    assert run_starts(one, other).tolist() == [i for i in range(count) if i == 0 or rows[i] != rows[i - 1]]


@pytest.mark.parametrize("count", [0, 1, 40])
def test_distinct_values_are_those_of_a_set_in_order(count: int) -> None:
    values = np.random.default_rng(count).integers(0, 9, count)
    assert distinct(values).tolist() == sorted(set(values.tolist()))


@pytest.mark.parametrize("count", [0, 1, 40])
def test_indices_that_occur_are_those_that_numpy_finds(count: int) -> None:
    indices = np.random.default_rng(count).integers(0, 60, count)
    ours, numpys = occurring(indices, 60), np.unique(indices, return_inverse=True)
    assert [each.tolist() for each in ours] == [each.tolist() for each in numpys]
