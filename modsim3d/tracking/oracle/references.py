"""The references that stand beside every score: the detections of a run, each with the vessel that it came from."""

from __future__ import annotations

from modsim3d.runs.run_rows import RunRows
from modsim3d.tracking.oracle.association import oracle_tracks
from modsim3d.tracking.scores.rules import Rules
from modsim3d.tracks.tracks import Tracks
from modsim3d.tracks.true_tracks import TrueTracks

SMOOTHED, RAW = "smoothed", "raw"
REFERENCES = {SMOOTHED: "oracle association, smoothed", RAW: "oracle association, raw boxes"}
"""What tables call them."""


def reference_tracks(rows: RunRows, rules: Rules) -> dict[str, Tracks]:
    """The tracks of the references, by their keys."""
    truth = TrueTracks.of(rows, rules.truth, rules.gap_s)
    return {name: oracle_tracks(rows, truth, smoothed=name == SMOOTHED) for name in REFERENCES}
