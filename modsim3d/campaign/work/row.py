"""The row of one run: what its scores are, as columns with types."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, get_type_hints

import pyarrow as pa

from modsim3d.campaign.file.keys import ScoreKeys
from modsim3d.campaign.plan.selection import CAMERA, STATE
from modsim3d.campaign.work.coverage import COVERED, MET, coverage_of, coverage_type
from modsim3d.campaign.work.layers import Made
from modsim3d.campaign.work.worst_moment import worst_moment_s
from modsim3d.tracking.report.numbers import keys_of
from modsim3d.tracking.scores.breakdown import BINS, Group
from modsim3d.tracking.scores.rules import Rules, SetDistance
from modsim3d.tracking.scores.scored import Scored
from modsim3d.tracking.scores.scoring import Part, SubsetScores, scores_of
from modsim3d.tracks.similarity import Similarity

DONE, CRASHED = "done", "crashed"
KEY_LENGTH = 16
"""Hexadecimal digits of a layer's checksum in a table."""
FACTS: dict[str, pa.DataType] = {
    "run": pa.int64(),
    "status": pa.string(),
    "error": pa.string(),
    "truth_key": pa.string(),
    "detections_key": pa.string(),
    "detections_sha256": pa.string(),
    "tracks_key": pa.string(),
    "simulated_s": pa.float64(),
    "frames": pa.int64(),
    "worst_s": pa.float64(),
}
"""Columns that every row has, before those of the scores."""
SUBSET_KEYS = ("frames", "vessel_frames", "hota", "deta", "assa", "mota", "idf1")


def _score_types() -> dict[str, pa.DataType]:
    """The scores of everything that are one number each, in their order."""
    hints = {name: hint for part in Part.__args__ for name, hint in get_type_hints(part).items()}
    numbers = {name: hint for name, hint in hints.items() if "tuple" not in str(hint)}
    return {name: pa.int64() if hint is int else pa.float64() for name, hint in numbers.items()}


SCORES = _score_types()
"""The scores of a whole run, with their types."""
_WHOLE = {"frames", "vessel_frames"}
_BIN_KEYS = (
    ("vessel_frames", "vessel_frames"),
    ("recall", "recall"),
    ("occlusions", "occlusions"),
    ("occlusions_judged", "judged"),
    ("occlusions_survived", "survived"),
    ("occlusions_to_survive", "to_survive"),
)
"""Columns of a bin, and what the breakdown calls them; all but two only of occlusions."""


def rules_of(keys: ScoreKeys) -> Rules:
    """The rules of a campaign's scores."""
    similarity = Similarity(keys.similarity, keys.scale_px, keys.threshold)
    return Rules(keys.truth, keys.gap_s, similarity, set_distance=SetDistance(keys.gospa_c, keys.gospa_p))


def row_of(number: int, made: Made, rules: Rules) -> dict[str, Any]:
    """The row of a run.

    Args:
        number: The run's number.
        made: Its layers.
        rules: By which tracks are scored.
    """
    scene, scored = made.rows.scene, Scored.of(made.rows, made.tracks, rules)
    scores = scores_of(scored)
    times_s = scene.times_s(0, scene.steps)
    row = {
        "run": number,
        "status": DONE,
        "error": None,
        "truth_key": made.truth_key[:KEY_LENGTH],
        "detections_key": made.detections_key[:KEY_LENGTH],
        "detections_sha256": made.rows.detections_sha256[:KEY_LENGTH],
        "tracks_key": made.tracks_key[:KEY_LENGTH],
        "simulated_s": float(times_s[-1] - times_s[0]),
        "frames": len(made.rows.frames),
        "worst_s": worst_moment_s(scored),
        **keys_of(scores),
        **coverage_of(made.rows),
    }
    if len(scene.detector.states) > 1:
        row |= _subset(STATE, scores.by_state)
    if len(scene.cameras) > 1:
        row |= _subset(CAMERA, scores.by_camera)
    for group in scores.breakdown:
        row |= _bins(group)
    return row


def crashed_row(number: int, error: str) -> dict[str, Any]:
    """The row of a run that failed."""
    return {"run": number, "status": CRASHED, "error": error}


def _subset(group: str, parts: Mapping[str, SubsetScores]) -> dict[str, Any]:
    return {f"{group}.{name}.{key}": getattr(part, key) for name, part in parts.items() for key in SUBSET_KEYS}


def _bins(group: Group) -> dict[str, Any]:
    """The columns of a group whose bins are the same in every run, also of bins without vessel-frames."""
    keys = _BIN_KEYS if group.name == "occlusion" else _BIN_KEYS[:2]
    none = dict.fromkeys((name for _, name in keys), 0) | {"recall": None, "survived": None}
    found = {each.bin: vars(each) for each in group.rows}
    return {
        f"{group.name}.{name}.{key}": found.get(name, none)[value]
        for name in BINS.get(group.name, ())
        for key, value in keys
    }


def column_type(name: str) -> pa.DataType:
    """The type of a column of a row."""
    if name in FACTS:
        return FACTS[name]
    if name in SCORES:
        return SCORES[name]
    if name.startswith((MET, COVERED)):
        return coverage_type(name)
    key = name.rpartition(".")[2]
    return pa.int64() if key in _WHOLE else SCORES.get(key, pa.float64())


def table_of(rows: Iterable[Mapping[str, Any]]) -> pa.Table:
    """Rows as a table; its columns are those of `FACTS`, those of `SCORES`, and the others by name."""
    rows = list(rows)
    others = sorted({name for row in rows for name in row} - {*FACTS, *SCORES})
    names = [*FACTS, *SCORES, *others]
    return pa.table({name: pa.array([row.get(name) for row in rows], type=column_type(name)) for name in names})
