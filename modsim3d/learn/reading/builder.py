"""What every reader of labelled sets does alike: collect rows and problems, and make columns of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from modsim3d.errors import InputError
from modsim3d.learn.labelled import NOBODY, Found, Images, Labelled, Truth, sorted_by_image

MOST_PROBLEMS = 20
MOST_PX = 1e7
"""Larger is no place in an image, and its square would leave no digits."""


@dataclass
class Problems:
    """What is wrong with a file's entries.

    Attributes:
        source: The file.
        skip: Whether entries that something is wrong with are left out, and only counted.
        lines: One each.
        skipped: How many entries have been left out.
        hint: What would mend many of them at once.
    """

    source: str
    skip: bool = False
    lines: list[str] = field(default_factory=list)
    skipped: int = 0
    hint: str = ""

    def add(self, line: str) -> None:
        """An entry cannot be used."""
        self.lines.append(line)

    def settle(self) -> list[str]:
        """Say it all, or how much was left out.

        Raises:
            InputError: Something is wrong, and is not to be skipped.
        """
        if not self.lines:
            return []
        if self.skip:
            self.skipped = len(self.lines)
            return [f"{self.source}: {self.skipped} entries left out, the first because {self.lines[0]}"]
        shown = self.lines[:MOST_PROBLEMS]
        if len(self.lines) > MOST_PROBLEMS:
            shown.append(f"... and {len(self.lines) - MOST_PROBLEMS} more; --skip-bad leaves all such entries out")
        shown += [self.hint] if self.hint else []
        raise InputError(self.source, shown)


def corners(values: Any, where: str, problems: Problems) -> list[float] | None:
    """x_min, y_min, x_max, y_max from x, y, width, height; None with a problem if that is no box."""
    if (
        not isinstance(values, list)
        or len(values) != 4
        or not all(isinstance(value, int | float) and not isinstance(value, bool) for value in values)
    ):
        problems.add(f"{where}: bbox must be [x, y, width, height] in pixels (got {str(values)[:60]})")
        return None
    x, y, width, height = values
    if not all(map(math.isfinite, values)):
        problems.add(f"{where}: bbox must be finite (got {values})")
        return None
    if max(map(abs, values)) > MOST_PX:
        problems.add(f"{where}: bbox must be in pixels, at most {MOST_PX:g} (got {values})")
        return None
    if width <= 0 or height <= 0:
        problems.add(f"{where}: bbox has no area: width {width:g}, height {height:g}")
        return None
    return [x, y, x + width, y + height]


@dataclass
class Rows:
    """Rows as they are read; see the columns of `Truth` and `Found`."""

    image: list[int] = field(default_factory=list)
    label: list[int] = field(default_factory=list)
    boxes: list[list[float]] = field(default_factory=list)
    confidence: list[float] = field(default_factory=list)
    ignored: list[bool] = field(default_factory=list)
    crowd: list[bool] = field(default_factory=list)
    identity: list[Any] = field(default_factory=list)
    visible_fraction: list[float] = field(default_factory=list)
    distance_m: list[float] = field(default_factory=list)
    probabilities: list[list[float] | None] = field(default_factory=list)
    seen: set[tuple[int, Any]] = field(default_factory=set)

    def has(self, image: int, identity: Any) -> bool:
        """Whether a thing is in the image already: nothing is there twice."""
        return identity is not None and (image, identity) in self.seen

    def identify(self, image: int, identity: Any) -> None:
        """Put down who a row is, None where that is not known."""
        self.seen.add((image, identity))
        self.identity.append(identity)

    def truth(self) -> Truth:
        """As truth."""
        numbers = {name: k for k, name in enumerate(dict.fromkeys(each for each in self.identity if each is not None))}
        whole = Truth(
            image=np.array(self.image, dtype=np.int64),
            label=np.array(self.label, dtype=np.int64),
            boxes_px=np.array(self.boxes, dtype=np.float64).reshape(-1, 4),
            ignored=np.array(self.ignored, dtype=bool),
            crowd=np.array(self.crowd, dtype=bool),
            identity=np.array([NOBODY if each is None else numbers[each] for each in self.identity], dtype=np.int64),
            visible_fraction=np.array(self.visible_fraction, dtype=np.float64),
            distance_m=np.array(self.distance_m, dtype=np.float64),
        )
        return Truth(**sorted_by_image(whole)[0])

    def found(self, labels: int) -> Found:
        """As detections."""
        probabilities = None
        if any(given is not None for given in self.probabilities):
            nothing = [math.nan] * labels
            probabilities = np.array([nothing if given is None else given for given in self.probabilities])
        whole = Found(
            image=np.array(self.image, dtype=np.int64),
            label=np.array(self.label, dtype=np.int64),
            boxes_px=np.array(self.boxes, dtype=np.float64).reshape(-1, 4),
            confidence=np.array(self.confidence, dtype=np.float64),
            probabilities=probabilities,
        )
        return Found(**sorted_by_image(whole)[0])


def one_condition(
    condition: str,
    labels: Sequence[str],
    names: Sequence[str],
    sizes_px: Sequence[Sequence[float]],
    truth: Rows,
    found: Rows,
    notes: Sequence[str],
    sequence: Sequence[int] | None = None,
    time_s: Sequence[float] | None = None,
    own: Sequence[str | None] = (),
) -> Labelled:
    """A labelled set of one source, and of one condition but for images that name their `own`.

    Raises:
        InputError: Two labels have the same name.
    """
    repeated = sorted({name for name in labels if list(labels).count(name) > 1})
    if repeated:
        raise InputError(f"labels of {condition}", [f"'{name}' names more than one class" for name in repeated])
    count = len(names)
    of_image = [condition if name is None else name for name in own] or [condition] * count
    conditions = tuple(dict.fromkeys(of_image)) or (condition,)
    images = Images(
        tuple(names),
        np.array(sizes_px, dtype=np.float64).reshape(-1, 2),
        np.array([conditions.index(name) for name in of_image], dtype=np.int64),
        np.zeros(count, dtype=np.int64),
        np.zeros(count, dtype=np.int64) if sequence is None else np.array(sequence, dtype=np.int64),
        np.full(count, np.nan) if time_s is None else np.array(time_s, dtype=np.float64),
    )
    return Labelled(tuple(labels), conditions, images, truth.truth(), found.found(len(labels)), tuple(notes))
