"""Draws the numbers of a detector from what its labelled set leaves open. The numbers of a state are drawn together,
with the correlations of their bootstrap replicates: normal numbers become shares by Beta and rates by Gamma
distributions (Jeffreys's prior), the others go back from the scale on which they are nearly normal. All spreads of a
state are multiplied by one factor that makes normal numbers Student's t ones, with a degree of freedom less than it had
images. Means and spreads are so those of the intervals that `modsim3d learn` reports. What sums to one over labels,
cells or states is drawn from a Dirichlet distribution with one observation added to a column (Perks's prior; one of
each kind for the transition matrix, as it was learned)."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError
from scipy import special

from modsim3d.core.arrays import Array
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.core.statistics import jeffreys_rate, jeffreys_share
from modsim3d.detector.file import schema, schema_models
from modsim3d.io.input_files import file_sha256
from modsim3d.io.strict_text import load_json
from modsim3d.io.validation import Strict, describe
from modsim3d.learn.bootstrap import Kind, columns_of_one, from_scale, nested, to_scale
from modsim3d.learn.box_errors.laws import covariance
from modsim3d.learn.learned_detector import correlated, uncertainty_file

MIN_UNITS = 5  # images or runs of frames of a state, below which their spread does not tell how well numbers are known


class LearnedNumber(Strict):
    """A number, vector or matrix of a detector file."""

    key: Annotated[list[str], Field(min_length=1)]  # in the detector file, or in its section of the state
    kind: Kind  # decides the scale on which it is nearly normal
    estimate: Any  # as the detector file has it
    observations: Any = None  # independent ones that a share or a rate is worth, in its shape
    spread: Any = None  # of other kinds, the standard deviation on the scale

    @property
    def name(self) -> str:
        """The last of its keys."""
        return self.key[-1]

    @property
    def values(self) -> Array:
        """The estimate as an array."""
        return np.array(self.estimate, dtype=np.float64)


class LearnedGroup(Strict):
    """The numbers of one state, or those that all states share."""

    state: str | None  # name; None: all states
    units: Annotated[int, Field(strict=True, ge=0)]  # images or runs of frames that they rest on
    numbers: list[LearnedNumber]
    correlations: list[list[float]]  # rows of the lower triangle, see `modsim3d.learn.learned_detector.correlated`


class LearnedUncertainty(Strict):
    """Uncertainty of the numbers of a detector file."""

    format: Literal[1]  # version of the file
    detector_sha256: str  # of the detector file
    confidence_threshold: float
    transitions: list[list[int]] | None  # number to each state (row) from each; None if none were seen
    groups: list[LearnedGroup]


def read_uncertainty(detector: Path) -> LearnedUncertainty:
    """Recorded uncertainty of a detector file; InputError if there is none, or it is too little or another file's."""
    path, source = uncertainty_file(detector), f"detector {detector}"
    if not path.is_file():
        needed = f"needs {path.name} beside it, which modsim3d learn writes with the detector file: learn it again"
        raise InputError(source, [f"uncertainty: learned {needed}"])
    try:
        uncertainty = LearnedUncertainty.model_validate(load_json(path, "uncertainty"))
    except ValidationError as error:
        raise InputError(f"uncertainty {path}", describe(error, LearnedUncertainty)) from None
    if uncertainty.detector_sha256 != file_sha256(detector):
        problem = f"{path.name} belongs to another detector file, or the file was changed since it was learned"
        raise InputError(source, [f"{problem}: learn it again (set keys with vary in the campaign, not in the file)"])
    few = [
        f"state {group.state}: learned from {group.units} {'image' if group.units == 1 else 'images or runs'}, too few "
        f"to say how well its numbers are known: at least {MIN_UNITS} are needed"
        for group in uncertainty.groups
        if group.state is not None and group.units < MIN_UNITS
    ]
    if few:
        raise InputError(source, few)
    return uncertainty


_STREAM = 3  # keeps these random numbers apart from those of the drawn keys, see `plan.drawn`
_INDEPENDENT = 0.01  # share of the identity in the matrix of correlations, whose entries are rounded
_ROUNDING = 1e-5  # least eigenvalue of a covariance over its greatest
NOT_NEGATIVE = ("visibility_slope", "size_slope")
_DIGITS = 1e-5  # what the digits of the settings may change in proportion
_MAX_FACTOR = 10.0  # numbers and rates are drawn within this factor of their estimates; some have no bound at all


def drawn_detector(spread: LearnedUncertainty, seed: int) -> dict[str, Any]:
    """Settings of the detector that is drawn for a traffic seed, from keys such as `detector.states.good.confusion` to
    values. Raises ModsimError if the correlations are none."""
    rng = np.random.default_rng([_STREAM, seed])
    settings: dict[str, Any] = {}
    for group in spread.groups:
        section = "detector" if group.state is None else f"detector.states.{group.state}"
        values = _drawn_group(group, rng)
        settings |= {f"{section}.{key}": value for key, value in _written(values, spread.confidence_threshold).items()}
    if spread.transitions is not None:
        columns = [rng.dirichlet(column + 1) for column in np.array(spread.transitions, dtype=np.float64).T]
        settings["detector.transition_matrix"] = columns_of_one(np.stack(columns, axis=1))
    return settings | _second_boxes_with_room(settings)


def _second_boxes_with_room(settings: dict[str, Any]) -> dict[str, Any]:
    """Probabilities of second boxes and parts of vessels that all drawn false discovery rates leave room for. They are
    lowered together where they are larger. With a rate for each image they only must not exceed one together."""
    keys = [key for name in ("duplicates", "splits") if (key := f"detector.false_positives.{name}") in settings]
    rates = [rate for key, rate in settings.items() if key.endswith(".false_discovery_rate")]
    counted = not any(key.endswith(".false_positives_per_image") for key in settings)
    room = min((rate / (1 - rate) for rate in rates if counted), default=1.0)
    lower = min((1 - _DIGITS) * room / max(sum(settings[key] for key in keys), _DIGITS), 1.0)
    return {key: nested(np.array(lower * settings[key])) for key in keys}


def _drawn_group(group: LearnedGroup, rng: np.random.Generator) -> dict[str, Array]:
    """The numbers of a state, by their keys with dots between."""
    freedom = max(group.units - 1, 1)
    normal, widen = _correlated_normal(group, rng), freedom / rng.chisquare(freedom)
    values, place = {}, 0
    for number in group.numbers:
        estimate = number.values
        places = correlated(number.key, estimate.shape)
        z = np.zeros(estimate.shape)
        z[places] = normal[place : (place := place + int(places.sum()))]
        values[".".join(number.key)] = _draw_number(number, z, widen, rng)
    return values


def _correlated_normal(group: LearnedGroup, rng: np.random.Generator) -> Array:
    """A standard normal number for each one with correlations, shape (n,)."""
    size = len(group.correlations)
    matrix = np.eye(size)
    for i, row in enumerate(group.correlations):
        matrix[i, :i] = matrix[:i, i] = (1 - _INDEPENDENT) * np.array(row)
    try:
        root = np.linalg.cholesky(matrix)
    except np.linalg.LinAlgError:
        raise ModsimError("the correlations in the file of the detector's uncertainty are none") from None
    return root @ rng.standard_normal(size)


def _draw_number(number: LearnedNumber, z: Array, widen: float, rng: np.random.Generator) -> Array:
    """A number from standard normal ones of its shape, with a variance that is widened by a factor."""
    estimate = number.values
    if number.kind not in ("share", "rate"):
        spread = np.array(number.spread, dtype=np.float64)
        drawn: Array = from_scale(to_scale(estimate, number.kind) + np.sqrt(widen) * spread * z, number.kind)
        drawn = np.maximum(drawn, 0) if number.name in NOT_NEGATIVE else drawn
        if number.kind == "capped":
            return np.clip(drawn, 0, 1)
        return np.clip(drawn, estimate / _MAX_FACTOR, estimate * _MAX_FACTOR) if number.kind == "positive" else drawn
    trials = np.array(number.observations, dtype=np.float64) / widen
    if number.kind == "rate":
        drawn = jeffreys_rate(estimate, trials, special.ndtr(z))
        return np.where(estimate > 0, np.minimum(drawn, estimate * _MAX_FACTOR), drawn)
    if number.name == "confusion":
        missed = jeffreys_share(estimate[-1], trials[-1], special.ndtr(z[-1]))
        columns = zip(estimate[:-1].T, trials[-1] * (1 - estimate[-1]), strict=True)
        labels = np.stack([_distribution(shares, count, rng) for shares, count in columns], axis=1)
        return np.vstack([labels * (1 - missed), missed])
    if number.name in ("false_positive_labels", "density"):
        return _distribution(estimate.ravel(), float(trials.max()), rng).reshape(estimate.shape)
    return jeffreys_share(estimate, trials, special.ndtr(z))


def _distribution(estimate: Array, trials: float, rng: np.random.Generator) -> Array:
    """Probabilities in proportion to an estimate, shape (n,), seen in a number of trials."""
    whole = max(float(estimate.sum()), 1e-300)
    return rng.dirichlet(estimate / whole * trials + 1 / len(estimate))


def _covariance(std: Array, correlation: Array) -> Array:
    """A covariance, shape (4, 4), that is still one when its entries are rounded."""
    matrix = covariance(std, correlation)
    least, greatest = np.linalg.eigvalsh(matrix)[[0, -1]]
    result: Array = matrix + max(_ROUNDING * greatest - least, 0.0) * np.eye(len(matrix))
    return result


def _written(values: dict[str, Array], threshold: float) -> dict[str, Any]:
    written: dict[str, Any] = {}
    shares = [key for key in values if key.startswith("persistence.score.")]
    whole = float(sum(values[key].sum() for key in shares))
    of_boxes = [key for key in values if key.startswith("persistence.box.")]
    columns = sum(np.atleast_2d(values[key]).sum(axis=0) for key in of_boxes)
    for key, value in values.items():
        name = key.rpartition(".")[2]
        if key in shares and whole >= 1:
            value = (1 - _DIGITS) * value / whole
        if key in of_boxes:
            value = value / np.maximum(columns, 1.0) * (1 - _DIGITS)
        if name == "box_error_std":
            value = _covariance(value, values["box_error_correlation"])
        elif name == "quantiles":
            value = np.clip(value, threshold, 1)
        if name != "box_error_correlation":
            written[_BOX_ERROR_KEYS.get(name, key)] = _WRITERS.get(name, nested)(value)
    return written


_BOX_ERROR_KEYS = {
    "box_error_mean": "box_error.mean",
    "box_error_std": "box_error.covariance",
    "box_error_growth": "box_error.growth",
    "box_error_degrees_of_freedom": "box_error.degrees_of_freedom",
}
_WRITERS: dict[str, Callable[[Array], Any]] = {
    "confusion": columns_of_one,
    "false_positive_labels": columns_of_one,
    "box_error_growth": lambda value: nested(np.maximum(value, 0.0)),
    "box_error_degrees_of_freedom": lambda value: nested(np.clip(value, schema.MIN_DEGREES, schema.MAX_DEGREES)),
    "density": lambda value: nested(np.round(value / value.max(), 6)),
    "quantiles": lambda value: nested(np.maximum.accumulate(value)),
    "false_discovery_rate": lambda value: nested(np.minimum(value, schema.MAX_FALSE_DISCOVERY_RATE)),
    "false_positives_per_image": lambda value: nested(np.minimum(value, schema_models.MAX_PER_IMAGE)),
}
"""How numbers are written that a draw may have moved beyond what a file may have."""
