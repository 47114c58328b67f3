"""Approaches to own ship against distances worked out by hand."""

from pathlib import Path

import numpy as np
import pytest

from modsim3d import RunRows, Tracks
from modsim3d.tracking.lookout import LOST_S, approaches, tracks_in_images, tracks_in_world
from modsim3d.tracking.scores.scored import Rules, Scored
from modsim3d.tracking.world.following import WorldTruth, follow_in_world
from tests.scenes import camera_keys
from tests.tracking.test_world_scores import tracks_of
from tests.tracks import sea_runs
from tests.tracks.sea_runs import ANCHORED, CROSSER, NAMES, PLACES_M, TIMES_S


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> RunRows:
    return RunRows.of(sea_runs.sea_run(tmp_path_factory.mktemp("sea") / "run"))


@pytest.fixture(scope="module")
def seen(rows: RunRows) -> np.ndarray:
    return WorldTruth.of(rows).scored


def found_of(rows: RunRows, parts) -> dict:
    following = follow_in_world(WorldTruth.of(rows), tracks_of(parts), 50.0)
    return {each.vessel: each for each in approaches(rows, tracks_in_world(rows, following))}


def apart_m(vessel: int, step: int) -> float:
    return float(np.hypot(*(PLACES_M[step, vessel] - PLACES_M[step, 0])))


def test_an_approach_has_its_distances_in_view_at_the_closest_and_where_it_was_first_followed(rows, seen) -> None:
    found = found_of(rows, [(CROSSER, TIMES_S[6:40]), (ANCHORED, TIMES_S[20:])])
    assert set(found) == {"crosser", "anchored"}  # no camera sees the vessel astern
    crosser = found["crosser"]
    assert (crosser.own_ship, crosser.label, crosser.length_m) == ("own", "boat", 12)
    assert crosser.in_view_m == pytest.approx(apart_m(CROSSER, 0), abs=1e-3)
    # The closest approach is at 20.49 s; steps are 0.5 s apart.
    assert crosser.closest_m == pytest.approx(min(apart_m(CROSSER, step) for step in range(60)), abs=1e-3)
    assert crosser.known_m == crosser.one_track_m == pytest.approx(apart_m(CROSSER, 6), abs=1e-3)
    assert found["anchored"].known_m == pytest.approx(apart_m(ANCHORED, 20), abs=1e-3)


def test_a_vessel_is_lost_after_five_seconds_in_view_or_with_another_track_and_hidden_time_is_no_loss(rows, seen):
    short, long = int(LOST_S / 0.5), int(LOST_S / 0.5) + 1
    hidden = np.flatnonzero(~seen[:, ANCHORED])
    assert hidden[-1] < 42 and len(hidden) > 1
    for missing, kept, one in ((short, 0, 0), (long, 42 + long, 42 + long)):
        parts = [(ANCHORED, np.delete(TIMES_S, np.arange(42, 42 + missing)))]
        found = found_of(rows, parts)["anchored"]
        assert [found.known_m, found.one_track_m] == pytest.approx(
            [apart_m(ANCHORED, s) for s in (kept, one)], abs=1e-3
        )
    found = found_of(rows, [(ANCHORED, TIMES_S[:30]), (ANCHORED, TIMES_S[30:])])["anchored"]
    assert [found.known_m, found.one_track_m] == pytest.approx([apart_m(ANCHORED, s) for s in (0, 30)], abs=1e-3)
    around = np.arange(hidden[0], min(hidden[-1] + short, 59))  # too long, but for the time in which it is hidden
    assert len(around) > short
    assert found_of(rows, [(ANCHORED, np.delete(TIMES_S, around))])["anchored"].known_m == pytest.approx(
        200.998, abs=1e-3
    )
    for times in (TIMES_S[:40], np.zeros(0)):  # gone before the end, or never there
        assert found_of(rows, [(CROSSER, TIMES_S[:1]), (ANCHORED, times)])["anchored"].known_m == 0


def test_tracks_in_the_images_are_those_of_own_ships_cameras_and_each_camera_has_its_own(tmp_path: Path) -> None:
    ahead = {"vessel": "own", "position_m": [5, 0, 6], "pitch_rad": 0.02}
    cameras = {name: camera_keys(1280, 720, focal_length_m=0.008, mount=ahead) for name in ("bow", "twin")}
    cameras["ashore"] = camera_keys(1280, 720, focal_length_m=0.008, pose={"position_m": [-300, 0, 9]})
    rows = RunRows.of(sea_runs.sea_run(tmp_path / "run", cameras=cameras))
    here = np.flatnonzero(rows.truth_vessel == ANCHORED)
    frame, boxes = rows.truth_frame[here], rows.annotated_boxes_px[here]
    halves = (frame % 3 == 0) & (frame < 90) | (frame % 3 == 1) & (frame >= 90)  # by one camera, then by the other

    def kept(chosen):
        tracks = Tracks.of(3, frame[chosen], np.full(int(chosen.sum()), 7), boxes[chosen])
        following = Scored.of(rows, tracks, Rules()).following
        found = {each.vessel: each for each in approaches(rows, tracks_in_images(rows, following))}
        return found[NAMES[ANCHORED]]

    every, both, ashore = kept(frame % 3 == 0), kept(halves), kept(frame % 3 == 2)
    assert (every.known_m, every.one_track_m) == (pytest.approx(200.998, abs=1e-3),) * 2
    assert (both.known_m, ashore.known_m) == (every.known_m, 0)
    assert both.one_track_m == pytest.approx(apart_m(ANCHORED, 30), abs=1e-3)


def test_a_vessel_that_is_lost_after_the_closest_approach_was_known(tmp_path: Path) -> None:
    port = {"vessel": "own", "position_m": [5, 0, 6], "pitch_rad": 0.02, "yaw_rad": np.pi / 2}
    cameras = {"port": camera_keys(1280, 720, focal_length_m=0.008, mount=port)}
    rows = RunRows.of(sea_runs.sea_run(tmp_path / "run", cameras=cameras))
    seen = np.flatnonzero(WorldTruth.of(rows).scored[:, CROSSER])
    assert seen[-1] == 59 and TIMES_S[seen[0]] < 20.49  # it passes at 20.49 s, and is in view to the end
    (found,) = [each for name, each in found_of(rows, [(CROSSER, TIMES_S[:43])]).items() if name == "crosser"]
    assert found.known_m == found.in_view_m > found.closest_m
