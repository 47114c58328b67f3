"""Reads what `modsim3d learn` wrote beside a detector file: how well its numbers are known."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from modsim3d.arrays import Array
from modsim3d.errors import InputError
from modsim3d.inputs.strict_json import load_json
from modsim3d.inputs.validation import Strict, describe
from modsim3d.learn.numbers.resampling import Kind
from modsim3d.learn.uncertainty import uncertainty_file

LEAST_UNITS = 5
"""Images or runs of frames of a state, below which their spread says too little of how well its numbers are known."""


class LearnedNumber(Strict):
    """A number, vector or matrix of a detector file.

    Attributes:
        key: Its keys in the detector file, within the section of the state if there is one.
        kind: Its kind, which decides the scale on which it is nearly normal.
        estimate: What the detector file has.
        observations: Of a share or a rate, the independent observations that it is worth, in the same shape.
        spread: Of other kinds, the standard deviation on the scale.
    """

    key: Annotated[list[str], Field(min_length=1)]
    kind: Kind
    estimate: Any
    observations: Any = None
    spread: Any = None

    @property
    def name(self) -> str:
        """The last of its keys."""
        return self.key[-1]

    @property
    def values(self) -> Array:
        """The estimate as an array."""
        return np.array(self.estimate, dtype=np.float64)


class LearnedGroup(Strict):
    """The numbers of one state, or those that all states share.

    Attributes:
        state: Name of the state; None: all states.
        units: Images or runs of frames that the numbers rest on.
        numbers: The numbers.
        correlations: Between them, see `modsim3d.learn.uncertainty.correlated`: rows of the lower triangle.
    """

    state: str | None
    units: Annotated[int, Field(strict=True, ge=0)]
    numbers: list[LearnedNumber]
    correlations: list[list[float]]


class LearnedUncertainty(Strict):
    """How well the numbers of a detector file are known.

    Attributes:
        format: Version of the file.
        detector_sha256: Checksum of the detector file.
        confidence_threshold: That of the detector.
        transitions: Number of transitions to each state (row) from each; None if none were seen.
        groups: The numbers by state.
    """

    format: Literal[1]
    detector_sha256: str
    confidence_threshold: float
    transitions: list[list[int]] | None
    groups: list[LearnedGroup]


def read_uncertainty(detector: Path) -> LearnedUncertainty:
    """What is known of a detector file.

    Raises:
        InputError: There is nothing beside it, it belongs to another detector file, or it rests on too little.
    """
    path, source = uncertainty_file(detector), f"detector {detector}"
    if not path.is_file():
        needed = f"needs {path.name} beside it, which modsim3d learn writes with the detector file: learn it again"
        raise InputError(source, [f"uncertainty: learned {needed}"])
    try:
        found = LearnedUncertainty.model_validate(load_json(path, "uncertainty"))
    except ValidationError as error:
        raise InputError(f"uncertainty {path}", describe(error, LearnedUncertainty)) from None
    if found.detector_sha256 != hashlib.sha256(detector.read_bytes()).hexdigest():
        problem = f"{path.name} belongs to another detector file, or the file was changed since it was learned"
        raise InputError(source, [f"{problem}: learn it again (set keys with vary in the campaign, not in the file)"])
    few = [
        f"state {group.state}: learned from {group.units} {'image' if group.units == 1 else 'images or runs'}, too few "
        f"to say how well its numbers are known: at least {LEAST_UNITS} are needed"
        for group in found.groups
        if group.state is not None and group.units < LEAST_UNITS
    ]
    if few:
        raise InputError(source, few)
    return found
