"""A run as the columns that its page's player reads."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from modsim3d.arrays import Indices
from modsim3d.runs.files.columns import NOBODY, indices, numbers
from modsim3d.runs.run_rows import RunRows
from modsim3d.scene.scene import Scene
from modsim3d.view import palette
from modsim3d.view.report.recording import NONE, Column, Recording, in_250ths, in_quanta, quantum_px, starts
from modsim3d.view.report.run_silhouettes import silhouettes

NO_STATE, ALL_SEA = 255, (0.0, 0.0, 1.0)
"""What stands for the state and the horizon of a camera that has not taken a frame yet."""


def recording(rows: RunRows, every: int, progress: Callable[[int], None]) -> Recording:
    """The recording of every K-th step.

    A camera with a frame rate of its own shows the last frame that it took. Before its first one it shows an empty
    frame, which is stored after all others.

    Args:
        rows: The run.
        every: K.
        progress: Called with the number of steps done since its last call.
    """
    scene, cameras = rows.scene, len(rows.scene.cameras)
    steps = np.arange(0, rows.steps, every)
    taken = rows.last_taken(steps)
    numbered = np.where(taken == NOBODY, NOBODY, taken * cameras + np.arange(cameras)).ravel()
    frames = np.unique(numbered[numbered != NOBODY])
    quantum = quantum_px([camera.intrinsics.image_size_px for camera in scene.cameras])
    drawn = silhouettes(rows, taken, frames, quantum, progress)
    state, horizons, pages = rows.states_of(frames), drawn.horizons, len(frames)
    if np.any(numbered == NOBODY):
        state, horizons, pages = np.append(state, NO_STATE), np.vstack([horizons, ALL_SEA]), pages + 1
    columns: dict[str, Column] = {
        "state": state.astype(np.uint8),
        "horizon": horizons.astype(np.float32),
        "shapeStart": starts(drawn.frame, pages),
        "owner": drawn.occluder.astype(np.uint16),
        "outline": drawn.outline.astype(np.uint32),
        "lineCount": drawn.line_count.astype(np.uint32),
        "cornerCount": drawn.corner_count,
        "corners": drawn.corners,
        **_truth_columns(rows, frames, pages, quantum),
        **_detection_columns(rows, frames, pages, quantum),
    }
    if len(frames) < numbered.size:  # some are shown more than once
        shown = np.where(numbered == NOBODY, len(frames), np.searchsorted(frames, numbered))
        columns |= {"frame": shown.astype(np.uint32), "taken": taken.ravel().astype(np.int32)}
    return Recording(_facts(scene, steps, quantum), columns)


def _truth_columns(rows: RunRows, frames: Indices, pages: int, quantum: float) -> dict[str, Column]:
    """The truth of frames, the farthest vessel of each frame first."""
    order = np.lexsort((-rows.numbers("depth_m"), rows.truth_frame))
    shown = order[np.isin(rows.truth_frame[order], frames)]
    occluders = rows.occluders()
    main_hider = np.full(len(order), NONE)
    least_first = np.argsort(occluders.px, kind="stable")
    main_hider[occluders.hidden[least_first]] = occluders.name[least_first]  # what is written last stays
    return {
        "truthStart": starts(np.searchsorted(frames, rows.truth_frame[shown]), pages),
        "vessel": rows.truth_vessel[shown].astype(np.uint16),
        "flags": (rows.annotated[shown] + 2 * rows.detected[shown]).astype(np.uint8),
        "fraction": in_250ths(rows.numbers("visible_fraction")[shown]),
        "depth": rows.numbers("depth_m")[shown].astype(np.float32),
        "hider": main_hider[shown].astype(np.uint16),
        "full": in_quanta(rows.boxes_px("full")[shown], quantum),
        "visible": in_quanta(rows.boxes_px("visible")[shown], quantum),
    }


def _detection_columns(rows: RunRows, frames: Indices, pages: int, quantum: float) -> dict[str, Column]:
    drawn = np.flatnonzero(np.isin(rows.detection_frame, frames))
    return {
        "drawnStart": starts(np.searchsorted(frames, rows.detection_frame[drawn]), pages),
        "drawnVessel": np.where(rows.detection_vessel < 0, NONE, rows.detection_vessel)[drawn].astype(np.uint16),
        "label": indices(rows.detections, "label", rows.scene.detector.labels)[drawn].astype(np.uint16),
        "confidence": np.rint(1000 * numbers(rows.detections, "confidence")[drawn]).astype(np.uint16),
        "box": in_quanta(rows.detection_boxes_px()[drawn], quantum),
    }


def _facts(scene: Scene, steps: Indices, quantum: float) -> dict[str, Any]:
    """What the numbers mean: names, times, colours."""
    stop = int(steps[-1]) + 1
    timestamps, times_s = scene.timestamps(0, stop), scene.times_s(0, stop)
    return {
        "quantum": quantum,
        "mode": scene.annotation.mode,
        "steps": steps.tolist(),
        "timestamps": [timestamps[step] for step in steps],
        "times": np.round(times_s[steps], 6).tolist(),
        "states": [state.name for state in scene.detector.states],
        "labels": list(scene.detector.labels),
        "occluders": list(scene.occluder_names),
        "vessels": [{"name": v.name, "label": v.label} for v in scene.vessels],
        "cameras": [
            {"name": camera.name, "size": list(camera.intrinsics.image_size_px), "carrier": camera.mount.vessel}
            for camera in scene.cameras
        ],
        "colours": {
            "vessels": [_css(palette.vessel_colour(index)) for index in range(len(scene.vessels))],
            "owners": [_css(palette.darker(colour)) for colour in map(palette.vessel_colour, range(len(scene.vessels)))]
            + [_css(palette.obstacle_colour(index)) for index in range(len(scene.obstacles))],
            "sea": _css(palette.SEA),
            "sky": _css(palette.SKY),
            "truth": _css(palette.TRUTH),
            "alarm": _css(palette.ALARM),
            "ink": _css(palette.INK),
        },
    }


def _css(colour: palette.Colour) -> str:
    return "#" + "".join(f"{channel:02x}" for channel in colour)
