"""Learning a detector from a voyage: its log and its scene in, what was learned out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from modsim3d.core.errors import ModsimError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.core.text import counted
from modsim3d.formats.labelled import LabelledSet
from modsim3d.io.input_files import inputs_noted
from modsim3d.learn.learn_detector import MIN_CONFIDENCE, LearnOptions, LearnRequest, NumberModel, parse_states
from modsim3d.learn.learned_detector import LearnSettings
from modsim3d.learn.learning import LearnResult
from modsim3d.learn.report import LearnReport
from modsim3d.learn.report_page import Sources
from modsim3d.learn.voyage import camera_registration
from modsim3d.learn.voyage import labelled_voyage as truth
from modsim3d.learn.voyage.attitude import read_attitude
from modsim3d.learn.voyage.camera_registration import KnownMeans, RegistrationOptions, parse_fixed, parse_known
from modsim3d.learn.voyage.clock import SceneClock
from modsim3d.learn.voyage.deconvolution import corrected_report
from modsim3d.learn.voyage.exclusions import stale_limit_s
from modsim3d.learn.voyage.labelled_voyage import LabelledVoyage, Registrar
from modsim3d.learn.voyage.log_to_scene import Correction, on_scene
from modsim3d.learn.voyage.logs.log import NO_OPTIONS, LogOptions
from modsim3d.learn.voyage.logs.reading import read_log
from modsim3d.learn.voyage.non_ais.classification import TimeSpan, check_stretches, parse_stretches
from modsim3d.learn.voyage.reference_error import ReferenceNoise
from modsim3d.learn.voyage.report import VoyageReport, learn_beside_unseen, voyage_sections
from modsim3d.runs.files.overwrite import RUN_FILE, read_of_run
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene

Method = Literal["confidence", "optimal", "centre"]


@dataclass(frozen=True, eq=False, repr=False)
class VoyageResult(LearnResult):
    """A detector that was learned from a voyage, from `learn_voyage`, and the `voyage_report`."""

    voyage_report: VoyageReport = field(kw_only=True)

    @property
    def registered(self) -> tuple[truth.CameraFit, ...]:
        """The registration of each camera."""
        return self.voyage_report.voyage.registered


def learn_from(
    voyage: LabelledVoyage,
    settings: LearnSettings,
    options: LearnOptions,
    stretches: tuple[TimeSpan, ...] = (),
    position_m: float = 0.0,
) -> tuple[LearnReport, VoyageReport]:
    """Learn from a labelled voyage with `stretches` in which nothing floats but the scene's vessels, and `position_m`,
    see `ReferenceNoise`. Raises ModsimError if nothing can be learned, or no frame is in a stretch."""
    noise = ReferenceNoise.of(voyage.scene, position_m)
    labelled = voyage.labelled if noise.std.any() else with_sure_boxes(voyage.labelled)
    report, judged = learn_beside_unseen(labelled, settings, options, stretches)
    report, taken_off = corrected_report(report, voyage.scene, voyage.views, noise)
    rates = judged.own_rates(settings.replicates, settings.seed)
    return report, VoyageReport(voyage, judged, taken_off, rates, report.level)


def with_sure_boxes(labelled: LabelledSet) -> LabelledSet:
    """The set of a scene whose vessels are surely where it has them, so that what is hidden of them is known."""
    return replace(labelled, annotations=replace(labelled.annotations, unsure_box=None))


@dataclass(frozen=True, eq=False)
class VoyageRequest:
    """A scene, the logs of its cameras' detectors, and how a detector is learned; the rest is as for `learn_voyage`."""

    request: LearnRequest  # as from any labelled set
    scene: Scene
    logs: tuple[Path, ...]
    cameras: tuple[str | None, ...] = (None,)  # of each log, or one for all; None if the log says it or there is one
    registration: Correction | Registrar | RegistrationOptions | None = None
    fixed: str | Sequence[str] = ()
    known: str | Mapping[str, float] | KnownMeans | None = None
    empty: str | None = None
    position_noise: float | None = None
    stale_s: float | None = None
    attitude: Path | None = None
    log_options: LogOptions = NO_OPTIONS

    def __post_init__(self) -> None:
        """Raise ModsimError if there is no log, not a name or a camera for each, or a value is wrong."""
        if self.registration is not None and (self.fixed or self.known):
            caller = self.request.caller
            raise ModsimError(f"{caller}: fixed and known are for a registration that is estimated, and one is given")
        if not self.logs:
            raise ModsimError("nothing to learn from: --detections is needed, the log of a camera's detector")
        if self.request.conditions and len(self.request.conditions) != len(self.logs):
            counts = f"{len(self.request.conditions)} conditions are named for {counted(len(self.logs), 'log')}"
            raise ModsimError(f"{counts}: name each")
        if len(self.cameras) not in (1, len(self.logs)):
            given = f"--camera is given {len(self.cameras)} times, with {counted(len(self.logs), 'log')}"
            raise ModsimError(f"{given}: give it once for all, or for each in their order")
        camera_registration.check_known(parse_known(self.known), parse_fixed(self.fixed))

    @cached_property
    def position_m(self) -> float:
        """Standard deviation of each coordinate of positions."""
        return camera_registration.position_noise_m(self.scene, self.position_noise)

    @cached_property
    def stretches(self) -> tuple[TimeSpan, ...]:
        """Stretches in which nothing floats but the scene's vessels."""
        return () if self.empty is None else parse_stretches(self.empty, SceneClock.of(self.scene).start_s)

    @property
    def files(self) -> list[Path]:
        """Files of the scene and of logs that are runs, which are not written over either."""
        of_runs = [path for log in self.logs if (log / RUN_FILE).is_file() for path in read_of_run(log)]
        return [*self.scene.copy.read, *of_runs]

    def labelled(self) -> LabelledVoyage:
        """Logs with the truth of the scene, cameras registered. Raises ModsimError if one is wrong, or given twice."""
        attitude = None if self.attitude is None else read_attitude(self.attitude, self.scene)
        registration = self.registration
        if registration is None:
            least = MIN_CONFIDENCE if self.request.confidence is None else self.request.confidence
            means, fixed = parse_known(self.known), parse_fixed(self.fixed)
            registration = RegistrationOptions(fixed, self.position_m, least, attitude, means)
        names = self.request.conditions or (truth.CONDITION,) * len(self.logs)
        cameras = self.cameras * (len(self.logs) // len(self.cameras))
        scene_logs, read = [], set()
        for path, camera in zip(self.logs, cameras, strict=True):
            if (path.resolve(), camera) in read:
                raise ModsimError(f"--detections {path} is given twice: its frames would count twice")
            read.add((path.resolve(), camera))
            scene_logs.append(on_scene(read_log(path, self.log_options), self.scene, camera))
        check_stretches(self.stretches, np.concatenate([log.time_s for log in scene_logs]))
        stale_s = stale_limit_s(self.scene, self.stale_s)
        options_of = (truth.VoyageOptions(registration, stale_s, attitude, name) for name in names)
        return truth.joined_voyages([truth.labelled_voyage(*pair) for pair in zip(scene_logs, options_of, strict=True)])

    def learn(self, voyage: LabelledVoyage, read: Sequence[Path], call: str) -> VoyageResult:
        """Learn a detector from the logs with the truth of the scene. `read` are the files that were read for it, and
        `call` is the command, or the call from Python, for the page. Raises ModsimError if nothing can be learned."""
        settings = self.request.settings(voyage.labelled, self.position_m)
        report, voyage_report = learn_from(voyage, settings, self.request.options(), self.stretches, self.position_m)
        files = (*dict.fromkeys([*read, *self.files]),)
        sources = Sources((self.scene.path,) * len(self.logs), self.logs, (), files, settings, call)
        return VoyageResult(report, files, sources, voyage_sections(voyage_report), voyage_report=voyage_report)


def learn_voyage(
    scene: Scene | StrPath,
    log: StrPath | Sequence[StrPath],
    *,
    camera: str | Sequence[str | None] | None = None,
    conditions: Sequence[str] = (),
    states: int | Mapping[str, Sequence[str]] | None = None,
    registration: Correction | Registrar | RegistrationOptions | None = None,
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
    level: float = 0.95,
    beta: float = 2.0,
    false_positives: NumberModel = "auto",
    without: Sequence[str] = (),
) -> VoyageResult:
    """Learn a detector from what it wrote during a voyage whose vessels' tracks are known.

        learned = modsim3d.learn_voyage("scene", "detections.csv")
        learned.registered[0].registration["pitch_deg"], learned.write("learned.yaml")

    Args:
        scene: The scene, its file, or the name of a shipped scene: the vessels, their tracks, and the camera.
        log: What the detector wrote, a log or several; docs/voyage.md has the formats.
        camera: The scene's camera that the log is of, or those of the logs in their order; needed where the log does
            not say it and the scene has several.
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
        match: As that of `modsim3d.learn_detector`; but if None, by centres where positions are not surely known.
        conditions, states, false_positives, without: As those of `modsim3d.learn_detector`.
        least_iou, most_distance_px, confidence, replicates, seed, level, beta: As those of `learn_detector` too.

    Raises:
        ModsimError: The scene or the log cannot be read, they do not fit each other, the camera cannot be registered,
            or nothing can be learned.
        TypeError: The scene, the log or the attitude is no path.
    """
    return _learned(**locals())


def _learned(scene: Any, log: Any, camera: Any, attitude: Any, states: Any, **options: Any) -> VoyageResult:
    """Result of learning from the arguments of `learn_voyage`."""
    plain = {name: options.pop(name) for name in LearnRequest.model_fields.keys() & options.keys()}
    request = LearnRequest.of("learn_voyage", **plain | parse_states(states, "learn_voyage"))
    measured = None if attitude is None else as_path(attitude, "attitude")
    logs = tuple(as_path(path, "log") for path in (log if isinstance(log, list | tuple) else [log]))
    cameras = (camera,) if camera is None or isinstance(camera, str) else tuple(camera)
    with inputs_noted() as read:
        loaded = scene if isinstance(scene, Scene) else load_scene(scene)
        voyage = VoyageRequest(request, loaded, logs, cameras, attitude=measured, **options)
        labelled = voyage.labelled()
    return voyage.learn(labelled, read, "modsim3d.learn_voyage(…).write(…) from Python")
