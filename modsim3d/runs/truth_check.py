"""The cross-check of a run's truth: which frames are drawn, and what is said if they differ."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from shlex import quote
from typing import TYPE_CHECKING

import numpy as np

from modsim3d.core.arrays import Indices, Mask
from modsim3d.core.errors import ModsimError
from modsim3d.core.random_streams import Purpose, Streams
from modsim3d.scene.parts import NO_FILE
from modsim3d.scene.scene import Scene
from modsim3d.truth.analytic import visible_areas
from modsim3d.truth.crosscheck.comparison import CheckCounts, Difference, FrameValues, check_frame
from modsim3d.truth.record import Truth

if TYPE_CHECKING:
    from modsim3d.render.id_pass import IdRenderer

MIN_FRAMES = 3
STREAM_STEPS = 1000  # a stream's first frames are checked, and then one in so many steps
PIXELS_A_UNIT, VESSELS_A_UNIT = 8_000_000, 10
"""An image with so many pixels, and a scene with so many vessels, double the effort of a frame that is checked."""
MAX_DRAWS = 3  # how often a frame is drawn, until one has a vessel
BATCH_FRAMES = 16  # frames that are checked together; it bounds the memory where all are

FrameKey = tuple[int, int]  # a step, and the index of a camera that takes a frame then


class TruthCheckError(ModsimError):
    """Truth that is not what OpenGL draws: an error in modsim3d, or in the OpenGL library. `masks` are the pixels of
    the vessel in the truth, and as they were drawn, both (h, w)."""

    def __init__(self, message: str, masks: tuple[Mask, Mask]) -> None:
        """Take the message, and what its picture shows."""
        super().__init__(message)
        self.masks = masks

    def __reduce__(self) -> tuple[type[TruthCheckError], tuple[str, tuple[Mask, Mask]]]:
        """Arguments to rebuild it from in another process."""
        return TruthCheckError, (str(self), self.masks)


def check_block(
    scene: Scene, truth: Truth, first: int, stop: int, renderer: IdRenderer | None, *, streamed: bool = False
) -> CheckCounts:
    """Check the truth of steps first to stop − 1; without a renderer nothing was drawn, and nothing is checked.
    `streamed` checks the first frames and then one step in a thousand, as where the number of steps is not known.
    Raises TruthCheckError if the truth is not what OpenGL draws."""
    if renderer is None:
        return CheckCounts()
    drawn = int(truth.drawn.sum())
    checked = CheckCounts(from_spans=len(truth) - drawn, from_buffers=drawn)
    chosen = sorted(set(_frames_to_check(scene, first, stop, streamed or scene.live)))
    whole = _first_checked(scene, chosen[0], streamed or scene.live) if chosen else None
    for camera in range(len(scene.cameras)):
        steps = np.array([step for step, index in chosen if index == camera], dtype=np.int64)
        for some in np.array_split(steps, -(-len(steps) // BATCH_FRAMES)) if len(steps) else []:
            checked += _check_frames(scene, truth, camera, some, renderer, whole)
    return checked


def _frames_to_check(scene: Scene, first: int, stop: int, streamed: bool) -> Iterator[FrameKey]:
    """Frames of steps first to stop − 1 that are checked. They follow from the seed, the scene and its number of steps:
    not from time, nor from how a run is split."""
    check = scene.annotation.check
    if check == "all":
        for index, camera in enumerate(scene.cameras):
            yield from ((step, index) for step in scene.frame_steps(camera, first, stop).tolist())
    elif check == "sample":
        yield from _frames_of_stream(scene, first, stop) if streamed else _sample(scene, first, stop)


def _first_checked(scene: Scene, frame: FrameKey, streamed: bool) -> FrameKey | None:
    """The first frame of a block that is checked, if it is the first of the run; it is drawn whole."""
    if scene.annotation.check == "sample" and not streamed:
        return min(_sample(scene, 0, frame[0] + 1))
    return None if _steps_before(scene, frame[0]) else frame


def _sample(scene: Scene, first: int, stop: int) -> set[FrameKey]:
    """Frame of each of equally long parts of the run, or all of a short run: those at steps first to stop − 1."""
    steps, _ = frames_taken(scene)
    if len(steps) < MIN_FRAMES:
        drawn = _frames_of_few(scene)
    else:
        parts = enumerate(np.array_split(steps, _bounds(scene)[1:-1]))
        drawn = [_frame_of_part(scene, i) for i, part in parts if part[0] < stop and first <= part[-1]]
    return {(step, index) for step, index in drawn if first <= step < stop}


@lru_cache(maxsize=8)
def frames_taken(scene: Scene) -> tuple[Indices, int]:
    """The steps at which any camera takes a frame, ascending, shape (n,), and the number of frames of all cameras."""
    steps = [scene.frame_steps(camera, 0, scene.steps) for camera in scene.cameras]
    return np.unique(np.concatenate(steps)), sum(map(len, steps))


def _bounds(scene: Scene) -> Indices:
    """Beginnings of the parts of a run among the steps with frames, and the end of the last one."""
    count = frame_count(scene)
    return np.arange(count + 1) * len(frames_taken(scene)[0]) // count


@lru_cache(maxsize=8)
def _frame_of_part(scene: Scene, part: int) -> FrameKey:
    """A frame of a part of the run, drawn anew a few times if no vessel is in it."""
    draw, ends = _streams(scene).generator(Purpose.CHECK, step=part), _bounds(scene)
    first, last = frames_taken(scene)[0][[ends[part], ends[part + 1] - 1]].tolist()
    steps = [scene.frame_steps(camera, first, last + 1) for camera in scene.cameras]
    taking = [index for index, own in enumerate(steps) if len(own)]
    for _ in range(MAX_DRAWS):
        index = taking[int(draw.integers(len(taking)))]
        step = int(steps[index][draw.integers(len(steps[index]))])
        if _has_a_vessel(scene, step, index):
            break
    return step, index


@lru_cache(maxsize=8)
def _frames_of_few(scene: Scene) -> list[FrameKey]:
    """Frames of a run with fewer steps with frames than `MIN_FRAMES`: those with a vessel first."""
    steps = [scene.frame_steps(camera, 0, scene.steps).tolist() for camera in scene.cameras]
    frames = [(step, index) for index, own in enumerate(steps) for step in own]
    mixed = _streams(scene).generator(Purpose.CHECK, step=0).permutation(len(frames)).tolist()
    return sorted((frames[i] for i in mixed), key=lambda frame: not _has_a_vessel(scene, *frame))[: frame_count(scene)]


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
    """Number of frames of a sample: three at least, and more of long runs, small images and few vessels."""
    steps, frames = frames_taken(scene)
    sizes = [math.prod(camera.intrinsics.image_size_px) for camera in scene.cameras]
    pixels = max(sizes) * scene.annotation.supersample**2
    effort = 4 * (1 + pixels / PIXELS_A_UNIT + len(scene.vessels) / VESSELS_A_UNIT)
    return min(max(MIN_FRAMES, round(math.sqrt(frames) / effort)), max(MIN_FRAMES, len(steps)), frames)


def _frames_of_stream(scene: Scene, first: int, stop: int) -> Iterator[FrameKey]:
    """The frames of steps first to stop − 1 that a stream checks, which follow from what came before them. They are one
    at each of the first steps with frames, and a camera's first frame at or after each step that is drawn."""
    if all(camera.frame_rate_hz is None and not camera.start_offset_s for camera in scene.cameras):
        for step in range(first, stop):  # at every step, as below, in fewer calls: a live step waits for them
            if step < MIN_FRAMES:
                yield step, step % len(scene.cameras)
            if (drawn := _step_of_stream(scene, step // STREAM_STEPS))[0] == step:
                yield drawn
        return
    taken = [set(scene.frame_steps(camera, first, stop).tolist()) for camera in scene.cameras]
    for step in sorted(set().union(*taken)):
        taking = [index for index, steps in enumerate(taken) if step in steps]
        if (count := _steps_before(scene, step)) < MIN_FRAMES:
            yield step, taking[count % len(taking)]
        for index in taking:
            before = scene.last_frame(scene.cameras[index], step)
            since = 0 if before is None else before + 1
            parts = range(since // STREAM_STEPS, step // STREAM_STEPS + 1)
            asked = (_step_of_stream(scene, part) for part in parts)
            if any(since <= check_step <= step and camera == index for check_step, camera in asked):
                yield step, index


def _steps_before(scene: Scene, step: int) -> int:
    """At how many steps before one any camera took a frame, counted up to `MIN_FRAMES`."""
    for count in range(MIN_FRAMES):
        before = [scene.last_frame(camera, step) for camera in scene.cameras]
        step = max((prior for prior in before if prior is not None), default=-1)
        if step < 0:
            return count
    return MIN_FRAMES


@lru_cache(maxsize=8)
def _step_of_stream(scene: Scene, part: int) -> FrameKey:
    """The step that is drawn among a thousand, and the camera whose next frame a stream checks."""
    draw = _streams(scene).generator(Purpose.CHECK, step=part)
    return part * STREAM_STEPS + int(draw.integers(STREAM_STEPS)), int(draw.integers(len(scene.cameras)))


def _check_frames(
    scene: Scene, truth: Truth, camera: int, steps: Indices, renderer: IdRenderer, whole: FrameKey | None
) -> CheckCounts:
    """Check frames of a camera at ascending steps; of the frame `whole`, the whole image."""
    from modsim3d.truth.rendered import rendered_spans, spans_of_frame

    sight, supersample = scene.sight(scene.cameras[camera], steps), scene.annotation.supersample
    outlines, lens = sight.outlines(), sight.camera.intrinsics
    spans = rendered_spans(outlines, lens, renderer, supersample, full=scene.annotation.render == "full")
    areas, bounds = visible_areas(outlines, lens, supersample)
    checked, seen = CheckCounts(), truth.of_camera(camera)
    for frame, step in enumerate(steps.tolist()):
        rows = np.flatnonzero((outlines.frame == frame) & outlines.boxed & ~np.isnan(areas))
        facts = FrameValues(
            seen.take(slice(*np.searchsorted(seen.step, (step, step + 1)).tolist())),
            spans_of_frame(spans[0], outlines, frame),
            spans_of_frame(spans[1], outlines, frame),
            {int(outlines.occluder[row]): (float(areas[row]), float(bounds[row])) for row in rows.tolist()},
            scene.annotation,
        )
        boxed = set(np.flatnonzero(sight.others[frame]).tolist())
        try:
            drawing = sight.drawing(frame, supersample)
            checked += check_frame(drawing, renderer, facts, boxed, scene.occluder_names, whole=(step, camera) == whole)
        except Difference as difference:
            raise TruthCheckError(_in_words(scene, camera, step, difference), difference.masks) from None
    return checked


def _in_words(scene: Scene, camera: int, step: int, difference: Difference) -> str:
    name, vessel = scene.cameras[camera].name, scene.vessel_names[difference.vessel]
    time_s = scene.timestamps(step, step + 1)[0]
    message = (
        "cross-check: the truth is not what OpenGL draws, which is an error in modsim3d or in OpenGL: "
        f"vessel '{vessel}' in camera {name} at step {step} (time {time_s} s): {difference.what}: "
        f"{difference.truth} in the truth, {difference.drawn} drawn"
    )
    if scene.path == NO_FILE:
        return message
    return (
        f"{message}. To see what is drawn:\n"
        f"  modsim3d run {quote(str(scene.path))} --seed {scene.seed} --steps {step + 1} --set annotation.check=off "
        f"--set annotation.supersample={scene.annotation.supersample} --out unchecked\n"
        f"  modsim3d view frame unchecked {step} --kind id_buffer --camera {quote(name)}"
    )
