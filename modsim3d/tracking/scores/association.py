"""HOTA and CLEAR scores by TrackEval, in memory, and identity scores. One whose denominator is 0 is None,
where TrackEval writes 0 or 1."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from modsim3d.core.arrays import Array, Indices, extents, ranges
from modsim3d.core.errors import ModsimError
from modsim3d.tracking.scores.scored_run import ScoredRun
from modsim3d.tracks.tracks import Similarity, Tracks
from modsim3d.tracks.true_tracks import TrueTracks

Data = dict[str, Any]  # what `eval_sequence` of a metric of TrackEval is given; see its own documentation


def metrics() -> Any:  # a module of a library without types
    """TrackEval's metrics. Raises ModsimError if it is not installed."""
    try:
        from trackeval import metrics as found  # type: ignore[import-untyped]
    except ImportError:
        raise ModsimError('scores of tracks need TrackEval: pip install "modsim3d[trackers]"') from None
    return found


def sequence(scored: ScoredRun) -> Data:
    """The vessels and the tracks that are scored, as one sequence."""
    return joined_sequence(scored.truth, scored.tracks, scored.rules.similarity)


def joined_sequence(truth: TrueTracks, tracks: Tracks, similarity: Similarity) -> Data:
    """Vessels and tracks as one sequence. Identities of different cameras are different, and the frames of a camera
    stand together, since CLEAR prefers the pairs of the frame before. So the scores are those that TrackEval combines
    from a sequence for each camera. Frames without vessels and without tracks are left out: they change no score."""
    frames = np.union1d(truth.frame, tracks.frame)
    frames = frames[np.lexsort((frames, frames % truth.cameras))]
    truth_first, truth_count = extents(truth.frame, frames)
    track_first, track_count = extents(tracks.frame, frames)
    truth_id, track_id = (np.unique(side, return_inverse=True)[1] for side in (truth.identity, tracks.identity))
    return {
        "num_timesteps": len(frames),
        "num_gt_dets": len(truth),
        "num_tracker_dets": len(tracks),
        "num_gt_ids": int(truth_id.max(initial=-1)) + 1,
        "num_tracker_ids": int(track_id.max(initial=-1)) + 1,
        "gt_ids": _cut(truth_id, truth_first, truth_count),
        "tracker_ids": _cut(track_id, track_first, track_count),
        "similarity_scores": _similarities(
            truth, tracks, similarity, (truth_first, truth_count), (track_first, track_count)
        ),
    }


def _similarities(
    truth: TrueTracks,
    tracks: Tracks,
    similarity: Similarity,
    of_truth: tuple[Indices, Indices],
    of_tracks: tuple[Indices, Indices],
) -> list[Array]:
    """Similarity of each vessel to each track of its frame: of each of F frames a matrix."""
    (truth_first, truth_count), (track_first, track_count) = of_truth, of_tracks
    rows = ranges(truth_first, truth_count)  # each vessel stands as often as its frame has tracks
    tracks_of_row = np.repeat(track_count, truth_count)
    i = np.repeat(rows, tracks_of_row)
    j = ranges(np.repeat(track_first, truth_count), tracks_of_row)
    alike = similarity(truth.boxes_px[i], tracks.boxes_px[j])
    sizes = truth_count * track_count
    parts = _cut(alike, np.cumsum(sizes) - sizes, sizes)
    shapes = zip(truth_count.tolist(), track_count.tolist(), strict=True)
    return [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]


def _cut(column: Any, first: Indices, count: Indices) -> list[Any]:
    return [column[a : a + n] for a, n in zip(first.tolist(), count.tolist(), strict=True)]


@dataclass(frozen=True)
class Hota:
    """Higher order tracking accuracy: means over the 19 thresholds α = 0.05, 0.1, …, 0.95 (Luiten et al. (2021))."""

    hota: float | None  # √(DetA · AssA) at each threshold
    deta: float | None  # detection accuracy, TP / (TP + FN + FP)
    assa: float | None  # association accuracy: mean of TPA / (TPA + FNA + FPA) over the matches; None without any
    detre: float | None  # detection recall, TP / (TP + FN)
    detpr: float | None  # detection precision, TP / (TP + FP)
    assre: float | None  # association recall, mean of TPA / (TPA + FNA)
    asspr: float | None  # association precision, mean of TPA / (TPA + FPA)
    # Mean similarity of the matches, over the thresholds that have any. TrackEval counts 1 for the others, and so large
    # errors of boxes can look better located than small ones.
    loca: float | None
    hota_by_alpha: tuple[float, ...] | None


@dataclass(frozen=True)
class Clear:
    """CLEAR scores at the rules' threshold (Bernardin & Stiefelhagen (2008))."""

    mota: float | None  # 1 − (misses + false positives + switches) / vessel-frames; below 0 with more errors than these
    motp: float | None  # mean similarity of the matches
    id_switches: int  # times at which a vessel is followed by another track than the one before
    # Times at which a vessel is followed again after it was not. As in TrackEval, a frame without any track interrupts
    # none, and one in which the vessel is hidden does, so perfect tracks have some.
    fragmentations: int
    mostly_tracked: int  # identities that are followed in more than 80 % of their frames
    partly_tracked: int  # those in between
    mostly_lost: int  # those that are followed in less than 20 %
    true_positives: int  # matches
    misses: int  # vessel-frames without a track
    false_positives: int  # boxes of tracks on no vessel


@dataclass(frozen=True)
class Identity:
    """Scores of the best one-to-one assignment of tracks to identities (Ristani et al. (2016))."""

    idf1: float | None  # F1 of the vessel-frames that carry the right identity
    idp: float | None  # share of the tracks' boxes that do
    idr: float | None  # share of the vessel-frames that do


def by_trackeval(scored: ScoredRun) -> tuple[Hota, Clear, Identity]:
    """HOTA, CLEAR and identity scores."""
    data, least = sequence(scored), scored.rules.similarity.least
    return hota_of(data), clear_of(data, least), identity_of(data, least)


def hota_of(data: Data) -> Hota:
    """HOTA and its parts of a sequence."""
    scores = metrics().HOTA().eval_sequence(data)
    vessels, boxes = data["num_gt_dets"], data["num_tracker_dets"]
    matched = scores["HOTA_TP"] > 0

    def mean(name: str, defined: bool) -> float | None:
        return float(np.mean(scores[name])) if defined else None

    anything, any_match = vessels + boxes > 0, bool(matched.any())
    return Hota(
        hota=mean("HOTA", anything),
        deta=mean("DetA", anything),
        assa=mean("AssA", any_match),
        detre=mean("DetRe", vessels > 0),
        detpr=mean("DetPr", boxes > 0),
        assre=mean("AssRe", any_match),
        asspr=mean("AssPr", any_match),
        loca=float(np.mean(scores["LocA"][matched])) if any_match else None,
        hota_by_alpha=tuple(scores["HOTA"].tolist()) if anything else None,
    )


def clear_of(data: Data, least: float) -> Clear:
    """CLEAR scores of a sequence, from a similarity on."""
    scores = metrics().CLEAR({"THRESHOLD": least, "PRINT_CONFIG": False}).eval_sequence(data)
    vessels, matches = data["num_gt_dets"], int(scores["CLR_TP"])
    errors = int(scores["CLR_FN"] + scores["CLR_FP"] + scores["IDSW"])
    counts = ("IDSW", "Frag", "MT", "PT", "ML", "CLR_TP", "CLR_FN", "CLR_FP")
    return Clear(
        1 - errors / vessels if vessels else None,
        float(scores["MOTP"]) if matches else None,
        *(int(scores[name]) for name in counts),
    )


def identity_of(data: Data, least: float) -> Identity:
    """Identity scores of a sequence, from a similarity on: TrackEval's numbers, without its three matrices of
    (identities + tracks)², which take 2.4 GB at 10,000 tracks. What its costs are least for is the assignment of tracks
    to identities with the most boxes on each other."""
    together = np.zeros((data["num_gt_ids"], data["num_tracker_ids"]))
    for identities, tracks, alike in zip(data["gt_ids"], data["tracker_ids"], data["similarity_scores"], strict=True):
        i, j = np.nonzero(alike >= least)
        together[identities[i], tracks[j]] += 1
    right = float(together[linear_sum_assignment(together, maximize=True)].sum())
    vessels, boxes = data["num_gt_dets"], data["num_tracker_dets"]
    counts = ((vessels + boxes) / 2, boxes, vessels)
    return Identity(*(right / count if count else None for count in counts))
