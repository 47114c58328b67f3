"""The pipeline: scene in, frames out."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from modsim3d.annotate.analytic import analytic_occlusion
from modsim3d.annotate.modes import Annotation, annotated_rows, annotation_boxes
from modsim3d.annotate.outlines import Outlines
from modsim3d.annotate.record import Occlusion, Truth, concatenate, no_truth
from modsim3d.annotate.rectangles import rectangle_occlusion
from modsim3d.arrays import Indices
from modsim3d.block import Block, CameraBlock, Frame, frames_of
from modsim3d.camera import Camera, Intrinsics
from modsim3d.detector.chain import Detector, reference_of
from modsim3d.detector.records import CameraFrames, Targets
from modsim3d.detector.reference import Reference
from modsim3d.errors import InputError, ModsimError
from modsim3d.poses import LivePoses
from modsim3d.scene import Scene
from modsim3d.scene_places import place_problems

if TYPE_CHECKING:
    from modsim3d.render.id_pass import IdRenderer

BLOCK_VESSELS, MOST_BLOCK_STEPS = 8_000, 250
"""Vessels times steps that are looked at together, and most steps: few calls for many, but arrays that fit a cache."""


@contextmanager
def open_renderer(scene: Scene) -> Iterator[IdRenderer | None]:
    """The ID renderer that a scene's truth needs; None if its source needs none.

    Raises:
        RendererError: There is no OpenGL library.
    """
    if scene.annotation.source != "rendered":
        yield None
        return
    from modsim3d.render.context import open_context  # no OpenGL where none is needed
    from modsim3d.render.id_pass import IdRenderer

    with open_context() as context:
        yield IdRenderer(context)


def truth_block(scene: Scene, first: int, stop: int, renderer: IdRenderer | None) -> Truth:
    """What all cameras see in the frames that they take at steps first to stop − 1.

    Args:
        scene: The scene.
        first: First step.
        stop: The step after the last.
        renderer: For the rendered source.

    Raises:
        ModsimError: The vessel that carries a camera is missing.
    """
    taken = [(index, camera, scene.frame_steps(camera, first, stop)) for index, camera in enumerate(scene.cameras)]
    seen = [_camera_truth(scene, index, camera, steps, renderer) for index, camera, steps in taken if len(steps)]
    return concatenate(seen) if seen else no_truth()


def _camera_truth(scene: Scene, index: int, camera: Camera, steps: Indices, renderer: IdRenderer | None) -> Truth:
    sight = scene.sight(camera, steps)
    outlines = sight.outlines(camera.intrinsics, scene.vessels, as_shoeboxes=scene.annotation.source != "rendered")
    occlusion = occlusion_by(outlines, camera.intrinsics, scene.annotation, renderer)
    truth = occlusion.truth(steps[outlines.frame], index, outlines.vessel, outlines.in_frame_fraction, outlines.depth_m)
    truth = truth.take(outlines.boxed)
    return truth.with_annotated(annotated_rows(truth, scene.annotation))


def occlusion_by(
    outlines: Outlines, intrinsics: Intrinsics, annotation: Annotation, renderer: IdRenderer | None
) -> Occlusion:
    """What the source that the annotation names says is seen.

    Args:
        outlines: The vessels in front of the camera.
        intrinsics: Of the camera.
        annotation: Names the source.
        renderer: For the rendered source.
    """
    if annotation.source == "analytic":
        return analytic_occlusion(outlines, intrinsics)
    if annotation.source == "rectangles":
        return rectangle_occlusion(outlines)
    if renderer is None:
        raise ModsimError("the rendered source needs a renderer: use open_renderer(scene)")
    from modsim3d.annotate.full_frame import full_frame_occlusion
    from modsim3d.annotate.rendered import rendered_occlusion

    draw = full_frame_occlusion if annotation.render == "full" else rendered_occlusion
    return draw(outlines, intrinsics, renderer, annotation.supersample)


@dataclass(frozen=True, eq=False)
class DetectorInput:
    """What a camera's detector is given for a block.

    Attributes:
        truth: The camera's rows.
        rows: Those of them that are annotated, shape (n,).
        frames: Those that the camera takes.
        targets: The annotated vessels.
    """

    truth: Truth
    rows: Indices
    frames: CameraFrames
    targets: Targets


def detector_inputs(scene: Scene, truth: Truth, first: int, stop: int) -> Iterator[DetectorInput]:
    """What the truth of steps first to stop − 1 gives each camera's detector, in the order of the cameras."""
    index = {label: i for i, label in enumerate(scene.detector.labels)}
    labels = np.array([index[vessel.label] for vessel in scene.vessels])
    times_s = scene.times_s(first, stop)
    for number, camera in enumerate(scene.cameras):
        seen = truth.take(truth.camera == number)
        rows = np.flatnonzero(seen.annotated)
        steps, before = scene.frame_steps(camera, first, stop), scene.last_frame(camera, first)
        frames = CameraFrames(
            camera=camera.name,
            steps=steps,
            times_s=times_s[steps - first],
            image_size_px=camera.intrinsics.image_size_px,
            sea_half_planes=scene.sea_half_planes(camera, steps),
            previous_s=-math.inf if before is None else float(scene.times_s(before, before + 1)[0]),
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


def survey(scene: Scene, truth: Truth, first: int, stop: int) -> Reference:
    """What a detector that `needs_reference` must know of a block; blocks add up."""
    parts = detector_inputs(scene, truth, first, stop)
    return sum((reference_of(scene.detector, part.frames, part.targets) for part in parts), Reference())


class Simulation:
    """A scene with its detector: blocks of truth in, blocks of truth and detections out."""

    def __init__(self, scene: Scene, reference: Reference | None = None) -> None:
        """Set the detector up from its seed.

        Args:
            scene: The scene.
            reference: Its targets, from `survey`, if its detector needs to know them.
        """
        self.scene = scene
        self._detector = Detector(scene.detector, scene.detector_seed, scene.times_s, reference)

    def detect(self, truth: Truth, first: int, stop: int) -> Block:
        """Run the detector over the truth of steps first to stop − 1."""
        parts = tuple(
            CameraBlock(
                index,
                part.frames.steps,
                part.truth,
                part.rows,
                self._detector.detect(part.frames, part.targets),
            )
            for index, part in enumerate(detector_inputs(self.scene, truth, first, stop))
        )
        return Block(first, self.scene.timestamps(first, stop), parts)


def block_steps(scene: Scene) -> int:
    """How many steps of a scene are looked at together; no result depends on it."""
    return max(1, min(MOST_BLOCK_STEPS, BLOCK_VESSELS // len(scene.vessels)))


def block_ranges(steps: int, block_steps: int) -> list[tuple[int, int]]:
    """First step and the step after the last of each block of a run."""
    return [(first, min(first + block_steps, steps)) for first in range(0, steps, block_steps)]


def step_ranges(scene: Scene) -> Iterator[tuple[int, int]]:
    """First step and the step after the last of each block of a scene.

    A live scene gives a block of one step when that step has come, and waits for the next only when it is asked for it.

    Raises:
        InputError: What came is wrong, or a camera has no place at the step.
    """
    poses = scene.poses
    if not isinstance(poses, LivePoses):
        yield from block_ranges(scene.steps, block_steps(scene))
        return
    for step in range(scene.steps):
        if not poses.wait(step):
            if step == 0:
                raise InputError(poses.source, ["ended before the first time step"])
            return
        if problems := place_problems(scene, np.arange(step, step + 1)):
            raise InputError(f"scene {scene.path}", [line for lines in problems.values() for line in lines])
        yield step, step + 1


def simulate_frames(scene: Scene) -> Iterator[Frame]:
    """Run a scene in memory, frame by frame, without writing anything.

    Args:
        scene: From `load_scene`.

    Yields:
        Each camera's frame at each step at which it takes one; of a live scene before the next step is waited for.
    """
    with open_renderer(scene) as renderer:
        truths: Iterable[tuple[Truth, int, int]]
        truths = ((truth_block(scene, *steps, renderer), *steps) for steps in step_ranges(scene))
        reference = None
        if scene.detector.needs_reference:
            truths = list(truths)
            reference = sum((survey(scene, *block) for block in truths), Reference())
        simulation = Simulation(scene, reference)
        for block in truths:
            yield from frames_of(simulation.detect(*block), scene)
