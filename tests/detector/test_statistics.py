"""What comes out of the detector has the statistics that went in, over 200,000 untruncated boxes."""

from dataclasses import dataclass

import numpy as np
import pytest

from modsim3d.detector.records import FALSE_POSITIVE, TRUE, Detections, Targets
from tests.detector import detector_builders as build

FRAMES, VESSELS = 10_000, 20
CONFUSION = np.array([[0.7, 0.1], [0.1, 0.6], [0.2, 0.3]])


@dataclass(frozen=True)
class Sample:
    targets: Targets
    detections: Detections

    @property
    def errors_px(self) -> np.ndarray:
        return self.detections.errors_px[self.detections.kind == TRUE]


@pytest.fixture(scope="module")
def sample() -> Sample:
    label = np.arange(VESSELS) % 2
    targets = build.steady_targets(FRAMES, VESSELS, build.centred(600, 600), label)
    return Sample(targets, build.run(build.one_state_data(), build.make_frames(FRAMES), targets, seed=20))


def test_no_box_of_the_sample_is_truncated(sample: Sample) -> None:
    assert len(sample.targets) == 200_000 and not sample.detections.redrawn.any()


@pytest.mark.parametrize("label", [0, 1])
def test_dropout_rate_is_the_background_row(sample: Sample, label: int) -> None:
    detected = np.zeros(len(sample.targets), dtype=bool)
    detected[sample.detections.target[sample.detections.kind == TRUE]] = True
    missed = ~detected[sample.targets.label == label]
    p = CONFUSION[2, label]
    assert abs(missed.mean() - p) < 4 * np.sqrt(p * (1 - p) / len(missed))


@pytest.mark.parametrize("label", [0, 1])
@pytest.mark.parametrize("detected_as", [0, 1])
def test_class_rates_are_the_confusion_matrix(sample: Sample, label: int, detected_as: int) -> None:
    true = sample.detections.kind == TRUE
    came_from = sample.targets.label[sample.detections.target[true]]
    count = np.sum((came_from == label) & (sample.detections.label[true] == detected_as))
    trials, p = np.sum(sample.targets.label == label), CONFUSION[detected_as, label]
    assert abs(count / trials - p) < 4 * np.sqrt(p * (1 - p) / trials)


@pytest.mark.parametrize("component", range(4))
def test_box_error_mean_is_the_one_asked_for(sample: Sample, component: int) -> None:
    errors = sample.errors_px[:, component]
    standard_error = np.sqrt(build.COVARIANCE_PX2[component][component] / len(errors))
    assert abs(errors.mean() - build.MEAN_PX[component]) < 4 * standard_error


@pytest.mark.parametrize(("i", "j"), [(i, j) for i in range(4) for j in range(i, 4)])
def test_box_error_covariance_is_the_one_asked_for(sample: Sample, i: int, j: int) -> None:
    c, errors = np.array(build.COVARIANCE_PX2, dtype=float), sample.errors_px
    # Of a normal sample: var(s_ij) = (c_ii c_jj + c_ij²) / (n − 1)
    standard_error = np.sqrt((c[i, i] * c[j, j] + c[i, j] ** 2) / (len(errors) - 1))
    assert abs(np.cov(errors.T)[i, j] - c[i, j]) < 4 * standard_error


def test_boxes_are_the_truth_with_these_errors(sample: Sample) -> None:
    true = sample.detections.kind == TRUE
    boxes, truth = sample.detections.boxes_px[true], np.array(build.centred(600, 600))
    centre_error = (boxes[:, :2] + boxes[:, 2:]) / 2 - (truth[:2] + truth[2:]) / 2
    size_error = boxes[:, 2:] - boxes[:, :2] - 600
    np.testing.assert_allclose(np.hstack([centre_error, size_error]), sample.errors_px, atol=1e-9)


def test_false_positives_are_the_share_asked_for_of_all_detections(sample: Sample) -> None:
    n_false = np.sum(sample.detections.kind == FALSE_POSITIVE)
    n_true = len(sample.detections) - n_false
    # Given the true detections the count is Poisson with mean n·r / (1 − r); the rest is the delta method.
    standard_error = np.sqrt(n_true * 0.2 / 0.8) * n_true / len(sample.detections) ** 2
    assert abs(n_false / len(sample.detections) - 0.2) < 4 * standard_error


def test_false_positive_labels_have_their_distribution(sample: Sample) -> None:
    labels = sample.detections.label[sample.detections.kind == FALSE_POSITIVE]
    assert abs(labels.mean() - 0.75) < 4 * np.sqrt(0.75 * 0.25 / len(labels))


@pytest.mark.parametrize("kind", [TRUE, FALSE_POSITIVE])
def test_confidence_has_the_mean_and_spread_asked_for(sample: Sample, kind: int) -> None:
    confidence = sample.detections.confidence[sample.detections.kind == kind]
    # Clipping at 0.2 and 1, 4.7 and 3.3 standard deviations away, changes the mean by less than 1e-5.
    assert abs(confidence.mean() - 0.67) < 4 * 0.1 / np.sqrt(len(confidence))
    assert abs(confidence.std() - 0.1) < 4 * 0.1 / np.sqrt(2 * len(confidence))


def test_noise_of_a_vessel_at_consecutive_steps_is_uncorrelated(sample: Sample) -> None:
    series = build.by_frame(sample.detections, sample.detections.errors_px[:, 0], FRAMES, VESSELS)
    for one, other in [(series[:-1], series[1:]), (series[:, :-1], series[:, 1:])]:
        both = ~np.isnan(one) & ~np.isnan(other)
        assert abs(np.corrcoef(one[both], other[both])[0, 1]) < 4 / np.sqrt(both.sum())
