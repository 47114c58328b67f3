"""Distances of tracks from the vessels that they follow, whether covariances say so, and distances of whole sets."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from modsim3d.core.arrays import Array, Indices, extents, ranges
from modsim3d.core.boxes import centres, errors_between
from modsim3d.tracking.scores.scored_run import ScoredRun, frame_lengths_s, stretches

_MIN_CONDITION = 1e-12


@dataclass(frozen=True)
class Errors:
    """Errors over the pairs of a scored vessel and the track that follows it; None where there is no pair."""

    error_pairs: int
    rmse_px: float | None  # root of the mean squared distance of the centres
    median_error_px: float | None  # median distance of the centres
    rmse_width_px: float | None
    rmse_height_px: float | None
    # Mean normalised estimation error squared of the centre; 2 is expected. None without covariances, infinite where
    # one is singular.
    nees: float | None
    anees: float | None  # NEES / 2, the number of its dimensions; 1 is expected
    nees_pairs: int  # with a covariance
    singular_covariances: int  # pairs whose covariance is not positive definite


def errors(scored: ScoredRun) -> Errors:
    """Errors over all pairs. Errors of consecutive frames are correlated, so the chi-square interval of NEES does not
    hold over frames: take an interval over runs."""
    vessels, tracks = scored.pairs
    following = scored.following
    error_px = errors_between(following.tracks.boxes_px[tracks], following.truth.boxes_px[vessels])
    squares = nees_or_infinity(error_px[:, :2], following.tracks.covariance_px2[tracks])
    if not len(error_px):
        return Errors(0, None, None, None, None, None, None, 0, 0)
    distance = np.hypot(error_px[:, 0], error_px[:, 1])
    given = squares[~np.isnan(squares)]
    mean = float(given.mean()) if len(given) else None
    return Errors(
        len(error_px),
        _root_mean_square(distance),
        float(np.median(distance)),
        _root_mean_square(error_px[:, 2]),
        _root_mean_square(error_px[:, 3]),
        mean,
        None if mean is None else mean / 2,
        len(given),
        int(np.isinf(given).sum()),
    )


def nees(errors: Array, covariances: Array) -> Array:
    """Normalised estimation errors squared e' P⁻¹ e (Bar-Shalom et al. (2001), equation 5.4.2-1), shape (k,). Errors,
    estimate minus truth, have shape (k, d); covariances P are positive definite, shape (k, d, d); NaN in either gives
    NaN. Jessen & Mohr (2023) misplace the transpose in equation 2.2, and leave out 1/n in that of ANEES, 2.3."""
    finite = np.isfinite(covariances).all(axis=(1, 2)) & np.isfinite(errors).all(axis=1)
    values = np.full(len(errors), np.nan)
    wanted = errors[finite, :, None]
    values[finite] = (wanted * np.linalg.solve(covariances[finite], wanted)).sum(axis=(1, 2))
    return values


def nees_or_infinity(error: Array, covariance: Array) -> Array:
    """NEES of k errors whose covariances may be singular: infinite where they are not positive definite, shape (k,).
    The smallest eigenvalue must be above 10⁻¹² of the largest. NaN where error or covariance is unknown."""
    squares = np.full(len(error), np.nan)
    given = np.flatnonzero(np.isfinite(covariance).all(axis=(1, 2)) & np.isfinite(error).all(axis=1))
    spread = np.linalg.eigvalsh(covariance[given])
    regular = (spread[:, 0] > 0) & (spread[:, 0] >= _MIN_CONDITION * spread[:, -1])
    squares[given[~regular]] = np.inf
    good = given[regular]
    squares[good] = nees(error[good], covariance[good])
    return squares


def _root_mean_square(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


class GospaParts(NamedTuple):
    """GOSPA with α = 2 and what it consists of; in one frame gospa^p = localisation + missed + false."""

    gospa: float  # the distance, in the unit of the cutoff c
    localisation: float  # sum of the p-th powers of the distances of pairs closer than c
    missed: float  # c^p / 2 for each vessel without a track closer than c
    false: float  # c^p / 2 for each track without a vessel closer than c


def gospa_frame(distance: Array, cutoff: float, power: float = 1.0) -> GospaParts:
    """GOSPA of one frame (Rahmathullah et al. (2017), definition 1 and proposition 1, with α = 2), given the distances
    of n vessels to m tracks, shape (n, m), n and m may be 0; the cutoff c > 0 in their unit; and the power p ≥ 1. A
    pair at c or beyond costs c^p, as much as a missed vessel and a false track, and is counted as these."""
    vessels, tracks = distance.shape
    close = _paired(distance, cutoff, power)
    close = close[close < cutoff]
    alone = cutoff**power / 2
    parts = float((close**power).sum()), alone * (vessels - len(close)), alone * (tracks - len(close))
    return GospaParts(sum(parts) ** (1 / power), *parts)


def ospa_frame(distance: Array, cutoff: float, power: float = 1.0) -> float:
    """OSPA of one frame (Schuhmacher et al. (2008)), at most the cutoff; 0 for two empty sets; arguments as in
    `gospa_frame`."""
    more, fewer = max(distance.shape), min(distance.shape)
    if not more:
        return 0.0
    paired = float((_paired(distance, cutoff, power) ** power).sum())
    return float(((paired + cutoff**power * (more - fewer)) / more) ** (1 / power))


def mean_gospa(distances: Iterable[Array], cutoff: float, power: float = 1.0) -> GospaParts | None:
    """Means over frames of GOSPA and of each part, which add up to it if p = 1; None without frames. With p > 1 the
    parts are means of p-th powers, and GOSPA the mean of p-th roots, so they do not add up."""
    frames = [gospa_frame(distance, cutoff, power) for distance in distances]
    return GospaParts(*np.mean(frames, axis=0).tolist()) if frames else None


def mean_ospa(distances: Iterable[Array], cutoff: float, power: float = 1.0) -> float | None:
    """Mean of OSPA over frames; None without frames."""
    frames = [ospa_frame(distance, cutoff, power) for distance in distances]
    return float(np.mean(frames)) if frames else None


def distances(vessels: Array, tracks: Array) -> Array:
    """Euclidean distances of points (n, 2) and (m, 2), shape (n, m)."""
    offset = vessels[:, None] - tracks
    return np.hypot(offset[..., 0], offset[..., 1])


def _paired(distance: Array, cutoff: float, power: float) -> Array:
    """min(d, c) of the pairs of the assignment with the smallest sum of p-th powers, shape (min(n, m),)."""
    cut = np.minimum(distance, cutoff)
    costs: Array = cut[linear_sum_assignment(cut**power)]
    return costs


@dataclass(frozen=True)
class Gospa:
    """Means over frames of GOSPA with α = 2, in pixels, and of what its parts add, in px^p; None without frames."""

    gospa: float | None
    gospa_localisation: float | None  # the errors of centres
    gospa_missed: float | None
    gospa_false: float | None


@dataclass(frozen=True)
class Ospa:
    """Mean over frames of OSPA, in pixels; None without frames."""

    ospa: float | None


def gospa(scored: ScoredRun) -> Gospa:
    """GOSPA of the centres of boxes, mean over all frames; one without vessels and tracks counts 0. The formula is that
    of `gospa_frame`. Parts are means of p-th powers: with p = 1 they add up to GOSPA."""
    rule = scored.rules.set_distance
    parts = mean_gospa(_frames(scored), rule.cutoff, rule.power)
    return Gospa(*parts) if parts else Gospa(None, None, None, None)


def ospa(scored: ScoredRun) -> Ospa:
    """OSPA of the centres of boxes, mean over all frames, by `ospa_frame`; one without vessels and tracks counts 0."""
    rule = scored.rules.set_distance
    return Ospa(mean_ospa(_frames(scored), rule.cutoff, rule.power))


def _frames(scored: ScoredRun) -> Iterator[Array]:
    """Distances in pixels of the vessels' and the tracks' centres in each frame, shapes (n, m)."""
    vessels, tracks = scored.truth, scored.tracks
    a_px, b_px = centres(vessels.boxes_px), centres(tracks.boxes_px)
    places = (column.tolist() for side in (vessels, tracks) for column in extents(side.frame, scored.frames))
    for a, n, b, m in zip(*places, strict=True):
        yield distances(a_px[a : a + n], b_px[b : b + m])


_TIME_DECIMALS = 9  # sums of times in another order differ in their last bits: they are rounded to so many decimals


@dataclass(frozen=True)
class Siap:
    """Attributes of the single integrated air picture, over all frames; None where there is nothing to divide by."""

    siap_completeness: float | None  # share of vessels, counted in each frame, with a track
    siap_ambiguity: float | None  # tracks for each vessel that has one
    siap_spuriousness: float | None  # share of tracks, counted in each frame, without a vessel
    siap_positional_accuracy_px: float | None  # mean distance of a track's centre from that of its vessel
    # Changes of the track that one has to make to stay on each vessel, as few as possible, for each second in which the
    # vessel has a track.
    siap_id_changes_per_s: float | None
    # The longest stretch that one track stays on each vessel without a break, over her time, sums over vessels.
    siap_longest_track_share: float | None


def siap(scored: ScoredRun) -> Siap:
    """Assign each track in each frame to the vessel that it is most similar to, if it is similar enough: not the one
    matching of the other scores. A track that is assigned to a vessel that is not scored is left out. A track that
    loses its vessel and finds it again is no change, but two stretches; in Stone Soup 1.9.1 it is a change and one
    stretch."""
    following = scored.following
    vessel, track, spurious = _assigned(scored)
    scored_vessels = len(scored.truth_rows)
    followed = len(np.unique(vessel))
    error_px = centres(following.tracks.boxes_px[track]) - centres(following.truth.boxes_px[vessel])
    place, length_s = _places(scored)
    identity = following.truth.identity[vessel]
    changes = _changes(identity, following.truth.frame[vessel], following.tracks.identity[track])
    longest_s = _longest_s(identity, place[vessel], following.tracks.identity[track], length_s)
    return Siap(
        _ratio(followed, scored_vessels),
        _ratio(len(vessel), followed),
        _ratio(spurious, len(vessel) + spurious),
        _ratio(float(np.hypot(error_px[:, 0], error_px[:, 1]).sum()), len(vessel)),
        _ratio(changes, float(length_s[np.unique(place[vessel])].sum())),
        _ratio(round(longest_s, _TIME_DECIMALS), round(float(length_s.sum()), _TIME_DECIMALS)),
    )


def _assigned(scored: ScoredRun) -> tuple[Indices, Indices, int]:
    """Rows of the scored vessels to which tracks are assigned and of these, shapes (a,); number of tracks to none."""
    truth, tracks, similarity = scored.following.truth, scored.following.tracks, scored.following.similarity
    rows = np.flatnonzero(np.isin(tracks.frame, scored.frames))
    first, count = extents(truth.frame, tracks.frame[rows])
    vessel, track = ranges(first, count), np.repeat(rows, count)
    alike = similarity(truth.boxes_px[vessel], tracks.boxes_px[track])
    other = scored.following.truth_row[track] != vessel  # decides where two vessels are as similar as each other
    order = np.lexsort((vessel, other, ~truth.scored[vessel], -alike, track))
    order = order[alike[order] >= similarity.least - np.finfo(float).eps]
    _, best = np.unique(track[order], return_index=True)
    vessel, track = vessel[order[best]], track[order[best]]
    counted = truth.scored[vessel]
    return vessel[counted], track[counted], len(rows) - len(track)


def _places(scored: ScoredRun) -> tuple[Indices, Array]:
    """Place of each vessel's row among the scored ones by identity and frame, shape (n,), and their times, (p,)."""
    truth, rows = scored.following.truth, scored.truth_rows
    rows = rows[np.lexsort((truth.frame[rows], truth.identity[rows]))]
    place = np.full(len(truth), -1)
    place[rows] = np.arange(len(rows))
    return place, frame_lengths_s(scored.rows, truth.frame[rows])


def _changes(identity: Indices, frame: Indices, track: Indices) -> int:
    """The least number of changes of the track over the frames in which each identity has one; arguments (a,). It is
    best to take the track that stays longest, and at its end again."""
    tracked, place = np.unique(np.column_stack([identity, frame]), axis=0, return_inverse=True)
    group, place = _by_track(identity, track, place.reshape(-1))
    stays = stretches(group, place)
    last_place = np.arange(len(tracked))  # to which a track that is there at a place stays at most
    np.maximum.at(last_place, place, np.repeat(place[stays.last], stays.last - stays.first + 1))
    taken, next_place = 0, 0
    while next_place < len(last_place):  # each turn is a track that is taken, not a row
        taken, next_place = taken + 1, int(last_place[next_place]) + 1
    return taken - len(np.unique(identity))


def _longest_s(identity: Indices, place: Indices, track: Indices, length_s: Array) -> float:
    """Sum over identities of the longest time that one track stays on them. For each assignment, `identity` is that of
    the vessel, `place` that of its row in the times, and `track` the identity of the track, shapes (a,); `length_s` is
    the time that each place stands for, shape (p,)."""
    vessel = np.zeros(len(length_s), dtype=np.int64)
    vessel[place] = identity
    group, place = _by_track(identity, track, place)
    spans, before_s = stretches(group, place), np.append(0, np.cumsum(length_s))
    stretch_s = before_s[place[spans.last] + 1] - before_s[place[spans.first]]
    longest_s = np.zeros(int(identity.max(initial=-1)) + 1)
    np.maximum.at(longest_s, vessel[place[spans.first]], stretch_s)
    return float(longest_s.sum())


def _by_track(identity: Indices, track: Indices, place: Indices) -> tuple[Indices, Indices]:
    """Number of each pair of a vessel and a track and the places, in order of pair and place, shapes (a,)."""
    _, group = np.unique(np.column_stack([identity, track]), axis=0, return_inverse=True)
    order = np.lexsort((place, group.reshape(-1)))
    return group.reshape(-1)[order], place[order]


def _ratio(part: float, whole: float) -> float | None:
    return part / whole if whole else None
