"""Files of boxes that are wrong as a whole: read in another way they fit boxes that are known, or their images.
Tracks are held against the detections of their run, detections against the annotations of their images."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask, extents, ranges
from modsim3d.core.boxes import centre_form, corner_form, from_top_left, sizes
from modsim3d.core.text import in_percent
from modsim3d.runs.files.table_columns import BOX_SIDES, CENTRE_FORM


@dataclass(frozen=True)
class BoxForm:
    """A form."""

    meaning: str  # of the four numbers, in words
    names: tuple[str, ...]  # of the four numbers
    first_px: int  # number of the first pixel
    to_corners: Callable[[Array], Array]  # makes x_min, y_min, x_max, y_max of the four, shapes (k, 4)

    def boxes_px(self, numbers: Array) -> Array:
        """Boxes as x_min, y_min, x_max, y_max with pixels from 0, of those of a file, shapes (k, 4)."""
        boxes: Array = self.to_corners(numbers) - self.first_px
        return boxes

    def numbers_of(self, boxes_px: Array) -> Array:
        """The four numbers that a file has of boxes, shapes (k, 4)."""
        if self.to_corners is corner_form:
            return centre_form(boxes_px)
        if self.to_corners is from_top_left:
            return np.hstack([boxes_px[:, :2] + self.first_px, sizes(boxes_px)])
        return boxes_px


CORNERS = BoxForm("the corners x_min, y_min, x_max, y_max", BOX_SIDES, 0, lambda numbers: numbers)
CENTRE = BoxForm("centre x, centre y, width, height", CENTRE_FORM, 0, corner_form)
TOP_LEFT = BoxForm("the corner x, y and width, height", ("x", "y", "width", "height"), 0, from_top_left)
MOT = BoxForm("x, y, width, height with pixels from 1", TOP_LEFT.names, 1, from_top_left)


_LOOKED_AT = 2000  # rows, spread over the file
_MIN_ROWS, _MIN_CLOSE_ROWS = 8, 30
"""Fewer rows may be false tracks, which fit nothing, or anything by chance; more are needed where little changes."""
_FITS, _NEARER = 0.1, 0.6
"""Another reading is meant if half of its boxes are at most this share of the image's diagonal from known ones, and
this share of them is nearer than as the file is. Of four trackers on four scenes at most 0.51 are, by a factor of 1.02.
"""
_MUCH, _CLOSE, _FRAME = 2.0, 1.25, 1.5
"""By what factor boxes must be nearer: read very differently, a pixel or half a box elsewhere, or a frame off."""
_NEAR, _EXACT, _AGREE = 0.001, 0.0001, 0.01
"""So near, two pixels of a large image, are no boxes that are read in another way; or so near are right ones."""
_SIZES_PX = (
    *((320, 320), (416, 416), (512, 512), (640, 360), (640, 480), (640, 640), (800, 600), (960, 540)),
    *((1024, 768), (1280, 720), (1280, 1280), (1920, 1080), (2560, 1440), (3840, 2160), (1000, 1000), (100, 100)),
)
"""Sizes to which images are often scaled for a detector or a tracker; halves and doubles of their own are tried too."""
_MAX_NORMALISED, _PER_CENT, _MANY_PX = 2.0, 100, 400
"""Numbers up to these are shares, or may be in per cent if each side of the images has so many pixels or more."""
_CLEARLY = 1.0  # standard deviations of a sign test by which boxes must be nearer if a bias looks the same
_LATE, _EXCHANGED = "frames are one too high", "x and y of the boxes are exchanged"
_BEYOND_PX, _MAX_BEYOND = 5.0, 0.1
"""Boxes may reach beyond their image by so much, and so many of them by more, as those of boats that it cuts do."""
_FITS_BETTER, _FOLLOWS = 0.2, 0.1
"""Another reading is meant if it leaves at most this share of such boxes; and width and height are corners if at most
this share of their variance is left when the upper left corner is subtracted."""
_NEARLY_ALL, _MANY, _TO_THE_EDGE = 0.98, 0.5, 0.9
_SNUG_PX = 2.0  # boxes that an image has cut end so near to its edge


@dataclass(frozen=True, eq=False)
class KnownBoxes:
    """The m boxes that others should lie near, in order of frame."""

    word: str  # what one is called
    frame: Indices  # number of the frame: (m,)
    boxes_px: Array  # (m, 4)

    def distances(self, frame: Indices, boxes_px: Array) -> Array:
        """Distances of boxes from the nearest one of their frame in pixels; infinite without one: (k,). The distance of
        two boxes is the largest of their four edges. Unlike the IoU it tells boxes that are near from others also where
        boats are smaller than the errors of their boxes."""
        return self._nearest(frame, boxes_px, lambda edges: np.abs(edges).max(axis=1))

    def squares(self, frame: Indices, boxes_px: Array) -> Array:
        """Sums of the squares of the distances of edges to the nearest box, in square pixels, shape (k,)."""
        return self._nearest(frame, boxes_px, lambda edges: np.square(edges).sum(axis=1))

    def nearest(self, frame: Indices, boxes_px: Array) -> tuple[Indices, Indices]:
        """Row of each box that has a known one in its frame, and of the nearest one, shapes (k,)."""
        row, other = self._pairs(frame)
        order = np.lexsort((np.abs(boxes_px[row] - self.boxes_px[other]).max(axis=1), row))
        rows, first = np.unique(row[order], return_index=True)
        return rows, other[order][first]

    def _pairs(self, frame: Indices) -> tuple[Indices, Indices]:
        """Row of each box and of each known one of its frame."""
        first, many = extents(self.frame, frame)
        return np.repeat(np.arange(len(frame)), many), ranges(first, many)

    def _nearest(self, frame: Indices, boxes_px: Array, measure: Callable[[Array], Array]) -> Array:
        row, other = self._pairs(frame)
        nearest = np.full(len(frame), np.inf)
        np.minimum.at(nearest, row, measure(boxes_px[row] - self.boxes_px[other]))
        return nearest


@dataclass(frozen=True, eq=False)
class BoxRows:
    """The k boxes of a file."""

    numbers: Array  # four of each as the file has them: (k, 4)
    form: BoxForm  # what these are read as
    image_px: Array  # width and height of the image: (k, 2)
    frame: Indices  # number of the frame: (k,)
    frame_before: Indices  # number of the frame before it, one that does not exist for the first: (k,)
    frame_after: Indices  # number of the frame after it, one that does not exist for the last: (k,)

    def spread(self) -> BoxRows:
        """Some of the rows, spread over the file."""
        chosen = np.unique(np.linspace(0, len(self.frame) - 1, _LOOKED_AT).astype(np.int64))[: len(self.frame)]
        frames = (column[chosen] for column in (self.frame, self.frame_before, self.frame_after))
        return BoxRows(self.numbers[chosen], self.form, self.image_px[chosen], *frames)


@dataclass(frozen=True, eq=False)
class _Reading:
    sentence: str  # what is wrong then, and what would be right
    boxes_px: Array  # (k, 4)
    frame: Indices  # number of the frame: (k,)
    factor: float = _MUCH  # by which boxes must be nearer


@dataclass(frozen=True)
class Misreading:
    """Sentence on a fault of a file, and whether boxes lie so near that their maker may err by as much."""

    sentence: str
    slight: bool


def misreading(
    rows: BoxRows, boxes: KnownBoxes, truth: KnownBoxes | None = None, *, only_forms: bool = False
) -> Misreading | None:
    """Fault of boxes that are far from known ones as they are, and near if they are read in another way. `truth` has,
    for tracks, the true boxes: a tracker may correct a bias of its detections or lag behind them by a frame, so boxes
    that another reading moves by little are wrong only if one brings them nearer to these too. With `only_forms`
    nothing but the form of the boxes is in doubt."""
    if len(rows.frame) < _MIN_ROWS:
        return None
    rows = rows.spread()
    diagonal_px = np.hypot(*rows.image_px.T)
    as_it_is = boxes.distances(rows.frame, rows.form.boxes_px(rows.numbers)) / diagonal_px
    now, best, meant, agreed = _median(as_it_is), _FITS, None, False
    for reading in (_form_readings if only_forms else _readings)(rows):
        if reading.sentence.startswith(_LATE) and truth is not None:
            continue  # a tracker with a latency of one frame looks the same
        away = boxes.distances(reading.frame, reading.boxes_px) / diagonal_px
        both, half = np.isfinite(away) & np.isfinite(as_it_is), _median(away)
        least = _NEAR if reading.factor == _MUCH else _EXACT
        many = _MIN_ROWS if now > _MUCH * half and reading.factor != _CLOSE else _MIN_CLOSE_ROWS
        nearer = np.count_nonzero(away[both] < as_it_is[both]) >= _NEARER * np.count_nonzero(both)
        if half < best and now > max(reading.factor * half, least) and nearer and len(away) >= many:
            best, meant = half, reading
            agreed = agreed or truth is None or reading.factor == _MUCH or _agrees(truth, rows, reading)
    if meant is None or not agreed:
        return None
    fits = f"{in_percent(best, 2)} of the image's diagonal from {boxes.word} instead of {in_percent(now, 2)}"
    slight = meant.factor == _CLOSE
    if meant.factor == _FRAME and truth is None:  # where boats move alike, a bias of all boxes looks the same
        boxes_px = rows.form.boxes_px(rows.numbers)
        row, nearest = boxes.nearest(rows.frame, boxes_px)
        unbiased_px = boxes_px - np.median(boxes_px[row] - boxes.boxes_px[nearest], axis=0)
        slight = _median(boxes.distances(rows.frame, unbiased_px) / diagonal_px) < _CLOSE * best
    return Misreading(f"{meant.sentence} (then half of them lie within {fits})", slight)


def agree(rows: BoxRows, boxes: KnownBoxes) -> bool:
    """Whether there are some boxes of which half, or more, lie near known ones."""
    rows = rows.spread()
    away = boxes.distances(rows.frame, rows.form.boxes_px(rows.numbers)) / np.hypot(*rows.image_px.T)
    return len(away) >= _MIN_ROWS and _median(away) < _AGREE


def implausible(rows: BoxRows) -> Misreading | None:
    """Fault of boxes that their images cannot hold, whatever they should lie near."""
    if not len(rows.frame):
        return None
    alone = len(np.unique(rows.frame)) == len(rows.frame)
    rows = rows.spread()
    numbers, image_px, now_px = rows.numbers, rows.image_px, rows.form.boxes_px(rows.numbers)
    if np.abs(numbers).max() <= _MAX_NORMALISED:
        return Misreading(f"the boxes are shares of the image, must be in pixels: {rows.form.meaning}", False)
    beyond = _beyond(now_px, image_px)
    size = " x ".join(f"{side:g}" for side in image_px[np.argmax(beyond)].tolist())
    if len(numbers) < _MIN_ROWS:
        return None
    if beyond.mean() <= _MAX_BEYOND:
        return _inside(rows, size, alone)
    clause = f"{in_percent(beyond.mean())} of them reach beyond their images by more than {_BEYOND_PX:g} px"
    outside = np.asarray(((now_px[:, :2] >= image_px) | (now_px[:, 2:] <= 0)).any(axis=1))
    edges_px = np.hstack([np.zeros_like(image_px), image_px])
    for reading in _form_readings(rows):
        snug = np.abs(reading.boxes_px - edges_px)[beyond].min(axis=1) <= _SNUG_PX
        moved = np.allclose(sizes(reading.boxes_px), sizes(now_px))  # as whole boxes that are cut nowhere may be
        fits = _beyond(reading.boxes_px, image_px).mean() <= _FITS_BETTER * beyond.mean()
        cut = reading.sentence == _EXCHANGED and outside[beyond].mean() < _MANY  # whole boxes in upright images
        if fits and not cut and (not moved or snug.mean() > _MANY):
            either = f", or width and height of the images are: {size}" if reading.sentence == _EXCHANGED else ""
            return Misreading(f"{reading.sentence}{either} ({clause})", False)
    reach = "{:.4g}, {:.4g} to {:.4g}, {:.4g}".format(*now_px[:, :2].min(axis=0), *now_px[:, 2:].max(axis=0))
    reached = f"the first is of {size} px, and boxes reach from {reach}"
    if outside.mean() > _MAX_BEYOND:
        fault = f"{in_percent(outside.mean())} of the boxes lie outside their images: {reached}"
        fault += "; is the size of the images right"
        return Misreading(f"{fault} (--image-size or seqinfo.ini in MOT, width and height in COCO)?", False)
    return Misreading(f"boxes are not cut at the edge of the image: {clause}; {reached}", True)


def _inside(rows: BoxRows, size: str, alone: bool) -> Misreading | None:
    """Possible fault of boxes that are in their images, as of a size, and perhaps alone there."""
    x_min, y_min, x_max, y_max = rows.numbers.T
    ordered = np.mean((x_min < x_max) & (y_min < y_max)) >= _NEARLY_ALL
    follows = np.var(x_max - x_min) < _FOLLOWS * np.var(x_max)
    if rows.form.to_corners is TOP_LEFT.to_corners and ordered and follows:
        fault = f"the boxes are read as {rows.form.meaning}, but are {CORNERS.meaning}"
        one = alone and bool(np.median(np.abs(np.diff(x_min))) < _FOLLOWS * np.ptp(x_min))
        also = ", or one vessel comes near as it moves right" * one
        return Misreading(f"{fault} (each third and fourth number is above the first and second){also}", one)
    most = np.abs(rows.numbers).max()
    if most <= _PER_CENT + rows.form.first_px and rows.image_px.min() >= _MANY_PX:
        reach = rows.form.boxes_px(rows.numbers).max()
        edge = bool(reach > _TO_THE_EDGE * _PER_CENT and len(rows.numbers) >= _MIN_CLOSE_ROWS)
        fault = f"all boxes lie within 100 x 100 of {size} px: are they in per cent? must be in pixels"
        return Misreading(fault, not edge)
    return None


def _beyond(boxes_px: Array, image_px: Array) -> Mask:
    """Mask of the boxes that reach far beyond their image, or are none, shape (k,)."""
    low, high = boxes_px[:, :2], boxes_px[:, 2:]
    return np.asarray(((low < -_BEYOND_PX) | (high > image_px + _BEYOND_PX) | (high <= low)).any(axis=1))


def _median(away: Array) -> float:
    finite = away[np.isfinite(away)]
    return float(np.median(finite)) if len(finite) else np.inf


def _agrees(truth: KnownBoxes, rows: BoxRows, reading: _Reading) -> bool:
    """Whether true boxes are clearly nearer in another reading: whether the sum of squares falls for most boxes. Where
    all boxes move by as much, this compares their median errors, of which noise hides less than of distances."""
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
    others, plain = _other_forms(form), TOP_LEFT if form is MOT else form
    yield from _form_readings(rows)
    if np.abs(numbers).max() <= _MAX_NORMALISED:
        scaled = numbers * np.tile(rows.image_px, 2)
        for other in (plain, *others):
            text = f"the boxes are shares of the image ({other.meaning}), must be in pixels: {form.meaning}"
            yield _Reading(text, other.boxes_px(scaled), frame)
    own = sorted({(width, height) for width, height in np.unique(rows.image_px, axis=0).tolist()})
    near = [(round(width * by), round(height * by)) for width, height in own for by in (0.25, 0.5, 2, 4)]
    sizes_told = ", ".join(f"{width:g} x {height:g}" for width, height in own[:4])
    for image in dict.fromkeys((*near[:16], *_SIZES_PX)):
        text = f"the boxes are those of an image of {image[0]} x {image[1]} px, must be in pixels of the camera's image"
        yield _Reading(f"{text} ({sizes_told})", as_it_is * np.tile(rows.image_px / image, 2), frame)


def _form_readings(rows: BoxRows) -> Iterator[_Reading]:
    """Readings in which the four numbers are others, or are counted from elsewhere."""
    for other in _other_forms(rows.form):
        fault = f"the boxes are read as {rows.form.meaning}, but are {other.meaning}"
        yield _Reading(fault, other.boxes_px(rows.numbers), rows.frame)
    exchanged = rows.numbers[:, [1, 0, 3, 2]]
    yield _Reading(_EXCHANGED, rows.form.boxes_px(exchanged), rows.frame)
    if rows.form is CENTRE:  # of YOLO, as shares of width and height
        as_shares = exchanged * np.tile(rows.image_px / rows.image_px[:, ::-1], 2)
        yield _Reading(_EXCHANGED, rows.form.boxes_px(as_shares), rows.frame)
    x_min, y_min, x_max, y_max = rows.form.boxes_px(rows.numbers).T
    height = rows.image_px[:, 1]
    below = np.column_stack([x_min, height - y_max, x_max, height - y_min])
    yield _Reading("y is counted from the lower edge of the image, must be from the upper", below, rows.frame)


def _other_forms(form: BoxForm) -> list[BoxForm]:
    return [other for other in (CORNERS, CENTRE, TOP_LEFT) if other.to_corners is not form.to_corners]


def _close_readings(rows: BoxRows, as_it_is: Array) -> Iterator[_Reading]:
    """Readings in which boxes lie a pixel, a frame or half a box elsewhere."""
    first, right, step = (0, 1, 1.0) if rows.form is MOT else (1, 0, -1.0)
    pixels = f"pixels are counted from {first}, must be counted from {right}"
    frames = "frames count from 0, must count from 1" if rows.form is MOT else "frames are one too low"
    yield _Reading(pixels, as_it_is + step, rows.frame, _CLOSE)
    for fault, frame in ((frames, rows.frame_after), (_LATE, rows.frame_before)):
        yield _Reading(fault, as_it_is, frame, _FRAME)
        yield _Reading(f"{fault}, and {pixels}", as_it_is + step, frame, _FRAME)
    if rows.form is CORNERS:  # in the other forms these are the other forms
        half, fault = np.tile(sizes(as_it_is) / 2, 2), "the corners lie half a box too far"
        yield _Reading(f"{fault} right and down: is x_min, y_min the centre?", as_it_is - half, rows.frame, _CLOSE)
        yield _Reading(f"{fault} left and up: is x_max, y_max the centre?", as_it_is + half, rows.frame, _CLOSE)
