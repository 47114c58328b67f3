"""The frames of a run for the player of its page, in few bytes.

Columns of small integers are stored one after the other, gzipped, in base64. A length in the image is a multiple of
`quantum_px`, which is 0.1 px for all but very large images.
"""

from __future__ import annotations

import base64
import gzip
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array, Indices
from modsim3d.detector.records import KINDS
from modsim3d.runs.files.columns import NOBODY, indices, numbers
from modsim3d.runs.outcomes import Outcome
from modsim3d.runs.run_rows import RunRows
from modsim3d.scene.scene import Scene
from modsim3d.view import palette
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.report.packing import Column, in_quanta, starts
from modsim3d.view.report.silhouettes import NONE, silhouette_columns
from modsim3d.view.report.track_columns import track_columns, track_facts

FINEST_PX = 0.1
UNKNOWN_FRACTION, WHOLE = 255, 250
"""Visible fractions are counted in 250ths."""
ALIGNED_BYTES = 8
"""A typed array in the browser begins at a multiple of its item's size."""
NO_STATE, ALL_SEA = 255, (0.0, 0.0, 1.0)
"""What stands for the state and the horizon of a camera that has not taken a frame yet."""


@dataclass(frozen=True, eq=False)
class Recording:
    """The frames of a run for the player: columns of numbers, and what they mean (names, colours, times)."""

    facts: dict[str, Any]
    columns: dict[str, Column]

    def packed(self) -> tuple[list[dict[str, Any]], str]:
        """Where each column begins, and all of them as text; the same for the same numbers."""
        index, parts, offset = [], [], 0
        for name, column in self.columns.items():
            data = np.ascontiguousarray(column, dtype=column.dtype.newbyteorder("<")).tobytes()
            index.append({"name": name, "type": column.dtype.name, "offset": offset, "length": int(column.size)})
            padding = -len(data) % ALIGNED_BYTES
            parts += [data, bytes(padding)]
            offset += len(data) + padding
        return index, base64.b64encode(gzip.compress(b"".join(parts), compresslevel=9, mtime=0)).decode("ascii")


def recording(
    rows: RunRows, every: int, progress: Callable[[int], None], followed: FollowedTracks | None = None
) -> Recording:
    """The recording of every K-th step, with tracks if there are some.

    A camera with a frame rate of its own shows the last frame that it took. Before its first one it shows an empty
    frame, which is stored after all others. `progress` is called with the number of steps done since its last call.
    """
    scene, cameras = rows.scene, len(rows.scene.cameras)
    steps = np.arange(0, rows.steps, every)
    taken = rows.last_taken(steps)
    numbered = np.where(taken == NOBODY, NOBODY, taken * cameras + np.arange(cameras)).ravel()
    frames = np.unique(numbered[numbered != NOBODY])
    quantum = quantum_px([camera.intrinsics.image_size_px for camera in scene.cameras])
    horizons, frame, silhouettes = silhouette_columns(rows, taken, frames, quantum, progress)
    state, pages = rows.states_of(frames), len(frames)
    if np.any(numbered == NOBODY):
        state, horizons, pages = np.append(state, NO_STATE), np.vstack([horizons, ALL_SEA]), pages + 1
    columns: dict[str, Column] = {
        "state": state.astype(np.uint8),
        "horizon": horizons.astype(np.float32),
        "shapeStart": starts(frame, pages),
        **silhouettes,
        **_truth_columns(rows, frames, pages, quantum),
        **_detection_columns(rows, frames, pages, quantum),
    }
    facts = _facts(scene, steps, quantum)
    if followed is not None:
        columns |= track_columns(followed, frames, pages, quantum)
        facts["tracks"] = track_facts(followed)
    if len(frames) < numbered.size:  # some are shown more than once
        shown = np.where(numbered == NOBODY, len(frames), np.searchsorted(frames, numbered))
        columns |= {"frame": shown.astype(np.uint32), "taken": taken.ravel().astype(np.int32)}
    return Recording(facts, columns)


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
        "outcome": rows.outcomes[drawn],
        "kind": indices(rows.detections, "kind", KINDS)[drawn].astype(np.uint8),
        "box": in_quanta(rows.detection_boxes_px()[drawn], quantum),
    }


def _facts(scene: Scene, steps: Indices, quantum: float) -> dict[str, Any]:
    """What the numbers mean: names, times, colours."""
    stop = int(steps[-1]) + 1
    timestamps, times_s = scene.timestamps(0, stop), scene.times_s(0, stop)
    vessels = [palette.vessel_colour(index) for index in range(len(scene.vessels))]
    obstacles = [palette.obstacle_colour(index) for index in range(len(scene.obstacles))]
    states = palette.state_colours(len(scene.detector.states))
    return {
        "quantum": quantum,
        "mode": scene.annotation.mode,
        "steps": steps.tolist(),
        "timestamps": [timestamps[step] for step in steps],
        "times": np.round(times_s[steps], 6).tolist(),
        "states": [state.name for state in scene.detector.states],
        "labels": list(scene.detector.labels),
        "kinds": list(KINDS),
        "outcomes": {outcome.name: outcome.value for outcome in Outcome},
        "occluders": list(scene.occluder_names),
        "vessels": [{"name": v.name, "label": v.label} for v in scene.vessels],
        "cameras": [
            {"name": camera.name, "size": list(camera.intrinsics.image_size_px), "carrier": camera.mount.vessel}
            for camera in scene.cameras
        ],
        "colours": {
            "vessels": [palette.css(colour) for colour in vessels],
            "owners": [*(palette.css(palette.darker(colour)) for colour in vessels), *map(palette.css, obstacles)],
            "states": [palette.css(colour) for colour in states],
            **{name: palette.css(getattr(palette, name.upper())) for name in ("sea", "sky", "truth", "alarm", "ink")},
        },
    }


def quantum_px(image_sizes_px: list[tuple[int, int]]) -> float:
    """The finest length with which every place in the images fits into 16 bits."""
    return max(FINEST_PX, max(max(size) for size in image_sizes_px) / (NONE - 1))


def in_250ths(fraction: Array) -> NDArray[np.uint8]:
    """Visible fractions in 250ths, of the same shape; NaN is `UNKNOWN_FRACTION`, and a part never rounds to 0 or 1."""
    counted = np.clip(np.rint(np.nan_to_num(fraction) * WHOLE), np.where(fraction > 0, 1, 0), WHOLE)
    counted = np.where((fraction < 1) & (counted == WHOLE), WHOLE - 1, counted)
    return np.where(np.isnan(fraction), UNKNOWN_FRACTION, counted).astype(np.uint8)
