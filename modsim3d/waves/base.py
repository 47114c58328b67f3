"""What every kind of waves is asked for, and what it gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from modsim3d.arrays import Array, Indices

GRAVITY_M_S2 = 9.80665


@dataclass(frozen=True, eq=False)
class Passage:
    """How one vessel passes over the sea: n moments, each of them complete in itself.

    Attributes:
        times_s: Since the scene's first step, shape (n,).
        steps: Number of each step, shape (n,).
        positions_m: Of the vessel's origin on the calm sea, in WCF, shape (n, 3).
        headings_rad: Counter-clockwise from w1, shape (n,).
        velocities_m_s: Over the ground, in WCF, shape (n, 3).
    """

    times_s: Array
    steps: Indices
    positions_m: Array
    headings_rad: Array
    velocities_m_s: Array


@dataclass(frozen=True, eq=False)
class Motion:
    """What waves do to a vessel at n moments.

    Attributes:
        heave_m: How far its origin is lifted along w3, shape (n,).
        angles_rad: Roll, pitch and yaw as in `rotations.vehicle_R_nominal`, shape (n, 3): positive roll lowers the port
            side, positive pitch the bow, positive yaw turns to port.
    """

    heave_m: Array
    angles_rad: Array


class WaveMotion(Protocol):
    """Moves vessels: a moment's motion depends on that moment alone, not on which were asked for before or with it.

    Attributes:
        needs_velocity: Whether it looks at how fast a vessel is, which is not known before its next pose has come.
    """

    needs_velocity: bool

    def motion(self, vessel: str, passage: Passage) -> Motion:
        """Heave and attitude of a vessel.

        Args:
            vessel: ID; its motion is the same for all its cameras.
            passage: When, where and how fast it is.
        """
