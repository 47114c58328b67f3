"""The edges of matched boxes, and what each says about the error of the box.

An edge that the detector put on the image's border, where the true edge lies inside the image, is censored: without the
border it would lie at the border or beyond it. An edge of which the truth is cut by the border is left out, because
many detectors put such an edge exactly on the border. All other edges are known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.formats.matching import Rule

CUT_PX = 2.0
"""A true edge so close to the border counts as cut by it."""
_ON_BORDER_PX = 0.5
OUTWARD = np.array([[-1, 0, 0.5, 0], [0, -1, 0, 0.5], [1, 0, 0.5, 0], [0, 1, 0, 0.5]])
"""How far each edge lies outside the true one, from e_x, e_y, e_w, e_h."""
ERRORS = np.linalg.inv(OUTWARD)
"""e_x, e_y, e_w, e_h from how far each edge lies outside the true one."""


@dataclass(frozen=True, eq=False)
class MatchedEdges:
    """Edges of n matched boxes in the order x_min, y_min, x_max, y_max.

    Attributes:
        truth_px: The true box, shape (n, 4).
        outward_px: How far each detected edge lies outside the true one, of a censored edge at least, shape (n, 4).
        known: Which edges are known, shape (n, 4).
        censored: Which edges are censored; those that are neither are left out, shape (n, 4).
        least_px: Least x and y of each image, −∞ where boxes are not clipped, shape (n, 2).
        most_px: Greatest x and y, shape (n, 2).
        rule: The rule by which the boxes match.
        image: Image of each, shape (n,).
    """

    truth_px: Array
    outward_px: Array
    known: Mask
    censored: Mask
    least_px: Array
    most_px: Array
    rule: Rule
    image: Indices

    @classmethod
    def of(cls, truth_px: Array, found_px: Array, image_px: Array, image: Indices, rule: Rule) -> MatchedEdges:
        """Edges of detected boxes (n, 4) and their true ones, in images of a size (n, 2), NaN where unknown."""
        size = np.where(np.isnan(image_px), np.inf, image_px)
        inward = np.concatenate([truth_px[:, :2], size - truth_px[:, 2:]], axis=1)
        inward[np.isnan(image_px[:, 0])] = np.inf
        outward = np.concatenate([truth_px[:, :2] - found_px[:, :2], found_px[:, 2:] - truth_px[:, 2:]], axis=1)
        clips = not np.any(outward - inward > _ON_BORDER_PX)  # some detectors put boxes partly outside the image
        cut = inward <= CUT_PX
        censored = ~cut & (outward >= inward - _ON_BORDER_PX) & clips
        limited = np.isfinite(image_px) & clips
        return cls(
            truth_px,
            np.where(censored, inward - _ON_BORDER_PX, outward),
            ~cut & ~censored,
            censored,
            np.where(limited, 0.0, -np.inf),
            np.where(limited, size, np.inf),
            rule,
            image,
        )

    def __len__(self) -> int:
        """Number of boxes."""
        return len(self.truth_px)

    def __getitem__(self, rows: Indices | Mask) -> MatchedEdges:
        """Some of the boxes."""
        return MatchedEdges(
            self.truth_px[rows],
            self.outward_px[rows],
            self.known[rows],
            self.censored[rows],
            self.least_px[rows],
            self.most_px[rows],
            self.rule,
            self.image[rows],
        )

    def without(self, boxes: Mask) -> MatchedEdges:
        """The same, with all edges of some boxes (n,) left out."""
        kept = ~boxes[:, None]
        return replace(self, known=self.known & kept, censored=self.censored & kept)

    def as_measured(self) -> MatchedEdges:
        """All boxes with every edge known as it was measured, and nothing cut off by the rule."""
        every, none = np.ones_like(self.known), np.full_like(self.least_px, np.inf)
        return replace(self, known=every, censored=~every, least_px=-none, most_px=none, rule=Rule("provenance"))

    @cached_property
    def sides_px(self) -> Array:
        """Width, height, width, height of the true box, at least a pixel, shape (n, 4)."""
        return np.tile(np.maximum(self.truth_px[:, 2:] - self.truth_px[:, :2], 1.0), 2)

    @cached_property
    def usable(self) -> Mask:
        """Which boxes say anything: at least a pixel wide and high, with an edge inside the image, shape (n,)."""
        large = np.all(self.truth_px[:, 2:] - self.truth_px[:, :2] >= 1, axis=1)
        usable: Mask = large & self.counted.any(axis=1)
        return usable

    @cached_property
    def counted(self) -> Mask:
        """Which edges are not left out, shape (n, 4)."""
        return self.known | self.censored

    @cached_property
    def whole(self) -> Mask:
        """Which boxes have no edge that is left out, shape (n,)."""
        result: Mask = self.usable & self.counted.all(axis=1)
        return result

    @cached_property
    def alike(self) -> tuple[tuple[Indices, MatchedEdges], ...]:
        """Boxes with the same edges known and censored together, with their rows."""
        pattern = (self.known + 2 * self.censored) @ 3 ** np.arange(4)
        groups = [np.flatnonzero(pattern == each) for each in np.unique(pattern)]
        return tuple((rows, self[rows]) for rows in groups)

    @cached_property
    def errors_px(self) -> Array:
        """e_x, e_y, e_w, e_h as measured, shape (n, 4)."""
        errors: Array = self.outward_px @ ERRORS.T
        return errors

    @cached_property
    def inward_px(self) -> Array:
        """How far the border lies outside each true edge, infinite where nothing is clipped, shape (n, 4)."""
        return np.concatenate([self.truth_px[:, :2] - self.least_px, self.most_px - self.truth_px[:, 2:]], axis=1)

    def passes(self, outward_px: Array) -> Mask:
        """Whether boxes with edges so far outside the true ones, shape (n, p, 4), would match, shape (n, p).

        Boxes are clipped to the image. Those that keep less than a pixel of width or height do not count.
        """
        # Seen from the true box's corner, so that numbers stay small: 0 to side is the true box.
        inward, sides = self.inward_px[..., None], self.sides_px[..., None]
        shifts: list[Array] = []
        common = found = own = np.ones((len(self), 1))
        passes: Mask = np.ones(outward_px.shape[:2], dtype=bool)
        for k in range(2):  # axis by axis, which is faster than sums and products over an axis of length 2
            side = sides[:, k]
            low = -np.minimum(outward_px[..., k], inward[:, k])
            high = side + np.minimum(outward_px[..., k + 2], inward[:, k + 2])
            # What lies beyond the opposite border is clipped away as well.
            low = np.minimum(low, side + inward[:, k + 2])
            high = np.maximum(high, -inward[:, k])
            passes &= high - low >= 1 - 1e-9
            if self.rule.method == "centre":
                shifts.append((low + high - side) / 2)
            elif self.rule.method != "provenance":
                common = common * np.maximum(np.minimum(high, side) - np.maximum(low, 0), 0)
                found, own = found * np.maximum(high - low, 0), own * side
        if self.rule.method == "provenance":
            return passes
        if self.rule.method == "centre":
            passes &= np.hypot(*shifts) <= self.rule.most_distance_px
            return passes
        passes &= common >= min(self.rule.least_iou, 1 - 1e-10) * (found + own - common)
        return passes

    def surely_passes(self, most_px: Array) -> Mask:
        """Whether boxes match however their edges lie, if each is at most so far off, (n, 4), either way; shape (n,).

        Clipping to the image only brings edges nearer to the true ones.
        """
        inside = (self.inward_px >= 0).all(axis=1)
        side, off = self.sides_px[:, :2], most_px[:, :2] + most_px[:, 2:]
        sure: Mask = inside & np.all(side - off >= 1, axis=1)
        if self.rule.method == "centre":
            sure &= np.hypot(*(off.T / 2)) <= self.rule.most_distance_px
        elif self.rule.method != "provenance":
            least = min(self.rule.least_iou, 1 - 1e-10)
            sure &= np.prod(side - off, axis=1) >= least * np.prod(side + off, axis=1)
        return sure
