"""Motion of the vessels that carry cameras, and what an inertial unit on board measures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.geometry.kinematics import first_derivative, second_derivative, slopes, turning
from modsim3d.motion.waves import GRAVITY_M_S2
from modsim3d.random_streams import Streams
from modsim3d.scene.scene import Scene

NEIGHBOURS = 2
"""The acceleration at the scene's first step equals that of the second, which needs the third."""


@dataclass(frozen=True, eq=False)
class OwnShips:
    """K vessels that carry cameras at S steps. Body axes are v1 forward, v2 to port, v3 up; rates are right-handed.

    Attributes:
        vessels: Indices into the scene's vessels, shape (K,).
        positions_m: Origins of the vessels in WCF, heave included, shape (S, K, 3).
        headings_rad: Without waves, counter-clockwise from w1, shape (S, K).
        angles_rad: Roll, pitch and yaw in waves: port side down, bow down, to port, shape (S, K, 3).
        rates_rad_s: Angular velocity against the world in body axes, shape (S, K, 3).
        forces_m_s2: Specific force at the unit in body axes, shape (S, K, 3): acceleration less gravity. A level vessel
            at rest has +g along v3.
        measured_rates_rad_s: Angular velocity with the unit's errors, shape (S, K, 3).
        measured_forces_m_s2: Specific force with the unit's errors, shape (S, K, 3).
        measured_attitudes_rad: Measured roll, pitch and heading, the heading with the yaw in waves, shape (S, K, 3).
    """

    vessels: Indices
    positions_m: Array
    headings_rad: Array
    angles_rad: Array
    rates_rad_s: Array
    forces_m_s2: Array
    measured_rates_rad_s: Array
    measured_forces_m_s2: Array
    measured_attitudes_rad: Array


def own_ships_at(scene: Scene, first: int, stop: int) -> OwnShips:
    """The vessels that carry cameras at steps first to stop − 1; at least one vessel must carry one.

    The result does not depend on where a run is split into blocks.
    """
    begin, end = scene.own_motion.with_neighbours(np.arange(first, stop), NEIGHBOURS)
    own, times_s = list(scene.own_ships), scene.times_s(begin, end)
    sea = scene.own_motion.at(np.arange(begin, end))
    attitude = sea.world_R_vessel[:, own]
    positions = sea.poses.positions_m[:, own]
    unit = positions + attitude @ np.array(scene.imu.position_m)
    rates = first_derivative(times_s, turning(times_s, attitude))
    forces = specific_force(attitude, second_derivative(times_s, slopes(times_s, unit)))
    streams, wanted = Streams(scene.seed), slice(first - begin, stop - begin)
    names = [scene.vessel_names[i] for i in own]
    errors = [scene.imu.errors(streams, name, first, stop - first) for name in names]
    headings, angles = sea.poses.headings_rad[wanted][:, own], sea.angles_rad[wanted][:, own]
    return OwnShips(
        vessels=np.array(own),
        positions_m=positions[wanted],
        headings_rad=headings,
        angles_rad=angles,
        rates_rad_s=rates[wanted],
        forces_m_s2=forces[wanted],
        measured_rates_rad_s=rates[wanted] + np.stack([rate for rate, _ in errors], axis=1),
        measured_forces_m_s2=forces[wanted] + np.stack([force for _, force in errors], axis=1),
        measured_attitudes_rad=_as_measured(scene, streams, headings, angles, first),
    )


def measured_attitudes_at(scene: Scene, streams: Streams, first: int, stop: int) -> Array:
    """Measured roll, pitch and heading of the K vessels that carry cameras, shape (S, K, 3), as in `OwnShips`.

    They need no motion at later steps, as rates and forces do. The streams are those of the scene's seed.
    """
    sea, own = scene.own_motion.at(np.arange(first, stop)), list(scene.own_ships)
    return _as_measured(scene, streams, sea.poses.headings_rad[:, own], sea.angles_rad[:, own], first)


def _as_measured(scene: Scene, streams: Streams, headings_rad: Array, angles_rad: Array, first: int) -> Array:
    """True attitudes from step `first` on, shapes (S, K) and (S, K, 3), with the errors of the units, (S, K, 3)."""
    names = [scene.vessel_names[index] for index in scene.own_ships]
    errors = [scene.imu.attitude_errors(streams, name, first, len(headings_rad)) for name in names]
    return true_attitudes(headings_rad, angles_rad) + np.stack(errors, axis=1)


def true_attitudes(headings_rad: Array, angles_rad: Array) -> Array:
    """Roll, pitch and heading, the heading with the yaw in waves, shape (..., 3).

    Args:
        headings_rad: Headings without waves, shape (...).
        angles_rad: Roll, pitch and yaw in waves, shape (..., 3).
    """
    attitudes: Array = angles_rad.copy()
    attitudes[..., 2] += headings_rad
    return attitudes


def specific_force(world_R_body: Array, accelerations_m_s2: Array) -> Array:
    """Specific force in body axes that accelerometers measure, f = Rᵀ (a − g) with g pointing down, shape (..., 3).

    Args:
        world_R_body: Rotations to WCF, shape (..., 3, 3).
        accelerations_m_s2: Accelerations in WCF, shape (..., 3).
    """
    against_gravity = accelerations_m_s2 + np.array([0.0, 0.0, GRAVITY_M_S2])
    force: Array = (np.swapaxes(world_R_body, -1, -2) @ against_gravity[..., None])[..., 0]
    return force
