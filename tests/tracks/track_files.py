"""Files of tracks of small runs: detections numbered by vessel, and a straight-line encounter as CSV."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import modsim3d
from benchmarks.voyages.cases import SHOEBOXES
from modsim3d.runs.stored_run import StoredRun
from modsim3d.scene.scene import Scene
from modsim3d.tracks.tracks import Tracks
from tests.run_folders import finished
from tests.scenes import camera_keys

IMAGE_PX = (1920, 1080)


def scene_run(folder, scene: str, steps: int = 8, **keys) -> modsim3d.StoredRun:
    """A run of a shipped scene with exact geometry; of the strait with shoeboxes, which takes a tenth of the time."""
    settings = SHOEBOXES if scene == "strait" else {}
    return finished(modsim3d.load_scene(scene, steps=steps, source="analytic", settings=settings, **keys), folder)


def detected_tracks(rows) -> Tracks:
    """The detections that came from a vessel, with the vessel as the track."""
    known = rows.detection_vessel >= 0
    frame, vessel = rows.detection_frame[known], rows.detection_vessel[known]
    first = np.unique(np.column_stack([frame, vessel]), axis=0, return_index=True)[1]
    boxes = np.round(rows.detection_boxes_px()[known], 3)
    return Tracks.of(len(rows.scene.cameras), frame[first], vessel[first], boxes[first])


def top_left(boxes_px):
    return np.concatenate([boxes_px[:, :2], boxes_px[:, 2:] - boxes_px[:, :2]], axis=1)


def csv_text(rows, tracks, numbers=None, names="x_min_px,y_min_px,x_max_px,y_max_px", when="step") -> str:
    numbers = tracks.boxes_px if numbers is None else numbers
    cameras = [camera.name for camera in rows.scene.cameras]
    times = tracks.step if when == "step" else rows.scene.times_s(0, rows.steps)[tracks.step]
    lines = [f"camera,{when},track,{names}"]
    lines += [
        ",".join([cameras[camera], f"{time:.9g}", str(track), *(f"{number:.9g}" for number in four)])
        for camera, time, track, four in zip(tracks.camera, times, tracks.track, numbers, strict=True)
    ]
    return "\n".join(lines) + "\n"


def mot_texts(rows, tracks, numbers=None, first_frame=1) -> dict[str, str]:
    numbers = top_left(tracks.boxes_px) + np.array([1, 1, 0, 0]) if numbers is None else numbers
    cameras, texts = [camera.name for camera in rows.scene.cameras], {}
    for index, name in enumerate(cameras):
        taken = rows.frames[rows.frames % len(cameras) == index]
        here = tracks.camera == index
        frame = np.searchsorted(taken, tracks.frame[here]) + first_frame
        lines = [
            f"{at},{track},{','.join(f'{each:.9g}' for each in four)},1,-1,-1,-1"
            for at, track, four in zip(frame, tracks.track[here], numbers[here], strict=True)
        ]
        texts[f"{name}.txt"] = "".join(f"{line}\n" for line in lines)
    return texts


def write_mot(folder, texts):
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


STEPS, STEP_S = 60, 0.5
TIMES_S = np.arange(STEPS) * STEP_S
OWN, CROSSER, ASTERN, ANCHORED = range(4)
NAMES = ("own", "crosser", "astern", "anchored")
ORIGIN = (63.4, 10.4)
VELOCITIES_M_S = np.array([(5.0, 0.0), (0.0, 4.0), (5.0, 0.0), (0.0, 0.0)])
STARTS_M = np.array([(0.0, 0.0), (120.0, -60.0), (-80.0, 10.0), (200.0, 20.0)])
PLACES_M = STARTS_M + TIMES_S[:, None, None] * VELOCITIES_M_S  # (steps, vessels, 2)
"""A straight-line encounter that can be worked out by hand. Own ship makes 5 m/s along w1 and looks ahead. `crosser`
begins 120 m ahead and 60 m to starboard and makes 4 m/s along w2. `astern` follows own ship, and no camera sees it.
`anchored` lies 200 m ahead, own ship does not get there, and the crosser hides it for a moment."""


def sea_scene(**keys: Any) -> Scene:
    """The scene; keys of the scene file replace its own."""
    hull = {"length_m": 12, "beam_m": 4, "air_draft_m": 6, "label": "boat"}
    headings = np.tile([0.0, np.pi / 2, 0.0, 0.0], (STEPS, 1))
    ahead = {"vessel": "own", "position_m": [5, 0, 6], "pitch_rad": 0.02}
    data: dict[str, Any] = {
        "seed": 1,
        "vessels": dict.fromkeys(NAMES, hull),
        "poses": {"positions_m": PLACES_M, "headings_rad": headings, "time_step_s": STEP_S},
        "cameras": {"bow": camera_keys(1280, 720, focal_length_m=0.008, mount=ahead)},
        "annotation": {"mode": 0, "source": "analytic"},
        "detector": "coastal",
        "origin": {"latitude_deg": ORIGIN[0], "longitude_deg": ORIGIN[1]},
    }
    return Scene.from_dict({key: value for key, value in (data | keys).items() if value is not None}, name="sea")


def sea_run(folder: Path, **keys: Any) -> StoredRun:
    return finished(sea_scene(**keys), folder)


def write_csv(path: Path, columns: Mapping[str, Any]) -> Path:
    lines = [",".join(columns), *(",".join(map(str, row)) for row in zip(*columns.values(), strict=True))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
