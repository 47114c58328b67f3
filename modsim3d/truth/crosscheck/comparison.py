"""The truth of one frame against its own drawing: pixel by pixel, in numbers, and against the corners' boxes. Each
vessel is drawn alone, in a buffer of its own size, and the scene in the rectangle around all of them. Pixels may differ
only where rounding decides what is seen. A box from pixels reaches at most half a pixel, and what rounding moves,
beyond the box of the projected corners; it may be smaller where a sharp tip holds no pixel centre."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, fields
from functools import cached_property
from typing import NoReturn

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask, occurring
from modsim3d.render.id_pass import IdRenderer, Ids, Region
from modsim3d.truth.analytic import mask_box
from modsim3d.truth.crosscheck.drawing import MARGIN_PX, Drawing, tiles_of
from modsim3d.truth.record import Annotation, Truth
from modsim3d.truth.silhouettes import Spans

EDGE_PX = 1 / 128
"""Buffer pixels by which rounding may move an edge: half of 1/256 along both axes, and as much for the corners of what
it is compared with."""
LENS_EDGE_PX = 1 / 32  # the same with a lens, whose curves are drawn as chords
DEPTH_SHARE = 2.0**-20  # depths differing by less, as a share of the nearest corner's, are equal, but for moved corners
MAX_PAIRS = 2_000_000  # most pixels times triangles that are looked at together; it bounds the memory


def undecided(drawing: Drawing, x: Indices, y: Indices, wanted: int) -> Mask:
    """Mask of k pixels at which rounding decides whether an ID is seen, or anything else or nothing, shape (k,)."""
    ids, possible = possible_ids(drawing, x, y)
    this = ids == wanted
    return np.asarray(possible[:, this].any(axis=1) & possible[:, ~this].any(axis=1))


def possible_ids(drawing: Drawing, x: Indices, y: Indices) -> tuple[Indices, Mask]:
    """The m IDs of a drawing, 0 first, ascending, and whether each may be seen at k pixels, shapes (m,) and (k, m)."""
    solids, solid = occurring(drawing.occluder, int(drawing.occluder.max(initial=-1)) + 1)
    points = _straight(drawing, x, y)
    step = max(1, MAX_PAIRS // max(len(solid), 1))
    parts = [
        _possible(drawing, solid, len(solids), points[first : first + step]) for first in range(0, len(points), step)
    ]
    nothing = np.empty((0, len(solids) + 1), dtype=bool)
    return np.concatenate([[0], solids + 1]), np.concatenate([nothing, *parts])


def _straight(drawing: Drawing, x: Indices, y: Indices) -> Array:
    """The centres of pixels in the image of the pinhole, shape (k, 2)."""
    centres: Array = np.stack([x, y], axis=-1).astype(np.float64) + 0.5
    if drawing.intrinsics.distortion is None:
        return centres
    ray = drawing.intrinsics.unproject(centres / drawing.supersample, np.full(len(centres), 1.0))
    pinhole = drawing.intrinsics.pinhole
    return (ray @ pinhole.matrix.T)[..., :2] * drawing.supersample


def _possible(drawing: Drawing, solid: Indices, count: int, points: Array) -> Mask:
    """Whether nothing, and each of `count` solids, may be seen at points (k, 2), shape (k, count + 1)."""
    band = EDGE_PX if drawing.intrinsics.distortion is None else LENS_EDGE_PX
    corners, depth = drawing.straight_px, drawing.inverse_depth
    touching = (corners.min(axis=1) <= points.max(axis=0) + band) & (corners.max(axis=1) >= points.min(axis=0) - band)
    near = touching.all(axis=1)
    corners, depth, solid = corners[near], depth[near], solid[near]
    low, high = corners.min(axis=1) - band, corners.max(axis=1) + band
    perhaps = ((points[:, None] >= low) & (points[:, None] <= high)).all(axis=-1)
    surely = perhaps.copy()
    edges = np.roll(corners, -1, axis=1) - corners
    doubled = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    lengths = np.linalg.norm(edges, axis=-1)
    sign = np.where(doubled < 0, -1.0, 1.0)
    for i in range(3):
        away = points[:, None] - corners[:, i]
        inside = (edges[:, i, 0] * away[..., 1] - edges[:, i, 1] * away[..., 0]) * sign
        perhaps &= inside >= -band * lengths[:, i]
        surely &= inside > band * lengths[:, i]
    nearest, farthest = depth.max(axis=1) * (1 + DEPTH_SHARE), depth.min(axis=1) * (1 - DEPTH_SHARE)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = _slope(edges, depth, doubled)
        here = depth[:, 0] + ((points[:, None] - corners[:, 0]) * slope).sum(axis=-1)
        spread = np.abs(slope).sum(axis=-1) * band + DEPTH_SHARE * nearest
        at_most = np.fmin(here + spread, nearest)
        at_least = np.fmax(here - spread, farthest)
    possible = np.zeros((len(points), count + 1), dtype=bool)
    most, least = np.zeros((2, len(points), count))
    for number in np.flatnonzero(np.bincount(solid, minlength=count)).tolist():
        own = solid == number
        most[:, number] = np.where(perhaps[:, own], at_most[:, own], 0.0).max(axis=1)
        least[:, number] = np.where(surely[:, own], at_least[:, own], 0.0).max(axis=1)
    possible[:, 0] = ~(least > 0).any(axis=1)
    for number in range(count):
        others = np.delete(least, number, axis=1).max(axis=1, initial=0.0)
        possible[:, number + 1] = (most[:, number] > 0) & (most[:, number] >= others)
    return possible


def _slope(edges: Array, depth: Array, doubled: Array) -> Array:
    """Change of near / c3 for a pixel to the right and a pixel down in T triangles, shape (T, 2)."""
    to_b, to_c = edges[:, 0], -edges[:, 2]
    by_b, by_c = depth[:, 1] - depth[:, 0], depth[:, 2] - depth[:, 0]
    right, down = by_b * to_c[:, 1] - by_c * to_b[:, 1], by_c * to_b[:, 0] - by_b * to_c[:, 0]
    return np.stack([right, down], axis=-1) / doubled[:, None]


NOT_ROUNDED_PX = 1e-6  # sides are whole buffer pixels; this is what dividing by supersampling and multiplying leaves


@dataclass(frozen=True)
class CheckCounts:
    """Counts of a cross-check, and largest differences; results can be added. Names are those in `run.json`."""

    from_spans: int = 0  # vessels of the whole run whose pixels came from exact spans
    from_buffers: int = 0  # those that OpenGL drew
    frames: int = 0  # that were checked
    empty_frames: int = 0  # those of them without a vessel
    whole_frames: int = 0  # those of which the whole image was drawn
    vessels: int = 0  # in them
    pixels: int = 0  # of silhouettes, each compared twice: the vessel alone, and with what is in front of it
    tie_pixels: int = 0  # that differ because rounding decides what is seen there
    geometry_vessels: int = 0  # whose visible pixels were compared with the area that exact geometry gives
    sharp_tips: int = 0  # boxes smaller than that of the corners by more than a pixel, where a tip has no pixel
    # Largest distance of a side of a box from pixels to that of the box of the projected corners, tips left out.
    largest_box_px: float = 0.0
    largest_tip_px: float = 0.0  # the same of the tips
    largest_area_px: float = 0.0  # largest difference between visible pixels and visible area

    def __add__(self, other: CheckCounts) -> CheckCounts:
        """Both together: counts are summed, of differences the larger ones are kept."""
        pairs = {field.name: (getattr(self, field.name), getattr(other, field.name)) for field in fields(self)}
        return CheckCounts(**{name: (max if name.startswith("largest") else sum)(pair) for name, pair in pairs.items()})


@dataclass(eq=False)
class Difference(Exception):
    """A vessel on which truth and drawing differ."""

    vessel: int  # its index
    what: str  # what differs
    truth: str  # its value in the truth
    drawn: str  # its value as drawn
    masks: tuple[Mask, Mask]  # its pixels in the truth, and as they were drawn; of the same shape (h, w)


@dataclass(frozen=True, eq=False)
class FrameValues:
    """Values of one frame by the truth and by exact geometry."""

    truth: Truth  # its rows
    silhouettes: Spans  # their pixels; `row` is the index of the vessel
    visible: Spans  # those that are visible, likewise
    # Area of a vessel's visible part, and by how much its pixels may differ, where geometry tells.
    areas: Mapping[int, tuple[float, float]]
    annotation: Annotation | None = None  # that `annotated` of the truth follows; None if it follows none yet


def check_frame(
    drawing: Drawing,
    renderer: IdRenderer,
    claims: FrameValues,
    boxed: Set[int],
    names: Sequence[str],
    *,
    whole: bool = False,
) -> CheckCounts:
    """Draw a frame and compare it with what is said of it. `boxed` are the indices of the vessels that get a box if
    they are in the image, `names` those of the scene's occluders; with `whole`, the whole image is drawn, not only the
    rectangle around all vessels. Raises Difference if they differ by more than ties."""
    row_of = {vessel: row for row, vessel in enumerate(claims.truth.vessel.tolist())}
    vessels = sorted({*row_of, *(boxed & drawing.boxes_px.keys())})
    checks = [_VesselPixels(drawing, claims, vessel, row_of.get(vessel), names) for vessel in vessels]
    for tile in tiles_of(drawing.image if whole else drawing.region(*vessels)):
        seen = drawing.ids(renderer, tile)
        for pixels in checks:
            pixels.compare(renderer, seen, tile)
        if whole and seen.any():
            _look_beside(checks, seen, tile)
    one = CheckCounts(frames=1, empty_frames=int(not row_of), whole_frames=int(whole), vessels=len(row_of))
    return sum((pixels.checked() for pixels in checks), one)


def _look_beside(checks: Sequence[_VesselPixels], seen: Ids, tile: Region) -> None:
    """Refuse vessels whose IDs `seen` in a tile has outside the rectangles around them; what is inside is cleared."""
    for pixels in checks:
        ids = pixels.part(seen, tile, pixels.region.common(tile))
        ids[ids == pixels.vessel + 1] = 0
    for pixels in checks if seen.any() else ():
        if beside := int(np.count_nonzero(seen == pixels.vessel + 1)):
            pixels.refuse("pixels outside the box of its corners", "0", str(beside))


class _VesselPixels:
    """The pixels of a vessel in a frame, compared tile by tile; `row` is its row of the truth, None if it has none."""

    def __init__(
        self, drawing: Drawing, claims: FrameValues, vessel: int, row: int | None, names: Sequence[str]
    ) -> None:
        self.drawing, self.alone, self.vessel, self.row, self.names = drawing, drawing.only(vessel), vessel, row, names
        self.claims, ss = claims, drawing.supersample
        self.spans = [spans.take(spans.row == vessel) for spans in (claims.silhouettes, claims.visible)]
        self.full_box, self.visible_box = np.full((2, 4), np.nan)
        if row is not None:
            self.full_box = claims.truth.full_boxes_px[row] * ss
            self.visible_box = claims.truth.visible_boxes_px[row] * ss
        self.corners = drawing.boxes_px.get(vessel, self.full_box)
        low, high = np.fmin(self.corners, self.full_box)[:2], np.fmax(self.corners, self.full_box)[2:]
        self.region = Region.around(np.concatenate([low, high]), drawing.size_px, MARGIN_PX)
        self.px, self.hidden_by, self.ties = [0, 0], Counter[int](), 0
        self.hidden = [np.empty((2, 0), dtype=np.int64)]
        self.boxes = np.tile([np.inf, np.inf, -np.inf, -np.inf], (2, 1))
        self.masks = np.zeros((0, 0), dtype=bool), np.zeros((0, 0), dtype=bool)

    @staticmethod
    def part(seen: Ids, tile: Region, region: Region) -> Ids:
        return seen[region.y - tile.y :, region.x - tile.x :][: region.height, : region.width]

    def compare(self, renderer: IdRenderer, seen: Ids, tile: Region) -> None:
        """Compare its pixels in a tile that shows the IDs `seen`. Raises Difference if more than ties differ."""
        region = self.region.common(tile)
        if not region.width or not region.height:
            return
        ids = self.part(seen, tile, region)
        alone = self.alone.ids(renderer, region) > 0
        shown = alone & ((ids == self.vessel + 1) | (ids == 0))
        masks = [mask_of(spans, region) for spans in self.spans]
        kinds = ("silhouette", self.alone, masks[0], alone), ("visible", self.drawing, masks[1], shown)
        for which, (what, of, claim, drawn) in enumerate(kinds):
            self._compare(of, what, claim, drawn, region)
            if claim.any():
                self.px[which] += int(np.count_nonzero(claim))
                box = mask_box(claim, region)
                self.boxes[which, :2] = np.minimum(self.boxes[which, :2], box[:2])
                self.boxes[which, 2:] = np.maximum(self.boxes[which, 2:], box[2:])
        y, x = np.nonzero((alone & ~shown) | (masks[0] & ~masks[1]))
        self.hidden.append(np.stack([y + region.y, x + region.x]))
        if (hidden := alone & ~shown).any():
            counts = np.bincount(ids[hidden])
            self.hidden_by.update({int(number) - 1: int(counts[number]) for number in np.flatnonzero(counts)})

    def _compare(self, drawing: Drawing, what: str, claim: Mask, drawn: Mask, region: Region) -> None:
        self.masks, differing = (claim, drawn), claim ^ drawn
        if not differing.any():
            return
        y, x = np.nonzero(differing)
        ties = undecided(drawing, x + region.x, y + region.y, self.vessel + 1)
        self.ties += len(x)
        if not ties.all():
            column, row = int(x[~ties][0]) + region.x, int(y[~ties][0]) + region.y
            where = f"{np.count_nonzero(~ties)} pixels differ, one of them at column {column}, row {row}"
            self.refuse(f"{what} pixels", f"{np.count_nonzero(claim)}", f"{np.count_nonzero(drawn)} ({where})")

    def checked(self) -> CheckCounts:
        """Result of the comparison, once all tiles were compared. Raises Difference if numbers or boxes of the truth
        are not those of its pixels, or not those of the corners."""
        if self.row is None:
            if self.px[0]:
                self.refuse("silhouette pixels", "no row", f"{self.px[0] / self.drawing.supersample**2:g}")
            return CheckCounts()
        truth, ss = self.claims.truth, self.drawing.supersample
        silhouette = "silhouette", truth.silhouette_px[self.row], self.full_box
        visible = "visible", truth.visible_px[self.row], self.visible_box
        for which, (what, px, box) in enumerate((silhouette, visible)):
            if self.px[which] != round(px * ss**2):
                self.refuse(f"{what} pixels", f"{px:g}", f"{self.px[which] / ss**2:g}")
            if self.px[which] and np.abs(self.boxes[which] - box).max() > NOT_ROUNDED_PX:
                self.refuse(f"{what} box", _in_words(box / ss), _in_words(self.boxes[which] / ss))
        for occluder, px in (dict.fromkeys(self.hidden_by, 0.0) | dict(truth.occluders_of(self.row))).items():
            drawn = self.hidden_by[occluder]
            off = abs(round(px * ss**2) - drawn)
            if off > self.ties and off > self.ties + self._ties_behind(occluder):
                self.refuse(f"pixels behind '{self.names[occluder]}'", f"{px:g}", f"{drawn / ss**2:g}")
        self._compare_annotated(truth, self.row)
        return self._checked_by_geometry()

    def _ties_behind(self, occluder: int) -> int:
        """Pixels that are hidden on either side, at which rounding decides whether an occluder is in front."""
        ids, possible = self._possible_behind
        this = ids == occluder + 1
        return int((possible[:, this].any(axis=1) & possible[:, ~this].any(axis=1)).sum())

    @cached_property
    def _possible_behind(self) -> tuple[Indices, Mask]:
        """IDs that may be seen at pixels that are hidden on either side, see `possible_ids`."""
        y, x = np.concatenate(self.hidden, axis=1)
        return possible_ids(self.drawing, x, y)

    def _compare_annotated(self, truth: Truth, row: int) -> None:
        """Compare the visible fraction, and what the annotation keeps, with what follows from the pixels."""
        fraction, rule = self.px[1] / self.px[0] if self.px[0] else np.nan, self.claims.annotation
        if not np.isclose(truth.visible_fraction[row], fraction, rtol=1e-9, atol=0, equal_nan=True):
            self.refuse("visible fraction", f"{truth.visible_fraction[row]:g}", f"{fraction:g}")
        if rule is None:
            return
        # The truth's own numbers, which are equal but for rounding: a filter may be set to just such a number.
        box = (truth.visible_boxes_px if rule.mode == 2 else truth.full_boxes_px)[row]
        fraction = truth.visible_fraction[row]
        kept = (
            (rule.mode == 0 or self.px[1] > 0)
            and min(box[2:] - box[:2]) >= rule.min_box_px
            and truth.visible_px[row] >= rule.min_visible_px
            and (rule.min_visible_fraction <= 0 or fraction >= rule.min_visible_fraction)
        )
        if truth.annotated[row] != kept:
            self.refuse("annotated", str(bool(truth.annotated[row])), f"{kept}, by its pixels,")

    def _checked_by_geometry(self) -> CheckCounts:
        """Compare the full box with that of the projected corners, and visible pixels with the visible area."""
        beyond = np.concatenate([self.corners[:2] - self.full_box[:2], self.full_box[2:] - self.corners[2:]])
        edge_px = EDGE_PX if self.drawing.intrinsics.distortion is None else LENS_EDGE_PX
        tip = beyond.min() < -1.0
        if beyond.max() > 0.5 + edge_px or (tip and not self.px[0]):
            ss = self.drawing.supersample
            self.refuse("full box", _in_words(self.full_box / ss), f"{_in_words(self.corners / ss)} around the corners")
        area, bound = self.claims.areas.get(self.vessel, (np.nan, np.nan))
        off, size = abs(self.claims.truth.visible_px[self.row] - area), float(np.abs(beyond).max())
        if off > bound:
            self.refuse("visible pixels", f"{self.claims.truth.visible_px[self.row]:g}", f"{area:g} px² by geometry")
        return CheckCounts(
            pixels=self.px[0],
            tie_pixels=self.ties,
            geometry_vessels=int(not np.isnan(off)),
            sharp_tips=int(tip),
            largest_box_px=0.0 if tip else size / self.drawing.supersample,
            largest_tip_px=size / self.drawing.supersample if tip else 0.0,
            largest_area_px=0.0 if np.isnan(off) else float(off),
        )

    def refuse(self, what: str, truth: str, drawn: str) -> NoReturn:
        raise Difference(self.vessel, what, truth, drawn, self.masks)


def mask_of(spans: Spans, region: Region) -> Mask:
    """The pixels of spans in a region, shape (height, width)."""
    edges = np.zeros((region.height, region.width + 1), dtype=np.int8)
    inside = (spans.y >= region.y) & (spans.y < region.y + region.height)
    for ends, step in ((spans.start, 1), (spans.stop, -1)):
        place = spans.y[inside] - region.y, np.clip(ends[inside] - region.x, 0, region.width)
        np.add.at(edges, place, step)
    return edges.cumsum(axis=1, dtype=np.int8)[:, :-1] > 0


def _in_words(box: Array) -> str:
    return "[" + ", ".join(f"{side:g}" for side in box.round(2)) + "]"
