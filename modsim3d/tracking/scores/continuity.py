"""Times until vessels are followed, how often and how long they are lost, and tracks of nothing. The list is that of
Helgesen et al. (2022), as in Jessen & Mohr (2023), section 2.3.1."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.tracking.scores.scored_run import ScoredRun, frame_lengths_s, stretches

_HOUR_S = 3600.0


@dataclass(frozen=True)
class Continuity:
    """Continuity of tracks over each vessel's appearances, in scored frames; None where there is nothing to average. A
    break is a stretch in which an established vessel is not followed before it is followed again. Frames in which the
    vessel is hidden or not expected to be followed belong to no break and add no time. A false track never follows a
    vessel, not even one that is not scored."""

    appearances: int  # with a scored frame
    established: int  # those that are followed in at least one such frame
    established_share: float | None  # established / appearances
    time_to_establish_s: float | None  # mean, from the first scored frame to the first in which it is followed
    longest_time_to_establish_s: float | None
    tracks_per_vessel: float | None  # mean number of different tracks that followed an established appearance
    track_breaks: int
    track_break_s: float  # total length of breaks
    mean_track_break_s: float | None
    longest_track_break_s: float | None
    track_breaks_per_hour: float | None  # for each hour of established vessels
    lost: int  # established appearances that are not followed in their last scored frame
    lost_s: float  # their total time after the last frame in which they are followed
    false_tracks: int
    false_track_s: float  # their total length, of the frames in which they are reported
    mean_false_track_s: float | None
    false_tracks_per_hour: float | None  # for each hour of a camera


class _Appearances(NamedTuple):
    """Scored frames of vessels by identity and frame: n rows."""

    identity: Indices
    time_s: Array  # of the frame since the first step
    followed: Mask
    length_s: Array  # time that the frame stands for


def continuity(scored: ScoredRun) -> Continuity:
    """Continuity of the tracks of scored vessels, and false tracks."""
    rows = _appearances(scored)
    waits_s = _times_to_establish_s(rows)
    appearances, established = len(np.unique(rows.identity)), len(waits_s)
    breaks_s, lost_s, established_s = _times_not_followed(rows)
    false_s = false_track_lengths_s(scored)
    vessels, tracks = scored.pairs
    pairs = np.column_stack([scored.following.truth.identity[vessels], scored.following.tracks.identity[tracks]])
    cameras_s = float(frame_lengths_s(scored.rows, scored.frames).sum())
    return Continuity(
        appearances=appearances,
        established=established,
        established_share=established / appearances if appearances else None,
        time_to_establish_s=_mean(waits_s),
        longest_time_to_establish_s=_longest(waits_s),
        tracks_per_vessel=len(np.unique(pairs, axis=0)) / established if established else None,
        track_breaks=len(breaks_s),
        track_break_s=float(breaks_s.sum()),
        mean_track_break_s=_mean(breaks_s),
        longest_track_break_s=_longest(breaks_s),
        track_breaks_per_hour=len(breaks_s) / established_s * _HOUR_S if established_s else None,
        lost=len(lost_s),
        lost_s=float(lost_s.sum()),
        false_tracks=len(false_s),
        false_track_s=float(false_s.sum()),
        mean_false_track_s=_mean(false_s),
        false_tracks_per_hour=len(false_s) / cameras_s * _HOUR_S if cameras_s else None,
    )


def _times_to_establish_s(rows: _Appearances) -> Array:
    """From the first frame of each established appearance to the first in which it is followed, shape (e,)."""
    identity, start = np.unique(rows.identity, return_index=True)
    established, followed = np.unique(rows.identity[rows.followed], return_index=True)
    first_s = rows.time_s[start][np.searchsorted(identity, established)]
    waits_s: Array = rows.time_s[rows.followed][followed] - first_s
    return waits_s


def false_track_lengths_s(scored: ScoredRun) -> Array:
    """Time for which each track is reported that never follows a vessel, in order of camera and track, shape (f,)."""
    following = scored.following
    identity = following.tracks.identity
    ever = np.unique(identity[~following.false])
    rows = np.flatnonzero(np.isin(following.tracks.frame, scored.frames) & ~np.isin(identity, ever))
    _, track = np.unique(identity[rows], return_inverse=True)
    return _sums(track.reshape(-1), frame_lengths_s(scored.rows, following.tracks.frame[rows]))


def _appearances(scored: ScoredRun) -> _Appearances:
    truth, rows = scored.following.truth, scored.truth_rows
    rows = rows[np.lexsort((truth.frame[rows], truth.identity[rows]))]
    frame = truth.frame[rows]
    times_s, lengths_s = scored.times_s[frame // scored.by_step], frame_lengths_s(scored.rows, frame)
    return _Appearances(truth.identity[rows], times_s, scored.following.found[rows], lengths_s)


def _times_not_followed(rows: _Appearances) -> tuple[Array, Array, float]:
    """Lengths of breaks, times of vessels after they were followed last where there is any, and total of all
    established time: from the first followed frame on."""
    _, group = np.unique(rows.identity, return_inverse=True)
    group = group.reshape(-1)
    place, count = np.arange(len(group)), int(group.max(initial=-1)) + 1
    first, last = np.full(count, len(group)), np.full(count, -1)
    np.minimum.at(first, group[rows.followed], place[rows.followed])
    np.maximum.at(last, group[rows.followed], place[rows.followed])
    missed = np.flatnonzero(~rows.followed & (place > first[group]) & (place < last[group]))
    spans, before_s = stretches(group[missed], missed), np.append(0, np.cumsum(rows.length_s))
    breaks_s = before_s[missed[spans.last] + 1] - before_s[missed[spans.first]]
    after = (place > last[group]) & (last[group] >= 0)
    lost_s = _sums(group[after], rows.length_s[after], count)
    lost_s = lost_s[np.bincount(group[after], minlength=count) > 0]
    return breaks_s, lost_s, float(rows.length_s[place >= first[group]].sum())


def _sums(group: Indices, values: Array, groups: int = 0) -> Array:
    return np.asarray(np.bincount(group, values, groups), dtype=np.float64)


def _mean(values: Array) -> float | None:
    return float(values.mean()) if len(values) else None


def _longest(values: Array) -> float | None:
    return float(values.max()) if len(values) else None
