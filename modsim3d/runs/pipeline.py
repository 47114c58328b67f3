"""The pipeline: from a scene to the truth of its steps, and from truth to detections and frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from modsim3d.core.arrays import NOBODY, Indices, occurring, positions
from modsim3d.core.boxes import areas, errors_between
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.detector.chain import Detector, target_statistics
from modsim3d.detector.records import FALSE_POSITIVE, TRUE, CameraFrames, Detections, Targets
from modsim3d.detector.target_statistics import TargetStatistics
from modsim3d.geometry.camera import Intrinsics
from modsim3d.runs.blocks import Block, CameraBlock, frames_of
from modsim3d.runs.frames import Frame
from modsim3d.runs.truth_check import check_block
from modsim3d.scene.reading import place_problems
from modsim3d.scene.scene import Scene
from modsim3d.scene.sight import Sight
from modsim3d.truth.analytic import analytic_occlusion, rectangle_occlusion
from modsim3d.truth.occlusion import Occlusion
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.record import Annotation, Truth, annotated_rows, annotation_boxes, concatenate, no_truth
from modsim3d.world.poses.labelled import LabelledPoses
from modsim3d.world.poses.replay import LivePoses
from modsim3d.world.vessel_motion import PosesInWaves

if TYPE_CHECKING:
    from modsim3d.render.id_pass import IdRenderer


BLOCK_VESSELS, MAX_BLOCK_STEPS = 8_000, 1_000  # most vessels times steps of a block, and steps: arrays fit a cache

Range = tuple[int, int]  # the first step of a block, and the step after its last


@contextmanager
def open_renderer(scene: Scene) -> Iterator[IdRenderer | None]:
    """The ID renderer that a scene's truth needs, or None. Raises RendererError if there is no OpenGL library."""
    if scene.annotation.source != "rendered":
        yield None
        return
    from modsim3d.render.context import open_context  # no OpenGL where none is needed
    from modsim3d.render.id_pass import IdRenderer
    from modsim3d.truth import full_frame, rendered  # noqa: F401  # now, not at the first frame with a vessel

    with open_context() as context:
        yield IdRenderer(context)


def truth_block(scene: Scene, first: int, stop: int, renderer: IdRenderer | None) -> Truth:
    """Truth of all cameras in the frames that they take at steps first to stop − 1; `open_renderer` gives the renderer.
    Raises ModsimError if the vessel that carries a camera is missing."""
    if scene.labels is not None:
        truth = labelled_truth(scene.labels, first, stop)
        return truth.with_annotated(annotated_rows(truth, scene.annotation))
    taken = [(index, camera, scene.frame_steps(camera, first, stop)) for index, camera in enumerate(scene.cameras)]
    every = taken[0][2]
    if len(taken) > 1:
        every = first + occurring(np.concatenate([steps for _, _, steps in taken]) - first, stop - first)[0]
    if not len(every):
        return no_truth()
    vessel_poses = scene.motion.at(every)  # waves take time: once for all cameras

    def poses_at(steps: Indices) -> PosesInWaves:
        return vessel_poses if len(steps) == len(every) else vessel_poses.rows(np.searchsorted(every, steps))

    sights = [(index, scene.sight(camera, steps, poses_at(steps))) for index, camera, steps in taken if len(steps)]
    return concatenate([_camera_truth(scene, index, sight, renderer) for index, sight in sights])


def _camera_truth(scene: Scene, index: int, sight: Sight, renderer: IdRenderer | None) -> Truth:
    outlines = sight.outlines(as_shoeboxes=scene.annotation.source == "rectangles")
    if not outlines.boxed.any():
        return no_truth()
    occlusion = occlusion_by(outlines, sight.camera.intrinsics, scene.annotation, renderer)
    truth = occlusion.truth(outlines, sight.steps, index)
    return truth.with_annotated(annotated_rows(truth, scene.annotation))


def occlusion_by(
    outlines: Outlines, intrinsics: Intrinsics, annotation: Annotation, renderer: IdRenderer | None
) -> Occlusion:
    """Occluders before a camera, and how much each hides of whom, by the annotation's source of truth. Raises
    ModsimError if the rendered source has no renderer."""
    if annotation.source == "analytic":
        return analytic_occlusion(outlines, intrinsics)
    if annotation.source == "rectangles":
        return rectangle_occlusion(outlines)
    if renderer is None:
        raise ModsimError("the rendered source needs a renderer: use open_renderer(scene)")
    from modsim3d.truth.full_frame import full_frame_occlusion
    from modsim3d.truth.rendered import rendered_occlusion

    draw = full_frame_occlusion if annotation.render == "full" else rendered_occlusion
    return draw(outlines, intrinsics, renderer, annotation.supersample)


@dataclass(frozen=True, eq=False)
class DetectorInput:
    """Input of one camera's detector for a block: `targets` are the annotated `rows` of `truth`, shape (n,)."""

    truth: Truth
    rows: Indices
    frames: CameraFrames
    targets: Targets


def detector_inputs(scene: Scene, truth: Truth, first: int, stop: int) -> Iterator[DetectorInput]:
    """The input of each camera's detector at steps first to stop − 1, in the order of the cameras."""
    index = {label: i for i, label in enumerate(scene.detector.labels)}
    labels = np.array([index[vessel.label] for vessel in scene.vessels], dtype=np.int64)
    times_s = scene.times_s(first, stop)
    for number, camera in enumerate(scene.cameras):
        seen = truth.of_camera(number)
        rows = np.flatnonzero(seen.annotated)
        steps, before = scene.frame_steps(camera, first, stop), scene.last_frame(camera, first)
        frames = CameraFrames(
            camera=camera.name,
            steps=steps,
            times_s=times_s[steps - first],
            image_size_px=camera.intrinsics.image_size_px,
            sea_half_planes=scene.sea_half_planes(camera, steps),
            previous_s=-np.inf if before is None else float(scene.times_s(before, before + 1)[0]),
        )
        targets = Targets(
            frame=np.searchsorted(steps, seen.step[rows]),
            vessel=seen.vessel[rows],
            label=labels[seen.vessel[rows]],
            boxes_px=annotation_boxes(seen, scene.annotation.mode)[rows],
            visible_fraction=seen.visible_fraction[rows],
            depth_m=seen.depth_m[rows],
            vessel_ids=scene.vessel_names,
        )
        yield DetectorInput(seen, rows, frames, targets)


def scene_statistics(scene: Scene, blocks: Iterable[tuple[Truth, int, int]]) -> TargetStatistics:
    """Statistics of all targets of a scene, which its detector needs before it starts. `blocks` gives for each block
    its truth, its first step, and the step after its last; they are not read if the detector needs no statistics."""
    parts = (part for block in blocks for part in detector_inputs(scene, *block))
    return target_statistics(scene.detector, ((part.frames, part.targets) for part in parts))


def detected_block(
    scene: Scene, truth: Truth, first: int, stop: int, detections_of: Callable[[CameraFrames, Targets], Detections]
) -> Block:
    """Truth and detections of steps first to stop − 1; `detections_of` gives the detections of one camera."""
    parts = tuple(
        CameraBlock(
            camera=index,
            steps=part.frames.steps,
            sea_half_planes=part.frames.sea_half_planes,
            truth=part.truth,
            target_rows=part.rows,
            detections=detections_of(part.frames, part.targets),
        )
        for index, part in enumerate(detector_inputs(scene, truth, first, stop))
    )
    return Block(first, scene.timestamps(first, stop), parts)


def _checked_truth(scene: Scene, first: int, stop: int, renderer: IdRenderer | None) -> Truth:
    """The truth of a block, of whose frames the first and then one in a thousand were checked."""
    truth = truth_block(scene, first, stop, renderer)
    check_block(scene, truth, first, stop, renderer, streamed=True)
    return truth


class Simulation:
    """A scene with its detector, which turns the truth of a block into truth and detections."""

    def __init__(self, scene: Scene, statistics: TargetStatistics) -> None:
        """Set up the detector from its seed; `scene_statistics` gives the statistics."""
        self.scene = scene
        self._detector = Detector(scene.detector, scene.detector_seed, statistics, scene.times_s)

    def detect(self, truth: Truth, first: int, stop: int) -> Block:
        """Run the detector over the truth of steps first to stop − 1; a real one's detections are given with it."""
        labels = self.scene.labels
        given = None if labels is None or labels.detections is None else partial(given_detections, labels)
        return detected_block(self.scene, truth, first, stop, given or self._detector.detect)


def block_steps(scene: Scene) -> int:
    """Number of steps of a scene in a block; no result depends on it."""
    seen = len(scene.vessels) if scene.labels is None else -(-len(scene.labels.boxes) // scene.steps)
    return max(1, min(MAX_BLOCK_STEPS, BLOCK_VESSELS // max(seen, 1)))


def block_ranges(steps: int, block_steps: int) -> list[Range]:
    """The blocks of a run."""
    return [(first, min(first + block_steps, steps)) for first in range(0, steps, block_steps)]


def step_ranges(scene: Scene, most_steps: int | None = None) -> Iterator[Range]:
    """The blocks of a scene, of `block_steps(scene)` steps or of `most_steps` at most; in a live scene one for each
    step, which is waited for when its block is asked for. Raises InputError if the poses that came are wrong, or a
    camera has no place at the step."""
    poses = scene.poses
    if not isinstance(poses, LivePoses):
        yield from block_ranges(scene.steps, most_steps or block_steps(scene))
        return
    for step in range(scene.steps):
        if not poses.wait(step):
            if step == 0:
                raise InputError(poses.source, ["ended before the first time step"])
            return
        if problems := place_problems(scene, np.arange(step, step + 1)):
            raise InputError(scene.title, [line for lines in problems.values() for line in lines])
        yield step, step + 1


def check_scene(scene: object) -> None:
    """Raise TypeError for what is no scene, such as the path of one."""
    if not isinstance(scene, Scene):
        raise TypeError(f"scene: a Scene is needed, from modsim3d.load_scene (got {type(scene).__name__})")


def simulate_frames(scene: Scene) -> Iterator[Frame]:
    """Simulate a scene in memory: the frames of all cameras, in order of step and camera.

        for frame in modsim3d.simulate_frames(modsim3d.load_scene("strait", steps=2)):
            frame.truth.boxes_px, frame.detections.boxes_px

    A live scene gives the frames of a step before it waits for the next step.

    Raises:
        ModsimError: The scene asks for what cannot be, at the first frame or while frames are made.
        TypeError: The scene is none.
    """
    check_scene(scene)
    return (frame for block in simulate_blocks(scene) for frame in frames_of(block, scene))


def simulate_blocks(scene: Scene, most_steps: int | None = None) -> Iterator[Block]:
    """Simulate a scene in memory, block by block; a live scene gives a step's block before it waits for the next step.
    No result depends on `most_steps`, the most steps of a block, which is for whoever cannot wait for a whole one.
    Raises ModsimError if the scene asks for what cannot be, at the first block or while blocks are made."""
    with open_renderer(scene) as renderer:
        if renderer is not None and (most_steps is not None or isinstance(scene.poses, LivePoses)):
            renderer.prepare()  # who waits for single steps would wait for this at one of them
        blocks: Iterable[tuple[Truth, int, int]]
        blocks = ((_checked_truth(scene, *steps, renderer), *steps) for steps in step_ranges(scene, most_steps))
        if scene.detector.needs_target_statistics:
            blocks = list(blocks)
        simulation = Simulation(scene, scene_statistics(scene, blocks))
        for block in blocks:
            yield simulation.detect(*block)


def labelled_truth(labels: LabelledPoses, first: int, stop: int) -> Truth:
    """Truth of all cameras at steps first to stop − 1: the pixels of a vessel are those of its box, of which a share is
    visible. Who hides it is not known."""
    boxes = labels.boxes.take(slice(*np.searchsorted(labels.boxes.step, (first, stop))))
    rows, box_px = len(boxes), areas(boxes.boxes_px)
    return replace(
        no_truth(),
        step=boxes.step,
        camera=boxes.camera,
        vessel=boxes.vessel,
        full_boxes_px=boxes.boxes_px,
        visible_boxes_px=np.full((rows, 4), np.nan),
        silhouette_px=box_px,
        visible_px=box_px * boxes.visible_fraction,
        visible_fraction=boxes.visible_fraction,
        in_frame_fraction=boxes.in_frame_fraction,
        depth_m=boxes.depth_m,
        occluder_offsets=np.zeros(rows + 1, dtype=np.int64),
        annotated=np.ones(rows, dtype=bool),
        drawn=np.zeros(rows, dtype=bool),
    )


def given_detections(labels: LabelledPoses, frames: CameraFrames, targets: Targets) -> Detections:
    """Detections of a real detector in a camera's frames. Those that detect nothing are false; those of a box that is
    not annotated, since nothing of it is visible or it is too small, are neither right nor false and left out."""
    given, boxes = labels.detections, labels.boxes
    camera = [sequence.name for sequence in labels.sequences].index(frames.camera)
    if given is None:
        raise ModsimError("the labels have no detections")
    detections = given.take(np.isin(given.step, frames.steps) & (given.camera == camera))
    vessels, last = len(targets.vessel_ids), np.append(boxes.vessel, NOBODY)
    key = np.searchsorted(frames.steps, detections.step) * vessels + last[detections.row]
    target = positions(targets.frame * vessels + targets.vessel, np.where(detections.row >= 0, key, NOBODY))
    counts = (detections.row < 0) | (target >= 0)
    detections, target = detections.take(counts), target[counts]
    own = target >= 0
    errors_px = np.full((len(detections), 4), np.nan)
    errors_px[own] = errors_between(detections.boxes_px[own], targets.boxes_px[target[own]])
    return Detections(
        states=np.zeros(len(frames), dtype=np.int64),
        frame=np.searchsorted(frames.steps, detections.step),
        target=target,
        partner=np.full(len(detections), NOBODY),
        kind=np.where(own, TRUE, FALSE_POSITIVE),
        label=detections.label,
        confidence=detections.confidence,
        boxes_px=detections.boxes_px,
        errors_px=errors_px,
        redrawn=np.zeros(len(detections), dtype=bool),
        gated=np.zeros(len(targets), dtype=bool),
    )
