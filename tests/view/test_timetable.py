import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from modsim3d.view.films.plan import MIN_RATE, Timetable

MOST = 60
PACES = [(0.2, 1, 5, 1), (0.1, 1, 10, 1), (0.1, 4, 40, 1), (0.5, 1, 6, 3), (1, 1, 5, 5), (10, 1, 5, 50), (10, 10, 5, 5)]


def test_even_steps_give_every_frame_its_time_and_a_film_that_is_too_fast_leaves_frames_out():
    for step_s, speed, rate, each in PACES:
        table = Timetable.of(np.full(30, step_s), speed, MOST)
        assert table.rate == rate and set(table.repeats.tolist()) == {each}, (step_s, speed)
        assert table.duration_s == pytest.approx(30 * step_s / speed)
    table = Timetable.of(np.full(1000, 0.01), 1.0, MOST)
    assert table.rate == MOST and set(table.repeats.tolist()) == {0, 1}
    assert table.duration_s == pytest.approx(10.0, abs=1 / MOST)
    assert Timetable.of(np.array([3600.0, 3600.0]), 1.0, MOST).rate >= MIN_RATE


@given(st.lists(st.floats(0.01, 20.0), min_size=1, max_size=40), st.floats(0.1, 20.0), st.sampled_from([25, 50, 60]))
def test_whatever_the_steps_each_frame_is_shown_when_it_is_due(durations, speed, most):
    table = Timetable.of(np.array(durations), speed, most)
    assert table.rate <= most
    due = np.cumsum(durations) / speed
    ends = np.cumsum(table.repeats) / float(table.rate)
    # Half a picture, and what rounding the rate to a fraction with a small denominator does to a long film.
    assert np.all(np.abs(due - ends) <= 1.0 / float(table.rate) + 0.001 * due) and table.repeats.sum() >= 1
