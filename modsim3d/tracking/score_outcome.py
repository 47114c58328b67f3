"""Outcome of all tracks of a run, in a sentence and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modsim3d.core.text import UNKNOWN
from modsim3d.runs.stored_run import StoredRun
from modsim3d.tracking.oracle import RAW
from modsim3d.tracking.score_text import LengthBin, TrackerOutcome, conclusion, keys_of
from modsim3d.tracking.scores.occlusions import LENGTH_EDGES_S, OcclusionEpisode
from modsim3d.tracking.scores.scored_run import Rules
from modsim3d.tracking.scores.scoring import Scores
from modsim3d.tracking.world.scoring import WorldScores
from modsim3d.tracks.tracks import TrackSet

ONE_RUN = (
    "One run is one sample: over seeds the HOTA of a tracker has a standard deviation of up to 0.1, so compare "
    "trackers over many traffic seeds."
)

NOISY_BOXES = 0.3  # below this HOTA of the raw boxes with perfect association, IoU is the wrong similarity


def conclusion_of(scores: ScoredTracks) -> str:
    """The outcome: of the best tracker in the images, and of each in the world."""
    sentences = []
    if scores.trackers:
        bins = [(tracker, length_bins(tracker.scores.occlusions)) for tracker in scores.trackers]
        outcomes = [TrackerOutcome(tracker.name, keys_of(tracker.scores), lengths) for tracker, lengths in bins]
        oracle = best_reference(scores)
        sentences.append(conclusion(outcomes, {"hota": None} if oracle is None else keys_of(oracle)))
    if scores.world:
        sentences.append(world_conclusion(scores))
    return " ".join(sentences)


def best_reference(scores: ScoredTracks) -> Scores | None:
    """The reference with the higher HOTA, None without any; where a camera moves, smoothing may cost more."""
    return max(scores.references.values(), key=lambda reference: keys_of(reference)["hota"] or 0, default=None)


def remarks_of(scores: ScoredTracks) -> str:
    """Remarks to read before using the scores in the images."""
    raw = keys_of(scores.references[RAW])["hota"] if scores.references else None
    if scores.rules.similarity.name != "iou" or raw is None or raw >= NOISY_BOXES:
        return ONE_RUN
    return (
        f"{ONE_RUN} The raw boxes with perfect association have HOTA {raw:.2f} only: here IoU scores the noise of the "
        "boxes more than the trackers. Compare centres (--similarity centre)."
    )


def world_conclusion(scores: ScoredTracks) -> str:
    """The outcome of tracks in the world, a sentence for each tracker."""
    sentences = []
    for tracker in scores.world:
        keys = tracker.scores.flat()
        rmse, share = keys["rmse_m"], keys["followed_share"]
        if rmse is None:
            sentences.append(f"{tracker.name} follows no vessel in the world.")
            continue
        met = keys["encounters"]
        sentences.append(
            f"{tracker.name} follows vessels in the world with an error of {rmse:.1f} m (RMSE), for "
            f"{UNKNOWN if share is None else f'{100 * share:.0f} %'} of the time that it should"
            + (f", and {keys['encounters_established']} of the {met} that met own ship." if met else ".")
        )
    return " ".join(sentences)


def survived_and_judged(occlusions: Sequence[OcclusionEpisode]) -> tuple[int, int]:
    """Number of occlusions that tracks survived, and of all."""
    judged = [episode.survived for episode in occlusions if episode.survived is not None]
    return sum(judged), len(judged)


def length_bins(occlusions: Sequence[OcclusionEpisode]) -> tuple[LengthBin, ...]:
    """Occlusions by length, those that a track could survive."""
    bins = []
    for low, high in pairwise((0, *LENGTH_EDGES_S, float("inf"))):
        survived, judged = survived_and_judged([episode for episode in occlusions if low <= episode.length_s < high])
        name = f"longer than {low:g} s" if high == float("inf") else f"of {low:g} to {high:g} s"
        bins.append(LengthBin(name, judged, survived))
    return tuple(bins)


FORMAT = 1


def score_data(scores: ScoredTracks) -> dict[str, Any]:
    """Content of `score.json`."""
    return {
        "format": FORMAT,
        "scene": scores.run.scene.name,
        "run": (*scores.run.made_of, scores.run.folder)[0],
        "conclusion": conclusion_of(scores),
        "rules": _rules(scores.rules),
        "trackers": [_tracker(tracker) for tracker in scores.trackers],
        "references": {name: reference.as_json() for name, reference in scores.references.items()},
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


def _tracker(tracker: TrackScores) -> dict[str, Any]:
    origin = tracker.track_set.origin
    return {
        "name": tracker.name,
        "tracks": tracker.path,
        **{key: origin and getattr(origin, key) for key in ("tracker", "settings", "chosen", "package")},
        **tracker.scores.as_json(),
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


def world_data(scores: ScoredTracks) -> list[dict[str, Any]]:
    """Entries of world tracks in `score.json`."""
    return [
        {
            "name": tracker.name,
            "tracks": tracker.path,
            "gate_m": tracker.scores.gate_m,
            "gospa_c_m": tracker.scores.set_distance.cutoff,
            "gospa_p": tracker.scores.set_distance.power,
            "gospa_switch_m": tracker.scores.set_distance.switch or tracker.scores.set_distance.cutoff,
            **tracker.scores.flat(),
            "each_encounter": [asdict(met) for met in tracker.scores.encounters],
            "predicted_approaches": asdict(tracker.scores.approaches),
        }
        for tracker in scores.world
    ]


if TYPE_CHECKING:
    from modsim3d.tracking.detector_seeds import SeedSpread


@dataclass(frozen=True, eq=False)
class TrackScores:
    """The scores of one tracker in the images."""

    name: str  # what tables call it
    path: Path | None  # where its tracks are; None if they were given in memory
    track_set: TrackSet
    scores: Scores


@dataclass(frozen=True, eq=False)
class WorldTrackScores:
    """The scores of one tracker in the world."""

    name: str  # what tables call it
    path: Path  # where its tracks are
    scores: WorldScores


@dataclass(frozen=True, eq=False, repr=False)
class ScoredTracks:
    """Scores of tracks of a run, before anything is said of them."""

    run: StoredRun
    rules: Rules
    trackers: tuple[TrackScores, ...]  # in the images, the highest HOTA first
    # The run's own detections with perfect association: `smoothed`, and with `raw` boxes. They are references and no
    # ceilings: a tracker that smooths better may exceed them.
    references: dict[str, Scores]
    seeds: SeedSpread | None  # scores over detector seeds; None unless asked for
    world: tuple[WorldTrackScores, ...]  # the trackers in the world
