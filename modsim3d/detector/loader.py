"""Detector files in, detector models out; everything that is wrong is said at once."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from modsim3d.detector.model import DetectorModel, PerformanceState, read_only
from modsim3d.detector.records import Array
from modsim3d.detector.schema import DetectorFile, StateSection
from modsim3d.errors import InputError
from modsim3d.validation import describe, load_yaml


def load_detector(path: Path | str) -> DetectorModel:
    """The detector that a YAML file describes.

    Raises:
        InputError: The file cannot be read, or something in it is wrong.
    """
    return parse_detector(load_yaml(Path(path), "detector"), f"detector {path}")


def parse_detector(data: Any, source: str = "detector") -> DetectorModel:
    """The detector that a mapping with the keys of a detector file describes.

    Args:
        data: What the file holds.
        source: What to call it in messages.

    Raises:
        InputError: Something is wrong; every problem has its own line with its path.
    """
    if not isinstance(data, Mapping):
        keys = ", ".join(DetectorFile.model_fields)
        raise InputError(source, [f"must be a mapping with the keys {keys} (got {str(data)[:80]!r})"])
    try:
        content = DetectorFile.model_validate(dict(data), context=_names(data))
    except ValidationError as error:
        raise InputError(source, describe(error, DetectorFile)) from None
    return _model(content)


def _names(data: Mapping[str, Any]) -> dict[str, list[str]]:
    """The labels and states that shapes are checked against, as far as they can be made out."""
    labels, states = data.get("labels"), data.get("states")
    return {
        "labels": [str(label) for label in labels] if isinstance(labels, list) else [],
        "states": [str(name) for name in states] if isinstance(states, Mapping) else [],
    }


def _normalised(columns: Any) -> Array:
    """Columns that sum to one but for the digits a file leaves off, made to do so."""
    array = np.array(columns, dtype=np.float64)
    return read_only(array / array.sum(axis=0))


def _model(content: DetectorFile) -> DetectorModel:
    return DetectorModel(
        labels=tuple(content.labels),
        confidence_threshold=content.confidence_threshold,
        initial_state=list(content.states).index(content.initial_state),
        transition_matrix=_normalised(content.transition_matrix),
        states=tuple(_state(name, section) for name, section in content.states.items()),
        transition_interval_s=content.transition_interval_s,
        false_positives=content.false_positives.model,
    )


def _state(name: str, section: StateSection) -> PerformanceState:
    covariance = np.array(section.box_error.covariance, dtype=np.float64)
    return PerformanceState(
        name=name,
        confusion=_normalised(section.confusion),
        false_positive_labels=_normalised(section.false_positive_labels),
        false_discovery_rate=section.false_discovery_rate,
        box_error_mean_px=read_only(section.box_error.mean),
        box_error_covariance_px2=read_only((covariance + covariance.T) / 2),
        confidence_mean=section.confidence.mean,
        confidence_std=section.confidence.std,
    )
