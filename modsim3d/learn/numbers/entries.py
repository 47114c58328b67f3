"""Entries of a detector file with their estimates: where each stands, how reports name it, how it is written."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, TypeVar, cast

import numpy as np

from modsim3d.arrays import Array
from modsim3d.learn.numbers.resampling import Column

T = TypeVar("T")


@dataclass(frozen=True)
class Key:
    """Where an entry stands in a detector file.

    Attributes:
        names: Keys of the file, outermost first; within the section of the state if there is one.
        state: Name of the performance state; None for an entry that all states share.
        axes: Names of the places along each axis; places are numbered if empty.
        remark: What a reader of the number must know, such as its unit.
        own_table: Whether reports show the entry in a table of its own.
    """

    names: tuple[str, ...]
    state: str | None = None
    axes: tuple[tuple[str, ...], ...] = ()
    remark: str = ""
    own_table: bool = False

    @property
    def path(self) -> str:
        """The keys with dots between, for reports."""
        section = () if self.state is None else ("states", self.state)
        return ".".join((*section, *self.names))

    def at(self, place: tuple[int, ...]) -> str:
        """The name of one number of the entry, for reports."""
        if self.axes:
            brackets = f"[{' from '.join(names[k] for names, k in zip(self.axes, place, strict=True))}]"
        else:
            brackets = "".join(f"[{k}]" for k in place)
        return f"{self.path}{brackets}{f' ({self.remark})' if self.remark else ''}"


@dataclass(frozen=True, eq=False)
class Entry:
    """One entry of a detector file: a number, vector or matrix."""

    key: Key
    column: Column

    @property
    def estimate(self) -> Array:
        """The number, in the shape of the entry."""
        return self.column.estimate


@dataclass(frozen=True, eq=False)
class Interval:
    """An entry with both ends of its confidence interval, arrays of one shape."""

    key: Key
    estimate: Array
    low: Array
    high: Array


def entries_of(value: object) -> Iterator[Entry]:
    """All entries in a dataclass, its fields and tuples of them, in their order."""
    if isinstance(value, Entry):
        yield value
    elif isinstance(value, tuple):
        for each in value:
            yield from entries_of(each)
    elif is_dataclass(value):
        for field in fields(value):
            yield from entries_of(getattr(value, field.name))


def with_entries(value: T, change: Callable[[Entry], Entry]) -> T:
    """A copy of a dataclass in which every entry is replaced by what `change` makes of it."""
    return cast(T, _changed(value, change))


def _changed(value: Any, change: Callable[[Entry], Entry]) -> Any:
    if isinstance(value, Entry):
        return change(value)
    if isinstance(value, tuple):
        return tuple(_changed(each, change) for each in value)
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{field.name: _changed(getattr(value, field.name), change) for field in fields(value)})
    return value


def digits(value: Any) -> float:
    """A number in the six digits that are written."""
    return float(f"{float(value):.6g}")


def nested(values: Array) -> Any:
    """An array of any shape as nested lists of numbers in six digits; a number if it has no axes."""
    return digits(values) if np.ndim(values) == 0 else [nested(each) for each in values]


def columns_of_one(matrix: Array) -> Any:
    """An array of shape (n, ...) as lists whose columns sum to one as written: the largest takes the rounding error."""
    clean = np.clip(np.array(matrix, dtype=np.float64), 0, 1)
    rounded = np.round(clean / clean.sum(axis=0), 7)
    columns = rounded.reshape(len(rounded), -1)
    largest = columns.argmax(axis=0), np.arange(columns.shape[1])
    columns[largest] += 1 - columns.sum(axis=0)
    return np.round(columns.reshape(rounded.shape), 7).tolist()
