"""Occlusions of vessels: a flicker neither begins nor ends one, wherever a run is cut into parts."""

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from modsim3d.view.report.overview import BEGINS, ENDS, Overview, ShownRows

STEPS, VESSELS = 12, 3
FRACTIONS = st.sampled_from([None, 0, 250, *(int(limit) + k for limit in (BEGINS, ENDS) for k in (-1, 0, 1))])
RUNS = st.lists(st.lists(FRACTIONS, min_size=STEPS, max_size=STEPS), min_size=VESSELS, max_size=VESSELS)


def slowly(fractions: list[int | None]) -> list[bool]:
    """Whether one vessel is occluded at each step; it is not where it is not in the image."""
    occluded, found = False, []
    for fraction in fractions:
        occluded = fraction is not None and fraction <= (ENDS if occluded else BEGINS)
        found.append(occluded)
    return found


@settings(max_examples=60, deadline=None)
@given(RUNS, st.sets(st.integers(1, STEPS - 1)))
def test_occlusions_are_those_of_a_loop_over_steps_whatever_the_parts(fractions, cuts):
    overview = Overview(STEPS, VESSELS, 1)
    for start, stop in pairwise([0, *sorted(cuts), STEPS]):
        rows = [(i, v, fractions[v][i]) for i in range(start, stop) for v in range(VESSELS)]
        overview.add(shown(np.arange(start, stop), [row for row in rows if row[2] is not None]))
    onsets = overview.stretches("hidden")
    found = np.zeros((VESSELS, STEPS), dtype=bool)
    for vessel, first, until in zip(onsets.key, onsets.first, onsets.until, strict=True):
        found[vessel, first : until + 1] = True
    np.testing.assert_array_equal(found, [slowly(each) for each in fractions])


def shown(index, rows):
    """One camera at some steps: the step, the vessel and the visible fraction in 250ths of each row of the truth."""
    at, vessel, fraction = np.array(rows, dtype=np.int64).reshape(-1, 3).T
    none, every = np.empty(0, dtype=np.int64), np.ones(len(at), dtype=bool)
    of_truth = (at, vessel, every, ~every, fraction, np.zeros((len(at), 2), dtype=np.int64))
    return ShownRows(index, np.zeros_like(index), *of_truth, none, none, none.astype(np.uint8))
