"""Detections are the same to the last bit where the functions of libraries are not, and those of the plain chain,
without any of the models that a detector file may add, stay what they were."""

import hashlib
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import special, stats

import modsim3d
from modsim3d.core.boxes import inside_image, move
from modsim3d.core.random_streams import GRID, grid_normals, normals, on_grid
from modsim3d.detector.box_error import symmetric_root
from modsim3d.detector.file.reading import load_detector, parse_detector
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import CameraFrames, Targets
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
    frames, targets = build.make_frames(150, sea=(0.02, 0.9998, -800.0)), build.steady_targets(150, 8, SMALL)
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
    for step in (GRID, 2.0**-40, 1.0):
        values = on_grid(np.array([0.0, -0.0, 0.49, 0.51, -7.3, 1e6 + 0.7]) * step, step)
        assert (values / step).tolist() == [0, 0, 0, 1, -7, 1e6 + 1], "rounded to the nearest multiple"
        assert np.array_equal(on_grid(values, step), values)


def test_the_root_of_a_covariance_is_as_good_as_lapacks() -> None:
    random = np.random.default_rng(0)
    for rank in (1, 2, 3, 4) * 20:
        factor = random.standard_normal((4, rank)) * 10 ** random.uniform(-2, 2, (4, 1))
        root, std = symmetric_root(factor @ factor.T), np.linalg.norm(factor, axis=1)
        assert np.abs((root @ root - factor @ factor.T) / np.outer(std, std)).max() < 1e-12
        assert np.abs(root - root.T).max() <= 1e-12 * std.max()


def test_redrawn_errors_are_those_of_plain_rejection() -> None:
    error, box_px = build.box_error(build.MEAN_PX, build.COVARIANCE_PX2), build.centred(20, 20)
    data = build.one_state_data(confusion=build.ALL_SEEN, false_discovery_rate=0, box_error=error)
    found = build.run(data, build.make_frames(1500), build.steady_targets(1500, 10, box_px))
    errors, random = found.errors_px[found.redrawn], np.random.default_rng(5)
    plain = random.multivariate_normal(build.MEAN_PX, build.COVARIANCE_PX2, 200_000)
    plain = plain[inside_image(move(np.array(box_px), plain), build.IMAGE_PX)]
    assert len(errors) > 5000
    for component in range(4):
        assert stats.ks_2samp(errors[:, component], plain[:, component]).pvalue > 1e-4
    error = 4 * np.sqrt(1 / len(errors) + 1 / len(plain))  # of a mean in deviations, and at most of a correlation
    assert np.all(np.abs(errors.mean(axis=0) - plain.mean(axis=0)) < np.std(plain, axis=0, ddof=1) * error)
    assert np.all(np.abs(np.corrcoef(errors.T) - np.corrcoef(plain.T)) < error)


def digest(*columns: np.ndarray) -> str:
    """Of seven digits of each number: more would hash the rounding of the machine's sine."""
    text = "\n".join(f"{value:.6e}" for column in columns for value in np.asarray(column, dtype=float).ravel())
    return hashlib.sha256(text.encode()).hexdigest()


# Digests of these tests, from the chain as it was when false positives got sides of their own parts of a pixel.
def test_simulation_1_is_detected_as_it_was() -> None:
    scene = modsim3d.load_scene("simulation_1", steps=300, source="analytic")
    found = [frame.detections for frame in modsim3d.simulate_frames(scene)]
    columns = [column for each in found for column in (each.boxes_px, each.confidence, each.errors_px)]
    assert sum(len(column) for column in columns) > 3000
    assert digest(*columns) == "72ded7f86c419a7370ebae5b39baf0daf7f273d8715fb55415d2c26dfcce6d23"


def test_three_labels_are_detected_as_they_were() -> None:
    random = np.random.default_rng(7)
    corners = np.sort(random.uniform(0, 1, (400, 6, 2, 2)) * [3600, 2400], axis=2)
    boxes = np.concatenate([corners[:, :, 0], corners[:, :, 1]], axis=-1)
    boxes[random.random((400, 6)) < 1 / 4] = np.nan
    model = load_detector(RICH.with_name("three_labels.yaml"))
    found = build.run(model, build.make_frames(400), build.make_targets(boxes, np.arange(6) % 3), seed=11)
    columns = (found.states, found.frame, found.target, found.kind, found.label)
    columns += (found.boxes_px, found.confidence, found.errors_px, found.redrawn)
    assert digest(*columns) == "e6fbb59940cd836b958449d76a2eacb6aaa9d673d775172c697ba6be32e63c7c"
