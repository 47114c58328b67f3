"""Where on the sea vessels were matched and missed: by bearing from the camera's axis, and by range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.boxes import centre_form
from modsim3d.geometry.camera import Camera
from modsim3d.learn.observed.observed import Observed
from modsim3d.learn.told.tables import Table
from modsim3d.voyage.truth_noise.jacobians import View

_STEPS_DEG = (1.0, 2.0, 5.0, 10.0, 15.0, 20.0, 30.0)
_MOST_BINS = 9


@dataclass(frozen=True, eq=False)
class Coverage:
    """Annotations that were to be detected, by the camera that they are of.

    Attributes:
        camera: Name of the camera.
        bearing_deg: Bearing from the camera's axis, to the right, shape (n,).
        range_m: Horizontal range, shape (n,).
        found: Whether it was matched, shape (n,).
    """

    camera: str
    bearing_deg: Array
    range_m: Array
    found: Mask

    @property
    def bearings_deg(self) -> Array:
        """Edges of cells of bearing, at round numbers, ascending."""
        low, high = self.bearing_deg.min(), self.bearing_deg.max()
        step = next((each for each in _STEPS_DEG if (high - low) / each <= _MOST_BINS - 1), _STEPS_DEG[-1])
        edges: Array = np.arange(np.floor(low / step), np.floor(high / step) + 2) * step
        return edges

    @property
    def ranges_m(self) -> Array:
        """Edges of cells of range: 1, 2, 5, 10 and so on, ascending."""
        series = np.array([digit * 10.0**power for power in range(7) for digit in (1, 2, 5)])
        first = max(int(np.searchsorted(series, self.range_m.min(), side="right")) - 1, 0)
        last = int(np.searchsorted(series, self.range_m.max(), side="right"))
        return series[first : last + 1]

    def counts(self) -> tuple[Array, Array]:
        """Numbers matched and to be matched in each cell of bearing and range, shapes (bearings, ranges)."""
        edges = [self.bearings_deg, self.ranges_m]
        whole = np.histogram2d(self.bearing_deg, self.range_m, edges)[0]
        matched = np.histogram2d(self.bearing_deg[self.found], self.range_m[self.found], edges)[0]
        return matched, whole


def coverages(observed: Observed, views: Sequence[View]) -> list[Coverage]:
    """The coverage of each camera that any vessel was before; views of one camera are taken together."""
    labelled, matched = observed.labelled, observed.matched
    of_image = np.full(len(labelled.images), -1)
    cameras: dict[str, Camera] = {}
    for number, view in enumerate(views):
        of_image[view.images] = number
        cameras.setdefault(view.camera.name, view.camera)
    rows = np.flatnonzero(matched.sought)
    names = np.array([view.camera.name for view in views])[of_image[labelled.annotations.image[rows]]]
    done = []
    for name, camera in cameras.items():
        ours = rows[names == name]
        if len(ours):
            bearing, range_m = bearings(camera, labelled.annotations.boxes_px[ours], labelled.annotations.depth_m[ours])
            done.append(Coverage(name, bearing, range_m, matched.detection[ours] >= 0))
    return done


def bearings(camera: Camera, boxes_px: Array, depth_m: Array | float) -> tuple[Array, Array]:
    """Bearing from the camera's axis in degrees, to the right, and horizontal range, of boxes (n, 4), shapes (n,)."""
    size = np.array(camera.intrinsics.image_size_px, dtype=np.float64)
    pixels = np.clip(centre_form(boxes_px)[:, :2], 0, size)
    rays = camera.intrinsics.unproject(pixels, np.ones(len(pixels)))
    across = np.nan_to_num(rays[:, 0])
    return np.degrees(np.arctan(across)), np.asarray(depth_m * np.hypot(1.0, across))


def range_table(coverage: Coverage) -> Table:
    """Matched and missed by range, the nearest first."""
    matched, whole = (each.sum(axis=0) for each in coverage.counts())
    edges = coverage.ranges_m
    rows = tuple(
        (
            f"{edges[k]:,.0f} to {edges[k + 1]:,.0f} m",
            f"{int(whole[k]):,}",
            f"{int(matched[k]):,}",
            f"{int(whole[k] - matched[k]):,}",
            f"{matched[k] / whole[k]:.0%}",
            _bearings(coverage, edges[k], edges[k + 1]),
        )
        for k in np.flatnonzero(whole)
    )
    header = ("range", "to be detected", "matched", "missed", "share matched", "bearings from the axis")
    return Table(f"What camera '{coverage.camera}' matched and missed, by range", header, rows)


def _bearings(coverage: Coverage, low_m: float, high_m: float) -> str:
    inside = (coverage.range_m >= low_m) & (coverage.range_m < high_m)
    low, high = coverage.bearing_deg[inside].min(), coverage.bearing_deg[inside].max()
    return f"{low:+.0f}° to {high:+.0f}°"


def cells(coverage: Coverage) -> list[tuple[int, int, int, int]]:
    """Place of bearing and of range, number matched and number to be matched, of each cell that is not empty."""
    matched, whole = coverage.counts()
    places: Indices = np.argwhere(whole > 0)
    return [(int(b), int(r), int(matched[b, r]), int(whole[b, r])) for b, r in places]
