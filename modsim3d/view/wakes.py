"""Foam that vessels leave on the sea of a shaded picture: bow waves and wakes, the stronger the faster they go."""

import math
from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Mask
from modsim3d.render.id_pass import Region
from modsim3d.view.pictures.canvas import Window
from modsim3d.view.pictures.plain import Solids
from modsim3d.view.sea_and_sky import Backdrop, Floats
from modsim3d.world.floating_vessels import GRAVITY_M_S2

LEAST_M_S = 0.5  # a slower vessel leaves none
WAKE_S, ARM_S = 14.0, 5.0  # in so much time the foam of the wake, and that of the bow wave, falls to a third
KELVIN = math.tan(math.asin(1 / 3))  # half the angle of a ship's waves in deep water: 19.47° (Kelvin, 1887)
FULL_M_S, FULL_FROUDE = 5.0, 0.4  # speed and Froude number at which wake and bow wave are white
FOAM = 0.75  # share of the light that the whitest foam takes from the sea


@dataclass(frozen=True, eq=False)
class _Wake:
    """A vessel on its way."""

    origin_m: Array  # in WCF, shape (3,)
    ahead: Array  # on the sea, unit vector, shape (2,)
    length_m: float
    beam_m: float
    speed_m_s: float

    @property
    def reach_m(self) -> float:
        """Distance behind the stern to which there is foam."""
        return 2.0 * WAKE_S * self.speed_m_s

    @property
    def wide_m(self) -> float:
        """Half the width of the foam where it is widest."""
        return self.beam_m + KELVIN * 2.5 * ARM_S * self.speed_m_s

    def corners_m(self) -> Array:
        """Corners of the part of the sea that may show foam, in WCF, shape (4, 3)."""
        port = np.array([-self.ahead[1], self.ahead[0]])
        bow, stern = 0.5 * self.length_m, -0.5 * self.length_m - self.reach_m
        places = [
            self.origin_m[:2] + a * self.ahead + b * port for a in (bow, stern) for b in (-self.wide_m, self.wide_m)
        ]
        return np.column_stack([places, np.zeros(4)])

    def inside(self, x: Floats, y: Floats) -> Mask:
        """Whether there may be foam at places from the origin in metres."""
        along = x * np.float32(self.ahead[0]) + y * np.float32(self.ahead[1])
        across = np.abs(y * np.float32(self.ahead[0]) - x * np.float32(self.ahead[1]))
        aft = 0.5 * self.length_m - along
        near = np.minimum(self.beam_m + KELVIN * 1.2 * aft, self.wide_m)
        found: Mask = (aft > 0) & (aft < self.length_m + self.reach_m) & (across < near)
        return found

    def foam(self, x: Floats, y: Floats, footprint_m: Floats) -> Floats:
        """Share of the sea that is foam at places from the origin in metres, each seen by a pixel of some size."""
        along = x * np.float32(self.ahead[0]) + y * np.float32(self.ahead[1])
        across = np.abs(y * np.float32(self.ahead[0]) - x * np.float32(self.ahead[1]))
        aft, behind = 0.5 * self.length_m - along, -0.45 * self.length_m - along  # of the bow, and of the stern
        half = 0.4 * self.beam_m + 0.05 * np.maximum(behind, 0)
        wake = np.exp(-((across / (half + footprint_m)) ** 2) - np.maximum(behind, 0) / (WAKE_S * self.speed_m_s))
        wake *= (behind > 0) * half / (half + footprint_m) * min(self.speed_m_s / FULL_M_S, 1.0)
        froude = self.speed_m_s / math.sqrt(GRAVITY_M_S2 * self.length_m)
        thick = 0.06 * self.beam_m + 0.1 + 0.04 * np.maximum(aft, 0)
        arm = np.maximum(KELVIN * aft, np.minimum(0.5 * self.beam_m, 1.2 * aft)) - across
        bow = np.exp(-((arm / (thick + footprint_m)) ** 2) - np.maximum(aft, 0) / (ARM_S * self.speed_m_s))
        bow *= (aft > 0) * thick / (thick + footprint_m) * min((froude / FULL_FROUDE) ** 2, 1.0)
        return np.maximum(wake, bow)


def draw_wakes(
    rgb: Floats, backdrop: Backdrop, solids: Solids, window: Window, speeds_m_s: Array
) -> tuple[Region, ...]:
    """Draw the foam of the vessels before a camera into a picture, sRGB from 0 to 1, shape (h, w, 3), and return the
    regions that it may have changed. For `speeds_m_s` see `lights_towards`."""
    sight, regions = solids.sight, []
    poses = sight.camera_poses
    for index in np.flatnonzero(sight.others[0] & (speeds_m_s > LEAST_M_S)).tolist():
        ahead = sight.world_R_vessel[0, index, :2, 0]
        vessel, origin_m = sight.vessels[index], sight.poses.positions_m[0, index]
        wake = _Wake(origin_m, ahead / np.linalg.norm(ahead), vessel.length_m, vessel.beam_m, float(speeds_m_s[index]))
        corners = poses.to_camera(wake.corners_m()[None])[0]
        ahead_of_camera = corners[:, 2] > solids.intrinsics.near_clip_m
        if not ahead_of_camera.any():
            continue
        rows, region = (
            backdrop.wet,
            Region(0, backdrop.wet.start, window.size[0], backdrop.wet.stop - backdrop.wet.start),
        )
        if ahead_of_camera.all():
            places = window.to_picture(solids.intrinsics.project(corners))
            region = Region.around(np.concatenate([places.min(axis=0), places.max(axis=0)]), window.size)
        top, stop = max(region.y, rows.start), min(region.y + region.height, rows.stop)
        if region.width <= 0 or stop <= top:
            continue
        here = np.s_[top - rows.start : stop - rows.start, region.x : region.x + region.width]
        shift = (poses.positions_m[0] - origin_m).astype(np.float32)
        x, y = (backdrop.from_camera_m[axis][here] + shift[axis] for axis in (0, 1))
        row, column = wake.inside(x, y).nonzero()
        share = wake.foam(x[row, column], y[row, column], backdrop.footprint_m[here][row, column])
        row, column = row + top, column + region.x
        share *= np.clip(0.75 + 0.9 * backdrop.ripple[row, column], 0.1, 1.2) * FOAM * backdrop.sea[row, column]
        rgb[row, column] += np.minimum(share, 0.9)[:, None] * (backdrop.foam - rgb[row, column])
        regions.append(region)
    return tuple(regions)
