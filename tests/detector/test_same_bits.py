"""Detections are the same to the last bit where the functions of libraries are not."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import special, stats

from modsim3d.core.boxes import inside_image, move
from modsim3d.core.random_streams import GRID, grid_normals, normals, on_grid
from modsim3d.detector.box_error import symmetric_root
from modsim3d.detector.file.reading import load_detector, parse_detector
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import CameraFrames, Detections, Targets
from tests.detector import detector_builders as build
from tests.detector.test_rich import RICH, rich_frames, rich_targets
from tests.detector_variants import CHANGES, variant

INEXACT = [
    *((special, name) for name in ("ndtri", "ndtr", "exp2", "xlogy", "log1p", "expit", "logit", "gammaincinv")),
    *((np, name) for name in ("exp", "exp2", "log", "log2", "power", "sin", "cos", "interp", "hypot")),
    *((math, name) for name in ("exp", "log")),
    *((np.linalg, name) for name in ("eigh", "cholesky", "inv")),
]
SMALL = [1800.0, 1195.0, 1808.0, 1205.0]


def with_other_last_bits(function: Any) -> Any:
    """The function, its results moved by up to two units in the last place to either side."""
    random = np.random.default_rng(0)

    def moved(*arguments: Any, **options: Any) -> Any:
        result = function(*arguments, **options)
        if isinstance(result, tuple):
            return tuple(part * (1 + random.integers(-2, 3, np.shape(part)) * 2.0**-53) for part in result)
        return result * (1 + random.integers(-2, 3, np.shape(result)) * 2.0**-53)

    return moved


@pytest.fixture
def other_processor(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    for module, name in INEXACT:
        monkeypatch.setattr(module, name, with_other_last_bits(getattr(module, name)))
    return monkeypatch


def many_kinds() -> dict[str, tuple[DetectorModel, CameraFrames, Targets]]:
    """Every model of a detector, over boxes of which many errors are drawn again."""
    frames, targets = (build.make_frames(150, sea=(0.02, 0.9998, -800.0)), build.steady_targets(150, 8, SMALL))
    thesis = {name: parse_detector(variant(name)) for name in CHANGES}
    small = {name: (model, frames, replace(targets, label=0 * targets.label)) for name, model in thesis.items()}
    return {**small, "rich": (load_detector(RICH), rich_frames(), rich_targets())}


KINDS = many_kinds()


@pytest.mark.parametrize("name", KINDS)
def test_the_last_bits_of_functions_do_not_reach_the_detections(name: str, other_processor: pytest.MonkeyPatch) -> None:
    model, frames, targets = KINDS[name]
    there = build.run(model, replace(frames, sea_half_planes=frames.sea_half_planes * (1 + 2.0**-50)), targets)
    other_processor.undo()
    here = build.run(model, frames, targets)
    assert len(here) > 200 and build.all_bytes(there) == build.all_bytes(here)


def test_drawn_normal_numbers_are_on_the_grid_and_half_a_step_from_the_exact_ones() -> None:
    uniforms = np.append(np.random.default_rng(1).random(100_000), [0, 2.0**-53, 1 - 2.0**-53])
    drawn = grid_normals(uniforms)
    assert np.array_equal(drawn / GRID, np.rint(drawn / GRID))
    assert np.abs(drawn - normals(uniforms)).max() <= GRID / 2


@pytest.mark.parametrize("step", [GRID, 2.0**-40, 1.0])
def test_on_grid_rounds_to_the_nearest_multiple(step: float) -> None:
    values = np.array([0.0, -0.0, 0.49, 0.51, -7.3, 1e6 + 0.7]) * step
    assert (on_grid(values, step) / step).tolist() == [0, 0, 0, 1, -7, 1e6 + 1]
    assert np.array_equal(on_grid(on_grid(values, step), step), on_grid(values, step))


def test_the_root_of_a_covariance_is_as_good_as_lapacks() -> None:
    random = np.random.default_rng(0)
    for rank in (1, 2, 3, 4) * 20:
        factor = random.standard_normal((4, rank)) * 10 ** random.uniform(-2, 2, (4, 1))
        root, std = symmetric_root(factor @ factor.T), np.linalg.norm(factor, axis=1)
        assert np.abs((root @ root - factor @ factor.T) / np.outer(std, std)).max() < 1e-12
        assert np.abs(root - root.T).max() <= 1e-12 * std.max()


def redrawn_errors() -> Detections:
    seen = {"confusion": build.ALL_SEEN, "false_discovery_rate": 0}
    model = parse_detector(build.one_state_data(**seen, box_error=build.box_error(build.MEAN_PX, build.COVARIANCE_PX2)))
    return build.run(model, build.make_frames(1500), build.steady_targets(1500, 10, build.centred(20, 20)))


def test_redrawn_errors_are_those_of_plain_rejection() -> None:
    found = redrawn_errors()
    errors, random = found.errors_px[found.redrawn], np.random.default_rng(5)
    plain = random.multivariate_normal(build.MEAN_PX, build.COVARIANCE_PX2, 200_000)
    plain = plain[inside_image(move(np.array(build.centred(20, 20)), plain), build.IMAGE_PX)]
    assert len(errors) > 5000
    for component in range(4):
        assert stats.ks_2samp(errors[:, component], plain[:, component]).pvalue > 1e-4
    spread = np.sqrt(np.diag(np.cov(plain.T)))
    ours, theirs = np.corrcoef(errors.T), np.corrcoef(plain.T)
    error = np.sqrt(1 / len(errors) + 1 / len(plain))  # of a mean in standard deviations, and at most of a correlation
    assert np.all(np.abs(errors.mean(axis=0) - plain.mean(axis=0)) < 4 * spread * error)
    assert np.all(np.abs(ours - theirs) < 4 * error)
