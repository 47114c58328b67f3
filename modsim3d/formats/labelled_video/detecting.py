"""The detector over the videos of a labelled set, some frames at a time."""

import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.detector.chain import Detector, target_statistics
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.persistence import Clock
from modsim3d.detector.records import CameraFrames, Detections, Targets
from modsim3d.formats.labelled import EVERYWHERE
from modsim3d.formats.labelled_video.targets import TargetBoxes, Video
from modsim3d.runs.counts import Counts, detection_counts
from modsim3d.runs.files.table_columns import BOX_SIDES, COLUMNS, TableColumn
from modsim3d.runs.files.tables import ROW_GROUP_ROWS, detection_columns, named, numbers

BLOCK_BOXES, BLOCK_FRAMES = 8000, 2000
"""About so many boxes, and at most so many frames, are worked on at once; no result depends on it."""


@dataclass(frozen=True, eq=False)
class VideoChunk:
    """Consecutive frames of a video, and what the detector was given and made of them."""

    video: Video
    steps: Indices  # place of each frame in the video: (S,)
    rows: Indices  # of the sought boxes in these frames: (n,)
    frame: Indices  # of each of these rows, counted from the first: (n,)
    target_rows: Indices  # places of those that are visible, and were given to the detector: (k,)
    detections: Detections

    @property
    def times_s(self) -> Array:
        """Times of the frames as the file has them, shape (S,)."""
        return self.video.times_s[self.steps]

    @property
    def origin(self) -> Indices:
        """Row of the sought boxes that each detection came from, −1 for none, shape (m,)."""
        target = self.detections.target
        if not len(self.target_rows):
            return np.full(len(target), -1)
        return np.where(target >= 0, self.rows[self.target_rows[target]], -1)

    @property
    def detected(self) -> Mask:
        """Mask of the sought boxes that were detected, shape (n,)."""
        found, detections = np.zeros(len(self.rows), dtype=bool), self.detections
        own, shared = detections.target[~detections.false()], detections.partner[detections.partner >= 0]
        found[self.target_rows[np.concatenate([own, shared])]] = True
        return found


@dataclass(frozen=True, eq=False)
class _Block:
    """Frames that the detector is given at once."""

    rows: Indices
    frame: Indices
    target_rows: Indices
    frames: CameraFrames
    targets: Targets


def detected_parts(
    videos: Sequence[Video],
    sought: TargetBoxes,
    tracks: Sequence[int | str],
    model: DetectorModel,
    seed: int,
    horizon: Array | None,
) -> Iterator[VideoChunk]:
    """Run a detector over the boxes of all videos, each of which is a camera of its own. `horizon` is the half-plane of
    the sea: (3,); None if it is not known."""
    sea = EVERYWHERE if horizon is None else horizon
    start_s = min(float(video.times_s[0]) for video in videos)
    rows = _rows_of(videos, sought)
    blocks = [
        list(_blocks(video, *of_video, sought, tracks, start_s, sea))
        for video, of_video in zip(videos, rows, strict=True)
    ]
    statistics = target_statistics(model, ((block.frames, block.targets) for of_video in blocks for block in of_video))
    for video, of_video in zip(videos, blocks, strict=True):
        detector = Detector(model, seed, statistics, _clock(video.times_s - start_s))
        for block in of_video:
            detections = detector.detect(block.frames, block.targets)
            yield VideoChunk(video, block.frames.steps, block.rows, block.frame, block.target_rows, detections)


def _clock(times_s: Array) -> Clock:
    return lambda first, stop: times_s[first:stop]


def _rows_of(videos: Sequence[Video], sought: TargetBoxes) -> list[tuple[Indices, Indices]]:
    """For each video the rows of its boxes, and the frame of each, both of shape (n,) and in order of frame."""
    images = np.concatenate([video.images for video in videos])
    frame_of, place_of = np.empty(len(images), dtype=np.int64), np.empty(len(images), dtype=np.int64)
    lengths = [len(video.images) for video in videos]
    place_of[images] = np.arange(len(images))
    frame_of[images] = np.concatenate([np.arange(length) for length in lengths])
    rows = np.argsort(place_of[sought.image], kind="stable")
    edges = np.searchsorted(place_of[sought.image[rows]], np.cumsum(lengths)[:-1])
    return [(ours, frame_of[sought.image[ours]]) for ours in np.split(rows, edges)]


def _blocks(
    video: Video,
    rows: Indices,
    frame: Indices,
    sought: TargetBoxes,
    tracks: Sequence[int | str],
    start_s: float,
    sea: Array,
) -> Iterator[_Block]:
    used, vessel = np.unique(sought.track[rows], return_inverse=True)
    ids = tuple(str(tracks[track]) for track in used.tolist())
    for first, stop in _ranges(np.searchsorted(frame, np.arange(len(video.images) + 1))):
        ours = slice(*np.searchsorted(frame, (first, stop)))
        of_block, steps = rows[ours], np.arange(first, stop)
        visible = np.flatnonzero(sought.visible[of_block])
        targets = of_block[visible]
        frames = CameraFrames(
            camera=video.name,
            steps=steps,
            times_s=video.times_s[steps] - start_s,
            image_size_px=video.size_px,
            sea_half_planes=np.tile(sea, (len(steps), 1)),
            previous_s=float(video.times_s[first - 1]) - start_s if first else -np.inf,
        )
        seen = Targets(
            frame=frame[ours][visible] - first,
            vessel=vessel[ours][visible],
            label=sought.label[targets],
            boxes_px=sought.boxes_px[targets],
            visible_fraction=sought.visible_fraction[targets],
            depth_m=sought.depth_m[targets],
            vessel_ids=ids,
        )
        yield _Block(of_block, frame[ours] - first, visible, frames, seen)


def _ranges(starts: Indices) -> Iterator[tuple[int, int]]:
    """Runs of frames with about `BLOCK_BOXES` boxes each, given the row of each frame's first box, shape (S + 1,)."""
    first, count = 0, len(starts) - 1
    while first < count:
        stop = int(np.searchsorted(starts, starts[first] + BLOCK_BOXES, side="right")) - 1
        stop = min(max(stop, first + 1), first + BLOCK_FRAMES, count)
        yield first, stop
        first = stop


def count_part(part: VideoChunk, sought: TargetBoxes) -> Counts:
    """Counts over some frames; see `Counts`."""
    visible, origin = sought.visible_fraction[part.rows], part.origin[~part.detections.false()]
    return Counts(
        frames=len(part.steps),
        vessel_frames=len(part.rows),
        seen=int((visible > 0).sum()),
        partly_hidden=int(((visible > 0) & (visible < 1)).sum()),
        fully_hidden=int((visible == 0).sum()),
        annotated=len(part.target_rows),
        detected=(detected := int(part.detected.sum())),
        missed=len(part.target_rows) - detected,
        **detection_counts(part.detections, sought.boxes_px[origin], sought.label[origin]),
    )


# ---- The Parquet tables of a detector over other people's truth ----

IMAGE = TableColumn(
    "image", pa.string(), "", "what the file of truth calls the image: its ID in COCO, the frame in MOT"
)
FROM_OVERLAP = TableColumn(
    "from_overlap", pa.bool_(), "", "whether visible_fraction comes from the overlap of boxes and not from the file"
)
_TRUTH = ("camera", "step", "timestamp", "vessel", "label", *(f"full_{side}" for side in BOX_SIDES))
_TRUTH_NUMBERS = ("visible_fraction", "depth_m", "annotated", "detected")


def _columns(table: str, names: Sequence[str]) -> tuple[TableColumn, ...]:
    known = {column.name: column for column in COLUMNS[table]}
    return tuple(known[name] for name in names)


TABLES = {
    "frames": (*COLUMNS["frames"], IMAGE),
    "truth": (*_columns("truth", (*_TRUTH, *_TRUTH_NUMBERS)), FROM_OVERLAP),
    "detections": COLUMNS["detections"],
}
"""The columns of each table, in order."""


def tables_of(
    parts: Sequence[VideoChunk],
    sought: TargetBoxes,
    tracks: Sequence[int | str],
    images: Sequence[int | str],
    model: DetectorModel,
) -> dict[str, bytes]:
    """The files of all tables, by the name of the table."""
    names = [str(track) for track in tracks]
    return {
        "frames": _file(TABLES["frames"], [_frames(part, images, model) for part in parts]),
        "truth": _file(TABLES["truth"], [_truth(part, sought, names, model) for part in parts]),
        "detections": _file(TABLES["detections"], [_detections(part, sought, names, model) for part in parts]),
    }


def _file(columns: Sequence[TableColumn], parts: Sequence[dict[str, Any]]) -> bytes:
    schema = pa.schema([column.field for column in columns])
    whole = pa.concat_tables([pa.table([part[name] for name in schema.names], schema=schema) for part in parts])
    buffer = io.BytesIO()
    pq.write_table(whole.combine_chunks(), buffer, compression="zstd", row_group_size=ROW_GROUP_ROWS)
    return buffer.getvalue()


def _keys(part: VideoChunk, frame: Indices) -> dict[str, Any]:
    times = [repr(time_s) for time_s in part.times_s.tolist()]
    return {
        "camera": named([part.video.name], np.zeros(len(frame), dtype=np.int64)),
        "step": part.steps[frame],
        "timestamp": named(times, frame),
    }


def _frames(part: VideoChunk, images: Sequence[int | str], model: DetectorModel) -> dict[str, Any]:
    detections, count = part.detections, len(part.steps)
    false = detections.false()
    return {
        **_keys(part, np.arange(count)),
        "state": named([state.name for state in model.states], detections.states),
        "n_annotated": np.bincount(part.frame[part.target_rows], minlength=count),
        "n_detected": np.bincount(detections.frame[~false], minlength=count),
        "n_false": np.bincount(detections.frame[false], minlength=count),
        "image": pa.array([str(images[image]) for image in part.video.images[part.steps].tolist()], pa.string()),
    }


def _truth(part: VideoChunk, sought: TargetBoxes, names: Sequence[str], model: DetectorModel) -> dict[str, Any]:
    rows = part.rows
    return {
        **_keys(part, part.frame),
        "vessel": named(names, sought.track[rows]),
        "label": named(model.labels, sought.label[rows]),
        **{f"full_{side}": sought.boxes_px[rows, k] for k, side in enumerate(BOX_SIDES)},
        "visible_fraction": sought.visible_fraction[rows],
        "depth_m": numbers(sought.depth_m[rows]),
        "annotated": sought.visible[rows],
        "detected": part.detected,
        "from_overlap": sought.from_overlap[rows],
    }


def _detections(part: VideoChunk, sought: TargetBoxes, names: Sequence[str], model: DetectorModel) -> dict[str, Any]:
    origin = part.origin
    vessel = np.where(origin >= 0, sought.track[origin], -1) if len(sought) else origin
    return {
        **_keys(part, part.detections.frame),
        **detection_columns(part.detections, model),
        "vessel": named(names, vessel),
    }
