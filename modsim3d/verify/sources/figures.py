"""The figures of a comparison of sources, with the names and in the order that `compare.json` has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.truth.crosscheck.comparison import Checked
from modsim3d.verify.sources.agreement import EXPLANATIONS, Agreement
from modsim3d.verify.sources.findings import Findings, RectangleRuleCheck, ShoeboxFit


@dataclass(frozen=True)
class BoxFigures:
    """Differences of full or of visible boxes.

    Attributes:
        side_max_px: The largest side difference of any box.
        side_p99_px: The 99th percentile of each box's largest side difference.
        verdicts: Explanation → number of vessel-frames.
    """

    side_max_px: float
    side_p99_px: float
    verdicts: dict[str, int]


@dataclass(frozen=True)
class FractionFigures:
    """Absolute differences of visible fractions.

    Attributes:
        p99: The 99th percentile.
        above_bound: Number of differences above what the pixels on the boundary can explain.
        largest_share_of_bound: The largest difference over what the boundary can explain.
    """

    max: float
    p99: float
    above_bound: int
    largest_share_of_bound: float


@dataclass(frozen=True)
class RuleFigures:
    """The rectangle rule against the rendered source, in vessel-frames; see `RectangleRuleCheck`."""

    occluded: int
    box_off_by_more_than_2_px: int
    hidden_vessel_kept: int
    visible_vessel_dropped: int
    wrong_share: float

    @classmethod
    def of(cls, rule: RectangleRuleCheck) -> RuleFigures:
        """The figures of a check."""
        return cls(rule.occluded, rule.off, rule.kept_hidden, rule.dropped_visible, rule.wrong_share)


@dataclass(frozen=True)
class ShoeboxFigures:
    """How much larger a shoebox's boxes are than a mesh's; see `ShoeboxFit`."""

    frames: int
    mean_area_ratio: float
    max_area_ratio: float
    max_side_px: float
    within_a_pixel: int

    @classmethod
    def of(cls, fit: ShoeboxFit) -> ShoeboxFigures:
        """The figures of a fit."""
        return cls(fit.frames, fit.ratio_sum / fit.frames, fit.ratio_max, fit.side_max_px, fit.within_a_pixel)


@dataclass(frozen=True)
class Figures:
    """Everything that `compare.json` holds.

    Attributes:
        format: Version of the file's layout.
        supersample: Buffer pixels per image pixel and axis of the rendered source.
        vessel_frames: Number of vessels in these frames.
        drawn: How much OpenGL drew, and the rendered source was compared with: as in `run.json`.
        differs_from_drawn: Vessel-frames of which the rendered source has other pixels, ties apart.
        missing: Vessels in frames that were drawn, but that the rendered source does not have.
        occluded: Vessel-frames with a hidden pixel.
        unexplained: Number of differences that nothing explains.
        visible_at_all_differs: Vessel-frames that are visible to one source only.
        pixels_looked_at: Vessel-frames of which every pixel was checked.
        intersecting: Pair of vessels or obstacles that intersect → number of frames.
        shoebox_against_mesh: ID of a vessel with a mesh → how well its shoebox fits.
        ms_per_frame: Source of truth → computing time per frame.
    """

    format: int
    scene: str
    supersample: int
    steps: int
    frames: int
    vessel_frames: int
    drawn: Checked
    differs_from_drawn: int
    missing: int
    occluded: int
    unexplained: int
    full_box: BoxFigures
    visible_box: BoxFigures
    visible_fraction: FractionFigures
    visible_at_all_differs: int
    pixels_looked_at: int
    intersecting: dict[str, int]
    rectangles_against_rendered: RuleFigures
    shoebox_against_mesh: dict[str, ShoeboxFigures]
    ms_per_frame: dict[str, float]


def figures_of(findings: Findings, scene: str, supersample: int, steps: int) -> Figures:
    """The figures of the findings in all frames of some steps."""
    differences, frames = findings.differences, max(findings.frames, 1)
    compared = differences.visible != Agreement.INTERSECTING
    return Figures(
        format=1,
        scene=scene,
        supersample=supersample,
        steps=steps,
        frames=findings.frames,
        vessel_frames=len(differences.full),
        drawn=findings.drawn,
        differs_from_drawn=findings.differing,
        missing=findings.missing,
        occluded=findings.rule.occluded,
        unexplained=findings.unexplained,
        full_box=_box_figures(differences.full_side_px, differences.full),
        visible_box=_box_figures(differences.visible_side_px, differences.visible),
        visible_fraction=_fraction_figures(differences.fraction, differences.fraction_bound),
        visible_at_all_differs=int((differences.seen_differs & compared).sum()),
        pixels_looked_at=int(differences.pixels_looked_at.sum()),
        intersecting=dict(findings.intersecting),
        rectangles_against_rendered=RuleFigures.of(findings.rule),
        shoebox_against_mesh={name: ShoeboxFigures.of(fit) for name, fit in sorted(findings.shoebox_fits.items())},
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
