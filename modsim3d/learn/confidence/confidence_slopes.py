"""Whether confidence falls with what is hidden of a vessel and with the size of its box."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from modsim3d.learn.confidence.confidence_fit import SlopeForm, fit_slopes, likeliest_reference
from modsim3d.learn.confidence.scores import Kind, Scores
from modsim3d.learn.numbers.resampling import SIGNIFICANT, resample, spread
from modsim3d.learn.observed.frames import usual_run_s
from modsim3d.learn.observed.observed import Observed

SCORES_NEEDED = 20
"""Detections that a distribution of a state's own needs, and so many partly hidden ones a slope on visibility."""
SLOPE_NEEDS = 50
"""Detections that a slope needs."""
_TRIALS = 200
_HIDDEN = 0.05
_EQUAL = 1e-3


def with_enough(samples: Mapping[Kind, Scores]) -> dict[Kind, Scores]:
    """The kinds whose confidences are enough, and differ enough, to tell a slope."""
    return {
        kind: scores
        for kind, scores in samples.items()
        if len(scores) >= SCORES_NEEDED and float(scores.values.std()) > _EQUAL
    }


def choose_slopes(observed: Observed, state: str, samples: Mapping[Kind, Scores], notes: list[str]) -> SlopeForm | None:
    """The slopes of a state that are surely above 0; None if there are none.

    Whether confidence follows size is tested with the median size as the reference: of a slope that is none, every
    reference is as good as any other, and the best of many would look significant too often. Where there is a slope,
    the likeliest reference is taken.
    """
    if "slopes" in observed.without:
        return None
    path = f"states.{state}.confidence"
    if "true" not in samples or len(samples["true"]) < SLOPE_NEEDS:
        count = len(samples["true"]) if "true" in samples else 0
        notes.append(f"{path}: no slopes; had {count} true detections of different confidence, needs {SLOPE_NEEDS}")
        return None
    visibility = _why_not_visibility(samples["true"])
    size = "all boxes have one size" if np.ptp(samples["true"].log_size) < _EQUAL else ""
    for key, reason in (("visibility_slope", visibility), ("size_slope", size)):
        if reason:
            notes.append(f"{path}.{key}: 0; {reason}")
    median = float(f"{2 ** float(np.median(samples['true'].log_size)):.2g}")
    form = _significant(observed, path, samples, SlopeForm(not visibility, not size, float(np.log2(median))), notes)
    if not form.names:
        return None
    return likeliest_reference(list(samples.values()), form, observed.threshold, SCORES_NEEDED) if form.size else form


def _why_not_visibility(scores: Scores) -> str:
    """Why there is no slope on visibility; empty if there may be one."""
    known = np.isfinite(scores.visible_fraction)
    if not known.all():
        return "visibility is not given everywhere" if known.any() else "visibility is not given"
    hidden = int((scores.hidden > _HIDDEN).sum())
    return "" if hidden >= SCORES_NEEDED else f"had {hidden} partly hidden true detections, needs {SCORES_NEEDED}"


def _significant(
    observed: Observed, path: str, samples: Mapping[Kind, Scores], form: SlopeForm, notes: list[str]
) -> SlopeForm:
    """The form without the slopes that are not surely above 0; the least certain one is left out first."""
    runs = resample(observed.labelled.images, _TRIALS, 0, usual_run_s(observed))
    scores = list(samples.values())
    while form.names:
        fit = fit_slopes(scores, [False] * len(scores), form, observed.threshold, runs)
        if fit is None:
            notes.append(f"{path}: no slopes; {sum(map(len, scores))} detections do not determine them")
            return SlopeForm(False, False)
        strength = fit.slopes[0] / np.maximum(fit.errors[-len(form.names) :], spread(fit.slopes[1:]))
        weakest = int(strength.argmin())
        if strength[weakest] >= SIGNIFICANT:
            break
        key = form.names[weakest]
        below = ", and only slopes above 0 are simulated" if strength[weakest] <= -SIGNIFICANT else ""
        notes.append(
            f"{path}.{key}: 0; {strength[weakest]:.1f} standard errors above 0 in {len(samples['true'])} true "
            f"detections, needs {SIGNIFICANT}{below}"
        )
        form = replace(form, **{"visibility" if key == "visibility_slope" else "size": False})
    return form
