"""The boxes of a labelled set that a detector is to find, and how much of each is visible."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.boxes import areas, clip, intersections, sizes
from modsim3d.core.errors import InputError
from modsim3d.formats.labelled import LabelledSet
from modsim3d.io.validation import shown
from modsim3d.truth.analytic import NOTHING_PX2, Hiding
from modsim3d.truth.occlusion_order import overlapping_pairs

# ---- How much of each box is visible, from the boxes alone ----


def visible_fractions(image: Indices, boxes_px: Array, feet_px: Array) -> Array:
    """Share of each box that no nearer box of its image covers, shape (n,).

    Args:
        image: Image of each box, non-decreasing, shape (n,).
        boxes_px: The boxes cut at the edge of the image, shape (n, 4).
        feet_px: Lower edge of each box before it was cut, shape (n,).
    """
    first, second = overlapping_pairs(image, boxes_px)
    below, above = feet_px[first] > feet_px[second], feet_px[first] < feet_px[second]
    hiding = Hiding.of(np.concatenate([second[below], first[above]]), np.concatenate([first[below], second[above]]))
    hidden_px = np.zeros(len(boxes_px))
    common_px = intersections(boxes_px[hiding.hidden], boxes_px[hiding.hiders])
    rows, starts, counts = np.unique(hiding.hidden, return_index=True, return_counts=True)
    hidden_px[rows] = common_px[starts]
    for row, start, count in zip(*(column[counts > 1].tolist() for column in (rows, starts, counts)), strict=True):
        nearer = boxes_px[hiding.hiders[start : start + count]]
        low, high = np.maximum(nearer[:, :2], boxes_px[row, :2]), np.minimum(nearer[:, 2:], boxes_px[row, 2:])
        hidden_px[row] = shapely.area(shapely.union_all(shapely.box(*low.T, *high.T)))
    whole_px = np.maximum(areas(boxes_px), 0)
    left_px = np.where(whole_px - hidden_px > NOTHING_PX2, whole_px - hidden_px, 0.0)
    fractions: Array = np.where(hidden_px > 0, left_px / np.where(whole_px > 0, whole_px, 1.0), 1.0)
    return fractions


MOST_BOXES = 2000
"""Of an image: pairs of them are compared."""
_HALF = 0.5


@dataclass(frozen=True, eq=False)
class TargetBoxes:
    """The boxes that are to be found, n rows in order of image and track.

    Attributes:
        image: Row of the images, non-decreasing, shape (n,).
        track: Index into the identities of the file, shape (n,).
        label: Index into the detector's labels, shape (n,).
        boxes_px: Cut at the edge of the image, shape (n, 4).
        visible_fraction: Shape (n,).
        depth_m: NaN where unknown, shape (n,).
        from_overlap: Whether the visible fraction comes from the overlap of boxes, not from the file, shape (n,).
        notes: What was left out, and where visible fractions come from.
    """

    image: Indices
    track: Indices
    label: Indices
    boxes_px: Array
    visible_fraction: Array
    depth_m: Array
    from_overlap: Mask
    notes: tuple[str, ...]

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.image)

    @property
    def visible(self) -> Mask:
        """Mask of the boxes with a visible part, which are given to the detector, shape (n,)."""
        mask: Mask = self.visible_fraction > 0
        return mask


def sought_in(labelled: LabelledSet, to_label: Indices, tracks: tuple[int | str, ...], source: str) -> TargetBoxes:
    """Targets of a detector in a labelled set.

    Args:
        labelled: The set.
        to_label: The detector's label of each of its labels, −1 for what is no target, shape (k,).
        tracks: Its identities; the rows of an image are ordered by their names.
        source: What messages call the file.

    Raises:
        InputError: A box that is to be found has no track, or an image has too many boxes.
    """
    rows = labelled.annotations
    _check_count(labelled, source)
    boxes_px = clip(rows.boxes_px, labelled.images.sizes_px[rows.image])
    inside = (sizes(boxes_px) > 0).all(axis=1)
    of_label = to_label[rows.label] >= 0
    wanted = ~rows.ignored & of_label
    solid = np.flatnonzero(inside & ~rows.crowd)
    found = np.flatnonzero(wanted & inside)
    _check_tracks(labelled, found, source)
    fractions, from_overlap, notes = _visible(
        rows.visible_fraction, rows.image, boxes_px, rows.boxes_px[:, 3], solid, found
    )
    left_out = {
        "not to be considered": rows.ignored,
        "of classes that are not to be detected": ~rows.ignored & ~of_label,
        "outside their image": wanted & ~inside,
    }
    said = [
        f"{int(mask.sum())} of {len(rows)} boxes are left out: {why}" for why, mask in left_out.items() if mask.any()
    ]
    names = np.argsort(np.argsort(np.array([str(track) for track in tracks], dtype=object), kind="stable"))
    order = found[np.lexsort((names[rows.identity[found]] if len(names) else found, rows.image[found]))]
    return TargetBoxes(
        rows.image[order],
        rows.identity[order],
        to_label[rows.label[order]],
        boxes_px[order],
        fractions[order],
        rows.depth_m[order],
        from_overlap[order],
        (*said, *notes),
    )


def _check_count(labelled: LabelledSet, source: str) -> None:
    counts = np.bincount(labelled.annotations.image, minlength=1)
    if (most := int(counts.max())) > MOST_BOXES:
        image = shown(labelled.images.names[int(counts.argmax())])
        raise InputError(source, [f"image {image} has {most:,} boxes, and at most {MOST_BOXES:,} can be compared"])


def _check_tracks(labelled: LabelledSet, found: Indices, source: str) -> None:
    rows = labelled.annotations
    without = found[rows.identity[found] < 0]
    if len(without):
        image = shown(labelled.images.names[rows.image[without[0]]])
        what = f"{len(without)} of {len(found)} boxes have no track, the first is in image {image}"
        raise InputError(source, [f"{what}: each needs a track_id in COCO, or an identity of 0 or more in MOT"])


def _visible(
    given: Array, image: Indices, boxes_px: Array, feet_px: Array, solid: Indices, found: Indices
) -> tuple[Array, Mask, list[str]]:
    """Visible fractions of all boxes, which of them come from overlap, shapes (n,), and remarks."""
    unknown = np.isnan(given)
    missing, constant = int(unknown[found].sum()), len(found) > 0 and bool((given[found] == 1).all())
    fractions = given.copy()
    if not missing and not constant:
        return fractions, unknown, []
    of_overlap = np.ones(len(given))
    of_overlap[solid] = visible_fractions(image[solid], boxes_px[solid], feet_px[solid])
    if missing:
        fractions[unknown] = of_overlap[unknown]
        nearer = "of overlapping boxes the one with the lower foot is nearer"
        return fractions, unknown, [f"visibility of {missing} of {len(found)} boxes comes from overlap: {nearer}"]
    hidden = int((of_overlap[found] < _HALF).sum())
    doubt = f"the file's visibility is 1 everywhere, but other boxes cover more than half of {hidden} boxes"
    remedy = "if it is not known, leave it out, and it comes from overlap"
    return fractions, unknown, [f"{doubt}: {remedy}"] if hidden else []
