"""Trials of trackers: one truth, looks of the detector at it, tracks, and scores as rows."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from modsim3d.core.statistics import t_bounds
from modsim3d.geometry.curved_sea import horizon_inverse_range
from modsim3d.runs.camera_sequences import sequences_of
from modsim3d.runs.locating import Viewpoints, locate
from modsim3d.runs.run import run_scene
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import open_run
from modsim3d.scene.reading import load_scene
from modsim3d.tracking.detector_seeds import LEVEL, detector_runs
from modsim3d.tracking.oracle import oracle_tracks
from modsim3d.tracking.scores.association import by_trackeval
from modsim3d.tracking.scores.continuity import continuity
from modsim3d.tracking.scores.errors import gospa
from modsim3d.tracking.scores.occlusions import LENGTH_EDGES_S, OcclusionEpisode, occlusions
from modsim3d.tracking.scores.scored_run import Rules, ScoredRun
from modsim3d.tracking.trackers.registry import NamedTracker, named_tracker
from modsim3d.tracking.trackers.running import run_tracker, tracked
from modsim3d.tracks.tracks import Similarity, Tracks, WorldTracks
from modsim3d.tracks.true_tracks import TrueTracks, TruthName

SCENES = ("fairway", "strait", "harbour", "simulation_1", "simulation_2", "simulation_3")
IOU = Rules(truth="full")
CENTRE = Rules(truth="full", similarity=Similarity("centre", scale_px=150))
ORACLES = {"oracle association, smoothed": True, "oracle association, raw boxes": False}
"""Name of each reference, and whether it is smoothed."""
OCCLUSION_EDGES_S = (0.0, *LENGTH_EDGES_S, np.inf)


def looks(
    name: str, traffic_seed: int, count: int, steps: int | None = None, detector: Mapping[str, Any] | None = None
) -> Iterator[tuple[int, RunRows]]:
    """A scene's truth with a seed, and detections of it with one detector seed after another.

    Args:
        name: Name of a shipped scene.
        traffic_seed: Seed of the scene.
        count: Number of detector seeds, from the scene's seed on.
        steps: Number of steps, in place of the scene's.
        detector: Content of a detector file, in place of the scene's.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = None
        if detector is not None:
            file = Path(folder) / "detector.yaml"
            file.write_text(yaml.safe_dump(dict(detector)), encoding="utf-8")
        scene = load_scene(name, seed=traffic_seed, detector_seed=traffic_seed, steps=steps, detector=file)
        run_scene(scene, Path(folder) / "run")
        yield from detector_runs(open_run(Path(folder) / "run"), count)


def tracks_of(rows: RunRows, tracker: str, settings: Mapping[str, object] | None = None) -> Tracks:
    """The tracks of a tracker, or of a reference by its name in `ORACLES`.

    Args:
        rows: The run.
        tracker: The name.
        settings: Settings beside the tracker's own defaults; None: those that were chosen for the scene.
    """
    if tracker in ORACLES:
        return oracle_tracks(rows, TrueTracks.of(rows, IOU.truth), smoothed=ORACLES[tracker])
    cameras = tuple(range(len(rows.scene.cameras)))
    named = named_tracker(tracker, settings or {}, rows.scene.name if settings is None else None)
    return tracked(named, sequences_of(rows, cameras), cameras, rows.scene)


def world_tracks_of(rows: RunRows, named: NamedTracker) -> WorldTracks:
    """Tracks in the world. Those of a tracker of images lie where the rays through the feet of their boxes meet the
    sea, camera by camera."""
    tracks = run_tracker(named, rows).tracks
    return tracks if isinstance(tracks, WorldTracks) else on_the_sea(rows, tracks)


def on_the_sea(rows: RunRows, tracks: Tracks) -> WorldTracks:
    """Tracks of boxes as positions; a box that has none is left out."""
    places = np.full((len(tracks), 2), np.nan)
    for index, camera in enumerate(rows.scene.cameras):
        own = np.flatnonzero(tracks.camera == index)
        found = locate(rows.scene, camera.name, tracks.step[own], tracks.boxes_px[own])
        steps, at = np.unique(tracks.step[own], return_inverse=True)
        if len(steps):
            centres_m = Viewpoints.of(rows.scene, camera, steps, measured=True).poses().positions_m[at]
            horizon = horizon_inverse_range(centres_m[:, 2], curved=rows.scene.sea == "curved")
            below = found.inverse_range_per_m > horizon
            away = 1 / np.where(below, found.inverse_range_per_m, np.nan)
            along = np.stack([np.cos(found.bearing_rad), np.sin(found.bearing_rad)], axis=-1)
            places[own] = centres_m[:, :2] + away[:, None] * along
    known = np.isfinite(places).all(axis=1)
    names = tuple(map(str, range(int(tracks.identity.max(initial=-1)) + 1)))
    times_s = rows.scene.times_s(0, rows.steps)[tracks.step[known]]
    return WorldTracks.of("tracks", tracks.identity[known], names, times_s, places[known])


def tracks_lost_when_hidden(rows: RunRows) -> Tracks:
    """The true boxes, with a new track after each stretch in which a vessel is wholly hidden."""
    truth = TrueTracks.of(rows)
    order = np.lexsort((truth.frame, truth.identity))
    hidden = ~truth.scored[order]
    begins = (np.diff(truth.identity[order], prepend=-1) != 0) | (np.diff(hidden, prepend=True).astype(bool) & ~hidden)
    seen = order[~hidden]
    return Tracks.of(truth.cameras, truth.frame[seen], np.cumsum(begins)[~hidden], truth.boxes_px[seen])


def scores(rows: RunRows, tracks: Tracks, *, annotated: bool = False) -> dict[str, Any]:
    """What the tables are made of; against the annotated truth in place of the full one if that is asked for."""
    truth: TruthName = "annotated" if annotated else "full"
    scored, by_centre = (ScoredRun.of(rows, tracks, replace(rules, truth=truth)) for rules in (IOU, CENTRE))
    (association, clear, identity), (centre, _, _) = by_trackeval(scored), by_trackeval(by_centre)
    states = rows.scene.detector.states
    lasting = continuity(scored)
    return {
        "hota": association.hota,
        "deta": association.deta,
        "assa": association.assa,
        "hota_centre": centre.hota,
        "mota": clear.mota,
        "id_switches": clear.id_switches,
        "idf1": identity.idf1,
        "gospa": gospa(scored).gospa,
        "false_tracks": lasting.false_tracks,
        "states": {
            state.name: by_trackeval(replace(by_centre, frames=frames))[0].hota
            for index, state in enumerate(states)
            if len(frames := by_centre.state_frames(index))
        },
        "occlusions": survived_by_length(occlusions(by_centre)),
    }


def survived_by_length(found: Sequence[OcclusionEpisode]) -> list[list[int]]:
    """Of each length: how many occlusions a track could survive, and how many one did."""
    judged = [each for each in found if each.survived is not None]
    bins = np.searchsorted(OCCLUSION_EDGES_S, [each.length_s for each in judged], side="right") - 1
    survived = np.array([each.survived for each in judged], dtype=bool)
    return [[int(np.sum(bins == k)), int(np.sum(survived[bins == k]))] for k in range(len(OCCLUSION_EDGES_S) - 1)]


def perfect_detector(labels: Sequence[str], miss_rate: float = 0.0) -> dict[str, Any]:
    """A detector file without errors, except that it misses a share of the vessels in each frame."""
    count = len(labels)
    confusion = [*((1 - miss_rate) * np.eye(count)).tolist(), [miss_rate] * count]
    state = {
        "confusion": confusion,
        "false_positive_labels": [1 / count] * count,
        "false_discovery_rate": 0,
        "box_error": {"unit": "px", "mean": [0.0] * 4, "covariance": np.zeros((4, 4)).tolist()},
        "confidence": {"mean": 0.9, "std": 0.0},
    }
    return {
        "labels": list(labels),
        "confidence_threshold": 0.2,
        "initial_state": "usual",
        "transition_matrix": [[1.0]],
        "false_positives": {"model": "calibrated"},
        "states": {"usual": state},
    }


def mean_and_interval(values: Sequence[float | None]) -> dict[str, Any]:
    """Number, mean, and half the 95 % interval of the mean by Student's t; None where there is none."""
    known = np.array([value for value in values if value is not None], dtype=float)
    ends = t_bounds(known, (1 - LEVEL) / 2)
    half = (ends[1] - ends[0]) / 2 if ends else None
    return {"n": len(known), "mean": float(known.mean()) if len(known) else None, "half": half}
