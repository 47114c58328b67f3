"""Tracks in the images of a run, and in the world."""

import re
from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, Self, get_args

import numpy as np
import pyarrow as pa

from modsim3d.core.arrays import NOBODY, Array, Columns, Indices, Mask
from modsim3d.core.boxes import centres, iou
from modsim3d.core.document import Result
from modsim3d.core.errors import ModsimError
from modsim3d.runs.files.table_columns import BOX_SIDES, TableColumn
from modsim3d.runs.files.tables import names_of, numbers
from modsim3d.scene.scene import Scene


@dataclass(frozen=True, eq=False, repr=False)
class Tracks(Result, Columns):
    """The boxes of all tracks: k rows in order of frame and track.

    Attributes:
        cameras: Number of cameras of the run.
        frame: Number of the frame, step × cameras + camera as in `RunRows`, shape (k,).
        track: Number that the tracker gave the track; equal ones in one camera are one track, shape (k,).
        boxes_px: x_min, y_min, x_max, y_max, shape (k, 4).
        label: Index of the label, −1 where the tracker says none, shape (k,).
        confidence: NaN where the tracker says none, shape (k,).
        covariance_px2: Of x and y of the box's centre, NaN where the tracker says none, shape (k, 2, 2).
    """

    cameras: int
    frame: Indices
    track: Indices
    boxes_px: Array
    label: Indices
    confidence: Array
    covariance_px2: Array

    @classmethod
    def of(
        cls,
        cameras: int,
        frame: Indices,
        track: Indices,
        boxes_px: Array,
        label: Indices | None = None,
        confidence: Array | None = None,
        covariance_px2: Array | None = None,
    ) -> Self:
        """Rows in any order; what is None is unknown."""
        count = len(frame)
        rows = cls(
            cameras,
            np.asarray(frame, dtype=np.int64),
            np.asarray(track, dtype=np.int64),
            np.asarray(boxes_px, dtype=np.float64).reshape(count, 4),
            np.full(count, -1) if label is None else np.asarray(label, dtype=np.int64),
            np.full(count, np.nan) if confidence is None else np.asarray(confidence, dtype=np.float64),
            np.full((count, 2, 2), np.nan) if covariance_px2 is None else np.asarray(covariance_px2, dtype=np.float64),
        )
        return rows.take(np.lexsort((rows.track, rows.frame)))

    @property
    def camera(self) -> Indices:
        """Index of the camera of each row, shape (k,)."""
        return self.frame % self.cameras

    @property
    def step(self) -> Indices:
        """Time step of each row, shape (k,)."""
        return self.frame // self.cameras

    @cached_property
    def identity(self) -> Indices:
        """Number of each row's track among those of all cameras, from 0 without gaps, shape (k,)."""
        keys = np.column_stack([self.camera, self.track])
        _, identity = np.unique(keys, axis=0, return_inverse=True)
        return np.asarray(identity, dtype=np.int64).reshape(-1)


@dataclass(frozen=True, eq=False, repr=False)
class WorldTracks(Result):
    """The estimates of all tracks: k rows in order of track and time."""

    name: str  # what tables call them
    track_names: tuple[str, ...]  # the tracker's names of the tracks
    track: Indices  # index of each row's track: (k,)
    time_s: Array  # since the scene's first step: (k,)
    position_m: Array  # centres of the vessels along w1 and w2: (k, 2)
    velocity_m_s: Array  # over ground along w1 and w2, NaN where unknown: (k, 2)
    # Of position (0, 1) and velocity (2, 3), in m², m²/s and m²/s²; NaN where unknown: (k, 4, 4).
    covariance: Array

    @classmethod
    def of(
        cls,
        name: str,
        track: Indices,
        track_names: tuple[str, ...],
        time_s: Array,
        position_m: Array,
        velocity_m_s: Array | None = None,
        covariance: Array | None = None,
    ) -> Self:
        """Rows in any order; what is None is unknown. A covariance may be that of the positions alone, (k, 2, 2)."""
        count = len(time_s)
        whole = np.full((count, 4, 4), np.nan)
        if covariance is not None:
            size = covariance.shape[-1]
            whole[:, :size, :size] = covariance
        velocity = np.full((count, 2), np.nan) if velocity_m_s is None else velocity_m_s
        order = np.lexsort((time_s, track))
        return cls(name, track_names, track[order], time_s[order], position_m[order], velocity[order], whole[order])

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.track)

    @property
    def interval_s(self) -> float:
        """Median time between two estimates of a track, 0 if no track has two."""
        gaps = np.diff(self.time_s)[np.diff(self.track) == 0]
        return float(np.median(gaps)) if len(gaps) else 0.0


DEFAULT_GATE_M = 50.0  # a track in the world that is farther from a vessel does not follow it


@dataclass(frozen=True, eq=False)
class TrackEstimates:
    """Estimate that stands for each track at each step: m of them, in order of step and track; shapes (m,)."""

    step: Indices
    row: Indices  # of the tracks

    @classmethod
    def of(cls, times_s: Array, tracks: WorldTracks) -> Self:
        """The estimate of each track that is nearest in time to each step, if it is near enough: within half of the
        median time between two estimates of a track, or half a step if that is longer. So a tracker may be slower than
        the run's steps and is still there at each."""
        step_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0
        reach_s = max(step_s, tracks.interval_s) / 2
        reach_s += 1e-6 * max(reach_s, 1.0)  # times have rounding errors
        parts = list(_nearest(times_s, tracks, reach_s))
        step, row = np.concatenate(parts, axis=1) if parts else np.zeros((2, 0), dtype=np.int64)
        order = np.argsort(step, kind="stable")
        return cls(step[order], row[order])


def _nearest(times_s: Array, tracks: WorldTracks, reach_s: float) -> Iterator[Indices]:
    """Steps that an estimate of each track reaches, and the row of the nearest one, shape (2, n)."""
    edges = np.flatnonzero(np.diff(tracks.track, prepend=NOBODY, append=NOBODY)).tolist()
    for first, stop in pairwise(edges):
        mine = tracks.time_s[first:stop]
        begin, end = np.searchsorted(times_s, (mine[0] - reach_s, mine[-1] + reach_s)).tolist()
        wanted = times_s[begin:end]
        after = np.clip(np.searchsorted(mine, wanted), 0, len(mine) - 1)
        before = np.maximum(after - 1, 0)
        nearer = np.where(wanted - mine[before] <= mine[after] - wanted, before, after)
        near = np.flatnonzero(np.abs(mine[nearer] - wanted) <= reach_s)
        yield np.stack([begin + near, first + nearer[near]])


SimilarityName = Literal["iou", "centre"]


@dataclass(frozen=True)
class Similarity:
    """A similarity of boxes, and from where on a track follows a vessel. `iou`: intersection over union; `centre`: 1 −
    distance of the centres / scale, and 0 beyond the scale."""

    name: SimilarityName = "iou"
    scale_px: float | None = None  # of `centre`
    least: float = 0.5  # similarity of a match

    def __post_init__(self) -> None:
        """Raise ModsimError if `centre` has no scale, `iou` has one, or a value is out of range."""
        if self.name == "centre" and self.scale_px is None:
            wanted = "the distance in pixels at which it is 0 (on the command line, --similarity centre:PX)"
            raise ModsimError(f"similarity centre needs scale_px, {wanted}")
        if self.name == "iou" and self.scale_px is not None:
            raise ModsimError("a scale is for similarity centre, not for iou")
        if self.scale_px is not None and not 0 < self.scale_px < np.inf:
            raise ModsimError(f"the scale of similarity centre must be above 0 (got {self.scale_px:g})")
        if not 0 < self.least <= 1:
            raise ModsimError(f"--threshold must be above 0 and at most 1 (got {self.least:g})")

    @classmethod
    def parse(cls, text: str | None, least: float = 0.5) -> Self:
        """A similarity from a text: `iou`, as also without one, or `centre:40`. Raises ModsimError for another."""
        name, colon, scale = (text or "iou").partition(":")
        with suppress(ValueError):
            scale_px = float(scale) if colon else None
            if name in get_args(SimilarityName):
                return cls(name, scale_px, least)  # type: ignore[arg-type]
        raise ModsimError(f"--similarity: needs iou, or centre:PX as in centre:40 (got '{text}')")

    def __str__(self) -> str:
        """The similarity in words."""
        return "IoU" if self.scale_px is None else f"1 - distance of centres / {self.scale_px:g} px"

    def __call__(self, a_px: Array, b_px: Array) -> Array:
        """Similarity of boxes pair by pair; shapes broadcast, as (n, 1, 4) and (m, 4) to (n, m)."""
        if self.scale_px is None:
            return iou(a_px, b_px)
        distance = np.hypot(*np.moveaxis(centres(a_px) - centres(b_px), -1, 0))
        alike: Array = np.maximum(1 - distance / self.scale_px, 0)
        return alike


@dataclass(frozen=True)
class Origin:
    """Tracker that made tracks, with its settings and versions."""

    tracker: str
    settings: dict[str, Any]  # all of them, as JSON can hold them
    chosen: str  # where the settings come from, a sentence
    package: str  # that the tracker is a part of, with its version, such as `modsim3d 0.3.0`
    versions: dict[str, str]  # of the packages that decide the tracks, by name


@dataclass(frozen=True, eq=False, repr=False)
class TrackSet(Result):
    """The tracks of one tracker in a run."""

    name: str  # what tables call it
    tracks: Tracks
    origin: Origin | None  # None for somebody's own file
    unnamed: tuple[str, ...] = ()  # cameras of which a file has no line, though it has lines of others and could say so

    def in_cameras(self, cameras: Sequence[int]) -> Self:
        """The tracks in some cameras, by their indices."""
        return replace(self, tracks=self.tracks.take(np.isin(self.tracks.camera, cameras)))


def source_of(path: Path) -> str:
    """Name of a file of tracks in messages."""
    return f"tracks {path}"


def name_of(path: Path) -> str:
    """Name of somebody's own tracks in a file, in tables."""
    return path.name.removesuffix(".gz").rsplit(".", 1)[0]


FAR = "the box lies more than an image away from the image, as does all of its track"


def far_tracks(boxes_px: Array, track: Indices, image_px: Array) -> Mask:
    """Mask of the boxes (k, 4) of tracks that never come within an image of their image: (k,). A track that has been
    there may coast as far as it likes: its boxes are false positives. `track` tells the track of each from others: (k,)
    or (k, columns); the size of the image, or of each box's, is (2,) or (k, 2)."""
    beyond: Mask = (boxes_px[:, 2:] < -image_px) | (boxes_px[:, :2] > 2 * image_px)
    far: Mask = np.any(beyond, axis=1)
    if far.any():
        _, own = np.unique(track, axis=0, return_inverse=True)
        near = np.bincount(own.reshape(-1), weights=~far) > 0
        return far & ~near[own.reshape(-1)]
    return far


def covariances(xx: Array, xy: Array, yy: Array) -> Mask:
    """Whether variances and a covariance are those of a distribution, same shape; not where any is NaN."""
    possible: Mask = (xx > 0) & (yy > 0) & (xx * yy > xy * xy) & np.isfinite(xx + yy)
    return possible


SEQUENCE_HEADING = "name"
"""The first line of a sequence map; some programs skip every line like it, so that no sequence has this name."""
_NOT_IN_NAMES = re.compile(r"[^A-Za-z0-9_.-]")


def plain_name(wanted: str) -> str:
    """A name without the characters that names of files had better not have."""
    return _NOT_IN_NAMES.sub("_", wanted)


def free_name(wanted: str, given: Collection[str]) -> str:
    """A name for a sequence like the one that is wanted, which none of the given has in upper or lower case."""
    plain, taken = plain_name(wanted), {SEQUENCE_HEADING, *(name.lower() for name in given)}
    name, number = plain, 1
    while name.lower() in taken:
        number += 1
        name = f"{plain}-{number}"
    return name


def camera_sequence_names(cameras: Sequence[str]) -> tuple[str, ...]:
    """The sequence of each camera, by the names of all cameras."""
    names: list[str] = []
    for camera in cameras:
        names.append(free_name(camera, names))
    return tuple(names)


COVARIANCES = ("var_x_px2", "cov_xy_px2", "var_y_px2")
_NONE = "null if the tracker says none"
_SIDES = ("left", "upper", "right", "lower")
COLUMNS = (
    TableColumn("camera", pa.string(), "", "name of the camera"),
    TableColumn("step", pa.int64(), "", "number of the scene's time step, from 0"),
    TableColumn("timestamp", pa.string(), "", "time of the step in seconds, as the scene's poses write it"),
    TableColumn("track", pa.int64(), "", "number of the track; equal ones in one camera are one track"),
    TableColumn("label", pa.string(), "", f"class of the track; {_NONE}"),
    *(
        TableColumn(name, pa.float64(), "px", f"{side} edge of the box, beyond the image too")
        for name, side in zip(BOX_SIDES, _SIDES, strict=True)
    ),
    TableColumn("confidence", pa.float64(), "", f"confidence of the track in this frame, from 0 to 1; {_NONE}"),
    TableColumn("var_x_px2", pa.float64(), "px²", f"variance of the column of the centre of the box; {_NONE}"),
    TableColumn("cov_xy_px2", pa.float64(), "px²", f"covariance of column and row of the centre; {_NONE}"),
    TableColumn("var_y_px2", pa.float64(), "px²", f"variance of the row of the centre; {_NONE}"),
)
SCHEMA = pa.schema([column.field for column in COLUMNS])


def track_table(tracks: Tracks, scene: Scene) -> pa.Table:
    """The rows of tracks, in order of step, camera and track."""
    steps = int(tracks.step.max(initial=-1)) + 1
    variances = tracks.covariance_px2[:, [0, 0, 1], [0, 1, 1]].T
    columns: dict[str, Any] = {
        "camera": names_of([camera.name for camera in scene.cameras], tracks.camera),
        "step": tracks.step,
        "timestamp": names_of(scene.timestamps(0, steps), tracks.step),
        "track": tracks.track,
        "label": names_of(scene.detector.labels, tracks.label),
        **{name: np.ascontiguousarray(side) for name, side in zip(BOX_SIDES, tracks.boxes_px.T, strict=True)},
        "confidence": numbers(tracks.confidence),
        **{name: numbers(part) for name, part in zip(COVARIANCES, variances, strict=True)},
    }
    return pa.table([columns[name] for name in SCHEMA.names], schema=SCHEMA).combine_chunks()
