"""Reference for tracks: the vessels in the images, each appearance of one as an identity."""

from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
from scipy.optimize import linear_sum_assignment

from modsim3d.core.arrays import NOBODY, Array, Columns, Indices, Mask, extents, ranges
from modsim3d.core.boxes import areas, intersections, iou
from modsim3d.runs.files.tables import indices
from modsim3d.runs.run_rows import RunRows
from modsim3d.tracks.tracks import Similarity, Tracks
from modsim3d.world.poses.labelled import IgnoredRegions

TruthName = Literal["annotated", "full"]
DEFAULT_GAP_S = 2.0  # after so long outside the image a vessel that comes back is a new identity
_TIME_S = 1e-6  # times are differences of rounded ones: an absence as long as the gap is no longer one


@dataclass(frozen=True, eq=False)
class TrueTracks(Columns):
    """The vessels in the images of a run: n rows in order of frame and vessel. A vessel of which no pixel is visible is
    there with the box of the whole vessel, and not scored: a track that stays on it is neither right nor wrong."""

    cameras: int  # number of cameras of the run
    row: Indices  # of the truth table: (n,)
    frame: Indices  # number of the frame, as in `RunRows`: (n,)
    vessel: Indices  # index of the vessel: (n,)
    identity: Indices  # number of the appearance, of one vessel in one camera, without a gap outside the image: (n,)
    label: Indices  # index of the vessel's true label: (n,)
    boxes_px: Array  # x_min, y_min, x_max, y_max: (n, 4)
    scored: Mask  # whether a tracker is expected to follow it here: (n,)
    hidden: Mask  # whether other things hide all of it: (n,)

    @classmethod
    def of(cls, rows: RunRows, truth: TruthName = "annotated", gap_s: float = DEFAULT_GAP_S) -> Self:
        """The truth of a run. `annotated`: the vessels that the detector was given, with the boxes of the annotation
        mode, and all others in the image as not scored; `full`: all vessels, with the boxes around all of each. After
        `gap_s` outside the image a vessel that comes back is a new identity."""
        visible_px, silhouette_px = rows.numbers("visible_px"), rows.numbers("silhouette_px")
        unseen = visible_px == 0  # where it is unknown what is visible, nothing is taken as hidden
        scored, boxes_px = ~unseen, rows.boxes_px("full")
        if truth == "annotated":
            scored = scored & rows.annotated
            boxes_px = np.where(scored[:, None], rows.annotated_boxes_px, boxes_px)
        order = np.lexsort((rows.truth_vessel, rows.truth_frame))
        identity, label = appearances(rows, gap_s), indices(rows.truth, "label", rows.scene.detector.labels)
        hidden = unseen & (silhouette_px > 0)
        keys = np.arange(len(order)), rows.truth_frame, rows.truth_vessel, identity, label
        return cls(len(rows.scene.cameras), *keys, boxes_px, scored, hidden).take(order)


def appearances(rows: RunRows, gap_s: float) -> Indices:
    """Number of the appearance of each row of the truth: (n,). An appearance ends when the vessel leaves the image for
    longer than the gap, not when something hides it."""
    cameras, times_s = len(rows.scene.cameras), rows.scene.times_s(0, rows.steps)
    camera, step = rows.truth_frame % cameras, rows.truth_frame // cameras
    frame_of_camera = np.empty(len(step), dtype=np.int64)
    for index in range(cameras):
        taken = rows.frames[rows.frames % cameras == index]
        here = camera == index
        frame_of_camera[here] = np.searchsorted(taken, rows.truth_frame[here])
    order = np.lexsort((step, rows.truth_vessel, camera))
    other = (np.diff(camera[order]) != 0) | (np.diff(rows.truth_vessel[order]) != 0)
    away = (np.diff(frame_of_camera[order]) > 1) & (np.diff(times_s[step[order]]) > gap_s + _TIME_S)
    numbers = np.zeros(len(order), dtype=np.int64)
    numbers[order[1:]] = np.cumsum(other | away)
    return numbers


_SAME_AS_BEFORE = 1000.0  # what a pair of the frame before gains, as in CLEAR MOT (Bernardin & Stiefelhagen (2008))


@dataclass(frozen=True, eq=False)
class TrackMatching:
    """The one matching of tracks and truth that all scores by rows are taken from. In each frame vessels and tracks are
    assigned so that as many pairs of the frame before as possible stay, and then the sum of similarities is largest.
    Vessels that are not scored take part: a track that follows one is not counted."""

    truth: TrueTracks  # n rows
    tracks: Tracks  # k rows
    similarity: Similarity
    track_row: Indices  # row of the track that follows each vessel, `NOBODY` for none: (n,)
    truth_row: Indices  # row of the vessel that each track follows, `NOBODY` for none: (k,)
    ignored: Mask  # tracks that follow nothing, where that is not to be counted: (k,)

    @property
    def counted(self) -> Mask:
        """Mask of the rows of the tracks that are scored: all but those on a vessel that is not, and those in a region
        that is to be ignored, shape (k,)."""
        counted: Mask = np.append(self.truth.scored, True)[self.truth_row] & ~self.ignored  # the last is NOBODY's
        return counted

    @property
    def false(self) -> Mask:
        """Mask of the rows of the tracks that follow nothing, shape (k,)."""
        return np.equal(self.truth_row, NOBODY) & ~self.ignored

    @property
    def found(self) -> Mask:
        """Mask of the vessels that are followed, shape (n,)."""
        return np.not_equal(self.track_row, NOBODY)


_HALF = 0.5


def _in_regions(tracks: Tracks, rows: Indices, regions: IgnoredRegions, cameras: int) -> Mask:
    """Mask of the tracks that lie in a region that is to be ignored, of some rows (m,), shape (k,): half of the box in
    a crowd, or with IoU of a half with another."""
    inside = np.zeros(len(tracks), dtype=bool)
    first, count = extents(regions.step * cameras + regions.camera, tracks.frame[rows])
    row, region = rows.repeat(count), ranges(first, count)
    boxes_px, region_px = tracks.boxes_px[row], regions.boxes_px[region]
    in_crowd = regions.crowd[region] & (intersections(boxes_px, region_px) >= _HALF * areas(boxes_px))
    inside[row[in_crowd | (iou(boxes_px, region_px) >= _HALF)]] = True
    return inside


def follow(
    truth: TrueTracks, tracks: Tracks, similarity: Similarity, regions: IgnoredRegions | None = None
) -> TrackMatching:
    """Assign tracks to vessels in each frame. Of those that follow nothing, the ones in `regions` are ignored."""
    track_row, truth_row = np.full(len(truth), NOBODY), np.full(len(tracks), NOBODY)
    before: dict[int, dict[int, int]] = {}  # camera: track that followed each identity in the camera's frame before
    frames = np.union1d(truth.frame, tracks.frame)
    places = (column.tolist() for side in (truth, tracks) for column in extents(side.frame, frames))
    for frame, first_truth, vessels, first_track, boxes in zip(frames.tolist(), *places, strict=True):
        a, b = first_truth + np.arange(vessels), first_track + np.arange(boxes)
        if not len(a) or not len(b):
            continue  # as in TrackEval: such a frame lies between two frames and is not the one before
        last = before.get(frame % truth.cameras, {})
        wanted = np.array([last.get(identity, NOBODY) for identity in truth.identity[a].tolist()], dtype=np.int64)
        alike = similarity(truth.boxes_px[a, None], tracks.boxes_px[b])
        i, j = best_pairs(alike, similarity.least, wanted[:, None] == tracks.identity[b])
        track_row[a[i]], truth_row[b[j]] = b[j], a[i]
        followed, by = truth.identity[a[i]].tolist(), tracks.identity[b[j]].tolist()
        before[frame % truth.cameras] = dict(zip(followed, by, strict=True))
    false, ignored = np.flatnonzero(truth_row == NOBODY), np.zeros(len(tracks), dtype=bool)
    if regions is not None and len(regions):
        ignored = _in_regions(tracks, false, regions, truth.cameras)
    return TrackMatching(truth, tracks, similarity, track_row, truth_row, ignored)


def best_pairs(alike: Array, least: float, kept: Mask) -> tuple[Indices, Indices]:
    """Rows and columns of the pairs with at least the similarity `least` in the best assignment of a similarity matrix
    (a, b). `kept` are pairs that are preferred to all others: (a, b)."""
    enough = alike >= least - np.finfo(float).eps
    score = np.where(enough, alike + _SAME_AS_BEFORE * kept, 0)
    i, j = linear_sum_assignment(score, maximize=True)
    good = enough[i, j]
    return i[good], j[good]
