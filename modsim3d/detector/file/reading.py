"""Reads detector files into detector models; reports all problems at once."""

from __future__ import annotations

import math
import pickle
from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from pydantic import ValidationError

from modsim3d.arrays import Array, read_only
from modsim3d.detector.box_error_law import ERROR_DISTRIBUTIONS, BoxErrorLaw
from modsim3d.detector.clutter import ClutterOptions, FixedSize, LognormalSize, Sizes
from modsim3d.detector.confidence import NormalScores, PrecisionRecall, QuantileScores, Scores, StateConfidence
from modsim3d.detector.dropout import Dropout, Effect, Slope, Table
from modsim3d.detector.file.agreement import agreement_problems
from modsim3d.detector.file.finding import find_detector
from modsim3d.detector.file.schema import BoxErrorSection, DetectorFile, FalsePositivesSection, StateSection
from modsim3d.detector.file.schema_models import (
    ConfidenceKeys,
    EffectsSection,
    PerformanceSection,
    ScoreSection,
    SizeSection,
)
from modsim3d.detector.gates import Gates
from modsim3d.detector.merges_and_splits import MergesAndSplits
from modsim3d.detector.model import DetectorModel, PerformanceState
from modsim3d.detector.performance import Performance
from modsim3d.detector.persistence import Persistence
from modsim3d.detector.placement import Placement
from modsim3d.errors import InputError
from modsim3d.inputs.strict_yaml import load_yaml
from modsim3d.inputs.validation import describe, kind_of
from modsim3d.paths import StrPath


def load_detector(path: StrPath) -> DetectorModel:
    """Read and validate a detector file.

        detector = modsim3d.load_detector("my/detector.yaml")
        detector = modsim3d.load_detector("conditions/foggy_cloudy")

    Args:
        path: A detector file, or the name of a shipped detector.

    Raises:
        InputError: The file cannot be read, or something in it is wrong; every problem has its own line.
        TypeError: It is neither text nor a path.
    """
    path = find_detector(path)
    return parse_detector(load_yaml(path, "detector"), f"detector {path}")


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
        raise InputError(source, [f"must be a mapping with the keys {keys} (got {kind_of(data)})"])
    try:
        content = DetectorFile.model_validate(dict(data), context=_names(data))
    except ValidationError as error:
        raise InputError(source, describe(error, DetectorFile)) from None
    problems = agreement_problems(content)
    if problems:
        raise InputError(source, problems)
    model = _model(content)
    _CONTENTS[model] = pickle.dumps(dict(data))
    return model


_CONTENTS: WeakKeyDictionary[DetectorModel, bytes] = WeakKeyDictionary()
"""What each model was read from, pickled, since callers change it: that takes a tenth of the time of a deep copy."""


def content_of(model: DetectorModel) -> dict[str, Any] | None:
    """The content of a file that gives this detector; None for one that was made or changed in another way."""
    content = _CONTENTS.get(model)
    if content is None:
        return None
    loaded: dict[str, Any] = pickle.loads(content)
    return loaded


def file_of(model: DetectorModel) -> DetectorFile | None:
    """The validated file that gives this detector, see `content_of`."""
    content = content_of(model)
    return None if content is None else DetectorFile.model_validate(content, context=_names(content))


def _names(data: Mapping[str, Any]) -> dict[str, list[str]]:
    """The labels and states that shapes are checked against, as far as they can be made out."""
    labels, states = data.get("labels"), data.get("states")
    return {
        "labels": [str(label) for label in labels] if isinstance(labels, list) else [],
        "states": [str(name) for name in states] if isinstance(states, Mapping) else [],
    }


def _normalised(columns: Any) -> Array:
    """Columns that sum to one but for rounding, made to sum to one exactly."""
    array = np.array(columns, dtype=np.float64)
    return read_only(array / array.sum(axis=0))


def _model(content: DetectorFile) -> DetectorModel:
    return DetectorModel(
        labels=tuple(content.labels),
        confidence_threshold=content.confidence_threshold,
        operating_threshold=content.operating_threshold,
        initial_state=list(content.states).index(content.initial_state),
        transition_matrix=_normalised(content.transition_matrix),
        states=tuple(_state(name, section, content) for name, section in content.states.items()),
        transition_interval_s=content.transition_interval_s,
        dropout=_dropout(content),
        gates=Gates(**content.gates.model_dump()),
        persistence=Persistence(**content.persistence.model_dump()),
        clutter=_clutter(content.false_positives),
        merges_and_splits=MergesAndSplits(
            **{field.name: getattr(content.false_positives, field.name) for field in fields(MergesAndSplits)}
        ),
        performance=_performance(content.performance, list(content.states)),
    )


def _state(name: str, section: StateSection, content: DetectorFile) -> PerformanceState:
    per_image = section.false_positives_per_image
    return PerformanceState(
        name=name,
        confusion=_normalised(section.confusion),
        false_positive_labels=_normalised(section.false_positive_labels),
        false_discovery_rate=math.nan if section.false_discovery_rate is None else section.false_discovery_rate,
        box_error=_box_error(section.box_error),
        confidence=_confidence(section.confidence, content.confidence_threshold),
        false_positives_per_image=(content.false_positives.rate or 0.0) if per_image is None else per_image,
    )


def _box_error(section: BoxErrorSection) -> BoxErrorLaw:
    covariance, distribution = np.array(section.covariance, dtype=np.float64), ERROR_DISTRIBUTIONS[section.law]
    return BoxErrorLaw(
        mean=read_only(section.mean),
        covariance=read_only((covariance + covariance.T) / 2),
        unit=section.unit,
        growth=read_only(section.growth or np.zeros(4)),
        distribution=distribution(**{key: getattr(section, key) for key in distribution.keys}),
    )


def _confidence(keys: ConfidenceKeys, threshold: float) -> StateConfidence:
    true: Scores
    false: Scores
    if keys.precision_recall is not None:
        true, false = PrecisionRecall.through(keys.precision_recall).scores(threshold)
    elif keys.true is not None and keys.false is not None:
        true, false = _scores(keys.true), _scores(keys.false)
    else:
        true = false = _scores(ScoreSection(mean=keys.mean, std=keys.std))
    return StateConfidence(true, false, keys.visibility_slope, keys.size_slope, keys.size_reference_px)


def _scores(section: ScoreSection) -> Scores:
    if section.mean is not None and section.std is not None:
        return NormalScores(section.mean, section.std)
    return QuantileScores(read_only(section.quantiles or []))


def _dropout(content: DetectorFile) -> Dropout:
    own = {index: _effects(section.dropout) for index, section in enumerate(content.states.values())}
    dropout = Dropout(_effects(content.dropout), own={index: effects for index, effects in own.items() if effects})
    return replace(dropout, anchored=bool(dropout.every_effect) and content.dropout.anchor == "state_rate")


def _effects(section: EffectsSection) -> tuple[Effect, ...]:
    effects: list[Effect] = []
    for name, keys in section.effects().items():
        if keys.edges is not None and keys.odds is not None:
            effects.append(Table(name, tuple(keys.edges), tuple(keys.odds)))
        elif keys.reference is not None:
            slope = keys.per_unit if keys.per_doubling is None else keys.per_doubling
            effects.append(Slope(name, slope or 0.0, keys.reference, doublings=keys.per_doubling is not None))
    return tuple(effects)


def _clutter(section: FalsePositivesSection) -> ClutterOptions:
    persistent = section.persistence
    density = None if section.density is None else read_only(section.density)
    return ClutterOptions(
        model=section.model,
        placement=Placement(section.band_px, section.far_half_px, density),
        size=None if section.size is None else _sizes(section.size),
        lifetime_s=persistent.lifetime_s if persistent else 1.0,
        drift_px_s=persistent.drift_px_s if persistent else 0.0,
        persistent_share=persistent.share if persistent else 0.0,
    )


def _sizes(section: SizeSection) -> Sizes | None:
    if section.px is None:
        return None
    return FixedSize(*section.px) if section.log_std is None else LognormalSize(*section.px, section.log_std)


def _performance(section: PerformanceSection, states: list[str]) -> Performance:
    schedule = tuple((time_s, -1 if state is None else states.index(state)) for time_s, state in section.schedule)
    return Performance(section.scope == "per_camera", schedule)
