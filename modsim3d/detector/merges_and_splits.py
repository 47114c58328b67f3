"""Detections that are not one box for one vessel: merged vessels, duplicate boxes, boxes split in two."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import sizes
from modsim3d.core.random_streams import Purpose, Streams
from modsim3d.detector.draws import step_uniforms, target_uniforms
from modsim3d.detector.persistence import Clock, decay
from modsim3d.detector.records import CameraFrames, Targets

# ---- A uniform number of two vessels ----

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
        for name, rows in places.items():
            result[rows] = self._of_pair(frames.camera, name, steps[rows])
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
        count = len(self._decays)
        if stop > count:
            times = self._clock(count - 1, stop).tolist()
            self._decays += [decay(b - a, self._correlation_s) for a, b in itertools.pairwise(times)]
        return np.array(self._decays)


_MIN_CUT, _MAX_CUT = 0.3, 0.7
MIN_SPLIT_PX = 4.0  # narrower boxes are not split: each part is at least a pixel wide


@dataclass(frozen=True)
class MergesAndSplits:
    """Rates at which boxes and vessels do not match one to one."""

    duplicates: float = 0.0  # probability that a detected vessel gets a second box
    merges: float = 0.0  # probability that two vessels that overlap come out as one box where the larger is detected
    merge_overlap: float = 0.3  # least share of the smaller box inside the larger one for which they overlap
    splits: float = 0.0  # probability that a long vessel is split into two boxes
    split_aspect: float = 4.0  # least width over height of a long vessel's box

    def merged_pairs(self, noise: PairNoise, frames: CameraFrames, kept: Targets) -> Indices:
        """Vessels that merge if the larger is detected, larger first, (k, 2), each once at most: most overlap wins."""
        if not self.merges:
            return np.empty((0, 2), dtype=np.int64)
        pairs, overlap = _overlapping(kept, self.merge_overlap)
        uniforms = noise.uniforms(frames, kept, pairs)
        willing = np.flatnonzero(uniforms < self.merges)
        taken: set[int] = set()
        winners = []
        for row in willing[np.lexsort((uniforms[willing], -overlap[willing]))]:
            pair = pairs[row].tolist()
            if taken.isdisjoint(pair):
                taken.update(pair)
                winners.append(pair)
        return np.array(sorted(winners), dtype=np.int64).reshape(-1, 2)

    def looks_long(self, boxes_px: Array) -> Mask:
        """Whether true boxes of shape (n, 4) are so wide for their height that a vessel may be split, shape (n,)."""
        width, height = sizes(boxes_px).T
        return np.asarray(width >= self.split_aspect * height)

    def events(self, streams: Streams, frames: CameraFrames, vessels: Targets, boxes_px: Array, single: Mask) -> Events:
        """Duplicated and split ones among n detected vessels, and expected numbers of both, given boxes with their
        errors (n, 4), and which are one vessel, not two merged, (n,)."""
        if not self.duplicates and not self.splits:
            nothing = np.empty(0, dtype=np.int64)
            return Events(nothing, nothing, np.empty(0), np.zeros(len(frames)))
        uniforms = target_uniforms(streams, Purpose.DOUBLE, frames, vessels)
        long = single & self.looks_long(vessels.boxes_px) & (sizes(boxes_px)[:, 0] >= MIN_SPLIT_PX)
        doubled = np.flatnonzero(single & (uniforms[:, 0] < self.duplicates))
        split = np.flatnonzero(long & (uniforms[:, 0] >= 1 - self.splits))
        expected = self.duplicates * single + self.splits * long
        return Events(
            doubled,
            split,
            _MIN_CUT + (_MAX_CUT - _MIN_CUT) * uniforms[split, 1],
            np.bincount(vessels.frame, weights=expected, minlength=len(frames)).astype(np.float64),
        )


@dataclass(frozen=True, eq=False)
class Events:
    """Duplicates and splits."""

    doubled: Indices  # rows that get a second box, shape (d,)
    split: Indices  # rows that are split, shape (k,)
    cut: Array  # share of their width at which they are cut, shape (k,)
    expected: Array  # expected number of extra boxes in each frame, given the detected vessels, shape (S,)


def halves(boxes_px: Array, cut: Array) -> tuple[Array, Array]:
    """The larger and the smaller part of boxes cut at these shares of their width, shapes (k, 4)."""
    middle = boxes_px[:, 0] + cut * (boxes_px[:, 2] - boxes_px[:, 0])
    left, right = boxes_px.copy(), boxes_px.copy()
    left[:, 2] = right[:, 0] = middle
    return np.where((cut >= 0.5)[:, None], left, right), np.where((cut >= 0.5)[:, None], right, left)


def _overlapping(kept: Targets, least: float) -> tuple[Indices, Array]:
    """Pairs of rows of one frame that share enough of the smaller box, the larger first; and which share."""
    box = kept.boxes_px
    area = sizes(box).prod(axis=1)
    pairs = [np.empty((0, 2), dtype=np.int64)]
    for apart in range(1, int(np.bincount(kept.frame).max(initial=0))):
        first = np.flatnonzero(kept.frame[apart:] == kept.frame[:-apart])
        pairs.append(np.stack([first, first + apart], axis=1))
    both = np.concatenate(pairs)
    a, b = both.T
    common = np.minimum(box[a, 2:], box[b, 2:]) - np.maximum(box[a, :2], box[b, :2])
    share = np.clip(common, 0, None).prod(axis=1) / np.maximum(np.minimum(area[a], area[b]), 1e-9)
    both = np.where((area[b] > area[a])[:, None], both[:, ::-1], both)
    near = np.flatnonzero((share >= least) & (share > 0))
    return both[near], share[near]
