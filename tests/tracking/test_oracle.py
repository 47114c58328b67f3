"""The oracle-association reference."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.oracle_noise import LIMITS, fitted_noise, log_likelihood, most_likely_noise
from modsim3d import InputError, ModsimError, RunRows, load_scene
from modsim3d.core.boxes import centre_form, centres, corner_form
from modsim3d.detector.records import FALSE_KINDS, KINDS
from modsim3d.io.input_files import data_folder
from modsim3d.runs.files.tables import indices, number_column
from modsim3d.tracking import oracle
from modsim3d.tracking.oracle import BoxSequences, SmootherNoise, oracle_tracks, smoothed_motion, smoother_noise
from modsim3d.tracks.true_tracks import TrueTracks
from tests.detector.detector_builders import no_error, one_state_data
from tests.run_folders import finished
from tests.scenes import crossing
from tests.tracks.track_files import scene_run

PERFECT = one_state_data(
    **{
        "confusion": [[1.0], [0.0]],
        "false_positive_labels": [1.0],
        "false_discovery_rate": 0.0,
        "box_error": no_error(),
    }
) | {"labels": ["Vessel"]}


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


def test_each_track_has_each_frame_from_its_first_detection_to_its_last_labelled_as_the_one_before(noisy, truth):
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


def test_boxes_are_those_that_a_tracker_is_given_no_false_one_with_the_identities_of_the_truth(noisy, truth):
    raw = oracle_tracks(noisy, truth, smoothed=False)
    false = np.isin(indices(noisy.detections, "kind", KINDS), FALSE_KINDS)
    assert false.sum() > 5 and len(raw) == (~false).sum()
    boxes_px, confidence = noisy.detection_boxes_px(), number_column(noisy.detections, "confidence")
    told = (noisy.detection_frame, noisy.detection_vessel, np.round(boxes_px, 3), np.round(confidence, 6))
    given = (raw.frame, truth.vessel[truth_at(truth, raw)], raw.boxes_px, raw.confidence)
    assert sorted(np.column_stack(given).tolist()) == sorted(np.column_stack(told)[~false].tolist())


def test_of_two_boxes_of_one_appearance_the_tracks_stay_apart_where_the_truth_splits_it(noisy, truth):
    split = replace(truth, identity=2 * truth.identity + (truth.frame >= 90))
    tracks = oracle_tracks(noisy, split, smoothed=True, noise=SmootherNoise())
    assert all((frames_of(tracks, track) >= 90).all() == bool(track % 2) for track in np.unique(tracks.track).tolist())


def test_smoothed_centres_are_closer_to_the_truth_than_detected_ones(noisy, truth):
    raw = oracle_tracks(noisy, truth, smoothed=False)
    smoothed = oracle_tracks(noisy, truth, smoothed=True, noise=smoother_noise("strait"))
    seen = smoothed.take(np.isfinite(smoothed.confidence))
    true = truth.boxes_px[truth_at(truth, raw)]
    errors = [np.hypot(*(centres(each.boxes_px) - centres(true)).T) for each in (raw, seen)]
    assert errors[1].mean() < 0.95 * errors[0].mean() and np.isfinite(smoothed.covariance_px2).all()
    assert (smoothed.covariance_px2[:, 0, 0] > 0).all()


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


def test_the_noise_that_made_boxes_is_found_again():
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


def test_fitted_noise_makes_the_detections_of_a_run_more_likely_than_other_noise(perfect):
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


def test_boxes_of_a_size_stay_in_the_image(noisy, truth):
    smoothed = oracle_tracks(noisy, truth, smoothed=True, noise=SmootherNoise(velocity_change_px_s=500))
    assert (centre_form(smoothed.boxes_px)[:, 2:] >= 1 - 1e-9).all()
    for index, camera in enumerate(noisy.scene.cameras):
        boxes_px = smoothed.boxes_px[smoothed.camera == index]
        assert (boxes_px >= 0).all() and (boxes_px <= np.tile(camera.intrinsics.image_size_px, 2)).all()
