"""Vessels that are put back from where late reports of their antennas put them."""

from __future__ import annotations

import numpy as np

from benchmarks.voyages.reported import AisErrors, as_reported
from modsim3d.learn.voyage.camera_registration import with_moved_vessels
from modsim3d.scene.scene import Scene


def test_antennas_and_delays_are_taken_off_again(strait: Scene) -> None:
    reported, wrong = as_reported(strait, 0, AisErrors(along_m=3.0, across_m=1.0, delay_s=0.5))
    true, off, back = (
        each.poses.poses(0, strait.steps).positions_m[8:-8, :, :2]
        for each in (strait, reported, with_moved_vessels(reported, wrong))
    )
    assert np.abs(off - true).max() > 3
    assert np.abs(back - true).max() < 0.05


def test_vessels_without_offsets_stay(strait: Scene) -> None:
    assert with_moved_vessels(strait, np.zeros((len(strait.vessels), 3))) is strait
