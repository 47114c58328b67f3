"""A detector in another condition: rates stay rates, covariances stay covariances, and there and back is nothing."""

import os
import re
import subprocess
import sys
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from modsim3d.cli.learn import _rows
from modsim3d.core.arrays import Array
from modsim3d.core.errors import InputError
from modsim3d.detector.file.reading import load_detector, parse_detector, shipped_detectors
from modsim3d.detector.model import ERROR_COMPONENTS, DetectorModel
from modsim3d.io.input_files import data_folder
from modsim3d.io.strict_text import load_yaml
from modsim3d.io.validation import conditions_in
from modsim3d.learn.box_errors.laws import covariance
from modsim3d.learn.guess import ConditionChange, guessed
from modsim3d.learn.states import cluster, parse_states
from tests.cli.bad_input.builders import Call, refusal
from tests.learn.one_state import detector_file

CONDITIONS = {name: (name, load_detector(file)) for name, file in conditions_in().items()}
REPOSITORY = Path(__file__).resolve().parents[2]
RICH = data_folder("scenes") / "detectors" / "rich.yaml"
NAMES = sorted(name for name in CONDITIONS if "experiment" not in name)


def content_of(name: str = "rich") -> dict[str, Any]:
    return load_yaml(RICH.with_name(f"{name}.yaml"), "detector")


def change(before: str, after: str) -> ConditionChange:
    return ConditionChange.between(CONDITIONS[before], CONDITIONS[after])


def errors_of(unit: str, covariance: Array) -> dict[str, Any]:
    return {"box_error": {"unit": unit, "mean": [0] * 4, "covariance": covariance.tolist()}}


def condition(**keys: Any) -> tuple[str, DetectorModel]:
    usual = errors_of("relative", np.diag([4.0, 1, 9, 1]))
    return "it", parse_detector(detector_file("it", missed=0.2, false=0.1, **{**usual, **keys}))


def test_the_detector_of_one_condition_becomes_that_of_another() -> None:
    """The guess is exact for the detector that the two conditions were measured with, but for means of errors."""
    for after in NAMES:
        content: dict[str, Any] = load_yaml(conditions_in()["noon_clear"], "detector")
        content["states"]["noon_clear"]["box_error"]["covariance"] = np.diag([2352.25, 392.04, 5402.25, 1225]).tolist()
        result = guessed(content, change("noon_clear", after))["states"]["noon_clear"]
        wanted = CONDITIONS[after][1].states[0]
        np.testing.assert_allclose(result["confusion"], wanted.confusion, atol=1e-7)
        assert result["false_discovery_rate"] == pytest.approx(wanted.false_discovery_rate, rel=1e-5)
        variances = np.diag(result["box_error"]["covariance"])
        np.testing.assert_allclose(variances, np.diag(wanted.box_error.covariance), rtol=1e-9)


def test_odds_by_hand() -> None:
    """Noon clear to foggy cloudy: misses 0.133 to 0.381, false discoveries 0.089 to 0.255 (Table 8.7)."""
    found = change("noon_clear", "foggy_cloudy")
    assert found.miss_odds == pytest.approx((0.381 / 0.619) / (0.133 / 0.867))
    assert found.false_odds == pytest.approx((0.255 / 0.745) / (0.089 / 0.911))
    assert found.false_per_image == pytest.approx(found.false_odds * 0.619 / 0.867)
    state = guessed(content_of("three_labels"), found)["states"]
    before = content_of("three_labels")["states"]
    for name in before:
        missed, was = np.array(state[name]["confusion"])[-1], np.array(before[name]["confusion"])[-1]
        np.testing.assert_allclose(missed / (1 - missed), found.miss_odds * was / (1 - was), rtol=1e-4)
    content, extremes = content_of("thesis"), {"good": [[1.0], [0.0]], "bad": [[0.0], [1.0]]}
    for name, confusion in extremes.items():  # what misses all or nothing still does
        content["states"][name]["confusion"] = confusion
    assert {name: guessed(content, found)["states"][name]["confusion"] for name in extremes} == extremes


@given(st.sampled_from(NAMES), st.sampled_from(NAMES), st.sampled_from(["rich", "thesis", "three_labels"]))
@settings(max_examples=25, deadline=None)
def test_a_guess_is_a_detector_and_the_way_back_undoes_it(before: str, after: str, name: str) -> None:
    content = content_of(name)
    try:
        there = guessed(content, change(before, after))
    except InputError as error:  # so few false positives leave no room for second boxes, which stay
        assert name == "rich" and "leaves room for" in str(error)
        return
    model = parse_detector(there)  # refuses probabilities out of range, columns, covariances
    for state in model.states:
        assert 0 < state.confusion[-1].min() <= state.confusion[-1].max() < 1
        assert 0 < state.false_discovery_rate < 1 and np.linalg.eigvalsh(state.box_error.covariance).min() > 0
    back, original = parse_detector(guessed(there, change(after, before))), parse_detector(content)
    for found, wanted in zip(back.states, original.states, strict=True):
        np.testing.assert_allclose(found.confusion, wanted.confusion, atol=2e-6)
        np.testing.assert_allclose(found.box_error.covariance, wanted.box_error.covariance, rtol=1e-8, atol=1e-12)
        assert found.false_discovery_rate == pytest.approx(wanted.false_discovery_rate, rel=2e-5)


def test_what_no_condition_says_stays_and_shares_of_classes_and_correlations_too() -> None:
    content, found = content_of(), guessed(content_of(), change("noon_clear", "night_cloudy"))
    changed = {"confusion", "false_discovery_rate", "box_error", "confidence"}
    assert {**found, "states": None} == {**content, "states": None}
    for name, state in content["states"].items():
        guess = found["states"][name]
        assert guess["box_error"]["mean"] == state["box_error"]["mean"]
        assert {**guess, **dict.fromkeys(changed)} == {**state, **dict.fromkeys(changed)}
        was, now = (np.array(each["confusion"])[:-1] for each in (state, guess))
        np.testing.assert_allclose(now / now.sum(axis=0), was / was.sum(axis=0), atol=1e-5)
        was, now = (np.array(each["box_error"]["covariance"]) for each in (state, guess))
        scale = [np.sqrt(np.diag(each)) for each in (was, now)]
        np.testing.assert_allclose(now / np.outer(scale[1], scale[1]), was / np.outer(scale[0], scale[0]), atol=1e-8)
    growth = found["states"]["haze"]["box_error"]["growth"]
    wider = change("noon_clear", "night_cloudy").spread
    np.testing.assert_allclose(growth, [0.05, 0.05, 0.08, 0.08] * wider, rtol=1e-5)


def test_rates_per_image_follow_the_number_of_false_positives_and_are_told() -> None:
    content, by = content_of(), change("noon_clear", "foggy_cloudy")
    content["false_positives"] |= {"model": "per_image", "rate": 0.4}
    content["states"]["haze"]["false_positives_per_image"] = 2
    found = guessed(content, by)
    assert found["false_positives"]["rate"] == pytest.approx(0.4 * by.false_per_image, rel=1e-5)
    assert found["states"]["haze"]["false_positives_per_image"] == pytest.approx(2 * by.false_per_image, rel=1e-5)
    content = load_yaml(shipped_detectors()["coastal"], "detector")
    found = guessed(content, by)
    assert "false_discovery_rate" not in found["states"]["clear"]
    rows = {row[0]: row[2] for row in _rows(content, found) if row[1] == "false positives in an image"}
    assert rows == {"clear": f"0.1 → {0.1 * by.false_per_image:.3g}", "haze": f"0.25 → {0.25 * by.false_per_image:.3g}"}


def test_confidence_is_shifted_by_its_log_odds_but_not_a_precision_recall_curve() -> None:
    content = content_of()
    by = ConditionChange.between(condition(), condition(confidence={"mean": 0.5, "std": 0.1}))
    ratio = (0.5 / 0.5) / (0.6 / 0.4)
    clear, haze = (guessed(content, by)["states"][name]["confidence"] for name in ("clear", "haze"))
    for found, was in zip(clear.values(), content["states"]["clear"]["confidence"].values(), strict=True):
        if not isinstance(was, dict):
            assert found == was
            continue
        odds, before_odds = (each["mean"] / (1 - each["mean"]) for each in (found, was))
        assert odds == pytest.approx(ratio * before_odds, rel=1e-4) and found["std"] == was["std"]
    quantiles = np.array(next(iter(haze.values()))["quantiles"])
    was = np.array([0.2, 0.4, 0.55, 0.65, 0.95])
    np.testing.assert_allclose(quantiles / (1 - quantiles), ratio * was / (1 - was), rtol=1e-4)
    content["states"]["haze"]["confidence"] = {"precision_recall": [[0.849, 0.887]]}
    with pytest.raises(InputError, match=r"states.haze:\n  confidence: a precision-recall curve cannot be shifted"):
        guessed(content, change("noon_clear", "night_cloudy"), "detector mine")


@pytest.mark.parametrize(("keys", "said"), [
    ({"confusion": [[1.0], [0.0]]}, "its probability of a miss is 0"),
    ({"false_discovery_rate": 0}, "its false_discovery_rate is 0"),
    ({"confidence": {"mean": 1, "std": 0}}, "its mean confidence of true detections is 1"),
    (errors_of("relative", np.zeros((4, 4))), "the variance of one of its box errors is 0"),
    (errors_of("px", np.eye(4)), "its box errors are in px, and those of it relative"),
])  # fmt: skip
def test_a_condition_without_a_ratio_is_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        ConditionChange.between(condition(), condition(**keys))


def test_the_table_of_the_page_has_the_rates_of_the_conditions() -> None:
    page = (REPOSITORY / "docs" / "conditions.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| ([\d.]+)% \| ([\d.]+)% \|$", page, re.MULTILINE)
    states = {name: CONDITIONS[name][1].states[0] for name in NAMES}
    assert sorted(rows) == sorted(
        (name, f"{100 * state.confusion[-1, 0]:.1f}", f"{100 * state.false_discovery_rate:.1f}")
        for name, state in states.items()
    )


GUESS = ("learn", "--from-condition", "noon_clear")
TOGETHER = "needs --detector, --from-condition and --to-condition together"


def guess(detector: Path | str, before: Path | str, after: str) -> tuple[str, ...]:
    return ("learn", "--detector", str(detector), "--from-condition", str(before), "--to-condition", after)


def test_the_command_writes_a_detector_that_says_that_it_is_a_guess(call: Call, tmp_path: Path) -> None:
    out = tmp_path / "in_fog.yaml"
    arguments = (*guess(RICH, "noon_clear", "foggy_cloudy"), "--out", str(out))
    status, said = call(*arguments)
    assert status == 0, said
    assert ERROR_COMPONENTS == ("e_x", "e_y", "e_w", "e_h")  # as cli/learn.py writes them
    assert "A guess, not a measurement: rich.yaml in foggy_cloudy" in said and "warning" not in said
    comments = [line for line in out.read_text().splitlines() if line.startswith("#")]
    assert "Written by modsim3d learn --from-condition. A guess, not a measurement" in comments[0]
    assert "noon_clear" in " ".join(comments) and "odds of a miss by 4.01" in " ".join(comments)
    assert max(map(len, comments)) <= 120 and load_detector(out).labels == load_detector(RICH).labels
    # These conditions were measured on other images.
    status, said = call(*guess(RICH, "noon_clear", "real_world_experiment_1"), "--out", str(tmp_path / "real.yaml"))
    warning = "warning: the box errors of the two conditions differ by more than a factor of four"
    assert status == 0 and warning in said


@pytest.mark.parametrize(("options", "part"), [
    (guess(RICH, "noon_clear", "rain"), "there is no 'rain' (known: afternoon_cloudy_rain, evening_cloudy_rain"),
    (guess(RICH, "non_clear", "foggy_clear"), "did you mean 'noon_clear'?"),
    (guess(RICH, RICH, "foggy_clear"), "one state and one label (got 2 states and 3 labels)"),
    (guess("nothing.yaml", "noon_clear", "foggy_clear"), "nothing.yaml: no such file"),
    ((*GUESS, "--to-condition", "foggy_cloudy"), TOGETHER),
    ((*GUESS, "--detector", "rich.yaml", "run"), TOGETHER),
])  # fmt: skip
def test_what_cannot_be_guessed_from_is_one_error(call: Call, tmp_path: Path, options, part) -> None:
    assert part in " ".join(refusal(call, (*options, "--out", tmp_path / "out.yaml"), kept=tmp_path).split())


DETECTORS = REPOSITORY / "scenes" / "detectors"


def data(name):
    return yaml.safe_load((DETECTORS / "data" / name).read_text())


PUBLISHED, STATES = data("detection_conditions.yaml"), data("performance_states.yaml")["states"]


@pytest.mark.parametrize("state", STATES)
def test_averages_of_conditions_are_tables_9_2_and_9_3(state):
    """Every condition counts alike, and means that differ add nothing to the covariance (section 9.1.3)."""
    published = STATES[state]
    entries = [PUBLISHED[name] for name in published["from"]]
    # Rates are printed with three decimals; means were made of numbers with one; 0.0005 is half of the last digit.
    recall, false = (np.mean([entry[key] for entry in entries]) for key in ("recall", "fdr"))
    assert 1 - recall == pytest.approx(published["false_negative_rate"], abs=6e-4)
    assert false == pytest.approx(published["false_discovery_rate"], abs=6e-4)
    mean_px = np.mean([entry["mean_px"] for entry in entries], axis=0)
    np.testing.assert_allclose(mean_px, published["box_error_mean_px"], atol=0.006)
    # Standard deviations have one decimal and correlations two: what that leaves open in each product.
    correlations = ([entry["correlation"][pair] for pair in ("xy", "xw", "xh", "yw", "yh", "wh")] for entry in entries)
    every_px2 = map(covariance, (np.array(entry["std_px"], dtype=float) for entry in entries), correlations)
    average_px2 = np.mean(list(every_px2), axis=0)
    stds = np.sqrt(np.diag(average_px2))
    open_px2 = 0.5 + 0.05 * (stds[:, None] + stds[None, :]) + 0.005 * np.outer(stds, stds)
    assert np.all(np.abs(average_px2 - published["box_error_covariance_px2"]) <= open_px2)


def test_files_of_the_conditions_are_what_the_script_writes_and_hold_the_published_numbers(tmp_path):
    script = REPOSITORY / "script" / "make_conditions"
    subprocess.run([sys.executable, script, tmp_path], check=True, env=os.environ | {"PYTHONPATH": str(REPOSITORY)})
    written = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert written == {path.name: path.read_bytes() for path in (DETECTORS / "conditions").iterdir()}
    assert len(written) == 17
    (state,) = load_detector(DETECTORS / "conditions" / "foggy_clear.yaml").states
    assert state.confusion.ravel().tolist() == [0.657, 0.343] and state.false_discovery_rate == 0.098
    np.testing.assert_allclose(np.sqrt(np.diag(state.box_error.covariance)), [47.7, 13.1, 65.8, 23.6], rtol=1e-5)
    assert state.box_error.covariance[0, 2] / (47.7 * 65.8) == pytest.approx(0.92, rel=1e-5)


def test_clusters_are_the_best_of_all_splits_and_always_the_same():
    f1 = {name: PUBLISHED[name]["f1"] for name in list(PUBLISHED)[:15]}
    found = cluster(f1, 4)
    assert found.names == ("excellent", "good", "bad", "terrible")
    assert sorted(name for names in found.states.values() for name in names) == sorted(f1)
    assert found.states["terrible"] == ("Foggy cloudy",)  # the only state that the thesis's split by eye has alike

    def within(groups):
        return sum(float(np.var(group) * len(group)) for group in groups)

    values = sorted(f1.values(), reverse=True)
    every = [within([values[:a], values[a:b], values[b:c], values[c:]]) for a, b, c in combinations(range(1, 15), 3)]
    ours = within([[f1[name] for name in names] for names in found.states.values()])
    assert ours == pytest.approx(min(every)) and cluster(dict(sorted(f1.items())), 4).states == found.states
    with pytest.raises(InputError, match="only 15 conditions"):
        cluster(f1, 16)


def test_states_that_do_not_fit_the_conditions_are_refused_at_once():
    with pytest.raises(InputError) as raised:
        parse_states(["good=day,nihgt", "bad=day", "worse", "good=fog"], ["day", "night", "fog"])
    for problem in ("did you mean 'night'?", "condition 'day' is already in state 'good'",
                    "states worse: must be NAME=CONDITION", "state 'good' is given twice"):  # fmt: skip
        assert problem in str(raised.value)
    assert parse_states(["good=day, fog"], ["day", "night", "fog"]).states == {"good": ("day", "fog")}
