"""Occlusions, and whether tracks survive them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask
from modsim3d.tracking.scores.scored_run import Histories, ScoredRun, frame_lengths_s, stretches

OCCLUDED_BELOW = 0.5  # a vessel is occluded while less than this share of its silhouette in the image is visible
BEFORE_S = 1.0  # the track before is the last that followed the vessel within this time before its occlusion
LENGTH_EDGES_S = (1, 3, 10)  # between these, occlusions are told apart by length
AFTER_S = 2.0  # the track after is the first that follows the vessel within this time after its occlusion
_TIME_DECIMALS = 6  # of differences of times that are compared: seconds since 1970 have no more


@dataclass(frozen=True)
class Survival:
    """Number of occlusions, and of those that tracks survive."""

    occlusions: int
    # Those that a track could survive: one followed the vessel in the last second before, and the vessel is scored in
    # the two seconds after.
    occlusions_judged: int
    occlusions_survived: float | None  # share of these after which the same track is the first to follow the vessel
    # Those that a tracker which misses nothing could survive: the vessel is scored in the two seconds after, and in the
    # last second before, or a track followed it there all the same.
    occlusions_to_survive: int


@dataclass(frozen=True)
class OcclusionEpisode:
    """Consecutive frames of an appearance in which less than half of the vessel is visible. Frames in which the vessel
    is too small for any pixel are passed over: nothing can be said of them."""

    camera: str
    vessel: str
    start_s: float  # time of the first of these frames
    end_s: float  # time of the camera's next frame after the last of them
    length_s: float  # from start to end
    least_visible_fraction: float  # of the silhouette
    followed_before: bool  # whether a track followed the vessel in the last second before
    track_before: int | None  # number of that track; None without one
    track_after: int | None  # number of the first track that follows it within two seconds after; None without one
    # Whether that is the same; None if no track followed before, or the vessel is not scored in the two seconds after.
    survived: bool | None


@dataclass(frozen=True, eq=False)
class OcclusionSpans:
    """The m occlusions of a matching in order of identity and time, as places in its histories; shapes (m,)."""

    histories: Histories
    first: Indices  # place of the first frame of each
    last: Indices  # place of the last one
    start_s: Array  # time of the first frame
    end_s: Array  # time of the camera's next frame after the last one
    before: Indices  # place at which the track before last followed the vessel, `NOBODY` for none
    after: Indices  # place at which the track after first follows it, `NOBODY` for none
    stays: Mask  # whether the vessel is scored within two seconds after
    expected: Mask  # whether it is scored within the second before

    @classmethod
    def of(cls, scored: ScoredRun) -> OcclusionSpans:
        """All occlusions that begin in a frame that counts."""
        past = Histories.of(scored)
        count = np.cumsum(~np.isnan(past.visible_fraction))  # a vessel without a pixel has no visible fraction
        occluded = np.flatnonzero(past.visible_fraction < OCCLUDED_BELOW)
        spans = stretches(past.identity[occluded], count[occluded])
        first, last = occluded[spans.first], occluded[spans.last]
        first, last = first[past.counted[first]], last[past.counted[first]]
        start_s = past.time_s[first]
        end_s = past.time_s[last] + frame_lengths_s(scored.rows, past.frame[last])
        before, after = past.last_before(past.followed)[first], past.first_after(past.followed)[last]
        wanted = scored.following.truth.scored[past.row]
        last_one, next_one = past.last_before(wanted)[first], past.first_after(wanted)[last]
        times_s = np.append(past.time_s, np.nan)  # the last is that of NOBODY, which no comparison finds
        before = np.where(within(start_s - times_s[before], BEFORE_S), before, NOBODY)
        after = np.where(within(times_s[after] - end_s, AFTER_S), after, NOBODY)
        stays, expected = within(times_s[next_one] - end_s, AFTER_S), within(start_s - times_s[last_one], BEFORE_S)
        return cls(past, first, last, start_s, end_s, before, after, stays, expected)

    @property
    def length_s(self) -> Array:
        """From start to end, shape (m,)."""
        length: Array = np.round(self.end_s - self.start_s, _TIME_DECIMALS)
        return length

    @property
    def judged(self) -> Mask:
        """Mask of those that a track could survive: one followed the vessel before, and she stays, shape (m,)."""
        judged: Mask = (self.before != NOBODY) & self.stays
        return judged

    @property
    def survived(self) -> Mask:
        """Mask of the judged ones that a track survived, shape (m,); it means nothing for the others."""
        track = np.append(self.histories.track, NOBODY)
        survived: Mask = track[self.before] == track[self.after]
        return survived

    def survival(self, chosen: Mask) -> Survival:
        """Number of the chosen ones, and of those that tracks survive."""
        judged = chosen & self.judged
        count = int(np.count_nonzero(judged))
        survived = float(np.mean(self.survived[judged])) if count else None
        to_survive = chosen & self.stays & (self.expected | (self.before != NOBODY))
        return Survival(int(np.count_nonzero(chosen)), count, survived, int(np.count_nonzero(to_survive)))


def within(times_s: Array, limit_s: float) -> Mask:
    """Mask of the spans of time no longer than a limit, whatever their last bits are; NaN is longer, same shape."""
    return np.less_equal(np.round(times_s, _TIME_DECIMALS), limit_s)


def survival(scored: ScoredRun) -> Survival:
    """Number of all occlusions, and of those that tracks survive."""
    spans = OcclusionSpans.of(scored)
    return spans.survival(np.ones(len(spans.first), dtype=bool))


def occlusions(scored: ScoredRun) -> tuple[OcclusionEpisode, ...]:
    """All occlusions in order of time, then of camera and vessel."""
    spans, following, scene = OcclusionSpans.of(scored), scored.following, scored.rows.scene
    truth_row = spans.histories.row[spans.first]
    frame, vessel = following.truth.frame[truth_row], following.truth.vessel[truth_row]
    fraction = spans.histories.visible_fraction
    ends = zip(spans.first.tolist(), spans.last.tolist(), strict=True)
    least = [float(np.nanmin(fraction[first : last + 1])) for first, last in ends]
    track_before, track_after = (_track_numbers(scored, spans, places) for places in (spans.before, spans.after))
    episodes = [
        OcclusionEpisode(
            scene.cameras[int(frame[k]) % scored.by_step].name,
            scene.vessel_names[vessel[k]],
            float(spans.start_s[k]),
            float(spans.end_s[k]),
            float(spans.length_s[k]),
            least[k],
            bool(spans.before[k] != NOBODY),
            track_before[k],
            track_after[k],
            bool(spans.survived[k]) if spans.judged[k] else None,
        )
        for k in range(len(least))
    ]
    return tuple(episodes[k] for k in np.lexsort((vessel, frame)).tolist())


def _track_numbers(scored: ScoredRun, spans: OcclusionSpans, places: Indices) -> Sequence[int | None]:
    """The tracker's numbers of the tracks that follow at places in the histories; None for `NOBODY`."""
    following = scored.following
    numbers = following.tracks.track
    track_row = following.track_row[spans.histories.row[places[places != NOBODY]]]
    tracks = iter(numbers[track_row].tolist())
    return [None if place == NOBODY else next(tracks) for place in places.tolist()]


@dataclass(frozen=True)
class HiddenTracks:
    """Tracks on vessels that are wholly hidden, against the box of the whole vessel."""

    hidden_vessel_frames: int  # frames of vessels of which no pixel is visible
    hidden_followed: float | None  # share of them in which a track follows the vessel
    hidden_same_track: float | None  # share in which that is the track that last followed it before it was hidden


def hidden(scored: ScoredRun) -> HiddenTracks:
    """Recall and identity on rows that are wholly hidden."""
    histories = Histories.of(scored)
    chosen = histories.hidden & histories.counted
    count = int(np.count_nonzero(chosen))
    if not count:
        return HiddenTracks(0, None, None)
    before = histories.last_before(histories.followed & ~histories.hidden)
    earlier = np.append(histories.track, NOBODY)[before]
    followed = histories.followed[chosen]
    same = followed & (histories.track == earlier)[chosen]
    return HiddenTracks(count, float(np.mean(followed)), float(np.mean(same)))
