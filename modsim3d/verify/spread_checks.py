"""Whether the numbers of false positives spread as they should: neither too evenly nor in clumps."""

from __future__ import annotations

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.detector.model import DetectorModel
from modsim3d.verify.clutter_checks import RATE_CHECKS, ExpectedClutter, expected_clutter
from modsim3d.verify.evidence import Evidence, unknown_rest_note
from modsim3d.verify.measures import AMOUNT, Estimate
from modsim3d.verify.parameters import Parameter
from modsim3d.verify.residuals import Draw, n_transient

LEAST_STRETCHES = 20
"""Independent stretches with one false positive each, below which their spread is not tested."""


def spread_checks(model: DetectorModel, evidence: Evidence, group: str) -> list[Parameter]:
    """Variance over mean of the number of transient false positives of an image, and of a stretch of images."""
    note = unknown_rest_note(model, evidence)
    if model.clutter.model not in RATE_CHECKS or model.clutter.persistent_share == 1:
        return []
    expected, found = expected_clutter(model, evidence), n_transient(evidence)
    windows = {
        "variance over mean in images": np.arange(len(found)),
        "variance over mean in stretches": stretches(evidence.frames.camera, expected.transient),
    }
    measures = {name: _spread(expected, evidence.frames.state, found, window) for name, window in windows.items()}
    return [
        Parameter(f"{Draw.FALSE_POSITIVES}: {name}", group, measure, in_file=False).unless(note)
        for name, measure in measures.items()
    ]


def stretches(camera: Indices, mean: Array) -> Indices:
    """Numbers that are equal in images of one camera that follow each other until one is expected, shape (s,)."""
    number, total, numbers = 0, 0.0, np.empty(len(mean), dtype=np.int64)
    before = -1
    for row, (now, more) in enumerate(zip(camera.tolist(), mean.tolist(), strict=True)):
        if now != before or total >= 1:
            number, total, before = number + 1, 0.0, now
        total += more
        numbers[row] = number
    return numbers


def _spread(expected: ExpectedClutter, state: Indices, found: Indices, window: Indices) -> Estimate | None:
    """The variance of the number of a window over its mean.

    With the number n of an image, its mean m and its variance v, (n − m)² − (2v/m − 1)·(n − m) − v has mean zero, does
    not depend on the rate to first order, and has the variance 2v² of a Poisson number and 2v²·(1 − (1 − v/m)/m) of a
    binomial one. Pairs of images of one window add twice the product of theirs, with variance 4v₁v₂. The third
    cumulant is 8V³ + 4V² for a Poisson number with mean V.
    """
    some = np.flatnonzero(expected.transient > 0)
    state, window, dispersion = state[some], window[some], expected.dispersion[some]
    # With each state's own rate: a wrong one must not look like clumps.
    ratio = np.bincount(state, found[some]) / np.maximum(np.bincount(state, expected.transient[some]), 1e-300)
    mean = expected.transient[some] * np.where(ratio > 0, ratio, 1)[state]
    rest = found[some] - mean
    variance = mean * dispersion
    of_windows = np.bincount(window, variance)
    alone = rest**2 - (2 * dispersion - 1) * rest - variance
    together = float((np.bincount(window, rest) ** 2).sum() - (rest**2).sum())
    spread = 2 * float((of_windows**2).sum()) - 2 * float((variance**2 * (1 - dispersion) / mean).sum())
    worth = float(of_windows.sum()) ** 2 / max(float((of_windows**2).sum()), 1e-300)
    if worth < LEAST_STRETCHES or spread <= 0:
        return None
    total, asked = float(of_windows.sum()), float(variance.sum() / mean.sum())
    error = spread**0.5
    skewness = float((8 * of_windows**3 + 4 * of_windows**2).sum()) / error**3
    scale = asked / total
    strays = float(alone.sum()) + together
    return Estimate(asked + strays * scale, asked, error * scale, worth, skewness, possible=AMOUNT)
