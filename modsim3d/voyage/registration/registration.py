"""A registration: what was estimated, how well it is known, and what it does to the camera."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from modsim3d.arrays import Array
from modsim3d.geometry.camera import Camera
from modsim3d.scene.scene import Scene
from modsim3d.voyage.correction import Correction
from modsim3d.voyage.registration.determined import Group
from modsim3d.voyage.registration.parameters import Values
from modsim3d.voyage.registration.sightings import Sightings


@dataclass(frozen=True)
class Estimate:
    """One number of a registration; zero is what the scene says.

    Attributes:
        name: Name with unit, such as `pitch_deg`; of a vessel with the vessel's ID before: `ferry.delay_s`.
        words: What it is.
        unit: Unit in text.
        value: Estimate, or the value at which it is held.
        standard_error: NaN if it is held.
        low: Lower end of the 95 % interval; NaN if it is held.
        high: Upper end.
        held: The rule by which it is held; empty if it was estimated.
    """

    name: str
    words: str
    unit: str
    value: float
    standard_error: float
    low: float
    high: float
    held: str = ""


@dataclass(frozen=True, eq=False)
class Registration:
    """How a camera and the clock of its detector differ from what the scene says.

    Attributes:
        camera: Name of the camera.
        values: All values: zero is what the scene says.
        estimates: The shared parameters, in order.
        vessels: What is known of single vessels: only what the data determine.
        covariance: Covariance of the estimated shared parameters, in the order of `estimates`, shape (p, p).
        groups: What the data cannot tell apart, so that a rule had to settle it.
        sightings: The matches that were used.
        detections: Number of detections.
        rms_before_px: Root mean square of bearings' and waterlines' residuals with the scene's values, by the same
            matches; NaN if one has no place in the image then.
        rms_after_px: The same with the registration.
    """

    camera: str
    values: Values
    estimates: tuple[Estimate, ...]
    vessels: tuple[Estimate, ...]
    covariance: Array
    groups: tuple[Group, ...]
    sightings: Sightings
    detections: int
    rms_before_px: float
    rms_after_px: float

    def __getitem__(self, name: str) -> Estimate:
        """An estimate by its name, such as `pitch_deg` or `ferry.delay_s`."""
        return {estimate.name: estimate for estimate in (*self.estimates, *self.vessels)}[name]

    @property
    def matched_vessels(self) -> int:
        """Number of vessels that were matched."""
        return len(np.unique(self.sightings.vessel))

    @property
    def correction(self) -> Correction:
        """What the estimates add to the camera and to the clock."""
        return Correction(**{each.name: self.values[each.name] for each in fields(Correction)})

    def camera_of(self, camera: Camera) -> Camera:
        """The camera as it really is, from the scene's."""
        return self.correction.camera(camera)

    def scene_of(self, scene: Scene) -> Scene:
        """The scene with the camera as it really is. The clock and the vessels are left as they are."""
        cameras = (self.camera_of(camera) if camera.name == self.camera else camera for camera in scene.cameras)
        return replace(scene, cameras=tuple(cameras))

    def __repr__(self) -> str:
        """The estimates line by line, then what could not be told apart."""
        lines = [f"registration of camera '{self.camera}' by {len(self.sightings)} of {self.detections} detections"]
        lines[0] += f" of {self.matched_vessels} vessels"
        lines.append(f"  residual {self.rms_before_px:.1f} px before, {self.rms_after_px:.1f} px after")
        for estimate in (*self.estimates, *self.vessels):
            known = f"held: {estimate.held}"
            if not estimate.held:
                known = f"{estimate.low:.4g} to {estimate.high:.4g}"
            lines.append(f"  {estimate.name:<20} {estimate.value:>9.4g} {estimate.unit:<3} ({known})")
        return "\n".join([*lines, *(f"  by rule: {group.words()}" for group in self.groups)])
