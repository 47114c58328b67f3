"""The table of the motion of the vessels that carry cameras."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from modsim3d.runs.files.table_columns import schema_of
from modsim3d.scene.own_ships import own_ships_at
from modsim3d.scene.scene import Scene

MEASURED_ATTITUDE = ("measured_roll_rad", "measured_pitch_rad", "measured_heading_rad")
_COLUMNS = {
    "positions_m": ("w1_m", "w2_m", "w3_m"),
    "headings_rad": ("heading_rad",),
    "angles_rad": ("roll_rad", "pitch_rad", "yaw_rad"),
    "rates_rad_s": ("p_rad_s", "q_rad_s", "r_rad_s"),
    "forces_m_s2": ("f1_m_s2", "f2_m_s2", "f3_m_s2"),
    "measured_rates_rad_s": ("measured_p_rad_s", "measured_q_rad_s", "measured_r_rad_s"),
    "measured_forces_m_s2": ("measured_f1_m_s2", "measured_f2_m_s2", "measured_f3_m_s2"),
    "measured_attitudes_rad": MEASURED_ATTITUDE,
}
"""Attribute of `OwnShips` → names of the columns of its components."""
OWN_SHIP = schema_of("ownship")
BEFORE_ATTITUDE = pa.schema([field for field in OWN_SHIP if field.name not in MEASURED_ATTITUDE])
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
    return pa.table([columns[name] for name in OWN_SHIP.names], schema=OWN_SHIP)


def with_attitude(table: pa.Table) -> pa.Table:
    """A table of `BEFORE_ATTITUDE` with the measured attitudes: those units had no error."""
    heading = pc.add(table["heading_rad"], table["yaw_rad"])
    for name, values in zip(MEASURED_ATTITUDE, (table["roll_rad"], table["pitch_rad"], heading), strict=True):
        table = table.append_column(OWN_SHIP.field(name), values)
    return table
