"""What each score can be by its definition: its bounds, whose fault it is if it is undefined, and what it rests on."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from modsim3d.arrays import Array
from modsim3d.campaign.file.keys import Requirement, ScoreKeys
from modsim3d.campaign.plan.selection import CAMERA, GROUPS, STATE
from modsim3d.campaign.work.row import SUBSET_KEYS

Columns = Callable[[str], Array]
"""Gives the column of a name, NaN where a row has nothing there."""
RECALL, SURVIVED = "recall", "occlusions_survived"
SCORES_BY = dict.fromkeys(GROUPS, (RECALL,)) | {
    **dict.fromkeys((STATE, CAMERA), tuple(name for name in SUBSET_KEYS if "frames" not in name)),
    "occlusion": (RECALL, SURVIVED),
}
"""Scores that the parts of a run have too, by what divides it."""


@dataclass(frozen=True)
class Basis:
    """The share of what is to be followed on which a score rests: one column over the sum of others.

    Attributes:
        of: What it is a share of.
        part: The column that is divided.
        whole: Those that it is divided by; none if it is a share already.
    """

    of: str
    part: str
    whole: tuple[str, ...] = ()

    def share(self, column: Columns) -> Array:
        """The share in each row; NaN where there is nothing to follow."""
        part = column(self.part)
        whole = sum((column(name) for name in self.whole), np.zeros_like(part)) if self.whole else np.ones_like(part)
        share: Array = np.divide(part, whole, out=np.full_like(part, np.nan), where=whole > 0)
        return share


FOLLOWED = Basis("vessel-frames", "true_positives", ("true_positives", "misses"))


@dataclass(frozen=True)
class ScoreFacts:
    """A score.

    Attributes:
        least: The least value that it can have.
        greatest: The greatest.
        managed: Whether it is a mean over what the tracker follows or reports. Then a tracker that gives up improves
            it, and one that does nothing leaves it undefined. If not, only the truth can leave it undefined.
        expected: The column with the number of things in the truth that a tracker could be scored on: where there are
            none, the truth alone leaves it undefined, managed or not.
        of_faults: Whether it is a mean over things that went wrong: it is undefined also where nothing did.
        basis: The share that it rests on.
        without_tracks: Its value without any track; None if it has none, or if it depends on the truth.
    """

    least: float = 0.0
    greatest: float = math.inf
    managed: bool = False
    expected: str = "appearances"
    of_faults: bool = False
    basis: Basis = FOLLOWED
    without_tracks: float | None = 0.0


_SHARE = ScoreFacts(greatest=1.0)
_MEAN = ScoreFacts(managed=True, without_tracks=None)
_MANAGED_SHARE = ScoreFacts(greatest=1.0, managed=True, without_tracks=None)
_OF_FAULTS = ScoreFacts(managed=True, of_faults=True, without_tracks=None)
_WAIT = ScoreFacts(managed=True, basis=Basis("appearances", "established_share"), without_tracks=None)
_NEES = ScoreFacts(
    managed=True, basis=Basis("vessel-frames", "nees_pairs", ("true_positives", "misses")), without_tracks=None
)
_OF_TRUTH = ScoreFacts(without_tracks=None)
_SURVIVED = ScoreFacts(
    greatest=1.0,
    managed=True,
    expected="occlusions_to_survive",
    basis=Basis("occlusions", "occlusions_judged", ("occlusions_to_survive",)),
    without_tracks=None,
)
_FAMILIES = {
    "hota deta detre idf1 idr siap_completeness siap_longest_track_share established_share": _SHARE,
    "hidden_followed hidden_same_track": _SHARE,
    "assa assre asspr loca detpr motp idp siap_spuriousness": _MANAGED_SHARE,
    "siap_ambiguity siap_positional_accuracy_px siap_id_changes_per_s tracks_per_vessel track_breaks_per_hour": _MEAN,
    "rmse_px median_error_px rmse_width_px rmse_height_px": _MEAN,
    "nees anees": _NEES,
    "time_to_establish_s longest_time_to_establish_s": _WAIT,
    "mean_track_break_s longest_track_break_s mean_false_track_s": _OF_FAULTS,
    SURVIVED: _SURVIVED,
    RECALL: ScoreFacts(greatest=1.0, expected="vessel_frames", basis=Basis("vessel-frames", RECALL)),
    "misses mostly_lost gospa gospa_missed ospa": _OF_TRUTH,
    "appearances hidden_vessel_frames occlusions occlusions_to_survive": _OF_TRUTH,
    "mota": ScoreFacts(least=-math.inf, greatest=1.0),
}
_KNOWN = {name: facts for names, facts in _FAMILIES.items() for name in names.split()}
SHARES = frozenset(name for name, facts in _KNOWN.items() if (facts.least, facts.greatest) == (0.0, 1.0))
"""Scores from 0 to 1."""


def facts_of(score: str, group: str = "") -> ScoreFacts:
    """Facts of a score, or of that of a part of a run; others are numbers of things, and times, of 0 or more.

    The rows have no number of matches by state or camera: `deta` is never above the share that is followed.
    """
    facts = _KNOWN.get(score, ScoreFacts())
    if group not in (STATE, CAMERA):
        return facts
    return replace(facts, expected="vessel_frames", basis=Basis(f"the {group}, by its deta", "deta"))


def without_tracks(score: str, keys: ScoreKeys, column: Columns) -> Array | None:
    """The value that each row would have without any track, or one that it would not exceed; None if unknown."""
    if (value := facts_of(score).without_tracks) is not None:
        return np.full_like(column("frames"), value)
    vessel_frames, alone = column("true_positives") + column("misses"), keys.gospa_c**keys.gospa_p / 2
    missed = alone * vessel_frames / column("frames")
    found = {
        "misses": vessel_frames,
        "mostly_lost": column("appearances"),
        "gospa_missed": missed,
        "gospa": missed ** (1 / keys.gospa_p),  # at most, by Jensen's inequality; exact for p = 1
        "ospa": np.full_like(missed, keys.gospa_c),  # at most
    }
    return found.get(score)


def score_bounds(score: str, keys: ScoreKeys) -> tuple[float, float]:
    """The least and the greatest value that a score can have; infinite where there is none.

    Args:
        score: A key of the scores.
        keys: How tracks are scored.
    """
    facts = facts_of(score)
    return facts.least, keys.gospa_c if score == "ospa" else facts.greatest


def limits_of(requirement: Requirement, keys: ScoreKeys) -> tuple[float, float]:
    """The same of what a requirement is about: a difference is no further from 0 than the bounds of its score are."""
    least, greatest = score_bounds(requirement.score, keys)
    return (least, greatest) if requirement.of is None else (least - greatest, greatest - least)


def is_bounded(score: str, keys: ScoreKeys) -> bool:
    """Whether a score lies between two numbers."""
    return all(math.isfinite(bound) for bound in score_bounds(score, keys))
