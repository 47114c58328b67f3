"""What `modsim3d detect --truth` prints."""

from __future__ import annotations

from typing import TYPE_CHECKING

from modsim3d.commands.run_summary import (
    CAMERA_HEADER,
    Row,
    camera_row,
    detection_rows,
    gate_rows,
    iou_warnings,
    vessel_rows,
)
from modsim3d.commands.shared import print_line, print_path
from modsim3d.commands.tables import print_prose, print_table
from modsim3d.commands.terminal import open_console, warn

if TYPE_CHECKING:
    from modsim3d.other_truth.detect_truth import TruthResult

MOST_SEQUENCES = 50
"""More are in `detect.json` alone."""


def print_truth_summary(result: TruthResult) -> None:
    """Print what happened, what was left out, and where the files are."""
    console = open_console()
    print_table(console, "", _rows(result), right=(1,), styles=("bold", "", "dim"))
    if 1 < len(result.sequence_counts) <= MOST_SEQUENCES:
        rows = [camera_row(name, counts) for name, counts in result.sequence_counts.items()]
        console.print()
        print_table(console, "", rows, header=("sequence", *CAMERA_HEADER[1:]), right=range(1, len(CAMERA_HEADER)))
    print_line(console, "")
    for note in result.notes:
        print_prose(console, f"Note: {note}.")
    if result.notes:
        print_line(console, "")
    print_path(console, "folder", result.folder)
    for warning in truth_warnings(result):
        warn(warning)


def _rows(result: TruthResult) -> list[Row]:
    counts, sequences = result.counts, len(result.sequence_counts)
    many = f"{sequences} sequence{'s' if sequences > 1 else ''}, from {result.kind}"
    return [
        ("frames", str(counts.frames), many),
        *vessel_rows(counts),
        *detection_rows(counts),
        *gate_rows(counts),
    ]


def truth_warnings(result: TruthResult) -> list[str]:
    """What a user should know before using the files, each a sentence."""
    nothing = [] if result.counts.annotated else ["no box of the truth is to be detected: there are only false alarms"]
    return nothing + iou_warnings(result.counts)
