"""Where the frames of a bag are: own ships, their inertial units and all cameras, after REP 103 and REP 105.

The world's, a vessel's and a camera's axes are those of ROS already: forward, left, up, and in an optical frame right,
down, forward.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Mask
from modsim3d.formats.writing.mcap.messages import Measured, Place, quaternions
from modsim3d.formats.writing.mcap.names import MAP, BagNames
from modsim3d.geometry.kinematics import first_derivative, slopes
from modsim3d.geometry.rotations import camera_R_parent, vehicle_R_nominal, world_R_vehicle
from modsim3d.scene.own_ships import OwnShips, own_ships_at
from modsim3d.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class OwnMotion:
    """A vessel that carries a camera, at S steps.

    Attributes:
        vessel: Index into the scene's vessels.
        place: Its frame in the map.
        velocities_m_s: Of its origin, along its own axes, shape (S, 3).
        rates_rad_s: Angular velocity along its own axes, shape (S, 3).
        measured: What its inertial unit measures.
    """

    vessel: int
    place: Place
    velocities_m_s: Array
    rates_rad_s: Array
    measured: Measured


def static_places(scene: Scene, names: BagNames) -> list[Place]:
    """The frames that never move in their parents: cameras ashore, mounts on board, and inertial units."""
    places = [
        _fixed(names.base(vessel), names.imu(vessel), scene.imu.position_m, np.eye(3)) for vessel in names.vessels
    ]
    for index in names.cameras:
        if index in _cameras_that_add_angles(scene, names):
            continue
        mount = scene.cameras[index].mount
        parent = MAP if mount.vessel is None else names.base(scene.vessel_names.index(mount.vessel))
        turn = camera_R_parent(mount.roll_rad, mount.pitch_rad, mount.yaw_rad)
        places.append(_fixed(parent, names.optical(index), mount.position_m, turn.T))
    return places


def moving_cameras(scene: Scene, names: BagNames, first: int, stop: int) -> list[Place]:
    """The cameras at steps first to stop − 1 that `composition: additive` moves on board, in the map."""
    places = []
    for index in _cameras_that_add_angles(scene, names):
        poses = scene.sight(scene.cameras[index], np.arange(first, stop)).camera_poses
        turns = quaternions(np.swapaxes(poses.camera_R_world, -1, -2))
        places.append(Place(MAP, names.optical(index), poses.positions_m, turns))
    return places


def own_motions(scene: Scene, names: BagNames, first: int, stop: int) -> list[OwnMotion]:
    """The vessels that carry cameras at steps first to stop − 1; the numbers are those of `ownship.parquet`."""
    if not names.vessels:
        return []
    begin, end = scene.motion.with_neighbours(np.arange(first, stop))
    own, wanted = own_ships_at(scene, begin, end), slice(first - begin, stop - begin)
    turns = world_R_vehicle(own.headings_rad) @ np.swapaxes(vehicle_R_nominal(own.angles_rad), -1, -2)
    times_s = scene.times_s(begin, end)
    in_map = first_derivative(times_s, slopes(times_s, own.positions_m))
    velocities = (np.swapaxes(turns, -1, -2) @ in_map[..., None])[..., 0]
    return [
        _own_motion(own, column, names, turns[wanted, column], velocities[wanted, column], wanted)
        for column, vessel in enumerate(own.vessels.tolist())
        if vessel in names.vessels
    ]


def _own_motion(
    own: OwnShips, column: int, names: BagNames, turns: Array, velocities_m_s: Array, wanted: slice
) -> OwnMotion:
    vessel = int(own.vessels[column])
    return OwnMotion(
        vessel,
        Place(MAP, names.base(vessel), own.positions_m[wanted, column], quaternions(turns)),
        velocities_m_s,
        own.rates_rad_s[wanted, column],
        Measured(
            quaternions(_world_R_vessel(own.measured_attitudes_rad[wanted, column])),
            own.measured_rates_rad_s[wanted, column],
            own.measured_forces_m_s2[wanted, column],
        ),
    )


def _world_R_vessel(attitudes_rad: Array) -> Array:
    """Rotations to the world from roll, pitch and heading, shape (..., 3) to (..., 3, 3).

    The yaw in waves is about the world's axis, so it is part of the heading.
    """
    tilts = attitudes_rad * np.array([1.0, 1.0, 0.0])
    turns: Array = world_R_vehicle(attitudes_rad[..., 2]) @ np.swapaxes(vehicle_R_nominal(tilts), -1, -2)
    return turns


def vessels_in_map(scene: Scene, first: int, stop: int) -> list[tuple[Place, Mask]]:
    """All vessels at steps first to stop − 1, and whether each is present, shape (stop − first,): the truth."""
    motion = scene.motion.at(np.arange(first, stop))
    found = []
    for column, name in enumerate(scene.vessel_names):
        present = motion.poses.present[:, column]
        turns = np.where(present[:, None, None], motion.world_R_vessel[:, column], np.eye(3))
        place = Place(MAP, f"truth/{name}", motion.poses.positions_m[:, column], quaternions(turns))
        found.append((place, present))
    return found


def _fixed(parent: str, child: str, position_m: tuple[float, float, float], parent_R_child: Array) -> Place:
    return Place(parent, child, np.array([position_m], dtype=np.float64), quaternions(parent_R_child[None]))


def _cameras_that_add_angles(scene: Scene, names: BagNames) -> list[int]:
    """Cameras on board whose angles and place are not rigid in their vessel's frame."""
    if scene.waves is None or scene.waves.composition != "additive":
        return []
    return [index for index in names.cameras if scene.cameras[index].mount.vessel is not None]
