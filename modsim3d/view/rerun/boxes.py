"""Boxes of a run in a recording: truth, detections and tracks in each image, and how many of them are wrong."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import centres
from modsim3d.runs.files.columns import NOBODY, indices, numbers
from modsim3d.runs.outcomes import Outcome, having
from modsim3d.runs.run_rows import RunRows
from modsim3d.view import palette
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.outcome_words import NAMES, is_a
from modsim3d.view.rerun.log import Log, image_path

COUNTS = {
    Outcome.FALSE_POSITIVE: "false",
    Outcome.MISLABELLED: "wrong_class",
    Outcome.BELOW_HALF_IOU: "below_half_iou",
    Outcome.OFF_VESSEL: "off_vessel",
}
"""What is counted of the detections of each frame, and under which name."""
MISSED, FALSE, TRACKS, FALSE_TRACKS = "missed", "false", "tracks", "false_tracks"
COLOURS = {
    MISSED: palette.ALARM,
    FALSE: palette.VESSELS[1],
    "wrong_class": palette.VESSELS[4],
    "below_half_iou": palette.VESSELS[3],
    "off_vessel": palette.VESSELS[2],
    TRACKS: palette.TRACKS[2],
    FALSE_TRACKS: palette.ALARM,
}
"""Of the lines of the plots, by what they count."""
TEXT = (0.09, 0.07)
"""Width and height of a text below a box, as shares of the image."""
PALER = 0.35
"""How much paler the lines of each further camera are."""


@dataclass(eq=False)
class Boxes:
    """Puts the boxes and counts of a run into its recording."""

    log: Log
    rows: RunRows
    followed: FollowedTracks | None = None
    _states: dict[str, int] = field(default_factory=dict)
    _texts: list[Array] = field(default_factory=list)

    @cached_property
    def _columns(self) -> BoxColumns:
        return BoxColumns.of(self.rows)

    def fixed(self) -> None:
        """Log how counts and states are drawn."""
        sdk, model = self.log.sdk, self.log.scene.detector
        names = [state.name for state in model.states]
        colours = np.array(palette.state_colours(len(names)), dtype=np.uint8)
        look = sdk.StateConfiguration(values=names, colors=colours)
        many = len(self.log.scene.cameras) > 1
        for index, camera in enumerate(self.log.scene.cameras):
            self.log.put(["detector", camera.name], look, static=True)
            for count, colour in COLOURS.items():
                if self.followed is None and count in (TRACKS, FALSE_TRACKS):
                    continue
                paler = palette.mixed(colour, palette.WHITE, 1 - (1 - PALER) ** index)
                name = count.replace("_", " ") + (f", {camera.name}" if many else "")
                line = sdk.SeriesLines(colors=[paler], names=[name], interpolation_mode="StepAfter")
                self.log.put(["counts", camera.name, count], line, static=True)

    def show(self, steps: Indices) -> None:
        """Log the boxes and counts of each camera at some steps, shape (n,)."""
        columns, rows, cameras = self._columns, self.rows, self.log.scene.cameras
        for step, camera, truth, drawn in _frames(rows, steps):
            self.log.at(step)
            self._texts.clear()
            frame = step * len(cameras) + camera
            self._state(cameras[camera].name, int(rows.states_of(np.array([frame]))[0]))
            self._truth(cameras[camera].name, columns.missed[truth], columns.full_px[truth], columns.truth_tags[truth])
            self._detections(cameras[camera].name, drawn)
            if self.followed is not None:
                self._tracks(self.followed, frame, cameras[camera].name)

    def _truth(self, camera: str, missed: Mask, boxes_px: Array, tags: list[str]) -> None:
        """Log the boxes of the truth, and the missed ones again with their names."""
        colours = [palette.ALARM if lost else palette.TRUTH for lost in missed]
        self._boxes(camera, "truth", boxes_px, colours, tags, radii=self.log.thin())
        lost = np.flatnonzero(missed)
        self._named(camera, MISSED, boxes_px[lost], [tags[i] for i in lost])
        self._count(camera, MISSED, len(lost))

    def _detections(self, camera: str, drawn: slice) -> None:
        """Log the boxes of the detections, the false ones again with what they say, and what is wrong with them."""
        rows, columns, outcome = self.rows, self._columns, self.rows.outcomes[drawn]
        false, boxes_px, tags = having(outcome, Outcome.FALSE_POSITIVE), columns.drawn_px[drawn], columns.tags[drawn]
        found = zip(rows.detection_vessel[drawn].tolist(), false.tolist(), strict=True)
        colours = [palette.ALARM if is_false else palette.vessel_colour(source) for source, is_false in found]
        self._boxes(camera, "detections", boxes_px, colours, tags)
        self._named(camera, FALSE, boxes_px[false], [tags[i] for i in np.flatnonzero(false)])
        lines = columns.tethers[drawn][having(outcome, Outcome.OFF_VESSEL)]
        self.log.put([*image_path(camera), "off_vessel"], self.log.sdk.LineStrips2D(lines, colors=[palette.ALARM]))
        for flag, count in COUNTS.items():
            self._count(camera, count, int(having(outcome, flag).sum()))

    def _tracks(self, followed: FollowedTracks, frame: int, camera: str) -> None:
        """Log the tracks in a frame, by its number, with the names of the vessels that they follow, and how many."""
        rows, names = followed.rows_of(frame), (*self.log.scene.vessel_names, "nothing")
        numbers, vessels = followed.tracks.track[rows].tolist(), followed.vessel[rows].tolist()
        shown = list(zip(numbers, vessels, strict=True))
        colours = [palette.ALARM if vessel == NOBODY else palette.track_colour(number) for number, vessel in shown]
        tags = [f"#{number} on {names[vessel]}" for number, vessel in shown]
        self._boxes(camera, TRACKS, followed.tracks.boxes_px[rows], colours, tags)
        self._count(camera, TRACKS, len(shown))
        self._count(camera, FALSE_TRACKS, vessels.count(NOBODY))

    def _boxes(
        self, camera: str, name: str, boxes_px: Any, colours: Sequence[palette.Colour], tags: list[str], **style: Any
    ) -> None:
        """Log boxes whose texts are shown for the one under the pointer."""
        style = {"array_format": self.log.sdk.Box2DFormat.XYXY, "show_labels": False, **style}
        boxes = self.log.sdk.Boxes2D(array=boxes_px, colors=colours, labels=tags, **style)
        self.log.put([*image_path(camera), name], boxes)

    def _named(self, camera: str, name: str, boxes_px: Any, tags: list[str]) -> None:
        """Log thick boxes in the colour of what went wrong, with those of their texts that lie on no other."""
        size = next(each.intrinsics.image_size_px for each in self.log.scene.cameras if each.name == camera)
        for i, (x0, _, x1, y1) in enumerate(boxes_px.tolist()):
            place = np.array([(x0 + x1) / 2, y1]) / size
            if any((np.abs(place - taken) < TEXT).all() for taken in self._texts):
                tags[i] = ""
            else:
                self._texts.append(place)
        self._boxes(camera, name, boxes_px, [palette.ALARM] * len(tags), tags, show_labels=True, radii=self.log.thick())

    def _count(self, camera: str, name: str, count: int) -> None:
        self.log.put(["counts", camera, name], self.log.sdk.Scalars(float(count)))

    def _state(self, camera: str, state: int) -> None:
        """Log the performance state where it changes."""
        if self._states.get(camera) != state:
            name = self.log.scene.detector.states[state].name
            self.log.put(["detector", camera], self.log.sdk.StateChange(state=name))
            self._states[camera] = state


@dataclass(frozen=True, eq=False)
class BoxColumns:
    """What is logged of the n rows of the truth and the m detections of a run.

    Attributes:
        missed: Shape (n,).
        truth_tags: What is written at each row of the truth, n texts.
        full_px: Boxes of the whole silhouettes, shape (n, 4).
        drawn_px: Boxes of the detections, shape (m, 4).
        tags: What is written at each detection, m texts.
        tethers: Lines from the centres of the detections to their vessels' annotated boxes; NaN for a false positive,
            shape (m, 2, 2).
    """

    rows: RunRows
    missed: Mask
    truth_tags: list[str]
    full_px: Array
    drawn_px: Array
    tags: list[str]
    tethers: Array

    @classmethod
    def of(cls, rows: RunRows) -> BoxColumns:
        """The columns of a run."""
        names, missed, drawn_px = rows.scene.vessel_names, rows.annotated & ~rows.detected, rows.detection_boxes_px()
        lost = zip(rows.truth_vessel.tolist(), missed.tolist(), strict=True)
        known = rows.detected_row != NOBODY
        tethers = np.full((len(drawn_px), 2, 2), np.nan)
        low, high = np.split(rows.annotated_boxes_px[rows.detected_row[known]], 2, axis=1)
        tethers[known, 0] = centres(drawn_px[known])
        tethers[known, 1] = np.clip(tethers[known, 0], low, high)
        return cls(
            rows,
            missed,
            [f"{names[vessel]} missed" if is_missed else names[vessel] for vessel, is_missed in lost],
            rows.boxes_px("full"),
            drawn_px,
            _detection_tags(rows),
            tethers,
        )


def _detection_tags(rows: RunRows) -> list[str]:
    """What is written at each detection: class, confidence, and what is wrong with it."""
    names, vessels = rows.scene.detector.labels, rows.scene.vessels
    labels, confidence = indices(rows.detections, "label", names).tolist(), numbers(rows.detections, "confidence")
    tags = []
    columns = (labels, confidence.tolist(), rows.detection_vessel.tolist(), rows.outcomes.tolist())
    for label, sure, vessel, outcome in zip(*columns, strict=True):
        words = [f"{'false: ' if outcome & Outcome.FALSE_POSITIVE else ''}{names[label]} {sure:.2f}"]
        if outcome & Outcome.MISLABELLED:
            words.append(is_a(vessels[vessel].label))
        if outcome & Outcome.BELOW_HALF_IOU:
            words.append(NAMES[Outcome.OFF_VESSEL if outcome & Outcome.OFF_VESSEL else Outcome.BELOW_HALF_IOU])
        tags.append(", ".join(words))
    return tags


def _frames(rows: RunRows, steps: Indices) -> Iterator[tuple[int, int, slice, slice]]:
    """Step and camera of each frame that was taken at some steps, and its rows of truth and detections."""
    cameras = len(rows.scene.cameras)
    for number in rows.frames[np.isin(rows.frames // cameras, steps)].tolist():
        frame = (number, number + 1)
        truth, drawn = (np.searchsorted(column, frame) for column in (rows.truth_frame, rows.detection_frame))
        yield number // cameras, number % cameras, slice(*truth), slice(*drawn)
