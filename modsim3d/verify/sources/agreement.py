"""Whether the rendered truth agrees with the analytic truth of the same outlines, and if it does not, why. The rendered
source counts pixels of exact spans, and of ID buffers with a depth test; the analytic one cuts polygons by polygons, in
an order that comes from separating planes. They may differ only because pixels sample regions at their centres. Where
they differ by more than a pixel, all pixels of the vessel are drawn again. One must be set where its centre is inside
the exact region, and nowhere else, except in a band along the boundary as wide as the rasteriser's rounding of corners.
The box and the count of the truth must be those of these pixels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import TypeVar

import numpy as np

from modsim3d.core.arrays import Array, Columns, Indices, Mask
from modsim3d.core.boxes import areas
from modsim3d.geometry.camera import Intrinsics
from modsim3d.truth import analytic as exact
from modsim3d.truth.analytic import (
    PixelMasks,
    VisibleRegions,
    boundary_pixels,
    counted_from,
    mask_fits,
    visible_regions,
)
from modsim3d.truth.crosscheck.comparison import CheckCounts
from modsim3d.truth.occlusion import Occlusion
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.record import SOURCES
from modsim3d.view.pictures.comparison_picture import SourceBoxes
from modsim3d.world.vessels import Vessel


class Agreement(IntEnum):
    """Whether two sources agree on a vessel, or why they do not. The greater, the worse."""

    AGREE = 0
    SHARP_TIP = 1
    SLIVER = 2
    BOUNDARY_ROUNDING = 3
    INTERSECTING = 4
    UNEXPLAINED = 5


EXPLANATIONS = {
    Agreement.AGREE: "agree within a pixel",
    Agreement.SHARP_TIP: "sharp tip without a pixel centre",
    Agreement.SLIVER: "sliver thinner than a pixel",
    Agreement.BOUNDARY_ROUNDING: "boundary rounding",
    Agreement.INTERSECTING: "left to pixels: no plane between two hulls",
    Agreement.UNEXPLAINED: "unexplained",
}

DrawMasks = Callable[[int], PixelMasks]  # draws the masks of a row of the outlines


@dataclass(frozen=True, eq=False)
class Comparison(Columns):
    """Differences of two sources on n outlines, rendered minus analytic."""

    full_side_px: Array  # sides of full boxes, shape (n, 4)
    visible_side_px: Array  # sides of visible boxes; NaN where either has none, shape (n, 4)
    fraction: Array  # visible fraction; NaN where either has none, shape (n,)
    fraction_bound: Array  # largest difference of fractions that pixels on the boundary can explain, shape (n,)
    seen_differs: Mask  # whether the vessel is visible to one source only, shape (n,)
    full: Indices  # `Agreement` of the full boxes, shape (n,)
    visible: Indices  # `Agreement` of visible boxes, visible fractions and visibility, shape (n,)
    pixels_looked_at: Mask  # whether all pixels of the row were checked, shape (n,)

    @property
    def worst(self) -> Indices:
        """The worse `Agreement` of full and visible, shape (n,)."""
        return np.maximum(self.full, self.visible)


def concatenate_comparisons(parts: Sequence[Comparison]) -> Comparison:
    """The rows of several comparisons, one after another."""
    empty, empty_sides, none = np.empty(0), np.empty((0, 4)), np.empty(0, dtype=np.int64)
    nothing = Comparison(empty_sides, empty_sides, empty, empty, none > 0, none, none, none > 0)
    return Comparison.join([nothing, *parts])


def compare_with_analytic(
    outlines: Outlines, intrinsics: Intrinsics, rendered: Occlusion, draw_masks: DrawMasks, supersample: int = 1
) -> Comparison:
    """Compare rendered with analytic truth, with a row for each vessel in the outlines. `rendered` has all rows of
    `outlines`, which both sources start from; `draw_masks` is called with rows where they differ by more than a pixel;
    `supersample` are buffer pixels per image pixel and axis."""
    regions = visible_regions(outlines, intrinsics)
    analytic = exact.occlusion_of_regions(outlines, regions)
    full_side = rendered.full_boxes_px - analytic.full_boxes_px
    visible_side = rendered.visible_boxes_px - analytic.visible_boxes_px
    fraction = rendered.visible_fraction() - analytic.visible_fraction()
    bound = fraction_bound(regions, analytic, supersample)
    seen_differs = (rendered.visible_px > 0) != (analytic.visible_px > 0)
    intersecting = np.zeros(len(outlines), dtype=bool)
    intersecting[analytic.intersecting.ravel()] = True
    explained_px = boundary_pixels(regions.silhouettes, supersample) / supersample**2
    full_off = _off(full_side, supersample) | (np.abs(rendered.silhouette_px - analytic.silhouette_px) > explained_px)
    visible_off = _off(visible_side, supersample) | seen_differs | (np.abs(fraction) > bound)
    full_off, visible_off = full_off & outlines.boxed, visible_off & ~intersecting & outlines.boxed
    full = np.zeros(len(outlines), dtype=np.int64)
    visible = np.where(intersecting, int(Agreement.INTERSECTING), 0)
    check = _PixelCheck(regions, rendered, analytic, supersample)
    for row in np.flatnonzero(full_off | visible_off).tolist():
        masks = draw_masks(row)
        if full_off[row]:
            full[row] = check.full(row, masks)
        if visible_off[row]:
            # A visible box that is short by what the full box is short by misses the silhouette's own tip.
            tip = np.array_equal(visible_side[row], full_side[row])
            visible[row] = check.visible(row, masks, Agreement.SHARP_TIP if tip else Agreement.SLIVER)
    looked_at = full_off | visible_off
    comparison = Comparison(full_side, visible_side, fraction, bound, seen_differs, full, visible, looked_at)
    return comparison.take(np.flatnonzero(outlines.boxed))


def _off(sides_px: Array, supersample: int) -> Mask:
    """Whether a side (n, 4) is off by more than a buffer pixel, shape (n,)."""
    return np.asarray(np.any(np.abs(sides_px) > 1 / supersample, axis=1))


@dataclass(frozen=True, eq=False)
class _PixelCheck:
    """Explains the differences of a row from its pixels."""

    regions: VisibleRegions
    rendered: Occlusion
    analytic: Occlusion
    supersample: int

    def full(self, row: int, masks: PixelMasks) -> Agreement:
        """Reason why the full boxes differ."""
        silhouettes = self.regions.silhouettes
        mask = masks.silhouette, masks.region
        fits = self._full_counted(row, masks) and mask_fits(*mask, silhouettes[row], silhouettes[:0], self.supersample)
        boxes = self.rendered.full_boxes_px[row], self.analytic.full_boxes_px[row]
        return _agreement(fits, *boxes, if_smaller=Agreement.SHARP_TIP)

    def visible(self, row: int, masks: PixelMasks, if_smaller: Agreement) -> Agreement:
        """Reason why the visible boxes or fractions differ."""
        silhouettes, box, px = self.regions.silhouettes, self.rendered.visible_boxes_px[row], self.rendered.visible_px
        covers = silhouettes[self.regions.hiding.hiders_of(row)]
        mask = masks.visible, masks.region
        counted = self._full_counted(row, masks) and counted_from(*mask, box, px[row], self.supersample)
        fits = counted and mask_fits(*mask, silhouettes[row], covers, self.supersample)
        return _agreement(fits, box, self.analytic.visible_boxes_px[row], if_smaller)

    def _full_counted(self, row: int, masks: PixelMasks) -> bool:
        box, px = self.rendered.full_boxes_px[row], self.rendered.silhouette_px[row]
        return counted_from(masks.silhouette, masks.region, box, px, self.supersample)


def _agreement(fits: bool, rendered_px: Array, analytic_px: Array, if_smaller: Agreement) -> Agreement:
    """Reason why boxes (4,) differ, given whether pixels fit the exact region; `if_smaller` if theirs lies inside."""
    if not fits:
        return Agreement.UNEXPLAINED
    nothing_drawn, nothing_exact = bool(np.isnan(rendered_px[0])), bool(np.isnan(analytic_px[0]))
    outside = np.concatenate([analytic_px[:2] - rendered_px[:2], rendered_px[2:] - analytic_px[2:]])
    larger = (nothing_exact and not nothing_drawn) or bool(np.any(outside > 1))
    return Agreement.BOUNDARY_ROUNDING if larger else if_smaller


def fraction_bound(regions: VisibleRegions, analytic: Occlusion, supersample: int) -> Array:
    """The greatest difference of visible fractions that boundary pixels can explain, shape (n,). A region of area A is
    counted as N pixels, and |N − A| is less than the number B of pixels on its boundary. With areas S of the silhouette
    and V of its visible part, the fraction from pixels therefore lies between (V − B_V) / (S + B_S) and (V + B_V) /
    (S − B_S)."""
    scale = supersample**2
    whole, seen = analytic.silhouette_px * scale, analytic.visible_px * scale
    edge, seen_edge = (boundary_pixels(r, supersample) for r in (regions.silhouettes, regions.visible))
    fraction = analytic.visible_fraction()
    least = np.maximum(seen - seen_edge, 0) / (whole + edge)
    greatest = np.where(whole > edge, (seen + seen_edge) / np.maximum(whole - edge, 1e-9), 1.0)
    return np.maximum(fraction - least, np.minimum(greatest, 1.0) - fraction)


# ---- The figures of a comparison, with the names and in the order that `compare.json` has ----


@dataclass(frozen=True)
class VesselDifference:
    """A vessel in an image on which sources differ."""

    camera: int  # index into the scene's cameras
    step: int
    vessel: int  # index into the scene's vessels
    badness: float  # the greater it is, the more it deserves to be shown
    reason: str
    boxes_px: SourceBoxes  # its boxes by each source


@dataclass(frozen=True)
class RectangleRuleCheck:
    """Numbers of vessel-frames with a hidden pixel, and of those that the idealised rectangle rule gets wrong."""

    occluded: int = 0  # all of them
    off: int = 0  # that both sources see, with a side more than 2 px off
    kept_hidden: int = 0  # that are wholly hidden, yet kept by the rule
    dropped_visible: int = 0  # that are visible, yet dropped by the rule
    worst: VesselDifference | None = None  # the box farthest off, of those that the other sources agree on if any

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
        return (self.off + self.kept_hidden + self.dropped_visible) / self.occluded if self.occluded else 0.0


@dataclass(frozen=True)
class ShoeboxFit:
    """One vessel's full boxes of mesh and shoebox, summed over frames. Fits of different frames add up."""

    frames: int  # in which the mesh is in the image
    ratio_sum: float  # over frames, of the area of the shoebox's box over the area of the mesh's box
    ratio_max: float  # the greatest of these ratios
    side_max_px: float  # the greatest distance by which a side of the shoebox's box is farther out
    within_a_pixel: int  # frames in which no side is more than a pixel farther out

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
    """Findings in some frames."""

    frames: int
    drawn: CheckCounts  # what OpenGL drew, and the rendered source was compared with
    differing: int  # vessel-frames of which the rendered source has other pixels, ties apart
    missing: int  # vessels in frames that were drawn, but that the rendered source does not have
    differences: Comparison  # rendered against analytic truth, a row for each vessel in a frame
    rule: RectangleRuleCheck  # against the rendered source
    intersecting: Mapping[str, int]  # pair of vessels or obstacles that intersect, as "a and b" → number of frames
    shoebox_fits: Mapping[str, ShoeboxFit]  # by ID of a vessel with a mesh
    seconds: Mapping[str, float]  # source of truth → computing time
    worst: tuple[VesselDifference, ...]  # the largest differences between rendered and analytic truth, worst first

    @classmethod
    def total(cls, parts: Sequence[Findings], most_shown: int) -> Findings:
        """The findings in the frames of all parts, with at most `most_shown` vessels in `worst`."""
        shown = [difference for part in parts for difference in part.worst]
        return cls(
            sum(part.frames for part in parts),
            sum((part.drawn for part in parts), CheckCounts()),
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
    total: dict[str, _Value] = {}
    for part in parts:
        for key, value in part.items():
            total[key] = total[key] + value if key in total else value
    return total


def shoebox_fits(vessels: Sequence[Vessel], meshes: Outlines, shoeboxes: Outlines) -> dict[str, ShoeboxFit]:
    """Vessel ID → fit, for each vessel with a mesh in an image. `shoeboxes` are the same frames with every vessel as
    its shoebox, which contains the mesh, so no row is missing."""
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


@dataclass(frozen=True)
class BoxFigures:
    """Differences of full or of visible boxes."""

    side_max_px: float  # the largest side difference of any box
    side_p99_px: float  # the 99th percentile of each box's largest side difference
    verdicts: dict[str, int]  # explanation → number of vessel-frames


@dataclass(frozen=True)
class FractionFigures:
    """Absolute differences of visible fractions."""

    max: float
    p99: float  # the 99th percentile
    above_bound: int  # differences above what the pixels on the boundary can explain
    largest_share_of_bound: float  # the largest difference over what the boundary can explain


@dataclass(frozen=True)
class RuleFigures:
    """The rectangle rule against the rendered source, in vessel-frames; see `RectangleRuleCheck`."""

    occluded: int
    box_off_by_more_than_2_px: int
    hidden_vessel_kept: int
    visible_vessel_dropped: int
    wrong_share: float


@dataclass(frozen=True)
class ShoeboxFigures:
    """Sizes of a shoebox's boxes over a mesh's; see `ShoeboxFit`."""

    frames: int
    mean_area_ratio: float
    max_area_ratio: float
    max_side_px: float
    within_a_pixel: int


@dataclass(frozen=True)
class ComparisonFigures:
    """Everything that `compare.json` holds."""

    format: int  # version of the file's layout
    scene: str
    supersample: int  # buffer pixels per image pixel and axis of the rendered source
    steps: int
    frames: int
    vessel_frames: int  # vessels in these frames
    drawn: CheckCounts  # as in `run.json`; see `Findings`
    differs_from_drawn: int  # see `Findings.differing`
    missing: int  # see `Findings`
    occluded: int  # vessel-frames with a hidden pixel
    unexplained: int  # differences that nothing explains
    full_box: BoxFigures
    visible_box: BoxFigures
    visible_fraction: FractionFigures
    visible_at_all_differs: int  # vessel-frames that are visible to one source only
    pixels_looked_at: int  # vessel-frames of which every pixel was checked
    intersecting: dict[str, int]  # pair of vessels or obstacles that intersect → number of frames
    rectangles_against_rendered: RuleFigures
    shoebox_against_mesh: dict[str, ShoeboxFigures]  # by ID of a vessel with a mesh
    ms_per_frame: dict[str, float]  # source of truth → computing time


def figures_of(findings: Findings, scene: str, supersample: int, steps: int) -> ComparisonFigures:
    """The figures of the findings in all frames of some steps."""
    differences, frames, rule = findings.differences, max(findings.frames, 1), findings.rule
    compared = differences.visible != Agreement.INTERSECTING
    shoeboxes = {
        name: ShoeboxFigures(fit.frames, fit.ratio_sum / fit.frames, fit.ratio_max, fit.side_max_px, fit.within_a_pixel)
        for name, fit in sorted(findings.shoebox_fits.items())
    }
    return ComparisonFigures(
        format=1,
        scene=scene,
        supersample=supersample,
        steps=steps,
        frames=findings.frames,
        vessel_frames=len(differences.full),
        drawn=findings.drawn,
        differs_from_drawn=findings.differing,
        missing=findings.missing,
        occluded=rule.occluded,
        unexplained=findings.unexplained,
        full_box=_box_figures(differences.full_side_px, differences.full),
        visible_box=_box_figures(differences.visible_side_px, differences.visible),
        visible_fraction=_fraction_figures(differences.fraction, differences.fraction_bound),
        visible_at_all_differs=int((differences.seen_differs & compared).sum()),
        pixels_looked_at=int(differences.pixels_looked_at.sum()),
        intersecting=dict(findings.intersecting),
        rectangles_against_rendered=RuleFigures(
            rule.occluded, rule.off, rule.kept_hidden, rule.dropped_visible, rule.wrong_share
        ),
        shoebox_against_mesh=shoeboxes,
        ms_per_frame={source: 1e3 * seconds / frames for source, seconds in findings.seconds.items()},
    )


def _box_figures(sides_px: Array, agreement: Indices) -> BoxFigures:
    """Figures of side differences (n, 4), of which a row is NaN if a source has no box, and `Agreement`s (n,)."""
    largest = np.abs(sides_px[~np.isnan(sides_px).any(axis=1)]).max(axis=1, initial=0.0)
    largest = np.append(largest, 0.0)
    verdicts = {explanation: int((agreement == reason).sum()) for reason, explanation in EXPLANATIONS.items()}
    return BoxFigures(float(largest.max()), float(np.quantile(largest, 0.99)), verdicts)


def _fraction_figures(differences: Array, bounds: Array) -> FractionFigures:
    """Figures of fraction differences (n,), NaN if a source has none, and what the boundary can explain (n,)."""
    finite = ~np.isnan(differences)
    difference, bound = np.append(np.abs(differences[finite]), 0.0), np.append(bounds[finite], 0.0)
    return FractionFigures(
        max=float(difference.max()),
        p99=float(np.quantile(difference, 0.99)),
        above_bound=int((difference > bound).sum()),
        largest_share_of_bound=float(np.max(difference / np.where(bound > 0, bound, 1.0))),
    )
