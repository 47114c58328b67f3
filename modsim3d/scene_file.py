"""The keys of a scene file. They are fixed: add to them, do not rename them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from modsim3d.validation import MAX_COORDINATE_M, Metres, Number, Probability, Strict, shown

MAX_PX = 1e9  # far beyond any scene, and near enough that no square or product of them overflows
MAX_STEPS = 10_000_000
MAX_SEED = 2**63 - 1

Pixels = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-MAX_PX, le=MAX_PX)]
Lens = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-9, le=1e3)]
NearClip = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-6, le=MAX_COORDINATE_M)]
Interval = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-9, le=1e9)]
Steps = Annotated[int, Field(strict=True, gt=0, le=MAX_STEPS)]
Seed = Annotated[int, Field(strict=True, ge=0, le=MAX_SEED)]
NotNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0)]
Vector = tuple[Metres, Metres, Metres]
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

    focal_length_m: Lens
    pixel_size_m: tuple[Lens, Lens]
    principal_point_px: tuple[Pixels, Pixels]
    image_size_px: tuple[ImageSide, ImageSide]
    skew: Pixels = 0.0
    near_clip_m: NearClip = 0.1
    pose: PoseKeys | None = None
    mount: MountKeys | None = Field(default=None, validate_default=True)

    # On a field and not on the whole, which pydantic looks at only when all fields are right.
    @field_validator("mount")
    @classmethod
    def _one_place(cls, mount: MountKeys | None, info: ValidationInfo) -> MountKeys | None:
        if (info.data.get("pose", "given but wrong") is None) == (mount is None):
            raise ValueError("give exactly one of pose (ashore) and mount (on a vessel)")
        return mount


class AnnotationKeys(Strict):
    """Annotation mode, source and filters (Jessen & Mohr (2023), §7.5.1)."""

    mode: Annotated[int, Field(strict=True, ge=0, le=2)] = 0
    source: Literal["rendered", "analytic", "rectangles"] = "rendered"
    supersample: Annotated[int, Field(strict=True, ge=1, le=8)] = 1
    render: Literal["regions", "full"] = "regions"
    min_visible_px: NotNegative = 0.0
    min_visible_fraction: Probability = 0.0
    min_box_px: NotNegative = 0.0
    allow_camera_inside: Annotated[bool, Field(strict=True)] = False


class AxisKeys(Strict):
    """One angle's second-order process (Jessen & Mohr (2023), eq. 7.23, 7.24)."""

    a: Annotated[float, Field(strict=True, ge=0, lt=1)] = 0.99
    b: Annotated[float, Field(strict=True, ge=0, lt=1)] = 0.99
    sigma_rad: NotNegative = 0.0
    start_rad: tuple[Number, Number] = (0.0, 0.0)


class WavesKeys(Strict):
    """How waves turn vessels: a named level, or the coefficients of each axis."""

    level: str | None = None
    roll: AxisKeys | None = None
    pitch: AxisKeys | None = None
    yaw: AxisKeys | None = None
    interval_s: Interval | None = None
    apply_to: Literal["ownship", "all"] = "ownship"
    composition: Literal["rigid", "additive"] = "rigid"

    @model_validator(mode="after")
    def _one_kind(self) -> WavesKeys:
        axes = [name for name in ("roll", "pitch", "yaw") if getattr(self, name) is not None]
        if (self.level is None) == (not axes):
            raise ValueError("give either level, or the coefficients of roll, pitch and yaw")
        if self.composition == "additive" and self.apply_to == "all":
            raise ValueError("composition: additive knows no attitude of other vessels: it goes with apply_to: ownship")
        return self


class SceneKeys(Strict):
    """A scene file. `vessels`, which may be a file, and the source in `poses` are looked at apart from this."""

    steps: Steps | None = None
    time_step_s: Interval | None = None
    seed: Seed = 0
    vessels: str | dict[str, object]
    poses: dict[str, object]
    cameras: dict[str, CameraKeys]
    waves: WavesKeys | None = None
    annotation: AnnotationKeys = AnnotationKeys()
    detector: str

    @field_validator("vessels", mode="before")
    @classmethod
    def _file_or_mapping(cls, vessels: object) -> object:
        if not isinstance(vessels, str | dict):
            raise ValueError(f"a file or a mapping of vessel ID to vessel is needed (got {shown(vessels)})")
        numbers = [shown(name) for name in vessels if not isinstance(name, str)]
        if numbers:
            raise ValueError(f"a vessel's ID must be text: put {', '.join(numbers)} in quotes")
        return vessels
