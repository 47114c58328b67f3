"""`detector.miss_rate` and `detector.states.NAME.miss_rate`, wherever keys are set."""

from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from modsim3d import InputError, load_detector, load_scene, run_scene
from modsim3d.campaign.work.layers import RunLayers
from modsim3d.detector.file.reading import with_miss_rate
from modsim3d.runs.files.tables import flags
from modsim3d.scene.settings import choose_detector
from tests.campaign.campaigns import checked_campaign

CONFUSIONS = {"a": [[0.6, 0.1], [0.2, 0.5], [0.2, 0.4]], "b": [[1, 0], [0, 1], [0, 0]]}
TWO_LABELS = {"states": {name: {"confusion": confusion} for name, confusion in CONFUSIONS.items()}}


@pytest.mark.parametrize("rate", [0, 0.35, 0.99])
def test_every_label_is_missed_at_the_rate_and_the_other_rows_keep_their_proportions(rate: float) -> None:
    states = with_miss_rate(TWO_LABELS, rate, None, "key")["states"]
    for name, state in TWO_LABELS["states"].items():
        before, after = np.array(state["confusion"])[:-1], np.array(states[name]["confusion"])[:-1]
        np.testing.assert_allclose([states[name]["confusion"][-1], 1 - after.sum(axis=0)], rate, atol=1e-12)
        np.testing.assert_allclose(after / after.sum(axis=0), before / before.sum(axis=0))


def test_the_rate_of_a_state_is_set_after_that_of_all_and_after_the_matrix_and_kept_with_a_run(tmp_path: Path) -> None:
    rates = {"detector.states.good.miss_rate": 0.3, "detector.miss_rate": 0.1}
    scene = load_scene("harbour", steps=2, settings={**rates, "detector.states.bad.confusion": [[0.2], [0.8]]})
    run_scene(scene, tmp_path / "run")
    for detector in (scene.detector, load_detector(tmp_path / "run/scene/detector.yaml")):
        missed = {state.name: float(state.confusion[-1, 0]) for state in detector.states}
        assert missed == pytest.approx({"excellent": 0.1, "good": 0.3, "bad": 0.1, "terrible": 0.1})


@pytest.mark.parametrize(("settings", "said"), [
    ({"detector.miss_rate": 1}, "a miss rate is a number from 0 to below 1 (got 1)"),
    ({"detector.miss_rate": "much"}, "a miss rate is a number from 0 to below 1"),
    ({"detector.states.god.miss_rate": 0.1}, "the detector has no state 'god' (did you mean 'good'?)"),
    ({"detector.states.good.confusion": [[0], [1]], "detector.miss_rate": 0.1}, "states.good: column 0"),
    ({"detector.states.miss_rate": 0.1}, "detector.states.miss_rate"),
])  # fmt: skip
def test_what_is_no_miss_rate_is_refused(settings: dict[str, Any], said: str) -> None:
    for load, name in ((load_scene, "harbour"), (choose_detector, "thesis")):
        with pytest.raises(InputError) as error:
            load(name, settings=settings)
        assert said in str(error.value) and 'settings["detector.' in str(error.value)


def test_the_measured_miss_rate_of_a_run_is_the_one_that_was_set(tmp_path: Path) -> None:
    """Within an exact interval of 99.9 %; every performance state has the rate, and nothing else makes a miss."""
    vary = [{"grid": {"detector.miss_rate": [0.1, 0.4]}}]
    campaign = checked_campaign(tmp_path, scene="harbour", steps=80, vary=vary, trackers=["reference"])
    with closing(RunLayers(campaign.file.keys, tmp_path, tmp_path / "cache")) as layers:
        for number, rate in enumerate((0.1, 0.4)):
            truth = layers.made(campaign.plan.run(number)).rows.truth
            there = flags(truth, "annotated")
            missed = int((there & ~flags(truth, "detected")).sum())
            interval = stats.binomtest(missed, int(there.sum())).proportion_ci(0.999)
            assert there.sum() > 300 and interval.low <= rate <= interval.high
