"""A voyage as a labelled set: what a detector wrote, and the truth of its scene at the same times."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.errors import InputError
from modsim3d.formats.labelled import Annotations, Images, LabelledSet, Results, joined
from modsim3d.runs.pipeline import open_renderer
from modsim3d.scene.scene import Scene
from modsim3d.truth.modes import annotation_boxes
from modsim3d.truth.truth_record import Truth
from modsim3d.voyage.attitude import Attitude
from modsim3d.voyage.clock import within_scene
from modsim3d.voyage.correction import NO_CORRECTION, Correction
from modsim3d.voyage.known import NOTHING_KNOWN, KnownMeans
from modsim3d.voyage.left_out import STALE_S, Freshness, Regions, left_out
from modsim3d.voyage.moved_vessels import with_moved_vessels
from modsim3d.voyage.on_scene import CameraLog, SceneLog
from modsim3d.voyage.registered import Registering, correction_of
from modsim3d.voyage.registration import Registration
from modsim3d.voyage.reports import read_reports
from modsim3d.voyage.sampling import NEAR_S, Sampler
from modsim3d.voyage.truth import CameraTruth, camera_truth
from modsim3d.voyage.truth_noise.jacobians import View

if TYPE_CHECKING:
    from modsim3d.render.id_pass import IdRenderer

CONDITION = "voyage"
_HIDDEN = 1e-3
"""A vessel of which a larger share is hidden is partly hidden; a smaller one is a pixel's rounding."""

Registrar = Callable[[Scene, CameraLog], Correction]
"""Finds the correction of a camera from its log and the scene."""


@dataclass(frozen=True)
class VoyageOptions:
    """How the truth of a voyage is made.

    Attributes:
        registration: What is added to the camera and to the clock, what finds it for each camera, or how each camera is
            registered.
        stale_s: Least time without a report of a vessel under way that is left out.
        attitude: That of own ship as it was measured; its frames without one are left out.
        condition: Name of the condition.
    """

    registration: Correction | Registrar | Registering = NO_CORRECTION
    stale_s: float = STALE_S
    attitude: Attitude | None = None
    condition: str = CONDITION


NO_OPTIONS = VoyageOptions()


@dataclass(frozen=True, eq=False)
class Registered:
    """The registration of one camera in one log.

    Attributes:
        source: What messages call the log.
        registration: The registration.
        clock_s: What was added to the log's times before, as is noted beside the scene.
        known: Means that were known beforehand.
    """

    source: str
    registration: Registration
    clock_s: float = 0.0
    known: KnownMeans = NOTHING_KNOWN


@dataclass(frozen=True, eq=False)
class LabelledVoyage:
    """A labelled set, with what it was made by.

    Attributes:
        labelled: The set.
        scene: The scene.
        views: What each camera looked at; images are those of the set.
        registered: The cameras that were registered.
    """

    labelled: LabelledSet
    scene: Scene
    views: tuple[View, ...]
    registered: tuple[Registered, ...]


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
    registered = tuple(each for part in parts for each in part.registered)
    return LabelledVoyage(joined([part.labelled for part in parts]), parts[0].scene, tuple(views), registered)


def labelled_voyage(log: SceneLog, options: VoyageOptions = NO_OPTIONS) -> LabelledVoyage:
    """The frames of a log with the truth of its scene, which is rendered as that of a run is.

    Vessels whose AIS is stale, jumps or is off are ignored: detecting them counts neither for nor against a detector.

    Raises:
        InputError: No frame is within the scene.
        ModsimError: The truth cannot be made.
    """
    known = _known(options)
    log = replace(log, scene=known.scene_of(log.scene))
    reports = read_reports(log.scene.path)
    fresh = Freshness(log.scene, reports, options.stale_s)
    with open_renderer(log.scene) as renderer:
        parts = [_CameraSet(log, each, fresh, options, renderer).voyage() for each in log.cameras]
    notes = list(log.notes)
    if known.delay_s:
        notes.append(f"reports of vessels are taken to be {known.delay_s:g} s late, as was given")
    if reports is not None and not reports.used_s:
        notes.append(f"{log.scene.title}: has no report times beside it, so stale AIS is not left out: make it again")
    for part in parts:
        notes += [note for note in part.labelled.notes if note not in notes]
    whole = joined_voyages(parts)
    number = len(whole.labelled.images)
    images = replace(whole.labelled.images, source=np.zeros(number, dtype=np.int64))  # cameras see the same traffic
    return replace(whole, labelled=replace(whole.labelled, images=images, notes=tuple(notes)))


def _known(options: VoyageOptions) -> KnownMeans:
    return options.registration.known if isinstance(options.registration, Registering) else NOTHING_KNOWN


class _CameraSet:
    """The labelled set of one camera."""

    def __init__(
        self,
        log: SceneLog,
        of_camera: CameraLog,
        fresh: Freshness,
        options: VoyageOptions,
        renderer: IdRenderer | None,
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
            self.notes.append(
                f"camera '{self.camera.name}' is not on board '{attitude.vessel}', so the attitude is not used for it"
            )
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
        if not isinstance(given, Registering):
            return given(self.scene, of_camera)
        self.registration = given.of(self.scene, of_camera, self.log.source)
        return correction_of(self.registration)

    def _offsets(self) -> Array:
        """How far vessels are off their reports, see `with_moved_vessels`; 0 where positions are surely known."""
        given = self.options.registration
        if self.registration is None or not isinstance(given, Registering) or not given.position_m:
            return np.zeros((len(self.scene.vessels), 3))
        return self.registration.values.vessels

    def voyage(self) -> LabelledVoyage:
        """The set with what it was made by."""
        view = View(self.camera, self.poses, np.arange(len(self.times_s)), moved=self.moved)
        found = self.registration
        registered = (
            () if found is None else (Registered(self.log.source, found, self.frames.clock_s, _known(self.options)),)
        )
        return LabelledVoyage(self._labelled(), self.scene, (view,), registered)

    def _labelled(self) -> LabelledSet:
        frames, number = self.frames, len(self.frames.names)
        annotations = self._annotations(self.truth)
        images = Images(
            names=frames.names,
            sizes_px=np.tile(np.array(self.camera.intrinsics.image_size_px, dtype=np.float64), (number, 1)),
            condition=np.zeros(number, dtype=np.int64),
            source=np.zeros(number, dtype=np.int64),
            sequence=np.zeros(number, dtype=np.int64),
            time_s=frames.time_s - frames.clock_s,  # by the log's clock, which is what a user reads
            half_planes=self.truth.half_planes,
        )
        results = Results(frames.frame, frames.label, frames.boxes_px, frames.confidence)
        return LabelledSet(self.log.labels, (self.options.condition,), images, annotations, results, tuple(self.notes))

    def _partly_hidden(self, truth: Truth) -> Mask:
        """Which vessels are annotated by the box of what is left of them, shape (n,)."""
        return (self.scene.annotation.mode == 2) & (truth.visible_fraction < 1 - _HIDDEN)

    def _annotations(self, seen: CameraTruth) -> Annotations:
        """The annotated vessels, and the regions of those that are left out."""
        untold = np.isnan(seen.truth.visible_fraction) & (seen.truth.silhouette_px > 0) & ~seen.truth.annotated
        truth = seen.truth.take(seen.truth.annotated | untold)
        untold = ~truth.annotated
        self.notes += _said_of_overlaps(self.scene, truth.vessel[untold], len(self.times_s))
        boxes = annotation_boxes(truth, self.scene.annotation.mode)
        boxes[untold] = truth.full_boxes_px[untold]
        rows = Regions(truth.step, truth.vessel, boxes, truth.depth_m)
        out = left_out(self.fresh, self.scene, self.camera, seen.camera_poses, self.times_s, rows)
        self.notes += out.notes
        boxes[out.rows] = out.boxes_px
        vessel = np.concatenate([truth.vessel, out.off.vessel])
        ignored = np.concatenate([out.rows | untold, np.ones(len(out.off.frame), dtype=bool)])
        return Annotations(
            image=np.concatenate([truth.step, out.off.frame]),
            label=self.log.vessel_label[vessel],
            boxes_px=np.concatenate([boxes, out.off.boxes_px]),
            ignored=ignored,
            crowd=ignored.copy(),
            identity=vessel,
            visible_fraction=np.concatenate([truth.visible_fraction, np.full(len(out.off.frame), np.nan)]),
            depth_m=np.concatenate([truth.depth_m, out.off.depth_m]),
            unsure_box=np.concatenate([self._partly_hidden(truth), np.zeros(len(out.off.frame), dtype=bool)]),
        ).by_image()


def _said_of_overlaps(scene: Scene, vessel: Indices, frames: int) -> Iterator[str]:
    """What becomes of vessels that overlap others in space, in which order the truth cannot tell, given their rows."""
    for column, count in zip(*np.unique(vessel, return_counts=True), strict=True):
        yield (
            f"vessel '{scene.vessel_names[column]}' is left out of frames: it overlaps another one in {count:,} of "
            f"{frames:,}"
        )


def _carrier_there(scene: Scene, vessel: str | None, times_s: Array) -> Mask:
    """Whether the vessel that carries a camera is in the scene at some times, shape (n,)."""
    if vessel is None:
        return np.ones(len(times_s), dtype=bool)
    there = scene.poses.poses(0, scene.steps).present[:, scene.vessel_names.index(vessel)]
    every_s = scene.times_s(0, scene.steps)
    before = np.clip(np.searchsorted(every_s, times_s + NEAR_S, side="right") - 1, 0, len(every_s) - 1)
    after = np.where(times_s - every_s[before] > NEAR_S, np.minimum(before + 1, len(every_s) - 1), before)
    found: Mask = there[before] & there[after]
    return found


def _said_of_frames(camera: str, inside: Mask, carried: Mask, vessel: str | None) -> Iterator[str]:
    """What became of frames that have no truth."""
    if outside := int((~inside).sum()):
        yield f"camera '{camera}': {outside:,} of {len(inside):,} frames are before or after the scene and left out"
    if absent := int((inside & ~carried).sum()):
        yield f"camera '{camera}': {absent:,} frames are left out in which '{vessel}', which carries it, has no pose"
