"""Cameras and waves of a scene, from its keys."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from modsim3d.geometry.camera import Camera, Intrinsics
from modsim3d.geometry.camera_poses import Mount
from modsim3d.geometry.lens import Distortion
from modsim3d.motion.vessel_motion import Waves
from modsim3d.motion.waves import AXES, PEAKEDNESS, Axis, FloatingVessels, Hull, SecondOrderWaves, jonswap_sea
from modsim3d.motion.waves.levels import Axes
from modsim3d.scene.keys import CameraKeys, WavesKeys
from modsim3d.vessels.vessel import Vessel


def camera_of(name: str, keys: CameraKeys) -> Camera:
    """The camera that a scene file describes."""
    intrinsics = Intrinsics.from_lens(
        keys.focal_length_m,
        keys.pixel_size_m,
        keys.principal_point_px,
        keys.image_size_px,
        keys.skew,
        keys.near_clip_m,
        _distortion(keys),
    )
    place = keys.mount or keys.pose
    values: Mapping[str, Any] = place.model_dump() if place is not None else {}
    return Camera(name, intrinsics, Mount(**values), keys.frame_rate_hz, keys.start_offset_s)


def _distortion(keys: CameraKeys) -> Distortion | None:
    """The lens distortion; None for a pinhole, whose coefficients are all zero."""
    if keys.distortion is None or not any(keys.distortion.model_dump().values()):
        return None
    return Distortion(**keys.distortion.model_dump())


def waves_of(keys: WavesKeys | None, seed: int, vessels: tuple[Vessel, ...], level: Axes | None) -> Waves | None:
    """The waves that a scene file describes; None for calm water.

    Args:
        keys: The section of the scene file.
        seed: Seed of the scene.
        vessels: Vessels of the scene.
        level: Roll, pitch and yaw of the wave level that it names.
    """
    if keys is None or keys.level == "none":
        return None
    if keys.spectrum is not None:
        sea = jonswap_sea(
            keys.significant_height_m or 0.0,
            keys.peak_period_s or 0.0,
            keys.direction_rad or 0.0,
            seed,
            keys.peakedness or PEAKEDNESS,
        )
        hulls = {vessel.name: Hull(vessel.length_m, vessel.beam_m) for vessel in vessels}
        return Waves(FloatingVessels(sea, hulls), keys.apply_to, keys.composition)
    axes = level
    if axes is None:
        given = [getattr(keys, name) for name in AXES]
        roll, pitch, yaw = (Axis(**axis.model_dump()) if axis else Axis() for axis in given)
        axes = (roll, pitch, yaw)
    return Waves(SecondOrderWaves(axes, seed, keys.interval_s), keys.apply_to, keys.composition)
