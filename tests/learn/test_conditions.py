from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from modsim3d.core.errors import InputError
from modsim3d.detector.file.reading import load_detector
from modsim3d.learn.box_errors.laws import covariance
from modsim3d.learn.states import cluster, parse_states

ROOT = Path(__file__).resolve().parents[2]
DETECTORS = ROOT / "scenes" / "detectors"
PAIRS = ("xy", "xw", "xh", "yw", "yh", "wh")


def data(name):
    return yaml.safe_load((DETECTORS / "data" / name).read_text())


CONDITIONS, STATES = data("detection_conditions.yaml"), data("performance_states.yaml")["states"]


def covariance_px2(entry):
    return covariance(np.array(entry["std_px"], dtype=float), [entry["correlation"][pair] for pair in PAIRS])


@pytest.mark.parametrize("state", STATES)
def test_averages_of_conditions_are_tables_9_2_and_9_3(state):
    """Every condition counts alike, and means that differ add nothing to the covariance (section 9.1.3)."""
    published = STATES[state]
    entries = [CONDITIONS[name] for name in published["from"]]
    # Rates are printed with three decimals; means were made of numbers with one; 0.0005 is half of the last digit.
    recall, false = (np.mean([entry[key] for entry in entries]) for key in ("recall", "fdr"))
    assert 1 - recall == pytest.approx(published["false_negative_rate"], abs=6e-4)
    assert false == pytest.approx(published["false_discovery_rate"], abs=6e-4)
    mean_px = np.mean([entry["mean_px"] for entry in entries], axis=0)
    np.testing.assert_allclose(mean_px, published["box_error_mean_px"], atol=0.006)
    # Standard deviations have one decimal and correlations two: what that leaves open in each product.
    average_px2 = np.mean([covariance_px2(entry) for entry in entries], axis=0)
    stds = np.sqrt(np.diag(average_px2))
    open_px2 = 0.5 + 0.05 * (stds[:, None] + stds[None, :]) + 0.005 * np.outer(stds, stds)
    assert np.all(np.abs(average_px2 - published["box_error_covariance_px2"]) <= open_px2)


def test_files_of_the_conditions_are_what_the_script_writes(tmp_path):
    script = ROOT / "script" / "make_conditions"
    subprocess.run([sys.executable, script, tmp_path], check=True, env=os.environ | {"PYTHONPATH": str(ROOT)})
    written = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert written == {path.name: path.read_bytes() for path in (DETECTORS / "conditions").iterdir()}
    assert len(written) == 17


def test_files_of_the_conditions_hold_the_published_numbers():
    model = load_detector(DETECTORS / "conditions" / "foggy_clear.yaml")
    state = model.states[0]
    assert state.confusion.ravel().tolist() == [0.657, 0.343]
    assert state.false_discovery_rate == 0.098
    np.testing.assert_allclose(np.sqrt(np.diag(state.box_error.covariance)), [47.7, 13.1, 65.8, 23.6], rtol=1e-5)
    correlation = state.box_error.covariance[0, 2] / (47.7 * 65.8)
    assert correlation == pytest.approx(0.92, rel=1e-5)


def test_clusters_are_the_best_of_all_splits_and_always_the_same():
    f1 = {name: CONDITIONS[name]["f1"] for name in list(CONDITIONS)[:15]}
    found = cluster(f1, 4)
    assert found.names == ("excellent", "good", "bad", "terrible")
    assert sorted(name for names in found.states.values() for name in names) == sorted(f1)
    assert found.states["terrible"] == ("Foggy cloudy",)  # the only state that the thesis's split by eye has alike

    def within(groups):
        return sum(float(np.var(group) * len(group)) for group in groups)

    values = sorted(f1.values(), reverse=True)
    every = [
        within([values[:a], values[a:b], values[b:c], values[c:]])
        for a in range(1, 13)
        for b in range(a + 1, 14)
        for c in range(b + 1, 15)
    ]
    ours = within([[f1[name] for name in names] for names in found.states.values()])
    assert ours == pytest.approx(min(every))
    shuffled = dict(sorted(f1.items()))
    assert cluster(shuffled, 4).states == found.states
    with pytest.raises(InputError, match="only 15 conditions"):
        cluster(f1, 16)


def test_states_that_do_not_fit_the_conditions_are_refused_at_once():
    with pytest.raises(InputError) as raised:
        parse_states(["good=day,nihgt", "bad=day", "worse", "good=fog"], ["day", "night", "fog"])
    text = str(raised.value)
    assert "did you mean 'night'?" in text
    assert "condition 'day' is already in state 'good'" in text
    assert "--states worse: must be NAME=CONDITION" in text
    assert "state 'good' is given twice" in text
    assert parse_states(["good=day, fog"], ["day", "night", "fog"]).states == {"good": ("day", "fog")}
