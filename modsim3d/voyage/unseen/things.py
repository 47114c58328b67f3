"""Things that were detected without a transponder: how long each lasts, and whether it moves like a vessel."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.formats.labelled import Images
from modsim3d.voyage.unseen.jitter import TO_STD
from modsim3d.voyage.unseen.links import Links

_LEAST_SEEN = 5
"""Detections that are needed to see how a thing moves; with fewer nothing speaks against a vessel."""
_MOST_OFF, _MOST_OFF_PX, _MOST_RESIZED = 0.35, 5.0, 0.4
"""Median distance from the middle of the detections before and after, in sides and in pixels; spread of log sides."""
_LEAST_SHARE = 0.25
"""Share of the frames of its life in which a vessel is detected at least."""
_ABOVE, _LEAST_ABOVE_PX = 0.25, 3.0
"""How far above the horizon a vessel's lower edge may seem to be, in heights and in pixels."""
_UNSTEADY_STDS = 1.5
"""What does not exceed so many standard deviations of the jitter of known boxes is steady in any case."""


class Behaviour(IntEnum):
    """What speaks against a vessel: the first that is true."""

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
            Behaviour.RARELY_SEEN: f"detected in less than {_LEAST_SHARE:.0%} of the frames",
            Behaviour.JUMPS: "moves unsteadily",
            Behaviour.CHANGES_SIZE: "changes its size",
        }[self]


@dataclass(frozen=True, eq=False)
class Things:
    """N linked things.

    Attributes:
        detections: How often each was detected, shape (N,).
        first_image: Image in which each was first detected, shape (N,).
        frames: Frames from the first detection to the last, both included, by the usual gap, shape (N,).
        lasted_s: Time from the first detection to the last, shape (N,).
        cut: Whether the frames end before the thing surely did, shape (N,).
        behaviour: Of `Behaviour`, shape (N,).
    """

    detections: Indices
    first_image: Indices
    frames: Indices
    lasted_s: Array
    cut: Mask
    behaviour: Indices

    @property
    def perhaps_vessel(self) -> Mask:
        """Whether nothing but a short life speaks against a vessel, shape (N,)."""
        perhaps: Mask = self.behaviour == Behaviour.LIKE_A_VESSEL
        return perhaps

    @property
    def unsteady(self) -> Mask:
        """Whether places or sizes jump, as those of a small vessel with large box errors do too, shape (N,)."""
        unsteady: Mask = np.isin(self.behaviour, (Behaviour.JUMPS, Behaviour.CHANGES_SIZE))
        return unsteady


def things_of(links: Links, images: Images) -> Things:
    """How long things last and how they move."""
    count, order = links.count, np.lexsort((links.time_s, links.link))
    link = links.link[order]
    starts = np.searchsorted(link, np.arange(count))
    stops = np.searchsorted(link, np.arange(count), side="right")
    detections = stops - starts
    time_s = links.time_s[order]
    lasted = np.nan_to_num(time_s[stops - 1] - time_s[starts]) if count else np.empty(0)
    frames = 1 + np.rint(lasted / links.gap_s).astype(np.int64)
    first_image = links.image[order][starts]
    ends = _ends_s(images)[images.sequence[first_image]] if count else np.empty(0)
    with np.errstate(invalid="ignore"):
        cut = ends - time_s[stops - 1] < links.longest_gap_s if count else np.empty(0, dtype=bool)
    cut = cut | links.at_border[order][stops - 1] if count else cut
    behaviour = np.zeros(count, dtype=np.int64)
    for thing in np.flatnonzero(detections >= _LEAST_SEEN).tolist():
        rows = order[starts[thing] : stops[thing]]
        whole = rows[links.whole[rows]]
        rows = whole if len(whole) >= _LEAST_SEEN else rows[:0]
        behaviour[thing] = _behaviour(links, rows, detections[thing] / frames[thing]) if len(rows) else 0
    return Things(detections, first_image, frames, lasted, cut, behaviour)


def _behaviour(links: Links, rows: Indices, share: float) -> Behaviour:
    """How a thing behaves that was detected in some rows, in order of time, shape (n,)."""
    place, size, time_s = links.places_px[rows], links.sizes_px[rows], links.time_s[rows]
    below = links.bottom_px[rows]
    if np.isfinite(below).any() and np.nanmedian(below + np.maximum(_ABOVE * size[:, 1], _LEAST_ABOVE_PX)) < 0:
        return Behaviour.ABOVE_THE_HORIZON
    if share < _LEAST_SHARE:
        return Behaviour.RARELY_SEEN
    part = ((time_s[1:-1] - time_s[:-2]) / (time_s[2:] - time_s[:-2]))[:, None]
    off = np.linalg.norm(place[1:-1] - (place[:-2] + part * (place[2:] - place[:-2])), axis=1)
    side = float(np.median(np.sqrt(size.prod(axis=1))))
    if np.median(off) > max(_MOST_OFF * side, _MOST_OFF_PX, _UNSTEADY_STDS * float(links.jitter.off_px(side))):
        return Behaviour.JUMPS
    # A vessel that nears grows, but slowly.
    shares, pixels = (TO_STD * np.median(np.abs(np.diff(each, axis=0)), axis=0) for each in (np.log(size), size))
    resized = (shares > np.sqrt(2) * _MOST_RESIZED) & (pixels > _UNSTEADY_STDS * links.jitter.resized_px(side))
    return Behaviour.CHANGES_SIZE if resized.any() else Behaviour.LIKE_A_VESSEL


def _ends_s(images: Images) -> Array:
    """The last time of each sequence, by its number, NaN without times."""
    ends = np.full(int(images.sequence.max(initial=-1)) + 1, -np.inf)
    timed = np.isfinite(images.time_s)
    np.maximum.at(ends, images.sequence[timed], images.time_s[timed])
    return np.where(np.isfinite(ends), ends, np.nan)
