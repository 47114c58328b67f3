"""Learning a detector from a voyage: its log and its scene in, what was learned out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from modsim3d.core.errors import ModsimError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Rule, usual_method
from modsim3d.io.input_files import inputs_noted
from modsim3d.learn.learn_detector import MIN_CONFIDENCE, LearnOptions, least_confidence
from modsim3d.learn.learned import LearnSettings
from modsim3d.learn.learning import LearnResult
from modsim3d.learn.model_selection import left_out
from modsim3d.learn.report import LearnReport
from modsim3d.learn.report_page import Sources
from modsim3d.learn.voyage.attitude import read_attitude
from modsim3d.learn.voyage.camera_registration import (
    KnownMeans,
    Registering,
    check_known,
    parse_fixed,
    parse_known,
    position_noise_m,
)
from modsim3d.learn.voyage.clock import SceneClock
from modsim3d.learn.voyage.deconvolution import report_less_truth_noise
from modsim3d.learn.voyage.exclusions import stale_limit_s
from modsim3d.learn.voyage.labelled_voyage import LabelledVoyage, Registered, Registrar, VoyageOptions, labelled_voyage
from modsim3d.learn.voyage.log_to_scene import Correction, on_scene
from modsim3d.learn.voyage.logs.log import NO_OPTIONS, LogOptions
from modsim3d.learn.voyage.logs.reading import read_log
from modsim3d.learn.voyage.non_ais.rates import TimeSpan, check_stretches, parse_stretches
from modsim3d.learn.voyage.non_ais.report import learn_beside_unseen
from modsim3d.learn.voyage.reference_error import TruthNoise
from modsim3d.learn.voyage.report import VoyageReport, voyage_sections
from modsim3d.runs.files.overwrite import RUN_FILE, read_of_run
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene

Method = Literal["confidence", "optimal", "centre"]
NO_SHIFT = (
    "--bias and --correct are not for --scene: a simulation of what was learned has neither vessels without a "
    "transponder nor errors of truth, so that it would show another shift"
)


@dataclass(frozen=True, eq=False, repr=False)
class VoyageResult(LearnResult):
    """A detector that was learned from a voyage, from `learn_voyage`.

    Attributes:
        told: What is reported of the voyage.
    """

    told: VoyageReport = field(kw_only=True)

    @property
    def registered(self) -> tuple[Registered, ...]:
        """The registration of each camera."""
        return self.told.voyage.registered


def learn_from(
    voyage: LabelledVoyage,
    settings: LearnSettings,
    options: LearnOptions,
    stretches: tuple[TimeSpan, ...] = (),
    position_m: float = 0.0,
) -> tuple[LearnReport, VoyageReport]:
    """Learn from a labelled voyage.

    Args:
        voyage: The voyage.
        settings: How it is learned.
        options: What is wanted besides.
        stretches: Stretches in which nothing floats but the vessels of the scene.
        position_m: Standard deviation of each coordinate of positions.

    Raises:
        ModsimError: Nothing can be learned, or no frame is in a stretch.
    """
    if options.bias:
        raise ModsimError(NO_SHIFT)
    noise = TruthNoise.of(voyage.scene, position_m)
    labelled = voyage.labelled if noise.std.any() else with_sure_boxes(voyage.labelled)
    report, judged = learn_beside_unseen(labelled, settings, options, stretches)
    report = replace(report, near_gate=replace(report.near_gate, simulated=False))
    report, taken_off = report_less_truth_noise(report, voyage.scene, voyage.views, noise)
    told = VoyageReport.of(voyage, judged, taken_off, report, settings.replicates, settings.seed)
    return report, told


def with_sure_boxes(labelled: LabelledSet) -> LabelledSet:
    """The set of a scene whose vessels are surely where it has them, so that what is hidden of them is known."""
    return replace(labelled, annotations=replace(labelled.annotations, unsure_box=None))


def learn_voyage(
    scene: Scene | StrPath,
    log: StrPath,
    *,
    camera: str | None = None,
    registration: Correction | Registrar | Registering | None = None,
    fixed: str | Sequence[str] = (),
    known: str | Mapping[str, float] | KnownMeans | None = None,
    empty: str | None = None,
    position_noise: float | None = None,
    stale_s: float | None = None,
    attitude: StrPath | None = None,
    log_options: LogOptions = NO_OPTIONS,
    match: Method | None = None,
    least_iou: float = 0.5,
    most_distance_px: float = 50.0,
    confidence: float | None = None,
    replicates: int = 300,
    seed: int = 0,
    without: Sequence[str] = (),
) -> VoyageResult:
    """Learn a detector from what it wrote during a voyage whose vessels' tracks are known.

        learned = modsim3d.learn_voyage("scene", "detections.csv")
        learned.registered[0].registration["pitch_deg"], learned.write("learned.yaml")

    Args:
        scene: The scene, its file, or the name of a shipped scene: the vessels, their tracks, and the camera.
        log: What the detector wrote; docs/voyage.md has the formats.
        camera: The scene's camera that the log is of; needed where the log does not say it and the scene has several.
        registration: What is added to the camera and to the clock, or what finds it for each camera; None to have it
            estimated from the detections.
        fixed: Parameters that are not estimated, such as `pitch,yaw`, or `all`.
        known: Means that are known beforehand, which else are taken to be zero: `mean_x=1.5,mean_y=-0.8,delay=2`, a
            mapping of these names, or `KnownMeans`. Pixels, shares for `mean_width` and `mean_height`, seconds.
        empty: Stretches in which nothing floats but the scene's vessels, by the clock of the log, such as
            `120-300,900-1000`.
        position_noise: Standard deviation of each coordinate of positions, in metres; if None, 10 m with AIS, else 0.
        stale_s: Least time without an AIS report of a vessel under way that is left out; if None, 60 s.
        attitude: File of own ship's roll, pitch and heading, in place of the scene's waves.
        log_options: What the log does not say itself.
        match: As that of `modsim3d.learn_detector`, as are the following; but if None, by centres where positions are
            not surely known.
        least_iou: Least IoU.
        most_distance_px: Largest distance between centres.
        confidence: Least confidence.
        replicates: Number of replicates of the bootstrap.
        seed: Seed of the bootstrap.
        without: Models to leave out.

    Raises:
        ModsimError: The scene or the log cannot be read, they do not fit each other, the camera cannot be registered,
            or nothing can be learned.
        TypeError: The scene, the log or the attitude is no path.
    """
    path = as_path(log, "log")
    if registration is not None and (fixed or known):
        raise ModsimError("learn_voyage: fixed and known are for a registration that is estimated, and one is given")
    with inputs_noted() as inputs:
        loaded = scene if isinstance(scene, Scene) else load_scene(scene)
        read = on_scene(read_log(path, log_options), loaded, camera)
        measured = None if attitude is None else read_attitude(as_path(attitude, "attitude"), loaded)
        position_m = position_noise_m(loaded, position_noise)
        stretches = parse_stretches(empty, SceneClock.of(loaded).start_s) if empty else ()
        check_stretches(stretches, read.time_s)
        if registration is None:
            least = MIN_CONFIDENCE if confidence is None else confidence
            registration = Registering(parse_fixed(fixed), position_m, least, measured, parse_known(known))
            check_known(registration.known, registration.fixed)
        voyage = labelled_voyage(read, VoyageOptions(registration, stale_limit_s(loaded, stale_s), measured))
    rule = Rule(match or usual_method(voyage.labelled, position_m), least_iou, most_distance_px)
    least = least_confidence(voyage.labelled, confidence)
    settings = LearnSettings(rule, least, replicates, seed, without=left_out(without, "learn_voyage: without"))
    report, told = learn_from(voyage, settings, LearnOptions(), stretches, position_m)
    files = (*dict.fromkeys([*inputs, *read_besides(loaded, path)]),)
    call = "modsim3d.learn_voyage(…).write(…) from Python"
    sources = Sources((loaded.path,), (path,), (), files, settings, call)
    return VoyageResult(report, files, sources, voyage_sections(told), told=told)


def read_besides(scene: Scene, log: Path) -> list[Path]:
    """Files of a scene and of a log that is a run, which are not written over either."""
    return [*scene.copy.read, *(read_of_run(log) if (log / RUN_FILE).is_file() else [])]
