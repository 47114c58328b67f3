"""The cameras of a log, each registered against its scene before anything is learned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Mask
from modsim3d.errors import InputError, ModsimError
from modsim3d.inputs.validation import nearest, shown
from modsim3d.learn.learn_detector import LEAST_CONFIDENCE
from modsim3d.scene.scene import Scene
from modsim3d.voyage.attitude import Attitude
from modsim3d.voyage.correction import NO_CORRECTION, Correction
from modsim3d.voyage.known import NOTHING_KNOWN, KnownMeans
from modsim3d.voyage.on_scene import CameraLog
from modsim3d.voyage.registration import BoxesAtTimes, Registration, register
from modsim3d.voyage.registration.parameters import SHARED_NAMES, SHORT
from modsim3d.voyage.registration.registering import BY_RULE
from modsim3d.voyage.reports import read_reports
from modsim3d.voyage.truth_noise.noise import POSITION_M, TruthNoise

ALL = "all"
"""The name in `fixed` that stands for all parameters: then nothing is registered."""
SHORT_OF = {full: short for short, full in SHORT.items()}
FIXED_NAMES = tuple(SHORT_OF.get(name, name) for name in SHARED_NAMES if name not in BY_RULE)
"""What `fixed` takes: the parameters that are registered, by their names without units."""
OFFSETS_M = 5.0
"""How far positions of AIS are expected to be off for as long as a vessel is seen: antennas, late reports."""
MOST_NOISE_M = 100.0
"""Positions that are worse do not tell which vessel a camera sees."""
_SIZES = frozenset({"length", "beam", "air draft"})


def is_from_ais(scene: Scene) -> bool:
    """Whether `modsim3d ais` made the scene: its report lies beside it."""
    return read_reports(scene.path) is not None


def position_noise_m(scene: Scene, given: float | None) -> float:
    """Standard deviation of each coordinate of positions: the given one, else 10 m with AIS and 0 without.

    Raises:
        InputError: The given one is negative, or so large that positions say nothing.
    """
    if given is None:
        return POSITION_M if is_from_ais(scene) else 0.0
    if not 0 <= given <= MOST_NOISE_M:
        raise InputError("--position-noise", [f"must be metres from 0 to {MOST_NOISE_M:g} (got {given:g})"])
    return given


@dataclass(frozen=True, eq=False)
class Registering:
    """How cameras are registered.

        Registering(("pitch",), position_m=10).of(scene, camera_log, "detections night.csv")

    Attributes:
        fixed: Names of parameters that stay as the scene has them.
        position_m: Standard deviation of each coordinate of positions.
        least_confidence: Least confidence of a detection that takes part.
        attitude: That of own ship as it was measured.
        known: Means that are known beforehand.
    """

    fixed: tuple[str, ...] = ()
    position_m: float = 0.0
    least_confidence: float = LEAST_CONFIDENCE
    attitude: Attitude | None = None
    known: KnownMeans = NOTHING_KNOWN

    def of(self, scene: Scene, log: CameraLog, source: str) -> Registration | None:
        """The registration of a camera; None if all of it is fixed.

        Args:
            scene: The scene.
            log: The frames of the camera.
            source: What messages call the log.

        Raises:
            ModsimError: It cannot be known, with the reason.
        """
        if ALL in self.fixed:
            return None
        camera = scene.cameras[log.camera]
        attitude = self.attitude if self.attitude and self.attitude.vessel == camera.mount.vessel else None
        known = attitude.known(log.time_s) if attitude else np.ones(len(log.time_s), dtype=bool)
        sizes = not _SIZES & TruthNoise.of(scene).reasons.keys()
        ais = is_from_ais(scene)
        try:
            return register(
                scene,
                camera.name,
                _boxes(log, known, self.least_confidence),
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


def correction_of(registration: Registration | None) -> Correction:
    """What a registration adds to the camera and to the clock of the log."""
    if registration is None:
        return NO_CORRECTION
    return registration.correction


def parse_fixed(names: str | Sequence[str] | None) -> tuple[str, ...]:
    """Names of parameters from a text such as `pitch,yaw`, or a list of them; names with units, too.

    Raises:
        InputError: A name is not known, or `all` does not stand alone.
    """
    fixed = tuple(text.strip() for text in (names.split(",") if isinstance(names, str) else names or ()))
    known = (*FIXED_NAMES, ALL)
    if unknown := [name for name in fixed if SHORT_OF.get(name, name) not in known]:
        raise InputError("--fixed", [f"no parameter {shown(unknown[0])} ({nearest(unknown[0], known)})"])
    if ALL in fixed and len(fixed) > 1:
        raise InputError("--fixed", [f"all stands alone (got {shown(','.join(fixed))})"])
    return fixed


def check_known(known: KnownMeans, fixed: tuple[str, ...]) -> None:
    """Refuse means of boxes where nothing is registered.

    Raises:
        InputError: They are given, and all parameters are fixed.
    """
    if ALL in fixed and any(value is not None for value in known.mean_errors):
        raise InputError("--known", ["means of box errors are for registration, which --fixed all leaves out"])


def _boxes(log: CameraLog, frames: Mask, least: float) -> BoxesAtTimes:
    """The detections of some frames (n,) that are confident enough, or have no confidence."""
    taken = log.take(frames)
    sure = np.isnan(taken.confidence) | (taken.confidence >= least)
    return BoxesAtTimes(taken.time_s, taken.frame[sure], taken.boxes_px[sure])
