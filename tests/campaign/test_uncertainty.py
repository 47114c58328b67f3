"""Detectors of campaigns: drawn, one for each traffic seed, from what a labelled set leaves open; and rates set."""

import json
import shutil
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from modsim3d import InputError, LearnResult, learn_detector, load_detector, load_scene, run_scene
from modsim3d.campaign.drawn_detectors import LearnedUncertainty, _draw_number, drawn_detector, read_uncertainty
from modsim3d.campaign.plan import Condition
from modsim3d.campaign.reproduce import remade
from modsim3d.campaign.running import CampaignResult
from modsim3d.campaign.work.layers import RunLayers
from modsim3d.campaign.work.scenes import Scenes
from modsim3d.core.arrays import Array
from modsim3d.detector.file.reading import with_miss_rate
from modsim3d.detector.model import ERROR_PAIRS
from modsim3d.learn.learned_detector import correlated
from modsim3d.runs.files.tables import flags
from modsim3d.scene.settings import choose_detector
from tests.campaign.campaigns import checked_campaign, problems_of, run_campaign_file
from tests.scenes import harbour_of_shoeboxes

Learned, Draws = dict[str, LearnResult], dict[str, list[dict[str, Any]]]
MANY, FEW, DRAWS = 160, 12, 800
DETECTOR: Any = {"detector": "experiment_1", "detector_seed": 77, "settings": {"detector.miss_rate": 0.2}}
DRAWN: dict[str, Any] = {"scene": "harbour", "steps": 3, "uncertainty": "learned", "trackers": ["reference"]}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """It has the harbour `boxes.yaml`, whose vessels are shoeboxes: their truth takes a fraction of the time."""
    folder = tmp_path_factory.mktemp("learned")
    (folder / "boxes.yaml").write_text(json.dumps(harbour_of_shoeboxes().copy.document))
    return folder


@pytest.fixture(scope="module")
def learned(folder: Path) -> Learned:
    """A detector of misses of 20 %, learned from many images and from few; the files are in the folder."""
    found = {}
    for name, steps in (("many", MANY), ("few", FEW)):
        run_scene(load_scene(folder / "boxes.yaml", steps=steps, **DETECTOR), folder / f"run_{name}")
        found[name] = learn_detector(run=folder / f"run_{name}", check=False)
        found[name].write(folder / f"{name}.yaml")
    return found


@pytest.fixture(scope="module")
def draws(folder: Path, learned: Learned) -> Draws:
    known = {name: read_uncertainty(folder / f"{name}.yaml") for name in learned}
    return {name: [drawn_detector(each, 1_000_000 + k) for k in range(DRAWS)] for name, each in known.items()}


def drawn_numbers(drawn: list[dict[str, Any]], state: str | None, name: str) -> Array | None:
    """The draws of an entry that `learn` reports, shape (draws, ...); None if it is not drawn."""
    section = "detector" if state is None else f"detector.states.{state}"
    if name.startswith("box_error_"):
        covariance = np.array([each[f"{section}.box_error.covariance"] for each in drawn])
        std = np.sqrt(np.einsum("dii->di", covariance))
        pairs = np.stack([covariance[:, i, j] / (std[:, i] * std[:, j]) for i, j in ERROR_PAIRS], axis=1)
        mean = np.array([each[f"{section}.box_error.mean"] for each in drawn])
        return {"box_error_mean": mean, "box_error_std": std, "box_error_correlation": pairs}[name]
    key = f"{section}.{name}"
    return np.array([each[key] for each in drawn]) if key in drawn[0] and not name.endswith("density") else None


@pytest.mark.parametrize("name", ["many", "few"])
@pytest.mark.parametrize("level", [0.8, 0.95])
def test_intervals_of_learn_hold_as_many_draws_as_said(name: str, level: float, learned: Learned, draws: Draws) -> None:
    checked = 0
    for interval in learned[name].report.learned.intervals(level):
        found = drawn_numbers(draws[name], interval.key.state, ".".join(interval.key.names))
        # Of a standard deviation that is known to less than a factor draws are held within ten times the estimate.
        held = "std" in interval.key.names[-1] and np.any(interval.high > 8 * interval.estimate)
        if found is None or np.ptp(found) == 0 or held:
            continue
        rounding = 1e-5 * np.abs(interval.estimate) + 1e-6
        inside = np.mean((found >= interval.low - rounding) & (found <= interval.high + rounding), axis=0)
        checked += np.size(inside)
        # Five standard errors, and what Student's factor of shares is not exactly; few seen make intervals too wide.
        slack = 5 * np.sqrt(level * (1 - level) / DRAWS) + 0.02
        assert np.all(np.abs(inside - level) < slack), interval.key
    assert checked >= 18


def test_draws_have_the_mean_and_the_spread_that_learn_says(learned: Learned, draws: Draws) -> None:
    """From many images everything is nearly normal: half a 68.3 % interval is the standard deviation."""
    for interval in learned["many"].report.learned.intervals(0.6827):
        found = drawn_numbers(draws["many"], interval.key.state, ".".join(interval.key.names))
        if found is not None and np.ptp(found) > 0:
            error = (interval.high - interval.low) / 2
            assert np.all(np.abs(found.mean(axis=0) - interval.estimate) < 0.2 * error + 1e-6), interval.key
            np.testing.assert_allclose(found.std(axis=0), error, rtol=0.12, atol=1e-6)


def group(correlation: float, labels: int, units: int, misses: float) -> dict[str, Any]:
    column = [(1 - misses) / labels] * labels + [misses]
    confusion, seen = np.tile(np.array(column)[:, None], labels).tolist(), np.full((labels + 1, labels), 40.0).tolist()
    numbers = [
        {"key": ["confusion"], "kind": "share", "estimate": confusion, "observations": seen},
        {"key": ["box_error_mean"], "kind": "mean", "estimate": [0, 1, 2, 3], "spread": [1, 1, 1, 1]},
        {"key": ["box_error_std"], "kind": "positive", "estimate": [1, 2, 3, 4], "spread": [0.9] * 4},
        {"key": ["box_error_correlation"], "kind": "correlation", "estimate": [0.9] * 6, "spread": [0.8] * 6},
        {"key": ["false_positives_per_image"], "kind": "rate", "estimate": 0.2, "observations": 50.0},
    ]
    correlations = [[0.0] * i for i in range(labels + 15)]
    correlations[labels + 1][labels] = correlation
    state = {"state": "a", "units": units, "numbers": numbers, "correlations": correlations}
    return {"format": 1, "detector_sha256": "", "confidence_threshold": 0.2, "transitions": None, "groups": [state]}


def test_correlations_of_the_replicates_are_those_of_the_draws() -> None:
    known = LearnedUncertainty.model_validate(group(0.8, 1, 2000, 0.3))
    means = np.array([drawn_detector(known, seed)["detector.states.a.box_error.mean"] for seed in range(1500)])
    found = np.corrcoef(means.T)
    assert abs(found[0, 1] - 0.8) < 0.03  # three standard errors of 0.0093
    assert np.abs(found[2:, :2]).max() < 5 / np.sqrt(1500)


def of_numbers(known: dict[str, Any], *names: str) -> LearnedUncertainty:
    """What is known of some of the numbers, none of which is correlated with others: they are quicker to draw."""
    (state,) = known["groups"]
    numbers = [number for number in state["numbers"] if number["key"][0] in names]
    shapes = [(tuple(number["key"]), np.shape(number["estimate"])) for number in numbers]
    size = sum(int(correlated(*each).sum()) for each in shapes)
    state |= {"numbers": numbers, "correlations": [[0.0] * i for i in range(size)]}
    return LearnedUncertainty.model_validate(known)


def test_counts_and_normal_numbers_have_the_distributions_of_their_intervals() -> None:
    """Jeffreys's Beta and Gamma distributions from many images; from five, Student's with four degrees of freedom."""
    count = 2000

    def drawn(units: int, **keys: str) -> dict[str, Array]:
        known = of_numbers(group(0.0, 2, units, 0.3), *keys)
        found = [drawn_detector(known, seed) for seed in range(count)]
        columns = {name: [each[f"detector.states.a.{key}"] for each in found] for name, key in keys.items()}
        return {name: np.reshape(column, (count, -1)) for name, column in columns.items()}

    counts = {"confusion": "confusion", "false_positives_per_image": "false_positives_per_image"}
    means = {"box_error_mean": "box_error.mean"}
    many, few = drawn(100_000, **counts, **means), drawn(5, **means)
    misses, rates = many["confusion"].reshape(count, 3, 2)[:, -1, 0], many["false_positives_per_image"][:, 0]
    laws = stats.beta(12.5, 28.5), stats.gamma(10.5, scale=1 / 50), stats.norm()
    for found, law in zip((misses, rates, many["box_error_mean"][:, 0]), laws, strict=True):
        assert stats.kstest(found, law.cdf).pvalue > 1e-3
    beyond = int((np.abs(few["box_error_mean"][:, 0]) > stats.t(4).ppf(0.975)).sum())
    assert stats.binomtest(beyond, count, 0.05).pvalue > 1e-3  # 0.6 % of normal ones are beyond
    (hardly,) = of_numbers(group(0.0, 2, 5, 0.3), "false_positives_per_image").groups[0].numbers
    hardly = hardly.model_copy(update={"observations": 1e-9})  # one run: replicates tell nothing
    rng = np.random.default_rng(0)
    rates = [float(_draw_number(hardly, np.array(z), 1.0, rng)) for z in (-1.0, 1.0, 2.0)]
    assert max(rates) == pytest.approx(10 * float(hardly.estimate)) and min(rates) >= 0


@given(st.integers(1, 4), st.integers(5, 50), st.sampled_from([0.0, 0.001, 0.4, 1.0]), st.integers(0, 2**40))
def test_every_draw_is_a_detector(labels: int, units: int, misses: float, seed: int) -> None:
    drawn = drawn_detector(LearnedUncertainty.model_validate(group(0.0, labels, units, misses)), seed)
    confusion = np.array(drawn["detector.states.a.confusion"])
    assert confusion.shape == (labels + 1, labels) and confusion.min() >= 0
    np.testing.assert_allclose(confusion.sum(axis=0), 1, atol=1e-9)
    assert np.linalg.eigvalsh(np.array(drawn["detector.states.a.box_error.covariance"]))[0] > 0


def test_a_drawn_detector_is_read_as_a_detector_file_is(folder: Path, draws: Draws) -> None:
    for settings in draws["few"][:40]:
        model, _ = choose_detector(folder / "few.yaml", settings=settings)
        assert model.states[0].confusion[-1, 0] == settings["detector.states.real_world.confusion"][-1][0]


def campaign(folder: Path, detector: str, **keys: Any) -> CampaignResult:
    name, vary = f"c{len(list(folder.iterdir()))}.yaml", [{"grid": {"detector": [detector]}}]
    keys = {"steps": 40, "trackers": ["reference"], "seeds": {"traffic": 12}, **keys}
    return run_campaign_file(folder, name, scene="boxes.yaml", vary=vary, **keys)


def test_a_small_labelled_set_spreads_the_score_over_traffic_seeds(folder: Path, learned: Learned) -> None:
    def spread(detector: str, **keys: str) -> float:
        result = campaign(folder, detector, steps=100, **keys)  # long enough for little chance within a run
        assert set(result.table["status"].to_pylist()) == {"done"}
        return float(np.std(result.table["hota"].to_numpy(), ddof=1))

    few, many = (spread(detector, uncertainty="learned") for detector in ("few.yaml", "many.yaml"))
    assert few > 2 * many and few > 2 * spread("few.yaml") > many  # 0.032, 0.012 and 0.010


def test_a_detector_is_drawn_for_a_traffic_seed_and_all_trackers_and_again(folder: Path, learned: Learned) -> None:
    trackers = ["reference", {"tracker": "reference", "name": "patient", "set": {"lost_s": 9}}]
    result = campaign(folder, "few.yaml", uncertainty="learned", trackers=trackers, seeds={"traffic": 2, "detector": 2})
    keys = result.table["detections_key"].to_pylist()
    assert keys[0::2] == keys[1::2] and len(set(keys)) == 4
    again = [remade(result.folder, number) for number in (6, 0, 2)]
    assert [made.detections_key[:16] for made in again] == [keys[number] for number in (6, 0, 2)]
    rates = [float(made.rows.scene.detector.states[0].confusion[-1, 0]) for made in again]
    assert rates[1] == rates[2] != rates[0]  # detector seeds of a traffic seed share its detector


def test_a_run_by_itself_has_the_drawn_detector(folder: Path, learned: Learned, tmp_path: Path) -> None:
    condition, scenes = Condition("harbour", {"detector": "few.yaml"}), Scenes(3, folder, learned=True)
    alone, shared = scenes.alone(condition, 5, 6), scenes.of(condition, 5, 6)
    alone.copy.write(tmp_path)
    written = load_detector(tmp_path / "detector.yaml").states[0]
    assert alone.detector_seed == 6
    for state in (alone.detector.states[0], shared.detector.states[0]):
        np.testing.assert_array_equal(state.confusion, written.confusion)
        np.testing.assert_array_equal(state.box_error.covariance, written.box_error.covariance)


def test_a_key_that_the_campaign_sets_is_not_drawn_and_nothing_within_it(folder: Path, learned: Learned) -> None:
    vary = [{"list": [{"detector": "few.yaml", "detector.miss_rate": 0.125}]}]
    found = checked_campaign(folder, **DRAWN, seeds={"traffic": 3}, vary=vary)
    layers = RunLayers(found.file.keys, folder, folder / "cache")
    states = [layers.layers_of(found.plan.run(number)).rows.scene.detector.states[0] for number in range(3)]
    assert [state.confusion[-1, 0] for state in states] == [0.125] * 3
    assert len({state.false_discovery_rate for state in states}) == 3
    # Settings of keys within others come later: a drawn mean would undo the box error that the campaign varies.
    errors = {"unit": "px", "mean": [0.0] * 4, "covariance": np.diag([1.0, 2.0, 3.0, 4.0]).tolist()}
    condition = Condition("harbour", {"detector": "few.yaml", "detector.states.real_world.box_error": errors})
    for scene in (Scenes(3, folder, learned=True).of(condition, seed, 6) for seed in (5, 6)):
        np.testing.assert_array_equal(scene.detector.states[0].box_error.covariance, errors["covariance"])


def test_a_detector_without_what_learn_says_of_it_is_refused(folder: Path, learned: Learned, tmp_path: Path) -> None:
    def refused(detector: str) -> str:
        return "\n".join(problems_of(tmp_path, **DRAWN, vary=[{"grid": {"detector": [detector]}}]))

    assert "uncertainty: learned needs thesis.uncertainty.json beside it" in refused("thesis")
    for name in ("few.yaml", "few.uncertainty.json"):
        shutil.copy(folder / name, tmp_path)
    with (tmp_path / "few.yaml").open("a") as file:
        file.write("# edited\n")
    assert "few.uncertainty.json belongs to another detector file, or the file was changed" in refused("few.yaml")
    text = (folder / "few.uncertainty.json").read_text()
    shutil.copy(folder / "few.yaml", tmp_path)
    (tmp_path / "few.uncertainty.json").write_text(text.replace('"units":12', '"units":2'))
    assert "learned from 2 images or runs, too few" in refused("few.yaml")
    (tmp_path / "few.uncertainty.json").write_text(text[:100])
    assert "few.uncertainty.json" in refused("few.yaml")


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
            truth = layers.layers_of(campaign.plan.run(number)).rows.truth
            there = flags(truth, "annotated")
            missed = int((there & ~flags(truth, "detected")).sum())
            interval = stats.binomtest(missed, int(there.sum())).proportion_ci(0.999)
            assert there.sum() > 300 and interval.low <= rate <= interval.high
