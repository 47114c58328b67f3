"""Scores of the tracks of a run as values: what tables, JSON and pages show."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from modsim3d.runs.stored_run import StoredRun
from modsim3d.tracking.scores.scored import Rules
from modsim3d.tracking.scores.scoring import Scores
from modsim3d.tracking.world.scoring import WorldScores
from modsim3d.tracks.tracks import TrackSet

if TYPE_CHECKING:
    from modsim3d.tracking.detector_seeds import SeedSpread


@dataclass(frozen=True, eq=False)
class TrackScores:
    """The scores of one tracker in the images.

    Attributes:
        name: What tables call it.
        path: Where its tracks are; None if they were given in memory.
        track_set: Its tracks.
        scores: Their scores.
    """

    name: str
    path: Path | None
    track_set: TrackSet
    scores: Scores


@dataclass(frozen=True, eq=False)
class WorldTrackScores:
    """The scores of one tracker in the world.

    Attributes:
        name: What tables call it.
        path: Where its tracks are.
        scores: Their scores.
    """

    name: str
    path: Path
    scores: WorldScores


@dataclass(frozen=True, eq=False, repr=False)
class ScoredTracks:
    """Scores of tracks of a run, before anything is said of them.

    Attributes:
        run: The run.
        rules: How tracks were scored.
        trackers: The trackers in the images, the highest HOTA first.
        references: The scores of the run's own detections with perfect association: `smoothed`, and with `raw` boxes.
            They are references and no ceilings: a tracker that smooths better may exceed them.
        seeds: Scores over detector seeds; None unless asked for.
        world: The trackers in the world.
    """

    run: StoredRun
    rules: Rules
    trackers: tuple[TrackScores, ...]
    references: dict[str, Scores]
    seeds: SeedSpread | None
    world: tuple[WorldTrackScores, ...]
