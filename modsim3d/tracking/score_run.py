"""Scores of tracks of a run, beside those of its detections with perfect association."""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TypeVar

from modsim3d.core.document import Document, Result
from modsim3d.core.errors import ModsimError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.io.overwrite_guard import claimed
from modsim3d.io.validation import nearest, shown
from modsim3d.runs.files.overwrite import read_of_run
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun, opened_run
from modsim3d.tracking.oracle import reference_tracks
from modsim3d.tracking.score_outcome import ScoredTracks, TrackScores, WorldTrackScores, conclusion_of
from modsim3d.tracking.score_text import keys_of
from modsim3d.tracking.scores.scored_run import Rules, SetDistance
from modsim3d.tracking.scores.scoring import score_tracks
from modsim3d.tracking.world.scoring import IN_METRES, score_world
from modsim3d.tracks.reading import read_tracks
from modsim3d.tracks.tracks import DEFAULT_GATE_M, Similarity, SimilarityName, TrackSet, WorldTracks
from modsim3d.tracks.true_tracks import DEFAULT_GAP_S, TruthName
from modsim3d.tracks.world_reading import is_world, read_world_tracks

P = TypeVar("P", Path, Path | None)
T = TypeVar("T", TrackSet, WorldTracks)


class RunScores(Result, ScoredTracks):
    """Scores that say how well tracks follow the vessels of a run, from `score_run`.

    scores = modsim3d.score_run("runs/first", ["runs/sort", "runs/reference"])
    scores.trackers[0].scores.flat()["hota"], scores.conclusion, scores.write("runs/scores")
    """

    def _document(self) -> Document:
        from modsim3d.tracking.score_page import document  # pages take 0.1 s to import

        return document(self)

    @cached_property
    def conclusion(self) -> str:
        """The outcome in a sentence."""
        return conclusion_of(self)

    def write(self, folder: StrPath, *, overwrite: bool = False) -> tuple[Path, ...]:
        """Write `score.json` and `score.html`.

        Args:
            folder: Where to.
            overwrite: Replace those that are there.

        Returns:
            The paths of both.

        Raises:
            OutputError: A file exists, or cannot be written.
            TypeError: The folder is neither text nor a path.
        """
        from modsim3d.tracking.score_page import FILES, write_scores  # pages take 0.1 s to import

        paths = tuple(as_path(folder, "folder") / name for name in FILES)
        given = [tracker.path for tracker in self.trackers] + [tracker.path for tracker in self.world]
        with claimed(paths, overwrite=overwrite, inputs=[*read_of_run(self.run.folder), *filter(None, given)]):
            write_scores(self, folder)
        return paths


def score_run(
    run: StoredRun | StrPath,
    tracks: StrPath | TrackSet | Sequence[StrPath | TrackSet],
    *,
    truth: TruthName = "annotated",
    similarity: SimilarityName = "iou",
    scale_px: float | None = None,
    threshold: float = 0.5,
    gap_s: float = DEFAULT_GAP_S,
    by_class: bool = False,
    gospa_c: float | None = None,
    gospa_p: float = 1.0,
    gospa_switch: float | None = None,
    gate_m: float | None = None,
    cameras: str | Sequence[str] | None = None,
    seeds: int | None = None,
    progress: Callable[[int], None] = lambda seeds: None,
) -> RunScores:
    """Score tracks against what was true, and beside them the same detections with perfect association.

        modsim3d.score_run("runs/first", ["runs/sort", "my_tracks.csv"])

    Args:
        run: A finished run, or its directory.
        tracks: Folders that `track_run` wrote, files of your own tracker, or tracks in memory; one or several.
        truth: `annotated`: the vessels that the detector was given; `full`: all in the image, with whole boxes.
        similarity: `iou`, or `centre`: 1 − distance of the centres / scale.
        scale_px: The scale of `centre`.
        threshold: The least similarity at which a track follows a vessel.
        gap_s: After so long outside the image a vessel that comes back is a new one.
        by_class: Score each class by itself too.
        gospa_c: Cutoff of GOSPA and OSPA: 100 px in the images and 50 m in the world if None.
        gospa_p: Power of GOSPA and OSPA.
        gospa_switch: Cost of a change of a vessel's track in T-GOSPA, for tracks in the world; the cutoff if None.
        gate_m: Farthest that a track in the world follows a vessel; 50 m if None.
        cameras: Names of the cameras to score; all if None, and then no file may lack lines of one.
        seeds: Number of detector seeds to run detector, tracker and scores with as well; for tracks that `track_run`
            wrote.
        progress: Called with the number of seeds done since its last call.

    Raises:
        ModsimError: The run was interrupted, tracks are not of this run, or a rule is out of range.
        TypeError: The run or a tracker's tracks are neither text, nor a path, nor what Python holds of them.
    """
    cutoff = SetDistance().cutoff if gospa_c is None else gospa_c
    rules = Rules(truth, gap_s, Similarity(similarity, scale_px, threshold), by_class, SetDistance(cutoff, gospa_p))
    in_metres = SetDistance(IN_METRES.cutoff if gospa_c is None else gospa_c, gospa_p, gospa_switch)
    return _scored(opened_run(run), tracks, rules, cameras, gate_m, in_metres, seeds, progress)


def _scored(
    run: StoredRun,
    tracks: StrPath | TrackSet | Sequence[StrPath | TrackSet],
    rules: Rules,
    cameras: str | Sequence[str] | None,
    gate_m: float | None,
    in_metres: SetDistance,
    seeds: int | None,
    progress: Callable[[int], None],
) -> RunScores:
    """Scores of tracks in the images by `rules`, and in the world by `gate_m` and `in_metres`; see `score_run`."""
    chosen = _camera_indices(run, cameras)
    run.finished_tables.check_checksums()
    rows = RunRows.of(run)
    in_images, in_world = _read(run, rows, tracks, chosen)
    if chosen and in_world:
        raise ModsimError("--camera is for tracks in the images: those in the world are of all cameras together")
    if chosen and len(chosen) < len(run.scene.cameras):
        rules = replace(rules, cameras=tuple(run.scene.cameras[index].name for index in chosen))
        rows = rows.in_cameras(chosen)
    if not in_images:
        _refuse_image_rules(rules)
    if gate_m is not None and not in_world:
        raise ModsimError("--gate is for tracks in the world, and none are given: leave it out")
    if in_metres.switch is not None and not in_world:
        raise ModsimError("--gospa C:P:G: G is for tracks in the world, and none are given: leave it out")
    if seeds is not None:
        from modsim3d.tracking.detector_seeds import check_seeds, spread_over_seeds

        if run.scene.labels is not None and run.scene.labels.detections is not None:
            raise ModsimError("--seeds is for a simulated detector, and these detections are a real one's: leave out")
        track_sets = [track_set for _, track_set in in_images]
        check_seeds(seeds, track_sets, [path for path, _ in in_world])
    gate_m = DEFAULT_GATE_M if gate_m is None else gate_m
    world = tuple(
        WorldTrackScores(estimates.name, path, score_world(rows, estimates, gate_m, in_metres))
        for path, estimates in in_world
    )
    scored = [
        TrackScores(track_set.name, path, track_set, score_tracks(rows, track_set.tracks, rules))
        for path, track_set in in_images
    ]
    references = reference_tracks(rows, rules) if in_images and len(rows.detections) else {}
    return RunScores(
        run,
        rules,
        tuple(sorted(scored, key=lambda tracker: -(keys_of(tracker.scores)["hota"] or 0.0))),
        {name: score_tracks(rows, reference, rules) for name, reference in references.items()},
        spread_over_seeds(run, track_sets, seeds, rules, progress) if seeds is not None else None,
        world,
    )


def _refuse_image_rules(rules: Rules) -> None:
    """Refuse rules that only tracks in the images have, where there are none and a rule is not as by default."""
    options = "--vessels", "--gap", "--by class", "--similarity", "--threshold"
    values, usual = (
        (r.truth, r.gap_s, r.by_class, (r.similarity.name, r.similarity.scale_px), r.similarity.least)
        for r in (rules, Rules())
    )
    if named := [name for name, value, other in zip(options, values, usual, strict=True) if value != other]:
        what = f"{' and '.join(named)}: for tracks in the images, and none are given"
        raise ModsimError(f"{what}: leave out; tracks in the world have --gate and --gospa")


def _camera_indices(run: StoredRun, cameras: str | Sequence[str] | None) -> tuple[int, ...]:
    """Indices of the cameras that are asked for; none if none are. Raises ModsimError if the run has no such camera, or
    these are no names."""
    names = [camera.name for camera in run.scene.cameras]
    asked = [cameras] if isinstance(cameras, str) else () if cameras is None else cameras
    if not isinstance(asked, Sequence) or not all(isinstance(name, str) for name in asked):
        raise ModsimError(f"cameras must be the name of a camera, or a list of names (got {shown(cameras)})")
    for name in asked:
        if name not in names:
            raise ModsimError(f"--camera: there is no camera {shown(name)} in this run ({nearest(name, names)})")
    return tuple(index for index, name in enumerate(names) if name in asked)


def _one_sided(track_set: TrackSet, run: StoredRun) -> ModsimError:
    every = [f"--camera {camera.name}" for camera in run.scene.cameras]
    some = [f"--camera {camera.name}" for camera in run.scene.cameras if camera.name not in track_set.unnamed]
    return ModsimError(
        f"the tracks '{track_set.name}' have no line of camera {' and '.join(map(shown, track_set.unnamed))}, where "
        f"every vessel would count as missed: score the others with {' '.join(some)}; if the tracker found nothing "
        f"there, give {' '.join(every)}"
    )


def _read(
    run: StoredRun, rows: RunRows, tracks: StrPath | TrackSet | Sequence[StrPath | TrackSet], cameras: Sequence[int]
) -> tuple[list[tuple[Path | None, TrackSet]], list[tuple[Path, WorldTracks]]]:
    """The tracks in the images and those in the world, each with its path. Raises ModsimError if there are none, some
    are given twice, or they are not what tracks may be."""
    given = [tracks] if isinstance(tracks, TrackSet | str | os.PathLike) else list(tracks)
    if not given:
        raise ModsimError("there are no tracks to score: give folders that `modsim3d track` wrote, or your own files")
    in_images: list[tuple[Path | None, TrackSet]] = []
    in_world: list[tuple[Path, WorldTracks]] = []
    seen: set[Path] = set()
    for source in given:
        if isinstance(source, TrackSet):
            in_images.append((None, source))
            continue
        path = as_path(source, "tracks", "a folder or a file of tracks, or a TrackSet")
        if path.resolve() in seen:
            raise ModsimError(f"{path} is given twice: each tracker needs a line of its own")
        seen.add(path.resolve())
        if is_world(path):
            in_world.append((path, read_world_tracks(path, run)))
        else:
            in_images.append((path, read_tracks(path, run, rows, cameras)))
    if wrong := [track_set for _, track_set in in_images if track_set.unnamed and not cameras]:
        raise _one_sided(wrong[0], run)
    if cameras:
        in_images = [(path, track_set.in_cameras(cameras)) for path, track_set in in_images]
    return _name_tracks(in_images), _name_tracks(in_world)


def _name_tracks(pairs: list[tuple[P, T]]) -> list[tuple[P, T]]:
    """Tracks with their names in tables: those of one name by their paths, or by their numbers where they have none."""
    names = [tracks.name for _, tracks in pairs]
    return [
        (path, replace(tracks, name=f"{path or f'{tracks.name} {place}'}") if names.count(tracks.name) > 1 else tracks)
        for place, (path, tracks) in enumerate(pairs, start=1)
    ]
