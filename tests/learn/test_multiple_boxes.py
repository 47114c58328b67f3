"""Second boxes, vessels in two parts, two vessels in one box, and false positives on vessels."""

from dataclasses import replace

import numpy as np
import pytest

from modsim3d.campaign.drawn_detectors import LearnedUncertainty, drawn_detector
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.file.unread_keys import dead_lines
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.matching import Rule, match
from modsim3d.formats.reading.coco import read_coco
from modsim3d.formats.writing.coco import write_coco
from modsim3d.learn.bootstrap import resample
from modsim3d.learn.dropout_fit import fit_misses
from modsim3d.learn.match_types import NAMES, kinds_of
from modsim3d.learn.multiple_boxes import ConsecutiveTrials, choose_multiple_boxes
from tests.formats.labelled_files import found, images, truth
from tests.learn import one_state
from tests.learn.one_state import PROVENANCE, detected, detector_file, drawn_models, learned_from, moored
from tests.learn.round_trip import ROOT, asked_of, outside, simulate

DETECTOR = ROOT / "tests" / "data" / "learn" / "multiple_boxes.yaml"


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    return labelled_run(simulate("harbour", tmp_path_factory.mktemp("many"), 2, 250, 3, DETECTOR))[0]


@pytest.mark.parametrize("method", ["provenance", "confidence"])
def test_what_was_asked_for_is_learned_again(many, method, tmp_path):
    labelled = many if method == "provenance" else read_coco("all", *write_coco(many, tmp_path))
    learned = one_state.learned_by_condition(labelled, Rule(method), replicates=100)
    content = learned.detector()
    assert {*NAMES} - {"on_vessels"} <= set(content["false_positives"])
    assert not {"merge_overlap", "split_aspect"} & set(content["false_positives"])  # those of the simulator
    parse_detector(content, "learned")
    # The clear state lasts longest; of false positives as few are left as are made, with their own sizes and labels.
    asked = {path: value for path, value in asked_of(DETECTOR).items() if "haze" not in path and "matrix" not in path}
    assert outside(asked, learned.intervals(0.999)) == {}


def test_nothing_is_learned_where_there_is_nothing(tmp_path):
    none = labelled_run(simulate("harbour", tmp_path, 2, 80, 3))[0]
    for method in ("provenance", "confidence"):
        learned = one_state.learned_by_condition(none, Rule(method))
        assert not set(NAMES) & set(learned.detector()["false_positives"])
        notes = [note.partition(":")[0] for note in learned.form.multiple_boxes.notes]
        assert notes == [f"false_positives.{name}" for name in NAMES]
        without = one_state.learned_by_condition(none, Rule(method), without=frozenset(NAMES))
        assert without.detector() == learned.detector()


def test_merges_that_do_not_persist_or_are_not_to_have_no_correlation_time(many):
    trials = one_state.observed_by_condition(many, PROVENANCE).kinds.trials["merges"]
    assert ConsecutiveTrials.of(many, trials).products().correlation().low > 0.5
    order = np.random.default_rng(0).permutation(len(trials.hits))
    mixed = ConsecutiveTrials.of(many, replace(trials, hits=trials.hits[order])).products().correlation()
    assert not mixed.persists and -0.2 < mixed.low < 0 < mixed.high < 0.2
    nobody = replace(many, annotations=replace(many.annotations, identity=np.full(len(many.annotations), -1)))
    assert not len(ConsecutiveTrials.of(nobody, trials).products())
    left_out = frozenset(), frozenset({"persistence"})
    observed = (one_state.observed_by_condition(many, PROVENANCE, names) for names in left_out)
    with_it, without = map(choose_multiple_boxes, observed)
    assert with_it.merge_s > 0 and without == replace(with_it, merge_s=0.0)


def test_what_is_left_out_counts_as_before(many):
    observed = one_state.observed_by_condition(many, Rule(), frozenset(NAMES))
    matched = observed.matched
    np.testing.assert_array_equal(observed.detection, matched.detection[observed.rows])
    np.testing.assert_array_equal(observed.false, matched.false)
    np.testing.assert_array_equal(observed.false_positives, matched.false)
    assert observed.unambiguous.all() and not observed.in_merged_box.any()


def test_a_run_and_its_boxes_tell_the_same(many):
    every = np.ones(len(many.images), dtype=bool)
    kinds = [kinds_of(many, match(many, rule, 0.2), every) for rule in (Rule("provenance"), Rule())]
    for share, columns in (
        (0.9, lambda each: (each.doubled,)),
        (0.95, lambda each: (each.fragments,)),
        (0.8, lambda each: (each.merged.smaller, each.merged.box)),
    ):
        real, seen = (set(zip(*(column.tolist() for column in columns(each)), strict=True)) for each in kinds)
        assert len(real & seen) >= share * max(len(real), len(seen))


def kinds_of_boxes(truth_px, found_px):
    """What boxes look like in the first of some images; a vessel of its own is found in all of them."""
    far_px = [[500, 500, 560, 520]]
    boxes, seen = far_px * 25 + list(truth_px), far_px * 25 + list(found_px)
    annotations = truth([*range(25), *[0] * len(truth_px)], [0] * len(boxes), boxes).by_image()
    scores = np.linspace(0.9, 0.5, len(seen))
    results = found([*range(25), *[0] * len(found_px)], [0] * len(seen), seen, scores).by_image()
    labelled = one_state.of_boats(images(25), annotations, results)
    return kinds_of(labelled, match(labelled, Rule(), 0.2), np.ones(25, dtype=bool)), labelled.results.boxes_px


def test_shapes():
    kinds, px = kinds_of_boxes([[0, 100, 200, 140]], [[0, 101, 198, 140], [3, 99, 204, 141]])
    assert px[kinds.doubled].tolist() == [[3, 99, 204, 141]]
    kinds, px = kinds_of_boxes([[0, 100, 200, 140]], [[0, 101, 95, 140], [95, 101, 203, 140]])
    assert px[kinds.split[1]].tolist() == [[95, 101, 203, 140]] and px[kinds.fragments].tolist() == [[0, 101, 95, 140]]
    kinds, px = kinds_of_boxes([[0, 100, 200, 140], [150, 100, 300, 135]], [[1, 100, 301, 141]])
    assert px[kinds.merged.box].tolist() == [[1, 100, 301, 141]]
    kinds, px = kinds_of_boxes([[0, 100, 200, 140], [150, 100, 300, 135]], [[1, 100, 199, 141]])
    assert not len(kinds.merged.box) and not len(kinds.doubled) and not len(kinds.fragments)


def test_second_boxes_with_few_false_ones_ask_for_a_rate_of_their_own(many):
    results = many.results
    rare = (results.kind == 0) | (results.kind >= 3)  # no false positives of nothing
    columns = {name: None if column is None else column[rare] for name, column in vars(results).items()}
    learned = one_state.learned_by_condition(replace(many, results=type(results)(**columns)), PROVENANCE)
    content = learned.detector()
    assert content["false_positives"]["model"] == "per_image"
    assert any("every vessel were long" in note for note in learned.notes)
    assert dead_lines(parse_detector(content, "learned")) == []


def test_drawn_second_boxes_leave_room():
    share = {"kind": "share", "observations": 20.0}
    numbers = [{"key": ["false_positives", name], "estimate": 0.2, **share} for name in ("duplicates", "splits")]
    rate = {"key": ["false_discovery_rate"], "estimate": 0.29, **share}
    groups = [
        {"state": None, "units": 50, "numbers": numbers, "correlations": [[], [0.0]]},
        {"state": "good", "units": 50, "numbers": [rate], "correlations": [[]]},
    ]
    content = {"format": 1, "detector_sha256": "", "confidence_threshold": 0.2, "transitions": None, "groups": groups}
    known = LearnedUncertainty.model_validate(content)
    for seed in range(20):
        drawn = drawn_detector(known, seed)
        rate_drawn = drawn["detector.states.good.false_discovery_rate"]
        extra = drawn["detector.false_positives.duplicates"] + drawn["detector.false_positives.splits"]
        assert 0 < extra <= rate_drawn / (1 - rate_drawn) + 1e-12


def test_where_every_box_of_a_state_may_be_in_anothers_misses_are_as_elsewhere() -> None:
    labelled = detected(moored(60, 4, columns=4, size_px=(1200.0, 500.0)), detector_file(missed=0.3), 1)
    observed = one_state.observed_as(labelled, ("clear", "haze"), np.repeat([0, 1], 30))
    observed.__dict__["unambiguous"] = observed.state == 0
    fit = fit_misses(observed, (), resample(labelled.images, 0, 0))
    assert fit is not None and fit.chance == pytest.approx(observed.missed[observed.state == 0].mean(), rel=1e-6)
    assert np.isnan(fit.rates[0, 1]).all()


LAW = {"share": 0.1, "lifetime_s": 1.5, "mean": [0.1, -0.2, 0.5, 0.4], "std": [0.3, 0.15, 0.2, 0.25]}


def detector(**false_positives) -> dict:
    content = detector_file(false_positives_per_image=0.3)
    content["states"]["usual"].pop("false_discovery_rate")
    size = {"model": "lognormal", "px": [40, 30], "log_std": 0.3}
    return content | {"false_positives": {"model": "per_image", "size": size} | false_positives}


@pytest.fixture(scope="module")
def boats():
    return moored(3000, 6, 3, (900.0, 800.0))


@pytest.fixture(scope="module")
def learned(boats):
    return learned_from(detected(boats, detector(on_vessels=LAW), 4))


@pytest.mark.parametrize("rule", ["provenance", "confidence"])
def test_false_positives_on_vessels_are_learned_again(boats, learned, rule: str) -> None:
    if rule == "confidence":
        learned = learned_from(detected(boats, detector(on_vessels=LAW), 4), Rule(rule, least_iou=0.6))
    intervals = {each.key.path.removeprefix("false_positives.on_vessels."): each for each in learned.intervals(0.999)}
    stray = 0.06 if rule == "confidence" else 0.0  # others lie on vessels by chance, and some of these beside them
    for key, asked in LAW.items():
        slack = stray * (10 if key == "lifetime_s" else 1)
        ends = intervals[key].low, intervals[key].high
        assert bool(np.isnan(ends).any()) == (rule == "confidence" and key != "share")  # said not to be known
        low, high = (np.where(np.isnan(end), intervals[key].estimate, end) for end in ends)
        low, high = low - slack, high + slack
        assert np.all((low <= np.array(asked)) & (np.array(asked) <= high)), (key, intervals[key])
    section = learned.detector()["false_positives"]
    assert section["model"] == "per_image" and "duplicates" not in section
    rate = learned.detector()["states"]["usual"]["false_positives_per_image"]
    assert rate == pytest.approx(0.3, abs=0.03 if rule == "provenance" else 0.12)


def test_a_campaign_draws_false_positives_on_vessels(learned, tmp_path) -> None:
    laws = [model.false_positives.on_vessels for model in drawn_models(learned, tmp_path, 3)]
    assert len({law.share for law in laws}) == len({law.std for law in laws}) == 3
    assert all(law.lifetime_s > 0 for law in laws)


def test_second_boxes_that_fit_as_well_as_first_ones_and_false_positives_anywhere_are_not_on_vessels(boats) -> None:
    second, anywhere = (
        learned_from(detected(boats, detector(**false), 4), Rule("confidence", least_iou=0.5))
        for false in ({"duplicates": 0.1}, {})
    )
    section = second.detector()["false_positives"]
    assert section["duplicates"] == pytest.approx(0.1, abs=0.02)
    assert "on_vessels" not in section.keys() | anywhere.detector()["false_positives"].keys()
    (note,) = (note for note in anywhere.notes if note.startswith("false_positives.on_vessels: none; "))
    assert "standard errors from 0" in note or "by chance" in note
