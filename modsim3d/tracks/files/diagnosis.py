"""Files of boxes that are wrong as a whole: read in another way they fit boxes that are known.

Tracks are held against the detections of their run, detections against the annotations of their images.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, extents, ranges
from modsim3d.boxes import sizes
from modsim3d.tracks.files.box_forms import CENTRE, CORNERS, MOT, TOP_LEFT, BoxForm

_LOOKED_AT = 2000
"""Rows, spread over the file."""
_LEAST_ROWS, _LEAST_CLOSE_ROWS = 8, 30
"""Fewer rows may be false tracks, which fit nothing, or anything by chance; more are needed where little changes."""
_FITS, _NEARER = 0.1, 0.6
"""Another reading is meant if half of its boxes are at most this share of the image's diagonal from known ones, and
this share of them is nearer than as the file is. Of four trackers on four scenes at most 0.51 are, by a factor of 1.02.
"""
_MUCH, _CLOSE, _FRAME = 2.0, 1.25, 1.5
"""By what factor boxes must be nearer: read very differently, a pixel or half a box elsewhere, or a frame off."""
_NEAR, _EXACT = 0.001, 0.0001
"""So near, two pixels of a large image, are no boxes that are read in a very different way, or in any."""
_SIZES_PX = (
    *((320, 320), (416, 416), (512, 512), (640, 360), (640, 480), (640, 640), (800, 600), (960, 540)),
    *((1024, 768), (1280, 720), (1280, 1280), (1920, 1080), (2560, 1440), (3840, 2160)),
)
"""Sizes to which images are often scaled for a detector or a tracker; halves and doubles of their own are tried too."""
_MOST_NORMALISED = 2.0
_CLEARLY = 1.0
"""By how many standard deviations of a sign test boxes must be nearer to the truth too if a bias looks the same."""
_LATE = "frames are one too high"


@dataclass(frozen=True, eq=False)
class KnownBoxes:
    """The m boxes that others should lie near, in order of frame.

    Attributes:
        word: What one is called.
        frame: Number of the frame, shape (m,).
        boxes_px: Shape (m, 4).
    """

    word: str
    frame: Indices
    boxes_px: Array

    def distances(self, frame: Indices, boxes_px: Array) -> Array:
        """How far boxes are from the nearest one of their frame, in pixels; infinite without one, shape (k,).

        The distance of two boxes is the largest of their four edges. Unlike the IoU it tells boxes that are near from
        others also where boats are smaller than the errors of their boxes.
        """
        return self._nearest(frame, boxes_px, lambda edges: np.abs(edges).max(axis=1))

    def squares(self, frame: Indices, boxes_px: Array) -> Array:
        """The same with the sum of the squares of the edges' distances, in square pixels, shape (k,)."""
        return self._nearest(frame, boxes_px, lambda edges: np.square(edges).sum(axis=1))

    def _nearest(self, frame: Indices, boxes_px: Array, measure: Callable[[Array], Array]) -> Array:
        first, many = extents(self.frame, frame)
        row, other = np.repeat(np.arange(len(frame)), many), ranges(first, many)
        nearest = np.full(len(frame), np.inf)
        np.minimum.at(nearest, row, measure(boxes_px[row] - self.boxes_px[other]))
        return nearest


@dataclass(frozen=True, eq=False)
class BoxRows:
    """The k boxes of a file.

    Attributes:
        numbers: Four numbers of each as the file has them, shape (k, 4).
        form: What these are read as.
        image_px: Width and height of the image, shape (k, 2).
        frame: Number of the frame, shape (k,).
        frame_before: Number of the frame before it, one that does not exist for the first, shape (k,).
        frame_after: The same for the frame after it, shape (k,).
    """

    numbers: Array
    form: BoxForm
    image_px: Array
    frame: Indices
    frame_before: Indices
    frame_after: Indices

    def spread(self) -> BoxRows:
        """Some of the rows, spread over the file."""
        chosen = np.unique(np.linspace(0, len(self.frame) - 1, _LOOKED_AT).astype(np.int64))
        frames = (each[chosen] for each in (self.frame, self.frame_before, self.frame_after))
        return BoxRows(self.numbers[chosen], self.form, self.image_px[chosen], *frames)


@dataclass(frozen=True, eq=False)
class _Reading:
    """Another way to read a file.

    Attributes:
        told: What is wrong then, and what would be right.
        boxes_px: Shape (k, 4).
        frame: Number of the frame, shape (k,).
        factor: By which boxes must be nearer.
    """

    told: str
    boxes_px: Array
    frame: Indices
    factor: float = _MUCH


@dataclass(frozen=True)
class Misreading:
    """What is wrong with a file: a sentence, and whether boxes lie so near that their maker may err by as much."""

    told: str
    slight: bool


def misreading(rows: BoxRows, known: KnownBoxes, truth: KnownBoxes | None = None) -> Misreading | None:
    """What is wrong with boxes that are far from known ones as they are, and near if they are read in another way.

    Args:
        rows: The boxes of a file.
        known: What they should lie near.
        truth: Of tracks, the true boxes. A tracker may correct a bias of its detections or lag behind them by a frame,
            so boxes that another reading moves by little are wrong only if one brings them nearer to these too.
    """
    if len(rows.frame) < _LEAST_ROWS:
        return None
    rows = rows.spread()
    diagonal_px = np.hypot(*rows.image_px.T)
    as_it_is = known.distances(rows.frame, rows.form.boxes_px(rows.numbers)) / diagonal_px
    now, best, meant, agreed = _median(as_it_is), _FITS, None, False
    for reading in _readings(rows):
        if reading.told == _LATE and truth is not None:
            continue  # a tracker with a latency of one frame looks the same
        away = known.distances(reading.frame, reading.boxes_px) / diagonal_px
        both, half = np.isfinite(away) & np.isfinite(as_it_is), _median(away)
        least = _NEAR if reading.factor == _MUCH else _EXACT
        many = _LEAST_ROWS if now > _MUCH * half and reading.factor != _CLOSE else _LEAST_CLOSE_ROWS
        nearer = np.count_nonzero(away[both] < as_it_is[both]) >= _NEARER * np.count_nonzero(both)
        if half < best and now > max(reading.factor * half, least) and nearer and len(away) >= many:
            best, meant = half, reading
            agreed = agreed or truth is None or reading.factor == _MUCH or _agrees(truth, rows, reading)
    if meant is None or not agreed:
        return None
    fits = f"{best:.2%} of the image's diagonal from {known.word} instead of {now:.2%}"
    return Misreading(f"{meant.told} (then half of them lie within {fits})", meant.factor == _CLOSE)


def _median(away: Array) -> float:
    """Of those that have a known box in their frame."""
    there = away[np.isfinite(away)]
    return float(np.median(there)) if len(there) else np.inf


def _agrees(truth: KnownBoxes, rows: BoxRows, reading: _Reading) -> bool:
    """Whether true boxes are clearly nearer in another reading: whether the sum of squares falls for most boxes.

    Where all boxes move by as much, this compares their median errors, of which noise hides less than of distances.
    """
    now = truth.squares(rows.frame, rows.form.boxes_px(rows.numbers))
    then = truth.squares(reading.frame, reading.boxes_px)
    both = np.isfinite(now) & np.isfinite(then)
    clearly = _CLEARLY if reading.factor == _CLOSE else 0.0  # no tracker knows the detections of the next frame
    return bool(np.sign(now[both] - then[both]).sum() > clearly * np.sqrt(np.count_nonzero(both)))


def _readings(rows: BoxRows) -> Iterator[_Reading]:
    """All other readings, the likeliest first: of equally good ones the first counts."""
    numbers, form, frame = rows.numbers, rows.form, rows.frame
    as_it_is = form.boxes_px(numbers)
    yield from _close_readings(rows, as_it_is)
    others = [each for each in (CORNERS, CENTRE, TOP_LEFT) if each.meaning != form.meaning and not _like(each, form)]
    plain = TOP_LEFT if form is MOT else form
    for other in others:
        yield _Reading(f"the boxes are read as {form.meaning}, but are {other.meaning}", other.boxes_px(numbers), frame)
    yield _Reading("x and y of the boxes are exchanged", form.boxes_px(numbers[:, [1, 0, 3, 2]]), frame)
    x_min, y_min, x_max, y_max = as_it_is.T
    height = rows.image_px[:, 1]
    below = np.column_stack([x_min, height - y_max, x_max, height - y_min])
    yield _Reading("y is counted from the lower edge of the image, must be from the upper", below, frame)
    if np.abs(numbers).max() <= _MOST_NORMALISED:
        scaled = numbers * np.tile(rows.image_px, 2)
        for other in (plain, *others):
            told = f"the boxes are shares of the image ({other.meaning}), must be in pixels: {form.meaning}"
            yield _Reading(told, other.boxes_px(scaled), frame)
    own = sorted({(width, height) for width, height in np.unique(rows.image_px, axis=0).tolist()})
    near = [(round(width * by), round(height * by)) for width, height in own for by in (0.25, 0.5, 2, 4)]
    sizes_told = ", ".join(f"{width:g} x {height:g}" for width, height in own[:4])
    for image in dict.fromkeys((*near[:16], *_SIZES_PX)):
        told = f"the boxes are those of an image of {image[0]} x {image[1]} px, must be in pixels of the camera's image"
        yield _Reading(f"{told} ({sizes_told})", as_it_is * np.tile(rows.image_px / image, 2), frame)


def _close_readings(rows: BoxRows, as_it_is: Array) -> Iterator[_Reading]:
    """Those in which boxes lie a pixel, a frame or half a box elsewhere."""
    first, right, step = (0, 1, 1.0) if rows.form is MOT else (1, 0, -1.0)
    pixels = f"pixels are counted from {first}, must be counted from {right}"
    frames = "frames count from 0, must count from 1" if rows.form is MOT else "frames are one too low"
    yield _Reading(pixels, as_it_is + step, rows.frame, _CLOSE)
    yield _Reading(frames, as_it_is, rows.frame_after, _FRAME)
    yield _Reading(f"{frames}, and {pixels}", as_it_is + step, rows.frame_after, _FRAME)
    yield _Reading(_LATE, as_it_is, rows.frame_before, _FRAME)
    if rows.form is CORNERS:  # in the other forms these are the other forms
        half, told = np.tile(sizes(as_it_is) / 2, 2), "the corners lie half a box too far"
        yield _Reading(f"{told} right and down: is x_min, y_min the centre?", as_it_is - half, rows.frame, _CLOSE)
        yield _Reading(f"{told} left and up: is x_max, y_max the centre?", as_it_is + half, rows.frame, _CLOSE)


def _like(one: BoxForm, other: BoxForm) -> bool:
    """Whether two forms differ by the number of the first pixel alone."""
    return one.to_corners is other.to_corners
