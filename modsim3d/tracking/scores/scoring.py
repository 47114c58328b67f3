"""All scores of tracks over a run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from modsim3d.core.arrays import NOBODY, Indices
from modsim3d.core.errors import ModsimError
from modsim3d.runs.run_rows import RunRows
from modsim3d.tracking.scores.association import Clear, Hota, Identity, by_trackeval
from modsim3d.tracking.scores.breakdown import Breakdown, breakdown
from modsim3d.tracking.scores.continuity import Continuity, continuity
from modsim3d.tracking.scores.errors import Errors, Gospa, Ospa, Siap, errors, gospa, ospa, siap
from modsim3d.tracking.scores.occlusions import HiddenTracks, OcclusionEpisode, Survival, hidden, occlusions, survival
from modsim3d.tracking.scores.scored_run import Rules, ScoredRun
from modsim3d.tracks.tracks import Tracks
from modsim3d.tracks.true_tracks import follow

Value = float | int | None | tuple[float, ...]
Part = Hota | Clear | Identity | Gospa | Ospa | Siap | Errors | Continuity | HiddenTracks | Survival
"""Scores that belong together; the names of their fields are keys of the JSON."""
OWN_PARTS: tuple[Callable[[ScoredRun], Part], ...] = (gospa, ospa, siap, errors, continuity, hidden, survival)
"""What is computed here, after the scores by TrackEval, in the order of the keys."""


@dataclass(frozen=True)
class SubsetScores:
    """The scores of some frames of a run, from the matching of all; as in `Hota`, `Clear` and `Identity`."""

    frames: int  # number of frames
    vessel_frames: int  # number of scored vessels in them
    hota: float | None
    deta: float | None
    assa: float | None
    mota: float | None
    idf1: float | None


@dataclass(frozen=True)
class Scores:
    """All scores of tracks over a run."""

    parts: tuple[Part, ...]  # the scores of everything
    occlusions: tuple[OcclusionEpisode, ...]
    breakdown: Breakdown  # recall and association by what only a simulator knows
    by_state: dict[str, SubsetScores]  # the frames of each performance state, by its name
    by_camera: dict[str, SubsetScores]  # the frames of each camera, by its name
    # The scores of each label alone, by its name, if the rules ask for them, but for labels without vessels and tracks.
    by_class: dict[str, Scores] = field(default_factory=dict)

    def flat(self) -> dict[str, Value]:
        """The scores of everything by their keys; None where one is not defined."""
        return {key: value for part in self.parts for key, value in vars(part).items()}

    def as_json(self) -> dict[str, Any]:
        """All scores as JSON has them."""
        subsets = {"by_state": self.by_state, "by_camera": self.by_camera}
        scores = self.flat() | {
            name: {key: asdict(part) for key, part in subset.items()} for name, subset in subsets.items()
        }
        if self.by_class:
            scores |= {"by_class": {label: part.flat() for label, part in self.by_class.items()}}
        return scores | {
            "breakdown": {group.name: [asdict(score_bin) for score_bin in group.rows] for group in self.breakdown},
            "each_occlusion": [asdict(episode) for episode in self.occlusions],
        }


def score_tracks(rows: RunRows, tracks: Tracks, rules: Rules) -> Scores:
    """Score tracks over a run. By class, the vessels and tracks of each label are matched and scored alone; the other
    scores stay as they are, of all classes as one. Raises ModsimError if it should be by class and a track has no
    label, or TrackEval is not installed."""
    unknown = int(np.count_nonzero(tracks.label == NOBODY))
    if rules.by_class and unknown:
        raise ModsimError(
            f"--by class needs a label in every row of the tracks, and {unknown} of {len(tracks)} rows have none: "
            "score without it"
        )
    return scores_of(ScoredRun.of(rows, tracks, rules))


def scores_of(scored: ScoredRun) -> Scores:
    """Score tracks that are matched already, and whose labels are checked if the rules ask for classes. Raises
    ModsimError if TrackEval is not installed."""
    names = scored.rows.scene.detector.labels if scored.rules.by_class else ()
    alone = zip(names, _by_class(scored), strict=False)
    by_class = {name: _scores(part) for name, part in alone if len(part.truth) + len(part.tracks)}
    return _scores(scored, by_class)


def _scores(scored: ScoredRun, by_class: dict[str, Scores] | None = None) -> Scores:
    whole = by_trackeval(scored)
    states, cameras = scored.rows.scene.detector.states, scored.rows.scene.cameras
    camera_frames = (scored.frames[scored.frames % scored.by_step == index] for index in range(len(cameras)))
    state_frames = (scored.state_frames(index) for index in range(len(states)))
    return Scores(
        (*whole, *(part(scored) for part in OWN_PARTS)),
        occlusions(scored),
        breakdown(scored),
        {state.name: _subset(scored, frames, whole) for state, frames in zip(states, state_frames, strict=True)},
        {
            camera.name: _subset(scored, frames, whole)
            for camera, frames in zip(cameras, camera_frames, strict=True)
            if not scored.rules.cameras or camera.name in scored.rules.cameras
        },
        by_class or {},
    )


def _subset(scored: ScoredRun, frames: Indices, whole: tuple[Hota, Clear, Identity]) -> SubsetScores:
    """The scores of some frames; those of all frames are known."""
    chosen = replace(scored, frames=frames)
    hota, clear, identity = whole if len(frames) == len(scored.frames) else by_trackeval(chosen)
    return SubsetScores(len(frames), len(chosen.truth), hota.hota, hota.deta, hota.assa, clear.mota, identity.idf1)


def _by_class(scored: ScoredRun) -> Iterator[ScoredRun]:
    truth, tracks, rules = scored.following.truth, scored.following.tracks, scored.rules
    for label in range(len(scored.rows.scene.detector.labels)):
        pair = truth.take(truth.label == label), tracks.take(tracks.label == label)
        alone = follow(*pair, rules.similarity, scored.rows.regions)
        yield ScoredRun(scored.rows, rules, alone, scored.frames)
