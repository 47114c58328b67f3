"""The oracle-association reference; the campaign `tracker_scores`: a small sample, and its committed result."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.special import stdtrit

from benchmarks.campaigns import tracker_scores
from benchmarks.oracle_noise import LIMITS, fitted_noise, log_likelihood, most_likely_noise
from benchmarks.tracker_trials import looks, mean_and_interval, on_the_sea, perfect_detector, tracks_lost_when_hidden
from modsim3d import InputError, ModsimError, RunRows, load_scene, score_world
from modsim3d.core.boxes import centre_form, centres, corner_form
from modsim3d.detector.records import FALSE_KINDS, KINDS
from modsim3d.io.input_files import data_folder
from modsim3d.runs.files.tables import indices, number_column
from modsim3d.tracking import oracle
from modsim3d.tracking.oracle import BoxSequences, SmootherNoise, oracle_tracks, smoothed_motion, smoother_noise
from modsim3d.tracking.score_outcome import ONE_RUN
from modsim3d.tracks.true_tracks import TrueTracks
from tests.detector.detector_builders import no_error, one_state_data
from tests.run_folders import finished
from tests.scenes import crossing
from tests.tracks.track_files import scene_run

SURE = {"confusion": [[1.0], [0.0]], "false_positive_labels": [1.0], "false_discovery_rate": 0.0}
PERFECT = one_state_data(**SURE, box_error=no_error()) | {"labels": ["Vessel"]}


EXACT = SmootherNoise(noise_share=0, noise_x_px=0, noise_y_px=0, size_noise=0, velocity_change_px_s=5)


@pytest.fixture(scope="module")
def noisy(tmp_path_factory):
    return RunRows.of(scene_run(tmp_path_factory.mktemp("noisy") / "run", "strait", steps=60, seed=3))


@pytest.fixture(scope="module")
def perfect(tmp_path_factory):
    folder = tmp_path_factory.mktemp("perfect")
    (folder / "perfect.yaml").write_text(json.dumps(PERFECT), encoding="utf-8")
    return RunRows.of(finished(load_scene(crossing(folder), detector=folder / "perfect.yaml"), folder / "run"))


@pytest.fixture(scope="module")
def truth(noisy):
    return TrueTracks.of(noisy)


def truth_at(truth, tracks):
    """Row of the truth with the identity and the frame of each row of the tracks, which must be there."""
    where = {key: row for row, key in enumerate(zip(truth.frame.tolist(), truth.identity.tolist(), strict=True))}
    return np.array([where[key] for key in zip(tracks.frame.tolist(), tracks.track.tolist(), strict=True)])


def with_detections(rows, chosen):
    columns = {name: getattr(rows, name)[chosen] for name in ("detection_frame", "detection_vessel")}
    return replace(rows, detections=rows.detections.take(chosen), **columns)


def frames_of(tracks, track):
    return tracks.frame[tracks.track == track]


def test_without_noise_and_misses_the_true_boxes_come_back_and_the_smoother_only_bridges_hidden_vessels(perfect):
    truth = TrueTracks.of(perfect)
    raw = oracle_tracks(perfect, truth, smoothed=False)
    assert len(raw) == truth.scored.sum() > 20
    np.testing.assert_array_equal(raw.boxes_px, np.round(truth.boxes_px[truth_at(truth, raw)], 3))
    smoothed = oracle_tracks(perfect, truth, smoothed=True, noise=EXACT)
    seen = smoothed.take(np.isfinite(smoothed.confidence))
    assert (seen.frame.tolist(), seen.track.tolist()) == (raw.frame.tolist(), raw.track.tolist())
    np.testing.assert_allclose(seen.boxes_px, raw.boxes_px, rtol=0, atol=1e-6)
    hidden = truth.take(truth.hidden)
    keys = set(zip(smoothed.frame.tolist(), smoothed.track.tolist(), strict=True))
    assert set(zip(hidden.frame.tolist(), hidden.identity.tolist(), strict=True)) & keys and len(smoothed) > len(raw)


def test_tracks_have_each_frame_the_boxes_of_a_tracker_and_the_identities_of_the_truth(noisy, truth):
    raw = oracle_tracks(noisy, truth, smoothed=False)
    smoothed = oracle_tracks(noisy, truth, smoothed=True, noise=SmootherNoise())
    assert len(smoothed) > len(raw) and set(smoothed.track.tolist()) == set(raw.track.tolist())
    for track in np.unique(raw.track).tolist():
        seen, frames = frames_of(raw, track), frames_of(smoothed, track)
        taken = noisy.frames[noisy.frames % 2 == seen[0] % 2]
        assert frames.tolist() == taken[(taken >= seen[0]) & (taken <= seen[-1])].tolist()
        before = np.searchsorted(seen, frames, side="right") - 1
        assert smoothed.label[smoothed.track == track].tolist() == raw.label[raw.track == track][before].tolist()
    assert len(np.unique(raw.label)) > 1
    false = np.isin(indices(noisy.detections, "kind", KINDS), FALSE_KINDS)
    assert false.sum() > 5 and len(raw) == (~false).sum()
    boxes_px, confidence = noisy.detection_boxes_px(), number_column(noisy.detections, "confidence")
    told = (noisy.detection_frame, noisy.detection_vessel, np.round(boxes_px, 3), np.round(confidence, 6))
    given = (raw.frame, truth.vessel[truth_at(truth, raw)], raw.boxes_px, raw.confidence)
    assert sorted(np.column_stack(given).tolist()) == sorted(np.column_stack(told)[~false].tolist())
    split = replace(truth, identity=2 * truth.identity + (truth.frame >= 90))
    tracks = oracle_tracks(noisy, split, smoothed=True, noise=SmootherNoise())
    assert all((frames_of(tracks, track) >= 90).all() == bool(track % 2) for track in np.unique(tracks.track).tolist())


def test_smoothed_centres_are_closer_to_the_truth_and_boxes_of_a_size_stay_in_the_image(noisy, truth):
    raw = oracle_tracks(noisy, truth, smoothed=False)
    smoothed = oracle_tracks(noisy, truth, smoothed=True, noise=smoother_noise("strait"))
    seen = smoothed.take(np.isfinite(smoothed.confidence))
    true = truth.boxes_px[truth_at(truth, raw)]
    errors = [np.hypot(*(centres(each.boxes_px) - centres(true)).T) for each in (raw, seen)]
    assert errors[1].mean() < 0.95 * errors[0].mean() and np.isfinite(smoothed.covariance_px2).all()
    assert (smoothed.covariance_px2[:, 0, 0] > 0).all()
    smoothed = oracle_tracks(noisy, truth, smoothed=True, noise=SmootherNoise(velocity_change_px_s=500))
    assert (centre_form(smoothed.boxes_px)[:, 2:] >= 1 - 1e-9).all()
    for index, camera in enumerate(noisy.scene.cameras):
        boxes_px = smoothed.boxes_px[smoothed.camera == index]
        assert (boxes_px >= 0).all() and (boxes_px <= np.tile(camera.intrinsics.image_size_px, 2)).all()


def test_the_smoother_is_the_least_squares_solution_of_all_steps_at_once():
    rng, time_s = np.random.default_rng(1), np.array([1.0, 0.5, 1.5, 0.7, 2.0])
    measured = np.array([100, 200, 60, 40]) + rng.normal(0, 3, (5, 4)).cumsum(axis=0)
    there = np.array([True, True, False, True, True])
    noise = SmootherNoise(noise_share=0, noise_x_px=2, noise_y_px=3, size_noise=1.2)
    found = smoothed_motion(BoxSequences(corner_form(measured[:, None]), there[:, None], time_s[:, None]), noise)
    variance, walk = noise.variance_px2(np.ones(2)), noise.rate_walk_px_s**2
    for axis in range(4):
        # Each row of the unknown places and rates, 10 of them, has variance 1.
        rows, wanted = [np.eye(10)[1] / 1000], [0.0]
        for step in np.flatnonzero(there):
            rows.append(np.eye(10)[2 * step] / np.sqrt(variance[axis]))
            wanted.append(measured[step, axis] / np.sqrt(variance[axis]))
        for step, elapsed in enumerate(time_s[1:]):
            change = np.zeros((2, 10))
            change[:, 2 * step : 2 * step + 2] = -np.array([[1, elapsed], [0, 1]])
            change[:, 2 * step + 2 : 2 * step + 4] = np.eye(2)
            spread = walk[axis] * np.array([[elapsed**3 / 3, elapsed**2 / 2], [elapsed**2 / 2, elapsed]])
            rows.extend(np.linalg.solve(np.linalg.cholesky(spread), change))
            wanted.extend([0.0, 0.0])
        matrix = np.array(rows)
        information = matrix.T @ matrix
        best, covariance = np.linalg.solve(information, matrix.T @ np.array(wanted)), np.linalg.inv(information)
        np.testing.assert_allclose([each.place[0, axis] for each in found], best[::2], rtol=1e-6)
        np.testing.assert_allclose([each.rate[0, axis] for each in found], best[1::2], rtol=1e-5, atol=1e-6)
        for name, offset in (("place_variance", 0), ("rate_variance", 1)):
            given = [getattr(each, name)[0, axis] for each in found]
            np.testing.assert_allclose(given, np.diag(covariance)[offset::2], rtol=1e-5)


def test_what_comes_after_the_last_detection_changes_nothing():
    rng = np.random.default_rng(2)
    boxes = corner_form(np.array([100, 200, 60, 40]) + rng.normal(0, 3, (4, 1, 4)))
    there, time_s = np.ones((4, 1), dtype=bool), np.ones((4, 1))
    longer = BoxSequences(np.tile(boxes, (2, 1, 1)), np.concatenate([there, ~there]), np.ones((8, 1)))
    short = smoothed_motion(BoxSequences(boxes, there, time_s), SmootherNoise())
    for one, other in zip(short, smoothed_motion(longer, SmootherNoise()), strict=False):
        np.testing.assert_allclose(one.place, other.place, rtol=1e-9)


def test_the_noise_that_made_boxes_is_found_again_and_makes_a_run_more_likely_than_other_noise(perfect):
    rng, count, length = np.random.default_rng(3), 60, 40
    made = SmootherNoise(**dict(zip(LIMITS, (0.05, 2.0, 4.0, 1.5, 6.0, 1.0), strict=True)))
    size = np.exp(rng.uniform(np.log(40), np.log(600), count))
    place = np.column_stack([np.zeros((count, 2)), size, size])
    rate, boxes = np.zeros((count, 4)), []
    for _ in range(length):
        boxes.append(place + rng.normal(0, 1, (count, 4)) * np.sqrt(made.variance_px2(place[:, 2:])))
        first, second = rng.normal(0, 1, (2, count, 4)) * made.rate_walk_px_s
        place, rate = place + rate + first / 2 + second / np.sqrt(12), rate + first
        place = np.maximum(place, [-np.inf, -np.inf, 5, 5])
    there = rng.random((length, count)) < 0.9
    there[0] = True
    found = most_likely_noise(BoxSequences(corner_form(np.array(boxes)), there, np.ones((length, count))))
    for name, value in made.model_dump().items():
        assert getattr(found, name) == pytest.approx(value, rel=0.25), name
    truth = TrueTracks.of(perfect)
    sequences = oracle.IdentitySpans.of(perfect, oracle.DetectionSources.of(perfect, truth)).sequences
    found = fitted_noise(perfect, truth)
    for name in ("noise_x_px", "noise_y_px", "growth_change_px_s"):
        for factor in (0.3, 3):
            least, most = LIMITS[name]
            other = found.model_copy(update={name: factor * getattr(found, name)})
            if least <= getattr(other, name) <= most:
                assert log_likelihood(sequences, other) < log_likelihood(sequences, found)


def test_each_shipped_scene_has_its_noise_others_the_default_and_a_damaged_file_is_an_error(tmp_path, monkeypatch):
    names = sorted(path.stem for path in data_folder("scenes").glob("*.yaml"))
    noises = [smoother_noise(name) for name in names]
    assert len(set(map(str, [*noises, smoother_noise("of somebody")]))) == len(names) + 1 == 8
    (tmp_path / "trackers").mkdir()
    (tmp_path / "trackers" / "oracle.yaml").write_text("default: {noise_x_px: -1}\nscenes: {}\n", encoding="utf-8")
    monkeypatch.setattr(oracle, "data_folder", lambda kind: tmp_path)
    with pytest.raises(InputError, match=r"default\.noise_x_px"):
        smoother_noise("fairway")


def test_a_run_without_detections_has_no_tracks_and_one_with_single_ones_no_noise(noisy, truth, perfect):
    nothing = with_detections(noisy, np.empty(0, int))
    for smoothed in (False, True):
        assert len(oracle_tracks(nothing, truth, smoothed=smoothed)) == 0
    short = with_detections(perfect, np.flatnonzero(perfect.detection_frame == 0))
    with pytest.raises(ModsimError, match="no vessel is detected twice"):
        fitted_noise(short, TrueTracks.of(perfect))


ROOT = Path(__file__).resolve().parents[2]
CAMPAIGNS = ROOT / "docs" / "campaigns"


@pytest.fixture(scope="module")
def data() -> dict:
    return json.loads((CAMPAIGNS / "tracker_scores.json").read_text(encoding="utf-8"))


def test_the_committed_page_is_of_its_figures_with_the_largest_spread_and_no_interval_without_width(data):
    page = (CAMPAIGNS / "tracker_scores.md").read_text(encoding="utf-8")
    assert page == tracker_scores.page(data)
    # Not reached: the page says so, and nothing else may be wrong.
    assert [problem.partition(":")[0] for problem in tracker_scores.problems(data)] == ["fairway", "harbour"]
    below = page.partition("HOTA is below 0.9 in ")[2].partition(".\n")[0]
    too_low = {name for name, each in data["perfect"].items() if each["reference"]["hota"]["mean"] < 0.9}
    assert {name for name in data["perfect"] if f"`{name}`" in below} == too_low
    assert set(tracker_scores.readme_table(data)) <= set((ROOT / "README.md").read_text(encoding="utf-8").splitlines())
    # The standard deviation of n values is half the interval of their mean, times √n / t.
    halves = [line[key] for lines in data["scenes"].values() for line in lines for key in ("hota", "hota_centre")]
    spread = [each["half"] * np.sqrt(each["n"]) / stdtrit(each["n"] - 1, 0.975) for each in halves]
    assert f"up to {max(spread):.1g}, so" in ONE_RUN
    assert not re.search(r"± 0\.0*[^0-9.]", page) and "± 0.00 " not in tracker_scores.page(data)
    means = [{"mean": 0.98, "half": 0.0031}, {"mean": 0.98, "half": 0.0012}, {"mean": 1.0, "half": 0.0}]
    cells = [tracker_scores.cell(each) for each in (*means, mean_and_interval([1.0] * 19))]
    assert cells == ["0.98 ± 0.003", "0.98 ± 0.001", "1.00", "1.00"]


def rows_of(scene: str, traffic_seed: int, detector_seed: int, tracker: str, hota: float, survived: list) -> dict:
    keys = ("hota", "hota_centre", "deta", "assa", "idf1", "id_switches", "false_tracks")
    scores = dict.fromkeys(keys, hota) | {"hota_centre": hota / 2, "states": {"clear": hota}, "occlusions": survived}
    seeds = {"scene": scene, "traffic_seed": traffic_seed, "detector_seed": detector_seed}
    return seeds | {"tracker": tracker} | scores


@pytest.fixture(scope="module")
def rows() -> tuple[list[dict], ...]:
    """Three traffics of the fairway, and another scene's detector seeds; the first tracker is 0.1 better on each."""
    every = (*tracker_scores.TRACKERS, *tracker_scores.ORACLES)
    drawn, others, misses = [], [], []
    for k, tracker in enumerate(every):
        for seed in (1, 2, 3):
            better, survived = 0.1 * (k == 0), [[seed, seed - 1], [10 * seed, 5], [4, 4], [0, 0]]
            hota = 0.2 * seed + better
            drawn += [rows_of("fairway", seed, look, tracker, hota, survived) for look in (seed, seed + 1)]
        for name in tracker_scores.SCENES[1:]:
            others += [rows_of(name, 0, look, tracker, 0.5 + look / 10, [[2, 1]] * 4) for look in (0, 1)]
    alone = [
        rows_of(name, seed, seed, tracker, 0.95, [[0, 0]] * 4)
        for name in tracker_scores.SCENES
        for seed in ((1, 2) if name == "fairway" else (0,))
        for tracker in ("reference", "lost when hidden")
    ]
    for tracker in tracker_scores.TRACKERS:
        for rate in tracker_scores.MISS_RATES:
            for seed in (1, 2):
                row = rows_of("fairway", seed, seed, tracker, 0.9 - rate * (1 + seed / 100), [[0, 0]] * 4)
                misses.append(row | {"miss_rate": rate})
    places = [(name, seed, look) for name in tracker_scores.SCENES for seed in (1, 2) for look in (1, 2)]
    in_world = [
        {"scene": name, "traffic_seed": seed, "detector_seed": look, "tracker": line}
        | dict.fromkeys(keys, 10.0 * seed + k)
        for name, seed, look in places
        for k, line in enumerate(tracker_scores.WORLD_TRACKERS)
        for keys in [tracker_scores.WORLD]
    ]
    return drawn + others, alone, misses, in_world


def test_rows_are_stored_as_they_were_and_the_page_is_made_of_them_alone(rows: tuple, tmp_path, monkeypatch) -> None:
    pq.write_table(tracker_scores.rows_table(*rows), tmp_path / tracker_scores.ROWS)
    for part, again in zip(rows, tracker_scores.stored_rows(tmp_path / tracker_scores.ROWS), strict=True):
        assert [{key: row[key] for key in given} for given, row in zip(part, again, strict=True)] == part
    monkeypatch.setattr("sys.argv", ["tracker_scores", "--stored", "--out", str(tmp_path)])
    assert tracker_scores.main() == 0
    data = json.loads((tmp_path / "tracker_scores.json").read_text())
    text = (tmp_path / "tracker_scores.md").read_text()
    assert (data["seeds"], data["looks"], data["other_looks"], data["miss_seeds"]) == (3, 2, 2, 2)
    assert (data["world"]["seeds"], data["world"]["looks"], data["world"]["other_looks"]) == (2, 2, 4)
    gospa = data["world"]["scenes"]["fairway"][1]["gospa_m"]  # 11 and 21, of two traffics
    assert (gospa["mean"], gospa["n"]) == (16, 2) and text.count("| world_gnn with AIS | 16 ± 64 | ") == 6
    assert f"SHA-256 {data['rows']}" in text and tracker_scores.ROWS in text
    assert "| reference − sort | 0.100 |" in text  # the same difference on all seeds has no interval
    readme = tracker_scores.readme_table(data)
    assert "| Difference | HOTA by centre on `fairway` |" in readme and "| reference − sort | 0.050 |" in readme


def test_survives_is_the_share_of_all_occlusions_beside_it_and_scores_fall_with_the_miss_rate(rows):
    """Of 1, 2 and 3 occlusions in two looks each 0, 1 and 2 are survived: 6 of 12, and no mean of 0, 1/2 and 2/3."""
    first, second, third, none = tracker_scores.table(rows[0], "fairway")[0]["occlusions"]
    assert (first["survived"], first["all"], first["mean"], first["n"]) == (6, 12, 0.5, 3)
    # By hand: sums of seeds (0, 2), (2, 4), (4, 6); residuals -1, 0, 1; √(3/2 · 2) / 12 · t(2).
    assert first["half"] == pytest.approx(stdtrit(2, 0.975) * np.sqrt(3) / 12)
    assert (second["survived"], second["all"]) == (30, 120)
    assert (third["mean"], third["half"]) == (1, None) and none["mean"] is None
    assert tracker_scores.cell(third) == "1.00"
    every = [tracker_scores.miss_trial(("simulation_1", 5, rate, 100)) for rate in (0.0, 0.4)]
    for sound, missing in zip(*every, strict=True):
        assert sound["hota"] > missing["hota"]
    reference, lost_when_hidden = tracker_scores.perfect_trial(("simulation_2", 0, 150))
    assert reference["hota"] > tracker_scores.PERFECT_LEAST and lost_when_hidden["deta"] == 1


def test_true_boxes_lie_within_a_length_of_their_vessels_and_an_interval_is_student_s():
    detector = perfect_detector(load_scene("simulation_1").detector.labels)
    ((_, rows),) = looks("simulation_1", 5, 1, 15, detector)
    scored = score_world(rows, on_the_sea(rows, tracks_lost_when_hidden(rows))).flat()
    assert scored["rmse_m"] < 8 and scored["followed_share"] > 0.95
    found = tracker_scores.world_trial(("simulation_1", 5, 1, 15))
    assert [row["tracker"] for row in found] == list(tracker_scores.WORLD_TRACKERS)
    assert all(row["gospa_m"] >= 0 and set(tracker_scores.WORLD) < set(row) for row in found)
    # Of 1, 2, 3: mean 2, standard deviation 1, and the 97.5 % quantile of t with 2 degrees of freedom is 4.3027.
    found = mean_and_interval([1.0, None, 2.0, 3.0])
    assert found == {"n": 3, "mean": 2, "half": pytest.approx(4.302653 / np.sqrt(3), rel=1e-6)}
    assert mean_and_interval([5.0]) == {"n": 1, "mean": 5.0, "half": None}
    rows = [{"traffic_seed": seed, "hota": value} for seed, value in ((1, 0.2), (1, 0.4), (2, 0.5), (2, 0.7))]
    found = tracker_scores.nested(rows, "hota")
    assert found["n"] == 2 and found["mean"] == pytest.approx(0.45)
    found = tracker_scores.nested([{"traffic_seed": 0, "hota": value} for value in (0.2, 0.4, 0.6)], "hota")
    assert found["n"] == 3 and found["half"] is not None
