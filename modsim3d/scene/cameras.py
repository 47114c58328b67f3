"""Motion of the vessels that carry cameras, and what an inertial unit on board measures."""

import math
from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.errors import InputError
from modsim3d.core.random_streams import Streams
from modsim3d.geometry.kinematics import first_derivative, second_derivative, slopes, turning
from modsim3d.scene.scene import Scene
from modsim3d.world.floating_vessels import GRAVITY_M_S2

NEIGHBOURS = 2  # the acceleration at the scene's first step equals that of the second, which needs the third


@dataclass(frozen=True, eq=False)
class OwnShips:
    """K vessels that carry cameras at S steps. Body axes are v1 forward, v2 to port, v3 up; rates are right-handed."""

    vessels: Indices  # indices into the scene's vessels, (K,)
    positions_m: Array  # origins of the vessels in WCF, heave included, (S, K, 3)
    headings_rad: Array  # without waves, counter-clockwise from w1, (S, K)
    angles_rad: Array  # roll, pitch and yaw in waves: port side down, bow down, to port, (S, K, 3)
    rates_rad_s: Array  # angular velocity against the world in body axes, (S, K, 3)
    forces_m_s2: Array
    """Specific force at the unit in body axes, (S, K, 3): acceleration less gravity, so that a level vessel at rest has
    +g along v3."""
    measured_rates_rad_s: Array  # with the unit's errors, (S, K, 3)
    measured_forces_m_s2: Array  # with the unit's errors, (S, K, 3)
    measured_attitudes_rad: Array  # roll, pitch and heading, the heading with the yaw in waves, (S, K, 3)


def own_ships_at(scene: Scene, first: int, stop: int) -> OwnShips:
    """The vessels that carry cameras at steps first to stop − 1; at least one vessel must carry one. The result does
    not depend on where a run is split into blocks."""
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
    """Measured roll, pitch and heading of the K vessels that carry cameras, shape (S, K, 3), as in `OwnShips`. They
    need no motion at later steps, as rates and forces do. The streams are those of the scene's seed."""
    sea, own = scene.own_motion.at(np.arange(first, stop)), list(scene.own_ships)
    return _as_measured(scene, streams, sea.poses.headings_rad[:, own], sea.angles_rad[:, own], first)


def _as_measured(scene: Scene, streams: Streams, headings_rad: Array, angles_rad: Array, first: int) -> Array:
    """True attitudes from step `first` on, shapes (S, K) and (S, K, 3), with the errors of the units, (S, K, 3)."""
    names = [scene.vessel_names[index] for index in scene.own_ships]
    errors = [scene.imu.attitude_errors(streams, name, first, len(headings_rad)) for name in names]
    return true_attitudes(headings_rad, angles_rad) + np.stack(errors, axis=1)


def true_attitudes(headings_rad: Array, angles_rad: Array) -> Array:
    """Roll, pitch and heading, the heading with the yaw in waves, shape (..., 3), from headings without waves, shape
    (...), and roll, pitch and yaw in waves, shape (..., 3)."""
    attitudes: Array = angles_rad.copy()
    attitudes[..., 2] += headings_rad
    return attitudes


def specific_force(world_R_body: Array, accelerations_m_s2: Array) -> Array:
    """Specific force in body axes that accelerometers measure, f = Rᵀ (a − g) with g pointing down, shape (..., 3),
    from rotations to WCF, shape (..., 3, 3), and accelerations in WCF, shape (..., 3)."""
    against_gravity = accelerations_m_s2 + np.array([0.0, 0.0, GRAVITY_M_S2])
    force: Array = (np.swapaxes(world_R_body, -1, -2) @ against_gravity[..., None])[..., 0]
    return force


def camera_placement(
    centre_m: tuple[float, float],
    radius_m: float,
    *,
    height_m: float,
    focal_length_m: float,
    sensor_width_m: float,
    whole: bool = True,
) -> dict[str, list[float] | float]:
    """The `pose` of a camera beyond a circle in the direction of w1, which looks at its centre (eq. B.1–B.3).

        pose = modsim3d.camera_placement((0, 0), 500, height_m=20, focal_length_m=0.05, sensor_width_m=0.036)

    Eq. B.2 prints d = r / tan(2 AOV), a misprint: such a camera may stand within the circle. The source's program
    computes d = r / tan(AOV / 2), from where the circle's nearer half is cut at the sides of the image. From
    d = r / sin(AOV / 2) on, the whole circle is seen across the image. A test projects the circle for all three.

    Args:
        centre_m: w1 and w2 of the circle's centre.
        radius_m: Its radius, r.
        height_m: Height of the camera above the sea.
        focal_length_m: f.
        sensor_width_m: Columns of the image times the width of a pixel; the principal point is in the middle.
        whole: Whether to see the whole circle; if not, the distance is that of the source's program.

    Raises:
        InputError: A length is not positive, or a number is not finite.
        TypeError: A length is not a number.
    """
    names = ("radius_m", "height_m", "focal_length_m", "sensor_width_m")
    lengths = zip(names, (radius_m, height_m, focal_length_m, sensor_width_m), strict=True)
    problems = [f"{name}: {value:g} is not a length above 0" for name, value in lengths if not 0 < value < math.inf]
    problems += [f"centre_m: {place:g} is not finite" for place in centre_m if not math.isfinite(place)]
    if problems:
        raise InputError("camera_placement", problems)
    half_view_rad = math.atan(sensor_width_m / (2 * focal_length_m))
    distance_m = radius_m / (math.sin if whole else math.tan)(half_view_rad)
    return {
        "position_m": [centre_m[0] + distance_m, centre_m[1], height_m],
        "pitch_rad": math.atan(height_m / distance_m),
        "yaw_rad": math.pi,
    }
