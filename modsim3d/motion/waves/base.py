"""The interface of every model of waves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from modsim3d.arrays import Array, Indices

GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True, eq=False)
class Passage:
    """One vessel on calm water at n moments, each complete in itself.

    Attributes:
        times_s: Times since the scene's first step, shape (n,).
        steps: Index of each step, shape (n,).
        positions_m: Origins of the vessel in WCF, shape (n, 3).
        headings_rad: Counter-clockwise from w1, shape (n,).
        velocities_m_s: Velocities over ground in WCF, shape (n, 3).
    """

    times_s: Array
    steps: Indices
    positions_m: Array
    headings_rad: Array
    velocities_m_s: Array


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of a vessel in waves at n moments.

    Attributes:
        heave_m: Displacement of its origin along w3, shape (n,).
        angles_rad: Roll, pitch and yaw as in `rotations.vehicle_R_nominal`, shape (n, 3): positive roll lowers the port
            side, positive pitch the bow, positive yaw turns to port.
    """

    heave_m: Array
    angles_rad: Array


class WaveMotion(Protocol):
    """A model of waves. The motion at a moment depends on that moment alone, not on earlier or other calls.

    Attributes:
        needs_velocity: Whether it uses velocities, which need the next pose of the vessel.
    """

    needs_velocity: bool

    def motion(self, vessel: str, passage: Passage) -> Motion:
        """Heave and attitude of a vessel, by its ID, at its times and places; they are the same for all cameras."""
