from __future__ import annotations

import numpy as np
import pytest

from modsim3d.detector.confusion import probabilistic_confusion
from modsim3d.errors import InputError

TABLE_5_4 = [[15, 1, 2], [4, 16, 2], [1, 3, np.nan]]  # Jessen & Mohr (2023): sailboat, kayak, background


def test_table_5_4_becomes_table_5_5() -> None:
    confusion, false_positive_labels = probabilistic_confusion(TABLE_5_4)
    np.testing.assert_allclose(confusion, [[0.75, 0.05], [0.2, 0.8], [0.05, 0.15]], rtol=1e-15)
    np.testing.assert_allclose(false_positive_labels, [0.5, 0.5], rtol=1e-15)


def test_without_false_positives_their_labels_are_uniform() -> None:
    assert probabilistic_confusion([[5, 0, 0], [0, 5, 0], [1, 1, 0]])[1].tolist() == [0.5, 0.5]


@pytest.mark.parametrize(
    ("counts", "message"),
    [
        ([[1, 2, 3], [1, 2, 3]], r"shape is \(2, 3\)"),
        ([[5]], r"shape is \(1, 1\)"),
        ([[-1, 0], [3, 0]], "at least 0"),
        ([[np.inf, 0], [3, 0]], "finite"),
        ([[3, 0, 1], [0, 0, 1], [1, 0, 0]], "column 1"),
    ],
)
def test_counts_that_give_no_rates_are_refused(counts: list[list[float]], message: str) -> None:
    with pytest.raises(InputError, match=message):
        probabilistic_confusion(counts)
