"""COCO ground truth and results out of a labelled set. Beside COCO's own keys an image has `condition`, `sequence`,
`time_s` and `horizon`, its rows at the left and the right edge, and an annotation `track_id`, `visible_fraction` and
`distance_m`, where they are known. Results name nobody."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from modsim3d.core.arrays import Indices, Mask
from modsim3d.core.errors import ModsimError
from modsim3d.formats.labelled import LabelledSet, written_horizon
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.writing.export_formats import ExportRequest
from modsim3d.io.atomic_write import write_files
from modsim3d.render.id_pass import IdRenderer, Region
from modsim3d.runs.camera_sequences import CameraSequence
from modsim3d.runs.pipeline import open_renderer
from modsim3d.runs.tracker_view import BOX_DECIMALS, anonymised
from modsim3d.scene.scene import Scene
from modsim3d.truth.analytic import PixelMasks
from modsim3d.truth.full_frame import vessel_masks

_BLOCK_FRAMES = 50  # whose solids are in memory at a time
_MAX_CHARACTERS = 7  # of a number in the encoding, 5 bits each: images have fewer than 2^34 pixels


def check_masks(request: ExportRequest) -> None:
    """Raise ModsimError for a run whose truth was not counted from the image's own pixels."""
    annotation, folder = request.run.scene.annotation, request.run.folder
    if annotation.source != "rendered":
        remedy = f"this one's source is {annotation.source}: run the scene with --source rendered"
        raise ModsimError(f"{folder}: --masks needs a truth that was counted from pixels, and {remedy}")
    if annotation.supersample != 1:
        drawn = f"this one was drawn with supersample {annotation.supersample}"
        needed = f"one pixel of the truth for each of the image, and {drawn}"
        raise ModsimError(f"{folder}: --masks needs {needed}: run the scene with --set annotation.supersample=1")


def mask_entries(request: ExportRequest) -> Iterator[dict[str, Any]]:
    """The keys of each annotated vessel, in order of camera, frame and vessel. Raises ModsimError if what is drawn now
    has not the pixels that the run counted."""
    scene = request.run.scene
    with open_renderer(scene) as renderer:
        assert renderer is not None  # see `check_masks`
        for sequence in request.sequences:
            for first in range(0, len(sequence.steps), _BLOCK_FRAMES):
                yield from _block_entries(scene, sequence, first, renderer)


def _block_entries(
    scene: Scene, sequence: CameraSequence, first: int, renderer: IdRenderer
) -> Iterator[dict[str, Any]]:
    """The keys of the annotated vessels in a block of frames that begins with a frame."""
    steps = sequence.steps[first : first + _BLOCK_FRAMES]
    outlines = scene.sight(sequence.camera, steps).outlines()
    drawn = defaultdict[tuple[int, int], list[PixelMasks]](list)
    for row, masks in vessel_masks(outlines, sequence.camera.intrinsics, renderer):
        drawn[int(outlines.frame[row]), int(outlines.occluder[row])].append(masks)
    truth = sequence.truth
    rows = np.arange(*np.searchsorted(truth.frame, (first, first + len(steps))))
    for row in rows[truth.annotated[rows]].tolist():
        vessel = int(truth.vessel[row])
        parts = drawn[int(truth.frame[row]) - first, vessel]
        size = sequence.size_px
        whole = Pixels.of([(part.silhouette, part.region) for part in parts], size)
        seen = Pixels.of([(part.visible, part.region) for part in parts], size)
        counted, areas = (truth.silhouette_px[row], truth.visible_px[row]), (whole.area, seen.area)
        if counted != areas:
            raise ModsimError(
                f"vessel '{scene.vessels[vessel].name}' has {areas[0]} pixels in the image of camera "
                f"'{sequence.camera.name}' at step {steps[int(truth.frame[row]) - first]} and {areas[1]} of them are "
                f"visible, and the run counted {counted[0]:g} and {counted[1]:g}: the run was made with another OpenGL "
                "or another version of modsim3d; run its scene again"
            )
        yield _entry(whole, seen, scene.annotation.mode)


def _entry(whole: Pixels, seen: Pixels, mode: int) -> dict[str, Any]:
    boxed = seen if mode == 2 else whole
    return {
        "segmentation": boxed.encoded,
        "area": boxed.area,
        **{"a_segm": whole.encoded, "a_bbox": whole.box, "a_area": whole.area},
        **{"i_segm": seen.encoded, "i_bbox": seen.box, "i_area": seen.area},
    }


@dataclass(frozen=True, eq=False)
class Pixels:
    """Pixels of an image as runs down its columns, each of which continues the one before it."""

    size_px: tuple[int, int]  # width and height of the image
    starts: Indices  # number of the first pixel of each run, ascending: (n,)
    stops: Indices  # number after its last pixel: (n,)

    @classmethod
    def of(cls, parts: Sequence[tuple[Mask, Region]], size_px: tuple[int, int]) -> Pixels:
        """The pixels of masks (h, w), no two of which share one, and which lie at regions of the image."""
        runs = [_runs(mask, region, size_px[1]) for mask, region in parts]
        starts, stops = np.sort(np.concatenate([np.empty((2, 0), dtype=np.int64), *runs], axis=1), axis=1)
        first, last = np.ones(len(starts), dtype=bool), np.ones(len(stops), dtype=bool)
        first[1:] = last[:-1] = starts[1:] != stops[:-1]
        return cls(size_px, starts[first], stops[last])

    @property
    def area(self) -> int:
        """Number of pixels."""
        return int((self.stops - self.starts).sum())

    @property
    def box(self) -> list[int]:
        """Corner, width and height of the box around them; zeros if there are none."""
        if not len(self.starts):
            return [0, 0, 0, 0]
        height = self.size_px[1]
        (left, right), last = (self.starts[[0, -1]] // height).tolist(), self.stops - 1
        spanned = last // height > self.starts // height  # to the bottom, and on from the top
        top = 0 if spanned.any() else int((self.starts % height).min())
        bottom = height if spanned.any() else int((last % height).max()) + 1
        return [left, top, max(right, int(last[-1]) // height) + 1 - left, bottom - top]

    @cached_property
    def encoded(self) -> dict[str, Any]:
        """COCO's compressed run-length encoding."""
        width, height = self.size_px
        edges = np.concatenate([[0], np.column_stack([self.starts, self.stops]).reshape(-1), [width * height]])
        counts = np.diff(edges)  # of pixels outside, inside, outside ...
        if len(counts) > 1 and not counts[-1]:
            counts = counts[:-1]
        return {"size": [height, width], "counts": _text(counts)}


def _runs(mask: Mask, region: Region, height: int) -> Indices:
    """First pixel of each run and the one after its last, numbered down the columns of the image, shape (2, n)."""
    change = np.diff(np.pad(mask.T, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    (column, first), (_, stop) = np.nonzero(change == 1), np.nonzero(change == -1)
    offset = (column + region.x) * height + region.y
    return np.stack([offset + first, offset + stop])


def _text(counts: Indices) -> str:
    """Counts as COCO's `rleToString` writes them: from the fourth on as differences, 5 bits a character."""
    values = counts.copy()
    values[3:] -= counts[1:-2]
    characters = np.zeros((len(values), _MAX_CHARACTERS), dtype=np.uint8)
    more = np.ones(len(values), dtype=bool)
    for place in range(_MAX_CHARACTERS):
        bits = values & 31
        values >>= 5
        last = values == np.where(bits & 16, -1, 0)
        characters[more, place] = (bits + np.where(last, 48, 48 + 32))[more]
        more &= ~last
    return characters[characters > 0].tobytes().decode("ascii")


FILES = ("gt.json", "dt.json")


def files(request: ExportRequest) -> tuple[str, ...]:
    """The paths of the files. Raises ModsimError if masks are asked for, and the run's truth has none."""
    if request.masks:
        check_masks(request)
    return FILES


def write(request: ExportRequest, folder: Path) -> None:
    """Write a run."""
    labelled, _ = labelled_run(request.run, request.cameras)
    write_coco(labelled, folder, mask_entries(request) if request.masks else None)


def write_coco(labelled: LabelledSet, folder: Path, masks: Iterable[dict[str, Any]] | None = None) -> tuple[Path, Path]:
    """Write `gt.json` and `dt.json` into a folder, which is made where it is not there, and return their paths. `masks`
    are keys to be added to each annotation, in their order."""
    truth, results = (folder / name for name in FILES)
    content = ground_truth(labelled)
    if masks is not None:
        for entry, more in zip(content["annotations"], masks, strict=True):
            entry |= more
    write_files({truth: orjson.dumps(content), results: orjson.dumps(coco_results(labelled))})
    return truth, results


def ground_truth(labelled: LabelledSet) -> dict[str, Any]:
    """The content of a ground truth; IDs begin at 1."""
    images, rows = labelled.images, labelled.annotations
    # A whole number is written as one, as COCO has it.
    sizes = [[int(side) if side.is_integer() else side for side in size] for size in images.sizes_px.tolist()]
    times = images.time_s.tolist()
    entries = []
    for k, name in enumerate(images.names):
        entry: dict[str, Any] = {"id": k + 1, "file_name": name, "width": sizes[k][0], "height": sizes[k][1]}
        entry["condition"] = labelled.conditions[images.condition[k]]
        entry["sequence"] = int(images.sequence[k])
        if math.isfinite(times[k]):
            entry["time_s"] = times[k]
        horizon = written_horizon(images.half_planes[k].tolist(), sizes[k][0])
        if horizon is not None:
            entry["horizon"] = horizon
        entries.append(entry)
    boxes = rows.boxes_px.tolist()
    annotations = []
    for row, (image, label) in enumerate(zip(rows.image.tolist(), rows.label.tolist(), strict=True)):
        box = _sides(boxes[row])
        entry = {"id": row + 1, "image_id": image + 1, "category_id": label + 1, "bbox": box, "area": box[2] * box[3]}
        entry["iscrowd"] = int(rows.crowd[row])
        if rows.ignored[row] and not rows.crowd[row]:
            entry["ignore"] = 1
        if rows.identity[row] >= 0:
            entry["track_id"] = int(rows.identity[row])
        for key, column in (("visible_fraction", rows.visible_fraction), ("distance_m", rows.depth_m)):
            if math.isfinite(column[row]):
                entry[key] = float(column[row])
        annotations.append(entry)
    categories = [{"id": k + 1, "name": name} for k, name in enumerate(labelled.labels)]
    return {"images": entries, "annotations": annotations, "categories": categories}


def coco_results(labelled: LabelledSet) -> list[dict[str, Any]]:
    """The content of a results file, as a tracker may read it: numbers are rounded, the most confident comes first."""
    results = labelled.results
    rows = anonymised(results.image, results.label, results.boxes_px, results.confidence)
    columns = (column.tolist() for column in (rows.frame, rows.label, rows.boxes_px, rows.confidence))
    entries = []
    for image, label, box, score in zip(*columns, strict=True):
        sides = [round(side, BOX_DECIMALS) for side in _sides(box)]
        entries.append({"image_id": image + 1, "category_id": label + 1, "bbox": sides, "score": score})
    return entries


def _sides(corners: list[float]) -> list[float]:
    x_min, y_min, x_max, y_max = corners
    return [x_min, y_min, x_max - x_min, y_max - y_min]
