"""Contradictions between the sections of a detector file, each of which is valid by itself."""

from __future__ import annotations

from modsim3d.detector.clutter_models import CLUTTER_MODELS
from modsim3d.detector.dropout import ATTRIBUTES
from modsim3d.detector.file.schema import DetectorFile, StateSection
from modsim3d.detector.file.schema_models import EffectsSection

RATE_TOLERANCE = 0.01
"""Greatest difference between the end of a precision-recall curve and the rates of its state."""


def agreement_problems(file: DetectorFile) -> list[str]:
    """One line for each contradiction, with its path."""
    problems = _clutter_problems(file) + _dropout_problems(file)
    least, asked = file.confidence_threshold, file.operating_threshold
    if asked is not None and asked < least:
        problems.append(f"operating_threshold: is {asked:g}, must be at least {least:g}, the confidence_threshold")
    for name, state in file.states.items():
        path = f"states.{name}"
        problems += _extra_problems(path, state, file) + _curve_problems(path, state, file)
    return problems


def _dropout_problems(file: DetectorFile) -> list[str]:
    """The effects of states are of the shared model, which has effects at all."""
    model = file.dropout.model
    if model != "confusion" and not any(each.effects() for each in (file.dropout, *_own_dropout(file).values())):
        return [f"dropout: model {model} needs at least one of {', '.join(ATTRIBUTES)}"]
    misfits = {name: own.misfit(model) for name, own in _own_dropout(file).items()}
    return [f"states.{name}.dropout: {misfit} (dropout.model)" for name, misfit in misfits.items() if misfit]


def _own_dropout(file: DetectorFile) -> dict[str, EffectsSection]:
    return {name: state.dropout for name, state in file.states.items()}


def _clutter_problems(file: DetectorFile) -> list[str]:
    keys = file.false_positives
    problems = []
    if CLUTTER_MODELS[keys.model].side_px is not None:
        own = ("placement", "far_half_px", "size", "persistence")
        given = [key for key in own if key in keys.model_fields_set]
        problems += [
            f"false_positives.{key}: model {keys.model} has its own: choose calibrated or per_image" for key in given
        ]
    problems += _rate_problems(file)
    if (keys.band_px is None) != (keys.placement != "horizon_band"):
        problems.append("false_positives.band_px: goes with placement horizon_band, and only there")
    if (keys.density is None) != (keys.placement != "density"):
        problems.append("false_positives.density: goes with placement density, and only there")
    if keys.placement == "density" and keys.far_half_px is not None:
        problems.append("false_positives.far_half_px: the density map already says where they are")
    if keys.duplicates + keys.splits > 1:
        problems.append("false_positives: duplicates and splits together exceed 1, and no detection is both")
    return problems


def _rate_problems(file: DetectorFile) -> list[str]:
    """The rate is where the model looks for it; one of each image is nowhere else."""
    keys = file.false_positives
    given = {name: state.false_positives_per_image is not None for name, state in file.states.items()}
    if CLUTTER_MODELS[keys.model].rate_key == "false_positives_per_image":
        if keys.rate is not None or all(given.values()):
            return []
        missing = ", ".join(name for name, there in given.items() if not there)
        return [
            f"false_positives.rate: model {keys.model} needs it, or false_positives_per_image in each state (missing "
            f"in {missing})"
        ]
    unused = [] if keys.rate is None else ["false_positives.rate"]
    unused += [f"states.{name}.false_positives_per_image" for name, there in given.items() if there]
    works = "set false_discovery_rate of the states, or choose per_image"
    return [f"{path}: model {keys.model} has none: {works}" for path in unused] + [
        f"states.{name}.false_discovery_rate: missing: model {keys.model} reads it"
        for name, state in file.states.items()
        if state.false_discovery_rate is None
    ]


def _extra_problems(path: str, state: StateSection, file: DetectorFile) -> list[str]:
    """Second boxes are false positives too, so the false discovery rate must leave room for them."""
    keys = file.false_positives
    rate, extra = state.false_discovery_rate, keys.duplicates + keys.splits
    if rate is None or not CLUTTER_MODELS[keys.model].counts_second_boxes or rate / (1 - rate) >= extra - 1e-12:
        return []
    return [
        f"{path}.false_discovery_rate: {rate:g} leaves room for {rate / (1 - rate):.3g} false detections for each true "
        f"one, but false_positives.duplicates and splits alone may make {extra:g}: lower them, or choose per_image"
    ]


def _curve_problems(path: str, state: StateSection, file: DetectorFile) -> list[str]:
    """A curve must end at the recall and the precision that the state has."""
    curve = state.confidence.precision_recall
    if curve is None:
        return []
    recall, precision = curve[-1]
    found = [1 - rate for rate in state.confusion[-1]]
    problems = []
    if not min(found) - RATE_TOLERANCE <= recall <= max(found) + RATE_TOLERANCE:
        problems.append(
            f"{path}.confidence.precision_recall: ends at recall {recall:g}, but the confusion matrix detects "
            + " to ".join(f"{rate:g}" for rate in dict.fromkeys((min(found), max(found))))
            + " of the vessels: a curve ends at the recall that the detector has"
        )
    rate = state.false_discovery_rate if CLUTTER_MODELS[file.false_positives.model].counts_second_boxes else None
    if rate is not None and abs(precision - (1 - rate)) > RATE_TOLERANCE:
        problems.append(
            f"{path}.confidence.precision_recall: ends at precision {precision:g}, but false_discovery_rate {rate:g} "
            f"makes it {1 - rate:g}"
        )
    return problems
