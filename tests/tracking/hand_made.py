"""Hand-made truth and tracks, held against each other without a run."""

from collections.abc import Iterable, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from modsim3d import RunRows, Scene, Tracks
from modsim3d.runs.files.table_columns import schema_of
from modsim3d.tracking.scores.scored_run import Rules, ScoredRun
from tests.scenes import camera_keys

VESSELS = 6
LABELS = ("sailboat", "motorboat", "ferry")
"""Vessels 0 and 1 have the first label, 2 and 3 the second, 4 and 5 the third."""
STATES = ("clear", "haze")
Box = tuple[float, float, float, float]


def box(x: float = 0, y: float = 0, width: float = 20, height: float = 20) -> Box:
    """A box by its upper left corner."""
    return (x, y, x + width, y + height)


def placed(name: int, frames: Iterable[int], *place: float) -> list[tuple]:
    """A vessel or a track in some frames at one place, which is that of `box`."""
    return [(frame, name, box(*place)) for frame in frames]


class Seen(NamedTuple):
    """A vessel in an image; a plain (frame, vessel, box) will do for one that is all visible."""

    frame: int
    vessel: int
    box: Box
    visible: float | None = 1.0  # None where the vessel is too small for any pixel
    in_frame: float = 1.0
    depth_m: float = 150.0


class Tracked(NamedTuple):
    """A track in an image; a plain (frame, track, box) will do."""

    frame: int
    track: int
    box: Box
    label: int = -1
    covariance_px2: Sequence[Sequence[float]] = ((np.nan, np.nan), (np.nan, np.nan))


def hand_made(truth: Iterable[tuple], tracks: Iterable[tuple], steps, *, rules=None, cameras=1, **keys) -> ScoredRun:
    """Tracks, as for `Tracked`, held against truth, as for `Seen`; keys as those of `rows_of`."""
    return ScoredRun.of(rows_of(truth, steps, cameras=cameras, **keys), tracks_of(tracks, cameras), rules or Rules())


def rows_of(truth: Iterable[tuple], steps: int, *, cameras=1, states=None, step_s=1.0) -> RunRows:
    """The rows of a run with hand-made truth and without detections. Frame = step × cameras + camera, and every camera
    takes a frame at each step, `step_s` apart; `states` are indices of each frame's performance state, all clear if
    None."""
    scene, seen = _scene(steps, cameras, step_s), [Seen(*row) for row in truth]
    named = (STATES[state] for state in states or [0] * (steps * cameras))
    frames = [{**_place(scene, frame), "state": state} for frame, state in enumerate(named)]
    tables = {"frames": frames, "truth": [_truth_row(scene, each) for each in seen], "detections": []}
    stored = {name: pa.Table.from_pylist(rows, schema_of(name)) for name, rows in tables.items()}
    return RunRows.of_tables(scene, steps, stored)


def tracks_of(tracks: Iterable[tuple], cameras: int = 1) -> Tracks:
    """Hand-made tracks."""
    rows = [Tracked(*row) for row in tracks]
    frame, track, boxes, label, covariance = zip(*rows, strict=True) if rows else ((), (), (), (), ())
    covariances = np.array(covariance, dtype=float).reshape(len(rows), 2, 2)
    return Tracks.of(cameras, np.array(frame), np.array(track), np.array(boxes), np.array(label), None, covariances)


def _truth_row(scene: Scene, seen: Seen) -> dict[str, object]:
    vessel, edges = scene.vessels[seen.vessel], ("x_min_px", "y_min_px", "x_max_px", "y_max_px")
    kinds = ("full", "visible") if seen.visible else ("full",)
    pixels = 0.0 if seen.visible is None else (seen.box[2] - seen.box[0]) * (seen.box[3] - seen.box[1])
    return {
        **_place(scene, seen.frame),
        **{f"{kind}_{edge}": float(value) for kind in kinds for edge, value in zip(edges, seen.box, strict=True)},
        **{"vessel": vessel.name, "label": vessel.label, "occluded_by": []},
        **{"silhouette_px": float(pixels), "visible_px": float((seen.visible or 0) * pixels)},
        "visible_fraction": seen.visible if seen.visible is None else float(seen.visible),
        **{"in_frame_fraction": float(seen.in_frame), "depth_m": float(seen.depth_m)},
        **{"annotated": bool(seen.visible), "detected": False},
    }


def _place(scene: Scene, frame: int) -> dict[str, object]:
    step, camera = divmod(frame, len(scene.cameras))
    return {"camera": scene.cameras[camera].name, "step": step, "timestamp": scene.poses.timestamps[step]}


@cache
def _scene(steps: int, cameras: int, step_s: float) -> Scene:
    """A scene with six vessels, three labels and two performance states."""
    size, camera = {"length_m": 10, "beam_m": 4, "air_draft_m": 3}, camera_keys(pose={"position_m": [0, 0, 10]})
    scene = {
        **{"steps": steps, "time_step_s": step_s, "cameras": {f"C{k}": camera for k in range(cameras)}},
        "vessels": {f"v{k}": {**size, "label": LABELS[k // 2]} for k in range(VESSELS)},
        "poses": {"tracks": {f"v{k}": [[0, 100 + 20 * k, 0], [10_000, 100 + 20 * k, 1]] for k in range(VESSELS)}},
        **{"annotation": {"mode": 0, "source": "analytic"}, "detector": "rich"},
    }
    return Scene.from_dict(scene, name="hand_made")
