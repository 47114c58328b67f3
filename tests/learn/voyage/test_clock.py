"""Frames that a registered clock puts just outside the scene."""

from __future__ import annotations

import numpy as np

from modsim3d.learn.voyage.clock import within_scene

FRAMES_S = np.arange(5) * 0.2


def test_a_clock_that_is_off_by_less_than_half_a_frame_loses_no_frame() -> None:
    times_s, inside = within_scene(FRAMES_S, -0.0007, 0.8)
    assert inside.all()
    assert times_s[0] == 0
    np.testing.assert_allclose(times_s[1:], FRAMES_S[1:] - 0.0007)
    late_s, inside = within_scene(FRAMES_S, 0.05, 0.8)
    assert inside.all()
    assert late_s[-1] == 0.8


def test_frames_that_are_clearly_outside_are_left_out_without_a_registered_clock_all() -> None:
    for frames_s, clock_s in (
        (FRAMES_S, -0.15),
        (FRAMES_S * 0.1, -0.011),  # more than half of 0.02 s
        (FRAMES_S - 0.01, 0.0),
    ):
        assert within_scene(frames_s, clock_s, 0.8)[1].tolist() == [False, True, True, True, True]
    assert within_scene(FRAMES_S - 1e-9, 0.0, 0.8)[1].all()
