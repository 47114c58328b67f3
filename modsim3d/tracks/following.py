"""Which track follows which vessel, frame by frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from modsim3d.arrays import Array, Indices, Mask, extents
from modsim3d.runs.files.columns import NOBODY
from modsim3d.tracks.similarity import Similarity
from modsim3d.tracks.tracks import Tracks
from modsim3d.tracks.true_tracks import TrueTracks

_SAME_AS_BEFORE = 1000.0
"""What a pair of the frame before gains over all others, as CLEAR MOT has it (Bernardin & Stiefelhagen (2008))."""


@dataclass(frozen=True, eq=False)
class Following:
    """The one matching of tracks and truth that all scores by rows are taken from.

    In each frame vessels and tracks are assigned so that as many pairs of the frame before as possible stay, and then
    the sum of similarities is largest. Vessels that are not scored take part: a track that follows one is not counted.

    Attributes:
        truth: The vessels, n rows.
        tracks: The tracks, k rows.
        similarity: How pairs were compared.
        track_row: Row of the track that follows each vessel, `NOBODY` for none, shape (n,).
        truth_row: Row of the vessel that each track follows, `NOBODY` for none, shape (k,).
    """

    truth: TrueTracks
    tracks: Tracks
    similarity: Similarity
    track_row: Indices
    truth_row: Indices

    @property
    def counted(self) -> Mask:
        """Which rows of the tracks are scored: all but those on a vessel that is not, shape (k,)."""
        counted: Mask = np.append(self.truth.scored, True)[self.truth_row]  # the last is that of NOBODY
        return counted

    @property
    def false(self) -> Mask:
        """Which rows of the tracks follow nothing, shape (k,)."""
        return np.equal(self.truth_row, NOBODY)

    @property
    def found(self) -> Mask:
        """Which vessels are followed, shape (n,)."""
        return np.not_equal(self.track_row, NOBODY)


def follow(truth: TrueTracks, tracks: Tracks, similarity: Similarity) -> Following:
    """Assign tracks to vessels in each frame."""
    track_row, truth_row = np.full(len(truth), NOBODY), np.full(len(tracks), NOBODY)
    before: dict[int, dict[int, int]] = {}  # camera: track that followed each identity in the camera's frame before
    frames = np.union1d(truth.frame, tracks.frame)
    places = (column.tolist() for each in (truth, tracks) for column in extents(each.frame, frames))
    for frame, first_truth, vessels, first_track, boxes in zip(frames.tolist(), *places, strict=True):
        a, b = first_truth + np.arange(vessels), first_track + np.arange(boxes)
        if not len(a) or not len(b):
            continue  # as in TrackEval: such a frame lies between two frames and is not the one before
        last = before.get(frame % truth.cameras, {})
        wanted = np.array([last.get(identity, NOBODY) for identity in truth.identity[a].tolist()], dtype=np.int64)
        alike = similarity(truth.boxes_px[a, None], tracks.boxes_px[b])
        i, j = best_pairs(alike, similarity.least, wanted[:, None] == tracks.identity[b])
        track_row[a[i]], truth_row[b[j]] = b[j], a[i]
        before[frame % truth.cameras] = dict(
            zip(truth.identity[a[i]].tolist(), tracks.identity[b[j]].tolist(), strict=True)
        )
    return Following(truth, tracks, similarity, track_row, truth_row)


def best_pairs(alike: Array, least: float, kept: Mask) -> tuple[Indices, Indices]:
    """The assignment of rows to columns of a similarity matrix, and of those that are alike enough the places.

    Args:
        alike: Similarities, shape (a, b).
        least: The least similarity of a pair.
        kept: Pairs that are preferred to all others, shape (a, b).
    """
    enough = alike >= least - np.finfo(float).eps
    score = np.where(enough, alike + _SAME_AS_BEFORE * kept, 0)
    i, j = linear_sum_assignment(score, maximize=True)
    good = enough[i, j]
    return i[good], j[good]
