"""What all readers of labelled sets share: they collect rows and problems, and make columns of the rows."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.errors import InputError
from modsim3d.formats.labelled import NOBODY, Annotations, Images, LabelledSet, Results

MOST_PROBLEMS = 20
MOST_PX = 1e7
"""A larger coordinate is no place in an image, and its square would leave no digits."""


@dataclass
class Problems:
    """What is wrong with the entries of a file.

    Attributes:
        source: The file, as messages name it.
        skip: Whether wrong entries are left out and counted; if not, they are an error.
        lines: One for each wrong entry.
        hint: A remedy for many of them at once.
    """

    source: str
    skip: bool = False
    lines: list[str] = field(default_factory=list)
    hint: str = ""

    def add(self, line: str) -> None:
        """Record an entry that cannot be used."""
        self.lines.append(line)

    def settle(self) -> list[str]:
        """A remark on how many entries were left out, if any.

        Raises:
            InputError: There are wrong entries, and they are not to be skipped.
        """
        if not self.lines:
            return []
        if self.skip:
            return [f"{self.source}: {len(self.lines)} entries left out, the first because {self.lines[0]}"]
        shown = self.lines[:MOST_PROBLEMS]
        if len(self.lines) > MOST_PROBLEMS:
            shown.append(f"... and {len(self.lines) - MOST_PROBLEMS} more; --skip-bad leaves all such entries out")
        shown += [self.hint] if self.hint else []
        raise InputError(self.source, shown)


def valid_box(values: Any, where: str, problems: Problems) -> bool:
    """Whether values are a position, width and height in pixels that can be a box; adds a problem if not."""
    if (
        not isinstance(values, list)
        or len(values) != 4
        or not all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    ):
        problems.add(f"{where}: bbox must be [x, y, width, height] in pixels (got {str(values)[:60]})")
        return False
    _, _, width, height = values
    if not all(map(math.isfinite, values)):
        problems.add(f"{where}: bbox must be finite (got {values})")
    elif max(map(abs, values)) > MOST_PX:
        problems.add(f"{where}: bbox must be in pixels, at most {MOST_PX:g} (got {values})")
    elif width <= 0 or height <= 0:
        problems.add(f"{where}: bbox has no area: width {width:g}, height {height:g}")
    else:
        return True
    return False


def from_top_left(boxes_px: Array) -> Array:
    """x_min, y_min, x_max, y_max from the top-left corner, width and height, shapes (n, 4)."""
    return np.concatenate([boxes_px[:, :2], boxes_px[:, :2] + boxes_px[:, 2:]], axis=1)


@dataclass(frozen=True)
class Place:
    """What annotations and results have in common.

    Attributes:
        image: Row of the image.
        label: Index into the labels.
        box_px: Four numbers in the form of the file.
    """

    image: int
    label: int
    box_px: list[float]


@dataclass
class _Rows:
    """Rows as they are read.

    Attributes:
        to_corners: Turns the file's form of boxes into x_min, y_min, x_max, y_max, shapes (n, 4).
        places: One for each row.
    """

    to_corners: Callable[[Array], Array] = from_top_left
    places: list[Place] = field(default_factory=list)

    def _columns(self) -> tuple[Indices, Indices, Array]:
        """Images (n,), labels (n,) and boxes as corners (n, 4)."""
        boxes = np.array([place.box_px for place in self.places], dtype=np.float64).reshape(-1, 4)
        image = np.array([place.image for place in self.places], dtype=np.int64)
        return image, np.array([place.label for place in self.places], dtype=np.int64), self.to_corners(boxes)


@dataclass
class AnnotationRows(_Rows):
    """Annotations as they are read; see the columns of `Annotations`."""

    ignored: list[bool] = field(default_factory=list)
    crowd: list[bool] = field(default_factory=list)
    identity: list[Any] = field(default_factory=list)
    visible_fraction: list[float] = field(default_factory=list)
    depth_m: list[float] = field(default_factory=list)
    _seen: set[tuple[int, Any]] = field(default_factory=set)

    def has(self, image: int, identity: Any) -> bool:
        """Whether a thing is in the image already, which it can be only once."""
        return identity is not None and (image, identity) in self._seen

    def add(
        self,
        place: Place,
        ignored: bool = False,
        crowd: bool = False,
        identity: Any = None,
        visible_fraction: float = math.nan,
        depth_m: float = math.nan,
    ) -> None:
        """Append a row; an unknown identity is None, other unknown values are NaN."""
        self._seen.add((place.image, identity))
        self.places.append(place)
        self.ignored.append(ignored)
        self.crowd.append(crowd)
        self.identity.append(identity)
        self.visible_fraction.append(visible_fraction)
        self.depth_m.append(depth_m)

    def annotations(self) -> Annotations:
        """The rows as columns, ordered by image; identities are numbered in the order in which they appear."""
        numbers = {name: k for k, name in enumerate(dict.fromkeys(each for each in self.identity if each is not None))}
        image, label, boxes_px = self._columns()
        return Annotations(
            image=image,
            label=label,
            boxes_px=boxes_px,
            ignored=np.array(self.ignored, dtype=bool),
            crowd=np.array(self.crowd, dtype=bool),
            identity=np.array([NOBODY if each is None else numbers[each] for each in self.identity], dtype=np.int64),
            visible_fraction=np.array(self.visible_fraction, dtype=np.float64),
            depth_m=np.array(self.depth_m, dtype=np.float64),
        ).by_image()


@dataclass
class ResultRows(_Rows):
    """Results as they are read; see the columns of `Results`."""

    confidence: list[float] = field(default_factory=list)
    probabilities: list[list[float] | None] = field(default_factory=list)

    def add(self, place: Place, confidence: float, probabilities: list[float] | None = None) -> None:
        """Append a row."""
        self.places.append(place)
        self.confidence.append(confidence)
        self.probabilities.append(probabilities)

    def results(self, labels: int) -> Results:
        """The rows as columns, ordered by image, with probabilities of so many labels."""
        probabilities = None
        if any(given is not None for given in self.probabilities):
            nothing = [math.nan] * labels
            probabilities = np.array([nothing if given is None else given for given in self.probabilities])
        confidence = np.array(self.confidence, dtype=np.float64)
        return Results(*self._columns(), confidence, probabilities).by_image()


@dataclass
class ImageRows:
    """Images as they are read; see the columns of `Images`.

    Attributes:
        condition: Name of the condition of each image that names its own; None for the others.
    """

    names: list[str] = field(default_factory=list)
    sizes_px: list[Sequence[float]] = field(default_factory=list)
    sequence: list[int] = field(default_factory=list)
    time_s: list[float] = field(default_factory=list)
    condition: list[str | None] = field(default_factory=list)

    def add(
        self,
        name: str,
        size_px: Sequence[float],
        sequence: int = 0,
        time_s: float = math.nan,
        condition: str | None = None,
    ) -> None:
        """Append an image."""
        self.names.append(name)
        self.sizes_px.append(size_px)
        self.sequence.append(sequence)
        self.time_s.append(time_s)
        self.condition.append(condition)


def labelled_set(
    condition: str,
    labels: Sequence[str],
    images: ImageRows,
    annotations: AnnotationRows,
    results: ResultRows,
    notes: Sequence[str],
) -> LabelledSet:
    """A labelled set of one source; images that name no condition of their own have the given one.

    Raises:
        InputError: Two labels have the same name.
    """
    repeated = sorted({name for name in labels if list(labels).count(name) > 1})
    if repeated:
        raise InputError(f"labels of {condition}", [f"'{name}' names more than one class" for name in repeated])
    of_image = [condition if name is None else name for name in images.condition]
    conditions = tuple(dict.fromkeys(of_image)) or (condition,)
    columns = Images(
        tuple(images.names),
        np.array(images.sizes_px, dtype=np.float64).reshape(-1, 2),
        np.array([conditions.index(name) for name in of_image], dtype=np.int64),
        np.zeros(len(of_image), dtype=np.int64),
        np.array(images.sequence, dtype=np.int64),
        np.array(images.time_s, dtype=np.float64),
    )
    return LabelledSet(
        tuple(labels), conditions, columns, annotations.annotations(), results.results(len(labels)), tuple(notes)
    )
