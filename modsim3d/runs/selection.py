"""The steps and cameras of a stored run that a user chose, and what the cameras show at them."""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.errors import ModsimError
from modsim3d.runs.frames import Frame
from modsim3d.runs.stored_run import StoredRun

NEAR_S = 1e-6  # times nearer than this are the same


@dataclass(frozen=True, eq=False)
class StepFrames:
    """Frames of cameras at a step: `frames` has the last frame that each camera took, None before its first."""

    step: int
    timestamp: str
    frames: tuple[Frame | None, ...]


@dataclass(frozen=True, eq=False)
class Selection:
    """Frames of a stored run."""

    run: StoredRun
    cameras: tuple[int, ...]  # indices into the scene's cameras
    steps: tuple[int, ...]  # n, ascending
    durations_s: Array  # from each step to the next, (n,)

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names of the cameras."""
        return tuple(self.run.scene.cameras[index].name for index in self.cameras)

    def step_frames(self) -> Iterator[StepFrames]:
        """Frames of the cameras at each step."""
        scene, names = self.run.scene, self.camera_names
        first, stop = self.steps[0], self.steps[-1] + 1
        last = {name: self._frame_before(index, first) for name, index in zip(names, self.cameras, strict=True)}
        coming = self.run.frames(first, stop)
        frame = next(coming, None)
        for step in self.steps:
            while frame is not None and frame.step <= step:
                last[frame.camera] = frame
                frame = next(coming, None)
            yield StepFrames(step, scene.timestamps(step, step + 1)[0], tuple(last[name] for name in names))

    def _frame_before(self, camera: int, step: int) -> Frame | None:
        """The last frame that a camera took before a step; None if there is none, or if it takes one at that step."""
        scene = self.run.scene
        taken = scene.last_frame(scene.cameras[camera], step + 1)
        if taken is None or taken == step:
            return None
        return self.run.frame(scene.cameras[camera].name, taken)


def select_cameras(run: StoredRun, names: str | Sequence[str] | None) -> tuple[int, ...]:
    """Indices of the cameras with these names, of all if there is none. Raises ModsimError for an unknown name."""
    names = [names] if isinstance(names, str) else names or ()
    cameras = [camera.name for camera in run.scene.cameras]
    unknown = [name for name in names if name not in cameras]
    if unknown:
        raise ModsimError(f"{run.folder} has no camera '{', '.join(unknown)}'; it has: {', '.join(cameras)}")
    return tuple(cameras.index(name) for name in dict.fromkeys(names)) or tuple(range(len(cameras)))


def check_every(every: object) -> None:
    """Raise ModsimError for what is no number of steps, to take every so many-th."""
    if not isinstance(every, int) or every < 1:
        raise ModsimError(f"--every: needs a whole number from 1 (got {every!r:.60})")


def select(
    run: StoredRun,
    cameras: tuple[int, ...],
    *,
    from_s: float | None = None,
    to_s: float | None = None,
    every: int = 1,
    only_with_vessels: bool = False,
) -> Selection:
    """Select every `every`-th of the steps of a run from `from_s` to `to_s` in seconds, as in the run's timestamps; by
    default the times of the first and last step. `only_with_vessels` leaves out steps at which no camera has a vessel
    in its image. `cameras` are indices into the scene's cameras. Raises ModsimError if no step is left."""
    check_every(every)
    times = times_of(run)
    start_s, end_s = (-math.inf if from_s is None else from_s), (math.inf if to_s is None else to_s)
    steps = np.flatnonzero((times >= start_s - NEAR_S) & (times <= end_s + NEAR_S))[::every]
    if not len(steps):
        raise ModsimError(f"no frames between {start_s:g} s and {end_s:g} s: {span(run)}")
    durations = _durations(times, steps, every)
    selection = Selection(run, cameras, tuple(steps.tolist()), durations)
    if not only_with_vessels:
        return selection
    with_vessels = np.array([any(frame and len(frame.truth) for frame in at.frames) for at in selection.step_frames()])
    if not with_vessels.any():
        names = ", ".join(selection.camera_names)
        raise ModsimError(f"no vessel is in an image of {names} in {len(steps)} frames; {span(run)}")
    return replace(selection, steps=tuple(steps[with_vessels].tolist()), durations_s=durations[with_vessels])


def find_step(run: StoredRun, text: str) -> int:
    """A step by its number, `255`, or by its time, `51.0` or `51s`. Raises ModsimError if there is no such step."""
    if re.fullmatch(r"\d+", text):
        step = int(text)
        if step >= run.steps:
            raise ModsimError(f"no step {step}: {span(run)}")
        return step
    try:
        time = float(text.removesuffix("s"))
    except ValueError:
        raise ModsimError(f"'{text}' is neither a step (255) nor a time in seconds (51.0 or 51s)") from None
    times = times_of(run)
    nearest = int(np.argmin(np.abs(times - time)))
    if not abs(times[nearest] - time) <= NEAR_S:
        raise ModsimError(f"no frame at {text}; the nearest is step {nearest} at {times[nearest]:g} s; {span(run)}")
    return nearest


def times_of(run: StoredRun) -> Array:
    """The times of the steps that are there in seconds, as in the run's timestamps, shape (steps,). Raises ModsimError
    if no step is there."""
    run.check_has_steps()
    return np.array([float(text) for text in run.scene.timestamps(0, run.steps)])


def span(run: StoredRun) -> str:
    """The steps and times that a run has, in words."""
    first, last = run.scene.timestamps(0, 1)[0], run.scene.timestamps(run.steps - 1, run.steps)[0]
    extent = f"steps 0 to {run.steps - 1}, {first} s to {last} s"
    if run.finished:
        return f"the run has {extent}"
    return f"the run was interrupted; of {run.scene.steps} steps there are {extent}"


def _durations(times: Array, steps: Indices, every: int) -> Array:
    """Seconds from each chosen step to the next, the last lasting as long as the one before, shape (n,)."""
    gaps = np.diff(times[steps])
    if len(gaps):
        return np.append(gaps, gaps[-1])
    return np.diff(times[:2]) * every if len(times) > 1 else np.ones(1)
