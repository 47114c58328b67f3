"""False positives on vessels: how many, for how long, where, and how large."""

import numpy as np
import pytest

from modsim3d.core.boxes import centres, sizes
from modsim3d.core.errors import InputError
from modsim3d.detector import records
from modsim3d.detector.file.reading import parse_detector
from tests.detector import detector_builders as build

FRAMES, VESSELS = 6000, 3
LAW = {"share": 0.2, "mean": [0.1, -0.2, 0.3, -0.4], "std": [0.3, 0.1, 0.2, 0.4]}
BOXES = np.array([[600.0 + 700 * k, 900, 700 + 700 * k, 940] for k in range(VESSELS)])


def detector(lifetime_s: float = 0.0, missed: float = 0.5, **keys):
    confusion = [[1 - missed, 0], [0, 1 - missed], [missed, missed]]
    data = build.one_state_data(confusion=confusion, false_positives_per_image=0.0, box_error=build.no_error())
    del data["states"]["only"]["false_discovery_rate"]
    on = LAW | ({"lifetime_s": lifetime_s} if lifetime_s else {}) | keys
    return data | {"false_positives": {"model": "per_image", "on_vessels": on}}


def shown(lifetime_s: float = 0.0, missed: float = 0.5):
    """Whether each vessel has one in each frame (frames, vessels), its place (..., 4), and all detections."""
    targets = build.make_targets(np.tile(BOXES, (FRAMES, 1, 1)))
    found = build.run(detector(lifetime_s, missed), build.make_frames(FRAMES), targets, 3)
    rows = np.flatnonzero(found.kind == records.ON_VESSEL)
    there, place = np.zeros((FRAMES, VESSELS), dtype=bool), np.full((FRAMES, VESSELS, 4), np.nan)
    at = found.frame[rows], targets.vessel[found.target[rows]]
    true, box = targets.boxes_px[found.target[rows]], found.boxes_px[rows]
    there[at] = True
    place[at] = np.hstack([(centres(box) - centres(true)) / sizes(true), np.log(sizes(box) / sizes(true))])
    return there, place, found, targets


def test_they_are_on_found_and_missed_vessels_alike_with_the_asked_place_and_size() -> None:
    there, place, found, targets = shown()
    error = np.sqrt(0.2 * 0.8 / there.size)
    assert abs(there.mean() - 0.2) < 4 * error
    seen = np.zeros(len(targets), dtype=bool)
    seen[found.target[found.kind == records.TRUE]] = True
    assert abs(there.ravel()[seen].mean() - there.ravel()[~seen].mean()) < 6 * error
    values = place[there]
    assert np.all(np.abs(values.mean(axis=0) - LAW["mean"]) < 4 * np.array(LAW["std"]) / np.sqrt(len(values)))
    assert np.all(np.abs(values.std(axis=0) / LAW["std"] - 1) < 4 / np.sqrt(2 * len(values)))
    assert np.all(np.abs(np.corrcoef(values.T) - np.eye(4)) < 4 / np.sqrt(len(values)))
    assert np.all(found.false() == (found.kind == records.ON_VESSEL))
    assert not np.any(found.gated)


def test_one_that_stays_keeps_its_place_and_the_share_is_the_same() -> None:
    """With 0.1 s between frames one is there in the next with e^(−1/τ) + (1 − e^(−1/τ)) · share."""
    there, place, _, _ = shown(lifetime_s=0.4)
    kept = np.exp(-0.1 / 0.4)
    inflation = (1 + kept) / (1 - kept)
    assert abs(there.mean() - 0.2) < 4 * np.sqrt(0.16 * inflation / there.size)
    again = there[1:][there[:-1]]
    expected = kept + (1 - kept) * 0.2
    assert abs(again.mean() - expected) < 4 * np.sqrt(expected * (1 - expected) / len(again))
    both = there[1:] & there[:-1]
    same = np.abs(place[1:][both] - place[:-1][both]).max(axis=1) < 1e-9
    assert abs(same.mean() - kept / expected) < 4 * np.sqrt(0.25 / len(same))


def test_nothing_else_changes_and_no_box_leaves_the_image() -> None:
    """Streams of their own: the other detections are those of the detector without them."""
    targets = build.make_targets(np.tile([[1.0, 1.0, 40.0, 20.0]], (400, 1, 1)))
    frames, data = build.make_frames(400), detector()
    found = build.run(data, frames, targets, 5)
    del data["false_positives"]["on_vessels"]
    plain = build.run(data, frames, targets, 5)
    others = found.kind != records.ON_VESSEL
    assert np.array_equal(found.boxes_px[others], plain.boxes_px)
    assert np.all(sizes(found.boxes_px) >= 1 - 1e-9) and np.all(found.boxes_px >= 0)
    assert 0 < np.count_nonzero(~others) < 0.2 * 400 * 1.3


def test_what_cannot_be_is_refused() -> None:
    wrong = {
        ".share": {"on_vessels": LAW | {"share": 1.0}},
        ".std": {"on_vessels": LAW | {"std": [0.1, -0.1, 0.1, 0.1]}},
        ": model calibrated counts those on vessels too": {"model": "calibrated"},
    }
    for message, change in wrong.items():
        data = detector()
        data["false_positives"] |= change
        with pytest.raises(InputError, match=f"false_positives.on_vessels{message}"):
            parse_detector(data)
