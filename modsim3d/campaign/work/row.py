"""The row of one run: what its scores are, as columns with types."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from typing import Any, get_type_hints

import numpy as np
import orjson
import pyarrow as pa

from modsim3d.campaign.keys import TIMES, CampaignKeys, Requirement, ScoreKeys, SearchKeys, WorldScoreKeys
from modsim3d.campaign.plan import CAMERA, GROUPS, STATE, Plan
from modsim3d.campaign.work.coverage import COVERED, MET, coverage_of, coverage_type
from modsim3d.campaign.work.layers import LayeredRun
from modsim3d.core.arrays import Array, Indices
from modsim3d.core.errors import ModsimError
from modsim3d.io.coprocess import CoprocessError
from modsim3d.io.validation import nearest
from modsim3d.runs.run_rows import RunRows
from modsim3d.tracking.lookout import approaches, tracks_in_images, tracks_in_world
from modsim3d.tracking.score_text import keys_of
from modsim3d.tracking.scores.breakdown import BINS, Group
from modsim3d.tracking.scores.scored_run import Rules, ScoredRun, SetDistance
from modsim3d.tracking.scores.scoring import Part, SubsetScores, scores_of
from modsim3d.tracking.world.following import WorldTruth, follow_in_world
from modsim3d.tracking.world.scoring import score_world
from modsim3d.tracking.worst_moment import worst_moment_s
from modsim3d.tracks.tracks import Similarity, WorldTracks

APPROACHES = "approaches"  # column of the approaches of vessels as JSON, in campaigns that have a lookout requirement
DONE, CRASHED = "done", "crashed"
REPEATS = "repeats"  # column that says whether the output of a program was the same again
SAID = "standard_error"  # column of the last lines that a program wrote, which may be others each time
KEY_LENGTH = 16  # hexadecimal digits of a layer's checksum in a table
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


SCORES = _score_types()  # the scores of a whole run, with their types
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


def row_of(number: int, made: LayeredRun, keys: ScoreKeys, lookout: bool = False) -> dict[str, Any]:
    """Row of a run, scored by the keys; what the tracker took stands beside the scores, and `lookout` asks for its
    approaches too."""
    row = _common(number, made)
    if isinstance(made.tracks, WorldTracks):
        world = keys.in_world or WorldScoreKeys()
        cpa = {name: getattr(world, name) for name in ("right_m", "before_s", "alarm_m")}
        distance = SetDistance(world.gospa_c_m, world.gospa_p)
        values = score_world(made.rows, made.tracks, world.gate_m, distance, cpa=cpa).flat()
        if lookout:
            following = follow_in_world(WorldTruth.of(made.rows), made.tracks, world.gate_m)
            row[APPROACHES] = _approaches_text(made.rows, tracks_in_world(made.rows, following))
        return row | {world_column(name): values[name] for name in values if world_column(name) in WORLD_SCORES}
    scene, scored = made.rows.scene, ScoredRun.of(made.rows, made.tracks, rules_of(keys))
    scores = scores_of(scored)
    row |= {"worst_s": worst_moment_s(scored), **keys_of(scores)}
    if len(scene.detector.states) > 1:
        row |= _subset(STATE, scores.by_state)
    if len(scene.cameras) > 1:
        row |= _subset(CAMERA, scores.by_camera)
    for group in scores.breakdown:
        row |= _bins(group)
    if lookout:
        row[APPROACHES] = _approaches_text(made.rows, tracks_in_images(made.rows, scored.following))
    return row


def _common(number: int, made: LayeredRun) -> dict[str, Any]:
    scene = made.rows.scene
    times_s = scene.times_s(0, scene.steps)
    return {
        "run": number,
        "status": DONE,
        "error": None,
        "truth_key": made.truth_key[:KEY_LENGTH],
        "detections_key": made.detections_key[:KEY_LENGTH],
        "detections_sha256": made.rows.detections_sha256[:KEY_LENGTH],
        "tracks_key": made.tracks_key[:KEY_LENGTH],
        "simulated_s": float(times_s[-1] - times_s[0]),
        "frames": len(made.rows.frames),
        **coverage_of(made.rows),
        **made.took,
    }


def _approaches_text(rows: RunRows, track: Indices) -> str:
    """All approaches as JSON; `track` is as in `tracks_in_images`."""
    return orjson.dumps(list(approaches(rows, track))).decode()


def crashed_row(number: int, error: str, **more: str) -> dict[str, Any]:
    """The row of a run that failed, with more columns."""
    return {"run": number, "status": CRASHED, "error": error, **more}


def error_and_said(error: Exception) -> tuple[str, str]:
    """An error as a row has it, and what a program wrote to standard error before it."""
    if isinstance(error, CoprocessError):
        return f"{type(error).__name__}: {error.problem}", error.stderr
    return f"{type(error).__name__}: {error}", ""


def error_text(row: Mapping[str, Any]) -> str:
    """The error of a row, with what a program wrote to standard error."""
    return f"{row['error']}; standard error: {row[SAID]}" if row.get(SAID) else row["error"] or "unknown"


def _subset(group: str, parts: Mapping[str, SubsetScores]) -> dict[str, Any]:
    return {f"{group}.{name}.{key}": getattr(part, key) for name, part in parts.items() for key in SUBSET_KEYS}


def _bins(group: Group) -> dict[str, Any]:
    """The columns of a group whose bins are the same in every run, also of bins without vessel-frames."""
    keys = _BIN_KEYS if group.name == "occlusion" else _BIN_KEYS[:2]
    none = dict.fromkeys((name for _, name in keys), 0) | {"recall": None, "survived": None}
    by_bin = {row.bin: vars(row) for row in group.rows}
    return {
        f"{group.name}.{name}.{key}": by_bin.get(name, none)[value]
        for name in BINS.get(group.name, ())
        for key, value in keys
    }


def column_type(name: str) -> pa.DataType:
    """The type of a column of a row."""
    if name in FACTS:
        return FACTS[name]
    if name in SCORES or name in WORLD_SCORES:
        return SCORES[name] if name in SCORES else WORLD_SCORES[name]
    if name == REPEATS:
        return pa.bool_()
    if name in (APPROACHES, SAID):
        return pa.string()
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


# ---- What each score can be by its definition ----

Columns = Callable[[str], Array]  # gives the column of a name, NaN where a row has nothing there
RECALL, SURVIVED = "recall", "occlusions_survived"
SCORES_BY = dict.fromkeys(GROUPS, (RECALL,)) | {
    **dict.fromkeys((STATE, CAMERA), tuple(name for name in SUBSET_KEYS if "frames" not in name)),
    "occlusion": (RECALL, SURVIVED),
}
"""Scores that the parts of a run have too, by what divides it."""


@dataclass(frozen=True)
class Basis:
    """The share of what is to be followed on which a score rests: one column over the sum of others."""

    of: str  # what it is a share of
    part: str
    whole: tuple[str, ...] = ()  # none if `part` is a share already

    def share(self, column: Columns) -> Array:
        """The share in each row; NaN where there is nothing to follow."""
        part = column(self.part)
        whole = sum((column(name) for name in self.whole), np.zeros_like(part)) if self.whole else np.ones_like(part)
        share: Array = np.divide(part, whole, out=np.full_like(part, np.nan), where=whole > 0)
        return share


FOLLOWED = Basis("vessel-frames", "true_positives", ("true_positives", "misses"))


@dataclass(frozen=True)
class ScoreFacts:
    """Facts of a score. It is `managed` if it is a mean over what the tracker follows or reports: then a tracker that
    gives up improves it, and one that does nothing leaves it undefined. If not, only the truth can leave it undefined.
    `expected` is the column with the number of things in the truth that a tracker could be scored on: where there are
    none, the truth alone leaves it undefined, managed or not."""

    least: float = 0.0
    greatest: float = math.inf
    managed: bool = False
    expected: str = "appearances"
    of_faults: bool = False  # a mean over things that went wrong: undefined also where nothing did
    basis: Basis = FOLLOWED  # the share that it rests on
    without_tracks: float | None = 0.0  # value without any track; None if it has none, or if it depends on the truth
    low_is_good: bool = False  # of a share
    worst_undefined: bool = False  # where it is undefined and there is something in the truth, it is worse than any


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
    "assa assre asspr loca detpr motp idp": _MANAGED_SHARE,
    "siap_spuriousness": replace(_MANAGED_SHARE, low_is_good=True),
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
_SEEN = ScoreFacts(expected="vessels")
_OF_FOLLOWED = replace(_SEEN, managed=True, basis=Basis("the time in view", "followed_share"), without_tracks=None)
_ESTABLISHED = replace(_SEEN, expected="encounters", worst_undefined=True, without_tracks=None)
_IN_VIEW = replace(_SEEN, expected="cpa_in_view")
_PREDICTED = Basis("encounters in view", "cpa_predicted", ("cpa_in_view",))
_WORLD_FAMILIES = {
    "rmse_m rmse_m_s world_nees nees_velocity nees_state world_anees anees_velocity anees_state": _OF_FOLLOWED,
    "followed_share": replace(_SEEN, greatest=1.0),
    "gospa_m gospa_missed_m t_gospa_m t_gospa_missed_m vessels encounters": replace(_SEEN, without_tracks=None),
    "ospa2_m": replace(_SEEN, without_tracks=None),
    "gospa_localisation_m gospa_false_m world_false_track_s": _SEEN,
    "t_gospa_localisation_m t_gospa_false_m t_gospa_switch_m": _SEEN,
    "cpa_right_share": replace(_IN_VIEW, greatest=1.0),
    "cpa_error_m tcpa_error_s": replace(_IN_VIEW, managed=True, basis=_PREDICTED, without_tracks=None),
    "cpa_in_view cpa_alarms_due cpa_missed_alarms": replace(_SEEN, without_tracks=None),
    "established_m established_m_lower established_m_upper": _ESTABLISHED,
    "time_left_s time_left_s_lower time_left_s_upper": _ESTABLISHED,
}
_WORLD_COUNTS = (
    *("pairs", "vessels", "world_established", "world_id_switches", "world_track_breaks", "world_false_tracks"),
    *("encounters", "encounters_established", "cpa_in_view", "cpa_predicted", "cpa_alarms_due"),
    *("cpa_missed_alarms", "cpa_false_alarms", "cpa_ghost_alarms"),
)
WORLD_SCORES: dict[str, pa.DataType] = {
    name: pa.int64() if name in _WORLD_COUNTS else pa.float64()
    for name in dict.fromkeys([*" ".join(_WORLD_FAMILIES).split(), *_WORLD_COUNTS])
}
"""The scores of tracks in the world, with their types."""


def world_column(name: str) -> str:
    """The column of a score of tracks in the world: its name, with `world_` before one that the images have too."""
    return f"world_{name}" if name in SCORES else name


_FAMILIES |= _WORLD_FAMILIES | {" ".join(_WORLD_COUNTS): _SEEN} | {" ".join(TIMES): ScoreFacts(without_tracks=None)}
_KNOWN = {name: facts for names, facts in reversed(_FAMILIES.items()) for name in names.split()}
SHARES = frozenset(name for name, facts in _KNOWN.items() if (facts.least, facts.greatest) == (0.0, 1.0))
"""Scores from 0 to 1."""


def facts_of(score: str, group: str = "") -> ScoreFacts:
    """Facts of a score, or of that of a part of a run; others are numbers of things, and times, of 0 or more. The rows
    have no number of matches by state or camera: `deta` is never above the share that is followed."""
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
    scores = {
        "misses": vessel_frames,
        "mostly_lost": column("appearances"),
        "gospa_missed": missed,
        "gospa": missed ** (1 / keys.gospa_p),  # at most, by Jensen's inequality; exact for p = 1
        "ospa": np.full_like(missed, keys.gospa_c),  # at most
    }
    return scores.get(score)


def score_bounds(score: str, keys: ScoreKeys) -> tuple[float, float]:
    """The least and the greatest value that a score can have; infinite where there is none."""
    facts = facts_of(score)
    of_cutoff = {"ospa": keys.gospa_c, "ospa2_m": (keys.in_world or WorldScoreKeys()).gospa_c_m}
    return facts.least, of_cutoff.get(score, facts.greatest)


def limits_of(requirement: Requirement, keys: ScoreKeys) -> tuple[float, float]:
    """Bounds of what a requirement is about; a difference has the width of its score's bounds on both sides of 0."""
    least, greatest = score_bounds(requirement.score, keys)
    return (least, greatest) if requirement.of is None else (least - greatest, greatest - least)


def is_bounded(score: str, keys: ScoreKeys) -> bool:
    """Whether a score lies between two numbers."""
    return all(math.isfinite(bound) for bound in score_bounds(score, keys))


MAX_CHOSEN_SEEDS = 1_000  # each seed is a category of the estimator, whose time grows with their number
NOT_SEARCHED = ("seed", "detector_seed", "steps", "scene", "tracker")


def search_problems(keys: CampaignKeys) -> Iterator[str]:
    """Problems of a campaign's search, if it has one."""
    if keys.search is None:
        return
    search, plan = keys.search, Plan.of(keys)
    score = search.minimise or search.maximise or ""
    if score not in (names := (*SCORES, *WORLD_SCORES)):
        name = "minimise" if search.minimise is not None else "maximise"
        yield f"search.{name}: there is no score '{score}' ({nearest(score, names)})"
    if (count := len(plan.conditions)) > 1:
        yield f"search: needs one scene and one condition, and there are {count}: search each in a campaign of its own"
    if plan.drawn:
        yield f"vary: '{plan.drawn[0]}' is drawn, which does not go with search: put its range into search.over"
    if len(keys.trackers) > 1:
        yield f"search: needs one tracker, and there are {len(keys.trackers)}: search each in a campaign of its own"
    for key in ("require", "stop", "seeds", "uncertainty"):
        if key in keys.model_fields_set:
            hint = "; search.seeds is the number of seeds to choose from" if key == "seeds" else ""
            yield f"{key}: does not go with search, whose trials are chosen to be bad and make no rate{hint}"
    if "batch" in keys.model_fields_set:
        yield "batch: does not go with search: search.batch is the number of trials that are proposed at once"
    yield from _range_problems(plan, search)


def _range_problems(plan: Plan, search: SearchKeys) -> Iterator[str]:
    if search.seeds > MAX_CHOSEN_SEEDS:
        yield f"search.seeds: at most {MAX_CHOSEN_SEEDS:,} can be chosen from (got {search.seeds:,})"
    for key in search.over:
        if key in NOT_SEARCHED:
            yield f"search.over: '{key}' cannot be searched; search.seeds is the number of seeds to choose from"
        if key in plan.parameters:
            yield f"search.over: '{key}' is in vary too"


def search_versions(keys: CampaignKeys) -> dict[str, str]:
    """Version of Optuna, if the campaign has a search, whose trials depend on it; ModsimError if it is missing."""
    if keys.search is None:
        return {}
    try:
        return {"optuna": version("optuna")}
    except PackageNotFoundError:
        raise ModsimError('a search needs Optuna: pip install "modsim3d[search]"') from None
