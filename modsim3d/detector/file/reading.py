"""Reads detector files into detector models; reports all problems at once."""

import os
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import yaml
from pydantic import ValidationError

from modsim3d.core.arrays import Array, read_only
from modsim3d.core.errors import InputError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.detector import false_positives
from modsim3d.detector.confidence import ConfidenceLaw, NormalScores, PrecisionRecall, QuantileScores, StateConfidence
from modsim3d.detector.draws import ERROR_DISTRIBUTIONS, ERROR_NORMALS, BoxErrorLaw
from modsim3d.detector.dropout import ATTRIBUTES, Dropout, Effect, FactorTable, Slope, anchor
from modsim3d.detector.false_positive_placement import Placement
from modsim3d.detector.false_positives import FALSE_POSITIVE_MODELS, FalsePositiveOptions
from modsim3d.detector.file import schema_models
from modsim3d.detector.file.schema import BoxErrorSection, DetectorFile, FalsePositivesSection, StateSection
from modsim3d.detector.merges_and_splits import MergesAndSplits
from modsim3d.detector.model import DetectorModel, Performance, PerformanceState
from modsim3d.detector.persistence import BoxMemory, LatentScore, Persistence
from modsim3d.detector.records import Gates
from modsim3d.io.input_files import data_folder
from modsim3d.io.strict_text import NUMBERS, load_yaml
from modsim3d.io.validation import describe, kind_of, nearest, shown

# ---- Which file a detector's path or name stands for ----


def shipped_detectors() -> dict[str, Path]:
    """Detector files that come with the package, by names such as `thesis` and `conditions/foggy_cloudy`."""
    folder = data_folder("scenes") / "detectors"
    files = [*folder.glob("*.yaml"), *folder.glob("conditions/*.yaml")]
    return {path.relative_to(folder).with_suffix("").as_posix(): path for path in sorted(files)}


def find_detector(detector: StrPath) -> Path:
    """The detector file that a path or, if there is no such file, the name of a shipped detector stands for. A name
    with an ending is a path. Raises InputError if it is neither, TypeError if it is neither text nor a path."""
    path = as_path(detector, "detector", "a path or the name of a shipped detector")
    name, shipped = os.fspath(detector), shipped_detectors()
    try:
        exists = path.exists() and not (path.is_dir() and name in shipped)
    except OSError as error:
        raise InputError(f"detector {shown(name)}", [f"cannot be read: {error.strerror}"]) from None
    if exists or path.suffix or path.is_absolute():
        return path
    if name not in shipped:
        problem = f"no such file, and no shipped detector has this name ({nearest(name, shipped)})"
        raise InputError(f"detector {path}", [problem])
    return shipped[name]


# ---- Contradictions between the sections of a detector file ----

RATE_TOLERANCE = 0.01
"""Greatest difference between the end of a precision-recall curve and the rates of its state."""


def agreement_problems(file: DetectorFile) -> list[str]:
    """One line for each contradiction, with its path."""
    problems = _false_positive_problems(file) + _dropout_problems(file)
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
    if model != "confusion" and not any(section.effects() for section in (file.dropout, *_own_dropout(file).values())):
        return [f"dropout: model {model} needs at least one of {', '.join(ATTRIBUTES)}"]
    misfits = {name: own.misfit(model) for name, own in _own_dropout(file).items()}
    anchored = "anchor state_rate holds the state's rate whatever it is: choose anchor none, or leave it out"
    sections = {"dropout": file.dropout} | {f"states.{name}.dropout": own for name, own in _own_dropout(file).items()}
    given = [path for path, section in sections.items() if section.intercept is not None]
    return [f"states.{name}.dropout: {misfit} (dropout.model)" for name, misfit in misfits.items() if misfit] + [
        f"{path}.intercept: {anchored}" for path in given if file.dropout.anchor == "state_rate"
    ]


def _own_dropout(file: DetectorFile) -> dict[str, schema_models.EffectsSection]:
    return {name: state.dropout for name, state in file.states.items()}


def _false_positive_problems(file: DetectorFile) -> list[str]:
    keys = file.false_positives
    problems = []
    if FALSE_POSITIVE_MODELS[keys.model].side_px is not None:
        given = [key for key in ("placement", "far_half_px", "size", "persistence") if key in keys.model_fields_set]
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
    if keys.on_vessels is not None and FALSE_POSITIVE_MODELS[keys.model].rate_key != "false_positives_per_image":
        problems.append(f"false_positives.on_vessels: model {keys.model} counts those on vessels too: choose per_image")
    if keys.duplicates + keys.splits > 1:
        problems.append("false_positives: duplicates and splits together exceed 1, and no detection is both")
    return problems


def _rate_problems(file: DetectorFile) -> list[str]:
    """The rate is where the model looks for it; one of each image is nowhere else."""
    keys = file.false_positives
    given = {name: state.false_positives_per_image is not None for name, state in file.states.items()}
    if FALSE_POSITIVE_MODELS[keys.model].rate_key == "false_positives_per_image":
        if keys.rate is not None or all(given.values()):
            return []
        missing = ", ".join(name for name, own_rate in given.items() if not own_rate)
        return [
            f"false_positives.rate: model {keys.model} needs it, or false_positives_per_image in each state (missing "
            f"in {missing})"
        ]
    unused = [] if keys.rate is None else ["false_positives.rate"]
    unused += [f"states.{name}.false_positives_per_image" for name, own_rate in given.items() if own_rate]
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
    if rate is None or not FALSE_POSITIVE_MODELS[keys.model].counts_second_boxes or rate / (1 - rate) >= extra - 1e-12:
        return []
    return [
        f"{path}.false_discovery_rate: {rate:g} leaves room for {rate / (1 - rate):.3g} false positives for each true "
        f"one, but false_positives.duplicates and splits alone may make {extra:g}: lower them, or choose per_image"
    ]


def _curve_problems(path: str, state: StateSection, file: DetectorFile) -> list[str]:
    """A curve must end at the recall and the precision that the state has."""
    curve = state.confidence.precision_recall
    if curve is None:
        return []
    recall, precision = curve[-1]
    recalls = [1 - rate for rate in state.confusion[-1]]
    problems = []
    if not min(recalls) - RATE_TOLERANCE <= recall <= max(recalls) + RATE_TOLERANCE:
        problems.append(
            f"{path}.confidence.precision_recall: ends at recall {recall:g}, but the confusion matrix detects "
            + " to ".join(f"{rate:g}" for rate in dict.fromkeys((min(recalls), max(recalls))))
            + " of the vessels: a curve ends at the recall that the detector has"
        )
    rate = state.false_discovery_rate if FALSE_POSITIVE_MODELS[file.false_positives.model].counts_second_boxes else None
    if rate is not None and abs(precision - (1 - rate)) > RATE_TOLERANCE:
        problems.append(
            f"{path}.confidence.precision_recall: ends at precision {precision:g}, but false_discovery_rate {rate:g} "
            f"makes it {1 - rate:g}"
        )
    return problems


def load_detector(path: StrPath) -> DetectorModel:
    """Read and validate a detector file, given as a path or the name of a shipped detector.

    detector = modsim3d.load_detector("my/detector.yaml")
    detector = modsim3d.load_detector("conditions/foggy_cloudy")

    Raises:
        InputError: The file cannot be read, or something in it is wrong; every problem has its own line.
        TypeError: It is neither text nor a path.
    """
    path = find_detector(path)
    return parse_detector(load_yaml(path, "detector"), f"detector {path}")


def parse_detector(data: Any, source: str = "detector") -> DetectorModel:
    """The detector that a mapping with the keys of a detector file describes; messages call it `source`. Raises
    InputError if something is wrong; every problem has its own line with its path."""
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
    return None if content is None else dict(pickle.loads(content))


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
    states, performance = list(content.states), content.performance
    schedule = tuple((time_s, -1 if state is None else states.index(state)) for time_s, state in performance.schedule)
    return DetectorModel(
        labels=tuple(content.labels),
        confidence_threshold=content.confidence_threshold,
        operating_threshold=content.operating_threshold,
        initial_state=states.index(content.initial_state),
        transition_matrix=_normalised(content.transition_matrix),
        states=tuple(_state(name, section, content) for name, section in content.states.items()),
        transition_interval_s=content.transition_interval_s,
        dropout=_dropout(content),
        gates=Gates(**content.gates.model_dump()),
        persistence=_persistence(content.persistence),
        false_positives=_false_positives(content.false_positives),
        merges_and_splits=MergesAndSplits(
            **{field.name: getattr(content.false_positives, field.name) for field in fields(MergesAndSplits)}
        ),
        performance=Performance(performance.scope == "per_camera", schedule),
    )


def _state(name: str, section: StateSection, content: DetectorFile) -> PerformanceState:
    per_image = section.false_positives_per_image
    return PerformanceState(
        name=name,
        confusion=_normalised(section.confusion),
        false_positive_labels=_normalised(section.false_positive_labels),
        false_discovery_rate=np.nan if section.false_discovery_rate is None else section.false_discovery_rate,
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


def _confidence(keys: schema_models.ConfidenceKeys, threshold: float) -> StateConfidence:
    true: ConfidenceLaw
    false: ConfidenceLaw
    if keys.precision_recall is not None:
        true, false = PrecisionRecall.through(keys.precision_recall).scores(threshold)
    elif keys.true is not None and keys.false is not None:
        true, false = _scores(keys.true), _scores(keys.false)
    else:
        true = false = _scores(schema_models.ScoreSection(mean=keys.mean, std=keys.std))
    return StateConfidence(true, false, keys.visibility_slope, keys.size_slope, keys.size_reference_px)


def _scores(section: schema_models.ScoreSection) -> ConfidenceLaw:
    if section.mean is not None and section.std is not None:
        return NormalScores(section.mean, section.std)
    return QuantileScores(read_only(section.quantiles or []))


def _dropout(content: DetectorFile) -> Dropout:
    own = {index: _effects(section.dropout) for index, section in enumerate(content.states.values())}
    of_states = [section.dropout.intercept or content.dropout.intercept for section in content.states.values()]
    dropout = Dropout(
        _effects(content.dropout),
        own={index: effects for index, effects in own.items() if effects},
        intercepts={index: tuple(intercept) for index, intercept in enumerate(of_states) if intercept is not None},
    )
    return replace(dropout, anchored=bool(dropout.every_effect) and content.dropout.anchor == "state_rate")


def _effects(section: schema_models.EffectsSection) -> tuple[Effect, ...]:
    effects: list[Effect] = []
    for name, keys in section.effects().items():
        if keys.edges is not None and keys.odds is not None:
            effects.append(FactorTable(name, tuple(keys.edges), tuple(keys.odds)))
        elif keys.reference is not None:
            slope = keys.per_unit if keys.per_doubling is None else keys.per_doubling
            effects.append(Slope(name, slope or 0.0, keys.reference, doublings=keys.per_doubling is not None))
    return tuple(effects)


def _false_positives(section: FalsePositivesSection) -> FalsePositiveOptions:
    persistent, on = section.persistence, section.on_vessels
    density = None if section.density is None else read_only(section.density)
    return FalsePositiveOptions(
        model=section.model,
        placement=Placement(section.band_px, section.far_half_px, density),
        size=None if section.size is None else _sizes(section.size),
        lifetime_s=persistent.lifetime_s if persistent else 1.0,
        drift_px_s=persistent.drift_px_s if persistent else 0.0,
        persistent_share=persistent.share if persistent else 0.0,
        on_vessels=None if on is None else _on_vessels(on),
    )


def _on_vessels(section: schema_models.OnVesselsSection) -> false_positives.VesselFalseBoxes:
    return false_positives.VesselFalseBoxes(section.share, section.lifetime_s, tuple(section.mean), tuple(section.std))


def _sizes(section: schema_models.SizeSection) -> false_positives.Sizes | None:
    if section.px is None:
        return None
    if section.log_std is None:
        return false_positives.FixedSize(*section.px)
    return false_positives.LognormalSize(*section.px, section.log_std)


def _persistence(section: schema_models.PersistenceSection) -> Persistence:
    score, box = section.score, section.box
    return Persistence(
        **section.model_dump(exclude={"score", "box"}),
        score=None if score is None else LatentScore(score.vessel_share, tuple(score.shares), tuple(score.times_s)),
        box=None if box is None else _box_memory(box),
    )


def _box_memory(section: schema_models.BoxMemorySection) -> BoxMemory:
    """Memory with a scale that is new at every step where the section says nothing of it."""
    columns = np.zeros((1 + len(section.shares), ERROR_NORMALS + 1))
    columns[:, : len(section.vessel_share)] = [section.vessel_share, *section.shares]
    return BoxMemory(read_only(columns[0]), read_only(columns[1:]), read_only(section.times_s))


# ---- The text of a file, with matrices in rows ----


class _Dumper(yaml.SafeDumper):
    """Quotes text that YAML 1.2 reads as a number and 1.1, which PyYAML follows, does not, such as `1e3`."""


for tag, pattern, first in NUMBERS:
    _Dumper.add_implicit_resolver(tag, pattern, first)


def detector_text(content: Mapping[str, Any], comments: Sequence[str] = ()) -> str:
    """The YAML of a detector file, after lines of comments."""
    head = "".join(f"# {line}".rstrip() + "\n" for line in comments)
    text: str = yaml.dump(
        dict(content), Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=118, allow_unicode=True
    )
    return head + text


# ---- The miss rate of a detector file, which is no key of it ----

MISS_RATE = "miss_rate"


def is_miss_rate(parts: tuple[str, ...]) -> bool:
    """Whether keys lead to a miss rate: `detector.miss_rate`, or `detector.states.NAME.miss_rate`."""
    inside = len(parts) == 2 or (len(parts) > 3 and parts[1] == "states")
    return inside and parts[0] == "detector" and parts[-1] == MISS_RATE


def with_miss_rate(content: Mapping[str, Any], rate: object, state: str | None, option: str) -> dict[str, Any]:
    """The content of a detector file in which every label is missed at one rate, from 0 to below 1, in a state or, with
    None, in all. The other rows of the confusion matrix keep their proportions in each column. Where misses follow what
    vessels look like and the file has the log-odds that this added in its learning set, the rate is that of the
    learning set again. Errors of the content are left to its own checks. Raises InputError, which calls the setting
    `option`, if it is no such rate, there is no such state, or a label is never found."""
    if isinstance(rate, bool) or not isinstance(rate, int | float) or not 0 <= rate < 1:
        raise InputError(option, [f"a miss rate is a number from 0 to below 1 (got {shown(rate)})"])
    states = content.get("states")
    if not isinstance(states, Mapping):
        return dict(content)
    if state is not None and state not in states:
        raise InputError(option, [f"the detector has no state '{state}' ({nearest(state, states)})"])
    changed = {
        name: _section(section, content.get("dropout"), float(rate), f"{option}: states.{name}")
        if state in (None, name)
        else section
        for name, section in states.items()
    }
    return {**content, "states": changed}


def _section(section: Any, shared: Any, rate: float, where: str) -> Any:
    try:
        matrix = np.array(section["confusion"], dtype=np.float64)
    except (TypeError, KeyError, ValueError):
        return section
    if matrix.ndim != 2 or len(matrix) < 2:
        return section
    recalls = matrix[:-1].sum(axis=0)
    if np.any(recalls <= 0):
        column = int(np.argmax(recalls <= 0))
        raise InputError(
            where, [f"column {column} of its confusion matrix has nothing but misses, so no miss rate fits"]
        )
    rows = np.vstack([matrix[:-1] * ((1 - rate) / recalls), np.full(matrix.shape[1], rate)])
    return {**section, "confusion": np.round(rows, 12).tolist()} | _intercept(section.get("dropout"), shared, rate)


def _intercept(own: Any, shared: Any, rate: float) -> dict[str, Any]:
    """Intercept with which the mean rate over the learning set is `rate`; empty without log-odds of that set."""
    key = "learned_log_odds"
    source = next((section for section in (own, shared) if isinstance(section, Mapping) and key in section), None)
    try:
        learned = [np.array(quantiles, dtype=np.float64) for quantiles in source[key]] if source else []
    except (TypeError, ValueError):
        return {}
    if any(quantiles.ndim != 1 or not len(quantiles) for quantiles in learned):
        return {}  # which the check of the file says
    intercept = [round(anchor(rate, quantiles, np.ones(len(quantiles))), 12) for quantiles in learned]
    return {"dropout": {**(own if isinstance(own, Mapping) else {}), "intercept": intercept}} if learned else {}
