"""Confidence: mean and standard deviation before clipping, from clipped numbers."""

from __future__ import annotations

import numpy as np
from scipy import special

from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import Array
from modsim3d.learn.evidence import Evidence
from modsim3d.learn.measures import Estimate, Exact, Measure
from modsim3d.learn.parameters import Parameter

GROUP = "confidence"
LEAST_DETECTIONS = 50
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(400)
_REACH = 9.0  # standard deviations that the integrals go to
_FAR, _STEPS = 3.0, 8  # an estimate farther off than this is refined by so many Newton steps


def confidence_checks(model: DetectorModel, evidence: Evidence) -> list[Parameter]:
    """Mean and standard deviation of every state, true and false detections together."""
    state_of_hits = evidence.chances.state[evidence.hits.chance]
    parameters = []
    outside = 0
    for s, state in enumerate(model.states):
        scores = np.concatenate(
            [evidence.hits.confidence[state_of_hits == s], evidence.clutter.confidence[evidence.clutter.state == s]]
        )
        outside += int(((scores < model.confidence_threshold) | (scores > 1)).sum())
        asked = (state.confidence_mean, state.confidence_std)
        measures = clipped_normal(scores, *asked, model.confidence_threshold)
        for name, value, measure in zip(("mean", "std"), asked, measures, strict=True):
            parameters.append(
                Parameter(f"states.{state.name}.confidence.{name}", GROUP, measure, value, state=state.name)
            )
    count = len(evidence.hits.confidence) + len(evidence.clutter.confidence)
    return [*parameters, Parameter("confidence_threshold", GROUP, Exact(outside, count))]


def clipped_normal(scores: Array, mean: float, std: float, threshold: float) -> tuple[Measure | None, Measure | None]:
    """Mean and standard deviation of normal numbers of which those outside [threshold, 1] were moved to its ends.

    One step from the asked values towards the largest likelihood, which also is the test (the score test of each with
    the other free); of an estimate that is far off, as many steps as it takes.
    """
    if len(scores) < LEAST_DETECTIONS:
        return None, None
    if std == 0:
        wrong = int((np.abs(scores - np.clip(mean, threshold, 1)) > 1e-12).sum())
        return Exact(wrong, len(scores), asked=0.0), None
    information, third = clipped_information(mean, std, threshold)
    if np.linalg.cond(information) > 1e10:  # all of them at one end: nothing to be learned
        return None, None
    covariance = np.linalg.inv(information) / len(scores)
    step = covariance @ clipped_score(scores, mean, std, threshold).sum(axis=0)
    errors = np.sqrt(np.diag(covariance))
    z = step / errors
    # Of the sum of n influences the third cumulant is n times that of one.
    skewness = third / len(scores) ** 2 / errors**3
    value = _fitted(scores, mean, std, threshold) if np.abs(z).max() > _FAR else np.array([mean, std]) + step
    count = len(scores)
    return (
        Estimate(value[0], mean, errors[0], count, skewness[0], z[0]),
        Estimate(value[1], std, errors[1], count, skewness[1], z[1], grows=True),
    )


def _fitted(scores: Array, mean: float, std: float, threshold: float) -> Array:
    value = np.array([mean, std])
    for _ in range(_STEPS):
        information, _ = clipped_information(value[0], value[1], threshold)
        step = np.linalg.solve(information, clipped_score(scores, value[0], value[1], threshold).mean(axis=0))
        value = np.array([value[0] + np.clip(step[0], -value[1], value[1]), value[1] * np.exp(step[1] / value[1])])
    return value


def clipped_score(scores: Array, mean: float, std: float, threshold: float) -> Array:
    """Derivatives of the log-likelihood by mean and standard deviation, shape (n, 2) (Tobin (1958))."""
    z = (scores - mean) / std
    low, high = (threshold - mean) / std, (1 - mean) / std
    inner = np.stack([z, z**2 - 1], axis=-1)
    below = -_hazard(-low) * np.array([1.0, low])
    above = _hazard(high) * np.array([1.0, high])
    result: Array = np.where((scores <= threshold)[:, None], below, np.where((scores >= 1)[:, None], above, inner))
    return result / std


def _hazard(z: float) -> float:
    """Normal density over the tail above z."""
    return float(np.exp(-(z**2) / 2 - special.log_ndtr(-z)) / np.sqrt(2 * np.pi))


def clipped_information(mean: float, std: float, threshold: float) -> tuple[Array, Array]:
    """Fisher information of one number, shape (2, 2), and the third cumulants of both influences, shape (2,)."""
    low, high = max((threshold - mean) / std, -_REACH), min((1 - mean) / std, _REACH)
    nodes, weights = np.zeros(0), np.zeros(0)
    if high > low:
        nodes = (low + high) / 2 + (high - low) / 2 * _NODES
        weights = (high - low) / 2 * _WEIGHTS * np.exp(-(nodes**2) / 2) / np.sqrt(2 * np.pi)
    places = np.concatenate([[threshold], np.clip(mean + std * nodes, threshold + 1e-15, 1 - 1e-15), [1.0]])
    chances = np.concatenate([[special.ndtr((threshold - mean) / std)], weights, [special.ndtr(-(1 - mean) / std)]])
    score = clipped_score(places, mean, std, threshold)
    score = np.where((chances > 0)[:, None], score, 0)
    information = np.einsum("n,ni,nj->ij", chances, score, score)
    influence = score @ np.linalg.pinv(information)
    return information, chances @ influence**3
