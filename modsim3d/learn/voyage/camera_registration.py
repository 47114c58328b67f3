"""The cameras of a log, each registered against its scene before anything is learned."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from modsim3d.core.arrays import Array
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.core.text import number_in
from modsim3d.io.validation import nearest, shown
from modsim3d.learn.learn_detector import MIN_CONFIDENCE
from modsim3d.learn.voyage.attitude import Attitude
from modsim3d.learn.voyage.clock import read_reports
from modsim3d.learn.voyage.log_to_scene import CameraLog
from modsim3d.learn.voyage.reference_error import POSITION_M, ReferenceNoise
from modsim3d.learn.voyage.registration.icp import BoxesAtTimes
from modsim3d.learn.voyage.registration.parameters import SHARED_NAMES, SHORT
from modsim3d.learn.voyage.registration.registering import BY_RULE, Registration, register
from modsim3d.scene.scene import Scene
from modsim3d.world.poses.base import Poses
from modsim3d.world.poses.replay import RecordedPoses


def with_moved_vessels(scene: Scene, offsets: Array) -> Scene:
    """A scene whose vessels are off their reports by `offsets` (V, 3): antenna ahead and to port of the centre in m,
    and delay in s: a late report says where a vessel was; before its first and after its last pose it is there."""
    if not offsets.any():
        return scene
    every_s, poses = scene.times_s(0, scene.steps), scene.poses.poses(0, scene.steps)
    positions, headings = poses.positions_m.copy(), poses.headings_rad.copy()
    for vessel in np.flatnonzero(offsets.any(axis=1)).tolist():
        steps = np.flatnonzero(poses.present[:, vessel])
        if not len(steps):
            continue
        along, across, delay = offsets[vessel].tolist()
        at_s = every_s[steps] + delay
        heading = np.interp(at_s, every_s[steps], np.unwrap(poses.headings_rad[steps, vessel]))
        places = [np.interp(at_s, every_s[steps], axis) for axis in poses.positions_m[steps, vessel].T]
        ahead, port = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
        places[:2] = np.array(places[:2]) - along * ahead - across * port
        positions[steps, vessel], headings[steps, vessel] = np.stack(places, axis=-1), heading
    return replace(scene, poses=RecordedPoses(scene.poses.timestamps, Poses(poses.present, positions, headings)))


# ---- Means that a user knows of what registration cannot tell from a camera and a clock ----


@dataclass(frozen=True)
class KnownMeans:
    """Means known beforehand, None where nothing is: `KnownMeans(mean_x_px=1.5, delay_s=2)`. Those of x, y, width and
    height are mean errors of boxes, detected less true: in pixels of the centres, as shares of the true sizes. A
    position report says where a vessel was `delay_s` seconds before its time, on average."""

    mean_x_px: float | None = None
    mean_y_px: float | None = None
    mean_width_share: float | None = None
    mean_height_share: float | None = None
    delay_s: float | None = None

    @property
    def mean_errors(self) -> tuple[float | None, ...]:
        """Mean errors of boxes, in x, y, width and height."""
        return self.mean_x_px, self.mean_y_px, self.mean_width_share, self.mean_height_share

    def by_name(self) -> dict[str, float]:
        """Means that are known, by the names of the attributes."""
        return {field.name: value for field in fields(self) if (value := getattr(self, field.name)) is not None}

    def scene_of(self, scene: Scene) -> Scene:
        """The scene with its vessels where they were, if reports are late; own ships stay."""
        if not self.delay_s:
            return scene
        offsets = np.zeros((len(scene.vessels), 3))
        offsets[:, 2] = self.delay_s
        offsets[list(scene.own_ships), 2] = 0
        return with_moved_vessels(scene, offsets)


NOTHING_KNOWN = KnownMeans()
SHORT_NAMES = {field.name.rsplit("_", 1)[0]: field.name for field in fields(KnownMeans)}  # `mean_x` → `mean_x_px`
_FORM = f"must be NAME=VALUE,..., such as mean_x=1.5,delay=2, with the names {', '.join(SHORT_NAMES)}"


def parse_known(given: str | Mapping[str, float] | KnownMeans | None) -> KnownMeans:
    """Means from a text such as `mean_x=1.5,delay=2`, or a mapping. Raises InputError if a name is unknown or there
    twice, or a value is no number or too large."""
    if given is None or isinstance(given, KnownMeans):
        return given or NOTHING_KNOWN
    means, problems = NOTHING_KNOWN, []
    for name, text in _pairs(given):
        full, value = SHORT_NAMES.get(name), number_in(text)
        if full is None:
            problems.append(f"no mean {shown(name)} ({nearest(name, SHORT_NAMES)})")
        elif getattr(means, full) is not None:
            problems.append(f"{name}: is given twice")
        elif math.isnan(value) or (full.endswith("_share") and abs(value) >= 1):
            needed = "a share above -1 and below 1, such as 0.02" if full.endswith("_share") else "a number"
            problems.append(f"{name}: must be {needed} (got {shown(text)})")
        else:
            means = replace(means, **{full: value})
    if problems:
        raise InputError("--known", problems)
    return means


def _pairs(given: str | Mapping[str, float]) -> list[tuple[str, object]]:
    if isinstance(given, Mapping):
        return list(given.items())
    pairs = [part.partition("=") for part in given.split(",")]
    if not all(name.strip() and sign for name, sign, _ in pairs):
        raise InputError("--known", [f"{_FORM} (got {shown(given)})"])
    return [(name.strip(), value.strip()) for name, _, value in pairs]


ALL = "all"  # the name in `fixed` that stands for all parameters: then nothing is registered
SHORT_OF = {full: short for short, full in SHORT.items()}
FIXED_NAMES = tuple(SHORT_OF.get(name, name) for name in SHARED_NAMES if name not in BY_RULE)
"""What `fixed` takes: the parameters that are registered, by their names without units."""
OFFSETS_M = 5.0  # how far positions of AIS are expected to be off while a vessel is seen: antennas, late reports
MAX_NOISE_M = 100.0  # positions that are worse do not tell which vessel a camera sees
_SIZES = frozenset({"length", "beam", "air draft"})


def position_noise_m(scene: Scene, given: float | None) -> float:
    """Standard deviation of each coordinate of positions: the given one, else 10 m with AIS and 0 without. Raises
    InputError if it is negative, or too large."""
    if given is None:
        return POSITION_M if read_reports(scene.path) is not None else 0.0  # only with AIS are there reports
    if not 0 <= given <= MAX_NOISE_M:
        raise InputError("--position-noise", [f"must be metres from 0 to {MAX_NOISE_M:g} (got {given:g})"])
    return given


@dataclass(frozen=True, eq=False)
class RegistrationOptions:
    """Options: `RegistrationOptions(("pitch",), position_m=10).of(scene, camera_log, "detections night.csv")` runs.
    Parameters in `fixed` stay as the scene has them, and detections below `least_confidence` take no part."""

    fixed: tuple[str, ...] = ()
    position_m: float = 0.0  # standard deviation of each coordinate of positions
    least_confidence: float = MIN_CONFIDENCE
    attitude: Attitude | None = None
    known: KnownMeans = NOTHING_KNOWN

    def of(self, scene: Scene, log: CameraLog, source: str) -> Registration | None:
        """Registration of a log's camera, `source`; None if all is fixed. Raises ModsimError if it is unknown."""
        if ALL in self.fixed:
            return None
        camera = scene.cameras[log.camera]
        attitude = self.attitude if self.attitude and self.attitude.vessel == camera.mount.vessel else None
        known = attitude.known(log.time_s) if attitude else np.ones(len(log.time_s), dtype=bool)
        sizes, ais = not _SIZES & ReferenceNoise.of(scene).reasons.keys(), read_reports(scene.path) is not None
        log = log.take(known)
        sure = np.isnan(log.confidence) | (log.confidence >= self.least_confidence)
        try:
            return register(
                scene,
                camera.name,
                BoxesAtTimes(log.time_s, log.frame[sure], log.boxes_px[sure]),
                fixed=self.fixed,
                mean_errors=self.known.mean_errors,
                use_sizes=sizes,
                offsets_m=OFFSETS_M if ais else None,
                noise_m=self.position_m,
                attitude=attitude,
            )
        except ModsimError as error:
            text = str(error)
            if text.startswith("fixed: "):  # all of them, one by one
                raise InputError("--fixed", [text.removeprefix("fixed: ")]) from None
            way_out = "--fixed all learns with the camera and the clock as they are"
            measured = "check the angles of --attitude too, and their signs; " if attitude else ""
            raise InputError(f"{source}, camera '{camera.name}'", [f"{text}; {measured}{way_out}"]) from None


def parse_fixed(names: str | Sequence[str] | None) -> tuple[str, ...]:
    """Names of parameters, perhaps with units, from a text such as `pitch,yaw`, or a list. Raises InputError if one is
    not known, or `all` does not stand alone."""
    fixed = tuple(text.strip() for text in (names.split(",") if isinstance(names, str) else names or ()))
    choices = (*FIXED_NAMES, ALL)
    if unknown := [name for name in fixed if SHORT_OF.get(name, name) not in choices]:
        raise InputError("--fixed", [f"no parameter {shown(unknown[0])} ({nearest(unknown[0], choices)})"])
    if ALL in fixed and len(fixed) > 1:
        raise InputError("--fixed", [f"all stands alone (got {shown(','.join(fixed))})"])
    return fixed


def check_known(means: KnownMeans, fixed: tuple[str, ...]) -> None:
    """Refuse, with InputError, means of boxes where nothing is registered since all parameters are fixed."""
    if ALL in fixed and any(value is not None for value in means.mean_errors):
        raise InputError("--known", ["means of box errors are for registration, which --fixed all leaves out"])
