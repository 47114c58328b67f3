"""A labelled set: images, what is annotated in them, and what a detector put out for them, in columns."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Columns, Indices, Mask
from modsim3d.core.boxes import sizes
from modsim3d.core.errors import InputError
from modsim3d.io.validation import shown


@dataclass(frozen=True, eq=False)
class Images:
    """The images of one or more conditions, I rows."""

    names: tuple[str, ...]
    sizes_px: Array  # width and height, NaN where unknown: (I, 2)
    condition: Indices  # index into the names of the conditions: (I,)
    source: Indices  # index of the data set that each came from; different ones are resampled separately: (I,)
    sequence: Indices  # images of equal number are consecutive frames of one camera: (I,)
    time_s: Array  # within its sequence; NaN where images are not consecutive frames: (I,)
    half_planes: Array  # (a, b, c), a·x + b·y + c >= 0 on the sea side of the horizon, NaN where unknown: (I, 3)

    def __len__(self) -> int:
        """Number of images."""
        return len(self.names)


@dataclass(frozen=True, eq=False)
class Annotations(Columns):
    """The annotated boxes of all images: T rows ordered by image."""

    image: Indices  # row of the images, non-decreasing: (T,)
    label: Indices  # index into the labels: (T,)
    boxes_px: Array  # x_min, y_min, x_max, y_max: (T, 4)
    ignored: Mask  # whether detecting it counts neither for nor against a detector: (T,)
    crowd: Mask  # whether the box is a region with many things in it, which is ignored as COCO does: (T,)
    identity: Indices  # equal for the same thing in images of one sequence, −1 where unknown: (T,)
    visible_fraction: Array  # NaN where unknown: (T,)
    depth_m: Array  # NaN where unknown: (T,)
    # Whether something hides a part of it, which may really be another part, so that the box of what is left tells
    # nothing of box errors: (T,); None if that is so of none.
    unsure_box: Mask | None = None
    in_frame_fraction: Array | None = None  # share inside the image, NaN where unknown: (T,); None if unknown of all

    @property
    def size_px(self) -> Array:
        """Side of a square as large as the box, at least a pixel, shape (T,)."""
        side: Array = np.maximum(np.sqrt(np.prod(np.maximum(sizes(self.boxes_px), 0), axis=1)), 1)
        return side

    def by_image(self) -> Annotations:
        """Annotations in the order of their images."""
        return self.take(np.argsort(self.image, kind="stable"))


@dataclass(frozen=True, eq=False)
class Results(Columns):
    """A detector's detections in all images: D rows ordered by image."""

    image: Indices  # row of the images, non-decreasing: (D,)
    label: Indices  # index into the labels: (D,)
    boxes_px: Array  # x_min, y_min, x_max, y_max: (D, 4)
    confidence: Array  # in [0, 1], NaN where not given: (D,)
    probabilities: Array | None = None  # of the k labels, NaN where not given: (D, k); None if given nowhere
    origin: Indices | None = None  # row of the annotation whose one detection it is, else −1: (D,); None where unknown
    kind: Indices | None = None  # index into `detector.records.KINDS`: (D,); None where unknown
    # Row of the smaller annotation in a merged box, or of the one that a false positive lies on, else −1: (D,); None
    # where unknown.
    partner: Indices | None = None

    def by_image(self) -> Results:
        """Results in the order of their images."""
        return self.take(np.argsort(self.image, kind="stable"))


@dataclass(frozen=True)
class FileIds:
    """IDs that a file uses for what a labelled set has by number."""

    images: tuple[int | str, ...]  # ID of each image in COCO, number of each frame in MOT
    labels: tuple[int, ...]  # ID of each label's category in COCO, number of its class in MOT; 0 for one without
    sequences: tuple[int | str | None, ...]  # name or number of each; None for one without
    identities: tuple[int | str, ...]  # the tracks
    first_frame: int = 1  # number of the first frame, and of the first pixel, in MOT
    files: tuple[str, ...] = ()  # file of each image, where COCO names it


@dataclass(frozen=True, eq=False)
class LabelledSet:
    """Images with their annotations and a detector's results; notes say what a reader left out, for instance.
    `ids` is known of a set that was read from one file of truth. Detections below `dropped_below` are missing."""

    labels: tuple[str, ...]
    conditions: tuple[str, ...]
    images: Images
    annotations: Annotations
    results: Results
    notes: tuple[str, ...] = field(default=())
    ids: FileIds | None = None
    dropped_below: float = 0.0

    @property
    def scored(self) -> bool:
        """Whether any detection has a confidence, or there are no detections."""
        return not len(self.results) or not bool(np.isnan(self.results.confidence).all())


def joined(parts: Sequence[LabelledSet]) -> LabelledSet:
    """Several sets as one; labels and conditions of equal name become one."""
    if len(parts) == 1:
        return parts[0]
    labels = tuple(dict.fromkeys(name for part in parts for name in part.labels))
    conditions = tuple(dict.fromkeys(name for part in parts for name in part.conditions))
    counts = np.array([_counts(part) for part in parts])
    offsets = np.cumsum(counts, axis=0) - counts
    moved = [_moved(part, offset, labels, conditions) for part, offset in zip(parts, offsets.tolist(), strict=True)]
    return LabelledSet(
        labels,
        conditions,
        Images(**_stacked([part.images for part in moved])),
        Annotations(**_stacked([part.annotations for part in moved])),
        Results(**_stacked([part.results for part in moved])),
        tuple(note for part in parts for note in part.notes),
        dropped_below=max(part.dropped_below for part in parts),
    )


def _counts(part: LabelledSet) -> list[int]:
    """Numbers of images and annotations, and the first free numbers of a source, a sequence and an identity."""
    numbered = part.images.source, part.images.sequence, part.annotations.identity
    return [len(part.images), len(part.annotations), *(int(column.max(initial=-1)) + 1 for column in numbered)]


def _moved(part: LabelledSet, offset: Sequence[int], labels: Sequence[str], conditions: Sequence[str]) -> LabelledSet:
    """A set whose numbers and indices continue those before it, in the joined labels and conditions."""
    first_image, first_annotation, first_source, first_sequence, first_identity = offset
    label_of, condition_of = ({name: k for k, name in enumerate(names)} for names in (labels, conditions))
    to_label = np.array([label_of[name] for name in part.labels], dtype=np.int64)
    to_condition = np.array([condition_of[name] for name in part.conditions], dtype=np.int64)
    images, annotations, results = part.images, part.annotations, part.results
    probabilities = None

    def moved_rows(rows: Indices | None) -> Indices | None:
        return None if rows is None else np.where(rows >= 0, rows + first_annotation, rows)

    if results.probabilities is not None:
        probabilities = np.zeros((len(results), len(labels)))
        probabilities[:, to_label] = results.probabilities
    return replace(
        part,
        images=replace(
            images,
            condition=to_condition[images.condition],
            source=images.source + first_source,
            sequence=images.sequence + first_sequence,
        ),
        annotations=replace(
            annotations,
            image=annotations.image + first_image,
            label=to_label[annotations.label],
            identity=np.where(annotations.identity >= 0, annotations.identity + first_identity, NOBODY),
        ),
        results=replace(
            results,
            image=results.image + first_image,
            label=to_label[results.label],
            probabilities=probabilities,
            origin=moved_rows(results.origin),
            partner=moved_rows(results.partner),
        ),
    )


def _stacked(parts: Sequence[Images] | Sequence[Annotations] | Sequence[Results]) -> dict[str, Any]:
    """Columns one below the other. What some parts do not give is NaN for probabilities, sure for boxes, else None."""
    return {name: _column(name, [vars(part)[name] for part in parts], list(map(len, parts))) for name in vars(parts[0])}


def _column(name: str, values: list[Any], lengths: list[int]) -> Any:
    if name == "names":
        return tuple(entry for part in values for entry in part)
    present = next((value for value in values if value is not None), None)
    if present is not None and name in ("probabilities", "unsure_box"):
        filler = np.nan if name == "probabilities" else False
        values = [
            np.full((length, *present.shape[1:]), filler) if value is None else value
            for value, length in zip(values, lengths, strict=True)
        ]
    return None if any(value is None for value in values) else np.concatenate(values)


# ---- The horizon in an image ----

MAX_PX = 1e7
UNKNOWN = (math.nan, math.nan, math.nan)  # the half-plane of an image whose horizon is not known
EVERYWHERE = np.array([0.0, 0.0, 1.0])  # the half-plane of a sea that fills the image
_DECIMALS, _MIN_PX = 3, 1e-3


def parse_horizon(text: str) -> tuple[float, ...]:
    """The numbers of a text such as `400` or `0,400,1920,380`. Raises InputError if there is something else in it."""
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise InputError("--horizon", [_wanted(text)]) from None


def half_plane(horizon: float | Sequence[float], sizes_px: Iterable[tuple[int, int]]) -> Array:
    """The half-plane (a, b, c) of the sea below a horizon, a·x + b·y + c >= 0: (3,). `horizon` is a row, or x and y of
    one point and of another. Raises InputError if it is no such line, or lies below an image of these sizes."""
    numbers = np.atleast_1d(np.asarray(horizon, dtype=np.float64))
    if numbers.shape not in ((1,), (4,)) or not (np.abs(numbers) <= MAX_PX).all():
        text = ", ".join(f"{number:g}" for number in numbers.ravel().tolist())
        far = f"; no farther than {MAX_PX:,.0f}" if (np.abs(numbers) > MAX_PX).any() else ""
        raise InputError("--horizon", [_wanted(text) + far])
    x_1, y_1, x_2, y_2 = numbers.tolist() if len(numbers) == 4 else (0.0, numbers[0], 1.0, numbers[0])
    if x_1 == x_2:
        raise InputError("--horizon", ["is upright: give two points in different columns"])
    sea = np.array(_below(x_1, y_1, x_2, y_2))
    for width, height in sizes_px:
        corners = np.array([[0, 0, 1], [width, 0, 1], [0, height, 1], [width, height, 1]], dtype=np.float64)
        if not (corners @ sea > 0).any():
            raise InputError("--horizon", [f"lies below images of {width} × {height} px: they would show no sea"])
    return sea


def with_horizon(labelled: LabelledSet, horizon: float | Sequence[float] | None) -> LabelledSet:
    """A labelled set in which images without a horizon have this one; None for none. Raises as `half_plane`."""
    if horizon is None:
        return labelled
    images = labelled.images
    unknown = np.isnan(images.half_planes[:, 0])
    sizes = np.unique(images.sizes_px[unknown & np.isfinite(images.sizes_px[:, 0])], axis=0).astype(np.int64)
    sea = half_plane(horizon, [(width, height) for width, height in sizes.tolist()])
    return replace(labelled, images=replace(images, half_planes=np.where(unknown[:, None], sea, images.half_planes)))


def written_horizon(half_plane: Sequence[float], width_px: float) -> list[float] | None:
    """Rows of the horizon at the left and the right edge of an image; None where the sea is not below such a line."""
    a, b, c = half_plane
    if not (b > 0 and math.isfinite(width_px)):  # NaN is not above 0
        return None
    rows = [round(-(a * x + c) / b, _DECIMALS) for x in (0.0, width_px)]
    return rows if max(map(abs, rows)) <= MAX_PX else None


def read_horizon(value: Any, width_px: float) -> tuple[float, float, float] | None:
    """The half-plane of an image whose horizon is a row, the rows at its edges, or two points; `UNKNOWN` where none is
    given, None if the value is neither."""
    if value is None:
        return UNKNOWN
    numbers = value if isinstance(value, list) else [value]
    if not all(isinstance(number, int | float) and not isinstance(number, bool) for number in numbers):
        return None
    if len(numbers) not in (1, 2, 4) or not all(-MAX_PX <= number <= MAX_PX for number in numbers):
        return None
    if len(numbers) == 4:
        return None if abs(numbers[0] - numbers[2]) < _MIN_PX else _below(*numbers)
    return _below(0.0, numbers[0], width_px, numbers[-1])


def _below(x_1: float, y_1: float, x_2: float, y_2: float) -> tuple[float, float, float]:
    """The half-plane below the line through two points in different columns."""
    slope = (y_2 - y_1) / (x_2 - x_1)
    return -slope, 1.0, slope * x_1 - y_1


def _wanted(got: str) -> str:
    return f"must be ROW, or X1,Y1,X2,Y2, in pixels, as 400 (got {shown(got)})"
