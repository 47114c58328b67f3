"""Colours stay apart for people who do not see red and green apart."""

from itertools import combinations, product

import numpy as np
import pytest

from modsim3d.view import palette
from tests.view.report.sight import CVD, linear

SEEN_BY = {"everybody": np.eye(3), **{name: np.array(matrix) for name, matrix in CVD.items()}}
# Linear sRGB to XYZ and its white, IEC 61966-2-1.
XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
JUST_NOTICEABLE = 2.3  # Mahy, Van Eycken & Oosterlinck (1994)


def lab(colour, seen):
    ratio = XYZ @ np.clip(seen @ linear(colour), 0, 1) / XYZ.sum(axis=1)
    root = np.where(ratio > (6 / 29) ** 3, np.cbrt(ratio), ratio / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.array([116 * root[1] - 16, 500 * (root[0] - root[1]), 200 * (root[1] - root[2])])


def least_distance(colours, seen):
    seen_as = [lab(colour, SEEN_BY[seen]) for colour in colours]
    return min(float(np.linalg.norm(a - b)) for a, b in combinations(seen_as, 2))


@pytest.mark.parametrize("seen", SEEN_BY)
def test_vessels_alarm_and_truth_are_far_apart_and_everything_stands_out_from_the_sea(seen):
    assert least_distance([*palette.VESSELS, palette.OWN, palette.ALARM, palette.TRUTH], seen) > 7 * JUST_NOTICEABLE
    sea = lab(palette.SEA, SEEN_BY[seen])
    for colour in (*palette.VESSELS, palette.ALARM, palette.TRUTH, palette.SKY):
        assert np.linalg.norm(lab(colour, SEEN_BY[seen]) - sea) > 10 * JUST_NOTICEABLE
    assert not {palette.ALARM, palette.OWN} & {palette.vessel_colour(i, [3]) for i in range(60) if i != 3}
    assert palette.vessel_colour(3, [3]) == palette.OWN


def test_text_is_readable_on_every_plate():
    """Contrast at least 3 : 1, as WCAG 2 asks for large text; lightness differs by more than 35."""
    np.testing.assert_allclose(lab((255, 255, 255), np.eye(3)), [100, 0, 0], atol=0.02)  # white is white in Lab
    for plate in [palette.vessel_colour(i) for i in range(18)] + [palette.ALARM, palette.TRUTH, palette.OWN]:
        assert abs(lab(plate, np.eye(3))[0] - lab(palette.ink_on(plate), np.eye(3))[0]) > 35, plate


def test_states_go_from_pale_to_strong_in_steps_that_everybody_sees_and_no_colour_means_something_else():
    for states, seen in product((2, 3, 5), SEEN_BY):
        ramp = palette.state_colours(states)
        assert len(ramp) == states and least_distance(ramp, seen) > 4 * JUST_NOTICEABLE, (states, seen)
        lightness = [lab(colour, SEEN_BY[seen])[0] for colour in ramp]
        assert lightness == sorted(lightness, reverse=True), (states, seen)
    others = [palette.ALARM, palette.TRUTH, palette.SEA, palette.SKY, *palette.VESSELS]
    for state in palette.state_colours(5):
        assert all(np.linalg.norm(lab(state, np.eye(3)) - lab(other, np.eye(3))) > 10 for other in others), state
    assert palette.state_colours(1) == palette.state_colours(2)[:1]  # a detector with one state
