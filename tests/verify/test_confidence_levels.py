"""Levels of confidences in their own law are uniform, also where the law is cut off at the ends of the range."""

import numpy as np
import pytest
from scipy import stats

from modsim3d.detector.confidence import LEVELS, ConfidenceLaw, NormalScores, QuantileScores, drawn_levels

LAWS: dict[str, ConfidenceLaw] = {
    "normal": NormalScores(0.6, 0.3),
    "quantiles": QuantileScores(np.array([0.1, 0.3, 0.3, 0.7, 1.2])),
}
STEPS = QuantileScores(np.array([0.3, 0.3, 0.5, 0.8, 0.8]))


@pytest.mark.parametrize("name", LAWS)
def test_levels_are_uniform_and_those_of_the_draw(name: str) -> None:
    rng = np.random.default_rng(4)
    uniforms, shift = rng.random(4000), np.where(np.arange(4000) % 2, 0.05, 0.0)
    values = LAWS[name].at(uniforms) + shift
    confidence = np.clip(values, 0.2, 1)
    levels = LEVELS[name](LAWS[name], confidence, np.zeros(4000) + shift)
    assert levels is not None
    drawn = drawn_levels(levels, confidence, 0.2, rng)
    assert stats.kstest(drawn, "uniform").pvalue > 1e-3
    level = np.interp(values - shift, [0.3 - 1e-9, 0.3 + 1e-9], [0, 1])
    alone = (confidence > 0.2) & (confidence < 1) & ((name == "normal") | (level == 0) | (level == 1))
    assert 0.3 < alone.mean() < 0.95
    np.testing.assert_allclose(drawn[alone], uniforms[alone], atol=1e-5)
    assert np.abs(drawn[~alone] - uniforms[~alone]).max() > 0.01


def test_a_law_of_one_value_has_no_levels() -> None:
    ends = np.array([0.4, 0.4])
    assert LEVELS["normal"](NormalScores(0.4, 0.0), ends, np.zeros(2)) is None
    assert LEVELS["quantiles"](QuantileScores(ends), ends, np.zeros(2)) is None


def test_a_step_of_a_law_has_all_its_levels() -> None:
    values = np.array([0.3, 0.4, 0.5, 0.65, 0.8])
    for shift in np.tile(np.linspace(0, 0.1, 8)[:, None], 5):
        levels = LEVELS["quantiles"](STEPS, values + shift, shift)
        assert levels is not None
        np.testing.assert_allclose(levels[0], [0, 0.375, 0.5, 0.625, 0.75], atol=1e-7)
        np.testing.assert_allclose(levels[1], [0.25, 0.375, 0.5, 0.625, 1], atol=1e-7)
