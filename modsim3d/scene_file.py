"""The keys of a scene file. They are fixed: add to them, do not rename them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator

from modsim3d.validation import Number, Probability, Strict, shown

# Far beyond any scene, and near enough that no square or product of them overflows.
MAX_COORDINATE_M = 1e9
MAX_PX = 1e9
MAX_STEPS = 10_000_000
MAX_SEED = 2**63 - 1

Metres = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-MAX_COORDINATE_M, le=MAX_COORDINATE_M)]
Pixels = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-MAX_PX, le=MAX_PX)]
Lens = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-9, le=1e3)]
NearClip = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-6, le=MAX_COORDINATE_M)]
Rate = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-1e6, le=1e6)]
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


class CircularKeys(Strict):
    """Vessels on concentric circles (Jessen & Mohr (2023), Table 9.4)."""

    centre_m: tuple[Metres, Metres] = (0.0, 0.0)
    radius_m: tuple[Annotated[Metres, Field(ge=0)], Annotated[Metres, Field(gt=0)]]
    rotation_rate_rad_s: tuple[Rate, Rate]

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
    tracks: dict[str, list[tuple[Number, Metres, Metres]]] | None = Field(default=None, validate_default=True)

    @field_validator("tracks")
    @classmethod
    def _one_source(cls, tracks: object, info: ValidationInfo) -> object:
        others = [info.data.get(key, "given but wrong") for key in ("file", "circular")]
        if sum(source is not None for source in (tracks, *others)) != 1:
            raise ValueError("give exactly one of file, circular and tracks")
        return tracks

    @property
    def generated(self) -> str | None:
        """The key of a source that has no times of its own, if it is one."""
        return next((key for key in ("circular", "tracks") if getattr(self, key) is not None), None)


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

    level: Literal["none", "small", "medium", "large", "huge"] | None = None
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
    """A scene file. `vessels` is looked at apart from this: it may be a file."""

    steps: Steps | None = None
    time_step_s: Interval | None = None
    seed: Seed = 0
    detector_seed: Seed | None = None
    vessels: str | dict[str, object]
    poses: PosesKeys
    cameras: dict[str, CameraKeys]
    waves: WavesKeys | None = None
    annotation: AnnotationKeys = AnnotationKeys()
    detector: str

    @property
    def truth_has_seed(self) -> bool:
        """Whether what the cameras see depends on the seed: poses that are drawn, and waves."""
        drawn = self.poses.file is None and self.poses.tracks is None
        return drawn or (self.waves is not None and self.waves.level != "none")

    @field_validator("vessels", mode="before")
    @classmethod
    def _file_or_mapping(cls, vessels: object) -> object:
        if not isinstance(vessels, str | dict):
            raise ValueError(f"a file or a mapping of vessel ID to vessel is needed (got {shown(vessels)})")
        numbers = [shown(name) for name in vessels if not isinstance(name, str)]
        if numbers:
            raise ValueError(f"a vessel's ID must be text: put {', '.join(numbers)} in quotes")
        return vessels

    @field_validator("poses")
    @classmethod
    def _times(cls, poses: PosesKeys, info: ValidationInfo) -> PosesKeys:
        if poses.generated is not None:
            missing = [key for key in ("steps", "time_step_s") if info.data.get(key, "given but wrong") is None]
            if missing:
                needed = " and ".join(missing)
                raise ValueError(f"{poses.generated} makes its own times: {needed} must be given beside it")
        return poses
