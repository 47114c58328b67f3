"""The form of a detector file. The names in it are known through the validation context, see `reading`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Sequence
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationInfo, model_validator

from modsim3d.detector.box_error_law import ERROR_DISTRIBUTIONS
from modsim3d.detector.clutter_models import CLUTTER_MODELS
from modsim3d.detector.file import checks
from modsim3d.detector.file.schema_models import (
    ClutterKeys,
    ConfidenceSection,
    DropoutSection,
    EffectsSection,
    GatesSection,
    PerformanceSection,
    PerImage,
    PersistenceSection,
)
from modsim3d.detector.model import ERROR_COMPONENTS
from modsim3d.inputs.validation import NotNegative, Number, Positive, Probability, Strict, nearest


def _raise(problems: list[str]) -> None:
    if problems:
        raise ValueError("; ".join(problems))


def _against(names_of: str, find: Callable[[Any, Sequence[str]], list[str]]) -> AfterValidator:
    """A check that needs the file's labels or states; left out where those are broken themselves."""

    def check(value: Any, info: ValidationInfo) -> Any:
        names = (info.context or {}).get(names_of)
        if names:
            _raise(find(value, names))
        return value

    return AfterValidator(check)


def _checked_by(find: Callable[[Any], list[str]]) -> AfterValidator:
    """A check that needs nothing but the value."""

    def check(value: Any) -> Any:
        _raise(find(value))
        return value

    return AfterValidator(check)


def _length_problems(value: list[float]) -> list[str]:
    whole = len(value) == len(ERROR_COMPONENTS)
    return [] if whole else [f"has {len(value)} entries, must have 4: {', '.join(ERROR_COMPONENTS)}"]


def _label_problems(value: list[str]) -> list[str]:
    if not value:
        return ["is empty, must name at least one label"]
    return [f"label '{name}' appears twice" for name, count in Counter(value).items() if count > 1]


GREATEST_FALSE_DISCOVERY_RATE = 0.99


def _discovery_problems(value: float) -> list[str]:
    if value == 1:
        return [
            "is 1, must be below 1: it is the share of false positives among all detections, "
            "and 1 would take infinitely many of them for each true one"
        ]
    if 0 <= value <= GREATEST_FALSE_DISCOVERY_RATE:
        return []
    return [
        f"is {value:g}, must be from 0 to {GREATEST_FALSE_DISCOVERY_RATE}, which already makes 99 false positives "
        "for each true detection"
    ]


def _one_of(models: Collection[str], what: str) -> AfterValidator:
    """A check that a name is registered."""
    return _checked_by(
        lambda value: [] if value in models else [f"unknown {what} '{value}' ({nearest(value, models)})"]
    )


LEAST_DEGREES, MOST_DEGREES = 2.1, 1000.0


def _freedom_problems(value: float) -> list[str]:
    if LEAST_DEGREES <= value <= MOST_DEGREES:
        return []
    return [
        f"is {value:.6g}, must be from {LEAST_DEGREES:g} to {MOST_DEGREES:g}: near 2 Student's t has hardly "
        "a covariance, and with more it is normal (law normal), so that no run could show the number"
    ]


def _unknown_state(value: str, states: Sequence[str]) -> list[str]:
    return [] if value in states else [f"unknown state '{value}' ({nearest(value, states)})"]


def _state_problems(value: dict[str, StateSection]) -> list[str]:
    return [] if value else ["is empty, must describe at least one state"]


Name = Annotated[str, Field(strict=True, min_length=1)]
Labels = Annotated[list[Name], _checked_by(_label_problems)]
Mean = Annotated[list[Number], _checked_by(_length_problems)]
Covariance = Annotated[list[list[Number]], _checked_by(checks.covariance_problems)]
Transition = Annotated[list[list[Probability]], _against("states", checks.transition_problems)]
Confusion = Annotated[list[list[Probability]], _against("labels", checks.confusion_problems)]
LabelDistribution = Annotated[list[Probability], _against("labels", checks.distribution_problems)]
StateName = Annotated[Name, _against("states", _unknown_state)]
ClutterName = Annotated[Name, _one_of(CLUTTER_MODELS, "model")]
ErrorLawName = Annotated[Name, _one_of(ERROR_DISTRIBUTIONS, "law")]
DegreesOfFreedom = Annotated[Number, _checked_by(_freedom_problems)]
FalseDiscoveryRate = Annotated[Number, _checked_by(_discovery_problems)]


class BoxErrorSection(Strict):
    """Box error: mean and covariance of (e_x, e_y, e_w, e_h), their distribution, and how the spread grows."""

    law: ErrorLawName = "normal"
    degrees_of_freedom: DegreesOfFreedom | None = None
    unit: Literal["px", "relative", "mixed"]
    mean: Mean
    covariance: Covariance
    growth: Annotated[list[NotNegative], _checked_by(_length_problems)] | None = None

    @model_validator(mode="after")
    def _growth_fits(self) -> BoxErrorSection:
        if (self.growth is None) != (self.unit != "mixed"):
            raise ValueError("growth goes with unit mixed, and only there")
        for i, (growth, name) in enumerate(zip(self.growth or [], ERROR_COMPONENTS, strict=False)):
            if growth > 0 and self.covariance[i][i] == 0:
                raise ValueError(f"{name} can only grow from a variance above 0 in covariance")
        return self

    @model_validator(mode="after")
    def _law_fits(self) -> BoxErrorSection:
        keys = {key for kind in ERROR_DISTRIBUTIONS.values() for key in kind.keys}
        own = ERROR_DISTRIBUTIONS[self.law].keys
        for key in sorted(keys):
            if (getattr(self, key) is not None) != (key in own):
                raise ValueError(f"law {self.law} {'needs' if key in own else 'has no'} {key}")
        return self


class StateSection(Strict):
    """One performance state."""

    confusion: Confusion
    false_positive_labels: LabelDistribution
    false_discovery_rate: FalseDiscoveryRate | None = None
    box_error: BoxErrorSection
    confidence: ConfidenceSection
    false_positives_per_image: PerImage | None = None
    dropout: EffectsSection = EffectsSection()


class FalsePositivesSection(ClutterKeys):
    """Which model makes false positives, and what they are like."""

    model: ClutterName = "calibrated"


class DetectorFile(Strict):
    """A whole detector file."""

    labels: Labels
    confidence_threshold: Probability
    operating_threshold: Probability | None = None
    initial_state: StateName
    transition_matrix: Transition
    transition_interval_s: Positive | None = None
    false_positives: FalsePositivesSection = FalsePositivesSection(model="calibrated")
    dropout: DropoutSection = DropoutSection()
    gates: GatesSection = GatesSection()
    persistence: PersistenceSection = PersistenceSection()
    performance: PerformanceSection = PerformanceSection()
    states: Annotated[dict[Name, StateSection], _checked_by(_state_problems)]
