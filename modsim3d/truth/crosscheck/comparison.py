"""The truth of one frame against its own drawing: pixel by pixel, in numbers, and against the corners' boxes.

Each vessel is drawn alone, in a buffer of its own size, and the scene in the rectangle around all of them. Pixels may
differ only where rounding decides what is seen. A box from pixels reaches at most half a pixel, and what rounding
moves, beyond the box of the projected corners; it may be smaller where a sharp tip holds no pixel centre.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, fields
from typing import NoReturn

import numpy as np

from modsim3d.arrays import Array, Mask
from modsim3d.render.id_pass import IdRenderer, Ids, Region
from modsim3d.truth.crosscheck.drawing import MARGIN_PX, Drawing, tiles_of
from modsim3d.truth.crosscheck.possible_ids import EDGE_PX, LENS_EDGE_PX, tie_pixels, undecided
from modsim3d.truth.pixel_spans import Spans

NOT_ROUNDED_PX = 1e-6
"""Sides of boxes are whole buffer pixels; this is what dividing by the supersampling and multiplying again leaves."""


@dataclass(frozen=True)
class Checked:
    """What was checked, and how far apart the two sides were; results can be added. The names are keys of `run.json`.

    Attributes:
        from_spans: Vessels of the whole run whose pixels came from exact spans.
        from_buffers: Those that OpenGL drew.
        frames: Frames that were checked.
        empty_frames: Those of them without a vessel.
        whole_frames: Those of which the whole image was drawn.
        vessels: Vessels in them.
        pixels: Pixels of silhouettes, each compared twice: the vessel alone, and with what is in front of it.
        tie_pixels: Pixels that differ because rounding decides what is seen there.
        geometry_vessels: Vessels whose visible pixels were compared with the area that exact geometry gives.
        sharp_tips: Boxes that are smaller than that of the corners by more than a pixel, where a tip has no pixel.
        largest_box_px: Largest distance of a side of a box from pixels to that of the box of the projected corners,
            tips left out.
        largest_tip_px: The same of the tips.
        largest_area_px: Largest difference between visible pixels and visible area.
    """

    from_spans: int = 0
    from_buffers: int = 0
    frames: int = 0
    empty_frames: int = 0
    whole_frames: int = 0
    vessels: int = 0
    pixels: int = 0
    tie_pixels: int = 0
    geometry_vessels: int = 0
    sharp_tips: int = 0
    largest_box_px: float = 0.0
    largest_tip_px: float = 0.0
    largest_area_px: float = 0.0

    def __add__(self, other: Checked) -> Checked:
        """Both together: counts are summed, of differences the larger ones are kept."""
        pairs = {each.name: (getattr(self, each.name), getattr(other, each.name)) for each in fields(self)}
        return Checked(**{name: (max if name.startswith("largest") else sum)(pair) for name, pair in pairs.items()})


@dataclass(eq=False)
class Difference(Exception):
    """A vessel on which truth and drawing differ.

    Attributes:
        vessel: Its index.
        what: What differs.
        truth: What the truth has.
        drawn: What was drawn.
        masks: Its pixels in the truth, and as they were drawn; of the same shape (h, w).
    """

    vessel: int
    what: str
    truth: str
    drawn: str
    masks: tuple[Mask, Mask]


@dataclass(frozen=True, eq=False)
class VesselTruth:
    """What the truth has of a vessel in a frame, in buffer pixels.

    Attributes:
        full_box: Of its silhouette, shape (4,).
        visible_box: Of what is visible, NaN if nothing is, shape (4,).
        silhouette_px: Number of pixels of its silhouette.
        visible_px: Number of those that are visible.
        hidden_by: How many of them each occluder hides, by its index.
        silhouette: The pixels of its silhouette.
        visible: Those that are visible.
    """

    full_box: Array
    visible_box: Array
    silhouette_px: float
    visible_px: float
    hidden_by: dict[int, float]
    silhouette: Spans
    visible: Spans


NO_TRUTH = VesselTruth(np.full(4, np.nan), np.full(4, np.nan), 0.0, 0.0, {}, Spans.none(), Spans.none())


def check_frame(
    drawing: Drawing,
    renderer: IdRenderer,
    truth: Mapping[int, VesselTruth],
    boxed: Set[int],
    names: Sequence[str],
    *,
    whole: bool = False,
) -> Checked:
    """Draw a frame and compare it with its truth.

    Args:
        drawing: The frame.
        renderer: Draws it.
        truth: What the truth has, by index of the vessel.
        boxed: Indices of the vessels that get a box if they are in the image.
        names: Of the scene's occluders.
        whole: Draw the whole image, not only the rectangle around all vessels.

    Raises:
        Difference: They differ by more than ties.
    """
    vessels = sorted({*truth, *(boxed & drawing.boxes_px.keys())})
    found = [_VesselPixels(drawing, vessel, truth.get(vessel, NO_TRUTH), names) for vessel in vessels]
    for tile in tiles_of(drawing.image if whole else drawing.region(*vessels)):
        seen = drawing.ids(renderer, tile)
        for pixels in found:
            pixels.compare(renderer, seen, tile)
        if whole:
            _look_beside(found, seen, tile)
    one = Checked(frames=1, empty_frames=int(not truth), whole_frames=int(whole), vessels=len(truth))
    return sum((pixels.checked() for pixels in found), one)


def _look_beside(found: Sequence[_VesselPixels], seen: Ids, tile: Region) -> None:
    """Refuse vessels whose IDs `seen` in a tile has outside the rectangles around them; what is inside is cleared."""
    for pixels in found if seen.any() else ():
        ids = pixels.part(seen, tile, pixels.region.common(tile))
        ids[ids == pixels.vessel + 1] = 0
    left = seen[seen > 0] if seen.any() else seen[:0]
    for pixels in found if len(left) else ():
        if beside := int(np.count_nonzero(left == pixels.vessel + 1)):
            pixels.refuse("pixels outside the box of its corners", "0", str(beside))


class _VesselPixels:
    """The pixels of a vessel in a frame, compared tile by tile."""

    def __init__(self, drawing: Drawing, vessel: int, truth: VesselTruth, names: Sequence[str]) -> None:
        self.drawing, self.vessel, self.truth, self.names = drawing, vessel, truth, names
        self.alone = drawing.only(vessel)
        box = drawing.boxes_px.get(vessel, truth.full_box)
        around = np.concatenate([np.fmin(box, truth.full_box)[:2], np.fmax(box, truth.full_box)[2:]])
        self.region = Region.around(around, drawing.size_px, MARGIN_PX)
        self.full, self.visible, self.hidden_by = _Counted(), _Counted(), Counter[int]()
        self.ties = self.hidden_ties = 0
        self.masks = np.zeros((0, 0), dtype=bool), np.zeros((0, 0), dtype=bool)

    def compare(self, renderer: IdRenderer, seen: Ids, tile: Region) -> None:
        """Compare its pixels in a tile, of which `seen` are the IDs.

        Raises:
            Difference: They differ by more than ties.
        """
        region = self.region.common(tile)
        if not region.width or not region.height:
            return
        ids = self.part(seen, tile, region)
        alone = self.alone.ids(renderer, region) > 0
        shown = alone & ((ids == self.vessel + 1) | (ids == 0))
        full, visible = _mask(self.truth.silhouette, region), _mask(self.truth.visible, region)
        self._compare(self.alone, "silhouette", full, alone, region)
        self._compare(self.drawing, "visible", visible, shown, region)
        self.full.add(full, region)
        self.visible.add(visible, region)
        hidden = alone & ~shown
        if hidden.any():
            counts = np.bincount(ids[hidden])
            self.hidden_by.update({int(each) - 1: int(counts[each]) for each in counts.nonzero()[0]})
            if self.hidden_by != self.truth.hidden_by:
                y, x = np.nonzero(hidden)
                self.hidden_ties += int(tie_pixels(self.drawing, x + region.x, y + region.y).sum())

    @staticmethod
    def part(seen: Ids, tile: Region, region: Region) -> Ids:
        """The IDs in a region of a tile."""
        return seen[region.y - tile.y :, region.x - tile.x :][: region.height, : region.width]

    def _compare(self, drawing: Drawing, what: str, truth: Mask, drawn: Mask, region: Region) -> None:
        self.masks = truth, drawn
        differing = truth ^ drawn
        if not differing.any():
            return
        y, x = np.nonzero(differing)
        ties = undecided(drawing, x + region.x, y + region.y, self.vessel + 1)
        if not ties.all():
            column, row = int(x[~ties][0]) + region.x, int(y[~ties][0]) + region.y
            where = f"{np.count_nonzero(~ties)} pixels differ, one of them at column {column}, row {row}"
            self.refuse(f"{what} pixels", f"{np.count_nonzero(truth)}", f"{np.count_nonzero(drawn)} ({where})")
        self.ties += len(x)

    def checked(self) -> Checked:
        """What was compared, once all tiles were.

        Raises:
            Difference: Numbers or boxes of the truth are not those of its pixels, or not those of the corners.
        """
        truth = self.truth
        for what, counted, px, box in (
            ("silhouette", self.full, truth.silhouette_px, truth.full_box),
            ("visible", self.visible, truth.visible_px, truth.visible_box),
        ):
            if counted.px != round(px):
                self.refuse(f"{what} pixels", f"{px:g}", f"{counted.px}")
            if counted.px and np.abs(counted.box - box).max() > NOT_ROUNDED_PX:
                self.refuse(f"{what} box", _in_words(box), _in_words(counted.box))
        self._check_occluders()
        sides = self._beyond_corners()
        tip = sides.min(initial=0.0) < -1.0
        size = float(np.abs(sides).max(initial=0.0)) / self.drawing.supersample
        return Checked(
            pixels=self.full.px,
            tie_pixels=self.ties + self.hidden_ties,
            sharp_tips=int(tip),
            largest_box_px=0.0 if tip else size,
            largest_tip_px=size if tip else 0.0,
        )

    def _check_occluders(self) -> None:
        """Refuse another number of pixels behind an occluder than ties can move from one to another."""
        for occluder in {*self.hidden_by, *self.truth.hidden_by}:
            said, drawn = self.truth.hidden_by.get(occluder, 0.0), self.hidden_by[occluder]
            if abs(round(said) - drawn) > self.ties + self.hidden_ties:
                self.refuse(f"pixels behind '{self.names[occluder]}'", f"{said:g}", f"{drawn}")

    def _beyond_corners(self) -> Array:
        """How far each side of the truth's full box lies outside the box of the projected corners, shape (4,)."""
        box, said = self.drawing.boxes_px.get(self.vessel), self.truth.full_box
        if box is None or self.truth is NO_TRUTH:
            return np.empty(0)
        beyond = np.concatenate([box[:2] - said[:2], said[2:] - box[2:]])
        edge_px = EDGE_PX if self.drawing.intrinsics.distortion is None else LENS_EDGE_PX
        if beyond.max() > 0.5 + edge_px or (not self.full.px and beyond.min() < -1.0):
            self.refuse("full box", _in_words(said), f"{_in_words(box)} around the projected corners")
        return beyond

    def refuse(self, what: str, truth: str, drawn: str) -> NoReturn:
        """Say what differs."""
        raise Difference(self.vessel, what, truth, drawn, self.masks)


class _Counted:
    """Pixels counted so far, and the box around them."""

    def __init__(self) -> None:
        self.px, self.box = 0, np.array([np.inf, np.inf, -np.inf, -np.inf])

    def add(self, mask: Mask, region: Region) -> None:
        """Count the pixels of a mask (h, w) at a region."""
        rows, columns = mask.any(axis=1).nonzero()[0], mask.any(axis=0).nonzero()[0]
        if not len(rows):
            return
        self.px += int(np.count_nonzero(mask))
        low = columns[0] + region.x, rows[0] + region.y
        high = columns[-1] + 1 + region.x, rows[-1] + 1 + region.y
        self.box = np.concatenate([np.minimum(self.box[:2], low), np.maximum(self.box[2:], high)])


def _mask(spans: Spans, region: Region) -> Mask:
    """The pixels of spans in a region, shape (height, width)."""
    edges = np.zeros((region.height, region.width + 1), dtype=np.int64)
    inside = (spans.y >= region.y) & (spans.y < region.y + region.height)
    y = spans.y[inside] - region.y
    for ends, step in ((spans.start, 1), (spans.stop, -1)):
        np.add.at(edges, (y, np.clip(ends[inside] - region.x, 0, region.width)), step)
    mask: Mask = edges.cumsum(axis=1)[:, :-1] > 0
    return mask


def _in_words(box: Array) -> str:
    return "[" + ", ".join(f"{side:g}" for side in box.round(2)) + "]"
