"""Recall and association broken down by what only a simulator knows. Tracks are matched once, with everything. Then
rows of the truth are averaged. To delete the other rows and match again would be wrong: the tracks on them would become
false positives. A false positive has no visibility, no range and no state of occlusion, so nothing here counts them."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from itertools import pairwise

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask, ranges
from modsim3d.core.boxes import areas
from modsim3d.tracking.scores.occlusions import LENGTH_EDGES_S, OcclusionSpans, Survival, within
from modsim3d.tracking.scores.scored_run import ScoredRun

NEAR_S = 2.0  # so long before and after an occlusion is a phase of its own
PHASES = ("before", "during", "after", "elsewhere")  # of an occlusion
RANGE_EDGES_M, SIZE_EDGES_PX = (100, 200, 400, 800), (16, 32, 64, 128)


def _intervals(edges: Sequence[int]) -> tuple[str, ...]:
    return (*(f"{low} to {high}" for low, high in pairwise((0, *edges))), f"{edges[-1]} and more")


BINS = {
    "visible_fraction": ("1", "0.75 to 1", "0.5 to 0.75", "0.25 to 0.5", "below 0.25"),
    "occlusion": _intervals(LENGTH_EDGES_S),
    "range": _intervals(RANGE_EDGES_M),
    "size": _intervals(SIZE_EDGES_PX),
}
"""Groups whose bins are the same in every run, with the names of the bins."""


@dataclass(frozen=True)
class Bin:
    """Some vessel-frames."""

    bin: str  # what they have in common
    vessel_frames: int  # their number
    recall: float | None  # share of them that a track follows; None if there are none
    association: float | None  # mean of those that are followed, as in `association_of_pairs`; None if none is
    occlusions: int | None = None  # that they belong to; None outside the group of occlusions
    judged: int | None = None  # those that a track could survive, as in `Survival`
    survived: float | None = None  # share of the judged ones that a track survived; None if there are none
    to_survive: int | None = None  # those that a tracker which misses nothing could survive, as in `Survival`


@dataclass(frozen=True)
class Group:
    """The vessel-frames divided by one property."""

    name: str
    explanation: str  # what the property is, with its unit
    rows: tuple[Bin, ...]  # the bins that have vessel-frames


Breakdown = tuple[Group, ...]


@dataclass(frozen=True, eq=False)
class _FollowedFrames:
    """The n vessel-frames that are scored: whether a track follows the vessel, and its association, NaN where none
    does; shapes (n,)."""

    found: Mask
    association: Array

    def bin(self, name: str, chosen: Mask, survival: Survival | None = None) -> Bin:
        matches = self.found[chosen]
        association = self.association[chosen][matches]
        return Bin(
            name,
            len(matches),
            float(np.mean(matches)) if len(matches) else None,
            float(np.mean(association)) if len(association) else None,
            *(astuple(survival) if survival else ()),
        )

    def bins(self, names: Sequence[str], index: Indices) -> tuple[Bin, ...]:
        """A bin for each name; rows whose index is none of a name are left out."""
        bins = (self.bin(name, index == k) for k, name in enumerate(names))
        return tuple(score_bin for score_bin in bins if score_bin.vessel_frames)


def breakdown(scored: ScoredRun) -> Breakdown:
    """The scored vessel-frames by visibility, occlusion, state, range, size, edge of the image and label."""
    rows, truth = scored.rows, scored.truth
    followed = _FollowedFrames(*association_of_pairs(scored))
    names = ("visible_fraction", "depth_m", "in_frame_fraction")
    visible, depth_m, in_frame = (rows.numbers(name)[truth.row] for name in names)
    side_px = np.sqrt(areas(truth.boxes_px))
    detector, cut = rows.scene.detector, "whether the edge of the image cuts the vessel"
    states = [state.name for state in detector.states]
    visibility = "share of the vessel's silhouette in the image that is visible"
    edge = (~(in_frame >= 1)).astype(np.int64)  # it is unknown where the near plane cuts the vessel
    if rows.scene.labels is not None:
        edge[np.isnan(in_frame)] = NOBODY
    groups = {
        "visible_fraction": (visibility, BINS["visible_fraction"], _visibility(visible)),
        "range": ("mean distance along the axis of the camera, m", BINS["range"], _places(depth_m, RANGE_EDGES_M)),
        "size": ("side of a square as large as the true box, px", BINS["size"], _places(side_px, SIZE_EDGES_PX)),
        "edge": (cut, ("whole in the image", "cut by the edge"), edge),
        "state": ("performance state of the detector", states, rows.states_of(truth.frame)),
        "label": ("true class of the vessel", detector.labels, truth.label),
    }
    parts = tuple(Group(name, text, followed.bins(names, index)) for name, (text, names, index) in groups.items())
    return (parts[0], *_by_occlusion(scored, followed), *parts[1:])


def association_of_pairs(scored: ScoredRun) -> tuple[Mask, Array]:
    """Mask of the vessels that are followed, and A(c) = TPA / (TPA + FNA + FPA) of those, shapes (n,). Luiten et al.
    (2021), eq. 1: TPA counts the frames in which the same track follows the same vessel, FNA all others of the vessel,
    FPA all others of the track; here of one matching at the rules' threshold."""
    following, truth = scored.following, scored.truth
    tracks = scored.following.tracks.identity
    track_row = following.track_row[scored.truth_rows]
    matches, association = track_row != NOBODY, np.full(len(truth), np.nan)
    pairs = np.column_stack([truth.identity[matches], tracks[track_row[matches]]])
    _, pair, together = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
    both = together[pair.reshape(-1)]
    of_vessel, of_track = np.bincount(truth.identity), np.bincount(tracks[scored.track_rows])
    association[matches] = both / (of_vessel[pairs[:, 0]] + of_track[pairs[:, 1]] - both)
    return matches, association


def _visibility(fraction: Array) -> Indices:
    """0 for all visible, then quarters; `NOBODY` where it is unknown."""
    below = np.array([1.0, 0.75, 0.5, 0.25])
    index: Indices = np.where(np.isnan(fraction), NOBODY, (fraction[:, None] < below).sum(axis=1))
    return index


def _places(values: Array, edges: Sequence[int]) -> Indices:
    """Index of the interval of each value, `NOBODY` where it is unknown; an edge belongs to the interval above it."""
    index: Indices = np.where(np.isnan(values), NOBODY, np.searchsorted(np.array(edges), values, side="right"))
    return index


def _by_occlusion(scored: ScoredRun, followed: _FollowedFrames) -> tuple[Group, Group]:
    """The vessel-frames by phase of an occlusion, and those during one by its length."""
    spans = OcclusionSpans.of(scored)
    during, phase = _phases(scored, spans)
    length = _places(spans.length_s, LENGTH_EDGES_S)
    of_row = np.append(length, NOBODY)[during]  # the last is that of NOBODY
    bins = (
        followed.bin(name, of_row == index, spans.survival(length == index))
        for index, name in enumerate(BINS["occlusion"])
        if (length == index).any()
    )
    phases = f"less than half of the vessel is visible, or it is in the {NEAR_S:g} s before or after; after goes first"
    lengths = "length of the occlusion, s; vessel-frames in which the vessel is occluded, but not wholly"
    return Group("phase", phases, followed.bins(PHASES, phase)), Group("occlusion", lengths, tuple(bins))


def _phases(scored: ScoredRun, spans: OcclusionSpans) -> tuple[Indices, Indices]:
    """The occlusion during which each of n rows is, `NOBODY` for none, and its phase, shapes (n,)."""
    past, count = spans.histories, spans.last - spans.first + 1
    during = np.full(len(past.row), NOBODY)
    during[ranges(spans.first, count)] = np.repeat(np.arange(len(count)), count)
    occluded = during != NOBODY
    start_s, end_s = (np.append(times_s, np.nan) for times_s in (spans.start_s, spans.end_s))
    next_one, last_one = (np.append(during, NOBODY)[place(occluded)] for place in (past.first_after, past.last_before))
    before, after = within(start_s[next_one] - past.time_s, NEAR_S), within(past.time_s - end_s[last_one], NEAR_S)
    phase = np.select([occluded, after, before], [1, 2, 0], 3)  # places in PHASES
    place = np.empty(len(past.row), dtype=np.int64)
    place[past.row] = np.arange(len(past.row))
    chosen = place[scored.truth_rows]
    return during[chosen], phase[chosen]
