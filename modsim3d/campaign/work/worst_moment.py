"""The moment at which a run went wrong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask
from modsim3d.tracking.scores.scored import Scored, frame_lengths_s

WINDOW_S = 5.0  # as long as a look at what happens in a film
LOST, FALSE, SWITCHED = range(3)
_DECIMALS = 6  # of sums of seconds that are compared: below that they differ by rounding only


@dataclass(frozen=True, eq=False)
class Mistakes:
    """Mistakes of a tracker in a run: n of them in order of time. `LOST`: a vessel that should be followed is not.
    `FALSE`: a track follows nothing. `SWITCHED`: a vessel is followed by another track than last. Of the first two
    kinds `seconds` is the time that the frame stands for; of a switch the whole window, since whoever watches that
    track has lost the vessel. Nothing counts while a vessel is new: it was never followed, and came less than a window
    ago."""

    kind: Indices  # shape (n,)
    frame: Indices  # number as in `RunRows`, shape (n,)
    seconds: Array  # what it counts, shape (n,)
    boxes_px: Array  # of the vessel, or of the track that follows nothing, shape (n, 4)
    vessel: Indices  # its index, `NOBODY` of a track that follows nothing, shape (n,)
    before: Indices  # number of the track that followed the vessel before a switch, else `NOBODY`, shape (n,)
    after: Indices  # number of the track that does so from the switch on, else `NOBODY`, shape (n,)

    @classmethod
    def of(cls, scored: Scored) -> Mistakes:
        """The mistakes in the frames that are scored."""
        following, truth_rows = scored.following, scored.truth_rows
        truth, tracks = following.truth, following.tracks
        lost = truth_rows[~following.found[truth_rows]]
        false = scored.track_rows[following.false[scored.track_rows]]
        switched, before, after = _switches(scored)
        frame = np.concatenate([truth.frame[lost], tracks.frame[false], truth.frame[switched]])
        seconds = frame_lengths_s(scored.rows, frame)
        seconds[: len(lost)][_new(scored)[lost]] = 0
        seconds[len(lost) + len(false) :] = WINDOW_S
        nobody = np.full(len(lost) + len(false), NOBODY)
        every = cls(
            np.repeat([LOST, FALSE, SWITCHED], [len(lost), len(false), len(switched)]),
            frame,
            seconds,
            np.concatenate([truth.boxes_px[lost], tracks.boxes_px[false], truth.boxes_px[switched]]),
            np.concatenate([truth.vessel[lost], nobody[: len(false)], truth.vessel[switched]]),
            np.concatenate([nobody, before]),
            np.concatenate([nobody, after]),
        )
        return every._take(np.argsort(frame, kind="stable"))

    def in_frame(self, frame: int) -> Mistakes:
        """Mistakes in one frame, by its number."""
        return self._take(np.flatnonzero(self.frame == frame))

    def _take(self, rows: Indices) -> Mistakes:
        return Mistakes(**{name: column[rows] for name, column in vars(self).items()})


def _new(scored: Scored) -> Mask:
    """Mask of the matching's vessels that came less than a window ago and were never followed before, shape (n,).
    Trackers wait for some detections before they report a track: all of them lose all vessels when a run begins."""
    truth, rows = scored.following.truth, scored.truth_rows
    time_s, followed = scored.times_s[truth.frame // scored.by_step], scored.pairs[0]
    until_s = np.full(int(truth.identity.max(initial=-1)) + 1, np.inf)
    np.minimum.at(until_s, truth.identity[rows], time_s[rows] + WINDOW_S)
    np.minimum.at(until_s, truth.identity[followed], time_s[followed])
    return np.less(time_s, until_s[truth.identity] - 1e-6)


def _switches(scored: Scored) -> tuple[Indices, Indices, Indices]:
    """Rows of the matching's vessels at which an appearance is followed by another track than last; the number of the
    last track, and that of the other one, each of shape (s,)."""
    truth, tracks, (rows, track_rows) = scored.following.truth, scored.following.tracks, scored.pairs
    order = np.lexsort((truth.frame[rows], truth.identity[rows]))
    rows, track_rows = rows[order], track_rows[order]
    switched = (np.diff(truth.identity[rows]) == 0) & (np.diff(tracks.identity[track_rows]) != 0)
    number = tracks.track[track_rows]
    return rows[1:][switched], number[:-1][switched], number[1:][switched]


def worst_moment_s(scored: Scored) -> float | None:
    """The moment at which a run went wrong, as its timestamps have it; None if nothing is wrong in it. Of all stretches
    of 5 s it is the one with most mistakes, in all cameras together: vessel-seconds in which a vessel is lost,
    track-seconds in which a track follows nothing, and 5 s for each identity switch. See `Mistakes`. The moment is the
    median of the mistakes in that stretch, so that there is one to see. Of equal stretches it is the first."""
    mistakes = Mistakes.of(scored)
    if not len(mistakes.frame):
        return None
    time_s = scored.times_s[mistakes.frame // scored.by_step]
    before_s = np.append(0.0, np.cumsum(mistakes.seconds))
    stop = np.searchsorted(time_s, time_s + WINDOW_S - 1e-6)
    first = int(np.argmax(np.round(before_s[stop] - before_s[:-1], _DECIMALS)))
    half_s = (before_s[first] + before_s[stop[first]]) / 2
    median = int(np.searchsorted(before_s[1:], half_s - 1e-9))  # the row in which the sum passes it
    step = int(mistakes.frame[median]) // scored.by_step
    return float(scored.rows.scene.timestamps(step, step + 1)[0])


def step_at(scored: Scored, moment_s: float) -> int:
    """The step nearest to a moment, as timestamps have it."""
    start_s = float(scored.rows.scene.timestamps(0, 1)[0])
    return int(np.argmin(np.abs(scored.times_s + start_s - moment_s)))


def worst_frame(scored: Scored, mistakes: Mistakes, moment_s: float) -> int:
    """Number of the frame with most mistakes at a moment; where there are none, of the last frame before it."""
    step, cameras = step_at(scored, moment_s), scored.by_step
    here = mistakes.frame[mistakes.frame // cameras == step]
    if not len(here):
        taken = scored.rows.frames[scored.rows.frames // cameras <= step]
        return int(taken[-1]) if len(taken) else NOBODY
    frames, place = np.unique(here, return_inverse=True)
    seconds = np.bincount(place, mistakes.seconds[mistakes.frame // cameras == step])
    return int(frames[int(np.argmax(seconds))])
