"""Scores as the rows of tables, for the terminal, a notebook and the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from modsim3d.display import counted
from modsim3d.tracking.oracle.references import RAW, REFERENCES, SMOOTHED
from modsim3d.tracking.report.numbers import COLUMNS, UNKNOWN, keys_of, number, percent
from modsim3d.tracking.report.sentence import LengthBin, TrackerOutcome, conclusion
from modsim3d.tracking.report.world_tables import world_conclusion
from modsim3d.tracking.run_scores import ScoredTracks
from modsim3d.tracking.scores.breakdown import Bin, Breakdown
from modsim3d.tracking.scores.occlusions import LENGTH_EDGES_S, Occlusion
from modsim3d.tracking.scores.scoring import Scores, SubsetScores

HEADER = ("tracker", *(name for name, _, _ in COLUMNS), "occlusions survived")
SEED_HEADER = ("tracker", "score", "mean", "standard deviation", "95 % of the mean")
HIDDEN_HEADER = ("tracker", "vessel-frames", "followed", "by the track from before")
OCCLUSION_HEADER = ("camera", "vessel", "from", "length", "least visible", "track before", "track after", "survived")
BIN_HEADER = ("by", "", "vessel-frames", "recall", "association", "survived")
PART_COLUMNS = COLUMNS[:5]
PART_HEADER = ("", "tracker", *(name for name, _, _ in PART_COLUMNS))
GROUP_NAMES = {
    "visible_fraction": "visible fraction",
    "phase": "an occlusion",
    "occlusion": "its length, s",
    "range": "range, m",
    "size": "size, px",
    "edge": "edge of the image",
    "state": "performance state",
    "label": "class",
}
"""What tables call the groups of a breakdown."""
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


def survived_and_judged(occlusions: Sequence[Occlusion]) -> tuple[int, int]:
    """How many occlusions tracks survived, and of how many."""
    judged = [each.survived for each in occlusions if each.survived is not None]
    return sum(judged), len(judged)


def length_bins(occlusions: Sequence[Occlusion]) -> tuple[LengthBin, ...]:
    """Occlusions by length, those that a track could survive."""
    bins = []
    for low, high in pairwise((0, *LENGTH_EDGES_S, float("inf"))):
        survived, judged = survived_and_judged([each for each in occlusions if low <= each.length_s < high])
        name = f"longer than {low:g} s" if high == float("inf") else f"of {low:g} to {high:g} s"
        bins.append(LengthBin(name, judged, survived))
    return tuple(bins)


def remarks_of(scores: ScoredTracks) -> str:
    """What a reader should know before using the scores in the images."""
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
    """What the table of seeds is."""
    if scores.seeds is None:
        return ""
    seeds = scores.seeds.seeds
    which = f"{counted(len(seeds), 'seed')} of the detector, {seeds[0]} to {seeds[-1]}, that of the run first"
    return f"{which}: {OF_SEEDS}."


def occlusion_rows(occlusions: Sequence[Occlusion]) -> list[tuple[str, ...]]:
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
    """What tracks do on wholly hidden vessels, a line for each tracker and reference."""
    return [
        (
            name,
            number(keys_of(found)["hidden_vessel_frames"], 0),
            percent(keys_of(found)["hidden_followed"]),
            percent(keys_of(found)["hidden_same_track"]),
        )
        for name, found in named_scores(scores)
    ]


def bin_rows(groups: Breakdown) -> list[tuple[str, ...]]:
    """A line for each bin of a breakdown, under `BIN_HEADER`."""
    return [
        (
            GROUP_NAMES[group.name] if place == 0 else "",
            each.bin,
            f"{each.vessel_frames:,}",
            number(each.recall, 2),
            number(each.association, 2),
            survived_of(each),
        )
        for group in groups
        for place, each in enumerate(group.rows)
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


def part_tables(scores: ScoredTracks) -> list[tuple[str, tuple[str, ...], list[tuple[str, ...]]]]:
    """Title, header and rows of the scores by performance state, by camera and by class, where there are several."""
    named = named_scores(scores)
    parts: dict[str, list[tuple[str, Mapping[str, Mapping[str, Any]]]]] = {
        "By performance state": [(name, _as_keys(found.by_state)) for name, found in named],
        "By camera": [(name, _as_keys(found.by_camera)) for name, found in named],
    }
    tables = [(title, PART_HEADER, _part_rows(part)) for title, part in parts.items() if len(part[0][1]) > 1]
    if scores.rules.by_class:
        of_class = [(name, {key: each.flat() for key, each in found.by_class.items()}) for name, found in named]
        tables.append(("By class", PART_HEADER, _part_rows(of_class)))
    return tables


def _as_keys(parts: Mapping[str, SubsetScores]) -> dict[str, Mapping[str, Any]]:
    return {name: vars(each) for name, each in parts.items()}


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
