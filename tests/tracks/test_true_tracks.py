"""Identities and what is scored, from a run's truth."""

from pathlib import Path

import numpy as np
import pytest

from modsim3d.runs.run import run_scene
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import open_run
from modsim3d.scene.scene import Scene
from modsim3d.tracks.true_tracks import TrueTracks
from tests.scenes import camera_keys
from tests.tracking.hand_made import box
from tests.tracking.hand_made import rows_of as rows_by_hand

BOAT = {"length_m": 10, "beam_m": 4, "air_draft_m": 5, "label": "Vessel"}
CAMERA = camera_keys(400, 200, pose={"position_m": [0, 0, 3]})  # along w1: at 100 m it sees 20 m to either side
FRONT, BEHIND, ASIDE, AWAY = (100.0, 0.0), (200.0, 0.0), (100.0, 10.0), None
Place = tuple[float, float] | None


def rows_of(folder: Path, ways: dict[str, list[Place]], **annotation: object) -> RunRows:
    """A run of boats that show the camera their side, with their places a second apart, None for absent."""
    positions = np.array([[place or (np.nan, np.nan) for place in way] for way in ways.values()]).swapaxes(0, 1)
    headings = np.where(np.isnan(positions[:, :, 0]), np.nan, np.pi / 2)
    scene = Scene.from_dict(
        {
            "vessels": dict.fromkeys(ways, BOAT),
            "poses": {"positions_m": positions, "headings_rad": headings, "time_step_s": 1.0},
            "cameras": {"c": CAMERA},
            "annotation": {"mode": 1, "source": "analytic", **annotation},
            "detector": "thesis",
        }
    )
    run_scene(scene, folder)
    return RunRows.of(open_run(folder))


@pytest.mark.parametrize(("away_s", "identities"), [(1, 1), (2, 1), (3, 2)])
def test_a_vessel_that_was_outside_the_image_for_longer_than_the_gap_is_a_new_identity(
    tmp_path: Path, away_s: int, identities: int
) -> None:
    rows = rows_of(tmp_path / "run", {"a": [FRONT, FRONT, *[AWAY] * (away_s - 1), FRONT]})
    assert len(np.unique(TrueTracks.of(rows, gap_s=2).identity)) == identities
    assert len(np.unique(TrueTracks.of(rows, gap_s=0).identity)) == (1 if away_s == 1 else 2)


def test_an_absence_as_long_as_the_gap_is_none_whatever_the_last_bits_of_times_are() -> None:
    for frame in range(20):
        rows = rows_by_hand([(frame, 0, box()), (frame + 10, 0, box())], 31, step_s=0.2)
        assert TrueTracks.of(rows, gap_s=2).identity.tolist() == [0, 0]
        assert TrueTracks.of(rows, gap_s=1.999).identity.tolist() == [0, 1]


def test_a_hidden_vessel_keeps_its_identity_and_is_not_scored_even_if_annotated(tmp_path: Path) -> None:
    rows = rows_of(tmp_path / "run", {"a": [FRONT] * 6, "b": [(200.0, 30.0), *[BEHIND] * 4, (200.0, 30.0)]})
    truth = TrueTracks.of(rows, gap_s=0)
    b = truth.vessel == 1
    assert len(np.unique(truth.identity[b])) == 1
    assert truth.hidden[b].tolist() == [False, True, True, True, True, False]
    assert (truth.scored == ~truth.hidden).all()
    assert np.isfinite(truth.boxes_px).all()  # the box of the whole vessel where nothing is visible
    rows = rows_of(tmp_path / "thesis", {"a": [FRONT], "b": [BEHIND]}, mode=0)
    assert rows.annotated.all() and TrueTracks.of(rows).scored.tolist() == [True, False]


def test_full_truth_has_the_whole_vessel_and_all_of_them_and_annotated_truth_what_mode_and_filter_take(
    tmp_path,
) -> None:
    """Half of b's 50 px stand behind a: its whole box is 50 px wide, its visible one 25 px and a little more."""
    rows = rows_of(tmp_path / "run", {"a": [FRONT], "b": [(200.0, 10.0)]}, mode=2)
    annotated, full = (TrueTracks.of(rows, name).boxes_px[1] for name in ("annotated", "full"))
    assert full[2] - full[0] > 49 and 24 < annotated[2] - annotated[0] < 30
    rows = rows_of(tmp_path / "far", {"a": [FRONT], "b": [(2000.0, 300.0)]}, min_visible_px=100)
    annotated, full = (TrueTracks.of(rows, name).scored.tolist() for name in ("annotated", "full"))
    assert (annotated, full) == ([True, False], [True, True]) and not TrueTracks.of(rows).hidden.any()
