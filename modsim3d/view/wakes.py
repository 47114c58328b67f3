"""Foam that vessels leave on the sea of a shaded picture: bow waves and wakes, the stronger the faster they go."""

import math

import numpy as np
from PIL import Image, ImageDraw

from modsim3d.core.arrays import Array
from modsim3d.render.id_pass import Region
from modsim3d.view.pictures.canvas import Window
from modsim3d.view.pictures.plain import Solids
from modsim3d.view.sea_and_sky import Backdrop, Floats, palette_of
from modsim3d.world.floating_vessels import GRAVITY_M_S2
from modsim3d.world.vessels import Vessel

LEAST_M_S = 0.5  # a slower vessel leaves none
WAKE_S, ARM_S = 14.0, 5.0  # in so much time the foam of the wake, and that of the bow wave, falls to a third
KELVIN = math.tan(math.asin(1 / 3))  # half the angle of a ship's waves in deep water: 19.47° (Kelvin, 1887)
FULL_M_S, FULL_FROUDE = 5.0, 0.4  # speed and Froude number at which wake and bow wave are white
FOAM, WHITER = 0.75, 0.12  # share of a pixel that the whitest foam covers, and how much whiter than fog it is


def draw_wakes(
    rgb: Floats, backdrop: Backdrop, solids: Solids, window: Window, speeds_m_s: Array
) -> tuple[Region, ...]:
    """Draw the foam of the vessels before a camera into a picture, sRGB from 0 to 1, shape (h, w, 3), and return the
    regions that it may have changed. For `speeds_m_s` see `lights_towards`."""
    sight, regions, wet = solids.sight, [], backdrop.wet
    poses, air = sight.camera_poses, np.array(palette_of(backdrop.style).fog, np.float32)
    for index in np.flatnonzero(sight.others[0] & (speeds_m_s > LEAST_M_S)).tolist():
        vessel, speed_m_s = sight.vessels[index], float(speeds_m_s[index])
        ahead, origin_m = sight.world_R_vessel[0, index, :2, 0], sight.poses.positions_m[0, index]
        ahead = (ahead / np.linalg.norm(ahead)).astype(np.float32)
        behind_m, wide_m = vessel.length_m + 2 * WAKE_S * speed_m_s, vessel.beam_m + 2.5 * KELVIN * ARM_S * speed_m_s
        bow_m = origin_m[:2] + 0.5 * vessel.length_m * ahead
        outline = ((0.0, vessel.beam_m), ((wide_m - vessel.beam_m) / (1.2 * KELVIN), wide_m), (behind_m, wide_m))
        port = np.array([-ahead[1], ahead[0]])
        places = [bow_m - aft * ahead + side * wide * port for side in (1, -1) for aft, wide in outline[::side]]
        corners = poses.to_camera(np.column_stack([places, np.zeros(len(places))])[None])[0]
        if not (corners[:, 2] > solids.intrinsics.near_clip_m).all():
            continue  # it begins behind the camera, or ends there
        ends = window.to_picture(solids.intrinsics.project(corners))
        region = Region.around(np.concatenate([ends.min(axis=0), ends.max(axis=0)]), window.size)
        if region.width <= 0 or region.height <= 0:
            continue
        mask = Image.new("1", (region.width, region.height))
        ImageDraw.Draw(mask).polygon([tuple(end) for end in (ends - (region.x, region.y)).tolist()], fill=1)
        row, column = np.nonzero(
            np.asarray(mask) & backdrop.sea[region.y : region.y + region.height, region.x : region.x + region.width]
        )
        row, column = row + region.y, column + region.x
        on_sea = row - wet.start, column
        from_bow = (poses.positions_m[0, :2] - bow_m).astype(np.float32)
        x, y = (backdrop.from_camera_m[axis][on_sea] + from_bow[axis] for axis in (0, 1))
        aft, across = np.maximum(-(x * ahead[0] + y * ahead[1]), 0), np.abs(y * ahead[0] - x * ahead[1])
        share = _foam(aft, across, backdrop.footprint_m[on_sea], vessel, speed_m_s)
        share *= np.clip(0.75 + 0.9 * backdrop.ripple[row, column], 0.1, 1.2) * FOAM
        kept = 1 if backdrop.kept is None else backdrop.kept[on_sea][:, None]  # foam is whiter than the air before it
        rgb[row, column] += np.minimum(share, 0.9)[:, None] * (air * (1 + WHITER * kept) - rgb[row, column])
        regions.append(region)
    return tuple(regions)


def _foam(aft_m: Floats, across_m: Floats, footprint_m: Floats, vessel: Vessel, speed_m_s: float) -> Floats:
    """Share of the sea that is foam aft of a vessel's bow and across her way, each seen by a pixel of some size."""
    behind = aft_m - 0.95 * vessel.length_m
    half = 0.4 * vessel.beam_m + 0.05 * np.maximum(behind, 0)
    wake = np.exp(-((across_m / (half + footprint_m)) ** 2) - np.maximum(behind, 0) / (WAKE_S * speed_m_s))
    wake *= (behind > 0) * half / (half + footprint_m) * min(speed_m_s / FULL_M_S, 1.0)
    froude = speed_m_s / math.sqrt(GRAVITY_M_S2 * vessel.length_m)
    thick = 0.06 * vessel.beam_m + 0.1 + 0.04 * aft_m
    arm = np.maximum(KELVIN * aft_m, np.minimum(0.5 * vessel.beam_m, 1.2 * aft_m)) - across_m
    bow = np.exp(-((arm / (thick + footprint_m)) ** 2) - aft_m / (ARM_S * speed_m_s))
    bow *= thick / (thick + footprint_m) * min((froude / FULL_FROUDE) ** 2, 1.0)
    foam: Floats = np.maximum(wake, bow)
    return foam
