"""The form of a detector file. The names in it are known through the validation context, see `reading`."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, model_validator

from modsim3d.core.arrays import Array
from modsim3d.detector.draws import ERROR_DISTRIBUTIONS
from modsim3d.detector.false_positives import FALSE_POSITIVE_MODELS
from modsim3d.detector.file import schema_models
from modsim3d.detector.model import ERROR_COMPONENTS
from modsim3d.io.validation import NotNegative, Number, Positive, Probability, Strict, nearest, shown

# ---- Checks of the vectors and matrices of a detector file ----

SUM_TOLERANCE = 1e-6
ROUNDING = 1e-9
"""Relative size of an asymmetry or a negative eigenvalue that counts as rounding."""

Rows = Sequence[Sequence[float]]


def matrix_problems(rows: Rows, shape: tuple[int, int], meaning: str) -> list[str]:
    """Whether a matrix has the shape it should have; `meaning` says what its rows and columns are."""
    lengths = {len(row) for row in rows}
    if len(lengths) > 1:
        return [f"its rows have different lengths: {', '.join(str(len(row)) for row in rows)}"]
    size = (len(rows), lengths.pop() if lengths else 0)
    if size == shape:
        return []
    return [f"is {size[0]} × {size[1]}, must be {shape[0]} × {shape[1]}: {meaning}"]


def _sums_to_one(sums: Array) -> bool:
    return bool(np.all(np.abs(sums - 1) <= SUM_TOLERANCE))


def column_problems(rows: Rows, names: Sequence[str]) -> list[str]:
    """Whether the columns of a matrix of the right shape are probability distributions."""
    matrix = np.array(rows, dtype=np.float64)
    sums = matrix.sum(axis=0)
    if _sums_to_one(sums):
        return []
    if matrix.shape[0] == matrix.shape[1] and _sums_to_one(matrix.sum(axis=1)):
        return [
            "its rows sum to one and its columns do not: it looks row-stochastic and must be transposed "
            "(a column holds the probabilities of what follows one state)"
        ]
    return [
        f"column '{name}' sums to {total:.9g}, must sum to 1"
        for name, total in zip(names, sums, strict=True)
        if abs(total - 1) > SUM_TOLERANCE
    ]


def transition_problems(rows: Rows, states: Sequence[str]) -> list[str]:
    """Whether A is column-stochastic (Jessen & Mohr (2023), eq. 6.1), with a column for each state."""
    size = len(states)
    return matrix_problems(
        rows, (size, size), f"one row and one column for each of the states {', '.join(states)}"
    ) or column_problems(rows, states)


def confusion_problems(rows: Rows, labels: Sequence[str]) -> list[str]:
    """Whether each column of a confusion matrix is a distribution over labels and background."""
    size = len(labels)
    meaning = f"rows {', '.join(labels)}, background; columns {', '.join(labels)}"
    wrong_shape = matrix_problems(rows, (size + 1, size), meaning)
    transposed = not matrix_problems(rows, (size, size + 1), meaning)
    if transposed and _sums_to_one(np.array(rows, dtype=np.float64).sum(axis=1)):
        return [f"{wrong_shape[0]}; it looks row-stochastic and must be transposed"]
    if wrong_shape:
        return [f"{wrong_shape[0]}; {_FROM_FIGURES}"] if rows and len(rows) == len(rows[0]) else wrong_shape
    problems = column_problems(rows, labels)
    return [f"{problem}; {_MISS_RATE}" for problem in problems[:1]] + problems[1:]


_FROM_FIGURES = "modsim3d learn --from-figures makes a detector file of a confusion matrix as programs print it"
_MISS_RATE = "to change misses alone, set miss_rate, which keeps the sum (docs/knobs.md)"


def _refuse_counts(value: Any) -> Any:
    """The rows of a confusion matrix, unless they hold counts. Raises ValueError."""
    rows = [row for row in value if isinstance(row, list)] if isinstance(value, list) else []
    numbers = [cell for row in rows for cell in row if isinstance(cell, int | float)]
    counts = [cell for cell in numbers if cell > 1 and (isinstance(cell, int) or cell.is_integer())]
    if counts:
        raise ValueError(f"has counts ({shown(counts[0])}), must have shares of each true label; {_FROM_FIGURES}")
    return value


def distribution_problems(values: Sequence[float], labels: Sequence[str]) -> list[str]:
    """Whether there is a probability for each label and they sum to one."""
    if len(values) != len(labels):
        return [f"has {len(values)} entries, must have one for each of the labels {', '.join(labels)}"]
    total = sum(values)
    return [] if abs(total - 1) <= SUM_TOLERANCE else [f"sums to {total:.9g}, must sum to 1"]


def covariance_problems(rows: Rows) -> list[str]:
    """Whether a matrix is the covariance of some random vector (e_x, e_y, e_w, e_h)."""
    problems = matrix_problems(rows, (4, 4), f"rows and columns {', '.join(ERROR_COMPONENTS)}")
    if problems:
        return problems
    matrix = np.array(rows, dtype=np.float64)
    scale = float(np.abs(matrix).max())
    if scale == 0:
        return []
    matrix = matrix / scale  # so that the eigenvalues of enormous entries do not overflow
    for i, j in itertools.combinations(range(4), 2):
        if abs(matrix[i, j] - matrix[j, i]) > ROUNDING:
            first, second = ERROR_COMPONENTS[i], ERROR_COMPONENTS[j]
            problems.append(
                f"is not symmetric: row {first}, column {second} is {rows[i][j]:.9g}, "
                f"row {second}, column {first} is {rows[j][i]:.9g}"
            )
    least = float(np.linalg.eigvalsh(matrix)[0]) if not problems else 0.0
    if least < -ROUNDING:
        problems.append(
            f"is not positive semi-definite, so no errors can have it: its smallest eigenvalue is "
            f"{least * scale:.6g}, must be at least 0"
        )
    return problems


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


MAX_FALSE_DISCOVERY_RATE = 0.99


def _discovery_problems(value: float) -> list[str]:
    if value == 1:
        return [
            "is 1, must be below 1: it is the share of false positives among all detections, "
            "and 1 would take infinitely many of them for each true one"
        ]
    if 0 <= value <= MAX_FALSE_DISCOVERY_RATE:
        return []
    return [
        f"is {value:g}, must be from 0 to {MAX_FALSE_DISCOVERY_RATE}, which already makes 99 false positives "
        "for each true detection"
    ]


def _one_of(models: Collection[str], what: str) -> AfterValidator:
    return _checked_by(lambda name: [] if name in models else [f"unknown {what} '{name}' ({nearest(name, models)})"])


MIN_DEGREES, MAX_DEGREES = 2.1, 1000.0


def _freedom_problems(value: float) -> list[str]:
    if MIN_DEGREES <= value <= MAX_DEGREES:
        return []
    return [
        f"is {value:.6g}, must be from {MIN_DEGREES:g} to {MAX_DEGREES:g}: near 2 Student's t has hardly "
        "a covariance, and with more it is normal (law normal), so that no run could show the number"
    ]


def _unknown_state(value: str, states: Sequence[str]) -> list[str]:
    return [] if value in states else [f"unknown state '{value}' ({nearest(value, states)})"]


def _state_problems(value: dict[str, StateSection]) -> list[str]:
    return [] if value else ["is empty, must describe at least one state"]


Name = Annotated[str, Field(strict=True, min_length=1)]
Labels = Annotated[list[Name], _checked_by(_label_problems)]
Mean = Annotated[list[Number], _checked_by(_length_problems)]
Covariance = Annotated[list[list[Number]], _checked_by(covariance_problems)]
Transition = Annotated[list[list[Probability]], _against("states", transition_problems)]
Confusion = Annotated[list[list[Probability]], BeforeValidator(_refuse_counts), _against("labels", confusion_problems)]
LabelDistribution = Annotated[list[Probability], _against("labels", distribution_problems)]
StateName = Annotated[Name, _against("states", _unknown_state)]
FalsePositiveModelName = Annotated[Name, _one_of(FALSE_POSITIVE_MODELS, "model")]
ErrorLawName = Annotated[Name, _one_of(ERROR_DISTRIBUTIONS, "law")]
DegreesOfFreedom = Annotated[Number, _checked_by(_freedom_problems)]
FalseDiscoveryRate = Annotated[Number, _checked_by(_discovery_problems)]


def with_covariance(section: Any) -> Any:
    """A section of box errors with `std`, a number or one for each component, written out as a covariance, which it
    takes the place of; without a mean there is none. Raises ValueError if it is no such number."""
    if not isinstance(section, Mapping) or "std" not in section:
        return section
    std = section["std"]
    numbers = std if isinstance(std, list) else [std] * len(ERROR_COMPONENTS)
    plain = [number for number in numbers if isinstance(number, int | float) and not isinstance(number, bool)]
    if len(plain) != len(numbers) or len(numbers) != len(ERROR_COMPONENTS) or not all(0 <= x < 1e9 for x in plain):
        wanted = f"a number from 0 is needed, or a list of one for each of {', '.join(ERROR_COMPONENTS)}"
        raise ValueError(f"std: {wanted} (got {shown(std)})")
    rest = {key: value for key, value in section.items() if key != "std"}
    return {"mean": [0.0] * len(numbers), **rest, "covariance": np.diag(np.square(plain, dtype=np.float64)).tolist()}


class BoxErrorSection(Strict):
    """Box error: mean and covariance of (e_x, e_y, e_w, e_h), their distribution, and how the spread grows."""

    std: Any = None  # short for a covariance, see `with_covariance`
    law: ErrorLawName = "normal"
    degrees_of_freedom: DegreesOfFreedom | None = None
    unit: Literal["px", "relative", "mixed"]
    mean: Mean
    covariance: Covariance
    growth: Annotated[list[NotNegative], _checked_by(_length_problems)] | None = None

    @model_validator(mode="before")
    @classmethod
    def _written_out(cls, section: Any) -> Any:
        return with_covariance(section)

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
    confidence: schema_models.ConfidenceSection
    false_positives_per_image: schema_models.PerImage | None = None
    dropout: schema_models.EffectsSection = schema_models.EffectsSection()


class FalsePositivesSection(schema_models.FalsePositiveKeys):
    """Model of false positives and their properties."""

    model: FalsePositiveModelName = "calibrated"


class DetectorFile(Strict):
    """A whole detector file."""

    labels: Labels
    confidence_threshold: Probability
    operating_threshold: Probability | None = None
    initial_state: StateName
    transition_matrix: Transition
    transition_interval_s: Positive | None = None
    false_positives: FalsePositivesSection = FalsePositivesSection(model="calibrated")
    dropout: schema_models.DropoutSection = schema_models.DropoutSection()
    gates: schema_models.GatesSection = schema_models.GatesSection()
    persistence: schema_models.PersistenceSection = schema_models.PersistenceSection()
    performance: schema_models.PerformanceSection = schema_models.PerformanceSection()
    states: Annotated[dict[Name, StateSection], _checked_by(_state_problems)]
