"""The figures of a comparison of sources, with the names and in the order that `compare.json` has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.boxes import areas
from modsim3d.truth.crosscheck.comparison import Checked
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.record import SOURCES
from modsim3d.verify.sources.agreement import EXPLANATIONS, Agreement, Comparison, concatenate_comparisons
from modsim3d.view.pictures.comparison_picture import SourceBoxes
from modsim3d.world.vessels import Vessel


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
        wrong = self.off + self.kept_hidden + self.dropped_visible
        return wrong / self.occluded if self.occluded else 0.0


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
    drawn: Checked  # what OpenGL drew, and the rendered source was compared with
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
    """Vessel ID → fit, for each vessel with a mesh that is in an image. `meshes` are vessels with their own shapes,
    `shoeboxes` the same frames with every vessel as its shoebox. It contains the mesh, so no row is missing."""
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
    drawn: Checked  # as in `run.json`; see `Findings`
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
    known = ~np.isnan(differences)
    difference, bound = np.append(np.abs(differences[known]), 0.0), np.append(bounds[known], 0.0)
    return FractionFigures(
        max=float(difference.max()),
        p99=float(np.quantile(difference, 0.99)),
        above_bound=int((difference > bound).sum()),
        largest_share_of_bound=float(np.max(difference / np.where(bound > 0, bound, 1.0))),
    )
