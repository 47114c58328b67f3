"""Which models a detector file is to have: what the data can carry, and why it is not more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from modsim3d.arrays import Array
from modsim3d.learn.clipped_scores import clipped_sums, fit_clipped
from modsim3d.learn.dropout_fit import MISSES_FOR_EACH, Effect, attribute_values, fit_misses
from modsim3d.learn.observed import Observed
from modsim3d.learn.persistence_fit import MISSES_NEEDED, PAIRS_NEEDED, correlation_time, steps_between
from modsim3d.learn.resampling import resample, spread

_ASTRAY = 0.02
_TRIALS, _USUAL_RUNS = 200, 24
ERRORS_NEEDED = 20
SCORES_NEEDED = 20
QUANTILES_NEEDED = 200
QUANTILES = 21
FALSE_NEEDED = 30
GRID = (3, 4)
FALSE_FOR_EACH_CELL = 10
SIGNIFICANT = 3.3
"""Standard errors from zero that make an effect one: one in a thousand by chance."""

_NORMAL_ENOUGH = 0.06
"""Largest difference of distribution functions at which confidence is still called a clipped normal one."""


@dataclass(frozen=True)
class Form:
    """The models.

    Attributes:
        labels: Names of the classes.
        states: Names of the performance states.
        threshold: Least confidence.
        units: Of the box error of each state, `px` or `relative`; `pooled` in front where all states share one, and
            `pooled edge` where even so there are too few but with those that the image's edge may have cut.
        effects: On misses.
        class_persists: Whether misses persist.
        box_persists: Whether box errors do.
        scores: Of each state, for true and false detections: `normal`, `quantiles`, or `shared` with all states.
        clutter: `calibrated` or `per_image`.
        sizes: Whether false positives have sizes of their own.
        grid: Rows and columns of the map of where they are; None where they are anywhere below the horizon.
        notes: Why a parameter has its simple form.
    """

    labels: tuple[str, ...]
    states: tuple[str, ...]
    threshold: float
    units: Mapping[str, str]
    effects: tuple[Effect, ...] = ()
    class_persists: bool = False
    box_persists: bool = False
    scores: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    clutter: str = "calibrated"
    sizes: bool = False
    grid: tuple[int, int] | None = None
    notes: tuple[str, ...] = ()


def choose_form(observed: Observed, clutter: str = "auto") -> Form:
    """What the data can carry.

    Args:
        observed: The data.
        clutter: The model of false positives, or `auto`.
    """
    notes: list[str] = []
    units = _units(observed, notes)
    effects = _effects(observed, notes)
    class_persists, box_persists = _persistence(observed, effects, units, notes)
    false = len(observed.false)
    sizes = false >= FALSE_NEEDED
    if not sizes:
        notes.append(f"false_positives.size: that of vessels; had {false} false detections, needs {FALSE_NEEDED}")
    needed = FALSE_FOR_EACH_CELL * GRID[0] * GRID[1]
    known = bool(np.isfinite(observed.labelled.images.sizes_px).all())
    mapped = false >= needed and known
    if not mapped:
        why = f"had {false} false detections, needs {needed}" if known else "the size of some images is not known"
        notes.append(f"false_positives.placement: uniform below the horizon; {why}")
    return Form(
        labels=observed.labelled.labels,
        states=observed.states,
        threshold=observed.threshold,
        units=units,
        effects=effects,
        class_persists=class_persists,
        box_persists=box_persists,
        scores=_scores(observed, notes),
        clutter=_clutter(observed, notes) if clutter == "auto" else clutter,
        sizes=sizes,
        grid=GRID if mapped else None,
        notes=tuple(notes),
    )


def _units(observed: Observed, notes: list[str]) -> dict[str, str]:
    """Pixels or sides of the box, whichever makes the errors likelier as normal ones."""
    pairs, sizes = observed.pairs(), observed.labelled.images.sizes_px
    units = {}
    for index, name in enumerate(observed.states):
        prefix, number = "", 0
        for prefix in ("", "pooled ", "pooled edge "):
            use = {unit: pairs.used(sizes, prefix + unit, index) for unit in ("px", "relative")}
            most = max(int(rows.sum()) for rows in use.values())
            number = number if prefix else most
            if most >= ERRORS_NEEDED:
                break
        if prefix:
            whose = "that of all states" + (", with boxes at the image's edge" if "edge" in prefix else "")
            notes.append(
                f"states.{name}.box_error: {whose}; had {number} matches away from the image's edge, "
                f"needs {ERRORS_NEEDED}"
            )
        likelihood = {
            unit: _likelihood(pairs.error_px[rows], pairs.sides_px[rows] if unit == "relative" else None)
            for unit, rows in use.items()
        }
        units[name] = prefix + ("relative" if likelihood["relative"] > likelihood["px"] else "px")
    return units


def _likelihood(errors_px: Array, sides_px: Array | None) -> float:
    """Mean log-likelihood of errors in pixels as normal ones, in pixels or in sides; −∞ from too few."""
    if len(errors_px) < ERRORS_NEEDED:
        return -np.inf
    errors = errors_px if sides_px is None else errors_px / sides_px
    sign, logarithm = np.linalg.slogdet(np.cov(errors.T) + 1e-12 * np.eye(4))
    stretch = 0.0 if sides_px is None else float(np.log(sides_px).sum(axis=1).mean())
    return float(-0.5 * logarithm - stretch) if sign > 0 else np.inf


def _effects(observed: Observed, notes: list[str]) -> tuple[Effect, ...]:
    """Attributes that change the odds of a miss, the least certain left out one by one."""
    values = attribute_values(observed)
    misses = int(observed.missed.sum())
    rarer = min(misses, len(observed.rows) - misses)
    chosen: list[Effect] = []
    for name, column in values.items():
        known = column[np.isfinite(column)]
        if not len(known):
            notes.append(f"dropout.{name}: none; it is not given")
        elif len(known) < len(column) or np.ptp(known) < 1e-6 * max(abs(float(known.max())), 1.0):
            notes.append(
                f"dropout.{name}: none; " + ("not given everywhere" if len(known) < len(column) else "constant")
            )
        else:
            reference = 1.0 if name == "visible_fraction" else float(f"{np.median(known):.3g}")
            chosen.append(Effect(name, reference))
    needed = MISSES_FOR_EACH * len(chosen)
    if rarer < needed:
        rare = "misses" if misses == rarer else "finds"
        notes.append(f"dropout: as in the confusion matrix; had {rarer} {rare}, needs {needed}")
        return ()
    runs = resample(observed.labelled.images, _TRIALS, 0, _usual_run_s(observed))
    while chosen:
        fit = fit_misses(observed, tuple(chosen), runs)
        if fit is None:
            notes.append(
                f"dropout: as in the confusion matrix; {len(observed.rows)} truths do not determine the effects"
            )
            return ()
        strength = np.abs(fit.slopes[0]) / np.maximum(fit.errors, spread(fit.slopes[1:]))
        weakest = int(strength.argmin())
        if strength[weakest] >= SIGNIFICANT:
            break
        effect = chosen.pop(weakest)
        notes.append(
            f"dropout.{effect.attribute}: none; {strength[weakest]:.1f} standard errors from 0 in {len(observed.rows)} "
            f"truths, needs {SIGNIFICANT}"
        )
    return tuple(chosen)


def _usual_run_s(observed: Observed) -> float:
    """Length of runs of frames in which misses that persist look independent; 0 where frames do not follow."""
    times = observed.labelled.images.time_s
    if len(steps_between(observed.labelled, observed.rows)) < PAIRS_NEEDED:
        return 0.0
    return float(np.nanmax(times) - np.nanmin(times)) / _USUAL_RUNS


def _persistence(
    observed: Observed, effects: tuple[Effect, ...], units: Mapping[str, str], notes: list[str]
) -> tuple[bool, bool]:
    """Whether misses and box errors persist."""
    steps = steps_between(observed.labelled, observed.rows)
    if len(steps) < PAIRS_NEEDED:
        notes.append(
            f"persistence: none; had {len(steps)} sightings that follow one of the same vessel, needs {PAIRS_NEEDED} "
            "(frames with times, truth with identities)"
        )
        return False, False
    misses = int(observed.missed.sum())
    class_s = box_s = False
    if misses < MISSES_NEEDED:
        notes.append(f"persistence.class_s: 0; had {misses} misses, needs {MISSES_NEEDED}")
    else:
        products, _, _ = miss_products(observed, effects)
        class_s = _correlated(products)
        if not class_s:
            notes.append(f"persistence.class_s: 0; misses of {len(steps)} consecutive pairs are not correlated")
    found = int((~observed.missed).sum())
    if found < PAIRS_NEEDED:
        notes.append(f"persistence.box_s: 0; had {found} matches, needs {PAIRS_NEEDED}")
    else:
        products, _, _ = error_products(observed, units)
        box_s = len(products) >= PAIRS_NEEDED and _correlated(products)
        if not box_s:
            notes.append(f"persistence.box_s: 0; errors of {len(products)} consecutive pairs are not correlated")
    return class_s, box_s


def _correlated(products: Array) -> bool:
    spread = float(products.std()) / np.sqrt(max(len(products), 1))
    return bool(spread > 0 and float(products.mean()) > SIGNIFICANT * spread)


def miss_products(observed: Observed, effects: tuple[Effect, ...]) -> tuple[Array, Array, np.ndarray]:
    """Products of residuals of consecutive misses, those expected of the same draw, and the later rows' places.

    Expected are they of earlier residuals as large as they were found: runs of frames with more misses than others have
    larger products and larger residuals alike, and say no less about how long both last.
    """
    fit = fit_misses(observed, effects, resample(observed.labelled.images, 0, 0))
    rate = np.full(len(observed.rows), observed.missed.mean()) if fit is None else fit.chance
    steps = steps_between(observed.labelled, observed.rows)
    residual = observed.missed - rate
    a, b = steps.earlier, steps.later
    size = residual[a] ** 2 / np.maximum(rate[a] * (1 - rate[a]), 1e-12)
    return residual[a] * residual[b], (np.minimum(rate[a], rate[b]) - rate[a] * rate[b]) * size, b


def error_products(observed: Observed, units: Mapping[str, str]) -> tuple[Array, Array, np.ndarray]:
    """The same of whitened box errors, as means over their four components; places are among the pairs used."""
    pairs, sizes = observed.pairs(), observed.labelled.images.sizes_px
    white = np.full((len(pairs), 4), np.nan)
    for index, name in enumerate(observed.states):
        relative = units[name].endswith("relative")
        use = (pairs.state == index) & pairs.unclipped(sizes, relative)
        if use.sum() < ERRORS_NEEDED:
            continue
        errors = pairs.error_px[use] / (pairs.sides_px[use] if relative else 1.0)
        values, vectors = np.linalg.eigh(np.cov(errors.T))
        root = (vectors / np.sqrt(np.maximum(values, 1e-9 * max(values[-1], 1e-12)))) @ vectors.T
        white[use] = (errors - errors.mean(axis=0)) @ root
    kept = np.flatnonzero(np.isfinite(white[:, 0]))
    steps = steps_between(observed.labelled, pairs.rows[kept])
    a, b = kept[steps.earlier], kept[steps.later]
    return (white[a] * white[b]).mean(axis=1), (white[a] ** 2).mean(axis=1), b


def first_times(observed: Observed, form: Form) -> tuple[float, float]:
    """Correlation times of misses and box errors, roughly: how long runs of frames must be to be independent."""
    once = resample(observed.labelled.images, 0, 0)

    def time(products: Array, expected: Array, gaps_s: Array) -> float:
        image = np.zeros(len(products), dtype=np.int64)
        return float(correlation_time(once, image, products, expected, gaps_s)[0])

    class_s = box_s = 0.0
    if form.class_persists:
        products, expected, _ = miss_products(observed, form.effects)
        class_s = time(products, expected, steps_between(observed.labelled, observed.rows).apart_s)
    if form.box_persists:
        products, expected, _ = error_products(observed, form.units)
        box_s = time(products, expected, error_gaps(observed, form.units))
    return class_s, box_s


def error_gaps(observed: Observed, units: Mapping[str, str]) -> Array:
    """Times between the pairs of `error_products`."""
    pairs, sizes = observed.pairs(), observed.labelled.images.sizes_px
    kept = np.zeros(len(pairs), dtype=bool)
    for index, name in enumerate(observed.states):
        use = (pairs.state == index) & pairs.unclipped(sizes, units[name].endswith("relative"))
        kept |= use if use.sum() >= ERRORS_NEEDED else False
    return steps_between(observed.labelled, pairs.rows[kept]).apart_s


def _scores(observed: Observed, notes: list[str]) -> dict[str, tuple[str, str]]:
    """Which distribution of confidence each state and kind has."""
    found, threshold = observed.labelled.results, observed.threshold
    pairs = observed.pairs()
    false_state = observed.image_state[found.image[observed.false]]
    chosen = {}
    for index, name in enumerate(observed.states):
        kinds = []
        for kind, values in (
            ("true", pairs.confidence[pairs.state == index]),
            ("false", found.confidence[observed.false[false_state == index]]),
        ):
            if len(values) < SCORES_NEEDED:
                kinds.append("shared")
                notes.append(
                    f"states.{name}.confidence.{kind}: that of all states; had {len(values)} detections, "
                    f"needs {SCORES_NEEDED}"
                )
            else:
                normal = len(values) < QUANTILES_NEEDED or _distance(values, threshold) < _NORMAL_ENOUGH
                kinds.append("normal" if normal else "quantiles")
        chosen[name] = (kinds[0], kinds[1])
    return chosen


def _distance(values: Array, threshold: float) -> float:
    """Largest difference between the distribution function of numbers and that of their clipped normal fit."""
    from scipy.special import ndtr

    mean, std = fit_clipped(clipped_sums(values, threshold, 1.0).sum(axis=0)[None], threshold, 1.0)
    ordered = np.sort(values)
    fitted = np.where(ordered >= 1, 1.0, ndtr((ordered - mean[0]) / max(std[0], 1e-9)))
    after = np.searchsorted(ordered, ordered, side="right") / len(values)
    before = np.searchsorted(ordered, ordered, side="left") / len(values)
    below = np.where(ordered <= threshold, 0.0, np.abs(fitted - before))
    above = np.abs(fitted - after)
    return float(max(below[ordered < 1].max(initial=0.0), above.max(initial=0.0)))


def _clutter(observed: Observed, notes: list[str]) -> str:
    """Whether the number of false detections follows that of the true ones, or is the same in every image."""
    images = len(observed.labelled.images)
    false = np.bincount(observed.labelled.results.image[observed.false], minlength=images).astype(np.float64)
    true = np.bincount(observed.image[~observed.missed], minlength=images).astype(np.float64)
    with_true, even = 0.0, 0.0
    for state in range(len(observed.states)):
        ours = observed.image_state == state
        total, n_true, n_images = false[ours].sum(), true[ours].sum(), ours.sum()
        if total == 0:
            continue
        # A few may be found where nothing else is, which is a matter of matching: they do not settle it alone.
        shares = true[ours] / max(n_true, 1.0)
        expected = total * ((1 - _ASTRAY) * shares + _ASTRAY / n_images)
        with_true += float((false[ours] * np.log(expected)).sum())
        even += float(total * np.log(total / n_images))
    if even > with_true:
        notes.append(
            "false_positives: per_image, for their number does not follow that of the true detections "
            f"(log-likelihood {even:.1f} against {with_true:.1f})"
        )
        return "per_image"
    return "calibrated"
