"""False positives: their rate, their kinds and their labels, held against what the model expects."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import centres, sizes, unions
from modsim3d.core.random_streams import Streams
from modsim3d.detector import records
from modsim3d.detector.chain import DetectorPart, false_positive_rates, false_positive_source
from modsim3d.detector.draws import select
from modsim3d.detector.false_positive_placement import DRAWS
from modsim3d.detector.false_positives import FrameCounts, VesselFalseBoxes, persistent_false_positives
from modsim3d.detector.merges_and_splits import MIN_SPLIT_PX, MergesAndSplits
from modsim3d.detector.model import DetectorModel
from modsim3d.verify.class_checks import expected_outcomes, lag_pairs, turn_before
from modsim3d.verify.evidence import CameraEvidence, Evidence, Instances, frames_above_max, unknown_rest_note
from modsim3d.verify.measures import CORRELATION, DiscoveryRate, Estimate, Exact, ImageRate, Rate
from modsim3d.verify.parameters import Law, Parameter

MIN_FALSE = 50
MIN_LIFETIMES = 20  # least length of a run in lifetimes, times the mean number, for which lifetimes are tested
_DRAWS_EACH = 40
_REPLAYS = 150
_DIGITS = 6  # decimals of a pixel: equal sides that were read back from centre and size stay equal


def placement_checks(model: DetectorModel, evidence: Evidence, persistent: Array) -> list[Parameter]:
    """Places and sizes of transient false positives, and the lifetime of persistent ones. `persistent` is the expected
    number of persistent ones in each frame, shape (s,)."""
    note = unknown_rest_note(model, evidence)
    names = ("placement[below the horizon]", "placement[along the horizon]", "size[width]", "size[height]")
    laws = [None] * len(names) if note else _laws(model, evidence)
    parameters = [
        Parameter(f"false_positives.{name}", DetectorPart.FALSE_POSITIVES, law, 0.0, note=note)
        for name, law in zip(names, laws, strict=True)
    ]
    if model.false_positives.persistent_share:
        lifetime = None if note else _lifetime(model, evidence, persistent)
        note = note or "as the correlation of their number from one frame to the next"
        name = "false_positives.persistence.lifetime_s"
        parameters.append(Parameter(name, DetectorPart.FALSE_POSITIVES, lifetime, note=note))
    return parameters


def _laws(model: DetectorModel, evidence: Evidence) -> list[Law] | list[None]:
    """Distance of each column of `_places_and_sizes` from many draws in the same frames (Smirnov (1939))."""
    source, rng = false_positive_source(model, evidence.target_statistics(model)), np.random.default_rng(0)
    places, drawn = [], []
    for seen in evidence.cameras:
        rows = np.flatnonzero(seen.detections.kind == records.FALSE_POSITIVE)
        frame = seen.detections.frame[rows]
        places.append(_places_and_sizes(seen.frames, frame, seen.detections.boxes_px[rows]))
        again = np.repeat(frame, _DRAWS_EACH)
        boxes = source.boxes_px(seen.frames, _detected_vessels(seen), again, rng.random((len(again), DRAWS + 1)))
        drawn.append(_places_and_sizes(seen.frames, again, boxes))
    values, expected = np.concatenate(places), np.concatenate(drawn)
    if len(values) < MIN_FALSE:
        return [None] * 4
    worth = len(values) * _DRAWS_EACH // (_DRAWS_EACH + 1)  # the draws too are a sample
    return [Law(_distance(values[:, k], expected[:, k]), worth) for k in range(4)]


def _detected_vessels(seen: CameraEvidence) -> records.Targets:
    """The detected vessels as the detector had them, with merged ones in one box."""
    detections = seen.detections
    true = np.flatnonzero(~detections.false())
    true = true[np.argsort(detections.frame[true], kind="stable")]
    kept = select(seen.targets, detections.target[true])
    merged = np.flatnonzero(detections.partner[true] >= 0)
    boxes = kept.boxes_px.copy()
    boxes[merged] = unions(boxes[merged], seen.targets.boxes_px[detections.partner[true[merged]]])
    return replace(kept, boxes_px=boxes)


def _places_and_sizes(frames: records.CameraFrames, frame: Indices, boxes_px: Array) -> Array:
    """Depth of the middle below the horizon, place along it, width, height; in pixels, shape (m, 4)."""
    a, b, c = frames.sea_half_planes[frame].T
    length = np.hypot(a, b)
    x, y = centres(boxes_px).T
    some, level = np.where(length > 0, length, 1), length == 0  # without a horizon: depth below the upper edge
    below = np.where(level, y, (a * x + b * y + c) / some)
    along = np.where(level, x, (b * x - a * y) / some)
    return np.round(np.column_stack([below, along, sizes(boxes_px)]), _DIGITS)


def _distance(values: Array, expected: Array) -> float:
    places = np.concatenate([values, expected])
    shares = [np.searchsorted(np.sort(sample), places, side="right") / len(sample) for sample in (values, expected)]
    return float(np.abs(shares[0] - shares[1]).max())


def _lifetime(model: DetectorModel, evidence: Evidence, persistent: Array) -> Estimate | None:
    """Estimate ρ = e^(−Δt/lifetime) from how much the number of persistent ones changes from frame to frame. With m
    expected in one frame and m' in the next, the mean square change of the number less its expectation is m + m' −
    2ρ·min(m, m'). Replays of the process give the standard error."""
    images, lifetime = evidence.frames, model.false_positives.lifetime_s
    rows = np.flatnonzero(persistent > 0)
    same = images.camera[rows][1:] == images.camera[rows][:-1]
    now, before = rows[1:][same], rows[:-1][same]
    if not len(now):
        return None
    apart = images.time_s[now] - images.time_s[before]
    common = np.minimum(persistent[now], persistent[before])
    if float((common * apart).sum()) < MIN_LIFETIMES * lifetime:
        return None

    def correlation(numbers: Array) -> float:
        surplus = numbers - persistent
        changes = (surplus[now] - surplus[before]) ** 2
        return float((persistent[now] + persistent[before] - changes).sum() / (2 * common.sum()))

    counts = [
        np.bincount(s.detections.frame[s.detections.kind == records.PERSISTENT], minlength=len(s.frames))
        for s in evidence.cameras
    ]
    asked = float((np.exp(-apart / lifetime) * common).sum() / common.sum())
    replays = np.array([correlation(_replayed(evidence, persistent, lifetime, seed)) for seed in range(_REPLAYS)])
    error = float(replays.std())
    if error <= 0:
        return None
    skewness = float(((replays - replays.mean()) ** 3).mean()) / error**3
    return Estimate(correlation(np.concatenate(counts)), asked, error, len(now), skewness, possible=CORRELATION)


def _replayed(evidence: Evidence, persistent: Array, lifetime_s: float, seed: int) -> Array:
    """Number of persistent false positives in each frame with another seed, shape (s,)."""
    numbers, streams, first = [], Streams(seed), 0
    for seen in evidence.cameras:
        means = persistent[first : first + len(seen.frames)]
        shown = persistent_false_positives(streams, seen.frames, means, lifetime_s)
        numbers.append(np.bincount(shown.frame, minlength=len(means)))
        first += len(means)
    return np.concatenate(numbers)


@dataclass(frozen=True, eq=False)
class ExpectedFalsePositives:
    """Expected numbers of false positives in each image, given what was detected; shapes (s,)."""

    due: Mask  # whether the detector runs
    transient: Array  # mean number of transient false positives
    persistent: Array  # mean number of persistent ones
    extras: Array  # mean number of second boxes of vessels
    extra_variance: Array  # variance of the number of second boxes
    dispersion: Array  # variance of the number of transient ones over its mean: 1 for a Poisson number

    @property
    def all(self) -> Array:
        """Mean number of every kind, shape (s,)."""
        return self.transient + self.persistent + self.extras


def expected_false_positives(model: DetectorModel, evidence: Evidence) -> ExpectedFalsePositives:
    """Expectation of the detector's own model of false positives."""
    images, numbers, rates = evidence.frames, model.false_positives.numbers, false_positive_rates(model)
    due = np.concatenate([model.gates.due(seen.frames) for seen in evidence.cameras])
    extras, variance = _extras(model, evidence)
    frames = FrameCounts(images.state, due, images.n_kept, extras)
    means, share = numbers.means(rates, frames), model.false_positives.persistent_share
    dispersion = numbers.dispersion(rates, frames)
    return ExpectedFalsePositives(due, (1 - share) * means, share * means, extras, variance, dispersion)


@dataclass(frozen=True, eq=False)
class FalsePositiveEvidence:
    """Data from which the rates of false positives are measured."""

    model: DetectorModel
    evidence: Evidence
    expected: ExpectedFalsePositives

    def persistent_variance(self, mask: Mask) -> float:
        """Variance of the number of persistent ones in the images chosen by a mask of shape (s,). Two images Δt apart
        with means m and m′ share min(m, m′)·e^(−Δt/lifetime) of them on average."""
        rows = np.flatnonzero(mask & (self.expected.persistent > 0))
        if not len(rows):
            return 0.0
        images, mean = self.evidence.frames, self.expected.persistent[rows]
        total, lifetime = float(mean.sum()), self.model.false_positives.lifetime_s
        for later, earlier, apart in lag_pairs(images.camera[rows, None], images.time_s[rows], lifetime):
            total += 2 * float((np.exp(-apart / lifetime) * np.minimum(mean[later], mean[earlier])).sum())
        return total


class RateCheck(Protocol):
    """Measures the rate of false positives that one model has."""

    def of_state(self, seen: FalsePositiveEvidence, s: int) -> Parameter:
        """The rate of a state."""

    def overall(self, seen: FalsePositiveEvidence) -> list[Parameter]:
        """The rate of all states together, if that says more."""


@dataclass(frozen=True)
class DiscoveryRateCheck:
    """The false discovery rate; `falls_short` if the model's own rule aims at another rate than the file's."""

    falls_short: bool = False

    def of_state(self, seen: FalsePositiveEvidence, s: int) -> Parameter:
        """The rate of a state."""
        state, measure = seen.model.states[s], self._measure(seen, seen.evidence.frames.state == s)
        name, rate = f"states.{state.name}.false_discovery_rate", state.false_discovery_rate
        parameter = Parameter(name, DetectorPart.FALSE_POSITIVES, measure, rate, state=state.name)
        if not self.falls_short:
            return parameter
        return replace(parameter, promised=rate, note="asked: what the rule of eq. 7.35 gives here")

    def overall(self, seen: FalsePositiveEvidence) -> list[Parameter]:
        """The rate of all states together."""
        measure = self._measure(seen, np.ones(len(seen.evidence.frames.state), dtype=bool))
        promised = self._promised(seen) if self.falls_short else None
        name = "false discovery rate, all states"
        return [Parameter(name, DetectorPart.FALSE_POSITIVES, measure, in_file=False, promised=promised)]

    @staticmethod
    def _promised(seen: FalsePositiveEvidence) -> float | None:
        """The share of false positives that the states' rates ask for together."""
        kept = seen.evidence.frames.n_kept
        rate = seen.model.column("false_discovery_rate")[seen.evidence.frames.state]
        asked = float((kept * rate / (1 - rate)).sum())
        return asked / (asked + float(kept.sum())) if kept.sum() else None

    @staticmethod
    def _measure(seen: FalsePositiveEvidence, mask: Mask) -> DiscoveryRate | None:
        images, expected = seen.evidence.frames, seen.expected
        true = float(images.n_kept[mask].sum())
        if not true:
            return None
        mean = float(expected.all[mask].sum())
        variance = float((expected.transient * expected.dispersion + expected.extra_variance)[mask].sum())
        variance += seen.persistent_variance(mask)
        inflation = variance / mean if mean > 0 else 1.0
        return DiscoveryRate(float(images.n_false[mask].sum()), true, mean, inflation or 1.0)


class ImageRateCheck:
    """The number of false positives in an image."""

    def of_state(self, seen: FalsePositiveEvidence, s: int) -> Parameter:
        """The rate of a state."""
        state = seen.model.states[s]
        name, rate = f"states.{state.name}.false_positives_per_image", state.false_positives_per_image
        return Parameter(name, DetectorPart.FALSE_POSITIVES, self._measure(seen, s), rate, state=state.name)

    def overall(self, seen: FalsePositiveEvidence) -> list[Parameter]:
        """Nothing: images of different rates have no common one."""
        return []

    @staticmethod
    def _measure(seen: FalsePositiveEvidence, s: int) -> ImageRate | None:
        mask, expected, false = seen.evidence.frames.state == s, seen.expected, seen.evidence.false_positives
        count = int(np.isin(false.kind, (records.FALSE_POSITIVE, records.PERSISTENT))[false.state == s].sum())
        images = float(expected.due[mask].sum())
        if not images:
            return None
        mean = float((expected.transient + expected.persistent)[mask].sum())
        variance = float((expected.transient * expected.dispersion)[mask].sum()) + seen.persistent_variance(mask)
        return ImageRate(count, images, mean / images, variance / mean if mean else 1.0)


RATE_CHECKS: Mapping[str, RateCheck] = {
    "calibrated": DiscoveryRateCheck(),
    "thesis": DiscoveryRateCheck(falls_short=True),
    "per_image": ImageRateCheck(),
}
"""By the name of the model of false positives; models that are missing here are reported as unchecked."""


def second_box_candidates(model: DetectorModel, evidence: Evidence) -> tuple[Indices, Mask]:
    """Rows of true detections that may be doubled or split, and whether they are long enough, shapes (k,)."""
    true_detections, false = evidence.true_detections, evidence.false_positives
    single = np.flatnonzero((true_detections.kind == records.TRUE) | (true_detections.kind == records.SPLIT))
    instances = true_detections.instance[single]
    placed = sizes(true_detections.boxes_px[single])[:, 0]
    pieces = np.flatnonzero(false.kind == records.FRAGMENT)
    of = {int(chance): int(row) for row, chance in zip(pieces, false.instance[pieces], strict=True)}
    is_split = true_detections.kind[single] == records.SPLIT
    split = np.flatnonzero(is_split & np.isin(instances, [*of]))  # both were put out
    other = np.array([of[int(chance)] for chance in instances[split]], dtype=np.int64)
    placed[split] += sizes(false.boxes_px[other])[:, 0]  # both parts together
    truth = np.concatenate([seen.targets.boxes_px for seen in evidence.cameras])
    return single, model.merges_and_splits.looks_long(truth[instances]) & (placed >= MIN_SPLIT_PX)


def _extras(model: DetectorModel, evidence: Evidence) -> tuple[Array, Array]:
    """Mean and variance of the number of second boxes in each image, shapes (s,)."""
    rule, size = model.merges_and_splits, len(evidence.frames.state)
    if not rule.duplicates and not rule.splits:
        return np.zeros(size), np.zeros(size)
    single, long = second_box_candidates(model, evidence)
    chance = rule.duplicates + rule.splits * long
    image = evidence.images_of(evidence.true_detections.instance[single])
    amounts = chance, chance * (1 - chance)
    mean, variance = (np.bincount(image, amount, minlength=size).astype(np.float64) for amount in amounts)
    return mean, variance


def false_positive_checks(model: DetectorModel, evidence: Evidence) -> list[Parameter]:
    """The rate of each state and of all, the kinds, and the labels of false positives."""
    note = unknown_rest_note(model, evidence)
    seen = FalsePositiveEvidence(model, evidence, expected_false_positives(model, evidence))
    check = RATE_CHECKS.get(model.false_positives.model)
    parameters = []
    if model.gates.max_detections is not None:
        wrong = Exact(frames_above_max(model, evidence), len(evidence.frames.state))
        parameters.append(Parameter("gates.max_detections", DetectorPart.FALSE_POSITIVES, wrong))
    for s in range(len(model.states)):
        parameters += [] if check is None else [check.of_state(seen, s).unless(note)]
        parameters += _label_checks(model, evidence, s)
    parameters += [] if check is None else [overall.unless(note) for overall in check.overall(seen)]
    if not note:
        parameters += [*_second_box_checks(seen), _merge_check(seen), _persistent_share_check(seen)]
        parameters += _on_vessel_checks(seen)
    return [*parameters, *placement_checks(model, evidence, seen.expected.persistent)]


def _label_checks(model: DetectorModel, evidence: Evidence, s: int) -> list[Parameter]:
    """The labels of transient ones: a persistent one keeps its label, so only the others are independent."""
    state, false = model.states[s], evidence.false_positives
    if len(model.labels) < 2:
        return []
    labels = false.label[(false.state == s) & (false.kind == records.FALSE_POSITIVE)]
    note = "of those that do not persist" if model.false_positives.persistent_share else ""
    return [
        Parameter(
            f"states.{state.name}.false_positive_labels[{label}]",
            DetectorPart.FALSE_POSITIVES,
            Rate(int((labels == i).sum()), len(labels), float(state.false_positive_labels[i])) if len(labels) else None,
            float(state.false_positive_labels[i]),
            state=state.name,
            note=note,
        )
        for i, label in enumerate(model.labels)
    ]


def _second_box_checks(seen: FalsePositiveEvidence) -> list[Parameter]:
    rule, kinds = seen.model.merges_and_splits, seen.evidence.false_positives.kind
    if rule == MergesAndSplits() and not np.isin(kinds, (records.DUPLICATE, records.FRAGMENT)).any():
        return []
    single, long = second_box_candidates(seen.model, seen.evidence)
    parameters = []
    for name, kind, count in (("duplicates", records.DUPLICATE, len(single)), ("splits", records.FRAGMENT, long.sum())):
        asked = float(getattr(rule, name))
        measure = Rate(int((kinds == kind).sum()), int(count), asked) if count else None
        parameters.append(Parameter(f"false_positives.{name}", DetectorPart.FALSE_POSITIVES, measure, asked))
    return parameters


_SAMPLED = 20_000  # vessels of which it is drawn how often a false positive on one lies in the image


def _on_vessel_checks(seen: FalsePositiveEvidence) -> list[Parameter]:
    """Share, stay and place of false positives on vessels; what the image's edge leaves out and cuts is drawn anew."""
    law, false = seen.model.false_positives.on_vessels, seen.evidence.false_positives
    name, lying = "false_positives.on_vessels", np.flatnonzero(false.kind == records.ON_VESSEL)
    if law is None:
        measure = Exact(len(lying), len(false.kind))
        return [Parameter(f"{name}.share", DetectorPart.FALSE_POSITIVES, measure)] if len(lying) else []
    instances, rng = seen.evidence.instances, np.random.default_rng(0)
    passed = np.flatnonzero(expected_outcomes(seen.model, seen.evidence).passed)
    shown, place = np.zeros(len(instances.vessel), dtype=bool), np.full((len(instances.vessel), 4), np.nan)
    rows = false.instance[lying]
    shown[rows], place[rows] = True, _place_on(instances.boxes_px[rows], false.boxes_px[lying])
    chosen = rng.choice(passed, min(len(passed), _SAMPLED), replace=False)
    inside = len(_places_on(law, instances, np.repeat(chosen, _DRAWS_EACH), rng)) / max(len(chosen) * _DRAWS_EACH, 1)
    before = turn_before(seen.model, seen.evidence)
    later = np.flatnonzero((before >= 0) & shown[before])
    kept = np.zeros(len(later))
    if law.lifetime_s:
        kept = np.exp(-(instances.time_s[later] - instances.time_s[before[later]]) / law.lifetime_s)
    usual = float(kept.mean()) if len(kept) else 0.0
    goes_on = usual + (1 - usual) * law.share * inside
    fresh = shown.copy()
    # Of one that stays the image's edge changes some numbers at most.
    fresh[later] &= np.abs(place[later] - place[before[later]]).min(axis=1) > 10.0**-_PLACE_DIGITS
    new = np.flatnonzero(fresh)
    around = _places_on(law, instances, np.repeat(new, _DRAWS_EACH), rng)
    share = _rate(shown[passed], law.share, (1 + usual) / max(1 - usual, 1e-9), inside)
    measures: dict[str, tuple[Rate | Law | None, float]] = {
        "share": (share, law.share),
        "lifetime_s": (_rate(shown[later], goes_on), law.lifetime_s),
    }
    for k, axis in enumerate(("across", "down", "log width", "log height")):
        worth = len(new) * _DRAWS_EACH // (_DRAWS_EACH + 1)
        compared = Law(_distance(place[new, k], around[:, k]), worth) if len(new) >= MIN_FALSE else None
        measures[f"place[{axis}]"] = (compared, 0.0)
    return [
        Parameter(f"{name}.{key}", DetectorPart.FALSE_POSITIVES, measure, asked, note=_ON_VESSEL_NOTES.get(key, ""))
        for key, (measure, asked) in measures.items()
    ]


_ON_VESSEL_NOTES = {"lifetime_s": "as the chance that one is there in the next frame again"}
_PLACE_DIGITS = 4  # decimals of a place on a vessel: boxes that were read back from a table are rounded


def _place_on(vessels_px: Array, boxes_px: Array) -> Array:
    """Centres from those of vessels in their sides, and logarithms of the ratios of sides, shape (m, 4)."""
    sides = sizes(vessels_px)
    shift = (centres(boxes_px) - centres(vessels_px)) / sides
    return np.round(np.hstack([shift, np.log(sizes(boxes_px) / sides)]), _PLACE_DIGITS)


def _places_on(law: VesselFalseBoxes, instances: Instances, rows: Indices, rng: np.random.Generator) -> Array:
    """Places of false positives that are drawn on vessels, as the image shows them, shape (at most m, 4)."""
    uniforms = rng.random((len(rows), 5))
    uniforms[:, 0] = 0.0  # on each of them
    boxes, visible = law.boxes_px(instances.boxes_px[rows], instances.image_px[rows], uniforms)
    return _place_on(instances.boxes_px[rows[visible]], boxes[visible])


def _rate(happened: Mask, asked: float, inflation: float = 1.0, inside: float = 1.0) -> Rate | None:
    """Share of those that happened of all that could, which is a part `inside` of them."""
    trials = inside * len(happened)
    return Rate(int(happened.sum()), trials, asked, inflation) if trials >= MIN_FALSE else None


def _merge_check(seen: FalsePositiveEvidence) -> Parameter:
    name, merges = "false_positives.merges", seen.model.merges_and_splits.merges
    kinds = seen.evidence.true_detections.kind
    if merges == 0:
        return Parameter(name, DetectorPart.FALSE_POSITIVES, Exact(int((kinds == records.MERGED).sum()), len(kinds)))
    note = "which pairs could have been merged depends on others that were: only counted"
    return Parameter(name, DetectorPart.FALSE_POSITIVES, None, merges, note=note)


def _persistent_share_check(seen: FalsePositiveEvidence) -> Parameter:
    name, share = "false_positives.persistence.share", seen.model.false_positives.persistent_share
    kinds, expected = seen.evidence.false_positives.kind, seen.expected
    persistent, transient = int((kinds == records.PERSISTENT).sum()), int((kinds == records.FALSE_POSITIVE).sum())
    if not share:
        return Parameter(name, DetectorPart.FALSE_POSITIVES, Exact(persistent, len(kinds)))
    if not persistent + transient:
        return Parameter(name, DetectorPart.FALSE_POSITIVES, None, share)
    variance = seen.persistent_variance(np.ones(len(expected.persistent), dtype=bool))
    # The variance of the number of persistent ones, and of the rest, over that of a binomial share of them.
    total = float(expected.persistent.sum()) + float(expected.transient.sum())
    spread = (1 - share) ** 2 * variance + share**2 * float(expected.transient.sum())
    factor = spread / max(total * share * (1 - share), 1e-12) if share < 1 else 1.0
    measure = Rate(persistent, persistent + transient, share, max(factor, 1.0))
    return Parameter(name, DetectorPart.FALSE_POSITIVES, measure, share)
