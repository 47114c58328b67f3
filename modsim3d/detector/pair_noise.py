"""A uniform number of two vessels: drawn for each step, or kept for a while.

As with the noise of one vessel, a number runs over all steps of the scene, whatever a camera saw, and a vanishing
correlation time gives the numbers that a detector without persistence would use.
"""

from __future__ import annotations

import itertools

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.detector.draws import step_uniforms
from modsim3d.detector.persistence import Clock, decay
from modsim3d.detector.records import CameraFrames, Targets
from modsim3d.random_streams import Purpose, Streams

_FIRST_LOOK, _FURTHER = 64, 4  # steps back for the last new number, and how much further where none is found


class PairNoise:
    """The numbers that decide whether two vessels come out as one box."""

    def __init__(self, correlation_s: float, streams: Streams, clock: Clock) -> None:
        """Keep numbers for a correlation time in seconds, 0 for none; the clock gives the times of steps."""
        self._correlation_s, self._streams, self._clock = correlation_s, streams, clock
        self._decays: list[float] = [0.0]  # nothing is kept from before the first step

    def uniforms(self, frames: CameraFrames, kept: Targets, pairs: Indices) -> Array:
        """Numbers of rows (k, 2) of targets, the same whichever of the two is first; shape (k,)."""
        ids = [kept.vessel_ids[vessel] for vessel in kept.vessel.tolist()]
        places: dict[str, list[int]] = {}
        for place, (a, b) in enumerate(pairs.tolist()):
            places.setdefault("\n".join(sorted((ids[a], ids[b]))), []).append(place)
        steps, result = frames.steps[kept.frame[pairs[:, 0]]], np.empty(len(pairs))
        for name, ours in places.items():
            result[ours] = self._of_pair(frames.camera, name, steps[ours])
        return result

    def _of_pair(self, camera: str, name: str, steps: Indices) -> Array:
        """The number at steps (n,): the new one of the last step at which the old one was not kept."""
        if not self._correlation_s:
            return step_uniforms(self._streams, Purpose.MERGE, camera, name, steps=steps)[:, 0]
        first, stop, back = int(steps.min()), int(steps.max()) + 1, _FIRST_LOOK
        decays = self._decays_until(stop)
        while True:
            start = max(first - back, 0)
            new, decides = (
                self._streams.uniforms(purpose, camera, name, first=start, count=stop - start)[:, 0]
                for purpose in (Purpose.MERGE, Purpose.MERGE_KEPT)
            )
            taken = np.where(decides >= decays[start:stop], np.arange(stop - start), -1)
            source = np.maximum.accumulate(taken)[steps - start]
            if source.min() >= 0:
                return new[source]
            back *= _FURTHER

    def _decays_until(self, stop: int) -> Array:
        """The probability to keep the number at each step, shape (at least `stop`,)."""
        known = len(self._decays)
        if stop > known:
            times = self._clock(known - 1, stop).tolist()
            self._decays += [decay(b - a, self._correlation_s) for a, b in itertools.pairwise(times)]
        return np.array(self._decays)
