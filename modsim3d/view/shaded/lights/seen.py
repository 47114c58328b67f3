"""Which lights a camera sees, where, and how strong."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array
from modsim3d.geometry.kinematics import velocities
from modsim3d.scene.scene import Scene
from modsim3d.scene.sight import Sight
from modsim3d.view.pictures.solids import Solids
from modsim3d.view.shaded.lights.lantern import CLEAR_EXTINCTION_PER_M, THRESHOLD_LUX, Lantern
from modsim3d.view.shaded.lights.rules import lanterns


@dataclass(frozen=True, eq=False)
class SeenLight:
    """A light that is turned to a camera.

    Attributes:
        vessel: Index of its vessel.
        place_m: Its place in WCF, shape (3,).
        decades: How strong it is: the logarithm to base 10 of its light over the faintest that an eye sees.
    """

    vessel: int
    lantern: Lantern
    place_m: Array
    decades: float


def ground_speeds(scene: Scene, step: int) -> Array:
    """Speeds over ground of the V vessels at a step in m/s, shape (V,); NaN where a neighbouring pose is needed."""
    first, stop = scene.motion.with_neighbours(np.array([step]))
    poses = scene.poses.poses(first, stop)
    calm_m = poses.positions_m * (1.0, 1.0, 0.0)
    speeds = np.linalg.norm(velocities(scene.times_s(first, stop), calm_m, poses.present)[step - first], axis=-1)
    known = poses.present[step - first] & (poses.present.sum(axis=0) > 1)
    return np.where(known, speeds, np.nan)


def lights_towards(sight: Sight, speeds_m_s: Array, extinction_per_m: float = 0.0) -> Iterator[SeenLight]:
    """The lights of other vessels that are turned to a camera at its first step, and strong enough.

    Args:
        sight: Where the camera and the vessels are.
        speeds_m_s: Speeds over ground, shape (V,); NaN where it is not known.
        extinction_per_m: Share of the light that a metre of air takes; that of clear air if it is 0.
    """
    camera_m = sight.camera_poses.positions_m[0]
    for index in np.flatnonzero(sight.others[0]).tolist():
        vessel, world_R_vessel = sight.vessels[index], sight.world_R_vessel[0, index]
        origin_m = sight.poses.positions_m[0, index]
        ahead, port, _ = ((camera_m - origin_m) @ world_R_vessel).tolist()
        for lantern in lanterns(vessel, float(speeds_m_s[index])):
            # From the centreline, so that a broad ship shows both sidelights to what is right ahead.
            bearing = math.atan2(port, ahead - lantern.place[0] * vessel.length_m)
            if not lantern.sector.holds(math.degrees(bearing)):
                continue
            place_m = world_R_vessel @ (np.array(lantern.place) * vessel.extents_m) + origin_m
            distance_m = max(float(np.linalg.norm(place_m - camera_m)), 1.0)
            light = lantern.illuminance_lux(distance_m, extinction_per_m or CLEAR_EXTINCTION_PER_M)
            if light >= THRESHOLD_LUX:
                yield SeenLight(index, lantern, place_m, math.log10(light / THRESHOLD_LUX))


def is_hidden(solids: Solids, vessel: int, place_px: Array, inverse_depth: float) -> bool:
    """Whether another vessel, an obstacle or own ship stands before a light.

    A vessel's own hull does not hide her lights: where they hang they are clear of it.

    Args:
        solids: What stands before the camera.
        vessel: The light's vessel.
        place_px: Column and row of the light in the camera's image, shape (2,).
        inverse_depth: near / c3 of the light, as in `Triangles`.
    """
    triangles = solids.triangles
    low, high = triangles.corners_px.min(axis=1), triangles.corners_px.max(axis=1)
    near = ((low <= place_px) & (place_px <= high)).all(axis=1) & (solids.occluders[triangles.row] != vessel)
    corners, depths = triangles.corners_px[near] - place_px, triangles.inverse_depth[near]
    # Barycentric coordinates: the areas that the place spans with two corners each.
    after, last = np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1)
    areas = after[..., 0] * last[..., 1] - after[..., 1] * last[..., 0]
    whole = areas.sum(axis=1)
    inside = ((areas * np.sign(whole)[:, None] >= 0).all(axis=1)) & (whole != 0)
    before = (areas[inside] * depths[inside]).sum(axis=1) / whole[inside] > inverse_depth
    return bool(before.any())
