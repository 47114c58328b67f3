"""The frames of a run for the player of its page, in few bytes, and in parts that the player unpacks as needed.

A length in the image is a multiple of `quantum_px`, which is 0.1 px for all but very large images.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from modsim3d.arrays import Indices
from modsim3d.detector.records import KINDS
from modsim3d.runs.outcomes import Outcome
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.scene.scene import Scene
from modsim3d.view import palette
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.report.recording.clock import clock
from modsim3d.view.report.recording.overview import Overview, ShownRows
from modsim3d.view.report.recording.packing import NONE, ROW_BEFORE, Coded, Column, packed, starts
from modsim3d.view.report.recording.part_columns import (
    ALL_SEA,
    PartFrames,
    detection_columns,
    frame_columns,
    truth_columns,
)
from modsim3d.view.report.recording.part_motion import PartMotion
from modsim3d.view.report.recording.parts import PartRows, parts, shown_in_a_part
from modsim3d.view.report.recording.places import Places
from modsim3d.view.report.recording.silhouettes.silhouettes import Silhouettes
from modsim3d.view.report.recording.track_columns import Lanes, TrackRows, track_facts
from modsim3d.view.report.recording.vessel_outcomes import OutcomesBuilder, OutcomeStretches

FINEST_PX = 0.1


@dataclass(frozen=True, eq=False)
class Recording:
    """The frames of a run for the player.

    Attributes:
        name: Tells the recordings of a page apart: `A`, `B`.
        facts: What the numbers mean: names, colours, times.
        overview: Packed columns of what the timeline shows, which the player unpacks first.
        parts: Packed columns of each part of the shown steps.
        outcomes: What became of the vessels, of each camera.
    """

    name: str
    facts: dict[str, Any]
    overview: bytes
    parts: tuple[bytes, ...]
    outcomes: tuple[OutcomeStretches, ...]


def recording(
    run: StoredRun,
    every: int = 1,
    progress: Callable[[int], None] = lambda steps: None,
    followed: FollowedTracks | None = None,
    name: str = "A",
    count: Callable[[RunRows], None] = lambda rows: None,
) -> Recording:
    """The recording of every K-th step of a run, with tracks if there are some.

    A camera with a frame rate of its own shows the last frame that it took, and an empty frame before its first one.

    Args:
        run: The run; no more than a part of it is in memory at once.
        every: K.
        progress: Called with the number of shown steps done since its last call.
        followed: Tracks of the run.
        name: The recording's name on its page.
        count: Called with all rows of the run, some steps at a time.

    Raises:
        RunDirectoryError: The tables are not what a run has written.
    """
    recorder = _Recorder(run, every, followed)
    done = []
    for part in parts(run, every, count):
        done.append(packed(recorder.columns(part)))
        progress(len(part.steps))
    facts, overview = recorder.overview()
    facts |= {"parts": len(done), "partSteps": shown_in_a_part(run.scene, every)}
    return Recording(name, facts, packed(overview), tuple(done), recorder.outcomes())


class _Recorder:
    """What is the same for all parts of a recording, or is gathered over them."""

    def __init__(self, run: StoredRun, every: int, followed: FollowedTracks | None) -> None:
        self._scene, self._every, self._followed = run.scene, every, followed
        self._steps = np.arange(0, run.steps, every)
        self._quantum = quantum_px([camera.intrinsics.image_size_px for camera in run.scene.cameras])
        self._places = Places(run.scene)
        self._silhouettes = Silhouettes(run.scene, self._quantum)
        sizes = len(self._steps), len(run.scene.vessels), len(run.scene.detector.states)
        self._overviews = [Overview(*sizes) for _ in run.scene.cameras]
        self._outcomes = [OutcomesBuilder() for _ in run.scene.cameras]
        self._lanes, self._tracks = [], None
        if followed is not None:
            self._lanes = [Lanes(len(run.scene.vessels)) for _ in run.scene.cameras]
            self._tracks = TrackRows(followed, run.scene, self._steps)

    def columns(self, part: PartRows) -> dict[str, Column | Coded]:
        """The columns of a part, which is added to the overviews."""
        frames = PartFrames(part)
        horizons = np.empty((frames.pages, 3))
        horizons[frames.count :] = ALL_SEA
        motion = PartMotion(self._scene, [part.steps, *frames.steps])
        shape_frame, silhouettes = self._silhouettes.columns(part.rows, frames.steps, motion, horizons)
        columns = {
            **frame_columns(part, frames),
            "horizon": Coded(horizons.astype(np.float32), by=ROW_BEFORE),
            "shapeStart": Coded(starts(shape_frame, frames.pages), by=ROW_BEFORE),
            **silhouettes,
            **truth_columns(part.rows, frames, self._quantum),
            **detection_columns(part.rows, frames, self._quantum),
            **self._places.columns(part.steps, motion),
        }
        if self._tracks is not None:
            columns |= self._tracks.columns(frames, self._quantum)
        self._add(part, frames.shown, columns)
        return columns

    def _add(self, part: PartRows, shown: Indices, columns: Mapping[str, Column | Coded]) -> None:
        index = part.steps // self._every
        plain = {name: each.values if isinstance(each, Coded) else each for name, each in columns.items()}
        for camera, (overview, outcomes) in enumerate(zip(self._overviews, self._outcomes, strict=True)):
            rows = ShownRows.of(index, shown[:, camera], plain)
            overview.add(rows)
            outcomes.add(rows)
        for camera, lanes in enumerate(self._lanes):
            lanes.add(index, shown[:, camera], part.taken[:, camera], plain)

    def outcomes(self) -> tuple[OutcomeStretches, ...]:
        """What became of the vessels, of each camera, once all parts are there."""
        return tuple(each.stretches() for each in self._outcomes)

    def overview(self) -> tuple[dict[str, Any], dict[str, Column | Coded]]:
        """The facts, and the columns of what the timeline shows, once all parts are there."""
        scene, steps = self._scene, self._steps
        timestamps = scene.timestamps(0, int(steps[-1]) + 1)[:: self._every]
        times, columns = clock(timestamps)
        every: dict[str, Column | Coded] = {**columns, **self._silhouettes.still_columns()}
        for camera, overview in enumerate(self._overviews):
            every |= overview.columns(f"{camera}.", half=bool(self._lanes))
        for camera, lanes in enumerate(self._lanes):
            every |= lanes.columns(f"{camera}.lanes.")
        facts = {
            "length": len(steps),
            "every": self._every,
            "clock": times,
            "overviews": [overview.facts(self._quantum) for overview in self._overviews],
            **_facts(scene, self._quantum),
            **self._places.facts(),
        }
        if self._followed is not None:
            facts["tracks"] = track_facts(self._followed)
        return facts, every


def _facts(scene: Scene, quantum: float) -> dict[str, Any]:
    """What the numbers mean: names, colours."""
    vessels = [palette.vessel_colour(index) for index in range(len(scene.vessels))]
    obstacles = [palette.obstacle_colour(index) for index in range(len(scene.obstacles))]
    states = palette.state_colours(len(scene.detector.states))
    return {
        "name": scene.name,
        "quantum": quantum,
        "mode": scene.annotation.mode,
        "states": [state.name for state in scene.detector.states],
        "labels": list(scene.detector.labels),
        "kinds": list(KINDS),
        "outcomes": {outcome.name: outcome.value for outcome in Outcome},
        "occluders": list(scene.occluder_names),
        "vessels": [{"name": v.name, "label": v.label} for v in scene.vessels],
        "cameras": [
            {"name": camera.name, "size": list(camera.intrinsics.image_size_px), "carrier": camera.mount.vessel}
            for camera in scene.cameras
        ],
        "colours": {
            "vessels": [palette.css(colour) for colour in vessels],
            "owners": [*(palette.css(palette.darker(colour)) for colour in vessels), *map(palette.css, obstacles)],
            "states": [palette.css(colour) for colour in states],
            **{name: palette.css(getattr(palette, name.upper())) for name in ("sea", "sky", "truth", "alarm", "ink")},
        },
    }


def quantum_px(image_sizes_px: list[tuple[int, int]]) -> float:
    """The finest length with which every place in the images fits into 16 bits."""
    return max(FINEST_PX, max(max(size) for size in image_sizes_px) / (NONE - 1))
