"""A voyage as a labelled set: what a detector wrote, and the truth of its scene at the same times."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.detector.file.reading import detector_text as yaml_text
from modsim3d.formats.labelled import Annotations, Images, LabelledSet, Results, joined
from modsim3d.formats.reading.pair import compared
from modsim3d.geometry.camera import Camera
from modsim3d.geometry.camera_poses import CameraPoses
from modsim3d.io.atomic_write import json_text
from modsim3d.learn.voyage.attitude import NEAR_S, Attitude, Sampler
from modsim3d.learn.voyage.camera_registration import NOTHING_KNOWN, KnownMeans, RegistrationOptions, with_moved_vessels
from modsim3d.learn.voyage.clock import REGISTRATION, noted_cameras, read_reports, within_scene
from modsim3d.learn.voyage.exclusions import STALE_S, Regions, ReportAge, exclusions
from modsim3d.learn.voyage.log_to_scene import NO_CORRECTION, CameraLog, Correction, SceneLog
from modsim3d.learn.voyage.reference_error import View
from modsim3d.learn.voyage.registration.registering import Registration
from modsim3d.runs.pipeline import block_steps, occlusion_by, open_renderer
from modsim3d.scene.ais.scene_folder import REPORT, REPORT_TIMES
from modsim3d.scene.parts import SCENE_FILE
from modsim3d.scene.scene import Scene
from modsim3d.tracks.diagnosis import misreading
from modsim3d.truth.record import Truth, annotated_rows, annotation_boxes, concatenate

if TYPE_CHECKING:
    from modsim3d.render.id_pass import IdRenderer

# ---- What a camera of a scene sees at the times of a log ----


@dataclass(frozen=True, eq=False)
class CameraTruth:
    """Vessels that a camera sees in n frames."""

    truth: Truth  # `step` is the number of the frame
    half_planes: Array  # the sea's side of the horizon, (n, 3)
    camera_poses: CameraPoses


def camera_truth(
    scene: Scene, index: int, eye: Camera, times_s: Array, renderer: IdRenderer | None, attitude: Attitude | None = None
) -> CameraTruth:
    """The truth of one camera, which may be registered, at some times, as that of a run, hidden vessels included. Times
    since the scene's first step, (n,) with n >= 1, ascend, and the camera's vessel is there. The renderer is that of
    `open_renderer`; measured attitude replaces waves. Raises ModsimError if the camera has no place at a time."""
    sampler, parts, looks, length = Sampler(scene, attitude), [], [], block_steps(scene)
    for first in range(0, len(times_s), length):
        frames = np.arange(first, min(first + length, len(times_s)))
        sight = scene.sight(eye, np.arange(len(frames)), sampler.at(times_s[frames]))
        outlines = sight.outlines(as_shoeboxes=scene.annotation.source == "rectangles")
        occlusion = occlusion_by(outlines, eye.intrinsics, scene.annotation, renderer)
        parts.append(occlusion.truth(outlines, frames, index))
        looks.append(sight.camera_poses)
    truth = concatenate(parts)
    truth = truth.with_annotated(annotated_rows(truth, scene.annotation))
    rotations, places = (np.concatenate([getattr(look, name) for look in looks]) for name in _POSES)
    return CameraTruth(truth, eye.intrinsics.sea_half_plane(rotations), CameraPoses(rotations, places))


_POSES = ("camera_R_world", "positions_m")
CONDITION = "voyage"
_HIDDEN = 1e-3  # a vessel of which a larger share is hidden is partly hidden; a smaller one is a pixel's rounding

Registrar = Callable[[Scene, CameraLog], Correction]  # finds the correction of a camera from its log and the scene


@dataclass(frozen=True)
class VoyageOptions:
    """Options of a voyage's truth. Registration is what is added to camera and clock, or finds it; or each camera's."""

    registration: Correction | Registrar | RegistrationOptions = NO_CORRECTION
    stale_s: float = STALE_S  # least time without a report of a vessel under way that is left out
    attitude: Attitude | None = None  # of own ship as it was measured; its frames without one are left out
    condition: str = CONDITION


NO_OPTIONS = VoyageOptions()


@dataclass(frozen=True, eq=False)
class CameraFit:
    """The registration of one camera in one log."""

    source: str  # what messages call the log
    registration: Registration
    clock_s: float = 0.0  # what was added to the log's times before, as is noted beside the scene
    known: KnownMeans = NOTHING_KNOWN  # beforehand


@dataclass(frozen=True, eq=False)
class LabelledVoyage:
    """A labelled set, with what it was made by."""

    labelled: LabelledSet
    scene: Scene
    views: tuple[View, ...]  # what each camera looked at; images are those of the set
    registered: tuple[CameraFit, ...]  # the cameras that were


def joined_voyages(parts: Sequence[LabelledVoyage]) -> LabelledVoyage:
    """Several voyages of one scene as one; each view's images and identities are those of the joined set."""
    views, first_image, first_identity = list[View](), 0, 0
    for part in parts:
        views += [
            replace(view, images=view.images + first_image, first_identity=view.first_identity + first_identity)
            for view in part.views
        ]
        first_image += len(part.labelled.images)
        first_identity += int(part.labelled.annotations.identity.max(initial=-1)) + 1
    registered = tuple(fit for part in parts for fit in part.registered)
    return LabelledVoyage(joined([part.labelled for part in parts]), parts[0].scene, tuple(views), registered)


def labelled_voyage(log: SceneLog, options: VoyageOptions = NO_OPTIONS) -> LabelledVoyage:
    """Frames of a log with the scene's truth, rendered as that of a run. Vessels whose AIS is stale, jumps or is off
    count neither for nor against a detector. Raises ModsimError if no frame is within the scene, boxes fit its vessels
    in another reading, or the truth cannot be made."""
    means = _prior_means(options)
    log = replace(log, scene=means.scene_of(log.scene))
    reports = read_reports(log.scene.path)
    fresh = ReportAge(log.scene, reports, options.stale_s)
    with open_renderer(log.scene) as renderer:
        parts = [_CameraSet(log, camera, fresh, options, renderer).voyage() for camera in log.cameras]
    notes = list(log.notes)
    if means.delay_s:
        notes.append(f"reports of vessels are taken to be {means.delay_s:g} s late, as was given")
    if reports is not None and not reports.used_s:
        notes.append(f"{log.scene.title}: has no report times beside it, so stale AIS is not left out: make it again")
    for part in parts:
        notes += [note for note in part.labelled.notes if note not in notes]
    whole = joined_voyages(parts)
    rows, vessels = next(compared(whole.labelled, log.form))
    if problem := misreading(rows, vessels, only_forms=True):
        raise InputError(log.source, [f"{problem.sentence}: they are of {log.scene.title}"])
    if problem := misreading(rows, vessels):
        notes.append(f"{log.source}: {problem.sentence}, or the clock, the camera or the detector is so far off")
    number = len(whole.labelled.images)
    images = replace(whole.labelled.images, source=np.zeros(number, dtype=np.int64))  # cameras see the same traffic
    return replace(whole, labelled=replace(whole.labelled, images=images, notes=tuple(notes)))


def _prior_means(options: VoyageOptions) -> KnownMeans:
    return options.registration.known if isinstance(options.registration, RegistrationOptions) else NOTHING_KNOWN


class _CameraSet:
    def __init__(
        self, log: SceneLog, of_camera: CameraLog, fresh: ReportAge, options: VoyageOptions, renderer: IdRenderer | None
    ) -> None:
        """Take the frames that are within the scene."""
        self.scene, self.options, self.log, self.fresh = log.scene, options, log, fresh
        self.registration: Registration | None = None
        correction = self._correction(of_camera)
        offsets = self._offsets()
        scene, self.moved = with_moved_vessels(self.scene, offsets), np.asarray(offsets.any(axis=1))
        self.camera = correction.camera(log.scene.cameras[of_camera.camera])
        times_s, inside = within_scene(of_camera.time_s, correction.clock_s, log.length_s)
        carrier, attitude = self.camera.mount.vessel, options.attitude
        carried = inside & _carrier_there(log.scene, carrier, times_s)
        self.notes = list(_said_of_frames(self.camera.name, inside, carried, carrier))
        if attitude is not None and attitude.vessel != carrier:
            elsewhere = f"is not on board '{attitude.vessel}', so the attitude is not used for it"
            self.notes.append(f"camera '{self.camera.name}' {elsewhere}")
            attitude = None
        if attitude is not None:
            measured = attitude.known(times_s)
            if lacking := int((carried & ~measured).sum()):
                self.notes.append(f"camera '{self.camera.name}': {lacking:,} frames without attitude are left out")
            carried &= measured
        if not carried.any():
            raise InputError(log.source, self.notes)
        self.frames, self.times_s = of_camera.take(carried), times_s[carried]
        self.truth = camera_truth(scene, of_camera.camera, self.camera, self.times_s, renderer, attitude)
        self.poses = Sampler(scene, attitude).at(self.times_s)

    def _correction(self, of_camera: CameraLog) -> Correction:
        given = self.options.registration
        if isinstance(given, Correction):
            return given
        if not isinstance(given, RegistrationOptions):
            return given(self.scene, of_camera)
        self.registration = given.of(self.scene, of_camera, self.log.source)
        return NO_CORRECTION if self.registration is None else self.registration.correction

    def _offsets(self) -> Array:
        """Offsets of vessels from their reports, see `with_moved_vessels`; 0 where positions are surely known."""
        given = self.options.registration
        if self.registration is None or not isinstance(given, RegistrationOptions) or not given.position_m:
            return np.zeros((len(self.scene.vessels), 3))
        return self.registration.values.vessels

    def voyage(self) -> LabelledVoyage:
        """The set with what it was made by."""
        view = View(self.camera, self.poses, np.arange(len(self.times_s)), moved=self.moved)
        registered = []
        if self.registration is not None:
            means = _prior_means(self.options)
            registered = [CameraFit(self.log.source, self.registration, self.frames.clock_s, means)]
        return LabelledVoyage(self._labelled(), self.scene, (view,), tuple(registered))

    def _labelled(self) -> LabelledSet:
        frames, annotations = self.frames, self._annotations(self.truth)
        condition, source, sequence = np.zeros((3, len(frames.names)), dtype=np.int64)
        images = Images(
            names=frames.names,
            sizes_px=np.tile(np.array(self.camera.intrinsics.image_size_px, dtype=np.float64), (len(source), 1)),
            condition=condition,
            source=source,
            sequence=sequence,
            time_s=frames.time_s - frames.clock_s,  # by the log's clock, which is what a user reads
            half_planes=self.truth.half_planes,
        )
        results = Results(frames.frame, frames.label, frames.boxes_px, frames.confidence)
        return LabelledSet(self.log.labels, (self.options.condition,), images, annotations, results, tuple(self.notes))

    def _annotations(self, seen: CameraTruth) -> Annotations:
        """The annotated vessels, and the regions of those that are left out."""
        untold = np.isnan(seen.truth.visible_fraction) & (seen.truth.silhouette_px > 0) & ~seen.truth.annotated
        truth = seen.truth.take(seen.truth.annotated | untold)
        untold = ~truth.annotated
        self.notes += _said_of_overlaps(self.scene, truth.vessel[untold], len(self.times_s))
        boxes = annotation_boxes(truth, self.scene.annotation.mode)
        boxes[untold] = truth.full_boxes_px[untold]
        rows = Regions(truth.step, truth.vessel, boxes, truth.depth_m)
        out = exclusions(self.fresh, self.scene, self.camera, seen.camera_poses, self.times_s, rows)
        self.notes += out.notes
        boxes[out.rows] = out.boxes_px
        vessel = np.concatenate([truth.vessel, out.off.vessel])
        ignored = np.concatenate([out.rows | untold, np.ones(len(out.off.frame), dtype=bool)])
        by_what_is_left = (self.scene.annotation.mode == 2) & (truth.visible_fraction < 1 - _HIDDEN)
        return Annotations(
            image=np.concatenate([truth.step, out.off.frame]),
            label=self.log.vessel_label[vessel],
            boxes_px=np.concatenate([boxes, out.off.boxes_px]),
            ignored=ignored,
            crowd=ignored.copy(),
            identity=vessel,
            visible_fraction=np.concatenate([truth.visible_fraction, np.full(len(out.off.frame), np.nan)]),
            depth_m=np.concatenate([truth.depth_m, out.off.depth_m]),
            unsure_box=np.concatenate([by_what_is_left, np.zeros(len(out.off.frame), dtype=bool)]),
        ).by_image()


def _said_of_overlaps(scene: Scene, vessel: Indices, frames: int) -> Iterator[str]:
    """Sentences on vessels that overlap others in space, in which order the truth cannot tell, given their rows."""
    for column, count in zip(*np.unique(vessel, return_counts=True), strict=True):
        overlaps = f"it overlaps another one in {count:,} of {frames:,}"
        yield f"vessel '{scene.vessel_names[column]}' is left out of frames: {overlaps}"


def _carrier_there(scene: Scene, vessel: str | None, times_s: Array) -> Mask:
    """Whether the vessel that carries a camera is in the scene at some times, shape (n,)."""
    if vessel is None:
        return np.ones(len(times_s), dtype=bool)
    present = scene.poses.poses(0, scene.steps).present[:, scene.vessel_names.index(vessel)]
    every_s = scene.times_s(0, scene.steps)
    before = np.clip(np.searchsorted(every_s, times_s + NEAR_S, side="right") - 1, 0, len(every_s) - 1)
    after = np.where(times_s - every_s[before] > NEAR_S, np.minimum(before + 1, len(every_s) - 1), before)
    return present[before] & present[after]


def _said_of_frames(camera: str, inside: Mask, carried: Mask, vessel: str | None) -> Iterator[str]:
    if outside := int((~inside).sum()):
        yield f"camera '{camera}': {outside:,} of {len(inside):,} frames are before or after the scene and left out"
    if absent := int((inside & ~carried).sum()):
        yield f"camera '{camera}': {absent:,} frames are left out in which '{vessel}', which carries it, has no pose"


# ---- A scene with its cameras as they were registered ----

_VESSELS = "vessels.json"
_HEAD = (
    "Scene '{name}', with its cameras as they were registered; made by `modsim3d learn-voyage --write-scene`.",
    "registration.json has the clocks of the logs, which `modsim3d learn-voyage` adds to their times.",
)


def scene_files(scene: Scene, registered: Sequence[CameraFit], folder: Path) -> dict[Path, bytes | str]:
    """The files of a copy of a scene, for a folder, whose cameras have the registered values: `scene.yaml`, so that the
    folder stands for it, and what `modsim3d ais` wrote beside it. Raises ModsimError if a camera is there twice."""
    names = [fit.registration.camera for fit in registered]
    if twice := [name for name in names if names.count(name) > 1]:
        raise ModsimError(f"--write-scene: camera '{twice[0]}' was registered in several logs: join them, or give one")
    cameras = {name: dict(keys) for name, keys in scene.copy.document["cameras"].items()}
    for fit in registered:
        cameras[fit.registration.camera] = _camera_keys(cameras[fit.registration.camera], fit.registration)
    document = {**scene.copy.document, "cameras": cameras}
    files = _files_beside(scene)
    if isinstance(document.get("vessels"), dict):
        files[Path(_VESSELS)], document["vessels"] = json_text(document["vessels"]), _VESSELS
    beside = (scene.path.parent / name for name in (REPORT, REPORT_TIMES))
    files |= {Path(path.name): path.read_bytes() for path in beside if path.is_file()}
    files[Path(REGISTRATION)] = json_text(_content(scene, registered))
    files[Path(SCENE_FILE)] = yaml_text(document, [line.format(name=scene.name) for line in _HEAD])
    return {folder / name: content for name, content in files.items()}


def _files_beside(scene: Scene) -> dict[Path, bytes | str]:
    with TemporaryDirectory() as temporary:
        written = Path(temporary)
        scene_file = scene.copy.write(written)
        paths = [path for path in written.rglob("*") if path.is_file() and path != scene_file]
        return {path.relative_to(written): path.read_bytes() for path in paths}


def _camera_keys(keys: Mapping[str, Any], registration: Registration) -> dict[str, Any]:
    """The keys of a camera with what its registration adds."""
    values, place = registration.values, "mount" if keys.get("mount") else "pose"
    posed = dict(keys[place])
    along, port, up = posed["position_m"]
    posed["position_m"] = [along, port, up + values["height_m"]]
    for name in ("roll", "pitch", "yaw"):
        posed[f"{name}_rad"] = posed.get(f"{name}_rad", 0.0) + float(np.radians(values[f"{name}_deg"]))
    share, changed = 1 + values["focal_share"], {**keys, place: posed}
    if keys.get("focal_px") is None:
        changed["focal_length_m"] = keys["focal_length_m"] * share
    else:
        changed["focal_px"] = [share * focal for focal in keys["focal_px"]]
    if values["k1"]:
        bent = dict(keys.get("distortion") or {})
        changed["distortion"] = bent | {"k1": bent.get("k1", 0.0) + values["k1"]}
    return changed


def _content(scene: Scene, registered: Sequence[CameraFit]) -> dict[str, Any]:
    """Registered values: the clock to add to the log's times, else the noted one; the scene has the others already."""
    cameras = dict(noted_cameras(scene.path))
    for fit in registered:
        cameras[fit.registration.camera] = {
            "log": fit.source,
            "clock_s": fit.clock_s + fit.registration.values["clock_s"],
            "known": fit.known.by_name(),
            "added": {
                entry.name: {"value": entry.value, "low": entry.low, "high": entry.high, "held": entry.held or None}
                for entry in fit.registration.estimates
            },
        }
    return {"format": 1, "cameras": cameras}
