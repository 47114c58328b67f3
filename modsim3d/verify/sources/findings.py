"""What a comparison of the sources of truth finds. Findings in different frames add up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from modsim3d.arrays import Array
from modsim3d.boxes import areas
from modsim3d.truth.crosscheck.comparison import Checked
from modsim3d.truth.modes import SOURCES
from modsim3d.truth.outlines import Outlines
from modsim3d.verify.sources.agreement import Agreement, Comparison, concatenate_comparisons
from modsim3d.vessels.vessel import Vessel
from modsim3d.view.pictures.comparison_picture import SourceBoxes


@dataclass(frozen=True)
class VesselDifference:
    """A vessel in an image on which sources differ.

    Attributes:
        camera: Index into the scene's cameras.
        vessel: Index into the scene's vessels.
        badness: The greater it is, the more it deserves to be shown.
        boxes_px: Its boxes by each source.
    """

    camera: int
    step: int
    vessel: int
    badness: float
    reason: str
    boxes_px: SourceBoxes


@dataclass(frozen=True)
class RectangleRuleCheck:
    """How the idealised rectangle rule does on vessels that something hides.

    Attributes:
        occluded: Number of vessel-frames with a hidden pixel.
        off: Number of these that both sources see, with a side more than 2 px off.
        kept_hidden: Number of these that are wholly hidden, yet kept by the rule.
        dropped_visible: Number of these that are visible, yet dropped by the rule.
        worst: The box that is farthest off, of those on which the other sources agree if there is one; None if no
            vessel is occluded.
    """

    occluded: int = 0
    off: int = 0
    kept_hidden: int = 0
    dropped_visible: int = 0
    worst: VesselDifference | None = None

    def __add__(self, other: RectangleRuleCheck) -> RectangleRuleCheck:
        """The check of the vessel-frames of both."""
        worst = [difference for difference in (self.worst, other.worst) if difference is not None]
        return RectangleRuleCheck(
            self.occluded + other.occluded,
            self.off + other.off,
            self.kept_hidden + other.kept_hidden,
            self.dropped_visible + other.dropped_visible,
            max(worst, key=lambda difference: difference.badness, default=None),
        )

    @property
    def wrong_share(self) -> float:
        """Share of occluded vessel-frames that the rule gets wrong."""
        wrong = self.off + self.kept_hidden + self.dropped_visible
        return wrong / self.occluded if self.occluded else 0.0


@dataclass(frozen=True)
class ShoeboxFit:
    """One vessel's full boxes of mesh and shoebox, summed over frames. Fits of different frames add up.

    Attributes:
        frames: Number of frames in which the mesh is in the image.
        ratio_sum: Sum over frames of the area of the shoebox's box over the area of the mesh's box.
        ratio_max: The greatest of these ratios.
        side_max_px: The greatest distance by which a side of the shoebox's box is farther out.
        within_a_pixel: Number of frames in which no side is more than a pixel farther out.
    """

    frames: int
    ratio_sum: float
    ratio_max: float
    side_max_px: float
    within_a_pixel: int

    @classmethod
    def between(cls, mesh_boxes_px: Array, shoebox_boxes_px: Array) -> ShoeboxFit:
        """The fit over n frames, given the full boxes of mesh and shoebox in each, shapes (n, 4)."""
        ratio = areas(shoebox_boxes_px) / areas(mesh_boxes_px)
        out = ((shoebox_boxes_px - mesh_boxes_px) * (-1, -1, 1, 1)).max(axis=1)
        return cls(
            frames=len(ratio),
            ratio_sum=float(ratio.sum()),
            ratio_max=float(ratio.max(initial=0.0)),
            side_max_px=float(out.max(initial=0.0)),
            within_a_pixel=int((out <= 1).sum()),
        )

    def __add__(self, other: ShoeboxFit) -> ShoeboxFit:
        """The fit over the frames of both."""
        return ShoeboxFit(
            self.frames + other.frames,
            self.ratio_sum + other.ratio_sum,
            max(self.ratio_max, other.ratio_max),
            max(self.side_max_px, other.side_max_px),
            self.within_a_pixel + other.within_a_pixel,
        )


@dataclass(frozen=True, eq=False)
class Findings:
    """What was found in some frames.

    Attributes:
        drawn: How much OpenGL drew, and the rendered source was compared with.
        differing: Vessel-frames of which the rendered source has other pixels, ties apart.
        missing: Vessels in frames that were drawn, but that the rendered source does not have.
        differences: Rendered against analytic truth, a row for each vessel in a frame.
        rule: The rectangle rule against the rendered source.
        intersecting: Pair of vessels or obstacles that intersect, as "a and b" → number of frames.
        shoebox_fits: ID of a vessel with a mesh → how well its shoebox fits it.
        seconds: Source of truth → computing time.
        worst: The vessels with the largest differences between rendered and analytic truth, worst first.
    """

    frames: int
    drawn: Checked
    differing: int
    missing: int
    differences: Comparison
    rule: RectangleRuleCheck
    intersecting: Mapping[str, int]
    shoebox_fits: Mapping[str, ShoeboxFit]
    seconds: Mapping[str, float]
    worst: tuple[VesselDifference, ...]

    @classmethod
    def total(cls, parts: Sequence[Findings], most_shown: int) -> Findings:
        """The findings in the frames of all parts, with at most `most_shown` vessels in `worst`."""
        shown = [difference for part in parts for difference in part.worst]
        return cls(
            sum(part.frames for part in parts),
            sum((part.drawn for part in parts), Checked()),
            sum(part.differing for part in parts),
            sum(part.missing for part in parts),
            concatenate_comparisons([part.differences for part in parts]),
            sum((part.rule for part in parts), RectangleRuleCheck()),
            _summed([part.intersecting for part in parts]),
            _summed([part.shoebox_fits for part in parts]),
            _summed([dict.fromkeys(SOURCES, 0.0), *(part.seconds for part in parts)]),
            tuple(sorted(shown, key=lambda difference: -difference.badness)[:most_shown]),
        )

    @property
    def unexplained(self) -> int:
        """Number of differences that nothing explains, in full boxes or visible parts, and of missing vessels."""
        columns = self.differences.full, self.differences.visible
        return self.missing + sum(int((column == Agreement.UNEXPLAINED).sum()) for column in columns)


_Value = TypeVar("_Value", int, float, ShoeboxFit)


def _summed(parts: Sequence[Mapping[str, _Value]]) -> dict[str, _Value]:
    """The sum of the values of each key."""
    total: dict[str, _Value] = {}
    for part in parts:
        for key, value in part.items():
            total[key] = total[key] + value if key in total else value
    return total


def shoebox_fits(vessels: Sequence[Vessel], meshes: Outlines, shoeboxes: Outlines) -> dict[str, ShoeboxFit]:
    """Vessel ID → fit, for each vessel with a mesh that is in an image.

    Args:
        meshes: Rows of vessels with their own shapes.
        shoeboxes: The same frames with every vessel as its shoebox. It contains the mesh, so no row is missing.
    """
    keys = zip(shoeboxes.frame.tolist(), shoeboxes.occluder.tolist(), strict=True)
    place = {key: row for row, key in enumerate(keys)}
    fits = {}
    for part in meshes.parts:
        for vessel in np.unique(meshes.occluder[part.rows]).tolist():
            if vessels[vessel].has_mesh:
                rows = part.rows[meshes.occluder[part.rows] == vessel]
                same = [place[frame, vessel] for frame in meshes.frame[rows].tolist()]
                fits[vessels[vessel].name] = ShoeboxFit.between(meshes.boxes_px[rows], shoeboxes.boxes_px[same])
    return fits
