"""The keys of a scene file. They are fixed: add to them, do not rename them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import shapely
from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator

from modsim3d.io.strict_text import load_yaml
from modsim3d.io.validation import (
    MAX_COORDINATE_M,
    MAX_NUMBER,
    MAX_PROBLEMS,
    Limits,
    Metres,
    NeedText,
    NotNegative,
    Number,
    Probability,
    Strict,
    shown,
)
from modsim3d.world.floating_vessels import GRAVITY_M_S2, STEEPEST
from modsim3d.world.vessels import MeshName

MAX_PX = 1e9  # far beyond any scene; squares and products do not overflow
MIN_FOCAL_PX = 1e-3
MAX_STEPS = 10_000_000
MAX_SEED = 2**63 - 1

Pixels = Annotated[float, Limits(allow_inf_nan=False, ge=-MAX_PX, le=MAX_PX)]
Lens = Annotated[float, Limits(allow_inf_nan=False, ge=1e-9, le=1e3)]
NearClip = Annotated[float, Limits(allow_inf_nan=False, ge=1e-6, le=MAX_COORDINATE_M)]
Interval = Annotated[float, Limits(allow_inf_nan=False, ge=1e-9, le=1e9)]
Steps = Annotated[int, Limits(gt=0, le=MAX_STEPS)]
Seed = Annotated[int, Limits(ge=0, le=MAX_SEED)]
Vector = tuple[Metres, Metres, Metres]
MatrixRows = tuple[tuple[Pixels, Pixels, Pixels], tuple[Pixels, Pixels, Pixels], tuple[Pixels, Pixels, Pixels]]
Size = Annotated[float, Limits(allow_inf_nan=False, gt=0, le=MAX_COORDINATE_M)]
TURN_RAD, RIGHT_ANGLE_RAD = 6.3, 1.58  # a whole turn and a right angle, as people round them


def _radians(angle: float) -> float:
    """Refuse angles of more than a turn: they are probably in degrees."""
    if abs(angle) > TURN_RAD:
        raise ValueError(f"{angle:g} is more than a whole turn: angles are in radians (180° is 3.14159)")
    return angle


def _tilt(angle: float) -> float:
    """Refuse more than a right angle, which a tilt has only if it is in degrees."""
    if abs(_radians(angle)) > RIGHT_ANGLE_RAD:
        raise ValueError(
            f"{angle:g} is more than a right angle: in degrees that is {math.degrees(angle):.0f}; for {angle:g}° give "
            f"{math.radians(angle):.4g}"
        )
    return angle


def _roll(angle: float) -> float:
    """Refuse more than a right angle, but for half a turn to four digits, which has a camera upside down."""
    return angle if abs(abs(angle) - math.pi) < 1e-3 else _tilt(angle)


def _roll_deg(angle: float) -> float:
    if abs(angle) > 90 and abs(abs(angle) - 180) > 0.05:
        raise ValueError(f"{angle:g}° is more than a right angle, and not upside down (180)")
    return angle


def upper_triangular(matrix: MatrixRows) -> MatrixRows:
    """Refuse what is no camera matrix."""
    (fx, _, _), (low, fy, _), last = matrix
    if min(fx, fy) < MIN_FOCAL_PX:
        raise ValueError(f"has the focal lengths {fx:g} and {fy:g} px, which must be above 0: {ROWS}")
    if low or last != (0, 0, 1):
        turned = ", and this one is transposed" if not (matrix[0][1] or matrix[0][2] or matrix[1][2]) else ""
        got = shown([list(row) for row in matrix])
        raise ValueError(f"is not upper triangular with the last row 0 0 1: {ROWS}{turned} (got {got})")
    return matrix


Angle = Annotated[float, Limits(_radians, allow_inf_nan=False, ge=-MAX_NUMBER, le=MAX_NUMBER)]
Tilt = Annotated[Number, AfterValidator(_tilt)]
AngleSpread = Annotated[NotNegative, AfterValidator(_tilt)]
MAX_IMAGE_SIDE_PX = 12_000
ImageSide = Annotated[int, Limits(gt=0, le=MAX_IMAGE_SIDE_PX)]
FocalPixels = Annotated[float, Limits(allow_inf_nan=False, ge=MIN_FOCAL_PX, le=MAX_PX)]
FieldOfView = Annotated[float, Limits(allow_inf_nan=False, ge=0.01, le=179)]
ROWS = "the rows are [fx, s, cx], [0, fy, cy] and [0, 0, 1]"
Matrix = Annotated[MatrixRows, NeedText(f"3 × 3 numbers are needed: {ROWS}"), AfterValidator(upper_triangular)]
ANGLES = ("roll", "pitch", "yaw")


class PoseKeys(Strict):
    """A camera ashore: position in WCF, angles against the base pose, each in radians or in degrees."""

    alternatives: ClassVar = tuple(((f"{angle}_rad",), (f"{angle}_deg",)) for angle in ANGLES)

    position_m: Vector
    roll_rad: Annotated[Number, AfterValidator(_roll)] = 0.0
    pitch_rad: Tilt = 0.0
    yaw_rad: Angle = 0.0
    roll_deg: Annotated[Number, AfterValidator(_roll_deg)] | None = None
    pitch_deg: Annotated[float, Limits(allow_inf_nan=False, ge=-90, le=90)] | None = None
    yaw_deg: Annotated[float, Limits(allow_inf_nan=False, ge=-360, le=360)] | None = None


class MountKeys(PoseKeys):
    """A camera on a vessel: position in VCF, angles against the vessel."""

    vessel: str


class DistortionKeys(Strict):
    """Coefficients of Brown and Conrady's model, named as OpenCV does."""

    k1: Number = 0.0
    k2: Number = 0.0
    p1: Number = 0.0
    p2: Number = 0.0
    k3: Number = 0.0


_BESIDE = ("principal_point_px", "skew", "distortion")
LENSES = (
    ("focal_length_m", "pixel_size_m", *_BESIDE),
    *((form, *_BESIDE) for form in ("focal_px", "hfov_deg", "vfov_deg")),
    ("K", "distortion"),
    ("calibration",),
)
"""The forms of a lens: the key that each is named by, and the keys that may stand beside it."""


class CameraKeys(Strict):
    """A camera: its lens in one of the forms, its image, and either `pose` or `mount`."""

    alternatives: ClassVar = (LENSES, (("pose",), ("mount",)))

    focal_length_m: Lens | None = None
    pixel_size_m: tuple[Lens, Lens] | None = None
    focal_px: tuple[FocalPixels, FocalPixels] | None = None
    hfov_deg: FieldOfView | None = None
    vfov_deg: FieldOfView | None = None
    K: Matrix | None = None
    calibration: str | None = None
    principal_point_px: tuple[Pixels, Pixels] | None = None
    image_size_px: tuple[ImageSide, ImageSide] | None = None
    skew: Pixels = 0.0
    near_clip_m: NearClip = 0.1
    distortion: DistortionKeys | None = None
    frame_rate_hz: Interval | None = None
    start_offset_s: Annotated[float, Limits(allow_inf_nan=False, ge=0, le=1e9)] = 0.0
    pose: PoseKeys | None = None
    mount: MountKeys | None = Field(default=None, validate_default=True)

    # A validator of the field, since pydantic calls those of the model only if all fields are valid.
    @field_validator("mount")
    @classmethod
    def _one_place(cls, mount: MountKeys | None, info: ValidationInfo) -> MountKeys | None:
        if (info.data.get("pose", "given but wrong") is None) == (mount is None):
            raise ValueError("give exactly one of pose (ashore) and mount (on a vessel)")
        return mount


class AnnotationKeys(Strict):
    """Annotation mode, source and filters (Jessen & Mohr (2023), §7.5.1)."""

    mode: Annotated[int, Limits(ge=0, le=2)] = 0
    source: Literal["rendered", "analytic", "rectangles", "labels"] = "rendered"
    supersample: Annotated[int, Limits(ge=1, le=8)] = 1
    render: Literal["regions", "full"] = "regions"
    min_visible_px: NotNegative = 0.0
    min_visible_fraction: Probability = 0.0
    min_box_px: NotNegative = 0.0
    allow_camera_inside: Annotated[bool, Field(strict=True)] = False
    check: Literal["sample", "off", "all"] = "sample"


class AxisKeys(Strict):
    """One angle's second-order process (Jessen & Mohr (2023), eq. 7.23, 7.24)."""

    a: Annotated[float, Limits(ge=0, lt=1)] = 0.99
    b: Annotated[float, Limits(ge=0, lt=1)] = 0.99
    sigma_rad: NotNegative = 0.0
    start_rad: tuple[Tilt, Tilt] = (0.0, 0.0)


class WavesKeys(Strict):
    """Waves: a named level, the coefficients of each axis, or a spectrum."""

    alternatives: ClassVar = (
        (("level",), ANGLES, ("spectrum", "significant_height_m", "peak_period_s", "direction_rad", "peakedness")),
    )

    level: str | None = None
    roll: AxisKeys | None = None
    pitch: AxisKeys | None = None
    yaw: AxisKeys | None = None
    interval_s: Interval | None = None
    spectrum: Literal["jonswap"] | None = None
    significant_height_m: Annotated[float, Limits(allow_inf_nan=False, ge=0)] | None = None
    peak_period_s: Annotated[float, Limits(ge=0.5, le=30)] | None = None
    direction_rad: Angle | None = None
    peakedness: Annotated[float, Limits(ge=1, le=10)] | None = None
    apply_to: Literal["ownship", "all"] = "ownship"
    composition: Literal["rigid", "additive"] = "rigid"

    @model_validator(mode="after")
    def _one_kind(self) -> WavesKeys:
        axes = [name for name in ("roll", "pitch", "yaw") if getattr(self, name) is not None]
        given = [self.level is not None, bool(axes), self.spectrum is not None]
        if sum(given) != 1:
            raise ValueError("give exactly one of level, the coefficients of roll, pitch and yaw, and spectrum")
        problems = self._sea_problems()
        if problems:
            raise ValueError("; ".join(problems))
        if self.composition == "additive" and self.apply_to == "all":
            raise ValueError("composition: additive cannot turn other vessels: it goes with apply_to: ownship only")
        return self

    def _sea_problems(self) -> list[str]:
        needed = ("significant_height_m", "peak_period_s", "direction_rad")
        if self.spectrum is None:
            stray = [key for key in (*needed, "peakedness") if getattr(self, key) is not None]
            return [f"{key} goes with spectrum: jonswap" for key in stray]
        problems = [f"spectrum: jonswap needs {key}" for key in needed if getattr(self, key) is None]
        if self.interval_s is not None:
            problems.append("interval_s goes with level or coefficients, not with a spectrum")
        if self.significant_height_m is not None and self.peak_period_s is not None:
            highest = STEEPEST * GRAVITY_M_S2 * self.peak_period_s**2 / (2 * math.pi)
            if self.significant_height_m > highest:
                problems.append(
                    f"significant_height_m: seas with a peak period of {self.peak_period_s:g} s break before they are "
                    f"{self.significant_height_m:g} m high: at most {highest:.2f} m, or a longer peak_period_s"
                )
        return problems


class ImuKeys(Strict):
    """The inertial measurement unit of each vessel that carries a camera."""

    position_m: Vector = (0.0, 0.0, 0.0)
    rate_noise_rad_s: NotNegative = 0.0
    rate_bias_rad_s: NotNegative = 0.0
    acceleration_noise_m_s2: NotNegative = 0.0
    acceleration_bias_m_s2: NotNegative = 0.0
    attitude_noise_rad: AngleSpread = 0.0
    attitude_bias_rad: AngleSpread = 0.0
    heading_noise_rad: AngleSpread = 0.0
    heading_bias_rad: AngleSpread = 0.0


class OriginKeys(Strict):
    """The place on the Earth where w1 = w2 = 0; w1 points east, w2 north."""

    latitude_deg: Annotated[float, Limits(allow_inf_nan=False, ge=-90, le=90)]
    longitude_deg: Annotated[float, Limits(allow_inf_nan=False, ge=-180, le=180)]


class AisKeys(Strict):
    """The AIS equipment of the vessels, for `modsim3d export --format ais`."""

    vessels: dict[str, Literal["A", "B", "none"]] = Field(default_factory=dict)
    drop_out: Probability = 0.05
    position_noise_m: Annotated[float, Limits(allow_inf_nan=False, ge=0, le=1000)] = 3.0


class ObstacleKeys(Strict):
    """An obstacle: a prism over a polygon, or a mesh."""

    polygon_m: list[tuple[Metres, Metres]] | None = None
    height_m: Size | None = None
    base_m: Metres = 0.0
    mesh: MeshName | None = None
    size_m: tuple[Size, Size, Size] | None = None
    position_m: Vector = (0.0, 0.0, 0.0)
    heading_rad: Angle = 0.0

    @field_validator("polygon_m")
    @classmethod
    def _simple(cls, polygon_m: list[tuple[float, float]] | None) -> list[tuple[float, float]] | None:
        if polygon_m is None:
            return None
        if len(polygon_m) < 3:
            raise ValueError(f"a polygon needs three corners or more (got {len(polygon_m)})")
        polygon = shapely.Polygon(polygon_m)
        if not polygon.is_valid or polygon.area <= 0:
            why = shapely.is_valid_reason(polygon) if not polygon.is_valid else "its area is zero"
            raise ValueError(f"the sides of a polygon must not cross or lie on each other ({why})")
        return polygon_m

    @model_validator(mode="after")
    def _one_kind(self) -> ObstacleKeys:
        if (self.polygon_m is None) == (self.mesh is None):
            raise ValueError("give either polygon_m with height_m, or mesh with size_m")
        needed, other = ("height_m", "size_m") if self.mesh is None else ("size_m", "height_m")
        if getattr(self, needed) is None:
            raise ValueError(f"{needed}: missing")
        misplaced = {other} | ({"position_m", "heading_rad"} if self.mesh is None else {"base_m"})
        if wrong := sorted(misplaced & self.model_fields_set):
            raise ValueError(f"{', '.join(wrong)}: not for {'a polygon' if self.mesh is None else 'a mesh'}")
        return self


class LookKeys(Strict):
    """Weather in which a performance state of the detector is drawn. It changes no data."""

    visibility_m: Annotated[float, Limits(allow_inf_nan=False, gt=0, le=MAX_NUMBER)] | None = None
    overcast: Annotated[bool, Field(strict=True)] = False
    rain: Annotated[bool, Field(strict=True)] = False
    dusk: Annotated[bool, Field(strict=True)] = False
    night: Annotated[bool, Field(strict=True)] = False
    significant_height_m: Annotated[float, Limits(allow_inf_nan=False, ge=0, le=20)] | None = None

    @field_validator("night")
    @classmethod
    def _one_time(cls, night: bool, info: ValidationInfo) -> bool:
        if night and info.data.get("dusk"):
            raise ValueError("it is dusk or night, not both")
        return night


class SceneKeys(Strict):
    """A scene file. The content of `vessels` and `poses` is validated elsewhere."""

    steps: Steps | None = None
    time_step_s: Interval | None = None
    seed: Seed = 0
    detector_seed: Seed | None = None
    vessels: str | dict[str, object]
    poses: dict[str, object]
    cameras: dict[str, CameraKeys]
    waves: WavesKeys | None = None
    sea: Literal["flat", "curved"] = "flat"
    obstacles: dict[str, ObstacleKeys] = Field(default_factory=dict)
    imu: ImuKeys | None = None
    origin: OriginKeys | None = None
    ais: AisKeys = AisKeys()
    looks: dict[str, LookKeys] = Field(default_factory=dict)
    annotation: AnnotationKeys = AnnotationKeys()
    detector: str

    @property
    def waves_have_seed(self) -> bool:
        """Whether waves move vessels."""
        return self.waves is not None and self.waves.level != "none"

    @field_validator("vessels", mode="before")
    @classmethod
    def _file_or_mapping(cls, vessels: object) -> object:
        if not isinstance(vessels, str | dict):
            raise ValueError(f"a file or a mapping of vessel ID to vessel is needed (got {shown(vessels)})")
        numbers = [shown(name) for name in vessels if not isinstance(name, str)]
        if numbers:
            raise ValueError(f"a vessel's ID must be text: put {', '.join(numbers[:MAX_PROBLEMS])} in quotes")
        return vessels


OF_LABELS = {"mode": 1, "source": "labels", "check": "off"}
"""Annotation of a scene of labels: boxes of whoever is seen, of which nothing can be drawn."""


class LabelledSceneKeys(SceneKeys):
    """A scene file whose truth is labels of videos, which have vessels and cameras of their own."""

    vessels: dict[str, object] = Field(default_factory=dict)
    cameras: dict[str, CameraKeys] = Field(default_factory=dict)
    annotation: AnnotationKeys = AnnotationKeys.model_validate(OF_LABELS)

    @model_validator(mode="after")
    def _nothing_of_the_world(self) -> LabelledSceneKeys:
        keys = ("steps", "seed", "detector_seed", "poses", "annotation", "detector")
        if stray := sorted(name for name in self.model_fields_set if name not in keys and getattr(self, name)):
            raise ValueError(f"{', '.join(stray)}: not in a scene of labels, whose world is not known: leave out")
        if wrong := [key for key, value in OF_LABELS.items() if getattr(self.annotation, key) != value]:
            values = ", ".join(f"annotation.{key}: {OF_LABELS[key]}" for key in wrong)
            raise ValueError(f"a scene of labels has {values}")
        return self


@dataclass(frozen=True)
class Ais:
    """AIS equipment, and how good it is."""

    # ID → `A`, `B` or `none`, of those whose class is not chosen by size and label
    vessels: Mapping[str, str] = field(default_factory=dict)
    drop_out: float = 0.05  # share of the reports that are not received
    position_noise_m: float = 3.0  # standard deviation of a position along each axis


USUAL_AIS = Ais()  # of a scene that says nothing

# ---- The weather that the name of a performance state tells ----

LOOKS_FILE = Path(__file__).with_name("looks.yaml")
BESIDE_LOOKS = re.compile(r"experiment|\d+")  # words of shipped names that say nothing of the weather


@cache
def usual_look(state: str) -> LookKeys | None:
    """The look of a performance state that its name tells, such as `foggy_cloudy`; None if a word of it is strange."""
    looks = load_yaml(LOOKS_FILE, "looks")
    words = [word for word in re.findall(r"[^\W_]+", state.lower()) if not BESIDE_LOOKS.fullmatch(word)]
    if not words or not all(word in looks for word in words):
        return None
    return LookKeys.model_validate({key: value for word in words for key, value in looks[word].items()})
