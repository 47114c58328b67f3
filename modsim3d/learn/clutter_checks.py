"""False positives: how many, of which kind, and with which label."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.boxes import sizes
from modsim3d.detector.doubles import LEAST_SPLIT_PX, Doubles
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import DUPLICATE, FALSE_POSITIVE, FRAGMENT, MERGED, PERSISTENT, SPLIT, TRUE
from modsim3d.learn.clutter_box_checks import clutter_box_checks
from modsim3d.learn.evidence import Evidence
from modsim3d.learn.limits import limit_broken, limit_note
from modsim3d.learn.measures import Exact, Measure
from modsim3d.learn.pairs import lag_pairs
from modsim3d.learn.parameters import Parameter
from modsim3d.learn.rate_measures import DiscoveryRate, ImageRate, Rate

GROUP = "false positives"


@dataclass(frozen=True, eq=False)
class Expected:
    """False positives to be expected in each image, given what was detected; shapes (s,).

    Attributes:
        passing: That are in one image only.
        lasting: That persist.
        extras: Second boxes of vessels.
        extra_variance: Of their number.
        spread: Variance of `passing` over their mean: 1 for a Poisson number.
    """

    passing: Array
    lasting: Array
    extras: Array
    extra_variance: Array
    spread: Array

    @property
    def all(self) -> Array:
        """Of every kind."""
        return self.passing + self.lasting + self.extras


def expected_clutter(model: DetectorModel, evidence: Evidence) -> Expected:
    """What the model of false positives makes of the images."""
    images = evidence.images
    due = np.concatenate([model.gates.due(seen.frames) for seen in evidence.cameras])
    extras, variance = _extras(model, evidence)
    rate = model.column("false_discovery_rate")[images.state]
    spread = np.ones(len(rate))
    if model.false_positives == "thesis":
        means = thesis_trials(model, images.n_kept, rate) * rate
        spread = 1 - rate
    elif model.false_positives == "per_image":
        means = np.where(due, model.column("false_positives_per_image")[images.state], 0.0)
    else:
        means = np.maximum(images.n_kept * rate / (1 - rate) - extras, 0)
    share = model.clutter.persistent_share
    # Trials of the thesis's rule are made in full, whatever persists beside them.
    passing = means if model.false_positives == "thesis" else (1 - share) * means
    return Expected(passing, share * means, extras, variance, spread)


def clutter_checks(model: DetectorModel, evidence: Evidence) -> list[Parameter]:
    """The rate of each state and of all, the kinds, and the labels of false positives."""
    note = limit_note(model, evidence)
    expected = expected_clutter(model, evidence)
    images, clutter = evidence.images, evidence.clutter
    thesis, per_image = model.false_positives == "thesis", model.false_positives == "per_image"
    parameters = []
    if model.gates.max_detections is not None:
        wrong = Exact(limit_broken(model, evidence), len(images.state))
        parameters.append(Parameter("gates.max_detections", GROUP, wrong))
    for s, state in enumerate(model.states):
        ours = images.state == s
        rate = state.false_discovery_rate
        if per_image:
            found = int(np.isin(clutter.kind, (FALSE_POSITIVE, PERSISTENT))[clutter.state == s].sum())
            measure: Measure | None = _image_rate(model, evidence, expected, ours, found)
            name, asked = f"states.{state.name}.false_positives_per_image", state.false_positives_per_image
        else:
            measure = _discovery_rate(model, evidence, expected, ours)
            name, asked = f"states.{state.name}.false_discovery_rate", rate
        parameters.append(
            Parameter(
                name,
                GROUP,
                None if note else measure,
                asked,
                state=state.name,
                promised=rate if thesis else None,
                note=note or ("asked: what the rule of eq. 7.35 gives here" if thesis else ""),
            )
        )
        # One that persists keeps its label: only the others are independent of each other.
        passing = (clutter.state == s) & (clutter.kind == FALSE_POSITIVE)
        parameters += _label_checks(model, s, clutter.label[passing])
    if not per_image:
        overall = None if note else _discovery_rate(model, evidence, expected, np.ones(len(images.state), dtype=bool))
        promised = _promised(model, evidence) if thesis else None
        name = "false discovery rate, all states"
        parameters.append(Parameter(name, GROUP, overall, in_file=False, promised=promised, note=note))
    parameters += [] if note else _kind_checks(model, evidence, expected)
    return [*parameters, *clutter_box_checks(model, evidence, expected.lasting)]


def thesis_trials(model: DetectorModel, kept: Indices, rate: Array | float) -> Array:
    """Trials that the original rule makes in frames with so many detections (Jessen & Mohr (2023), eq. 7.35)."""
    trials: Array = np.maximum(np.rint(rate * kept - model.confidence_threshold), 0)
    return trials


def _promised(model: DetectorModel, evidence: Evidence) -> float | None:
    """The share of false positives that the states' rates ask for together."""
    kept = evidence.images.n_kept
    rate = model.column("false_discovery_rate")[evidence.images.state]
    asked = float((kept * rate / (1 - rate)).sum())
    return asked / (asked + float(kept.sum())) if kept.sum() else None


def _discovery_rate(
    model: DetectorModel, evidence: Evidence, expected: Expected, ours: np.ndarray
) -> DiscoveryRate | None:
    images = evidence.images
    true = float(images.n_kept[ours].sum())
    if not true:
        return None
    mean = float(expected.all[ours].sum())
    variance = float((expected.passing * expected.spread + expected.extra_variance)[ours].sum())
    variance += _lasting_variance(model, evidence, expected.lasting, ours)
    inflation = variance / mean if mean > 0 else 1.0
    return DiscoveryRate(float(images.n_false[ours].sum()), true, mean, inflation or 1.0)


def _image_rate(
    model: DetectorModel, evidence: Evidence, expected: Expected, ours: np.ndarray, found: int
) -> ImageRate | None:
    means = (expected.passing + expected.lasting)[ours]
    due = np.concatenate([model.gates.due(seen.frames) for seen in evidence.cameras])
    if not due[ours].any():
        return None
    mean = float(means.sum())
    variance = float(expected.passing[ours].sum()) + _lasting_variance(model, evidence, expected.lasting, ours)
    return ImageRate(found, float(due[ours].sum()), mean / float(due[ours].sum()), variance / mean if mean else 1.0)


def _lasting_variance(model: DetectorModel, evidence: Evidence, means: Array, ours: np.ndarray) -> float:
    """Variance of the number of persistent ones: those in two images Δt apart share min(m, m′)·e^(−Δt/lifetime)."""
    rows = np.flatnonzero(ours & (means > 0))
    if not len(rows):
        return 0.0
    mean = means[rows]
    total, lifetime = float(mean.sum()), model.clutter.lifetime_s
    for later, earlier, apart in lag_pairs(evidence.images.camera[rows, None], evidence.images.time_s[rows], lifetime):
        total += 2 * float((np.exp(-apart / lifetime) * np.minimum(mean[later], mean[earlier])).sum())
    return total


def _label_checks(model: DetectorModel, s: int, found: Indices) -> list[Parameter]:
    state = model.states[s]
    if len(model.labels) < 2:
        return []
    note = "of those that do not persist" if model.clutter.persistent_share else ""
    return [
        Parameter(
            f"states.{state.name}.false_positive_labels[{label}]",
            GROUP,
            Rate(int((found == i).sum()), len(found), float(state.false_positive_labels[i])) if len(found) else None,
            float(state.false_positive_labels[i]),
            state=state.name,
            note=note,
        )
        for i, label in enumerate(model.labels)
    ]


def _eligible(model: DetectorModel, evidence: Evidence) -> tuple[Indices, np.ndarray]:
    """True detections that may be doubled or split, and which of them are long enough to be split."""
    hits, clutter = evidence.hits, evidence.clutter
    single = np.flatnonzero((hits.kind == TRUE) | (hits.kind == SPLIT))
    chances = hits.chance[single]
    placed = sizes(hits.boxes_px[single])[:, 0]
    pieces = np.flatnonzero(clutter.kind == FRAGMENT)
    of = {int(chance): int(row) for row, chance in zip(pieces, clutter.chance[pieces], strict=True)}
    split = np.flatnonzero(hits.kind[single] == SPLIT)
    other = np.array([of[int(chance)] for chance in chances[split]], dtype=np.int64)
    placed[split] += sizes(clutter.boxes_px[other])[:, 0]  # both parts together
    truth = np.concatenate([seen.targets.boxes_px for seen in evidence.cameras])
    return single, model.doubles.looks_long(truth[chances]) & (placed >= LEAST_SPLIT_PX)


def _extras(model: DetectorModel, evidence: Evidence) -> tuple[Array, Array]:
    """Mean and variance of the number of second boxes in each image, shapes (s,)."""
    doubles, size = model.doubles, len(evidence.images.state)
    if not doubles.duplicates and not doubles.splits:
        return np.zeros(size), np.zeros(size)
    single, long = _eligible(model, evidence)
    chance = doubles.duplicates + doubles.splits * long
    image = _images_of(evidence, evidence.hits.chance[single])
    return (
        np.bincount(image, chance, minlength=size).astype(np.float64),
        np.bincount(image, chance * (1 - chance), minlength=size).astype(np.float64),
    )


def _images_of(evidence: Evidence, chances: Indices) -> Indices:
    """Row of `Images` of chances."""
    first = np.cumsum([0, *(len(seen.frames) for seen in evidence.cameras)])
    return first[evidence.chances.camera[chances]] + evidence.chances.frame[chances]


def _kind_checks(model: DetectorModel, evidence: Evidence, expected: Expected) -> list[Parameter]:
    doubles, kinds = model.doubles, evidence.clutter.kind
    parameters = []
    if doubles != Doubles() or np.isin(kinds, (DUPLICATE, FRAGMENT)).any():
        single, long = _eligible(model, evidence)
        for name, kind, count in (("duplicates", DUPLICATE, len(single)), ("splits", FRAGMENT, int(long.sum()))):
            asked = float(getattr(doubles, name))
            measure = Rate(int((kinds == kind).sum()), count, asked) if count else None
            parameters.append(Parameter(f"false_positives.{name}", GROUP, measure, asked))
    merged = int((evidence.hits.kind == MERGED).sum())
    if doubles.merges == 0:
        none = Exact(merged, len(evidence.hits.kind))
        parameters.append(Parameter("false_positives.merges", GROUP, none))
    else:
        note = "which pairs could have been merged depends on others that were: only counted"
        parameters.append(Parameter("false_positives.merges", GROUP, None, doubles.merges, note=note))
    lasting = int((kinds == PERSISTENT).sum())
    share = model.clutter.persistent_share
    if not share:
        parameters.append(Parameter("false_positives.persistence.share", GROUP, Exact(lasting, len(kinds))))
    else:
        passing, mean = int((kinds == FALSE_POSITIVE).sum()), float(expected.lasting.sum())
        every = np.ones(len(expected.lasting), dtype=bool)
        variance = _lasting_variance(model, evidence, expected.lasting, every)
        # The variance of the number that persists, and of the rest, over that of a binomial share of them.
        total = mean + float(expected.passing.sum())
        spread = (1 - share) ** 2 * variance + share**2 * float(expected.passing.sum())
        factor = spread / max(total * share * (1 - share), 1e-12) if share < 1 else 1.0
        measure_share = Rate(lasting, lasting + passing, share, max(factor, 1.0)) if lasting + passing else None
        parameters.append(Parameter("false_positives.persistence.share", GROUP, measure_share, share))
    return parameters
