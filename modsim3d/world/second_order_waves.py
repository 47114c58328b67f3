"""Slowly varying angles from a second-order process (Jessen & Mohr (2023), §7.4.3); no heave.
The angles are those of `camera_poses.attitude`, in camera-base axes: positive roll lowers the port side, positive pitch
lowers the bow, positive yaw turns to port."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.errors import InputError
from modsim3d.core.random_streams import Purpose, Streams, normals
from modsim3d.io.plugins import WAVE_LEVELS, Plugin, load_plugin
from modsim3d.world.floating_vessels import Motion, Passage

AXES = ("roll", "pitch", "yaw")
SMALL_SIGMA_RAD = (5e-5, 3e-5, 1.5e-5)  # noise of roll, pitch and yaw of the small wave impact (Table 9.8)
LEVELS = {"none": 0.0, "small": 1.0, "medium": 2.0, "large": 4.0, "huge": 8.0}
"""Factors of the small noise. The source has numbers for small and large only (Tables 9.8, 9.12)."""
BLOCK_STEPS = 4096


@dataclass(frozen=True)
class Axis:
    """One angle's process: x(t + 1) = a · x(t) + e, x'(t + 1) = b · x'(t) + x(t + 1) (eq. 7.23, 7.24).

    Attributes:
        a: Coefficient of the first-order process.
        b: Coefficient of the second-order process.
        sigma_rad: Standard deviation of e.
        start_rad: x(0) and x'(0).
    """

    a: float = 0.99
    b: float = 0.99
    sigma_rad: float = 0.0
    start_rad: tuple[float, float] = (0.0, 0.0)


def level_axes(level: str) -> tuple[Axis, Axis, Axis]:
    """Roll, pitch and yaw of a named wave level (§7.4.5)."""
    roll, pitch, yaw = (Axis(sigma_rad=LEVELS[level] * sigma) for sigma in SMALL_SIGMA_RAD)
    return roll, pitch, yaw


def second_order(noise: Array, axis: Axis, state: tuple[float, float]) -> tuple[Array, tuple[float, float]]:
    """Continue the process from a state, x and x' before the first step, with e of the next n steps in radians (n,).
    Returns x' after each step in radians (n,), and the last x and x'."""
    first = _continued(noise.tolist(), axis.a, state[0])
    second = _continued(first, axis.b, state[1])
    return np.array(second), (first[-1], second[-1])


def _continued(inputs: Sequence[float], coefficient: float, state: float) -> list[float]:
    """x(t + 1) = coefficient · x(t) + input; `scipy.signal.lfilter` gives the same, but its import takes 0.4 s."""
    return list(accumulate(inputs, lambda before, new: coefficient * before + new, initial=state))[1:]


@dataclass(eq=False)
class _Track:
    """Angles of a vessel at the process steps computed so far, shape (k, 3), and each axis's x and x' at the last."""

    angles: Array
    states: list[tuple[float, float]]


class SecondOrderWaves:
    """Independent second-order processes for roll, pitch and yaw of every vessel (eq. 7.26–7.31). They step every
    `interval_s` and are linear between; without an interval they use the scene's steps."""

    needs_velocity = False

    def __init__(self, axes: tuple[Axis, Axis, Axis], seed: int, interval_s: float | None = None) -> None:
        """Take the coefficients of the axes and the seed of the noise."""
        self._axes = axes
        self._interval_s = interval_s
        self._streams = Streams(seed)
        self._tracks: dict[str, _Track] = {}

    def motion(self, vessel: str, passage: Passage) -> Motion:
        """Roll, pitch and yaw of a vessel at any place; heave is zero."""
        return Motion(np.zeros(len(passage.steps)), self.angles(vessel, passage.times_s, passage.steps))

    def angles(self, vessel: str, times_s: Array, steps: Indices) -> Array:
        """Roll, pitch and yaw of a vessel, each with a process of its own, in radians: (n, 3), at times since the
        scene's first step and indices of steps, (n,) both."""
        if self._interval_s is None:
            return self._until(vessel, int(steps.max(initial=0)))[steps]
        position = times_s / self._interval_s
        # 0.3 / 0.1 is just below 3; rounding must not miss a step.
        nearest = np.rint(position)
        position = np.where(np.abs(position - nearest) < 1e-6, nearest, position)
        before = np.floor(position).astype(np.int64)
        track = self._until(vessel, int(before.max(initial=0)) + 1)
        share = (position - before)[:, None]
        return (1 - share) * track[before] + share * track[before + 1]

    def _until(self, vessel: str, last: int) -> Array:
        """Angles of a vessel at process steps 0 to at least `last`, shape (≥ last + 1, 3)."""
        if vessel not in self._tracks:
            states = [axis.start_rad for axis in self._axes]
            self._tracks[vessel] = _Track(np.array([[angle for _, angle in states]]), states)
        track = self._tracks[vessel]
        while len(track.angles) <= last:
            self._extend(vessel, track)
        return track.angles

    def _extend(self, vessel: str, track: _Track) -> None:
        done = len(track.angles) - 1
        uniforms = self._streams.uniforms(Purpose.WAVE_ANGLES, vessel, first=done, count=BLOCK_STEPS)
        noise = normals(uniforms)
        columns = []
        for i, axis in enumerate(self._axes):
            angles, track.states[i] = second_order(axis.sigma_rad * noise[:, i], axis, track.states[i])
            columns.append(angles)
        track.angles = np.concatenate([track.angles, np.stack(columns, axis=1)])


Axes = tuple[Axis, Axis, Axis]  # roll, pitch and yaw


def find_level(name: str) -> tuple[Axes, Plugin | None]:
    """The axes of a wave level, and the plug-in that it comes from; None if it is built in. A plug-in of the group
    `modsim3d.wave_levels` is a tuple of three `Axis`: roll, pitch and yaw. Raises InputError if there is no such level,
    or the plug-in is no three axes."""
    if name in LEVELS:
        return level_axes(name), None
    axes, plugin = load_plugin(WAVE_LEVELS, name, "waves.level", LEVELS)
    if isinstance(axes, tuple | list) and len(axes) == len(AXES) and all(isinstance(axis, Axis) for axis in axes):
        roll, pitch, yaw = axes
        return (roll, pitch, yaw), plugin
    problem = f"{plugin} must be three modsim3d.plugins.Axis, for {', '.join(AXES)}, not {axes!r}"
    raise InputError("waves.level", [problem])
