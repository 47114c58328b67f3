"""Scores as JSON."""

from __future__ import annotations

from typing import Any

from modsim3d.tracking.report.score_tables import conclusion_of
from modsim3d.tracking.report.world_tables import world_data
from modsim3d.tracking.run_scores import ScoredTracks, TrackScores
from modsim3d.tracking.scores.rules import Rules

FORMAT = 1


def score_data(scores: ScoredTracks) -> dict[str, Any]:
    """What `score.json` holds."""
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
                key: {
                    "values": spread.values,
                    "mean": spread.mean,
                    "deviation": spread.deviation,
                    "interval": spread.interval,
                }
                for key, spread in spreads.items()
            }
            for name, spreads in scores.seeds.spreads.items()
        },
    }
