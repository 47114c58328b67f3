"""`verify` where two models of a detector meet: what one of them leaves to be seen must not count against the other."""

from typing import Any

import numpy as np
import pytest

from modsim3d import DetectorModel, MomentTable
from modsim3d.core.boxes import sizes
from modsim3d.detector.file.reading import parse_detector
from modsim3d.verify.box_error_checks import MIN_DETECTIONS, box_error_checks, with_known_errors
from modsim3d.verify.class_checks import class_checks
from modsim3d.verify.confidence_checks import confidence_checks
from modsim3d.verify.evidence import Evidence, ManyDetections
from modsim3d.verify.false_positive_checks import false_positive_checks
from modsim3d.verify.figures import run_lengths
from modsim3d.verify.measures import Estimate, Exact
from modsim3d.verify.parameters import Parameter, judge
from modsim3d.verify.verification import state_checks
from modsim3d.verify.verify_run import conclusion, row_of
from tests.detector_variants import Data, thesis_data, variant
from tests.scenes import harbour_of_shoeboxes


def changed(**sections: Any) -> DetectorModel:
    return parse_detector(thesis_data() | sections)


def three_labels(share: float) -> DetectorModel:
    data: Data = thesis_data() | {"labels": ["Vessel", "Ferry", "Kayak"]}
    data["false_positives"] = {"model": "calibrated", "persistence": {"lifetime_s": 20.0, "share": share}}
    for state in data["states"].values():
        missed = state["confusion"][-1][0]
        state["confusion"] = [[1 - missed if i == j else 0.0 for j in range(3)] for i in range(3)] + [[missed] * 3]
        state["false_positive_labels"] = [0.5, 0.3, 0.2]
    return parse_detector(data)


def test_labels_that_persist_are_not_taken_for_independent_ones_but_those_beside_them_are_tested(many) -> None:
    def tested(share: float, seed: int) -> list[Any]:
        model = three_labels(share)
        found = false_positive_checks(model, many.detect(model, seed))
        return [p.measure for p in found if "false_positive_labels" in p.name and p.measure is not None]

    assert tested(1.0, 0) == []  # in 40 s one that lives for 20 s on average shows its label in frame after frame
    beside = [measure for seed in range(6) for measure in tested(0.5, seed)]
    assert len(beside) > 40 and min(measure.p_value() for measure in beside) > 1e-5


def test_splits_leave_the_law_of_box_errors_as_it_is(many: ManyDetections) -> None:
    def error_widths(splits: float) -> tuple[np.ndarray, np.ndarray]:
        model = changed(false_positives={"model": "per_image", "rate": 0.0, "splits": splits, "split_aspect": 0.2})
        evidence = many.detect(model, 3)
        rows = np.flatnonzero(with_known_errors(model, evidence))
        return evidence.true_detections.errors_px[rows, 2], sizes(evidence.true_detections.boxes_px[rows])[:, 0] < 4

    (every, every_narrow), (some, some_narrow) = error_widths(0.0), error_widths(0.9)
    assert 0.05 * len(every) < len(some) < 0.2 * len(every)
    assert abs(some.mean() - every.mean()) < 4 * every.std() / np.sqrt(len(some))
    share = every_narrow.mean()
    assert abs(some_narrow.mean() - share) < 4 * np.sqrt(share * (1 - share) / len(some))


def test_only_what_an_operating_threshold_drops_is_not_tested(many: ManyDetections, table: MomentTable) -> None:
    model = parse_detector(thesis_data() | {"operating_threshold": 0.7})
    evidence = many.detect(model, 0)
    checks = class_checks, false_positive_checks, confidence_checks
    rates = [parameter for check in checks for parameter in check(model, evidence)]
    untested = [p for p in rates if p.name.startswith("states.") and "false_positive_labels" not in p.name]
    assert untested and all(p.measure is None and p.note.startswith("operating_threshold is 0.7") for p in untested)
    (least,) = [p.measure for p in rates if p.name == "operating_threshold"]
    assert least.wrong == 0
    assert any(p.measure is not None for p in box_error_checks(model, evidence, table) if p.name.startswith("states."))
    other = parse_detector(thesis_data() | {"operating_threshold": 0.8})
    (least,) = [p.measure for p in confidence_checks(other, evidence) if p.name == "operating_threshold"]
    assert least.wrong > 0


@pytest.mark.parametrize("limit", [{"operating_threshold": 0.7}, {"gates": {"max_detections": 2}}])
def test_parts_of_vessels_of_which_one_was_dropped_are_no_fault(many: ManyDetections, limit: Data) -> None:
    clutter = {"model": "per_image", "rate": 0.1, "splits": 0.5, "split_aspect": 0.2, "duplicates": 0.1}
    model = parse_detector(thesis_data() | {"false_positives": clutter} | limit)
    found = false_positive_checks(model, many.detect(model, 0))
    assert any(p.name.endswith("false_positives_per_image") and p.measure is None for p in found)
    assert min([p.measure.p_value() for p in found if p.measure is not None], default=1.0) > 1e-5


def test_box_errors_are_not_tested_where_the_largest_boxes_were_kept(many: ManyDetections, table: MomentTable) -> None:
    data = thesis_data() | {"gates": {"max_detections": 2}}
    data["states"]["good"]["confidence"]["size_slope"] = 0.1
    model = parse_detector(data)
    evidence = many.detect(model, 0)
    found = box_error_checks(model, evidence, table)
    of_good = [p for p in found if p.name.startswith("states.good.")]
    assert of_good and all(p.measure is None and "max_detections was reached" in p.note for p in of_good)
    enough = np.bincount(evidence.instances.state[evidence.true_detections.instance], minlength=4) >= MIN_DETECTIONS
    assert enough.sum() > 1
    assert any(p.measure is not None for p in found if p.name.startswith("states.") and p not in of_good)


def persistence_of(model: DetectorModel, evidence: Evidence, table: MomentTable) -> list[Parameter]:
    every = [*class_checks(model, evidence), *box_error_checks(model, evidence, table)]
    return [parameter for parameter in every if parameter.name.startswith("persistence.")]


def test_persistence_is_seen_between_two_turns_of_the_detector(many: ManyDetections, table: MomentTable) -> None:
    gates = {"update_interval_s": 0.4}
    model = changed(gates=gates, persistence={"class_s": 1.0, "box_s": 1.0})
    evidence = many.detect(model, 4)
    for parameter in persistence_of(model, evidence, table):
        assert parameter.measure is not None and parameter.measure.asked == pytest.approx(np.exp(-0.4), rel=1e-9)
        assert parameter.measure.p_value() > 1e-4
    for parameter in persistence_of(changed(gates=gates), evidence, table):
        assert parameter.measure is not None and parameter.measure.p_value() < 1e-6


def test_misses_that_persist_for_ever_are_obeyed_and_those_that_do_not_are_seen(many: ManyDetections) -> None:
    for_ever = changed(persistence={"class_s": 1e9})
    for seed in range(4):
        found = judge(class_checks(for_ever, many.detect(for_ever, seed)))
        assert found.obeys, [(verdict.parameter.name, verdict.p_value) for verdict in found.failed]
        cause = judge(class_checks(for_ever, many.detect(changed(), seed))).cause
        assert cause is not None and cause.parameter.name == "persistence.class_s"


def test_box_errors_that_stay_with_a_few_vessels_are_too_little_seen(many: ManyDetections, table: MomentTable) -> None:
    for_ever = changed(persistence={"box_s": 1e6})
    found = box_error_checks(for_ever, many.detect(for_ever, 0), table)
    laws = [parameter for parameter in found if parameter.name.startswith("states.")]
    assert laws and all(parameter.measure is None for parameter in laws)
    persistence = found[-1].measure
    assert persistence is not None and persistence.p_value() > 1e-4
    for_a_moment = changed(persistence={"box_s": 0.05})
    found = box_error_checks(for_a_moment, many.detect(for_a_moment, 0), table)
    assert sum(p.measure is not None for p in found if p.name.startswith("states.")) > len(laws) / 3


def box_persistence(asked: DetectorModel, evidence: Evidence, table: MomentTable) -> Estimate:
    measure = box_error_checks(asked, evidence, table)[-1].measure
    assert isinstance(measure, Estimate)
    return measure


def test_what_truncation_leaves_of_a_correlation_is_told_from_all_of_it(many, table: MomentTable) -> None:
    # Half of the first draws leave no box: of a correlation of 0.2 from frame to frame 0.05 is left.
    made_with = changed(persistence={"box_s": -0.2 / np.log(0.2)})
    found = [box_persistence(changed(), many.detect(made_with, seed), table) for seed in range(4)]
    error = float(np.mean([measure.error for measure in found])) / 2
    assert error < 0.04 and np.mean([measure.measured for measure in found]) == pytest.approx(0.2, abs=4 * error)
    # Of errors that nothing cuts, all of it is left.
    data = variant("relative box errors")
    for state in data["states"].values():
        state["box_error"]["covariance"] = [[value / 100 for value in row] for row in state["box_error"]["covariance"]]
    model = parse_detector(data)
    measure = box_persistence(model, many.detect(model, 0), MomentTable())
    assert measure.error == pytest.approx((4 * measure.count) ** -0.5, rel=0.01)


def test_a_vessel_in_anothers_box_is_not_a_miss() -> None:
    crowded = ManyDetections.of_scene(harbour_of_shoeboxes(mode=2, steps=40, source="analytic"))
    evidence = crowded.detect(parse_detector(variant("doubled, split and merged boxes")), 0)
    assert (evidence.instances.outcome == -2).any()
    counts = run_lengths(evidence)
    assert int(np.arange(len(counts)) @ counts) == int((evidence.instances.outcome == -1).sum())


def test_a_number_that_nobody_asked_for_is_a_dash_and_what_must_always_hold_is_counted_in_words() -> None:
    verification = judge([Parameter("dropout, all states", "group", None)])
    assert row_of(verification.verdicts[0])[1] == "–"
    verification = judge([Parameter("states shared by all cameras", "group", Exact(3, 10))])
    assert row_of(verification.verdicts[0])[1:4] == ("always", "3 of 10 wrong", "exact")
    assert conclusion(verification).endswith("states shared by all cameras: wrong 3 times of 10.")


@pytest.mark.parametrize("stay", [0.98, 0.5])
def test_of_two_states_the_rate_of_staying_is_named(many: ManyDetections, stay: float) -> None:
    states = {name: thesis_data()["states"][name] for name in ("excellent", "good")}
    made_with = changed(states=states, transition_matrix=[[0.9, 0.2], [0.1, 0.8]])
    asked = changed(states=states, transition_matrix=[[0.9, 1 - stay], [0.1, stay]])
    for seed in range(3):
        found = judge(state_checks(asked, many.detect(made_with, seed)))
        assert found.cause is not None and found.cause.parameter.name == "transition_matrix[good][good]"
