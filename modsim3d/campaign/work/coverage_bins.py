"""The bins by which a campaign says what it covered and what not: fixed, so that campaigns can be compared."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.tracking.scores.occlusions import LENGTH_EDGES_S


@dataclass(frozen=True)
class Bins:
    """Bins of a quantity from 0 up; the last one is open, and a value at an edge belongs to the bin above it.

    Attributes:
        prefix: How the names of its columns begin.
        unit: Unit of the edges.
        edges: Between two bins, ascending.
    """

    prefix: str
    unit: str
    edges: tuple[int, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Columns, such as `covered.frames.range_0_100_m` and `covered.frames.range_over_5000_m`."""
        closed = (f"{self.prefix}{low}_{high}_{self.unit}" for low, high in pairwise((0, *self.edges)))
        return *closed, f"{self.prefix}over_{self.edges[-1]}_{self.unit}"

    @property
    def labels(self) -> tuple[str, ...]:
        """The same as a page shows them, such as `0 to 100 m` and `100 m and more`."""
        closed = (f"{low} to {high} {self.unit}" for low, high in pairwise((0, *self.edges)))
        return *closed, f"{self.edges[-1]} {self.unit} and more"

    def place(self, values: Array) -> Indices:
        """Index of the bin of each value, shape (n,)."""
        return np.asarray(np.searchsorted(np.array(self.edges), values, side="right"), dtype=np.int64)

    def counts(self, values: Array) -> dict[str, int]:
        """Number of values in each bin, by the name of its column; those that are not finite are left out."""
        found = np.bincount(self.place(values[np.isfinite(values)]), minlength=len(self.edges) + 1)
        return dict(zip(self.names, found.tolist(), strict=True))


RANGES = Bins("covered.frames.range_", "m", (100, 200, 500, 1000, 2000, 5000))
"""Vessel-frames by the distance of the vessel's centre from the camera."""
SIZES = Bins("covered.frames.size_", "px", (8, 16, 32, 64, 128, 256))
"""Vessel-frames by √(width × height) of the box, as the detector's effects of size take it."""
OCCLUSIONS = Bins("covered.occlusions.", "s", LENGTH_EDGES_S)
"""Occlusions by length, as the scores tell them apart."""
