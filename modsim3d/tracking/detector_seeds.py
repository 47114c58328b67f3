"""Scores over detector seeds: detector, tracker and scores again over the truth of one run."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from modsim3d.core.arrays import Array
from modsim3d.core.errors import ModsimError
from modsim3d.core.statistics import t_bounds
from modsim3d.runs.camera_sequences import sequences_of
from modsim3d.runs.files.block_files import detected_tables
from modsim3d.runs.files.stored_tables import truth_of
from modsim3d.runs.pipeline import block_ranges, block_steps
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.scene.scene import Scene
from modsim3d.tracking.oracle import reference_tracks
from modsim3d.tracking.score_text import Keys, keys_of
from modsim3d.tracking.scores.scored_run import Rules
from modsim3d.tracking.scores.scoring import score_tracks
from modsim3d.tracking.trackers.registry import named_tracker
from modsim3d.tracking.trackers.running import tracked
from modsim3d.tracks.tracks import TrackSet

LEVEL = 0.95  # confidence of the interval of a mean
SPREAD_KEYS = ("hota", "deta", "assa", "mota", "idf1", "id_switches", "gospa", "anees")  # whose spread is told
MIN_SEEDS, MAX_SEEDS = 2, 1000


@dataclass(frozen=True)
class Spread:
    """A score over detector seeds: that of each, None where it is undefined."""

    values: tuple[float | None, ...]

    @property
    def known(self) -> Array:
        """The values that are defined, shape (n,)."""
        return np.array([value for value in self.values if value is not None], dtype=np.float64)

    @property
    def mean(self) -> float | None:
        """The mean."""
        return float(self.known.mean()) if len(self.known) else None

    @property
    def deviation(self) -> float | None:
        """The standard deviation of one seed's value, with n − 1; None if one is infinite."""
        return float(self.known.std(ddof=1)) if len(self.known) > 1 and np.isfinite(self.known).all() else None

    @property
    def interval(self) -> tuple[float, float] | None:
        """The 95 % interval of the mean, by Student's t; None if all values are the same."""
        return t_bounds(self.known, (1 - LEVEL) / 2)


@dataclass(frozen=True)
class SeedSpread:
    """Scores over detector seeds."""

    seeds: tuple[int, ...]  # that of the run first
    spreads: dict[str, dict[str, Spread]]  # name of the tracker or reference → score → its spread


def check_seeds(seeds: int, track_sets: Sequence[TrackSet], in_world: Sequence[Path]) -> None:
    """Raise ModsimError if there are too few or too many seeds, or tracks that `modsim3d track` did not write, whose
    tracker is not known."""
    if not MIN_SEEDS <= seeds <= MAX_SEEDS:
        raise ModsimError(f"--seeds must be from {MIN_SEEDS} to {MAX_SEEDS} (got {seeds})")
    own = [tracks for tracks in track_sets if tracks.origin is None or tracks.origin.package.startswith("command ")]
    unknown = [f"{path}" for path in in_world] + [tracks.name for tracks in own]
    if unknown:
        raise ModsimError(
            f"--seeds runs the tracker again, and nothing says which one made '{unknown[0]}': give folders that "
            "`modsim3d track` wrote, of no program (campaigns run these with several seeds), or leave out --seeds"
        )


def detector_runs(run: StoredRun, count: int) -> Iterator[tuple[int, RunRows]]:
    """A finished run as other seeds of the detector would have given it, in memory: the same truth, other detections.
    The first of `count` seeds is that of the run."""
    stored, ranges = run.finished_tables, block_ranges(run.steps, block_steps(run.scene))
    blocks = [(truth_of(stored.truth(first, stop), run.scene), first, stop) for first, stop in ranges]
    for seed in range(run.scene.detector_seed, run.scene.detector_seed + count):
        scene: Scene = replace(run.scene, detector_seed=seed)
        yield seed, RunRows.of_tables(scene, run.steps, detected_tables(scene, blocks))


def spread_over_seeds(
    run: StoredRun, track_sets: Sequence[TrackSet], count: int, rules: Rules, progress: Callable[[int], None]
) -> SeedSpread:
    """Run detector, tracker and scores again with other seeds of the detector, for tracks whose tracker is known; see
    `check_seeds`. `progress` is called with the number of seeds done since its last call."""
    names = [camera.name for camera in run.scene.cameras]
    cameras = tuple(index for index, name in enumerate(names) if not rules.cameras or name in rules.cameras)
    scores: dict[str, list[Keys]] = {}
    seeds = []
    for seed, whole in detector_runs(run, count):
        rows = whole.in_cameras(cameras)
        sequences = sequences_of(rows, cameras)
        for track_set in track_sets:
            assert track_set.origin is not None  # check_seeds has seen it
            named = named_tracker(track_set.origin.tracker, track_set.origin.settings, run.scene.name)
            tracks = tracked(named, sequences, cameras, rows.scene)
            scores.setdefault(track_set.name, []).append(keys_of(score_tracks(rows, tracks, rules)))
        for name, tracks in reference_tracks(rows, rules).items():
            scores.setdefault(name, []).append(keys_of(score_tracks(rows, tracks, rules)))
        seeds.append(seed)
        progress(1)
    spreads = {
        name: {key: Spread(tuple(keys[key] for keys in every)) for key in SPREAD_KEYS} for name, every in scores.items()
    }
    return SeedSpread(tuple(seeds), spreads)
