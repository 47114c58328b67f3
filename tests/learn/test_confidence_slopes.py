"""Slopes of confidence, and how long it persists: what was asked of a detector is what is learned."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from modsim3d.campaign.drawn_detectors import LearnedUncertainty, drawn_detector
from modsim3d.detector.file.reading import parse_detector
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Rule
from modsim3d.learn.confidence_fit import ObservedConfidences, SlopeForm, _Point, product_limit
from modsim3d.learn.confidence_laws import Inflation
from modsim3d.learn.learned import Learned, uncertainty_text
from tests.learn import round_trip
from tests.learn.one_state import detected, detector, learned_from, truth_of

SLOPES = {"visibility_slope": 0.4, "size_slope": 0.06, "size_reference_px": 64}
NORMAL = {"true": {"mean": 0.8, "std": 0.1}, "false": {"mean": 0.45, "std": 0.12}}
CLIPPED = {"true": {"mean": 1.0, "std": 0.15}, "false": {"mean": 0.45, "std": 0.12}}
SKEW = {"true": {"quantiles": [0.3, 0.5, 0.8, 0.95, 0.97, 0.98]}, "false": {"mean": 0.45, "std": 0.12}}


def outside(learned: Learned, asked: dict[str, Any]) -> dict[str, int]:
    """Asked numbers of confidence outside their intervals of 99.9 %, or without one; ends of quantiles do not count."""
    flat = {key: value for key, value in asked.items() if not isinstance(value, dict)}
    flat |= {f"{kind}.{key}": asked[kind][key] for kind in ("true", "false") for key in asked[kind]}
    for key, value in flat.items():
        if key.endswith("quantiles"):
            flat[key] = np.interp(np.linspace(0, 1, 21), np.linspace(0, 1, len(value)), value)
            flat[key][[0, 1, -2, -1]] = np.nan
    paths = {f"states.usual.confidence.{key}": value for key, value in flat.items()}
    return round_trip.outside({path: np.array(value) for path, value in paths.items()}, learned.intervals(0.999))


@pytest.fixture(scope="module")
def boats() -> LabelledSet:
    return truth_of(500, 1)


@pytest.fixture(scope="module")
def sloped(boats: LabelledSet) -> LabelledSet:
    return detected(boats, detector(NORMAL | SLOPES), 4)


@pytest.fixture(scope="module")
def learned_lasting(boats: LabelledSet) -> Learned:
    """What is learned from confidences with slopes that persist for a second."""
    return learned_from(detected(boats, detector(NORMAL | SLOPES, persistence={"confidence_s": 1.0}), 4))


@pytest.mark.parametrize(
    ("scores", "method"),
    [(NORMAL, "provenance"), (NORMAL, "confidence"), (CLIPPED, "provenance"), (SKEW, "provenance")],
    ids=["provenance", "confidence", "many are 1", "quantiles"],
)
def test_slopes_come_back_inside_their_intervals_and_no_persistence_that_is_not_there(boats, scores, method) -> None:
    labelled = detected(boats, detector(scores | SLOPES), 4)
    if scores is CLIPPED:
        assert (labelled.results.confidence == 1).mean() > 0.15
    learned = learned_from(labelled, Rule(method))
    assert outside(learned, scores | SLOPES) == {}
    section = learned.detector()["states"]["usual"]["confidence"]
    assert section.keys() == {"true", "false", *SLOPES}
    assert parse_detector(learned.detector()).states[0].confidence.visibility_slope == section["visibility_slope"]
    assert "persistence" not in learned.detector()
    (note,) = (note for note in learned.notes if note.startswith("persistence.confidence_s: 0; "))
    assert note.endswith("includes 0")


def test_slopes_that_are_none_below_zero_or_not_shown_by_the_data_are_left_out(boats, sloped: LabelledSet) -> None:
    learned = learned_from(detected(boats, detector(NORMAL), 4))
    assert outside(learned, NORMAL) == {}
    assert learned.detector()["states"]["usual"]["confidence"].keys() == {"true", "false"}
    for key in ("visibility_slope", "size_slope"):
        (note,) = (note for note in learned.notes if note.startswith(f"states.usual.confidence.{key}: 0; "))
        assert "standard errors above 0" in note and note.endswith("needs 3.3")
    risen = replace(sloped.results, confidence=np.maximum(1.1 - sloped.results.confidence, 0.21))
    learned = learned_from(replace(sloped, results=risen))
    assert learned.detector()["states"]["usual"]["confidence"].keys() == {"true", "false"}
    assert sum("only slopes above 0 are simulated" in note for note in learned.notes) == 2
    unknown = learned_from(detected(truth_of(200, 1, hidden=False), detector(NORMAL | SLOPES), 4))
    assert "states.usual.confidence.visibility_slope: 0; visibility is not given" in unknown.notes
    assert unknown.detector()["states"]["usual"]["confidence"].keys() >= {"size_slope"}
    few = learned_from(detected(truth_of(10, 1), detector(NORMAL | SLOPES), 4))
    (note,) = (note for note in few.notes if "no slopes" in note)
    assert note.endswith("true detections of different confidence, needs 50")


def test_models_that_are_to_be_left_out_are(sloped: LabelledSet) -> None:
    section = learned_from(sloped, without=("slopes",)).detector()["states"]["usual"]["confidence"]
    assert section.keys() == {"true", "false"}
    learned = learned_from(sloped, without=("confidence", "effects", "persistence"))
    section = learned.detector()["states"]["usual"]["confidence"]
    assert section["mean"] == pytest.approx(sloped.results.confidence.mean(), abs=0.03)
    assert section.keys() == {"mean", "std"} and not learned.detector().keys() & {"dropout", "persistence"}
    assert not any("dropout" in note or "persistence.class_s" in note for note in learned.notes)


@pytest.mark.parametrize("scores", [NORMAL | SLOPES, CLIPPED, SKEW], ids=["normal", "many are 1", "quantiles"])
def test_how_long_confidence_persists_comes_back(boats: LabelledSet, learned_lasting: Learned, scores) -> None:
    learned = learned_lasting
    if scores in (CLIPPED, SKEW):
        learned = learned_from(detected(boats, detector(scores, persistence={"confidence_s": 1.0}), 4))
    (interval,) = (each for each in learned.intervals(0.999) if each.key.path == "persistence.confidence_s")
    assert interval.low < 1.0 < interval.high < 2.0
    assert learned.detector()["persistence"].keys() == {"confidence_s"} and learned.run_s > 3
    assert outside(learned, scores) == {}


def test_a_campaign_draws_slopes_and_their_reference(learned_lasting: Learned) -> None:
    known = LearnedUncertainty.model_validate_json(uncertainty_text(learned_lasting, ""))
    drawn = [drawn_detector(known, seed) for seed in range(3)]
    for key in ("states.usual.confidence.visibility_slope", "states.usual.confidence.size_reference_px",
                "persistence.confidence_s"):  # fmt: skip
        values = [each[f"detector.{key}"] for each in drawn]
        assert len(set(values)) == 3 and min(values) > 0


def test_the_product_limit_is_the_mean_over_what_each_bound_leaves_open() -> None:
    # Self-consistent (Efron (1967)): a bound counts as the part of the distribution below it.
    rng = np.random.default_rng(2)
    base, clipped, weights = rng.normal(size=60), rng.random(60) < 0.4, rng.integers(1, 4, 60).astype(float)
    clipped[base.argmin()] = False
    values, mass = product_limit(base, clipped, weights)
    for at in np.linspace(-2, 2, 15):
        parts = np.where(clipped, 0.0, base <= at)
        for row in np.flatnonzero(clipped):
            parts[row] = mass[values <= min(at, base[row])].sum() / mass[values <= base[row]].sum()
        assert mass[values <= at].sum() == pytest.approx((weights * parts).sum() / weights.sum(), abs=1e-12)


def test_the_curvature_of_the_fit_is_the_derivative_of_its_gradient() -> None:
    rng = np.random.default_rng(3)
    count = 40
    scores = ObservedConfidences(
        np.clip(rng.normal(0.8, 0.3, count), 0.2, 1), np.arange(count), np.zeros(count, dtype=np.int64),
        rng.uniform(0, 1, count), rng.uniform(3, 7, count), np.arange(count),
    )  # fmt: skip
    point = _Point(np.array([0.8, 0.25, 0.3, 0.05]), (scores,), (False,), SlopeForm(True, True, 6.0), 0.2)
    gradient, curvature = point.newton()
    for k, move in enumerate(1e-5 * np.eye(4)):
        ahead, behind = (replace(point, values=point.values + sign * move) for sign in (1, -1))
        np.testing.assert_allclose(-(ahead.newton()[0] - behind.newton()[0]) / 2e-5, curvature[k], rtol=1e-4, atol=1e-3)
        np.testing.assert_allclose((ahead.likelihood() - behind.likelihood()) / 2e-5, gradient[k], rtol=1e-5, atol=1e-4)


def test_parts_of_confidence_that_things_keep_widen_its_means_and_spreads() -> None:
    rng, thing = np.random.default_rng(5), np.repeat(np.arange(2000), 10)
    values = np.sqrt(0.3) * rng.standard_normal(2000)[thing] + np.sqrt(0.7) * rng.standard_normal(20_000)
    kept, alone = Inflation.by_things(values, thing), Inflation.by_things(values, np.arange(20_000))
    assert kept.mean == pytest.approx(1 + 9 * 0.3, rel=0.1) and kept.std == pytest.approx(1 + 9 * 0.3**2, rel=0.1)
    assert alone.mean == pytest.approx(1, abs=1e-3) and Inflation.by_things(values[:5], thing[:5]) == Inflation()
