"""False detections linked over time: which of them are the same thing, seen again.

Things move at a constant velocity, along and below the horizon, so that a camera that rolls and pitches does not break
the links.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.formats.labelled import Images
from modsim3d.learn.observed.observed import Observed
from modsim3d.voyage.unseen.following import follow
from modsim3d.voyage.unseen.jitter import Jitter, jitter_of
from modsim3d.voyage.unseen.sides import Sides

MOST_GAP_S = 3.0
"""A thing that is not detected for longer is another one when it is detected again, unless it was followed as long."""
LEAST_GAP_FRAMES = 3
"""Usual gaps between frames that a thing may be missed for in any case."""


@dataclass(frozen=True, eq=False)
class Links:
    """Which detections are of one thing.

    Attributes:
        rows: Rows of the results that are linked, shape (n,).
        link: Number of the thing that each is of, from 0 up, shape (n,).
        image: Image of each, shape (n,).
        time_s: Time of each, shape (n,).
        places_px: Distance along and below the horizon of the centre, shape (n, 2).
        bottom_px: Distance below the horizon of the middle of the lower edge, NaN where no horizon is known, (n,).
        sizes_px: Width and height, shape (n, 2).
        whole: Whether nothing cuts off a side, shape (n,).
        at_border: Whether the image's left or right border may cut it, shape (n,).
        gap_s: Usual time between frames.
        longest_gap_s: Longest time between two detections of a thing that is not hidden.
        jitter: By how much small boxes change through the detector's errors.
    """

    rows: Indices
    link: Indices
    image: Indices
    time_s: Array
    places_px: Array
    bottom_px: Array
    sizes_px: Array
    whole: Mask
    at_border: Mask
    gap_s: float
    longest_gap_s: float
    jitter: Jitter

    @property
    def count(self) -> int:
        """Number of things."""
        return int(self.link.max(initial=-1)) + 1


def link(observed: Observed) -> Links:
    """Link the false positives of a labelled set whose images have times; others are things of their own."""
    sightings, images = observed.false_sightings, observed.labelled.images
    time_s = images.time_s[sightings.image]
    gap_s = _usual_gap_s(images)
    longest = max(MOST_GAP_S, (LEAST_GAP_FRAMES + 0.5) * gap_s)
    jitter = jitter_of(observed, longest)
    sides = Sides.of(sightings, observed.labelled.annotations, len(images))
    numbers, first = np.full(len(sightings), -1), 0
    sequence = images.sequence[sightings.image]
    for each in np.unique(sequence[np.isfinite(time_s)]):
        rows = np.flatnonzero((sequence == each) & np.isfinite(time_s))
        rows = rows[np.argsort(time_s[rows], kind="stable")]
        numbers[rows] = first + follow(time_s[rows], sides.places_px[rows], sides.sure[rows], longest, jitter)
        first = int(numbers.max()) + 1
    alone = np.flatnonzero(numbers < 0)
    numbers[alone] = first + np.arange(len(alone))
    return Links(
        observed.false_positives,
        numbers,
        sightings.image,
        time_s,
        np.column_stack([sightings.along_px, sightings.depth_px]),
        np.where(sightings.known, sides.places_px[:, 3], np.nan),
        sightings.sizes_px,
        np.asarray(sides.sure.all(axis=1)),
        sides.at_border,
        gap_s,
        longest,
        jitter,
    )


def _usual_gap_s(images: Images) -> float:
    """Median time between consecutive frames; 1 where frames have no times."""
    order = np.lexsort((images.time_s, images.sequence))
    gaps = np.diff(images.time_s[order])[np.diff(images.sequence[order]) == 0]
    gaps = gaps[gaps > 0]
    return float(np.median(gaps)) if len(gaps) else 1.0
