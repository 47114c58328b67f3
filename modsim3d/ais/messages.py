"""What the readers return: reported positions and particulars of vessels, in columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from modsim3d.arrays import Array, Indices, Mask


class _Columns:
    """A table whose columns are arrays of equal length."""

    def _arrays(self) -> list[NDArray[Any]]:
        return [getattr(self, field.name) for field in fields(self)]  # type: ignore[arg-type]

    def __len__(self) -> int:
        return len(self._arrays()[0])

    def take(self, rows: Indices | Mask) -> Self:
        """Some of the rows: by mask, shape (n,), or by row numbers in any order, shape (m,)."""
        return type(self)(*(array[rows] for array in self._arrays()))

    @classmethod
    def join(cls, parts: Sequence[Self]) -> Self:
        """The rows of one or more tables, one table after another."""
        return cls(*(np.concatenate(arrays) for arrays in zip(*(part._arrays() for part in parts), strict=True)))


@dataclass(frozen=True, eq=False)
class Positions(_Columns):
    """Reported positions, shape (n,) each, NaN where a report leaves a value open.

    Attributes:
        mmsi: The vessel's identity.
        time_s: Unix time.
        latitude_deg: Latitude of the antenna, and with `longitude_deg` its place.
        speed_kn: Speed over ground.
        course_deg: Course over ground, clockwise from north.
        heading_deg: True heading of the bow, clockwise from north.
        ship: Whether the sender is of a kind that sits on ships (class A or B).
        row: Its row or line in the file, the first being 1.
    """

    mmsi: Indices
    time_s: Array
    latitude_deg: Array
    longitude_deg: Array
    speed_kn: Array
    course_deg: Array
    heading_deg: Array
    ship: Mask
    row: Indices


@dataclass(frozen=True, eq=False)
class Particulars(_Columns):
    """Names, types and dimensions that vessels report, shape (n,) each, NaN or empty where they report none.

    Attributes:
        mmsi: The vessel's identity.
        time_s: Unix time at which this was last reported.
        ship_type: Code or words of the source.
        to_bow_m: From the antenna to the bow, A in the standard; the distances to the other sides are B, C and D.
        length_m: Where the source gives the length itself, beside these distances or in their place.
    """

    mmsi: Indices
    time_s: Array
    name: NDArray[np.object_]
    ship_type: NDArray[np.object_]
    to_bow_m: Array
    to_stern_m: Array
    to_port_m: Array
    to_starboard_m: Array
    length_m: Array
    beam_m: Array


@dataclass(frozen=True, eq=False)
class Chunk:
    """What a reader returns for a part of a file.

    Attributes:
        messages: Number of messages read, with those dropped.
        dropped: Reason → number of messages that are in neither table.
        problems: One line on each of the first dropped messages.
    """

    positions: Positions
    particulars: Particulars
    messages: int
    dropped: Mapping[str, int]
    problems: tuple[str, ...] = ()
