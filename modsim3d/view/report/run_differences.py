"""Two runs of the same truth: whether they are that, and where their detectors made different things of a vessel."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from modsim3d.arrays import Indices
from modsim3d.errors import RunDirectoryError
from modsim3d.runs.files.columns import NOBODY
from modsim3d.runs.outcomes import Outcome, having
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.view.report.packing import ROW_BEFORE, Coded, Column

DETECTORS_OWN = "detected"
"""The column of the truth that depends on the detector."""


class VesselOutcome(IntEnum):
    """What a detector made of a vessel in a frame, from good to bad; NONE where it was not given to the detector."""

    NONE = 0
    RIGHT = 1
    BELOW_HALF_IOU = 2
    MISLABELLED = 3
    OFF_VESSEL = 4
    MISSED = 5


def check_same_truth(first: StoredRun, second: StoredRun) -> None:
    """Raise an error if two runs do not hold the same truth.

    Raises:
        RunDirectoryError: Cameras, vessels, steps or a row of the truth differ.
    """
    for name, one, other in (
        ("cameras", *([camera.name for camera in run.scene.cameras] for run in (first, second))),
        ("vessels", *(list(run.scene.vessel_names) for run in (first, second))),
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


def vessel_outcomes(rows: RunRows) -> NDArray[np.uint8]:
    """The `VesselOutcome` of each row of the truth, shape (n,); of a box around two vessels, both are RIGHT."""
    outcome = np.where(rows.annotated, VesselOutcome.MISSED, VesselOutcome.NONE).astype(np.uint8)
    outcome[rows.annotated & rows.detected] = VesselOutcome.RIGHT
    own = rows.detected_row != NOBODY
    row, flags = rows.detected_row[own], rows.outcomes[own]
    for flag in (Outcome.BELOW_HALF_IOU, Outcome.MISLABELLED, Outcome.OFF_VESSEL):  # the worst is written last
        outcome[row[having(flags, flag)]] = VesselOutcome[str(flag.name)]
    return outcome


@dataclass(frozen=True, eq=False)
class Differences:
    """Stretches of shown steps in which two detectors made different things of a vessel, by camera, vessel and step.

    Attributes:
        camera: Index of the camera of each stretch, shape (d,).
        vessel: Index of the vessel, shape (d,).
        index: First shown step, shape (d,).
        until: Last shown step, shape (d,).
        outcomes: The `VesselOutcome` in the first and the second run, shape (d, 2).
    """

    camera: Indices
    vessel: Indices
    index: Indices
    until: Indices
    outcomes: NDArray[np.uint8]


def differences(first: RunRows, second: RunRows, every: int = 1) -> Differences:
    """Where two runs of the same truth differ, at every K-th step.

    A camera with a frame rate of its own shows the last frame that it took.
    """
    cameras, vessels = len(first.scene.cameras), len(first.scene.vessels)
    taken = first.last_taken(np.arange(0, first.steps, every))
    made = np.column_stack([vessel_outcomes(first), vessel_outcomes(second)])
    parts = []
    for camera in range(cameras):
        here = first.truth_frame % cameras == camera
        by_step = np.zeros((first.steps + 1, vessels, 2), dtype=np.uint8)  # the last one: no frame yet, or NOBODY
        by_step[first.truth_frame[here] // cameras, first.truth_vessel[here]] = made[here]
        shown = by_step[taken[:, camera]].transpose(1, 0, 2)
        differs = shown[..., 0] != shown[..., 1]
        keyed = np.where(differs, 1 + shown[..., 0].astype(np.int16) * len(VesselOutcome) + shown[..., 1], 0)
        edges = np.diff(np.pad(keyed, ((0, 0), (1, 1))), axis=1)
        vessel, begin = np.nonzero((edges != 0)[:, :-1] & differs)
        _, end = np.nonzero((edges != 0)[:, 1:] & differs)
        parts.append((np.full(len(vessel), camera), vessel, begin, end, shown[vessel, begin]))
    return Differences(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def difference_columns(found: Differences) -> dict[str, Column | Coded]:
    """The differences for the player of a page, in order of camera and first step."""
    order = np.lexsort((found.vessel, found.index, found.camera))
    return {
        "camera": Coded(found.camera[order].astype(np.uint16), by=ROW_BEFORE),
        "vessel": found.vessel[order].astype(np.uint16),
        "index": Coded(found.index[order].astype(np.uint32), by=ROW_BEFORE),
        "long": Coded((found.until - found.index)[order].astype(np.uint32)),
        "outcomes": found.outcomes[order],
    }
