"""What registration changes: the camera of a scene, and the clock of a log."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from modsim3d.geometry.camera import Camera
from modsim3d.geometry.lens import Distortion


@dataclass(frozen=True)
class Correction:
    """What is added to the values of the scene and of the log; angles turn as those of a scene's camera do.

    Attributes:
        clock_s: Added to the times of the log to get those of the scene.
        roll_deg: Added to the camera's roll.
        pitch_deg: Added to its pitch; positive looks further down.
        yaw_deg: Added to its yaw; positive looks further to port.
        height_m: Added to its height.
        focal_share: Added to the focal length, as a share of it.
        k1: Added to the lens's first radial coefficient.
    """

    clock_s: float = 0.0
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    height_m: float = 0.0
    focal_share: float = 0.0
    k1: float = 0.0

    def camera(self, camera: Camera) -> Camera:
        """The camera with the changes; the same one if nothing of it changes."""
        if self == Correction(self.clock_s):
            return camera
        mount, lens = camera.mount, camera.intrinsics
        w1, w2, w3 = mount.position_m
        mount = replace(
            mount,
            position_m=(w1, w2, w3 + self.height_m),
            roll_rad=mount.roll_rad + math.radians(self.roll_deg),
            pitch_rad=mount.pitch_rad + math.radians(self.pitch_deg),
            yaw_rad=mount.yaw_rad + math.radians(self.yaw_deg),
        )
        f1, f2 = (focal * (1 + self.focal_share) for focal in lens.focal_px)
        distortion = lens.distortion
        if self.k1:
            known = distortion or Distortion()
            distortion = replace(known, k1=known.k1 + self.k1)
        return replace(camera, mount=mount, intrinsics=replace(lens, focal_px=(f1, f2), distortion=distortion))


NO_CORRECTION = Correction()
