"""Scores of trackers on a film behind real or simulated detections: one way for both, from the same truth."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.stand_in.margins import SCORES
from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import areas
from modsim3d.core.errors import ModsimError
from modsim3d.runs.camera_sequences import CameraSequence, sequences_of
from modsim3d.runs.files.stored_tables import truth_of
from modsim3d.runs.pipeline import Simulation, block_ranges, block_steps, scene_statistics
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import open_run
from modsim3d.runs.tracker_view import TrackerDetections, anonymised
from modsim3d.scene.settings import choose_detector
from modsim3d.tracking.scores.association import clear_of, hota_of, identity_of, sequence
from modsim3d.tracking.scores.breakdown import association_of_pairs
from modsim3d.tracking.scores.continuity import false_track_lengths_s
from modsim3d.tracking.scores.errors import gospa
from modsim3d.tracking.scores.scored_run import Rules, ScoredRun
from modsim3d.tracking.trackers.registry import named_tracker
from modsim3d.tracking.trackers.running import tracked
from modsim3d.tracks.tracks import Tracks
from modsim3d.tracks.true_tracks import TrueTracks, follow
from modsim3d.truth.record import Truth

if TYPE_CHECKING:
    from benchmarks.stand_in.films import Film

TRACKERS = ("reference", "sort", "bytetrack", "ocsort")
SETTINGS_OF = {"harbour": "harbour", "strait": "strait", "basin": "simulation_2"}
"""The shipped scene whose chosen settings a tracker has at each place."""
RULES = Rules()
BINS = (
    ("visible", "at least half of the vessel visible"),
    ("hidden", "less than half of the vessel visible"),
    ("near", "nearer than 150 m"),
    ("middle", "150 m to 300 m"),
    ("far", "300 m and farther"),
)
"""Vessel-frames that are looked at alone, and what they are."""
NEAR_M, FAR_M = 150, 300
PICTURE_BINS = (
    *BINS[:2],
    ("near", "nearer than 20 m"),
    ("middle", "20 m to 40 m"),
    ("far", "40 m and farther"),
    ("small", "box smaller than 32 px"),
    ("medium", "box of 32 px to 96 px"),
    ("large", "box of 96 px and more"),
)
"""The same for real pictures, with sizes: the side of a square as large as the box, as COCO has them."""
PICTURE_NEAR_M, PICTURE_FAR_M = 20, 40
SIZES_PX = (32, 96)
_SEEDS_OF_A_FILM = 1000


@dataclass(frozen=True, eq=False)
class OpenFilm:
    """A film with its truth in memory.

    Attributes:
        film: The film.
        rows: Its run.
        sequence: The frames of its camera.
        truth: What tracks are held against.
        blocks: Its truth as the detector is given it: for each block the truth, its first step, and the one after.
    """

    film: Film
    rows: RunRows
    sequence: CameraSequence
    truth: TrueTracks
    blocks: list[tuple[Truth, int, int]]

    @property
    def period_s(self) -> float:
        """Time from frame to frame."""
        return 1 / self.sequence.rate_hz

    @property
    def hidden(self) -> Mask:
        """Whether less than half of each vessel of the truth is visible, shape (n,)."""
        hidden: Mask = self.rows.numbers("visible_fraction")[self.truth.row] < 0.5
        return hidden


def open_film(film: Film) -> OpenFilm:
    """Read a film.

    Raises:
        ModsimError: Its run cannot be read, or has more than one camera.
    """
    run = open_run(film.run)
    if len(run.scene.cameras) != 1:
        raise ModsimError(f"{film.run}: a film has one camera (got {len(run.scene.cameras)})")
    rows, stored = RunRows.of(run), run.finished_tables
    blocks = [
        (truth_of(stored.truth(first, stop), run.scene), first, stop)
        for first, stop in block_ranges(run.steps, block_steps(run.scene))
    ]
    return OpenFilm(film, rows, sequences_of(rows, (0,))[0], TrueTracks.of(rows, RULES.truth, RULES.gap_s), blocks)


def real_detections(opened: OpenFilm, threshold: float) -> TrackerDetections:
    """What the detector that looks at pixels found, from a confidence on.

    Raises:
        ModsimError: The images of the file are not the frames of the run, or it has a label that the run has not.
    """
    if opened.rows.scene.labels is not None:
        return _confident(opened.sequence.detections, threshold)  # the run is of real detections
    truth = json.loads(Path(opened.film.truth).read_text(encoding="utf-8"))
    found = json.loads(Path(opened.film.real).read_text(encoding="utf-8"))
    frame_of = {image["id"]: frame for frame, image in enumerate(truth["images"])}
    if len(frame_of) != len(opened.sequence.steps):
        raise ModsimError(
            f"{opened.film.truth}: has {len(frame_of)} images, and the run {opened.film.run} has "
            f"{len(opened.sequence.steps)} frames: make the film again"
        )
    labels = opened.rows.scene.detector.labels
    names = {each["id"]: each["name"] for each in truth["categories"]}
    if unknown := {names[each["category_id"]] for each in found} - set(labels):
        raise ModsimError(f"{opened.film.real}: the label '{min(unknown)}' is none of the run's ({', '.join(labels)})")
    corner_px = np.array([each["bbox"] for each in found], dtype=np.float64).reshape(-1, 4)
    return _confident(
        anonymised(
            np.array([frame_of[each["image_id"]] for each in found], dtype=np.int64),
            np.array([labels.index(names[each["category_id"]]) for each in found], dtype=np.int64),
            np.hstack([corner_px[:, :2], corner_px[:, :2] + corner_px[:, 2:]]),
            np.array([each["score"] for each in found], dtype=np.float64),
        ),
        threshold,
    )


def simulated_detections(
    opened: OpenFilm, detector: Path, seeds: Sequence[int], threshold: float
) -> list[TrackerDetections]:
    """What a detector file gives with each seed, in the state of the film's weather.

    Noise belongs to a seed, a vessel and a step, so films of one seed would not be independent: seed k of a film is
    1000 times the film's own plus k. `modsim3d detect --state WEATHER --detector-seed N` gives the same.

    Raises:
        ModsimError: The file is wrong, or does not suit the run.
    """
    model, file = choose_detector(detector, state=opened.film.weather)
    if unknown := set(opened.rows.scene.detector.labels) - set(model.labels):
        raise ModsimError(f"{file}: has no label '{min(unknown)}', which the film {opened.film.name} has")
    scene = replace(opened.rows.scene, detector=model)
    if scene.labels is not None:
        scene = replace(scene, poses=replace(scene.labels, detections=None))
    statistics = scene_statistics(scene, opened.blocks)
    own = [_SEEDS_OF_A_FILM * opened.film.seed + seed for seed in seeds]
    return [_simulated(opened, Simulation(replace(scene, detector_seed=seed), statistics), threshold) for seed in own]


def _simulated(opened: OpenFilm, simulation: Simulation, threshold: float) -> TrackerDetections:
    parts = []
    for block in opened.blocks:
        part = simulation.detect(*block).cameras[0]
        frame = np.searchsorted(opened.sequence.steps, part.steps[part.detections.frame])
        parts.append((frame, part.detections.label, part.detections.boxes_px, part.detections.confidence))
    return _confident(anonymised(*(np.concatenate(column) for column in zip(*parts, strict=True))), threshold)


def _confident(detections: TrackerDetections, threshold: float) -> TrackerDetections:
    return detections.take(detections.confidence >= threshold)


def scored_tracks(opened: OpenFilm, detections: TrackerDetections, tracker: str) -> ScoredRun:
    """Run a tracker over the detections of a film, and match its tracks with the truth."""
    named = named_tracker(tracker, {}, SETTINGS_OF.get(opened.film.place))
    tracks = tracked(named, [replace(opened.sequence, detections=detections)], (0,), opened.rows.scene)
    return ScoredRun(
        opened.rows, RULES, follow(opened.truth, tracks, RULES.similarity, opened.rows.regions), opened.rows.frames
    )


def scores_of(opened: OpenFilm, scored: ScoredRun) -> dict[str, float]:
    """The scores of a tracker on a film by their keys; NaN where one is undefined."""
    data, least = sequence(scored), RULES.similarity.least
    hota, clear = hota_of(data), clear_of(data, least)
    lengths_s = track_lengths_s(opened, scored.following.tracks)
    found = {
        "hota": hota.hota,
        "deta": hota.deta,
        "assa": hota.assa,
        "idf1": identity_of(data, least).idf1,
        "mota": clear.mota,
        "gospa": gospa(scored).gospa,
        "id_switches": clear.id_switches,
        "tracks": len(lengths_s),
        "track_s": float(lengths_s.mean()) if len(lengths_s) else None,
        "false_tracks": len(false_track_lengths_s(scored)),
    }
    return {score.key: np.nan if (value := found[score.key]) is None else float(value) for score in SCORES}


def track_lengths_s(opened: OpenFilm, tracks: Tracks) -> Array:
    """Time for which each track is reported, shape (k,)."""
    return np.asarray(np.bincount(tracks.identity), dtype=np.float64) * opened.period_s


def recall_of_bins(opened: OpenFilm, scored: ScoredRun) -> dict[str, dict[str, float]]:
    """Of the vessel-frames of each of `BINS`: share that a track follows, and their mean association; NaN of none."""
    found, association = association_of_pairs(scored)
    chosen = bins_of(opened, scored.truth)
    return {
        name: {"recall": _mean(found[rows]), "association": _mean(association[rows & found])}
        for name, rows in chosen.items()
    }


def bins_of(opened: OpenFilm, truth: TrueTracks) -> dict[str, Mask]:
    """Which rows of the truth belong to each of `BINS`, shapes (n,)."""
    visible, depth_m = (opened.rows.numbers(name)[truth.row] for name in ("visible_fraction", "depth_m"))
    pictures = opened.rows.scene.labels is not None
    near, far = depth_m < (PICTURE_NEAR_M if pictures else NEAR_M), depth_m >= (PICTURE_FAR_M if pictures else FAR_M)
    found = {"visible": visible >= 0.5, "hidden": visible < 0.5, "near": near, "middle": ~near & ~far, "far": far}
    if not pictures:
        return found
    side_px = np.sqrt(areas(truth.boxes_px))
    small, large = side_px < SIZES_PX[0], side_px >= SIZES_PX[1]
    return {**found, "middle": found["middle"] & ~np.isnan(depth_m), "small": small, "medium": ~small & ~large,
            "large": large}  # fmt: skip


def found_vessels(opened: OpenFilm, detections: TrackerDetections) -> tuple[Mask, Indices]:
    """Whether each vessel of the truth is detected, shape (n,), and the row of the truth of each detection, shape (m,).

    A detection of no vessel has −1. In each frame detections and vessels are assigned so that the sum of IoU is
    largest; a pair has an IoU of at least a half.
    """
    frame = opened.rows.frames[detections.frame]
    alone = Tracks.of(opened.truth.cameras, frame, np.arange(len(frame)), detections.boxes_px)
    following = follow(opened.truth, alone, RULES.similarity)
    row = np.empty(len(frame), dtype=np.int64)
    row[alone.track] = following.truth_row
    return following.found, row


def _mean(values: Array | Mask) -> float:
    return float(values.mean()) if len(values) else np.nan
