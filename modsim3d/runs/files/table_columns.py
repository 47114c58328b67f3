"""Columns of a run's tables: name, type, unit and meaning; docs/tables.md says the same."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.detector.records import KINDS
from modsim3d.scene.cameras import own_ships_at
from modsim3d.scene.scene import Scene

BOX_SIDES = ("x_min_px", "y_min_px", "x_max_px", "y_max_px")
CENTRE_FORM = ("centre_x_px", "centre_y_px", "width_px", "height_px")
ERRORS = ("e_x_px", "e_y_px", "e_w_px", "e_h_px")
TRUTH_NUMBERS = ("silhouette_px", "visible_px", "visible_fraction", "in_frame_fraction", "depth_m")
"""Columns of the truth table that are attributes of `Truth`."""
_WHOLE = "box around the whole silhouette, hidden parts included, cut at the image edge"
_VISIBLE = "box around the visible part; null if nothing is visible, or if the source of the truth cannot tell"
_OWN = "box, cut at the image edge"
_NO_ERROR = "null for what is not one box of one vessel"


@dataclass(frozen=True)
class TableColumn:
    """A column of a table."""

    name: str
    type: pa.DataType
    unit: str  # of its numbers; empty if it has none
    meaning: str  # in plain text

    @property
    def field(self) -> pa.Field:
        """The column in Arrow's schema, with unit and meaning as its metadata."""
        return pa.field(self.name, self.type, metadata={"unit": self.unit, "description": self.meaning})


def _text(name: str, meaning: str) -> TableColumn:
    return TableColumn(name, pa.string(), "", meaning)


def _whole(name: str, meaning: str) -> TableColumn:
    return TableColumn(name, pa.int64(), "", meaning)


def _flag(name: str, meaning: str) -> TableColumn:
    return TableColumn(name, pa.bool_(), "", meaning)


def _number(name: str, unit: str, meaning: str) -> TableColumn:
    return TableColumn(name, pa.float64(), unit, meaning)


def _box(prefix: str, of: str) -> tuple[TableColumn, ...]:
    sides = {"x_min_px": "left", "y_min_px": "upper", "x_max_px": "right", "y_max_px": "lower"}
    return tuple(_number(f"{prefix}{name}", "px", f"{side} edge of the {of}") for name, side in sides.items())


_CAMERA = _text("camera", "name of the camera")
_STEP = _whole("step", "number of the scene's time step, from 0")
_TIMESTAMP = _text("timestamp", "time of the step in seconds, as the scene's poses write it")
_STATE = _text("state", "performance state of the detector in this frame")
_OCCLUDERS = pa.list_(pa.struct([("id", pa.string()), ("px", pa.float64())]))

FRAMES = (
    *(_CAMERA, _STEP, _TIMESTAMP, _STATE),
    _whole("n_annotated", "vessels that were given to the detector"),
    _whole("n_detected", "true detections; one box around two vessels is one"),
    _whole("n_false", "false alarms: detections of nothing, and second boxes of a vessel"),
)
TRUTH = (
    *(_CAMERA, _STEP, _TIMESTAMP),
    _text("vessel", "ID of the vessel"),
    _text("label", "true class of the vessel"),
    *_box("full_", _WHOLE),
    *_box("visible_", _VISIBLE),
    _number("silhouette_px", "px", "number of pixels of the whole silhouette in the image"),
    _number("visible_px", "px", "number of these that are visible; null if the source of the truth cannot tell"),
    _number("visible_fraction", "", "visible_px / silhouette_px; null if the silhouette has no pixel"),
    _number(
        "in_frame_fraction",
        "",
        "area of the silhouette in the image / area of the whole silhouette; null where the near plane cuts the vessel",
    ),
    _number("depth_m", "m", "mean distance of the vessel's corners along the axis of the camera"),
    TableColumn(
        "occluded_by",
        _OCCLUDERS,
        "px",
        "what hides it: id is a vessel or obstacle:NAME, and px is the number of pixels that this hides",
    ),
    _flag("annotated", "whether it was given to the detector"),
    _flag("detected", "whether it was detected, under whatever label, alone or in one box with another"),
)
DETECTIONS = (
    *(_CAMERA, _STEP, _TIMESTAMP),
    _whole("detection", "number of the row in its frame, from 0; the order means nothing"),
    _text("label", "detected class"),
    _number("confidence", "", "confidence of the detection, from 0 to 1"),
    *_box("", _OWN),
    _number("centre_x_px", "px", "column of the centre of the box, (x_min_px + x_max_px) / 2"),
    _number("centre_y_px", "px", "row of the centre of the box, (y_min_px + y_max_px) / 2"),
    _number("width_px", "px", "width of the box, x_max_px - x_min_px"),
    _number("height_px", "px", "height of the box, y_max_px - y_min_px"),
    _STATE,
    _text("kind", f"truth, not for a tracker: where it came from, one of {', '.join(KINDS)}"),
    _text("vessel", "truth, not for a tracker: ID of the vessel that it came from; null if there is none"),
    *(
        _number(error, "px", f"truth, not for a tracker: error of {name} before the box was cut; {_NO_ERROR}")
        for error, name in zip(ERRORS, CENTRE_FORM, strict=True)
    ),
    _number("iou", "", "truth, not for a tracker: IoU with the annotated box of its vessel; null for a false alarm"),
)
OWN_SHIP = (
    _text("vessel", "ID of the vessel that carries a camera"),
    *(_STEP, _TIMESTAMP),
    _number("w1_m", "m", "centre of the vessel's bottom plane along the world's axis w1"),
    _number("w2_m", "m", "the same along w2"),
    _number("w3_m", "m", "the same along w3, upwards from the sea, heave included"),
    _number("heading_rad", "rad", "heading without waves, counter-clockwise from w1"),
    _number("roll_rad", "rad", "roll in waves, port side down"),
    _number("pitch_rad", "rad", "pitch in waves, bow down"),
    _number("yaw_rad", "rad", "yaw in waves, to port, added to the heading"),
    _number("p_rad_s", "rad/s", "angular velocity about v1, forward; right-handed, so opposite to roll"),
    _number("q_rad_s", "rad/s", "angular velocity about v2, to port"),
    _number("r_rad_s", "rad/s", "angular velocity about v3, upwards"),
    _number("f1_m_s2", "m/s²", "specific force at the inertial unit along v1, gravity included"),
    _number("f2_m_s2", "m/s²", "the same along v2"),
    _number("f3_m_s2", "m/s²", "the same along v3; +9.80665 for a level vessel at rest"),
    *(
        _number(f"measured_{name}", unit, f"{name} as the inertial unit measures it")
        for names, unit in (("p_rad_s q_rad_s r_rad_s", "rad/s"), ("f1_m_s2 f2_m_s2 f3_m_s2", "m/s²"))
        for name in names.split()
    ),
    _number("measured_roll_rad", "rad", "roll_rad as the inertial unit measures it"),
    _number("measured_pitch_rad", "rad", "pitch_rad as the inertial unit measures it"),
    _number("measured_heading_rad", "rad", "heading_rad + yaw_rad as the inertial unit measures it"),
)
COLUMNS = {"frames": FRAMES, "truth": TRUTH, "detections": DETECTIONS, "ownship": OWN_SHIP}  # of each table of a run


def schema_of(table: str) -> pa.Schema:
    """Arrow's schema of a table of a run."""
    return pa.schema([column.field for column in COLUMNS[table]])


MEASURED_ATTITUDE = ("measured_roll_rad", "measured_pitch_rad", "measured_heading_rad")
_COLUMNS = {  # attribute of `OwnShips` → names of the columns of its components
    "positions_m": ("w1_m", "w2_m", "w3_m"),
    "headings_rad": ("heading_rad",),
    "angles_rad": ("roll_rad", "pitch_rad", "yaw_rad"),
    "rates_rad_s": ("p_rad_s", "q_rad_s", "r_rad_s"),
    "forces_m_s2": ("f1_m_s2", "f2_m_s2", "f3_m_s2"),
    "measured_rates_rad_s": ("measured_p_rad_s", "measured_q_rad_s", "measured_r_rad_s"),
    "measured_forces_m_s2": ("measured_f1_m_s2", "measured_f2_m_s2", "measured_f3_m_s2"),
    "measured_attitudes_rad": MEASURED_ATTITUDE,
}
OWN_SHIP_SCHEMA = schema_of("ownship")
BEFORE_ATTITUDE = pa.schema([field for field in OWN_SHIP_SCHEMA if field.name not in MEASURED_ATTITUDE])
"""As runs wrote it before inertial units measured attitudes."""


def own_ship_table(scene: Scene, first: int, stop: int) -> pa.Table:
    """One row for each step from first to stop − 1 and each vessel that carries a camera, in this order."""
    own = own_ships_at(scene, first, stop)
    steps, vessels = own.headings_rad.shape
    names = pa.array([scene.vessel_names[index] for index in own.vessels])
    columns: dict[str, Any] = {
        "vessel": names.take(pa.array(np.tile(np.arange(vessels), steps))),
        "step": np.repeat(np.arange(first, stop), vessels),
        "timestamp": pa.array(scene.timestamps(first, stop)).take(pa.array(np.repeat(np.arange(steps), vessels))),
    }
    for attribute, components in _COLUMNS.items():
        columns |= zip(components, getattr(own, attribute).reshape(-1, len(components)).T, strict=True)
    return pa.table([columns[name] for name in OWN_SHIP_SCHEMA.names], schema=OWN_SHIP_SCHEMA)


def with_attitude(table: pa.Table) -> pa.Table:
    """A table of `BEFORE_ATTITUDE` with the measured attitudes: those units had no error."""
    heading = pc.add(table["heading_rad"], table["yaw_rad"])
    for name, values in zip(MEASURED_ATTITUDE, (table["roll_rad"], table["pitch_rad"], heading), strict=True):
        table = table.append_column(OWN_SHIP_SCHEMA.field(name), values)
    return table
