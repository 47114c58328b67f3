"""The moment at which a run went wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask
from modsim3d.core.boxes import areas
from modsim3d.tracking.scores.occlusions import OcclusionSpans
from modsim3d.tracking.scores.scored_run import ScoredRun, frame_lengths_s

WINDOW_S = 5.0  # as long as a look at what happens in a film
LOST, FALSE, SWITCHED = range(3)
_BY_SWITCHES = "id_switches", "tracks_per_vessel", "assa", "assre", "asspr", "idf1", "idp", "idr"
LOWERED_BY = dict.fromkeys(_BY_SWITCHES, "identity switch") | {"occlusions_survived": "lost occlusion"}  # by score
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
    track: Indices  # number of the track that follows nothing, else `NOBODY`, shape (n,)

    @classmethod
    def of(cls, scored: ScoredRun) -> Mistakes:
        """The mistakes in the frames that are scored."""
        following, truth_rows = scored.following, scored.truth_rows
        truth, tracks = following.truth, following.tracks
        lost = truth_rows[~following.found[truth_rows]]
        false = scored.track_rows[following.false[scored.track_rows]]
        switched = _switches(scored)
        frame = np.concatenate([truth.frame[lost], tracks.frame[false], truth.frame[switched]])
        seconds = frame_lengths_s(scored.rows, frame)
        seconds[: len(lost)][_new(scored)[lost]] = 0
        seconds[len(lost) + len(false) :] = WINDOW_S
        nobody, nothing = np.full(len(false), NOBODY), np.full(len(lost), NOBODY)
        every = cls(
            np.repeat([LOST, FALSE, SWITCHED], [len(lost), len(false), len(switched)]),
            frame,
            seconds,
            np.concatenate([truth.boxes_px[lost], tracks.boxes_px[false], truth.boxes_px[switched]]),
            np.concatenate([truth.vessel[lost], nobody, truth.vessel[switched]]),
            np.concatenate([nothing, tracks.track[false], np.full(len(switched), NOBODY)]),
        )
        return every._take(np.argsort(frame, kind="stable"))

    def _take(self, rows: Indices | Mask) -> Mistakes:
        return Mistakes(**{name: column[rows] for name, column in vars(self).items()})


def _new(scored: ScoredRun) -> Mask:
    """Mask of the matching's vessels that came less than a window ago and were never followed before, shape (n,).
    Trackers wait for some detections before they report a track: all of them lose all vessels when a run begins."""
    truth, rows = scored.following.truth, scored.truth_rows
    time_s, followed = scored.times_s[truth.frame // scored.by_step], scored.pairs[0]
    until_s = np.full(int(truth.identity.max(initial=-1)) + 1, np.inf)
    np.minimum.at(until_s, truth.identity[rows], time_s[rows] + WINDOW_S)
    np.minimum.at(until_s, truth.identity[followed], time_s[followed])
    return np.less(time_s, until_s[truth.identity] - 1e-6)


def _switches(scored: ScoredRun) -> Indices:
    """Rows of the matching's vessels at which an appearance is followed by another track than last, shape (s,)."""
    truth, tracks, (rows, track_rows) = scored.following.truth, scored.following.tracks, scored.pairs
    order = np.lexsort((truth.frame[rows], truth.identity[rows]))
    rows, track_rows = rows[order], track_rows[order]
    switched = (np.diff(truth.identity[rows]) == 0) & (np.diff(tracks.identity[track_rows]) != 0)
    switches: Indices = rows[1:][switched]
    return switches


def worst_moment_s(scored: ScoredRun) -> float | None:
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


def worst_mistake(scored: ScoredRun, moment_s: float) -> Mistakes:
    """The mistake to look at, of those at the step nearest to a moment that has some: in the frame with most of them a
    switch rather than a vessel that is lost, and that rather than a track on nothing; of those the largest box."""
    mistakes = Mistakes.of(scored)
    steps, start_s = mistakes.frame // scored.by_step, float(scored.rows.scene.timestamps(0, 1)[0])
    near = steps == steps[np.argmin(np.abs(scored.times_s[steps] + start_s - moment_s))]
    frames, place = np.unique(mistakes.frame[near], return_inverse=True)
    here = mistakes._take(mistakes.frame == frames[np.argmax(np.bincount(place, mistakes.seconds[near]))])
    return here._take(np.lexsort((areas(here.boxes_px), np.array([1, 0, 2])[here.kind]))[-1:])


def row_to_show(scored: ScoredRun, column: str) -> int:
    """Row of the matching's vessels that shows why a score, by its column in a table, is low, as in `LOWERED_BY`: of
    the vessel with most switches, or with most lost occlusions, the largest box after one; `NOBODY` for none."""
    part, _, key = column.rpartition(".")
    truth, scene, rows = scored.following.truth, scored.rows.scene, np.empty(0, dtype=np.int64)
    if key in _BY_SWITCHES:
        frames = {f"state.{state.name}": scored.state_frames(k) for k, state in enumerate(scene.detector.states)}
        rows = _switches(replace(scored, frames=frames.get(part, scored.frames)))
    elif key in LOWERED_BY:
        past = (spans := OcclusionSpans.of(scored)).histories
        after = past.first_after(truth.scored[past.row])[spans.last]
        rows = past.row[after[spans.judged & ~spans.survived]]
    vessel, area = truth.vessel[rows], areas(truth.boxes_px[rows])
    return int(rows[np.lexsort((area, np.bincount(vessel)[vessel]))[-1]]) if len(rows) else NOBODY
