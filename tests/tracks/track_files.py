"""Files of tracks of a small run: its detections, numbered as if each vessel were a track."""

import numpy as np

import modsim3d
from modsim3d.tracks.tracks import Tracks
from tests.run_folders import finished

IMAGE_PX = (1920, 1080)


def scene_run(folder, scene: str, steps: int = 8, **keys) -> modsim3d.StoredRun:
    """A run of a shipped scene with exact geometry."""
    return finished(modsim3d.load_scene(scene, steps=steps, source="analytic", **keys), folder)


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
