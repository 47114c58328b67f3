"""Where a fit starts: the guess of the search from which the detections are explained best.

The clock has several local optima. On board, the waves' motion looks much the same a period later. So guesses are
aligned one by one, with vessels off their reports where that is expected, and compared.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from modsim3d.arrays import Array
from modsim3d.scene.scene import Scene
from modsim3d.voyage.registration.aligning import Aligner, Alignment, usual_px
from modsim3d.voyage.registration.checks import check_search
from modsim3d.voyage.registration.fitting import Unknowns
from modsim3d.voyage.registration.parameters import Values
from modsim3d.voyage.registration.search import search

CLOCK_STEP_S = 0.5
MOST_TURN_DEG = 15.0
MOST_GUESSES, LIKELY = 5, 0.6
"""How many guesses are tried, and with how many votes in shares of the best one's."""
APART_S = 0.5
"""Starts whose clocks have come closer than this are the same."""
SURE = 3.0
"""A start is clearly worse than another by so many standard errors of the mean over stretches of time."""
STRETCHES = 12


def starts(aligner: Aligner, searched_s: float, spread_m: float, scene: Scene) -> tuple[Values, list[Values]]:
    """The best start, and others whose clocks explain the detections nearly as well.

    Args:
        aligner: Of some of the frames.
        searched_s: Greatest offset of the clock that is looked for.
        spread_m: How far vessels are expected to be from where the scene has them.
        scene: The scene.

    Raises:
        ModsimError: No guess explains more detections than chance.
    """
    model, found, free = aligner.model, aligner.found, aligner.free
    clocks = np.arange(-searched_s, searched_s + CLOCK_STEP_S / 2, CLOCK_STEP_S) if "clock_s" in free else np.zeros(1)
    voted = search(model, found, clocks, np.radians(MOST_TURN_DEG if "yaw_deg" in free else 2.0))
    check_search(voted, model, found, clocks, scene)
    zero = {name: 0.0 for name in ("clock_s", "yaw_deg", "pitch_deg") if name not in free}
    tried, clocks_s = list[tuple[Array, Values]](), list[float]()
    for guess in voted.guesses[:MOST_GUESSES]:
        if guess.votes < LIKELY * voted.guesses[0].votes:
            break
        rough = aligner.first(guess.values(len(model.hulls_m)).changed(**zero))
        clock_s = rough.values["clock_s"]
        if any(abs(clock_s - other) < APART_S for other in clocks_s):
            continue
        clocks_s.append(clock_s)
        if spread_m:
            vessels = np.unique(rough.sightings.vessel)
            unknowns = Unknowns(aligner.all_unknowns().shared, np.array([spread_m, spread_m, 0.0]), vessels)
            rough = aligner.until_stable(rough, unknowns, tied=True, rounds=2)
        tried.append((explained(aligner, rough), rough.values))
    tried.sort(key=lambda start: -start[0].sum())
    (most, best), *others = tried
    return best, rivals_of(most, best, others)


def rivals_of(most: Array, best: Values, others: Sequence[tuple[Array, Values]]) -> list[Values]:
    """Starts of another clock that are not clearly worse than the best one.

    Args:
        most: How well the best start explains the detections, in each of k stretches of time, shape (k,).
        best: Its values.
        others: The same of other starts.
    """
    rivals = list[Values]()
    for less, other in others:
        worse = most - less
        clocks_s = np.array([each["clock_s"] for each in (best, *rivals)])
        new = np.abs(clocks_s - other["clock_s"]).min() > APART_S
        if new and worse.mean() < SURE * worse.std(ddof=1) / np.sqrt(len(worse)):
            rivals.append(other)
    return rivals


def explained(aligner: Aligner, aligned: Alignment) -> Array:
    """How well the detections are explained, in each of some stretches of time, shape (STRETCHES,).

    A bearing or a waterline counts 1 where it is met, and less the further it is off.
    """
    residuals = aligned.residuals
    px = np.nan_to_num(residuals.px(aligner.model, aligned.values), nan=1e3)
    close = np.where(residuals.kind <= 3, 1 / (1 + (px / usual_px(residuals.size_px)) ** 2), 0.0)
    times_s = aligner.found.times_s
    edges = np.linspace(times_s[0], times_s[-1], STRETCHES + 1)[1:-1]
    stretch = np.searchsorted(edges, residuals.sightings.time_s[residuals.row])
    return np.asarray(np.bincount(stretch, close, STRETCHES))
