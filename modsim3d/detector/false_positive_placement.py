"""Places of false positives: on the sea in the image, near the horizon, or by a map."""

from dataclasses import dataclass

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Mask
from modsim3d.core.random_streams import on_grid
from modsim3d.detector.draws import choose, cumulative

_NEXT = np.array([1, 2, 3, 0])  # the corner after each of four: `np.roll` takes ten times as long for one image


def sea_polygons(half_planes: Array, image_size_px: tuple[int, int]) -> Array:
    """The sea in each image: the image cut by half-planes a·x + b·y + c >= 0 (Sutherland & Hodgman (1974)). Half-planes
    (a, b, c) have shape (m, 3). The convex polygons have eight corners in order, shape (m, 8, 2); one that has fewer
    repeats some. Where no sea is in the image, the polygon is the whole image."""
    width, height = image_size_px
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.float64)
    a, b, c = half_planes[:, :1], half_planes[:, 1:2], half_planes[:, 2:]
    start_side = a * corners[:, 0] + b * corners[:, 1] + c  # (m, 4), at the start of each edge
    end_side = start_side[:, _NEXT]
    at_sea = start_side >= 0
    crosses = at_sea != at_sea[:, _NEXT]
    along = np.where(crosses, start_side, 0) / np.where(crosses, start_side - end_side, 1)
    polygons, is_corner = np.empty((len(half_planes), 8, 2)), np.empty((len(half_planes), 8), dtype=bool)
    polygons[:, ::2], polygons[:, 1::2] = corners, corners + along[..., None] * (corners[_NEXT] - corners)
    is_corner[:, ::2], is_corner[:, 1::2] = at_sea, crosses
    is_corner[~is_corner.any(axis=1), ::2] = True
    return _repeat_missing(polygons, is_corner)


def _repeat_missing(polygons: Array, present: Mask) -> Array:
    """Each missing corner replaced by the last one before it that is there, around the polygon."""
    places = np.where(present, np.arange(8), -1)
    last = places.max(axis=1, keepdims=True)
    source = np.maximum.accumulate(places, axis=1)
    return polygons[np.arange(len(polygons))[:, None], np.where(source < 0, last, source)]


def uniform_places(half_planes: Array, image_size_px: tuple[int, int], uniforms: Array) -> Array:
    """Points spread evenly over the sea in the image, or over the image where it shows none. A triangle of the fan from
    the first corner is chosen by its area, then a point in it. Half-planes and uniform numbers have shape (m, 3); the
    points, x and y in pixels, have shape (m, 2)."""
    polygons = sea_polygons(half_planes, image_size_px)
    spokes = polygons[:, 1:] - polygons[:, :1]
    first, second = spokes[:, :-1], spokes[:, 1:]
    areas = np.abs(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])
    areas[areas.sum(axis=1) == 0] = 1  # sea along one edge or at one corner only
    rows, chosen = np.arange(len(polygons)), choose(cumulative(areas), uniforms[:, 0])
    outward, across = np.sqrt(uniforms[:, 1:2]), uniforms[:, 2:3]
    offsets = (1 - across) * first[rows, chosen] + across * second[rows, chosen]
    return np.clip(polygons[:, 0] + outward * offsets, 0, image_size_px)


_NODES = 129
DRAWS = 3  # uniform numbers a place
PLACE_STEP_PX = 2.0**-10  # places are rounded to it: the horizon brings in all the rounding of a camera's angles


@dataclass(frozen=True, eq=False)
class Placement:
    """Density of false positives in the image."""

    band_px: float | None = None  # greatest distance below the horizon; no limit if None
    far_half_px: float | None = None  # distance below the horizon over which the density halves; it is uniform if None
    density: Array | None = None  # weights of the cells of a grid over the whole image, shape (rows, columns)

    def places(
        self, half_planes: Array, image_size_px: tuple[int, int], uniforms: Array, drift_px: Array | None = None
    ) -> Array:
        """Points in the image, x and y in pixels, multiples of `PLACE_STEP_PX`, shape (m, 2). Half-planes are the sea
        side of the horizon, and uniform numbers have the same shape (m, 3). `drift_px` is how far each point has moved
        along the horizon, (m,); None for points that do not move."""
        if not len(uniforms):  # most single frames
            return np.empty((0, 2))
        return on_grid(self._places(half_planes, image_size_px, uniforms, drift_px), PLACE_STEP_PX)

    def _places(
        self, half_planes: Array, image_size_px: tuple[int, int], uniforms: Array, drift_px: Array | None
    ) -> Array:
        if self.density is not None:
            return _on_map(self.density, image_size_px, uniforms, drift_px)
        if self.band_px is None and self.far_half_px is None and drift_px is None:
            return uniform_places(half_planes, image_size_px, uniforms)
        return self._below_the_horizon(half_planes, image_size_px, uniforms, drift_px)

    def _weights(self, below_px: Array) -> Array:
        if self.far_half_px is None:
            return np.ones_like(below_px)
        return np.asarray(special.exp2(-below_px / self.far_half_px))

    def _below_the_horizon(
        self, half_planes: Array, image_size_px: tuple[int, int], uniforms: Array, drift_px: Array | None
    ) -> Array:
        """A depth below the horizon by its share of the weight, then a place along that level. A place follows the
        horizon smoothly as it moves, which one chosen by area does not."""
        down, along = _axes(half_planes)
        offset = half_planes[:, 2] / _length(half_planes)
        depth, across = _corners(half_planes, image_size_px)
        level = _inverse(self._level_weights(depth, across), self._levels(depth), uniforms[:, 0])
        low, high = (ends[:, 0] for ends in _slice(depth, across, level[:, None]))
        width = np.maximum(high - low, 1e-9)
        place = low + _reflected(uniforms[:, 1] * width + (0 if drift_px is None else drift_px), width)
        return np.clip((level - offset)[:, None] * down + place[:, None] * along, 0, image_size_px)

    def _level_weights(self, depth: Array, across: Array) -> Array:
        """Weight of levels evenly spaced over each polygon's depths, shape (m, nodes)."""
        nodes = self._levels(depth)
        low, high = _slice(depth, across, nodes)
        weights: Array = self._weights(np.maximum(nodes, 0)) * (high - low)
        weights[weights.sum(axis=1) <= 0] = 1.0  # sea along one edge or at one corner only
        return weights

    def _levels(self, depth: Array) -> Array:
        """Depths below the horizon that share out the sea in the band, closer together near the horizon. Where the band
        is not in the image, they share out all the sea in it. Shape (m, nodes)."""
        least, most = depth.min(axis=1), depth.max(axis=1)
        if self.band_px is not None:
            most = np.where(least < self.band_px, np.minimum(most, self.band_px), most)
        levels = least[:, None] + (most - least)[:, None] * np.linspace(0, 1, _NODES) ** 2
        return np.asarray(np.minimum(levels, most[:, None]))


def sea_levels(half_planes: Array, image_size_px: tuple[int, int]) -> tuple[Array, Array]:
    """Depths below the horizon that share out each image's sea, and its width there, in px, (m, nodes)."""
    depth, across = _corners(half_planes, image_size_px)
    everywhere = Placement()
    return everywhere._levels(depth), everywhere._level_weights(depth, across)


def depths_px(half_planes: Array, points_px: Array) -> Array:
    """Depths of points (m, 2) below the horizons of half-planes (m, 3), negative above them, shape (m,)."""
    down, _ = _axes(half_planes)
    return np.asarray((points_px * down).sum(axis=1) + half_planes[:, 2] / _length(half_planes))


def _corners(half_planes: Array, image_size_px: tuple[int, int]) -> tuple[Array, Array]:
    """Depth below the horizon and place along it of the corners of the sea in each image, shapes (m, 8)."""
    polygons = sea_polygons(half_planes, image_size_px)
    down, along = _axes(half_planes)
    # On the grid: rounding must not decide whether an edge lies along a level.
    depth = on_grid((polygons * down[:, None]).sum(axis=2) + (half_planes[:, 2] / _length(half_planes))[:, None])
    return depth, on_grid((polygons * along[:, None]).sum(axis=2))


def _length(half_planes: Array) -> Array:
    length = np.sqrt(half_planes[:, 0] ** 2 + half_planes[:, 1] ** 2)
    return np.where(length > 0, length, 1.0)


def _axes(half_planes: Array) -> tuple[Array, Array]:
    """Unit vectors away from the horizon and along it, to the right in a level image; shapes (m, 2)."""
    down = half_planes[:, :2] / _length(half_planes)[:, None]
    down = np.where(np.any(down != 0, axis=1)[:, None], down, [0.0, 1.0])  # no horizon: the whole image is sea
    return down, np.stack([down[:, 1], -down[:, 0]], axis=1)


def _slice(depth: Array, across: Array, levels: Array) -> tuple[Array, Array]:
    """Ends of levels (m, k) in each convex polygon, whose corners have shapes (m, 8); shapes (m, k)."""
    rise, run = np.roll(depth, -1, axis=1) - depth, np.roll(across, -1, axis=1) - across
    low, high = np.full(levels.shape, np.inf), np.full(levels.shape, -np.inf)
    for edge in range(depth.shape[1]):
        start, up = depth[:, edge, None], rise[:, edge, None]
        share = (levels - start) / np.where(up == 0, 1.0, up)
        met: Mask = (share >= 0) & (share <= 1) & (up != 0)
        crossing = across[:, edge, None] + share * run[:, edge, None]
        np.minimum(low, crossing, out=low, where=met)
        np.maximum(high, crossing, out=high, where=met)
    some = low <= high
    least, most = across.min(axis=1, keepdims=True), across.max(axis=1, keepdims=True)
    return np.where(some, low, least), np.where(some, high, most)


def _inverse(weights: Array, nodes: Array, uniforms: Array) -> Array:
    """Levels at these shares of the weight, which is taken for constant between two nodes; shape (m,)."""
    middles = (weights[:, 1:] + weights[:, :-1]) / 2 * np.diff(nodes, axis=1)
    middles[middles.sum(axis=1) <= 0] = 1.0
    distribution = cumulative(middles)
    cell = choose(distribution, uniforms)
    rows = np.arange(len(cell))
    below = np.where(cell > 0, distribution[rows, cell - 1], 0.0)
    share = (uniforms - below) / np.maximum(distribution[rows, cell] - below, 1e-300)
    return nodes[rows, cell] + share * (nodes[rows, cell + 1] - nodes[rows, cell])


def _reflected(place: Array, width: Array) -> Array:
    """A place that has moved, thrown back at both ends of [0, width]."""
    turned = np.mod(place, 2 * width)
    return np.minimum(turned, 2 * width - turned)


def _on_map(density: Array, image_size_px: tuple[int, int], uniforms: Array, drift_px: Array | None) -> Array:
    """A cell by its weight, a place in it."""
    rows, columns = density.shape
    cell = np.searchsorted(cumulative(density.ravel()), uniforms[:, 0], side="right")
    place = np.stack([cell % columns + uniforms[:, 1], cell // columns + uniforms[:, 2]], axis=1)
    points = place / [columns, rows] * image_size_px
    if drift_px is not None:
        points[:, 0] = _reflected(points[:, 0] + drift_px, np.full(len(points), float(image_size_px[0])))
    return np.clip(points, 0, image_size_px)
