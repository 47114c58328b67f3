"""Box errors each component of which has a memory of its own: correlations are the file's, and `verify` holds them."""

from typing import Any

import numpy as np
import pytest
from scipy import special, stats

from modsim3d.detector.file.reading import parse_detector
from modsim3d.scene.reading import load_scene
from modsim3d.verify.error_fit import MomentTable
from modsim3d.verify.evidence import ManyDetections
from modsim3d.verify.verification import verify_evidence
from tests.detector import detector_builders as build
from tests.detector_variants import variant

MEMORY = {
    "vessel_share": [0.1, 0.5, 0.0, 0.2, 0.3],
    "shares": [[0.5, 0.1, 0.0, 0.3, 0.2], [0.3, 0.4, 0.2, 0.5, 0.5]],
    "times_s": [0.1, 0.8],
}
PLAIN = {"unit": "px", "mean": [0, 0, 0, 0], "covariance": np.diag([4.0, 4.0, 9.0, 1.0]).tolist()}
HEAVY = PLAIN | {"law": "student_t", "degrees_of_freedom": 3}
FRAMES, VESSELS, STEP_S = 1500, 60, 0.1


def errors_of(error: dict[str, Any], frames: int = FRAMES) -> np.ndarray:
    """Errors (frames, vessels, 4) of vessels that are always found, in standard deviations."""
    data = build.one_state_data(confusion=build.ALL_SEEN, false_discovery_rate=0, box_error=error)
    targets = build.steady_targets(frames, VESSELS, build.centred(2000, 1500))
    found = build.detector(data | {"persistence": {"box": MEMORY}}, 2).detect(build.make_frames(frames), targets)
    return build.by_frame(found, found.errors_px, frames, VESSELS) / np.sqrt(np.diag(PLAIN["covariance"]))


def asked(component: int, lag: int) -> float:
    shares = [part[component] for part in MEMORY["shares"]]
    decays = [np.exp(-lag * STEP_S / time_s) for time_s in MEMORY["times_s"]]
    return float(MEMORY["vessel_share"][component] + np.dot(shares, decays))


@pytest.fixture(scope="module")
def errors() -> np.ndarray:
    return errors_of(PLAIN)


def test_each_component_correlates_with_itself_as_the_file_says(errors: np.ndarray) -> None:
    for component in range(4):
        for lag in (1, 5, 40):
            found = (errors[lag:, :, component] * errors[:-lag, :, component]).mean(axis=0)  # one mean of each vessel
            assert abs(found.mean() - asked(component, lag)) < 4 * found.std(ddof=1) / np.sqrt(VESSELS)
        one = (errors[..., component] ** 2).mean(axis=0)
        assert abs(one.mean() - 1) < 4 * one.std(ddof=1) / np.sqrt(VESSELS)
    np.testing.assert_array_equal(errors_of(PLAIN, 30), errors[:30], "how a run is split shows")


def test_large_errors_stay_as_long_as_the_fifth_number_says(errors: np.ndarray) -> None:
    """The normal number behind the scale of Student's t, which is the ratio to the normal errors of the same seed."""
    scale = (errors_of(HEAVY) / errors)[..., 0]
    number = special.ndtri(stats.chi2(3).cdf(1 / scale**2))
    for lag in (1, 5, 40):
        found = (number[lag:] * number[:-lag]).mean(axis=0)
        assert abs(found.mean() - asked(4, lag)) < 4 * found.std(ddof=1) / np.sqrt(VESSELS)


def test_honest_errors_obey_and_those_of_another_memory_are_named() -> None:
    many = ManyDetections.of_scene(load_scene("simulation_1", mode=2, steps=500, source="analytic"))
    memories = MEMORY, MEMORY | {"times_s": [0.1, 0.1]}
    asked_for, made_with = (parse_detector(variant("plain") | {"persistence": {"box": each}}) for each in memories)
    table = MomentTable()
    for seed in range(2):
        found = verify_evidence(asked_for, many.detect(asked_for, seed), table)
        assert found.obeys, (seed, [(verdict.parameter.name, verdict.p_value) for verdict in found.failed])
    wrong = verify_evidence(asked_for, many.detect(made_with, 0), table)
    assert any(verdict.parameter.name.startswith("persistence.box") for verdict in wrong.failed)
