"""Occlusions of vessels: a flicker neither begins nor ends one, wherever a run is cut into parts."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from modsim3d.view.report.occlusions import BEGINS, ENDS, Occlusions

STEPS, VESSELS = 12, 3
FRACTIONS = st.sampled_from([None, 0, BEGINS - 1, BEGINS, BEGINS + 1, ENDS - 1, ENDS, ENDS + 1, 250])


def slowly(fractions: list[int | None]) -> list[bool]:
    """Whether one vessel is occluded at each step; it is not where it is not in the image."""
    occluded, found = False, []
    for fraction in fractions:
        occluded = fraction is not None and fraction <= (ENDS if occluded else BEGINS)
        found.append(occluded)
    return found


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.lists(FRACTIONS, min_size=STEPS, max_size=STEPS), min_size=VESSELS, max_size=VESSELS),
    st.sets(st.integers(1, STEPS - 1)),
)
def test_occlusions_are_those_of_a_loop_over_steps_whatever_the_parts(fractions, cuts):
    occlusions = Occlusions(VESSELS)
    found = np.zeros((VESSELS, STEPS), dtype=bool)
    edges = [0, *sorted(cuts), STEPS]
    for start, stop in pairwise(edges):
        rows = [(i, v) for i in range(start, stop) for v in range(VESSELS) if fractions[v][i] is not None]
        index, vessel = np.array(rows, dtype=int).reshape(-1, 2).T
        found[vessel, index] = occlusions.of(index, vessel, np.array([fractions[v][i] for i, v in rows], dtype=int))
    np.testing.assert_array_equal(found, [slowly(each) for each in fractions])
