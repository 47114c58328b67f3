"""Functions on arrays, against a loop over their rows."""

import numpy as np
import pytest

from modsim3d.core.arrays import distinct, occurring, run_starts


@pytest.mark.parametrize("count", [0, 1, 40])
def test_starts_of_runs_distinct_values_and_indices_that_occur_are_those_of_plain_python(count: int) -> None:
    rng = np.random.default_rng(count)
    (one, other), values, indices = (rng.integers(0, *shape) for shape in ((2, (2, count)), (9, count), (60, count)))
    rows = list(zip(one.tolist(), other.tolist(), strict=True))
    assert run_starts(one, other).tolist() == [i for i in range(count) if i == 0 or rows[i] != rows[i - 1]]
    assert distinct(values).tolist() == sorted(set(values.tolist()))
    occur = sorted(set(indices.tolist()))
    assert [each.tolist() for each in occurring(indices, 60)] == [occur, [occur.index(i) for i in indices.tolist()]]
