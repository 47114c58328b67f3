"""The keys of a scene file. They are fixed: add to them, do not rename them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from modsim3d.validation import Count, Number, Positive, Probability, Strict

PositiveInt = Annotated[int, Field(strict=True, gt=0)]
NotNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0)]
Vector = tuple[Number, Number, Number]
MAX_IMAGE_SIDE_PX = 12_000
ImageSide = Annotated[int, Field(strict=True, gt=0, le=MAX_IMAGE_SIDE_PX)]


class PoseKeys(Strict):
    """A camera ashore: position in WCF, angles against the base pose."""

    position_m: Vector
    roll_rad: Number = 0.0
    pitch_rad: Number = 0.0
    yaw_rad: Number = 0.0


class MountKeys(PoseKeys):
    """A camera on a vessel: position in VCF, angles against the vessel."""

    vessel: str


class CameraKeys(Strict):
    """A camera: lens, sensor, and either `pose` or `mount`."""

    focal_length_m: Positive
    pixel_size_m: tuple[Positive, Positive]
    principal_point_px: tuple[Number, Number]
    image_size_px: tuple[ImageSide, ImageSide]
    skew: Number = 0.0
    near_clip_m: Positive = 0.1
    pose: PoseKeys | None = None
    mount: MountKeys | None = None

    @model_validator(mode="after")
    def _one_place(self) -> CameraKeys:
        if (self.pose is None) == (self.mount is None):
            raise ValueError("give exactly one of pose (ashore) and mount (on a vessel)")
        return self


class CircularKeys(Strict):
    """Vessels on concentric circles (Jessen & Mohr (2023), Table 9.4)."""

    centre_m: tuple[Number, Number] = (0.0, 0.0)
    radius_m: tuple[NotNegative, Positive]
    rotation_rate_rad_s: tuple[Number, Number]

    @model_validator(mode="after")
    def _ordered(self) -> CircularKeys:
        for key in ("radius_m", "rotation_rate_rad_s"):
            low, high = getattr(self, key)
            if low > high:
                raise ValueError(f"{key} is [least, greatest], but {low} > {high}")
        return self


class PosesKeys(Strict):
    """Where vessels are: exactly one source."""

    file: str | None = None
    circular: CircularKeys | None = None

    @model_validator(mode="after")
    def _one_source(self) -> PosesKeys:
        if (self.file is None) == (self.circular is None):
            raise ValueError("give exactly one of file and circular")
        return self


class AnnotationKeys(Strict):
    """Annotation mode, source and filters (Jessen & Mohr (2023), §7.5.1)."""

    mode: Literal[0, 1, 2] = 0
    source: Literal["rendered", "analytic"] = "rendered"
    min_visible_px: NotNegative = 0.0
    min_visible_fraction: Probability = 0.0
    min_box_px: NotNegative = 0.0
    allow_camera_inside: Annotated[bool, Field(strict=True)] = False


class SceneKeys(Strict):
    """A scene file. `vessels` is looked at apart from this: it may be a file."""

    steps: PositiveInt | None = None
    time_step_s: Positive | None = None
    seed: Count = 0
    vessels: str | dict[str, object]
    poses: PosesKeys
    cameras: dict[str, CameraKeys]
    annotation: AnnotationKeys = AnnotationKeys()
    detector: str

    @model_validator(mode="after")
    def _times(self) -> SceneKeys:
        if self.poses.circular is not None:
            missing = [key for key in ("steps", "time_step_s") if getattr(self, key) is None]
            if missing:
                raise ValueError(f"{' and '.join(missing)} needed: poses.circular generates its own times")
        return self
