"""A guess of how a detector performs in another condition, from how another detector changed between two conditions."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.core.arrays import Array
from modsim3d.core.errors import InputError
from modsim3d.core.paths import StrPath, out_file
from modsim3d.core.written_files import OutputFiles
from modsim3d.detector.confidence import ConfidenceLaw, NormalScores, QuantileScores
from modsim3d.detector.file.reading import detector_text, find_detector, load_detector, parse_detector
from modsim3d.detector.file.schema import with_covariance
from modsim3d.detector.model import DetectorModel
from modsim3d.io.atomic_write import write_files
from modsim3d.io.overwrite_guard import claimed
from modsim3d.io.strict_text import load_yaml
from modsim3d.io.validation import find_condition
from modsim3d.learn.bootstrap import columns_of_one, digits, nested

STRANGE_SPREAD = 4.0
"""Box errors of the thesis's conditions on the same images differ by factors of 3.4 at most."""


@dataclass(frozen=True, eq=False)
class ConditionChange:
    """Change of a detector from one condition to another."""

    miss_odds: float  # ratio of the odds of a miss
    false_odds: float  # ratio of the odds that a detection is false
    false_per_image: float  # ratio of the numbers of false positives per image, over the same vessels
    spread: Array  # ratios of the standard deviations of e_x, e_y, e_w, e_h, shape (4,)
    confidence: tuple[float, float]  # differences of the log-odds of mean confidence, of true and false positives

    @classmethod
    def between(cls, before: tuple[str, DetectorModel], after: tuple[str, DetectorModel]) -> ConditionChange:
        """Change between names and detectors of one label and state. Raises InputError if a rate has no ratio."""
        for name, model in (before, after):
            _check_condition(name, model)
        first, second = before[1].states[0], after[1].states[0]
        if first.box_error.unit != second.box_error.unit:
            problem = f"its box errors are in {second.box_error.unit}, and those of {before[0]} {first.box_error.unit}"
            raise InputError(f"condition {after[0]}", [problem])
        recall, now_recall = (1 - float(state.confusion[-1, 0]) for state in (first, second))
        false_odds = _odds(second.false_discovery_rate) / _odds(first.false_discovery_rate)
        variances = np.diag(second.box_error.covariance) / np.diag(first.box_error.covariance)
        pairs = ((second.confidence.true, first.confidence.true), (second.confidence.false, first.confidence.false))
        true, false = (_log_odds(_mean(now)) - _log_odds(_mean(then)) for now, then in pairs)
        return cls(
            miss_odds=_odds(1 - now_recall) / _odds(1 - recall),
            false_odds=false_odds,
            false_per_image=false_odds * now_recall / recall,
            spread=np.sqrt(variances),
            confidence=(true, false),
        )


@dataclass(frozen=True, repr=False, kw_only=True)
class GuessedDetector(OutputFiles):
    """A detector file that was guessed, from `guess_detector`, with the keys of both and the change."""

    before: dict[str, Any]
    after: dict[str, Any]
    change: ConditionChange


def guess_detector(
    detector: StrPath, out: StrPath, *, from_condition: str, to_condition: str, overwrite: bool = False
) -> GuessedDetector:
    """Guess a detector in another condition: it changes as much as another detector did between two conditions.

        modsim3d.guess_detector("vessel", "foggy.yaml", from_condition="day", to_condition="fog")

    Args:
        detector, out: Detector file or shipped name; detector file to write.
        from_condition, to_condition: Condition that it shows and that is wanted: shipped names or detector files.
        overwrite: Replace a file that is there.

    Raises:
        ModsimError: A detector or a condition is wrong, no ratio can be taken of them, or the file cannot be written.
        TypeError: A path is neither text nor a path.
    """
    names = (from_condition, to_condition)
    files = [Path(name) if Path(name).is_file() else find_condition(name) for name in names]
    file, path = find_detector(detector), out_file(out, Path("detector.yaml"))
    with claimed([path], overwrite=overwrite, inputs=[file, *files]):
        change = ConditionChange.between(*zip(names, map(load_detector, files), strict=True))
        before = load_yaml(file, "detector")
        after = guessed(before, change, f"detector {file}")
        write_files({path: detector_text(after, _comments(file, from_condition, to_condition, change))})
    notes = [_guess(file, from_condition, to_condition)]
    if any(not 1 / STRANGE_SPREAD < ratio < STRANGE_SPREAD for ratio in change.spread):
        notes.append(
            "the box errors of the two conditions differ by more than a factor of four. If they were measured on "
            "different images, this is not the effect of the condition"
        )
    return GuessedDetector((path,), tuple(notes), before=before, after=after, change=change)


def _guess(detector: Path, from_condition: str, to_condition: str) -> str:
    return (
        f"A guess, not a measurement: {detector.name} in {to_condition}, if it changes from {from_condition} as much "
        "as the detector of those two conditions did."
    )


def _comments(detector: Path, from_condition: str, to_condition: str, change: ConditionChange) -> list[str]:
    """Comments that a reader of the file needs."""
    spread = ", ".join(f"{ratio:.3g}" for ratio in change.spread)
    changes = (
        f"Multiplied: odds of a miss by {change.miss_odds:.3g}, odds that a detection is false by "
        f"{change.false_odds:.3g}, false positives per image by {change.false_per_image:.3g}, standard deviations of "
        f"e_x, e_y, e_w, e_h by {spread}. Added to the log-odds of confidence: {change.confidence[0]:.3g} (true), "
        f"{change.confidence[1]:.3g} (false)."
    )
    texts = (f"Written by modsim3d learn --from-condition. {_guess(detector, from_condition, to_condition)}", changes)
    return [line for text in texts for line in textwrap.wrap(text, 110)]


def guessed(content: Mapping[str, Any], change: ConditionChange, source: str = "detector") -> dict[str, Any]:
    """The content of a detector file after a change of condition, with every state changed by it. The odds p/(1 − p) of
    probabilities are multiplied, so that they stay below 1, as are standard deviations of box errors. Shares of classes
    detected, means and correlations of errors, and all else stay. Confidence is shifted by its log-odds. Raises
    InputError, with `source`, if the detector is wrong before or after, or its confidence cannot be shifted."""
    parse_detector(content, source)
    states = {name: _state(state, change, f"{source}: states.{name}") for name, state in content["states"].items()}
    result = {**content, "states": states}
    section = content.get("false_positives") or {}
    if section.get("rate") is not None:
        result["false_positives"] = {**section, "rate": digits(section["rate"] * change.false_per_image)}
    parse_detector(result, f"{source}, changed")
    return result


def _check_condition(name: str, model: DetectorModel) -> None:
    if len(model.states) != 1 or len(model.labels) != 1:
        count = f"{len(model.states)} states and {len(model.labels)} labels"
        raise InputError(f"condition {name}", [f"a condition is a detector with one state and one label (got {count})"])
    state = model.states[0]
    numbers = {
        "probability of a miss": state.confusion[-1, 0],
        "false_discovery_rate": state.false_discovery_rate,
        "mean confidence of true detections": _mean(state.confidence.true),
        "mean confidence of false positives": _mean(state.confidence.false),
    }
    problems = [
        f"its {what} is {value:g}: a ratio needs one between 0 and 1"
        for what, value in numbers.items()
        if not 0 < value < 1
    ]
    if not np.all(np.diag(state.box_error.covariance) > 0):
        problems.append("the variance of one of its box errors is 0: no ratio can be taken of it")
    if problems:
        raise InputError(f"condition {name}", problems)


def _state(state: Mapping[str, Any], change: ConditionChange, where: str) -> dict[str, Any]:
    confusion = np.array(state["confusion"], dtype=np.float64)
    missed = _with_odds(confusion[-1], change.miss_odds)
    factor = np.where(confusion[-1] < 1, (1 - missed) / np.maximum(1 - confusion[-1], np.finfo(float).tiny), 0)
    result = {
        **state,
        "confusion": columns_of_one(np.vstack([confusion[:-1] * factor, missed])),
        "box_error": _box_error(state["box_error"], change.spread),
        "confidence": _confidence(state["confidence"], change.confidence, where),
    }
    if state.get("false_discovery_rate") is not None:
        result["false_discovery_rate"] = digits(_with_odds(state["false_discovery_rate"], change.false_odds))
    if state.get("false_positives_per_image") is not None:
        result["false_positives_per_image"] = digits(state["false_positives_per_image"] * change.false_per_image)
    return result


def _box_error(section: Mapping[str, Any], spread: Array) -> dict[str, Any]:
    """A section of box errors with other standard deviations, and with its mean and correlations."""
    section = with_covariance(section)
    covariance = np.array(section["covariance"], dtype=np.float64) * np.outer(spread, spread)
    result = {**section, "covariance": [[float(f"{value:.10g}") for value in row] for row in covariance]}
    if section.get("growth") is not None:
        result["growth"] = nested(np.array(section["growth"], dtype=np.float64) * spread)
    return result


def _confidence(section: Mapping[str, Any], shift: tuple[float, float], where: str) -> dict[Any, Any]:
    """A section of confidence, shifted; `shift` is that of true detections and of false positives."""
    if section.get("precision_recall") is not None:
        problem = "a precision-recall curve cannot be shifted: give mean and std, or true and false"
        raise InputError(where, [f"confidence: {problem}"])
    true, false = shift
    if "mean" in section:
        return _shifted(section, true, where)
    shifts = {"true": true, True: true, "false": false, False: false}
    return {key: _shifted(part, shifts[key], where) if key in shifts else part for key, part in section.items()}


def _shifted(section: Mapping[Any, Any], shift: float, where: str) -> dict[Any, Any]:
    if not shift:
        return dict(section)
    if section.get("quantiles") is not None:
        return {**section, "quantiles": nested(_with_odds(section["quantiles"], np.exp(shift)))}
    if not 0 < section["mean"] < 1:
        problem = f"confidence: its mean is {section['mean']:g}: only one between 0 and 1 can be shifted"
        raise InputError(where, [problem])
    return {**section, "mean": digits(_with_odds(section["mean"], np.exp(shift)))}


def _mean(scores: ConfidenceLaw) -> float:
    if isinstance(scores, NormalScores):
        return scores.mean
    if not isinstance(scores, QuantileScores):
        raise TypeError(f"no mean is known of {type(scores).__name__}")
    return float(np.mean((scores.quantiles[1:] + scores.quantiles[:-1]) / 2))


def _odds(probability: float) -> float:
    return probability / (1 - probability)


def _log_odds(probability: float) -> float:
    return float(np.log(_odds(probability)))


def _with_odds(probability: Any, ratio: float) -> Array:
    """Probabilities of any shape with their odds multiplied: r·p / (1 − p + r·p)."""
    values = np.array(probability, dtype=np.float64)
    return ratio * values / (1 - values + ratio * values)
