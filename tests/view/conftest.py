"""Small finished runs to look at, and tracks that are made of the truth, so that it is known whom they follow."""

from pathlib import Path

import numpy as np
import pytest

from modsim3d import RunRows, load_scene, open_run, run_scene
from modsim3d.tracks.tracks import Tracks, TrackSet
from tests.scenes import crossing, mistaken_strait


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twelve steps; tests write only pictures into it."""
    folder = tmp_path_factory.mktemp("view")
    run_scene(load_scene(crossing(folder, 12)), folder / "run")
    return folder / "run"


@pytest.fixture(scope="session")
def exact_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same scene with exact truth, for tracks that are made of it."""
    folder = tmp_path_factory.mktemp("analytic")
    run_scene(load_scene(str(crossing(folder, 12)), source="analytic"), folder / "run")
    return folder / "run"


@pytest.fixture(scope="session")
def rows(exact_run: Path) -> RunRows:
    return RunRows.of(open_run(exact_run))


@pytest.fixture(scope="session")
def mistaken_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run in which the detector makes every kind of mistake."""
    folder = tmp_path_factory.mktemp("mistaken")
    run_scene(load_scene(mistaken_strait(folder)), folder / "run")
    return folder / "run"


FALSE_TRACK = 90  # in the corner of the first camera's image, where no vessel is


def perfect(rows: RunRows) -> Tracks:
    """A track on each vessel of which something is seen, with the vessel's index as its number; exact boxes."""
    there, cameras = rows.annotated, len(rows.scene.cameras)
    return Tracks.of(cameras, rows.truth_frame[there], rows.truth_vessel[there], rows.annotated_boxes_px[there])


def swapped(tracks: Tracks, a: int, b: int, step: int) -> Tracks:
    """The same boxes, with the numbers of two tracks exchanged from a step on."""
    number = tracks.track.copy()
    for old, new in ((a, b), (b, a)):
        number[(tracks.track == old) & (tracks.step >= step)] = new
    return Tracks.of(tracks.cameras, tracks.frame, number, tracks.boxes_px)


def with_false(tracks: Tracks, steps: range) -> Tracks:
    """The same with a false track at some steps of the first camera."""
    false = np.array(steps) * tracks.cameras
    frame, track = np.append(tracks.frame, false), np.append(tracks.track, np.full(len(steps), FALSE_TRACK))
    boxes_px = np.vstack([tracks.boxes_px, np.tile([2.0, 2.0, 32.0, 22.0], (len(steps), 1))])
    return Tracks.of(tracks.cameras, frame, track, boxes_px)


def as_set(tracks: Tracks) -> TrackSet:
    return TrackSet("made", tracks, None)


def write_csv(tracks: Tracks, rows: RunRows, path: Path) -> Path:
    names = [camera.name for camera in rows.scene.cameras]
    lines = ["camera,step,track,x_min_px,y_min_px,x_max_px,y_max_px"]
    columns = (tracks.camera, tracks.step, tracks.track, tracks.boxes_px)
    for camera, step, track, box in zip(*(column.tolist() for column in columns), strict=True):
        lines.append(",".join(map(str, (names[camera], step, track, *box))))
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
