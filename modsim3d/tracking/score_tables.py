"""Scores as rows of tables and as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import pairwise
from typing import Any

from modsim3d.core.document import Table, Where
from modsim3d.core.text import UNKNOWN, counted, number
from modsim3d.tracking.oracle import RAW, REFERENCES, SMOOTHED
from modsim3d.tracking.run_scores import ScoredTracks, TrackScores, WorldTrackScores
from modsim3d.tracking.score_text import (
    COLUMNS,
    LengthBin,
    TrackerOutcome,
    conclusion,
    keys_of,
    percent,
)
from modsim3d.tracking.scores.breakdown import Bin
from modsim3d.tracking.scores.occlusions import LENGTH_EDGES_S, OcclusionEpisode
from modsim3d.tracking.scores.scored import Rules
from modsim3d.tracking.scores.scoring import Scores
from modsim3d.tracking.world.scoring import MetVessel

# ---- Scores of tracks in the world ----

WORLD_COLUMNS: tuple[tuple[str, str, int], ...] = (
    ("RMSE, m", "rmse_m", 1),
    ("RMSE, m/s", "rmse_m_s", 2),
    ("ANEES", "anees", 2),
    ("GOSPA, m", "gospa_m", 1),
    ("followed", "followed_share", 3),
    ("ID switches", "id_switches", 0),
    ("false tracks", "false_tracks", 0),
    ("established at, m", "established_m", 0),
    ("time left, s", "time_left_s", 0),
)
WORLD_HEADER = ("tracks in the world", *(name for name, _, _ in WORLD_COLUMNS))
ENCOUNTER_HEADER = (
    *("vessel", "own ship", "kind", "closest, m", "at, s"),
    *("first seen, s", "established, s", "at distance, m", "time left, s"),
)


def world_rows(scores: ScoredTracks) -> list[tuple[str, ...]]:
    """A line for each tracker, under `WORLD_HEADER`."""
    return [
        (each.name, *(number(each.scores.flat()[key], decimals) for _, key, decimals in WORLD_COLUMNS))
        for each in scores.world
    ]


def world_rules(each: WorldTrackScores) -> str:
    """How tracks in the world were scored."""
    distance = each.scores.set_distance
    return (
        f"A track follows a vessel within {each.scores.gate_m:g} m. GOSPA: c = {distance.cutoff:g} m, "
        f"p = {distance.power:g}. Errors are averaged within each vessel, then over vessels."
    )


def encounter_rows(encounters: Sequence[MetVessel]) -> list[tuple[str, ...]]:
    """A line for each encounter, under `ENCOUNTER_HEADER`."""
    return [
        (
            *(each.vessel, each.own_ship, each.kind.replace("_", " ")),
            *(number(each.closest_m, 0), number(each.closest_s, 1)),
            *(number(each.seen_s, 1), number(each.established_s, 1)),
            *(number(each.established_m, 0), number(each.time_left_s, 1)),
        )
        for each in encounters
    ]


def is_missed(met: MetVessel) -> bool:
    """Whether a camera saw the vessel, and no track ever followed it."""
    return met.seen_s is not None and met.established_s is None


def encounters_in_words(each: WorldTrackScores) -> str:
    """How many vessels met own ship, and which of them the table of encounters marks."""
    met = each.scores.encounters
    if not met:
        return f"{each.name}: no vessel came nearer to own ship."
    passed = sum(one.passed for one in met)
    said = f"{each.name}: {counted(len(met), 'vessel')} came nearer to own ship, and {passed} passed her in this run."
    return f"{said} Red: a camera saw the vessel, and no track followed it." if any(map(is_missed, met)) else said


def world_data(scores: ScoredTracks) -> list[dict[str, Any]]:
    """Entries of world tracks in `score.json`."""
    return [
        {
            "name": each.name,
            "tracks": each.path,
            "gate_m": each.scores.gate_m,
            "gospa_c_m": each.scores.set_distance.cutoff,
            "gospa_p": each.scores.set_distance.power,
            **each.scores.flat(),
            "each_encounter": [asdict(met) for met in each.scores.encounters],
        }
        for each in scores.world
    ]


def world_conclusion(scores: ScoredTracks) -> str:
    """The outcome of tracks in the world, a sentence for each tracker."""
    said = []
    for each in scores.world:
        keys = each.scores.flat()
        rmse, share = keys["rmse_m"], keys["followed_share"]
        if rmse is None:
            said.append(f"{each.name} follows no vessel in the world.")
            continue
        met = keys["encounters"]
        said.append(
            f"{each.name} follows vessels in the world with an error of {rmse:.1f} m (RMSE), for "
            f"{UNKNOWN if share is None else f'{100 * share:.0f} %'} of the time that it should"
            + (f", and {keys['encounters_established']} of the {met} that met own ship." if met else ".")
        )
    return " ".join(said)


HEADER = ("tracker", *(name for name, _, _ in COLUMNS), "occlusions survived")
SEED_HEADER = ("tracker", "score", "mean", "standard deviation", "95 % of the mean")
HIDDEN_HEADER = ("tracker", "vessel-frames", "followed", "by the track from before")
OCCLUSION_HEADER = ("camera", "vessel", "from", "length", "least visible", "track before", "track after", "survived")
PART_COLUMNS = COLUMNS[:5]
PART_HEADER = ("", "tracker", *(name for name, _, _ in PART_COLUMNS))
ONE_RUN = (
    "One run is one sample: over seeds the HOTA of a tracker has a standard deviation of up to 0.1, so compare "
    "trackers over many traffic seeds."
)
NOISY_BOXES = 0.3
"""Below this HOTA of the raw boxes with perfect association, IoU is the wrong similarity."""
OF_SEEDS = "over detector seeds of this traffic; it says nothing about other traffic"


def score_rows(scores: ScoredTracks) -> list[tuple[str, ...]]:
    """A line for each tracker, the highest HOTA first, and for each reference, under `HEADER`."""
    return [(name, *score_cells(found)) for name, found in named_scores(scores)]


def named_scores(scores: ScoredTracks) -> list[tuple[str, Scores]]:
    """The trackers, then the references, with what tables call them."""
    named = [(each.name, each.scores) for each in scores.trackers]
    return named + [(REFERENCES[name], found) for name, found in scores.references.items()]


def score_cells(scores: Scores) -> tuple[str, ...]:
    """The scores of one line."""
    keys, (survived, judged) = keys_of(scores), survived_and_judged(scores.occlusions)
    cells = tuple(number(keys[key], decimals) for _, key, decimals in COLUMNS)
    return (*cells, f"{survived} of {judged}" if judged else UNKNOWN)


def survived_and_judged(occlusions: Sequence[OcclusionEpisode]) -> tuple[int, int]:
    """How many occlusions tracks survived, and of how many."""
    judged = [each.survived for each in occlusions if each.survived is not None]
    return sum(judged), len(judged)


def length_bins(occlusions: Sequence[OcclusionEpisode]) -> tuple[LengthBin, ...]:
    """Occlusions by length, those that a track could survive."""
    bins = []
    for low, high in pairwise((0, *LENGTH_EDGES_S, float("inf"))):
        survived, judged = survived_and_judged([each for each in occlusions if low <= each.length_s < high])
        name = f"longer than {low:g} s" if high == float("inf") else f"of {low:g} to {high:g} s"
        bins.append(LengthBin(name, judged, survived))
    return tuple(bins)


def remarks_of(scores: ScoredTracks) -> str:
    """Remarks to read before using the scores in the images."""
    raw = keys_of(scores.references[RAW])["hota"]
    if scores.rules.similarity.name != "iou" or raw is None or raw >= NOISY_BOXES:
        return ONE_RUN
    return (
        f"{ONE_RUN} The raw boxes with perfect association have HOTA {raw:.2f} only: here IoU scores the noise of the "
        "boxes more than the trackers. Compare centres (--similarity centre)."
    )


def conclusion_of(scores: ScoredTracks) -> str:
    """The outcome: of the best tracker in the images, and of each in the world."""
    said = []
    if scores.trackers:
        outcomes = [
            TrackerOutcome(each.name, keys_of(each.scores), length_bins(each.scores.occlusions))
            for each in scores.trackers
        ]
        said.append(conclusion(outcomes, keys_of(scores.references[SMOOTHED])))
    if scores.world:
        said.append(world_conclusion(scores))
    return " ".join(said)


def seed_rows(scores: ScoredTracks) -> list[tuple[str, ...]]:
    """A line for each tracker and score over detector seeds, under `SEED_HEADER`."""
    if scores.seeds is None:
        return []
    rows: list[tuple[str, ...]] = []
    for name, spreads in scores.seeds.spreads.items():
        for title, key, decimals in (*COLUMNS, ("ANEES", "anees", 1)):
            spread = spreads[key]
            if key == "anees" and spread.mean is None:  # a tracker without covariances
                continue
            interval = UNKNOWN
            if spread.interval is not None:
                interval = " … ".join(number(value, decimals + 1) for value in spread.interval)
            few = "" if len(spread.known) == len(spread.values) else f" of {counted(len(spread.known), 'seed')}"
            shown = number(spread.mean, decimals + 1) + few, number(spread.deviation, decimals + 1)
            rows.append((REFERENCES.get(name, name), title, *shown, interval))
    return rows


def seeds_in_words(scores: ScoredTracks) -> str:
    """Description of the table of seeds."""
    if scores.seeds is None:
        return ""
    seeds = scores.seeds.seeds
    which = f"{counted(len(seeds), 'seed')} of the detector, {seeds[0]} to {seeds[-1]}, that of the run first"
    return f"{which}: {OF_SEEDS}."


def occlusion_rows(occlusions: Sequence[OcclusionEpisode]) -> list[tuple[str, ...]]:
    """A line for each occlusion."""
    return [
        (
            each.camera,
            each.vessel,
            f"{each.start_s:.1f} s",
            f"{each.length_s:.1f} s",
            percent(each.least_visible_fraction),
            UNKNOWN if each.track_before is None else f"{each.track_before}",
            UNKNOWN if each.track_after is None else f"{each.track_after}",
            UNKNOWN if each.survived is None else "yes" if each.survived else "no",
        )
        for each in occlusions
    ]


def hidden_rows(scores: ScoredTracks) -> list[tuple[str, ...]]:
    """Rows on wholly hidden vessels and their tracks, one for each tracker and reference."""
    return [
        (
            name,
            number(keys_of(found)["hidden_vessel_frames"], 0),
            percent(keys_of(found)["hidden_followed"]),
            percent(keys_of(found)["hidden_same_track"]),
        )
        for name, found in named_scores(scores)
    ]


def survived_of(each: Bin) -> str:
    """How many occlusions of a bin are survived, of those that could be; empty outside the group of occlusions."""
    if each.occlusions is None:
        return ""
    return f"{round((each.survived or 0.0) * each.judged)} of {each.judged}" if each.judged else UNKNOWN


def key_rows(scores: ScoredTracks) -> list[tuple[str, ...]]:
    """All scores by their keys, a column for each tracker and reference."""
    every = [keys_of(found) for _, found in named_scores(scores)]
    return [(key, *(_any_number(keys[key]) for keys in every)) for key in every[0]]


def part_tables(scores: ScoredTracks) -> list[Table]:
    """Scores by performance state, by camera and by class, where there are several."""
    named = named_scores(scores)
    tables = []
    for title, part in (("By performance state", "by_state"), ("By camera", "by_camera")):
        parts = [(name, {key: vars(each) for key, each in getattr(found, part).items()}) for name, found in named]
        if len(parts[0][1]) > 1:
            tables.append(Table(title, PART_HEADER, _part_rows(parts), where=Where.PAGE))
    if scores.rules.by_class:
        of_class = [(name, {key: each.flat() for key, each in found.by_class.items()}) for name, found in named]
        tables.append(Table("By class", PART_HEADER, _part_rows(of_class)))
    return tables


def _part_rows(named: Sequence[tuple[str, Mapping[str, Mapping[str, Any]]]]) -> list[tuple[str, ...]]:
    """A row for each part and each tracker that has it."""
    labels = dict.fromkeys(label for _, parts in named for label in parts)
    return [
        (label, name, *(number(parts[label][key], decimals) for _, key, decimals in PART_COLUMNS))
        for label in labels
        for name, parts in named
        if label in parts
    ]


def _any_number(value: float | int | None) -> str:
    """A count as it is, anything else with three decimals."""
    return number(value, 0 if isinstance(value, int) else 3)


# ---- Scores as JSON ----

FORMAT = 1


def score_data(scores: ScoredTracks) -> dict[str, Any]:
    """Content of `score.json`."""
    return {
        "format": FORMAT,
        "scene": scores.run.scene.name,
        "run": scores.run.folder,
        "conclusion": conclusion_of(scores),
        "rules": _rules(scores.rules),
        "trackers": [_tracker(each) for each in scores.trackers],
        "references": {name: found.as_json() for name, found in scores.references.items()},
        "seeds": _seeds(scores),
        "world": world_data(scores),
    }


def _rules(rules: Rules) -> dict[str, Any]:
    similarity, distance = rules.similarity, rules.set_distance
    return {
        "truth": rules.truth,
        "gap_s": rules.gap_s,
        "similarity": similarity.name,
        "scale_px": similarity.scale_px,
        "threshold": similarity.least,
        "by_class": rules.by_class,
        "cameras": rules.cameras or None,
        "gospa_c_px": distance.cutoff,
        "gospa_p": distance.power,
    }


def _tracker(each: TrackScores) -> dict[str, Any]:
    origin = each.track_set.origin
    return {
        "name": each.name,
        "tracks": each.path,
        "tracker": origin and origin.tracker,
        "settings": origin and origin.settings,
        "chosen": origin and origin.chosen,
        "package": origin and origin.package,
        **each.scores.as_json(),
    }


def _seeds(scores: ScoredTracks) -> dict[str, Any] | None:
    if scores.seeds is None:
        return None
    return {
        "detector_seeds": scores.seeds.seeds,
        "scores": {
            name: {
                key: {part: getattr(spread, part) for part in ("values", "mean", "deviation", "interval")}
                for key, spread in spreads.items()
            }
            for name, spreads in scores.seeds.spreads.items()
        },
    }
