"""What comes out of the detector has the statistics that went in, over 200,000 untruncated boxes."""

import numpy as np
import pytest

from modsim3d.detector.records import FALSE_POSITIVE, TRUE, Detections
from tests.detector import detector_builders as build

FRAMES, VESSELS = 10_000, 20


LABEL = np.arange(VESSELS) % 2


@pytest.fixture(scope="module")
def found() -> Detections:
    targets = build.steady_targets(FRAMES, VESSELS, build.centred(600, 600), LABEL)
    return build.run(build.one_state_data(), build.make_frames(FRAMES), targets, seed=20)


def test_boxes_are_the_truth_with_their_errors_and_none_of_this_sample_is_truncated(found: Detections) -> None:
    true, truth = found.kind == TRUE, np.array(build.centred(600, 600))
    boxes = found.boxes_px[true]
    centre_error = (boxes[:, :2] + boxes[:, 2:]) / 2 - (truth[:2] + truth[2:]) / 2
    size_error = boxes[:, 2:] - boxes[:, :2] - 600
    np.testing.assert_allclose(np.hstack([centre_error, size_error]), found.errors_px[true], atol=1e-9)
    assert not found.redrawn.any()


def test_rates_of_labels_and_of_misses_are_the_confusion_matrix(found: Detections) -> None:
    label = build.by_frame(found, found.label, FRAMES, VESSELS, 2)  # a miss is the last row
    for vessels, column in enumerate(np.array([[0.7, 0.1, 0.2], [0.1, 0.6, 0.3]])):
        seen_as = label[:, vessels == LABEL]
        rates = np.bincount(seen_as.astype(int).ravel(), minlength=3) / seen_as.size
        assert np.all(np.abs(rates - column) < 4 * np.sqrt(column * (1 - column) / seen_as.size))


def test_mean_and_covariance_of_box_errors_are_those_asked_for(found: Detections) -> None:
    errors, c = found.errors_px[found.kind == TRUE], np.array(build.COVARIANCE_PX2, dtype=float)
    variances = np.diag(c)
    assert np.all(np.abs(errors.mean(axis=0) - build.MEAN_PX) < 4 * np.sqrt(variances / len(errors)))
    # Of a normal sample: var(s_ij) = (c_ii c_jj + c_ij²) / (n − 1)
    standard_error = np.sqrt((np.outer(variances, variances) + c**2) / (len(errors) - 1))
    assert np.all(np.abs(np.cov(errors.T) - c) < 4 * standard_error)


def test_false_positives_are_the_share_asked_for_and_have_the_labels_asked_for(found: Detections) -> None:
    labels = found.label[found.kind == FALSE_POSITIVE]
    n_true = len(found) - len(labels)
    # Given the true detections the count is Poisson with mean n·r / (1 − r); the rest is the delta method.
    assert abs(len(labels) / len(found) - 0.2) < 4 * np.sqrt(n_true * 0.2 / 0.8) * n_true / len(found) ** 2
    assert abs(labels.mean() - 0.75) < 4 * np.sqrt(0.75 * 0.25 / len(labels))


def test_confidence_has_the_mean_and_spread_asked_for(found: Detections) -> None:
    for kind in (TRUE, FALSE_POSITIVE):
        confidence = found.confidence[found.kind == kind]
        # Clipping at 0.2 and 1, 4.7 and 3.3 standard deviations away, changes the mean by less than 1e-5.
        assert abs(confidence.mean() - 0.67) < 4 * 0.1 / np.sqrt(len(confidence))
        assert abs(confidence.std() - 0.1) < 4 * 0.1 / np.sqrt(2 * len(confidence))


def test_noise_of_a_vessel_at_consecutive_steps_is_uncorrelated(found: Detections) -> None:
    series = build.by_frame(found, found.errors_px[:, 0], FRAMES, VESSELS)
    for one, other in [(series[:-1], series[1:]), (series[:, :-1], series[:, 1:])]:
        both = ~np.isnan(one) & ~np.isnan(other)
        assert abs(np.corrcoef(one[both], other[both])[0, 1]) < 4 / np.sqrt(both.sum())
