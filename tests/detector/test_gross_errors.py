"""Normal box errors some of which are gross: mean and covariance are the file's, and `verify` holds every number."""

from typing import Any

import numpy as np
import pytest
from scipy import stats

from modsim3d.core.errors import InputError
from modsim3d.detector.box_error import BoxErrorSource
from modsim3d.detector.chain import Detector
from modsim3d.detector.draws import ContaminatedNormal
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.records import Detections
from modsim3d.detector.target_statistics import TargetStatistics
from modsim3d.detector.truncation import truncated_errors
from modsim3d.scene.reading import load_scene
from modsim3d.verify.error_fit import MomentTable
from modsim3d.verify.error_parameters import ErrorParameters
from modsim3d.verify.evidence import ManyDetections
from modsim3d.verify.verification import verify_evidence
from tests.detector.detector_builders import (
    COVARIANCE_PX2,
    IMAGE_PX,
    MEAN_PX,
    centred,
    clock,
    make_frames,
    make_targets,
    one_state_data,
    same_boxes,
)
from tests.detector_variants import variant

SHARE, RATIO = 0.15, (6.0, 3.0, 6.0, 1.0)
SEEN = {"confusion": [[1, 0], [0, 1], [0, 0]], "false_discovery_rate": 0}
C = np.array(COVARIANCE_PX2, dtype=float)
STD = np.sqrt(np.diag(C))


def gross(**changes: Any) -> dict[str, Any]:
    error = {"law": "contaminated_normal", "gross_share": SHARE, "gross_ratio": list(RATIO), "unit": "px"}
    return error | {"mean": MEAN_PX, "covariance": COVARIANCE_PX2} | changes


def symmetric_root_of(matrix: np.ndarray) -> np.ndarray:
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.sqrt(values)) @ vectors.T)


def parts_of(share: float, ratio: np.ndarray, correlation: np.ndarray) -> list[tuple[float, np.ndarray]]:
    """Share and covariance, in standard deviations, of fine and of gross errors, from the page's formula."""
    fine = 1 / np.sqrt(1 - share + share * np.asarray(ratio) ** 2)
    root = symmetric_root_of(correlation)
    return [(1 - share, root @ np.diag(fine**2) @ root.T), (share, root @ np.diag((ratio * fine) ** 2) @ root.T)]


def drawn(box_px: list[float], frames: int = 4000, **sections: Any) -> Detections:
    model = parse_detector(one_state_data(**SEEN, box_error=gross()) | sections)
    return Detector(model, 1, TargetStatistics(), clock()).detect(
        make_frames(frames), make_targets(same_boxes(frames, 20, box_px))
    )


@pytest.mark.parametrize("persistence", [{}, {"box_s": 0.05}], ids=["independent", "persistent"])
def test_errors_have_the_mean_the_covariance_and_the_tails_of_the_file(persistence: dict[str, float]) -> None:
    found = drawn(centred(2400, 1800), persistence=persistence)
    assert found.redrawn.mean() < 1e-4
    errors, worth = found.errors_px, len(found.errors_px) / 1.4
    assert np.all(np.abs(errors.mean(axis=0) - MEAN_PX) < 4 * STD / np.sqrt(worth))
    np.testing.assert_allclose(np.cov(errors.T) / np.outer(STD, STD), C / np.outer(STD, STD), atol=4 * 3 / worth**0.5)
    parts = parts_of(SHARE, np.array(RATIO), C / np.outer(STD, STD))
    for j in range(4):
        sample = ((errors[:, j] - MEAN_PX[j]) / STD[j])[::1607]

        def law(x: np.ndarray, j: int = j) -> np.ndarray:
            return np.asarray(sum(share * stats.norm(scale=np.sqrt(part[j, j])).cdf(x) for share, part in parts))

        assert stats.kstest(sample, law).pvalue > 1e-4


@pytest.mark.parametrize("box_px", [centred(20, 20), [0, 1000, 60, 1040]])
def test_truncated_moments_are_those_of_what_the_detector_draws(box_px: list[float]) -> None:
    found = drawn(box_px, frames=2000)
    source = BoxErrorSource.from_model(parse_detector(one_state_data(**SEEN, box_error=gross())))
    asked = truncated_errors(source, 0, np.array([box_px]), IMAGE_PX)
    std = np.sqrt(np.diag(asked.covariances()[0]))
    assert np.all(np.abs(found.errors_px.mean(axis=0) - asked.means[0]) < 0.03 * std)
    assert np.all(np.abs(found.errors_px.std(axis=0) / std - 1) < 0.04)
    assert abs((1 - found.redrawn.mean()) - asked.accepted[0]) < 0.01


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gross_share": 0.6}, "gross_share: is 0.6, must be above 0 and at most 0.5"),
        ({"gross_share": 0}, "gross_share: is 0, must be above 0"),
        ({"gross_ratio": [1, 1, 1, 1]}, "gross_ratio: is 1, 1, 1, 1, must be above 0 and at most 200, and above 1 for"),
        ({"gross_ratio": [4, -1, 4, 1]}, "gross_ratio: is 4, -1, 4, 1, must be above 0"),
        ({"gross_ratio": [4]}, "gross_ratio: .*4"),
        ({"gross_ratio": None}, "law contaminated_normal needs gross_ratio"),
        ({"law": "normal"}, "law normal has no gross_ratio"),
    ],
)
def test_a_law_that_cannot_be_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_detector(one_state_data(box_error=gross(**changes)))


@pytest.mark.parametrize("parameter", range(19))
def test_scores_are_derivatives_of_the_density(parameter: int) -> None:
    law, h = ErrorParameters.of(parse_detector(one_state_data(box_error=gross())).states[0].box_error), 1e-5
    x = np.random.default_rng(8).standard_normal((20, 4)) * 1.5
    step = np.zeros(19)
    step[parameter] = h

    def log_density(moved: ErrorParameters) -> np.ndarray:
        assert isinstance(moved.distribution, ContaminatedNormal)
        scale = np.outer(moved.std / law.std, moved.std / law.std)
        numbers = moved.distribution.gross_share, np.array(moved.distribution.gross_ratio), moved.correlation
        laws = [
            share * stats.multivariate_normal((moved.mean - law.mean) / law.std, part * scale).pdf(x)
            for share, part in parts_of(*numbers)
        ]
        return np.asarray(np.log(laws[0] + laws[1]))

    slope = (log_density(law.moved(step)) - log_density(law.moved(-step))) / (2 * h)
    weights, _ = law.score_weights(np.array([[1800.0, 1200, 1840, 1212]]))
    found = law.statistics(x) @ weights[parameter]
    np.testing.assert_allclose(found - found[0], slope - slope[0], rtol=1e-4, atol=1e-4)


@pytest.fixture(scope="module")
def many() -> ManyDetections:
    return ManyDetections.of_scene(load_scene("simulation_1", mode=2, steps=500, source="analytic"))


def data(share: float = SHARE, ratio: tuple[float, ...] = RATIO, **sections: Any) -> dict[str, Any]:
    content = variant("plain") | sections
    for state in content["states"].values():
        state["box_error"].update(law="contaminated_normal", gross_share=share, gross_ratio=list(ratio))
    return content


def test_honest_seeds_obey_and_wrong_numbers_are_named(many: ManyDetections) -> None:
    model, table, z = parse_detector(data()), MomentTable(), []
    for seed in range(4):
        found = verify_evidence(model, many.detect(model, seed), table)
        assert found.obeys, (seed, [(verdict.parameter.name, verdict.p_value) for verdict in found.failed])
        of_law = (v.parameter.measure for v in found.verdicts if ".box_error." in v.parameter.name)
        z += [measure.z for measure in of_law if measure is not None]
    assert len(z) > 120
    assert abs(np.mean(z)) < 4 / np.sqrt(len(z))
    assert abs(np.std(z) - 1) < 4 / np.sqrt(2 * len(z))
    for changes, named in (({"share": 0.3}, "gross_share"), ({"ratio": (6.0, 8.0, 6.0, 1.0)}, "gross_ratio[e_y]")):
        wrong = verify_evidence(model, many.detect(parse_detector(data(**changes)), 1), table)
        assert any(f"box_error.{named}" in verdict.parameter.name for verdict in wrong.failed), named


def test_honest_errors_that_persist_obey(many: ManyDetections) -> None:
    model, measured = parse_detector(data(persistence={"box_s": 0.5})), []
    for seed in range(2):
        found = verify_evidence(model, many.detect(model, seed), MomentTable())
        assert found.obeys, (seed, [(verdict.parameter.name, verdict.p_value) for verdict in found.failed])
        measured += [v.measured for v in found.verdicts if v.parameter.name == "persistence.box_s"]
    assert np.mean(measured) == pytest.approx(np.exp(-0.2 / 0.5), abs=4 * 0.05 / np.sqrt(2))
