"""Which of the detector's labels each class of a file is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Indices, Mask
from modsim3d.errors import InputError
from modsim3d.inputs.validation import nearest, shown

NO_TARGET = "-"
"""In place of a label: things of this class are not to be detected."""


@dataclass(frozen=True)
class FileClasses:
    """The classes of a file.

    Attributes:
        kind: `MOT` or `COCO`.
        names: Their names; MOT's have none of their own and are called `class_1`, `class_2` and so on.
        numbers: Their numbers; 0 in a MOT file without classes.
    """

    kind: str
    names: tuple[str, ...]
    numbers: tuple[int, ...]

    def in_words(self, index: int) -> str:
        """What messages call a class."""
        if self.kind == "COCO":
            return f"category {shown(self.names[index])}"
        return f"class {self.numbers[index]}" if self.numbers[index] else "the one class of the file"


def to_labels(
    classes: FileClasses, used: Mask, given: Sequence[str] | None, labels: Sequence[str]
) -> tuple[Indices, list[str]]:
    """Index into the detector's labels of each of k classes, −1 for one that is no target, shape (k,); and remarks.

    Args:
        classes: The classes.
        used: Which of them have boxes that are to be detected, shape (k,).
        given: A label of the detector, or `-`, for each class in the order of the file or of the numbers, as `--labels`
            has them; None if there are none.
        labels: The detector's labels.

    Raises:
        InputError: A class that is used has no label.
    """
    whole = np.flatnonzero(used)
    if given is not None:
        problems = list(_given_problems(classes, used, given, labels))
        if problems:
            raise InputError("--labels", problems)
        named = [*given[: len(classes.names)], *[NO_TARGET] * (len(classes.names) - len(given))]
        return np.array([-1 if name == NO_TARGET else labels.index(name) for name in named], dtype=np.int64), []
    if classes.kind == "MOT" and len(whole) == len(labels) == 1:
        mapped = np.full(len(classes.names), -1)
        mapped[whole] = 0
        return mapped, [f"{classes.in_words(whole[0])} is taken for the detector's one label, {labels[0]}"]
    problems = [
        f"{classes.in_words(index)} is not one of the detector's labels ({nearest(classes.names[index], labels)})"
        for index in whole.tolist()
        if classes.names[index] not in labels
    ]
    if problems:
        raise InputError("labels", [*problems, _how(classes)])
    return np.array([labels.index(name) if name in labels else -1 for name in classes.names], dtype=np.int64), []


def _how(classes: FileClasses) -> str:
    order = f"in the order of the file ({', '.join(classes.names[:20])})"
    if classes.kind == "MOT":
        order = f"for each class from 1 to {len(classes.names)}"
    return f"give --labels A,B,... with a label of the detector {order}; {NO_TARGET} for one that is not to be detected"


def _given_problems(classes: FileClasses, used: Mask, given: Sequence[str], labels: Sequence[str]) -> Iterator[str]:
    for name in dict.fromkeys(given):
        if name not in labels and name != NO_TARGET:
            yield f"'{name}' is not one of the detector's labels ({nearest(name, labels)})"
    if classes.kind == "COCO" and len(given) > len(classes.names):
        yield f"names {len(given)} categories, and the file has {len(classes.names)}"
    for index in np.flatnonzero(used)[np.flatnonzero(used) >= len(given)].tolist():
        yield f"does not say what {classes.in_words(index)} is: {_how(classes)}"
