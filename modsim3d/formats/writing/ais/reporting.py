"""Times at which an AIS station sends its reports, and the reports that are lost. Intervals are those of ITU-R
M.1371-5, annex 1, tables 1 and 2. Class A sends every 10 s below 14 knots, every 6 s up to 23 knots, and every 2 s
above; while it changes course every 3⅓ s below 14 knots and every 2 s above; at anchor below 3 knots every 3 min. Class
B "CS" sends every 30 s above 2 knots, and every 3 min below. Static data follow every 6 min. The tables leave open when
a ship changes course, and when it has slowed down. Here it changes course while its heading differs by more than 5°
from the mean of the last 30 s, and for 20 s after; a longer interval for a lower speed begins after 3 min. The time of
a report lies within a selection interval around its nominal time, in one of the 2250 slots of a minute (annex 2, §
3.3.4.4; annex 7, § 4.3 of class B "CS")."""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.formats.writing.ais.sensors import SensorReadings

STATIC_S = 360.0
STATIC_B_AFTER_S = 30.0  # part B of message 24 follows part A within a minute
STATIC_SPREAD_S = 2.0  # half the 150 slots in which a station chooses one for a single message
REST_S = 180.0
CLASS_A_S = ((14.0, 10.0, 10 / 3), (23.0, 6.0, 2.0), (np.inf, 2.0, 2.0))
"""Speed in knots up to which these intervals hold: on a straight course, and while it changes."""
ANCHOR_KN, CLASS_B_KN, CLASS_B_S = 3.0, 2.0, 30.0
TURN_DEG, TURN_MEAN_S, TURN_HOLD_S, SLOWER_AFTER_S = 5.0, 30, 20, 180
SLOT_S = 60 / 2250
AGE_S = 0.2  # least time from a fix to the report with it; fixes come once a second, so it is 0.2 to 1.2 s old


@dataclass(frozen=True, eq=False)
class ReportingRate:
    """Reporting of a station's position, at n seconds."""

    intervals_s: Array  # (n,)
    # Whether class A sends reports beside its regular ones, as message 3 in place of 1: while it changes course, and
    # less than twice a minute; (n,).
    between: Mask


@dataclass(frozen=True, eq=False)
class Schedule:
    """Nominal times of m reports, and half the selection interval around each, in seconds, shape (m,) each."""

    due_s: Array
    spread_s: Array


@dataclass(frozen=True, eq=False)
class ReceivedReports:
    """The reports of a schedule that are received, shape (m,) each."""

    times_s: Array  # of sending, since the first step
    rows: Indices  # of the `SensorReadings` that each has
    numbers: Indices  # place of each among the schedule's reports


def changes_course(seen: SensorReadings) -> Mask:
    """Whether a ship changes course, at each second, shape (n,)."""
    n = len(seen.heading_deg)
    sums = np.concatenate([[0.0], np.cumsum(seen.heading_deg - seen.heading_deg[0])])
    first = np.maximum(np.arange(n) + 1 - TURN_MEAN_S, 0)
    mean = (sums[1:] - sums[first]) / (np.arange(n) + 1 - first)
    turned = np.abs(seen.heading_deg - seen.heading_deg[0] - mean) > TURN_DEG
    last = np.maximum.accumulate(np.where(turned, np.arange(n), -TURN_HOLD_S - 1))
    return np.asarray(np.arange(n) - last <= TURN_HOLD_S)


def rate(seen: SensorReadings, ais_class: str, at_rest: bool) -> ReportingRate:
    """Reporting rate of a station of a class, at anchor or under way."""
    speed = np.nan_to_num(seen.speed_kn)
    if ais_class == "B":
        return ReportingRate(np.where(speed > CLASS_B_KN, CLASS_B_S, REST_S), np.zeros(len(speed), dtype=bool))
    if at_rest:
        return ReportingRate(np.where(speed > ANCHOR_KN, CLASS_A_S[0][1], REST_S), speed <= ANCHOR_KN)
    bounds, straight, turning = (np.array(column) for column in zip(*CLASS_A_S, strict=True))
    # The highest speed of the last three minutes.
    size = SLOWER_AFTER_S + 1
    highest = sliding_window_view(np.pad(speed, (size, 0)), size)[1:].max(axis=1)
    row, changing = np.searchsorted(bounds, highest), changes_course(seen)
    return ReportingRate(np.where(changing, turning[row], straight[row]), changing & (turning[row] < straight[row]))


def due_times(times_s: Indices, intervals: Array, end_s: float, phase: float) -> Array:
    """Nominal times of reports from the first second to the end, at which the vessel leaves: (m,). `intervals` hold
    from each whole second on: (n,); a shorter one shortens the one that is running. `phase` is how much of the first
    interval is over at the beginning, from 0 to 1."""
    begins = np.flatnonzero(np.diff(intervals, prepend=np.nan) != 0)
    begin, interval = times_s[begins].astype(float).tolist(), intervals[begins].tolist()
    due_s: list[float] = []
    last, part = begin[0] - phase * interval[0], 0
    while True:
        due = max(last + interval[part], begin[part])
        if part + 1 < len(begin) and due >= begin[part + 1]:
            part += 1
        elif due > end_s:
            return np.array(due_s)
        else:
            due_s.append(due)
            last = due


def position_schedule(times_s: Indices, end_s: float, rate: ReportingRate, ais_class: str, phase: float) -> Schedule:
    """Times when a station is to send its position; for the arguments see `due_times`."""
    due = due_times(times_s, rate.intervals_s, end_s, phase)
    running = rate.intervals_s[np.clip(np.floor(due).astype(np.int64) - times_s[0], 0, len(times_s) - 1)]
    spread = np.minimum(running / 6, 5.0) if ais_class == "B" else np.minimum(running / 10, STATIC_SPREAD_S)
    return Schedule(due, spread)


def static_schedule(times_s: Indices, end_s: float, phase: float, after_s: float = 0.0) -> Schedule:
    """Times when a station is to send its name and size, some seconds after the nominal time."""
    due = due_times(times_s, np.full(len(times_s), STATIC_S), end_s, phase) + after_s
    return Schedule(due, np.full(len(due), STATIC_SPREAD_S))


def own_static_schedule(times_s: Indices, end_s: float) -> Schedule:
    """Times when own ship's station gives its name and size: at once, and then every six minutes."""
    due = np.arange(times_s[0] + AGE_S + SLOT_S, end_s, STATIC_S)
    return Schedule(due, np.zeros(len(due)))


def heard(schedule: Schedule, times_s: Indices, end_s: float, lost: float, draws: Array) -> ReceivedReports:
    """The reports that are sent while the vessel is there, and received. There is a fix at each of `times_s` (n,); the
    vessel leaves at `end_s`; `lost` is the share that is lost, `draws` are uniform numbers: (m, 2)."""
    sent = np.floor((schedule.due_s + (2 * draws[:, 0] - 1) * schedule.spread_s) / SLOT_S) * SLOT_S
    fix = np.floor(sent - AGE_S).astype(np.int64) - int(times_s[0])
    audible = (fix >= 0) & (fix < len(times_s)) & (sent <= end_s) & (draws[:, 1] >= lost)
    return ReceivedReports(sent[audible], fix[audible], np.flatnonzero(audible))
