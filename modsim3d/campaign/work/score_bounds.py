"""Between which values each score lies by its definition."""

from __future__ import annotations

import math

from modsim3d.campaign.file.keys import ScoreKeys
from modsim3d.campaign.work.row import SUBSET_KEYS

SHARES = frozenset(
    (
        *("hota", "deta", "assa", "detre", "detpr", "assre", "asspr", "loca", "motp", "idf1", "idp", "idr"),
        *("siap_completeness", "siap_spuriousness", "siap_longest_track_share", "established_share"),
        *("hidden_followed", "hidden_same_track", "occlusions_survived"),
    )
)
"""Scores from 0 to 1."""
OF_STATES = tuple(name for name in SUBSET_KEYS if "frames" not in name)
"""Scores that a run has for each performance state too."""


def score_bounds(score: str, keys: ScoreKeys) -> tuple[float, float]:
    """The least and the greatest value that a score can have; infinite where there is none.

    Args:
        score: A key of the scores.
        keys: How tracks are scored.
    """
    if score in SHARES:
        return 0.0, 1.0
    if score == "mota":
        return -math.inf, 1.0
    return 0.0, keys.gospa_c if score == "ospa" else math.inf


def is_bounded(score: str, keys: ScoreKeys) -> bool:
    """Whether a score lies between two numbers."""
    return all(math.isfinite(bound) for bound in score_bounds(score, keys))
