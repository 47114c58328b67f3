"""Two runs of the same truth: whether they are that, and where their detectors made different things of a vessel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from modsim3d.arrays import Indices
from modsim3d.display import listed
from modsim3d.errors import RunDirectoryError
from modsim3d.runs.stored_run import StoredRun
from modsim3d.view.report.recording.packing import ROW_BEFORE, Coded, Column
from modsim3d.view.report.recording.vessel_outcomes import OutcomeStretches

DETECTORS_OWN = "detected"
"""The column of the truth that depends on the detector."""


def check_same_truth(first: StoredRun, second: StoredRun) -> None:
    """Raise an error if two runs do not hold the same truth.

    Raises:
        RunDirectoryError: Cameras, vessels, steps or a row of the truth differ.
    """
    for name, one, other in (
        ("cameras", *(listed([camera.name for camera in run.scene.cameras]) for run in (first, second))),
        ("vessels", *(listed(list(run.scene.vessel_names)) for run in (first, second))),
        ("number of steps", first.steps, second.steps),
        ("annotation mode", *(run.scene.annotation.mode for run in (first, second))),
    ):
        if one != other:
            raise _other_truth(first, second, f"the {name}: {one} against {other}")
    truths = [run.table("truth").drop_columns([DETECTORS_OWN]) for run in (first, second)]
    if not truths[0].equals(truths[1]):
        raise _other_truth(first, second, _first_difference(*truths))


def _other_truth(first: StoredRun, second: StoredRun, what: str) -> RunDirectoryError:
    return RunDirectoryError(
        f"{first.folder} and {second.folder} show different truth, in {what}. Runs are compared side by side if their "
        f"detectors looked at the same: modsim3d detect {first.folder} --detector FILE or --seed N makes one"
    )


def _first_difference(one: pa.Table, other: pa.Table) -> str:
    if len(one) != len(other):
        return f"the number of vessels in frames: {len(one)} against {len(other)}"
    for name in one.column_names:
        first, second = one[name].combine_chunks(), other[name].combine_chunks()
        if first.equals(second):
            continue
        values = zip(first.to_pylist(), second.to_pylist(), strict=True)
        row = next(row for row, (a, b) in enumerate(values) if a != b and not (a != a and b != b))
        step, camera = one["step"][row], one["camera"][row]
        return f"{name} of {one['vessel'][row]} at step {step} of camera {camera}: {first[row]} against {second[row]}"
    return "its columns"


@dataclass(frozen=True, eq=False)
class Differences:
    """Stretches of shown steps in which two detectors made different things of a vessel, by camera, vessel and step.

    Attributes:
        camera: Index of the camera of each stretch, shape (d,).
        vessel: Index of the vessel, shape (d,).
        index: First shown step, shape (d,).
        until: Last shown step, shape (d,).
        outcomes: Numbers of the `VesselOutcome` in the first and the second run, shape (d, 2).
    """

    camera: Indices
    vessel: Indices
    index: Indices
    until: Indices
    outcomes: Indices


def differences(first: Sequence[OutcomeStretches], second: Sequence[OutcomeStretches]) -> Differences:
    """Where two runs of the same truth differ, from what became of the vessels of each camera in them."""
    parts = []
    for camera, (one, other) in enumerate(zip(first, second, strict=True)):
        span = int(one.until.max(initial=0)) + 1
        begins = [stretches.vessel * span + stretches.first for stretches in (one, other)]
        begin = np.union1d(*begins)  # each run's outcome changes at some of them
        row, other_row = (np.searchsorted(each, begin, side="right") - 1 for each in begins)
        outcomes = np.column_stack([one.outcome[row], other.outcome[other_row]])
        vessel, index = np.divmod(begin, span)
        until = np.minimum(one.until[row], other.until[other_row])
        differs = outcomes[:, 0] != outcomes[:, 1]
        columns = np.full(len(begin), camera), vessel, index, until, outcomes
        parts.append([column[differs] for column in columns])
    return Differences(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def difference_columns(found: Differences) -> dict[str, Column | Coded]:
    """The differences for the player of a page, in order of camera and first step."""
    order = np.lexsort((found.vessel, found.index, found.camera))
    return {
        "camera": Coded(found.camera[order].astype(np.uint16), by=ROW_BEFORE),
        "vessel": found.vessel[order].astype(np.uint16),
        "index": Coded(found.index[order].astype(np.uint32), by=ROW_BEFORE),
        "long": Coded((found.until - found.index)[order].astype(np.uint32)),
        "outcomes": found.outcomes[order].astype(np.uint8),
    }
