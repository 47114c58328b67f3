"""A labelled set of images and what a detector put out for them, in columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import sizes

NOBODY = -1
"""No identity, no truth."""


@dataclass(frozen=True, eq=False)
class Images:
    """The images of one or more conditions.

    Attributes:
        names: One each.
        sizes_px: Width and height, NaN where unknown, shape (I, 2).
        condition: Index into the names of the conditions, shape (I,).
        source: Which data set each came from: images of different ones are resampled apart, shape (I,).
        sequence: Images of one number are consecutive frames of one camera, shape (I,).
        time_s: Of each image within its sequence; NaN where images do not follow one another, shape (I,).
    """

    names: tuple[str, ...]
    sizes_px: Array
    condition: Indices
    source: Indices
    sequence: Indices
    time_s: Array

    def __len__(self) -> int:
        """Number of images."""
        return len(self.names)


@dataclass(frozen=True, eq=False)
class Truth:
    """What is in the images: T rows ordered by image.

    Attributes:
        image: Row of the images, non-decreasing, shape (T,).
        label: Index into the labels, shape (T,).
        boxes_px: x_min, y_min, x_max, y_max, shape (T, 4).
        ignored: Whether a detector is neither to find it nor to be blamed for finding it, shape (T,).
        crowd: Whether it is a region with many in it, which is ignored as COCO does it, shape (T,).
        identity: Equal for the same thing in images of one sequence, −1 where unknown, shape (T,).
        visible_fraction: NaN where unknown, shape (T,).
        distance_m: NaN where unknown, shape (T,).
    """

    image: Indices
    label: Indices
    boxes_px: Array
    ignored: Mask
    crowd: Mask
    identity: Indices
    visible_fraction: Array
    distance_m: Array

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.image)

    @property
    def size_px(self) -> Array:
        """Side of a square as large as the box, at least a pixel, shape (T,)."""
        side: Array = np.maximum(np.sqrt(np.prod(np.maximum(sizes(self.boxes_px), 0), axis=1)), 1)
        return side


@dataclass(frozen=True, eq=False)
class Found:
    """What the detector put out: D rows ordered by image.

    Attributes:
        image: Row of the images, non-decreasing, shape (D,).
        label: Index into the labels, shape (D,).
        boxes_px: x_min, y_min, x_max, y_max, shape (D, 4).
        confidence: In [0, 1], shape (D,).
        probabilities: Of the k labels, NaN where not given, shape (D, k); None if given nowhere.
        origin: Row of the truth that each is the one detection of, −1 for a false one; None where unknown, shape (D,).
    """

    image: Indices
    label: Indices
    boxes_px: Array
    confidence: Array
    probabilities: Array | None = None
    origin: Indices | None = None

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.image)


@dataclass(frozen=True, eq=False)
class Labelled:
    """Images, truth and detections.

    Attributes:
        labels: Names of the classes.
        conditions: Names of the conditions.
        images: The images.
        truth: What is in them.
        found: What the detector put out.
        notes: What a reader has to say about what it read.
    """

    labels: tuple[str, ...]
    conditions: tuple[str, ...]
    images: Images
    truth: Truth
    found: Found
    notes: tuple[str, ...] = field(default=())


def sorted_by_image(part: Truth | Found, image_order: Indices | None = None) -> tuple[dict[str, NDArray], Indices]:  # type: ignore[type-arg]
    """The columns of rows in the order of their images, which are renumbered; and where each row was."""
    columns = {name: value for name, value in vars(part).items() if isinstance(value, np.ndarray)}
    if image_order is not None:
        columns["image"] = image_order[columns["image"]]
    order = np.argsort(columns["image"], kind="stable")
    return {name: value[order] for name, value in columns.items()}, order


def joined(parts: Sequence[Labelled]) -> Labelled:
    """Several sets as one; conditions and labels of the same name become one."""
    labels = tuple(dict.fromkeys(name for part in parts for name in part.labels))
    conditions = tuple(dict.fromkeys(name for part in parts for name in part.conditions))
    if len(parts) == 1:
        return parts[0]
    image_first = np.cumsum([0, *(len(part.images) for part in parts)])
    truth_first = np.cumsum([0, *(len(part.truth) for part in parts)])
    images, truths, founds = [], [], []
    sources = sequences = identities = 0
    for k, part in enumerate(parts):
        to_label = np.array([labels.index(name) for name in part.labels], dtype=np.int64)
        to_condition = np.array([conditions.index(name) for name in part.conditions], dtype=np.int64)
        images.append(
            replace(
                part.images,
                condition=to_condition[part.images.condition],
                source=part.images.source + sources,
                sequence=part.images.sequence + sequences,
            )
        )
        known = part.truth.identity >= 0
        truths.append(
            replace(
                part.truth,
                image=part.truth.image + image_first[k],
                label=to_label[part.truth.label],
                identity=np.where(known, part.truth.identity + identities, NOBODY),
            )
        )
        origin = part.found.origin
        founds.append(
            replace(
                part.found,
                image=part.found.image + image_first[k],
                label=to_label[part.found.label],
                probabilities=_spread(part.found, to_label, len(labels)),
                origin=None if origin is None else np.where(origin >= 0, origin + truth_first[k], origin),
            )
        )
        sources += _next(part.images.source)
        sequences += _next(part.images.sequence)
        identities += _next(part.truth.identity)
    return Labelled(
        labels,
        conditions,
        Images(tuple(name for part in images for name in part.names), **_stacked(images, exclude=("names",))),
        Truth(**_stacked(truths)),
        Found(**_stacked(founds)),
        tuple(note for part in parts for note in part.notes),
    )


def _next(numbers: Indices) -> int:
    return int(numbers.max(initial=-1)) + 1


def _spread(found: Found, to_label: Indices, count: int) -> Array | None:
    """Probabilities in the columns of all labels."""
    if found.probabilities is None:
        return None
    wide = np.zeros((len(found), count))
    wide[:, to_label] = found.probabilities
    return wide


def _stacked(parts: Sequence[object], exclude: tuple[str, ...] = ()) -> dict[str, NDArray]:  # type: ignore[type-arg]
    """Columns one after another; a column that only some have is filled with NaN or, for an origin, left out."""
    columns = {}
    for name in vars(parts[0]):
        values = [getattr(part, name) for part in parts]
        if name in exclude:
            continue
        if name == "probabilities":
            width = next((value.shape[1] for value in values if value is not None), None)
            if width is not None:
                lengths = [len(part) for part in parts]  # type: ignore[arg-type]
                values = [
                    np.full((length, width), np.nan) if value is None else value
                    for value, length in zip(values, lengths, strict=True)
                ]
        columns[name] = None if any(value is None for value in values) else np.concatenate(values)
    return columns  # type: ignore[return-value]
