"""The cross-check of a run's truth: which frames are drawn, and what is said if they differ."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from modsim3d.arrays import Indices, Mask
from modsim3d.errors import ModsimError
from modsim3d.random_streams import Purpose, Streams
from modsim3d.scene.scene import Scene
from modsim3d.truth.crosscheck.comparison import Checked, Difference, SaidOfFrame, check_frame
from modsim3d.truth.crosscheck.visible_areas import visible_areas
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.pixel_spans import Spans
from modsim3d.truth.truth_record import Truth

if TYPE_CHECKING:
    from modsim3d.render.id_pass import IdRenderer

MIN_FRAMES = 3
STREAM_STEPS = 1000
"""A stream's first frames are checked, and then one step in so many."""
PIXELS_A_UNIT, VESSELS_A_UNIT = 8_000_000, 10
"""An image with so many pixels, and a scene with so many vessels, double the effort of a frame that is checked."""
MOST_DRAWS = 3
"""How often a frame is drawn, until one has a vessel."""
BATCH_FRAMES = 16
"""Frames that are checked together; it bounds the memory where all are."""

FrameKey = tuple[int, int]
"""A step, and the index of a camera that takes a frame then."""


class TruthCheckError(ModsimError):
    """The truth is not what OpenGL draws: an error in modsim3d, or in the OpenGL library.

    Attributes:
        masks: The pixels of the vessel in the truth, and as they were drawn, both (h, w).
    """

    def __init__(self, message: str, masks: tuple[Mask, Mask]) -> None:
        """Take the message, and what its picture shows."""
        super().__init__(message)
        self.masks = masks

    def __reduce__(self) -> tuple[type[TruthCheckError], tuple[str, tuple[Mask, Mask]]]:
        """Arguments to rebuild it from in another process."""
        return TruthCheckError, (str(self), self.masks)


def check_block(
    scene: Scene, truth: Truth, first: int, stop: int, renderer: IdRenderer | None, *, streamed: bool = False
) -> Checked:
    """Check the truth of steps first to stop − 1; without a renderer nothing was drawn, and nothing is checked.

    Args:
        scene: The scene.
        truth: Its truth at these steps.
        first: First step.
        stop: The step after the last.
        renderer: From `open_renderer`.
        streamed: Check the first frames and then one step in a thousand, as where the number of steps is not known.

    Raises:
        TruthCheckError: It is not what OpenGL draws.
    """
    if renderer is None:
        return Checked()
    drawn = int(truth.drawn.sum())
    checked = Checked(from_spans=len(truth) - drawn, from_buffers=drawn)
    chosen = sorted(_frames_to_check(scene, first, stop, streamed or scene.live))
    for camera in range(len(scene.cameras)):
        steps = np.array([step for step, index in chosen if index == camera], dtype=np.int64)
        for some in np.array_split(steps, -(-len(steps) // BATCH_FRAMES)) if len(steps) else []:
            checked += _check_frames(scene, truth, camera, some, renderer)
    return checked


def _frames_to_check(scene: Scene, first: int, stop: int, streamed: bool) -> Iterator[FrameKey]:
    """Frames of steps first to stop − 1 that are checked.

    They follow from the seed, the scene and its number of steps: not from time, nor from how a run is split.
    """
    check = scene.annotation.check
    if check == "all":
        for index, camera in enumerate(scene.cameras):
            yield from ((step, index) for step in scene.frame_steps(camera, first, stop).tolist())
    elif check == "sample":
        drawn = _frames_of_stream(scene, first, stop) if streamed else _sample(scene, first, stop)
        yield from ((step, index) for step, index in drawn if first <= step < stop)


def _sample(scene: Scene, first: int, stop: int) -> set[FrameKey]:
    """Of each of equally long parts of the run one frame; those of steps first to stop − 1 are among them."""
    count = frame_count(scene)
    parts = ((part, part * scene.steps // count, (part + 1) * scene.steps // count) for part in range(count))
    drawn = (_frame_of_part(scene, *each) for each in parts if each[1] < stop and first < each[2])
    return {frame for frame in drawn if frame is not None}


@lru_cache(maxsize=8)
def _frame_of_part(scene: Scene, part: int, first: int, stop: int) -> FrameKey | None:
    """A frame of steps first to stop − 1, drawn anew a few times if no vessel is in it; None if none was taken."""
    draw = _streams(scene).generator(Purpose.CHECK, step=part)
    frame = None
    for _ in range(MOST_DRAWS):
        index = int(draw.integers(len(scene.cameras)))
        step = scene.last_frame(scene.cameras[index], int(draw.integers(first, stop)) + 1)
        if step is not None and step >= first:
            frame = step, index
            if _has_a_vessel(scene, step, index):
                break
    return frame


def _streams(scene: Scene) -> Streams:
    """Random numbers of a truth: if no seed changes it, none changes which frames are checked."""
    return Streams(scene.seed if scene.truth_has_seed else 0)


def _has_a_vessel(scene: Scene, step: int, index: int) -> bool:
    """Whether the middle of a vessel's bottom is in the image."""
    camera = scene.cameras[index]
    sight = scene.sight(camera, np.array([step]))
    pixels = camera.intrinsics.project(sight.camera_poses.to_camera(sight.poses.positions_m))[0, sight.others[0]]
    return bool(((pixels >= 0) & (pixels <= camera.intrinsics.image_size_px)).all(axis=1).any())


def frame_count(scene: Scene) -> int:
    """How many frames a sample has: three at least, and more of long runs, small images and few vessels."""
    frames = scene.steps * len(scene.cameras)
    sizes = [math.prod(camera.intrinsics.image_size_px) for camera in scene.cameras]
    pixels = max(sizes) * scene.annotation.supersample**2
    effort = 4 * (1 + pixels / PIXELS_A_UNIT + len(scene.vessels) / VESSELS_A_UNIT)
    return min(max(MIN_FRAMES, round(math.sqrt(frames) / effort)), scene.steps)


def _frames_of_stream(scene: Scene, first: int, stop: int) -> set[FrameKey]:
    """The frames of steps first to stop − 1 that a stream checks."""
    parts = range(first // STREAM_STEPS, (stop - 1) // STREAM_STEPS + 1)
    drawn = ((step, index) for part in parts for step, index in stream_part(scene, part).items())
    return {(step, i) for step, i in drawn if len(scene.frame_steps(scene.cameras[i], step, step + 1))}


@lru_cache(maxsize=2)
def stream_part(scene: Scene, part: int) -> dict[int, int]:
    """The steps that a stream checks among a thousand, and a camera for each: one step, and the first of all."""
    draw = _streams(scene).generator(Purpose.CHECK, step=part)
    step, camera = part * STREAM_STEPS + int(draw.integers(STREAM_STEPS)), int(draw.integers(len(scene.cameras)))
    first = {step: step % len(scene.cameras) for step in range(0 if part else MIN_FRAMES)}
    return {step: camera} | first


def _check_frames(scene: Scene, truth: Truth, camera: int, steps: Indices, renderer: IdRenderer) -> Checked:
    """Check frames of a camera at ascending steps; of the scene's first frame, the whole image."""
    from modsim3d.truth.rendered import rendered_spans

    sight, supersample = scene.sight(scene.cameras[camera], steps), scene.annotation.supersample
    outlines, lens = sight.outlines(), sight.camera.intrinsics
    spans = rendered_spans(outlines, lens, renderer, supersample, full=scene.annotation.render == "full")
    areas, bounds = visible_areas(outlines, lens, supersample)
    checked, seen = Checked(), truth.of_camera(camera)
    for frame, step in enumerate(steps.tolist()):
        rows = np.flatnonzero((outlines.frame == frame) & outlines.boxed & ~np.isnan(areas))
        said = SaidOfFrame(
            seen.take(slice(*np.searchsorted(seen.step, (step, step + 1)).tolist())),
            _of_frame(spans[0], outlines, frame),
            _of_frame(spans[1], outlines, frame),
            {int(outlines.occluder[row]): (float(areas[row]), float(bounds[row])) for row in rows.tolist()},
            scene.annotation,
        )
        boxed, whole = set(np.flatnonzero(sight.others[frame]).tolist()), step == _whole_step(scene)
        try:
            drawing = sight.drawing(frame, supersample)
            checked += check_frame(drawing, renderer, said, boxed, scene.occluder_names, whole=whole)
        except Difference as difference:
            raise TruthCheckError(_in_words(scene, camera, step, difference), difference.masks) from None
    return checked


def _of_frame(spans: Spans, outlines: Outlines, frame: int) -> Spans:
    """The spans of a frame, by index of the vessel in place of the row of the outlines."""
    chosen = spans.take(outlines.frame[spans.row] == frame)
    return replace(chosen, row=outlines.occluder[chosen.row])


def _whole_step(scene: Scene) -> int:
    """The step of the frame that is drawn whole: the first that is checked."""
    return min(_sample(scene, 0, 1), default=(0, 0))[0] if scene.annotation.check == "sample" and not scene.live else 0


def _in_words(scene: Scene, camera: int, step: int, difference: Difference) -> str:
    name, vessel = scene.cameras[camera].name, scene.vessel_names[difference.vessel]
    time_s = scene.timestamps(step, step + 1)[0]
    return (
        "cross-check: the truth is not what OpenGL draws, which is an error in modsim3d or in OpenGL: "
        f"vessel '{vessel}' in camera {name} at step {step} (time {time_s} s): {difference.what}: "
        f"{difference.truth} in the truth, {difference.drawn} drawn. To see what is drawn:\n"
        f"  modsim3d run {scene.path} --seed {scene.seed} --steps {step + 1} --set annotation.check=off "
        "--out unchecked\n"
        f"  modsim3d view unchecked --ids --frame {step} --camera {name}"
    )
