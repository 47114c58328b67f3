"""Truth and tracks as TrackEval takes them: one long sequence of all cameras, one camera after the other."""

from __future__ import annotations

from typing import Any

import numpy as np

from modsim3d.arrays import Array, Indices, extents, ranges
from modsim3d.errors import ModsimError
from modsim3d.tracking.scores.scored import Scored

Data = dict[str, Any]
"""What `eval_sequence` of a metric of TrackEval is given; see its own documentation."""


def metrics() -> Any:  # a module of a library without types
    """TrackEval's metrics.

    Raises:
        ModsimError: TrackEval is not installed.
    """
    try:
        from trackeval import metrics as found  # type: ignore[import-untyped]
    except ImportError:
        raise ModsimError('scores of tracks need TrackEval: pip install "modsim3d[trackers]"') from None
    return found


def sequence(scored: Scored) -> Data:
    """The vessels and the tracks that are scored, as one sequence.

    Identities of different cameras are different, and the frames of a camera stand together, since CLEAR prefers the
    pairs of the frame before. So the scores are those that TrackEval combines from a sequence for each camera. Frames
    without vessels and without tracks are left out: they change no score.
    """
    truth, tracks = scored.truth, scored.tracks
    frames = np.union1d(truth.frame, tracks.frame)
    frames = frames[np.lexsort((frames, frames % scored.by_step))]
    truth_first, truth_count = extents(truth.frame, frames)
    track_first, track_count = extents(tracks.frame, frames)
    truth_id, track_id = (np.unique(each, return_inverse=True)[1] for each in (truth.identity, tracks.identity))
    return {
        "num_timesteps": len(frames),
        "num_gt_dets": len(truth),
        "num_tracker_dets": len(tracks),
        "num_gt_ids": int(truth_id.max(initial=-1)) + 1,
        "num_tracker_ids": int(track_id.max(initial=-1)) + 1,
        "gt_ids": _cut(truth_id, truth_first, truth_count),
        "tracker_ids": _cut(track_id, track_first, track_count),
        "similarity_scores": _similarities(scored, (truth_first, truth_count), (track_first, track_count)),
    }


def _similarities(scored: Scored, truth: tuple[Indices, Indices], tracks: tuple[Indices, Indices]) -> list[Array]:
    """Similarity of each vessel to each track of its frame: of each of F frames a matrix."""
    (truth_first, truth_count), (track_first, track_count) = truth, tracks
    rows = ranges(truth_first, truth_count)  # each vessel stands as often as its frame has tracks
    tracks_of_row = np.repeat(track_count, truth_count)
    i = np.repeat(rows, tracks_of_row)
    j = ranges(np.repeat(track_first, truth_count), tracks_of_row)
    alike = scored.rules.similarity(scored.truth.boxes_px[i], scored.tracks.boxes_px[j])
    parts = _cut(alike, *_places(truth_count * track_count))
    shapes = zip(truth_count.tolist(), track_count.tolist(), strict=True)
    return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]


def _places(counts: Indices) -> tuple[Indices, Indices]:
    return np.cumsum(counts) - counts, counts


def _cut(column: Any, first: Indices, count: Indices) -> list[Any]:
    """The parts of a column with the given first rows and numbers of rows."""
    return [column[a : a + n] for a, n in zip(first.tolist(), count.tolist(), strict=True)]
