"""Vessels without a transponder, told from false positives."""

from dataclasses import replace

import numpy as np
import pytest

from modsim3d.core.errors import InputError
from modsim3d.detector.file.reading import parse_detector
from modsim3d.formats.labelled import Annotations, Results
from modsim3d.learn.bootstrap import entries_of
from modsim3d.learn.learn_detector import LearnOptions, learn_detector
from modsim3d.learn.learned_detector import RICHER, LearnSettings
from modsim3d.learn.self_check import simulated
from modsim3d.learn.voyage.non_ais.classification import RateSource, TimeSpan, classify_unmatched, parse_stretches
from modsim3d.learn.voyage.report import learn_beside_unseen, rows_of, sentences
from tests.learn.one_state import detector
from tests.learn.voyage.non_ais.voyages import HORIZON_PX, Flicker, observed, voyage

PLAIN = frozenset(RICHER) - {"confidence"}
RATE, SEEDS = 0.4, 30


def interval(learned, name):
    (found,) = (each for each in learned.intervals(0.95) if each.key.names[0] == name)
    return float(found.low), float(found.high)


def mean_false_confidence(learned):
    false = learned.detector()["states"]["all"]["confidence"]["false"]
    return false["mean"] if "mean" in false else float(np.mean(false["quantiles"]))


def test_a_fifth_of_the_vessels_without_transponder_leaves_the_detector_as_it_is():
    """Five boats that a simulated detector looks at, with persistent false positives; one has no transponder."""
    content = detector({"true": {"mean": 0.8, "std": 0.1}, "false": {"mean": 0.4, "std": 0.1}})
    content["false_positives"] |= {"model": "per_image", "persistence": {"lifetime_s": 3.0, "share": 0.5}}
    content["states"]["usual"]["false_positives_per_image"] = RATE
    every = voyage(0, boats=5, kayaks=0, flicker=Flicker(0.0))
    seen = simulated(every, np.zeros(len(every.images), dtype=np.int64), parse_detector(content), 0)
    known = every.annotations.identity != 2
    columns = {name: column[known] for name, column in vars(every.annotations).items() if column is not None}
    results = Results(**{name: getattr(seen.results, name) for name in ("image", "label", "boxes_px", "confidence")})
    labelled = replace(seen, annotations=Annotations(**columns), results=results)
    settings = LearnSettings(replicates=60, without=PLAIN)
    plain = learn_detector(labelled, settings, LearnOptions()).learned
    report, judged = learn_beside_unseen(labelled, settings, LearnOptions())
    assert judged.own_rates(20, 0)[0].source is RateSource.MIXTURE
    low, high = interval(report.learned, "false_positives_per_image")
    assert low <= RATE <= high and interval(plain, "false_positives_per_image")[0] > RATE
    low, high = interval(report.learned, "false_discovery_rate")
    assert low <= RATE / (RATE + 0.9 * 4) <= high
    assert mean_false_confidence(report.learned) == pytest.approx(0.4, abs=0.05) and mean_false_confidence(plain) > 0.5
    state, before = (each.detector()["states"]["all"] for each in (report.learned, plain))
    assert state["confusion"] == before["confusion"]
    (rate,) = judged.rates(report.learned.resampling, judged.observed.image_state, ("all",))
    assert state["false_positives_per_image"] == pytest.approx(float(rate.used.estimate), rel=1e-5)


def test_intervals_hold_the_rate_and_bounds_lie_on_both_sides():
    counts, widths = np.zeros(3), []
    for seed in range(SEEDS):
        labelled = voyage(seed, frames=400, kayaks=2, flicker=Flicker(0.4, 0.4, 3.0), kayak_s=200.0)
        (rate,) = classify_unmatched(observed(labelled)).own_rates(40, seed)
        lower, used, upper = (each.interval(0.95, rate.units) for each in (rate.lower, rate.used, rate.upper))
        counts += lower[0] <= 0.4, used[0] <= 0.4 <= used[1], upper[1] >= 0.4
        widths.append(float(used[1] - used[0]))
    assert np.max(widths) < 0.6
    assert (counts >= 25).all()  # of 30, each with a chance of 95 %: fewer come by chance once in 600 times


def test_a_sea_without_other_vessels_leaves_all_as_it_is():
    labelled, settings = voyage(3, frames=300, kayaks=0), LearnSettings(replicates=20, without=PLAIN)
    plain = learn_detector(labelled, settings, LearnOptions()).learned
    report, judged = learn_beside_unseen(labelled, settings, LearnOptions())
    assert not judged.left_out.any() and report.learned.detector() == plain.detector()
    for one, other in zip(entries_of(report.learned.numbers), entries_of(plain.numbers), strict=True):
        np.testing.assert_array_equal(one.column.values, other.column.values)


def test_frames_too_short_to_tell_give_an_upper_bound_and_say_so():
    judged = classify_unmatched(observed(voyage(2, frames=60, kayaks=2, flicker=Flicker(0.3, 0.0), kayak_s=400.0)))
    (rate,) = judged.own_rates(20, 0)
    assert rate.source is RateSource.ALL and float(rate.lower.estimate) <= 0.4 < 1.0 < float(rate.upper.estimate)
    longer = "may be an upper bound: 2 things seen for longer than 10 s"
    assert any(longer in said for said in sentences(judged, (rate,)))


def test_what_lasts_above_the_horizon_or_changes_its_size_counts_as_false():
    labelled = voyage(0, kayaks=3, above=1, frames=1000)
    judged = classify_unmatched(observed(labelled))
    high = labelled.results.boxes_px[:, 3] < HORIZON_PX - 50
    assert high.sum() > 100 and not judged.left_out[high].any()
    assert judged.left_out.sum() > 100
    assert any("above the horizon" in said for said in sentences(judged, judged.own_rates(20, 0)))
    # What changes its size is false too, but not in the least rate.
    labelled = voyage(0, kayaks=2, frames=1000)
    boxes = labelled.results.boxes_px
    steady = classify_unmatched(observed(labelled))
    of_vessel = steady.links.rows[steady.links.link == np.argmax(steady.tracklets.detections)]
    middle, half = (boxes[of_vessel, 2:] + boxes[of_vessel, :2]) / 2, (boxes[of_vessel, 2:] - boxes[of_vessel, :2]) / 2
    half *= np.exp(0.25 * (-1.0) ** np.arange(len(of_vessel)))[:, None]
    boxes[of_vessel] = np.concatenate([middle - half, middle + half], axis=1)
    judged = classify_unmatched(observed(labelled))
    (rate,) = judged.own_rates(20, 0)
    assert not judged.left_out[judged.links.rows[np.isin(judged.links.rows, of_vessel)]].all()
    assert float(rate.lower.estimate) < 0.35 < float(rate.mixture.estimate)  # 0.3 were drawn
    assert any("as false, but not in the least rate: changes its size" in said for said in sentences(judged, (rate,)))


def test_marked_stretches_give_the_rate_themselves():
    labelled, stretches = voyage(1), (TimeSpan(20, 60), TimeSpan(180, 200.5))
    settings = LearnSettings(replicates=40, without=PLAIN)
    report, judged = learn_beside_unseen(labelled, settings, LearnOptions(), stretches)
    time_s = labelled.images.time_s
    inside = ((time_s >= 20) & (time_s <= 60)) | ((time_s >= 180) & (time_s <= 200.5))
    false = judged.observed.false_positives
    expected = inside[labelled.results.image[false]].sum() / inside.sum()
    (rate,) = judged.own_rates(20, 0)
    assert rate.source is RateSource.EMPTY and float(rate.used.estimate) == pytest.approx(expected, rel=1e-12)
    written = report.learned.detector()["states"]["all"]
    (entry,) = (e for e in entries_of(report.learned.numbers) if e.key.names == ("false_positives_per_image",))
    assert float(entry.estimate) == pytest.approx(expected, rel=1e-9)
    low, high = interval(report.learned, "false_positives_per_image")
    assert low < expected < high and written["false_positives_per_image"] > 0 and "false_discovery_rate" not in written
    assert not judged.left_out[false[inside[labelled.results.image[false]]]].any()
    assert rows_of((rate,), 0.95)[0][-1] == "the stretches marked as empty"


def test_an_empty_stretch_without_a_false_positive_leaves_the_rate_uncertain():
    """Of n images without any, 95 % intervals of the rate reach to about 3 / n, and those of the share as far."""
    labelled = voyage(1)
    seen = observed(labelled)
    time_s = labelled.images.time_s[labelled.results.image]
    kept = np.ones(len(time_s), dtype=bool)
    kept[seen.false[(time_s[seen.false] >= 20) & (time_s[seen.false] <= 24)]] = False
    columns = {name: None if each is None else each[kept] for name, each in vars(labelled.results).items()}
    labelled = replace(labelled, results=Results(**columns))
    settings = LearnSettings(replicates=40, without=PLAIN)
    learned = learn_beside_unseen(labelled, settings, LearnOptions(), (TimeSpan(20, 24),))[0].learned
    (low, high), (_, most) = (interval(learned, f"false_{each}") for each in ("discovery_rate", "positives_per_image"))
    assert low == 0
    assert high / (1 - high) == pytest.approx(most / (len(seen.matched.pairs[0]) / len(labelled.images)), rel=0.5)
    assert most > 2 / (labelled.images.time_s <= 4).sum()


def test_faint_detections_of_an_unseen_vessel_are_left_out_too():
    labelled = voyage(0)
    before = classify_unmatched(observed(labelled))
    rows = before.links.rows[before.lasting[before.links.link] >= 0.5]
    assert len(rows) > 20
    faint = labelled.results.confidence.copy()
    faint[rows[5::9]] = 0.1
    after = classify_unmatched(observed(replace(labelled, results=replace(labelled.results, confidence=faint))))
    assert after.left_out[rows].all()


def test_stretches_are_read_in_seconds_and_in_utc_and_refused_without_frames():
    start = 1704362400.0  # 2024-01-04T10:00:00Z
    assert parse_stretches("120-300, 900-1000.5", None) == (TimeSpan(120, 300), TimeSpan(900, 1000.5))
    utc = "2024-01-04T10:02:00Z/2024-01-04T10:05:00Z"
    assert parse_stretches(utc, start) == (TimeSpan(120, 300),)
    assert [str(each) for each in parse_stretches(utc, start)] == [utc]
    assert parse_stretches("1704362520-1704362700", start) == (TimeSpan(120, 300),)
    for text in (utc, "1704362520-1704362700"):
        with pytest.raises(InputError, match="does not say when it starts"):
            parse_stretches(text, None)
    for text in ("", "5", "300-120", "a-b", "1-2-3", "-5-9", "2024-01-04T10:02:00Z/never"):
        with pytest.raises(InputError, match=r"^empty"):
            parse_stretches(text, start)
    for stretches, said in (
        ((TimeSpan(5000, 6000),), "5000-6000: no frame lies in it; they are from 0 s to"),
        (parse_stretches(utc, 1704276000.0), f"{utc}: no frame lies in it; they are from 2024-01-03T10:00:00Z to"),
    ):
        with pytest.raises(InputError, match=said):
            classify_unmatched(observed(voyage(0, frames=60)), stretches)


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("per_image", [0.0, 0.3])
def test_sets_with_little_in_them_are_judged(timed, per_image):
    labelled = voyage(0, frames=40, kayaks=0, flicker=Flicker(per_image, 0.0))
    if not timed:
        labelled.images.time_s[:] = np.nan
    judged = classify_unmatched(observed(labelled))
    (rate,) = judged.own_rates(10, 0)
    assert rate.unmatched == len(judged.observed.false_positives) and rate.source is RateSource.ALL
    assert float(rate.used.estimate) * 40 == pytest.approx(rate.unmatched)
    assert any("no times" in said for said in sentences(judged, (rate,))) == (not timed and per_image > 0)
