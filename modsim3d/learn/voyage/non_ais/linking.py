"""False positives linked over time: which are the same thing, seen again, at a constant velocity along and below the
horizon, so that roll and pitch do not break the links."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from scipy.optimize import linear_sum_assignment

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import sizes
from modsim3d.core.statistics import MAD_TO_STD
from modsim3d.core.text import in_percent
from modsim3d.formats.labelled import Annotations, Images
from modsim3d.formats.matching import image_pairs
from modsim3d.learn.matches import FalseSightings, Outcomes
from modsim3d.learn.persistence import frame_interval_s

# ---- By how much boxes jump ----

_SMALL_SHARE = 0.25  # of the matched boxes that are called small; errors of larger ones are often larger in pixels
_MIN_CHANGES = 20
_MUCH_SMALLER = 1 / 3  # smaller boxes, in shares of their side, err by less: nothing shows that errors stay as large


@dataclass(frozen=True, eq=False)
class Jitter:
    """Standard deviations of what the error of a small box changes by between two frames."""

    place_px: Array  # of the centre, in x and y, (2,)
    size_px: Array  # of width and height, (2,)
    side_px: float  # median of the square root of the area of the boxes that show it

    def off_px(self, side_px: Array | float) -> Array:
        """Distance of centres of boxes of some sides for a standard deviation in x and y, in the shape of the sides."""
        return float(np.hypot(*self.place_px)) * self._share(side_px)

    def resized_px(self, side_px: Array | float) -> Array:
        """Standard deviations of what width and height change by, shape (..., 2)."""
        return self.size_px * self._share(side_px)[..., None]

    def _share(self, side_px: Array | float) -> Array:
        return np.minimum(np.asarray(side_px) / (_MUCH_SMALLER * self.side_px), 1.0)


STEADY = Jitter(np.zeros(2), np.zeros(2), 1.0)


def jitter_of(observed: Outcomes, longest_s: float) -> Jitter:
    """Jitter of the smallest known vessels in full view, from detections at most so long apart; 0 if they are few."""
    pairs, images = observed.pairs, observed.labelled.images
    if not len(pairs):
        return STEADY
    identity = observed.labelled.annotations.identity[pairs.rows]
    sequence, time_s = images.sequence[pairs.image], images.time_s[pairs.image]
    whole = np.flatnonzero(pairs.edges.known.all(axis=1) & (identity >= 0))
    order = whole[np.lexsort((time_s[whole], identity[whole], sequence[whole]))]
    same = (np.diff(sequence[order]) == 0) & (np.diff(identity[order]) == 0)
    with np.errstate(invalid="ignore"):
        near = same & (np.diff(time_s[order]) <= longest_s)
    side_px = np.sqrt(sizes(pairs.annotated_px[order]).prod(axis=1))
    of_two = np.maximum(side_px[1:], side_px[:-1])[near]
    changes = np.diff(pairs.error_px[order], axis=0)[near]
    small = of_two <= np.quantile(of_two, _SMALL_SHARE) if len(of_two) else near[:0]
    if np.count_nonzero(small) < _MIN_CHANGES:
        return STEADY
    spread = MAD_TO_STD * np.median(np.abs(changes[small]), axis=0)
    return Jitter(spread[:2], spread[2:], float(np.median(of_two[small])))


# ---- Things followed from frame to frame ----

MAX_HIDDEN_S = 30.0  # the longest that a thing may be hidden
_MIN_SEEN = 5  # detections of a thing that may be missed for longer than usual, and that show how it moves
_NEAR, _MIN_NEAR_PX = 0.6, 5.0  # how far off a box may lie, in sides of it, and in pixels
_SPEED_SIDES_S = 1.0  # how fast a thing may be, in lengths a second: a boat of 10 m at 20 knots makes one
_MAX_WAY_SIDES = 2.0
_MAX_LOG_RATIO = np.log(2.0)
_GATE_STDS = 3.0  # a box may be off, and larger or smaller, by so many standard deviations of the jitter, too
_ASPECT = 3.0  # width over height of a thing whose width was never seen
_VAGUE = 0.5  # how far off a thing counts to be along an axis where no side tells, in reaches
_NOTHING = 1.001
_BESIDE_PX = 5.0  # a side so near to another detection's box may be hidden by what is there
_MEMORY, _MIN_MEMORY, _MEMORY_S = 12, 5, 6.0
"""Detections that a velocity is made from; not many more than in so long, since what nears seems to go ever faster."""
_AXES = np.array([0, 1, 0, 1])  # axis of the left, upper, right and lower side


@dataclass(eq=False)
class _Tracklet:
    number: int
    seen: int  # how often
    first_s: float
    last_s: float
    sides: Array  # (4,)
    known: Mask  # which of the sides are, (4,)
    velocity: Array  # along and below the horizon, (2,)
    counts: Array  # how many detections tell where it is along each, (2,)

    def is_lost(self, now: float, longest_s: float) -> bool:
        """Whether it is another thing if it is seen again: it may be hidden for as long as it was followed."""
        hidden_s = min(self.last_s - self.first_s, MAX_HIDDEN_S) if self.seen >= _MIN_SEEN else 0.0
        return now - self.last_s > max(longest_s, hidden_s) + 1e-9

    def expected(self, now: float) -> Array:
        """Its sides at a later time, shape (4,)."""
        return np.asarray(self.sides + self.velocity[_AXES] * (now - self.last_s))

    def update(self, now: float, measured: Array, sure: Mask) -> None:
        """Move it to where it was detected, by least squares over its last detections."""
        apart, expected = now - self.last_s, self.expected(now)
        usable = (sure & self.known).reshape(2, 2)
        self.seen += 1
        self.counts = np.minimum(self.counts + usable.any(axis=0), np.clip(_MEMORY_S / apart, _MIN_MEMORY, _MEMORY))
        off = _offsets(measured[None], sure[None], expected[None], self.known[None])[0, 0] * usable.any(axis=0)
        # Gains of a straight line through the last detections, evenly spaced (Brookner (1998), section 1.2.10).
        sides = expected + (2 * (2 * self.counts - 1) / (self.counts * (self.counts + 1)) * off)[_AXES]
        self.velocity = self.velocity + 6 / (self.counts * (self.counts + 1)) * off / apart
        both = usable.all(axis=0)  # then the size is seen as well
        larger = ((measured - sides)[2:] - (measured - sides)[:2]) / 2 * both / self.counts
        sides += np.concatenate([-larger, larger])
        sides = np.where(self.known, sides, measured)
        self.sides, self.known, self.last_s = sides, self.known | sure, now


def follow(time_s: Array, sides: Array, sure: Mask, longest_s: float, jitter: Jitter) -> Indices:
    """Number one sequence's detections by what they are of, from 0, (n,). Times (n,) ascend; sides are left, upper,
    right, lower, (n, 4), `sure` unless cut off. A thing missed for longer than `longest_s` may be another one."""
    numbers, tracklets, count = np.full(len(time_s), -1), list[_Tracklet](), 0
    for rows in np.split(np.arange(len(time_s)), np.flatnonzero(np.diff(time_s)) + 1) if len(time_s) else []:
        now = float(time_s[rows[0]])
        tracklets = [tracklet for tracklet in tracklets if not tracklet.is_lost(now, longest_s)]
        free = np.arange(len(rows))
        for seen in (sure[rows], sure[rows] & ~_beside_others(sides[rows])):
            waiting = [tracklet for tracklet in tracklets if tracklet.last_s < now]
            taken = _assigned(waiting, now, sides[rows[free]], seen[free], jitter)
            for place, tracklet in taken:
                row = rows[free[place]]
                numbers[row] = waiting[tracklet].number
                waiting[tracklet].update(now, sides[row], seen[free[place]])
            free = np.delete(free, [place for place, _ in taken])
            if not len(free):
                break
        for row in rows[free].tolist():
            numbers[row] = count
            here = sides[row].copy(), sure[row].copy()
            tracklets.append(_Tracklet(count, 1, now, now, *here, np.zeros(2), np.ones(2)))
            count += 1
    return numbers


def _assigned(
    tracklets: list[_Tracklet], now: float, measured: Array, sure: Mask, jitter: Jitter
) -> list[tuple[int, int]]:
    """Pairs of a detection and the thing that it is of, as places; measured and sure are (n, 4)."""
    if not tracklets:
        return []
    expected = np.stack([tracklet.expected(now) for tracklet in tracklets])
    known = np.stack([tracklet.known for tracklet in tracklets])
    apart, counts = np.array([(now - tracklet.last_s, tracklet.counts.min()) for tracklet in tracklets]).T
    width, height = np.maximum(expected[:, 2:] - expected[:, :2], 1.0).T
    side = np.sqrt(np.where(known[:, 0] & known[:, 2], width, np.maximum(width, _ASPECT * height)) * height)
    way = np.minimum(apart * _SPEED_SIDES_S, _MAX_WAY_SIDES) / np.sqrt(counts)
    reach = np.maximum(_NEAR * side, np.maximum(_GATE_STDS * jitter.off_px(side), _MIN_NEAR_PX)) + side * way
    off = np.linalg.norm(_offsets(measured, sure, expected, known), axis=-1) / reach
    fits = (off <= 1) & _alike(measured, sure, expected, known, jitter)
    if not fits.any():
        return []
    vague = 2 - (sure[:, None] & known[None]).reshape(*off.shape, 2, 2).any(axis=2).sum(axis=-1)
    pairs = zip(*linear_sum_assignment(np.where(fits, np.maximum(off, _VAGUE * vague), _NOTHING)), strict=True)
    return [(int(a), int(b)) for a, b in pairs if fits[a, b]]


def _beside_others(sides: Array) -> Mask:
    """Mask of the sides (n, 4) of detections in one frame in or just beside the box of another, shape (n, 4)."""
    low, high = sides[:, :2] - _BESIDE_PX, sides[:, 2:] + _BESIDE_PX
    meets = ((sides[:, None, :2] <= high) & (sides[:, None, 2:] >= low)).all(axis=-1) & ~np.eye(len(sides), dtype=bool)
    inside = (sides[:, None] >= np.tile(low, 2)) & (sides[:, None] <= np.tile(high, 2))
    return np.asarray((inside & meets[..., None]).any(axis=1))


def _offsets(measured: Array, sure: Mask, expected: Array, known: Mask) -> Array:
    """Distances of n detections from where k things are expected, along and below the horizon, (n, k, 2), by sure
    sides; without any, of what is between, 0 if they overlap."""
    usable = (sure[:, None] & known[None]).reshape(len(measured), len(expected), 2, 2)
    off = (measured[:, None] - expected[None]).reshape(usable.shape)
    number = usable.sum(axis=2)
    mean = np.where(usable, off, 0.0).sum(axis=2) / np.maximum(number, 1)
    before = np.maximum(expected[None, :, :2] - measured[:, None, 2:], 0)
    return np.where(number > 0, mean, np.maximum(measured[:, None, :2] - expected[None, :, 2:], 0) - before)


def _alike(measured: Array, sure: Mask, expected: Array, known: Mask, jitter: Jitter) -> Mask:
    """Whether n detections are about as large as k things, along axes where all sides are sure, shape (n, k)."""
    usable = (sure[:, None] & known[None]).reshape(len(measured), len(expected), 2, 2).all(axis=2)
    size, whole = (np.maximum(sides[..., 2:] - sides[..., :2], 1.0) for sides in (measured[:, None], expected[None]))
    near = np.abs(size - whole) <= _GATE_STDS * jitter.resized_px(np.sqrt(whole.prod(axis=-1)))
    return np.asarray((~usable | near | (np.abs(np.log(size / whole)) <= _MAX_LOG_RATIO)).all(axis=-1))


# ---- The four sides of unmatched detections ----

AT_BORDER_PX = 5.0  # a side so near to the image's border may be cut by it
_BESIDE, _NEAR_PX = 0.25, 5.0  # a side so near to a known vessel's box, in heights of it and px, may be hidden


@dataclass(frozen=True, eq=False)
class Sides:
    """Sides of n detections."""

    places_px: Array  # left, upper, right and lower side, along and below the horizon, (n, 4)
    sure: Mask  # whether each is a side of the whole thing, as nothing cuts it off there, (n, 4)
    at_border: Mask  # whether the image's left or right border may cut it, (n,)

    @classmethod
    def of(cls, sightings: FalseSightings, vessels: Annotations, images: int) -> Sides:
        """Sides of false positives beside known vessels, in so many images."""
        centre, half = np.column_stack([sightings.along_px, sightings.depth_px]), sightings.sizes_px / 2
        boxes = sightings.boxes_px
        with np.errstate(invalid="ignore"):
            near, far = boxes[:, :2] <= AT_BORDER_PX, boxes[:, 2:] >= sightings.image_px - AT_BORDER_PX
        sure: Mask = ~(np.concatenate([near, far], axis=1) | _covered_sides(sightings, vessels, images))
        return cls(np.concatenate([centre - half, centre + half], axis=1), sure, near[:, 0] | far[:, 0])


def _covered_sides(sightings: FalseSightings, truth: Annotations, images: int) -> Mask:
    """Mask of the sides in the box of a known vessel, or just beside it, shape (n, 4)."""
    hidden = np.zeros((len(sightings), 4), dtype=bool)
    for row, vessel in image_pairs(sightings.image, truth.image, images):
        boxes, vessels = sightings.boxes_px[row], truth.boxes_px[vessel]
        beside_px = np.maximum(_BESIDE * (vessels[:, 3] - vessels[:, 1]), _NEAR_PX)
        near = np.column_stack([beside_px, np.full(len(row), _NEAR_PX)])
        low, high = vessels[:, :2] - near, vessels[:, 2:] + near
        meets = ((boxes[:, :2] <= high) & (boxes[:, 2:] >= low)).all(axis=1)
        np.logical_or.at(hidden, row, (boxes >= np.tile(low, 2)) & (boxes <= np.tile(high, 2)) & meets[:, None])
    return hidden


MAX_GAP_S = 3.0  # a thing not detected for longer is another when it is detected again, unless followed as long
MIN_GAP_FRAMES = 3  # usual gaps between frames that a thing may be missed for in any case


@dataclass(frozen=True, eq=False)
class Links:
    """Detections linked to things, as columns (n,)."""

    rows: Indices  # of the results that are linked, (n,)
    link: Indices  # number of the thing that each is of, from 0 up
    image: Indices
    time_s: Array
    places_px: Array  # of the centre along and below the horizon, (n, 2)
    bottom_px: Array  # of the middle of the lower edge below the horizon, nan where no horizon is known
    sizes_px: Array  # width and height, (n, 2)
    whole: Mask  # whether nothing cuts off a side
    at_border: Mask  # whether the image's left or right border may cut it
    gap_s: float  # usual time between frames
    longest_gap_s: float  # between two detections of a thing that is not hidden
    jitter: Jitter  # by how much small boxes change through the detector's errors

    @property
    def count(self) -> int:
        """Number of things."""
        return int(self.link.max(initial=-1)) + 1


def link(observed: Outcomes) -> Links:
    """Link the false positives of a labelled set whose images have times; others are things of their own."""
    sightings, images = observed.false_sightings, observed.labelled.images
    time_s = images.time_s[sightings.image]
    gap_s = float(np.nan_to_num(frame_interval_s(observed.labelled), nan=1.0))  # where frames have no times
    longest = max(MAX_GAP_S, (MIN_GAP_FRAMES + 0.5) * gap_s)
    jitter = jitter_of(observed, longest)
    sides = Sides.of(sightings, observed.labelled.annotations, len(images))
    numbers, first = np.full(len(sightings), -1), 0
    sequence = images.sequence[sightings.image]
    for series in np.unique(sequence[np.isfinite(time_s)]):
        rows = np.flatnonzero((sequence == series) & np.isfinite(time_s))
        rows = rows[np.argsort(time_s[rows], kind="stable")]
        numbers[rows] = first + follow(time_s[rows], sides.places_px[rows], sides.sure[rows], longest, jitter)
        first = int(numbers.max()) + 1
    alone = np.flatnonzero(numbers < 0)
    numbers[alone] = first + np.arange(len(alone))
    places = np.column_stack([sightings.along_px, sightings.depth_px])
    bottom = np.where(sightings.known, sides.places_px[:, 3], np.nan)
    about = sightings.image, time_s, places, bottom, sightings.sizes_px, np.asarray(sides.sure.all(axis=1))
    return Links(observed.false_positives, numbers, *about, sides.at_border, gap_s, longest, jitter)


# ---- How things last and move ----


_MAX_OFF, _MAX_OFF_PX, _MAX_RESIZED = 0.35, 5.0, 0.4
"""Median distance from the middle of the detections before and after, in sides and in pixels; spread of log sides."""
_MIN_SHARE = 0.25  # share of the frames of its life in which a vessel is detected at least
_ABOVE, _MIN_ABOVE_PX = 0.25, 3.0  # how far above the horizon a vessel's lower edge may be, in heights and in pixels
_UNSTEADY_STDS = 1.5  # so many standard deviations of the jitter of known boxes are steady in any case


class Behaviour(IntEnum):
    """Reasons against a vessel: the first that is true."""

    LIKE_A_VESSEL = 0
    ABOVE_THE_HORIZON = 1
    RARELY_SEEN = 2
    JUMPS = 3
    CHANGES_SIZE = 4

    @property
    def in_words(self) -> str:
        """For a report."""
        return {
            Behaviour.LIKE_A_VESSEL: "nothing speaks against a vessel",
            Behaviour.ABOVE_THE_HORIZON: "lower edge above the horizon",
            Behaviour.RARELY_SEEN: f"detected in less than {in_percent(_MIN_SHARE)} of the frames",
            Behaviour.JUMPS: "moves unsteadily",
            Behaviour.CHANGES_SIZE: "changes its size",
        }[self]


@dataclass(frozen=True, eq=False)
class Tracklets:
    """N linked things, as columns (N,)."""

    detections: Indices  # how often each was detected, (N,)
    first_image: Indices  # in which each was detected
    frames: Indices  # from the first detection to the last, both included, by the usual gap
    lasted_s: Array  # from the first detection to the last
    cut: Mask  # whether the frames end before the thing surely did
    behaviour: Indices  # of `Behaviour`

    @property
    def perhaps_vessel(self) -> Mask:
        """Whether nothing but a short life speaks against a vessel, shape (N,)."""
        return np.asarray(self.behaviour == Behaviour.LIKE_A_VESSEL)

    @property
    def unsteady(self) -> Mask:
        """Whether places or sizes jump, as those of a small vessel with large box errors do too, shape (N,)."""
        return np.isin(self.behaviour, (Behaviour.JUMPS, Behaviour.CHANGES_SIZE))


def tracklets_of(links: Links, images: Images) -> Tracklets:
    """Durations and movements of the linked things."""
    count, order = links.count, np.lexsort((links.time_s, links.link))
    link = links.link[order]
    starts = np.searchsorted(link, np.arange(count))
    stops = np.searchsorted(link, np.arange(count), side="right")
    detections = stops - starts
    time_s = links.time_s[order]
    lasted = np.nan_to_num(time_s[stops - 1] - time_s[starts])
    frames = 1 + np.rint(lasted / links.gap_s).astype(np.int64)
    first_image = links.image[order][starts]
    ends = _ends_s(images)[images.sequence[first_image]]
    with np.errstate(invalid="ignore"):
        cut = (ends - time_s[stops - 1] < links.longest_gap_s) | links.at_border[order][stops - 1]
    behaviour = np.zeros(count, dtype=np.int64)
    for tracklet in np.flatnonzero(detections >= _MIN_SEEN).tolist():
        rows = order[starts[tracklet] : stops[tracklet]]
        whole = rows[links.whole[rows]]
        rows = whole if len(whole) >= _MIN_SEEN else rows[:0]
        behaviour[tracklet] = _behaviour(links, rows, detections[tracklet] / frames[tracklet]) if len(rows) else 0
    return Tracklets(detections, first_image, frames, lasted, cut, behaviour)


def _behaviour(links: Links, rows: Indices, share: float) -> Behaviour:
    """Behaviour of a thing that was detected in some rows, in order of time, (n,)."""
    place, size, time_s = links.places_px[rows], links.sizes_px[rows], links.time_s[rows]
    below = links.bottom_px[rows]
    if np.isfinite(below).any() and np.nanmedian(below + np.maximum(_ABOVE * size[:, 1], _MIN_ABOVE_PX)) < 0:
        return Behaviour.ABOVE_THE_HORIZON
    if share < _MIN_SHARE:
        return Behaviour.RARELY_SEEN
    part = ((time_s[1:-1] - time_s[:-2]) / (time_s[2:] - time_s[:-2]))[:, None]
    off = np.linalg.norm(place[1:-1] - (place[:-2] + part * (place[2:] - place[:-2])), axis=1)
    side = float(np.median(np.sqrt(size.prod(axis=1))))
    if np.median(off) > max(_MAX_OFF * side, _MAX_OFF_PX, _UNSTEADY_STDS * float(links.jitter.off_px(side))):
        return Behaviour.JUMPS
    # A vessel that nears grows, but slowly.
    shares, pixels = (MAD_TO_STD * np.median(np.abs(np.diff(sides, axis=0)), axis=0) for sides in (np.log(size), size))
    resized = (shares > np.sqrt(2) * _MAX_RESIZED) & (pixels > _UNSTEADY_STDS * links.jitter.resized_px(side))
    return Behaviour.CHANGES_SIZE if resized.any() else Behaviour.LIKE_A_VESSEL


def _ends_s(images: Images) -> Array:
    """The last time of each sequence, by its number, NaN without times."""
    ends = np.full(int(images.sequence.max(initial=-1)) + 1, -np.inf)
    timed = np.isfinite(images.time_s)
    np.maximum.at(ends, images.sequence[timed], images.time_s[timed])
    return np.where(np.isfinite(ends), ends, np.nan)
