"""`verify` on whole runs: honest ones obey, changed files are named, and models that meet count against no other."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import modsim3d
from modsim3d import DetectorModel, MomentTable, RunDirectoryError, load_scene, open_run, run_scene, verify_evidence
from modsim3d.core.boxes import sizes
from modsim3d.detector.file.reading import load_detector, parse_detector
from modsim3d.io.input_files import data_folder
from modsim3d.verify.box_error_checks import MIN_DETECTIONS, box_error_checks, with_known_errors
from modsim3d.verify.class_checks import class_checks
from modsim3d.verify.confidence_checks import confidence_checks
from modsim3d.verify.evidence import Evidence, ManyDetections
from modsim3d.verify.false_positive_checks import false_positive_checks
from modsim3d.verify.figures import run_lengths
from modsim3d.verify.measures import Estimate, Exact
from modsim3d.verify.parameters import FALLS_SHORT, Parameter, judge
from modsim3d.verify.verification import state_checks
from modsim3d.verify.verify_run import conclusion, row_of, verify_run, write_report
from tests.cli.bad_input.builders import refusal
from tests.detector_changes import single_changes
from tests.detector_variants import CHANGES, ON_VESSELS, Data, thesis_data, variant
from tests.run_folders import interrupt
from tests.scenes import harbour_of_shoeboxes

DETECTORS = data_folder("scenes") / "detectors"


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("verify") / "run"
    run_scene(load_scene("simulation_1", mode=2, steps=500, source="analytic"), folder)
    return folder


def test_an_honest_run_obeys_and_says_so_and_a_change_made_after_it_is_caught_and_named(finished, tmp_path, call):
    status, said = call("check", "run", finished)
    assert status == 0
    assert "obeys its detector file" in said and " tests passed" in said and len(said.splitlines()) < 20
    _, said = call("check", "run", finished, "--verbose", "--overwrite")
    assert "states.excellent.confusion[background][Vessel]" in said
    assert "dropout, all states" in said and "noticed from" in said
    report = json.loads((finished / "verify.json").read_text())
    assert report["obeys"] and report["cause"] is None
    page = (finished / "verify.html").read_text()
    assert page.count("<svg") >= 5 and "http" not in page and "<script" not in page
    # The report changes nothing for whoever reads the run.
    modsim3d.detect_run(open_run(finished), tmp_path / "again")
    assert not (tmp_path / "again" / "verify.json").exists()
    assert (tmp_path / "again" / "detections.parquet").read_bytes() == (finished / "detections.parquet").read_bytes()
    data = thesis_data()
    data["states"]["good"]["confidence"]["std"] = 0.13
    changed = tmp_path / "changed.yaml"
    changed.write_text(yaml.safe_dump(data, sort_keys=False))
    out = tmp_path / "report"
    status, said = call("check", "run", finished, "--detector", changed, "--out", out)
    report = json.loads((out / "verify.json").read_text())
    assert (status, report["cause"]) == (1, "states.good.confidence.std") and "does NOT obey" in said
    assert re.search(r"What fails\nparameter .*\n(.+ DIFFERS\n)+", said)
    page = (out / "verify.html").read_text().replace("<wbr>", "")
    failing = [line for line in page.splitlines() if "DIFFERS" in line]
    assert all(line.startswith('<tr class="bad">') for line in failing)
    assert "states.good.confidence.std" in page.split("What fails</h2>")[1].split("</table>")[0]


def test_cameras_with_states_of_their_own_have_a_timeline_each(tmp_path):
    detector = tmp_path / "detector.yaml"
    detector.write_text(yaml.safe_dump(variant("a chain for each camera"), sort_keys=False))
    run = tmp_path / "run"
    run_scene(load_scene("simulation_3", steps=60, source="analytic", detector=detector), run)
    write_report(verify_run(open_run(run)), tmp_path)
    page = (tmp_path / "verify.html").read_text()
    assert [f"was in: {camera}" in page for camera in ("C1", "C2")] == [True, True]
    assert "modsim3d.verify_run(" in page and "from Python" in page  # no command made it


def test_verdicts_in_memory_are_those_of_files_and_the_thesiss_rule_falls_short_of_its_rate(finished, many, table):
    run = open_run(finished)
    in_memory = verify_evidence(run.scene.detector, many.detect(run.scene.detector, run.scene.detector_seed), table)
    for a, b in zip(verify_run(run).verification.verdicts, in_memory.verdicts, strict=True):
        assert (a.parameter.name, a.verdict) == (b.parameter.name, b.verdict)
        assert (a.p_value is None) == (b.p_value is None)
        assert a.p_value is None or a.p_value == pytest.approx(b.p_value, rel=1e-6)
    model = load_detector(DETECTORS / "thesis_original.yaml")
    verification = verify_evidence(model, many.detect(model, 0))
    assert verification.obeys
    rate = next(v for v in verification.verdicts if v.parameter.name == "states.excellent.false_discovery_rate")
    # Five vessels: round(0.089 · 5 − 0.2) is 0 trials, Jessen & Mohr (2023), eq. 7.35.
    assert (rate.verdict, rate.parameter.promised, rate.asked, rate.measured) == (FALLS_SHORT, 0.089, 0, 0)

    def tested(share: float, seed: int) -> list[Any]:
        model = three_labels(share)
        found = false_positive_checks(model, many.detect(model, seed))
        return [p.measure for p in found if "false_positive_labels" in p.name and p.measure is not None]

    assert tested(1.0, 0) == []  # in 40 s one that lives for 20 s on average shows its label in frame after frame
    beside = [measure for seed in range(6) for measure in tested(0.5, seed)]
    assert len(beside) > 40 and min(measure.p_value() for measure in beside) > 1e-5


@pytest.mark.parametrize("name", CHANGES)
def test_a_run_of_every_model_obeys_its_file(many, table, name):
    model = parse_detector(variant(name))
    verification = verify_evidence(model, many.detect(model, 3), table)
    assert verification.obeys, [verdict.parameter.name for verdict in verification.failed]


@pytest.mark.parametrize("made_with, cause", [
    ("persistence of misses, 1 s", "persistence.class_s"),
    ("persistence of box errors, 1 s", "persistence.box_s"),
    ("persistence of confidence, 1 s", "persistence.confidence_s"),
    ("doubled, split and merged boxes", "false_positives.duplicates"),
    ("persistent false positives", "false_positives.persistence.share"),
    ("false positives on vessels", "false_positives.on_vessels.share"),
])  # fmt: skip
def test_a_model_that_the_file_does_not_have_is_named(many, table, made_with, cause):
    evidence = many.detect(parse_detector(variant(made_with)), 3)
    verification = verify_evidence(parse_detector(thesis_data()), evidence, table)
    assert cause in [verdict.parameter.name for verdict in verification.failed]
    if cause.startswith("persistence"):
        assert verification.cause.parameter.name == cause


def test_slopes_false_positives_and_noticeable_changes_that_are_others_are_named(many, table):
    name = "dropout by size and distance, anchored"
    data = variant(name)
    data["dropout"]["size_px"]["per_doubling"] = 1.0
    verification = verify_evidence(parse_detector(data), many.detect(parse_detector(variant(name)), 3), table)
    assert verification.cause.parameter.name == "dropout.size_px.per_doubling"
    data = variant("false positives on vessels")
    evidence = many.detect(parse_detector(data), 3)
    place = {"place[log height]": ("mean", [0.1, -0.1, 0.2, 0.6]), "place[across]": ("std", [0.9, 0.2, 0.2, 0.3])}
    for named, (key, value) in {"share": ("share", 0.25), "lifetime_s": ("lifetime_s", 1.5), **place}.items():
        data["false_positives"]["on_vessels"] = ON_VESSELS | {key: value}
        verification = verify_evidence(parse_detector(data), evidence, table)
        assert {verdict.parameter.name for verdict in verification.failed} == {f"false_positives.on_vessels.{named}"}
    model = parse_detector(thesis_data())
    evidence = many.detect(model, 5)
    verify_evidence(model, evidence, table)
    noticeable = named = 0
    for change in list(single_changes(model, 0.2))[::9]:
        verification = verify_evidence(change.model, evidence, table.branch())
        verdict = next(v for v in verification.verdicts if v.parameter.name == change.name)
        reach = verdict.noticed[0 if change.up else 1]
        if reach is not None and reach <= change.size:
            noticeable += 1
            named += verification.cause is not None and verification.cause.parameter.name == change.name
    assert noticeable >= 2 and named >= noticeable - 1


def test_other_detectors_no_runs_broken_tables_and_interrupted_runs_are_refused(finished, call, tmp_path):
    other = ("--detector", DETECTORS / "experiment_1.yaml", "--overwrite")
    refusal(call, ("check", "run", finished, *other), "cannot have made this run")
    refusal(call, ("check", "run", tmp_path), "run.json")
    broken = shutil.copytree(finished, tmp_path / "broken")
    (broken / "detections.parquet").write_bytes(b"not a table")
    refusal(call, ("check", "run", broken), "detections.parquet has 11 bytes, and had")
    cut = interrupt(load_scene("simulation_1", steps=260, source="analytic"), tmp_path / "cut")
    with pytest.raises(RunDirectoryError, match="interrupted run"):
        verify_run(open_run(cut))


@pytest.mark.parametrize("keys, name", [
    ({}, None),
    ({"size": {"model": "fixed", "px": [40, 20]}, "far_half_px": 90.0}, None),
    ({"placement": "horizon_band", "band_px": 300.0}, "false_positives.placement[below the horizon]"),
    ({"placement": "density", "density": [[1, 2]]}, "false_positives.placement[along the horizon]"),
    ({"size": {"model": "fixed", "px": [40, 20]}}, "false_positives.size[width]"),
    ({"persistence": {"lifetime_s": 0.4, "share": 0.5}}, "false_positives.persistence.lifetime_s"),
])  # fmt: skip
def test_honest_false_positives_obey_and_others_are_told_apart(many, keys, name):
    usual = {"model": "per_image", "rate": 2.0, "persistence": {"lifetime_s": 2.0, "share": 0.5}}
    section = usual | keys, usual | ({} if name else keys)
    made_with, asked = (parse_detector(thesis_data() | {"false_positives": each}) for each in section)
    wanted = ("false_positives.placement", "false_positives.size", "false_positives.persistence.lifetime_s")
    checks = [each for each in false_positive_checks(asked, many.detect(made_with, 3)) if each.name.startswith(wanted)]
    found = {each.name: each.measure.p_value() for each in checks if each.measure is not None}
    assert found[name] < 1e-5 if name else len(found) == 5 and min(found.values()) > 1e-4


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


def test_splits_leave_the_law_of_box_errors_as_it_is_and_an_operating_threshold_what_it_keeps(many, table):
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
    section = {"model": "per_image", "rate": 0.1, "splits": 0.5, "split_aspect": 0.2, "duplicates": 0.1}
    model = parse_detector(thesis_data() | {"false_positives": section} | limit)
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


def test_persistence_is_seen_or_obeyed_and_few_vessels_are_too_little_seen(many, table):
    gates = {"update_interval_s": 0.4}
    model = changed(gates=gates, persistence={"class_s": 1.0, "box_s": 1.0})
    evidence = many.detect(model, 4)
    for parameter in persistence_of(model, evidence, table):
        assert parameter.measure is not None and parameter.measure.asked == pytest.approx(np.exp(-0.4), rel=1e-9)
        assert parameter.measure.p_value() > 1e-4
    for parameter in persistence_of(changed(gates=gates), evidence, table):
        assert parameter.measure is not None and parameter.measure.p_value() < 1e-6
    for_ever = changed(persistence={"class_s": 1e9})
    for seed in range(4):
        found = judge(class_checks(for_ever, many.detect(for_ever, seed)))
        assert found.obeys, [(verdict.parameter.name, verdict.p_value) for verdict in found.failed]
        cause = judge(class_checks(for_ever, many.detect(changed(), seed))).cause
        assert cause is not None and cause.parameter.name == "persistence.class_s"
    for_ever = changed(persistence={"box_s": 1e6})
    found = box_error_checks(for_ever, many.detect(for_ever, 0), table)
    laws = [parameter for parameter in found if parameter.name.startswith("states.")]
    assert laws and all(parameter.measure is None for parameter in laws)
    persistence = found[-1].measure
    assert persistence is not None and persistence.p_value() > 1e-4
    for_a_moment = changed(persistence={"box_s": 0.05})
    found = box_error_checks(for_a_moment, many.detect(for_a_moment, 0), table)
    assert sum(p.measure is not None for p in found if p.name.startswith("states.")) > len(laws) / 3
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


def box_persistence(asked: DetectorModel, evidence: Evidence, table: MomentTable) -> Estimate:
    measure = box_error_checks(asked, evidence, table)[-1].measure
    assert isinstance(measure, Estimate)
    return measure


def test_a_vessel_in_anothers_box_is_no_miss_and_numbers_that_nobody_asked_for_are_dashes():
    crowded = ManyDetections.of_scene(harbour_of_shoeboxes(mode=2, steps=40, source="analytic"))
    evidence = crowded.detect(parse_detector(variant("doubled, split and merged boxes")), 0)
    assert (evidence.instances.outcome == -2).any()
    counts = run_lengths(evidence)
    assert int(np.arange(len(counts)) @ counts) == int((evidence.instances.outcome == -1).sum())
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
