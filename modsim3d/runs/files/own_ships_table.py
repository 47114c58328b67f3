"""The table of the motion of the vessels that carry cameras."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from modsim3d.scene.own_ships import OwnShips, own_ships_at
from modsim3d.scene.scene import Scene

VECTORS = {
    "positions_m": ("w1_m", "w2_m", "w3_m"),
    "angles_rad": ("roll_rad", "pitch_rad", "yaw_rad"),
    "rates_rad_s": ("p_rad_s", "q_rad_s", "r_rad_s"),
    "forces_m_s2": ("f1_m_s2", "f2_m_s2", "f3_m_s2"),
    "measured_rates_rad_s": ("measured_p_rad_s", "measured_q_rad_s", "measured_r_rad_s"),
    "measured_forces_m_s2": ("measured_f1_m_s2", "measured_f2_m_s2", "measured_f3_m_s2"),
}
"""Names of the three columns of each vector of `OwnShips`."""
OWN_SHIP = pa.schema(
    [
        ("vessel", pa.string()),
        ("step", pa.int64()),
        ("timestamp", pa.string()),
        ("w1_m", pa.float64()),
        ("w2_m", pa.float64()),
        ("w3_m", pa.float64()),
        ("heading_rad", pa.float64()),
        *[(name, pa.float64()) for vector, names in VECTORS.items() if vector != "positions_m" for name in names],
    ]
)


def own_ship_table(scene: Scene, first: int, stop: int) -> pa.Table:
    """One row for each step from first to stop − 1 and each vessel that carries a camera, in this order."""
    own = own_ships_at(scene, first, stop)
    steps, vessels = own.headings_rad.shape
    names = pa.array([scene.vessel_names[index] for index in own.vessels])
    columns = {
        "vessel": names.take(pa.array(np.tile(np.arange(vessels), steps))),
        "step": np.repeat(np.arange(first, stop), vessels),
        "timestamp": pa.array(scene.timestamps(first, stop)).take(pa.array(np.repeat(np.arange(steps), vessels))),
        "heading_rad": own.headings_rad.ravel(),
        **_components(own),
    }
    return pa.table([columns[name] for name in OWN_SHIP.names], schema=OWN_SHIP)


def _components(own: OwnShips) -> dict[str, np.ndarray]:
    return {
        name: np.ascontiguousarray(getattr(own, vector)[..., axis]).ravel()
        for vector, names in VECTORS.items()
        for axis, name in enumerate(names)
    }
