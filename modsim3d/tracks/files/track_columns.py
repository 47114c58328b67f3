"""What the columns of `tracks.parquet` are, and tracks as its rows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa

from modsim3d.runs.files.table_columns import BOX_SIDES, Column
from modsim3d.runs.files.tables import named, numbers
from modsim3d.scene.scene import Scene
from modsim3d.tracks.tracks import Tracks

COVARIANCES = ("var_x_px2", "cov_xy_px2", "var_y_px2")
_NONE = "null if the tracker says none"
_SIDES = ("left", "upper", "right", "lower")
COLUMNS = (
    Column("camera", pa.string(), "", "name of the camera"),
    Column("step", pa.int64(), "", "number of the scene's time step, from 0"),
    Column("timestamp", pa.string(), "", "time of the step in seconds, as the scene's poses write it"),
    Column("track", pa.int64(), "", "number of the track; equal ones in one camera are one track"),
    Column("label", pa.string(), "", f"class of the track; {_NONE}"),
    *(
        Column(name, pa.float64(), "px", f"{side} edge of the box, beyond the image too")
        for name, side in zip(BOX_SIDES, _SIDES, strict=True)
    ),
    Column("confidence", pa.float64(), "", f"confidence of the track in this frame, from 0 to 1; {_NONE}"),
    Column("var_x_px2", pa.float64(), "px²", f"variance of the column of the centre of the box; {_NONE}"),
    Column("cov_xy_px2", pa.float64(), "px²", f"covariance of column and row of the centre; {_NONE}"),
    Column("var_y_px2", pa.float64(), "px²", f"variance of the row of the centre; {_NONE}"),
)
SCHEMA = pa.schema([column.field for column in COLUMNS])


def track_table(tracks: Tracks, scene: Scene) -> pa.Table:
    """The rows of tracks, in order of step, camera and track."""
    steps = int(tracks.step.max(initial=-1)) + 1
    covariance = tracks.covariance_px2
    columns: dict[str, Any] = {
        "camera": named([camera.name for camera in scene.cameras], tracks.camera),
        "step": tracks.step,
        "timestamp": named(scene.timestamps(0, steps), tracks.step),
        "track": tracks.track,
        "label": named(scene.detector.labels, tracks.label),
        **{name: np.ascontiguousarray(side) for name, side in zip(BOX_SIDES, tracks.boxes_px.T, strict=True)},
        "confidence": numbers(tracks.confidence),
        **dict(
            zip(
                COVARIANCES,
                (numbers(part) for part in (covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1])),
                strict=True,
            )
        ),
    }
    return pa.table([columns[name] for name in SCHEMA.names], schema=SCHEMA).combine_chunks()
