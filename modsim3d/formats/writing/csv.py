"""A run as tables of text: what a tracker may read, with bearings and positions, and the truth (docs/positions.md)."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow import csv

from modsim3d.core.arrays import Array, Indices
from modsim3d.formats.writing.export_formats import ExportRequest
from modsim3d.geometry.camera import Camera
from modsim3d.geometry.camera_poses import BASE_R_WORLD, CameraPoses
from modsim3d.io.atomic_write import write_files
from modsim3d.runs.camera_sequences import CameraSequence
from modsim3d.runs.files.table_columns import BOX_SIDES
from modsim3d.runs.files.tables import number_column
from modsim3d.runs.locating import Attitude, Viewpoints, locate
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.tracker_view import BOX_DECIMALS
from modsim3d.scene.cameras import own_ships_at, true_attitudes
from modsim3d.scene.scene import Scene

Columns = Mapping[str, Any]
_DIGITS = 9  # of numbers that are worked out: the last of sixteen depend on the processor


def files(request: ExportRequest) -> tuple[str, ...]:
    """The paths of the files."""
    tables = [f"{table}_{name}.csv" for name in request.camera_names for table in ("detections", "frames", "truth")]
    return (*tables, "cameras.csv", *(["ownship.csv"] if request.run.scene.own_ships else []))


def write(request: ExportRequest, folder: Path) -> None:
    """Write a run."""
    request.run.scene.check_world("a table of bearings and places")
    scene, rows, measured = request.run.scene, RunRows.of(request.run), request.attitude == "measured"
    tables: dict[str, Columns] = {}
    for index, sequence in zip(request.cameras, request.sequences, strict=True):
        name = sequence.camera.name
        tables[f"detections_{name}.csv"] = _detections(scene, sequence, request.attitude)
        tables[f"frames_{name}.csv"] = _frames(rows, index, measured=measured)
        tables[f"truth_{name}.csv"] = _truth(rows, index)
    tables["cameras.csv"] = _cameras(scene, [scene.cameras[index] for index in request.cameras])
    if scene.own_ships:
        tables["ownship.csv"] = _own_ships(scene, rows.steps, measured=measured)
    write_files({folder / name: _text(columns) for name, columns in tables.items()})


def _text(columns: Columns) -> bytes:
    out = pa.BufferOutputStream()
    csv.write_csv(pa.table({name: pa.array(values, from_pandas=True) for name, values in columns.items()}), out)
    return bytes(out.getvalue())


def _when(scene: Scene, steps: Indices) -> Columns:
    stop = int(steps.max(initial=-1)) + 1
    stamps, times = np.array(scene.timestamps(0, stop), dtype=object), scene.times_s(0, stop)
    return {"step": steps, "timestamp": pa.array(stamps[steps], pa.string()), "time_s": times[steps]}


def _boxes(boxes_px: Array) -> Columns:
    return dict(zip(BOX_SIDES, np.round(boxes_px, BOX_DECIMALS).T, strict=True))


def _detections(scene: Scene, sequence: CameraSequence, attitude: Attitude) -> Columns:
    """The detections of a camera, those of a frame in the order of `tracker_input_CAMERA.jsonl`."""
    detections, labels = sequence.detections, np.array(scene.detector.labels, dtype=object)
    steps = sequence.steps[detections.frame]
    place = locate(scene, sequence.camera.name, steps, detections.boxes_px, attitude)
    names = ("bearing_rad", "bearing_std_rad", "inverse_range_per_m", "inverse_range_std_per_m", "covariance_rad_per_m")
    located = {name: getattr(place, name) for name in names}
    located |= zip(("w1_m", "w2_m"), place.positions_m.T, strict=True)
    entries = place.position_covariances_m2.reshape(-1, 4)[:, [0, 1, 3]].T
    located |= zip(("w1_variance_m2", "w1_w2_covariance_m2", "w2_variance_m2"), entries, strict=True)
    return {
        **_when(scene, steps),
        "label": pa.array(labels[detections.label], pa.string()),
        "confidence": detections.confidence,
        **_boxes(detections.boxes_px),
        **{name: rounded(values) for name, values in located.items()},
    }


def _frames(rows: RunRows, index: int, *, measured: bool) -> Columns:
    """The frames of a camera, and from where it took them."""
    scene, cameras = rows.scene, len(rows.scene.cameras)
    steps = rows.frames[rows.frames % cameras == index] // cameras
    poses = Viewpoints.of(scene, scene.cameras[index], steps, measured=measured).poses() if len(steps) else None
    places, angles = (poses.positions_m, _camera_angles(poses)) if poses else (np.empty((0, 3)), np.empty((0, 3)))
    return {
        **_when(scene, steps),
        **{f"camera_w{axis + 1}_m": rounded(places[:, axis]) for axis in range(3)},
        **{f"camera_{name}_rad": rounded(angles[:, k]) for k, name in enumerate(("roll", "pitch", "yaw"))},
    }


def _camera_angles(poses: CameraPoses) -> Array:
    """Roll, pitch and yaw of the camera ashore that would look the same way, shape (S, 3): see `camera_R_parent`."""
    turned = poses.camera_R_world @ BASE_R_WORLD.T  # Rz(roll) · Rx(pitch) · Ry(yaw)
    roll = np.arctan2(-turned[:, 0, 1], turned[:, 1, 1])
    pitch = np.arctan2(turned[:, 2, 1], np.hypot(turned[:, 0, 1], turned[:, 1, 1]))
    yaw = np.arctan2(-turned[:, 2, 0], turned[:, 2, 2])
    return np.stack([roll, pitch, yaw], axis=-1)


def _truth(rows: RunRows, index: int) -> Columns:
    """The vessels that are in the images of a camera: boxes, and bearing and inverse range of their centres."""
    scene = rows.scene
    mine = np.flatnonzero(rows.truth_frame % len(scene.cameras) == index)
    seen, vessel, steps = rows.truth.take(pa.array(mine)), rows.truth_vessel[mine], rows.truth_frame[mine]
    steps = steps // len(scene.cameras)
    at, frame = np.unique(steps, return_inverse=True)
    places, headings, cameras_m = np.empty((0, 3)), np.empty(0), np.empty((0, 3))
    if len(at):
        view = Viewpoints.of(scene, scene.cameras[index], at, measured=False)
        places, cameras_m = view.vessels.poses.positions_m[frame, vessel], view.poses().positions_m[frame]
        headings = view.vessels.poses.headings_rad[frame, vessel] + view.vessels.angles_rad[frame, vessel, 2]
    away = (places - cameras_m)[:, :2]
    return {
        **_when(scene, steps),
        **{name: seen[name] for name in ("vessel", "label", "annotated")},
        **_boxes(rows.annotated_boxes_px[mine]),
        "visible_fraction": rounded(number_column(seen, "visible_fraction")),
        "w1_m": rounded(places[:, 0]),
        "w2_m": rounded(places[:, 1]),
        "heading_rad": rounded(headings),
        "bearing_rad": rounded(np.arctan2(away[:, 1], away[:, 0])),
        "inverse_range_per_m": rounded(1 / np.hypot(away[:, 0], away[:, 1])),
    }


def _cameras(scene: Scene, cameras: list[Camera]) -> Columns:
    lenses, mounts = [camera.intrinsics for camera in cameras], [camera.mount for camera in cameras]
    coefficients = ("k1", "k2", "p1", "p2", "k3")
    return {
        "camera": [camera.name for camera in cameras],
        "width_px": [lens.image_size_px[0] for lens in lenses],
        "height_px": [lens.image_size_px[1] for lens in lenses],
        **{f"f{axis + 1}_px": rounded(np.array([lens.focal_px[axis] for lens in lenses])) for axis in range(2)},
        "a1_px": [lens.principal_point_px[0] for lens in lenses],
        "a2_px": [lens.principal_point_px[1] for lens in lenses],
        "skew_px": [lens.skew for lens in lenses],
        **{name: [getattr(lens.distortion, name, 0.0) for lens in lenses] for name in coefficients},
        "vessel": pa.array([mount.vessel for mount in mounts], pa.string()),
        **{f"mount_{axis + 1}_m": [mount.position_m[axis] for mount in mounts] for axis in range(3)},
        **{f"mount_{name}": [getattr(mount, name) for mount in mounts] for name in _ANGLES},
        "sea": [scene.sea] * len(cameras),
    }


_ANGLES = ("roll_rad", "pitch_rad", "yaw_rad")


def _own_ships(scene: Scene, steps: int, *, measured: bool) -> Columns:
    """Readings of the instruments on board at every step; with true attitude if that is asked for."""
    own = own_ships_at(scene, 0, steps)
    shape = own.headings_rad.shape
    attitudes = own.measured_attitudes_rad if measured else true_attitudes(own.headings_rad, own.angles_rad)
    names = np.array(scene.vessel_names, dtype=object)[own.vessels]
    columns = {
        ("w1_m", "w2_m", "w3_m"): own.positions_m,
        ("roll_rad", "pitch_rad", "heading_rad"): attitudes,
        ("p_rad_s", "q_rad_s", "r_rad_s"): own.measured_rates_rad_s,
        ("f1_m_s2", "f2_m_s2", "f3_m_s2"): own.measured_forces_m_s2,
    }
    when = _when(scene, np.repeat(np.arange(steps), shape[1]))
    table: dict[str, Any] = {"vessel": pa.array(np.tile(names, shape[0]), pa.string()), **when}
    for three, values in columns.items():
        table |= zip(three, map(rounded, values.reshape(-1, 3).T), strict=True)
    return table


def rounded(values: Array) -> Array:
    """Numbers with so many significant digits, same shape; NaN stays."""
    size = np.abs(values)
    exponent = np.floor(np.log10(np.where(np.isfinite(size) & (size > 0), size, 1.0)))
    scale = 10.0 ** (_DIGITS - 1 - exponent)
    return np.round(values * scale) / scale + 0.0  # no negative zero
