"""The sources of truth side by side on a scene: the check that an auditor can run.

The rendered truth is compared with the analytic one and every difference is explained. The thesis's rectangle rule is
compared with the rendered truth.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.errors import ModsimError
from modsim3d.render.id_pass import IdRenderer
from modsim3d.scene.scene import Scene
from modsim3d.truth.analytic import analytic_occlusion
from modsim3d.truth.full_frame import full_frame_occlusion, pixel_masks
from modsim3d.truth.occlusion import Occlusion
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.rectangle_rule import rectangle_occlusion
from modsim3d.truth.rendered import rendered_occlusion
from modsim3d.verify.compare_figures import Figures, figures_of
from modsim3d.verify.compare_findings import Findings, RectangleRuleCheck, VesselDifference
from modsim3d.verify.comparison import EXPLANATIONS, Agreement, Comparison, compare_with_analytic
from modsim3d.verify.shoebox_fit import shoebox_fits
from modsim3d.vessels.vessel import shoebox
from modsim3d.view.pictures.comparison_picture import SourceBoxes

BLOCK_STEPS = 50
WORST = 10
"""Number of vessels that are shown because their differences are the largest."""
RULE_OFF_PX = 2.0
"""The rectangle rule's box is called wrong when a side is off by more."""


@dataclass(frozen=True, eq=False)
class SourceComparison:
    """What `modsim3d compare` found.

    Attributes:
        findings: What was found in all frames that were looked at.
        figures: What `compare.json` holds.
    """

    findings: Findings
    figures: Figures


def compare_sources(
    scene: Scene,
    renderer: IdRenderer,
    *,
    every: int = 1,
    progress: Callable[[int], None] = lambda steps: None,
) -> SourceComparison:
    """Compare rendered, analytic and rectangle truth on every camera of a scene.

    Args:
        scene: From `load_scene`.
        renderer: Draws the ID buffers.
        every: Look at every K-th frame of each camera.
        progress: Called with the number of steps done since its last call.

    Raises:
        ModsimError: The scene is live.
    """
    if scene.live:
        raise ModsimError(
            f"scene {scene.path}: compare needs a scene whose steps are known, and this one is live: run it, and "
            "compare a scene with poses: {file: poses.jsonl} of its run directory"
        )
    steps = np.arange(0, scene.steps, every)
    frames = [scene.frame_steps(camera, 0, scene.steps)[::every] for camera in scene.cameras]
    shoebox()  # loads what makes solids, which is no part of the time per frame
    parts = []
    for start in range(0, len(steps), BLOCK_STEPS):
        chosen = steps[start : start + BLOCK_STEPS]
        for camera, taken in enumerate(frames):
            some = taken[slice(*np.searchsorted(taken, (chosen[0], chosen[-1] + every)))]
            if len(some):
                parts.append(_compare_frames(scene, renderer, camera, some))
        progress(len(chosen))
    findings = Findings.total(parts, WORST)
    return SourceComparison(findings, figures_of(findings, scene.name, scene.annotation.supersample, len(steps)))


@dataclass(frozen=True, eq=False)
class _Sources:
    """What the three sources say about the same outlines, and the computing time of each."""

    rendered: Occlusion
    analytic: Occlusion
    rectangles: Occlusion
    seconds: dict[str, float]


def _compare_frames(scene: Scene, renderer: IdRenderer, camera: int, steps: Indices) -> Findings:
    """Compare the sources on the frames that a camera takes at some steps."""
    intrinsics, supersample = scene.cameras[camera].intrinsics, scene.annotation.supersample
    started = time.perf_counter()
    sight = scene.sight(scene.cameras[camera], steps)
    outlines = sight.outlines()
    sources = _computed(scene, renderer, camera, outlines, shared_s=time.perf_counter() - started)
    differences = compare_with_analytic(
        outlines,
        intrinsics,
        sources.rendered,
        lambda row: pixel_masks(outlines, intrinsics, renderer, row, supersample),
        supersample,
    )
    vessels = _Vessels.of(outlines, sources, camera, steps)
    fits = {}
    if not outlines.convex.all():
        shoeboxes = sight.outlines(as_shoeboxes=True)
        fits = shoebox_fits(scene.vessels, vessels.outlines, shoeboxes)
    names = scene.occluder_names
    pairs = outlines.occluder[sources.analytic.intersecting].tolist()
    return Findings(
        frames=len(steps),
        differences=differences,
        rule=_check_rule(vessels),
        intersecting=Counter(f"{names[first]} and {names[second]}" for first, second in pairs),
        shoebox_fits=fits,
        seconds=sources.seconds,
        worst=_worst(differences, vessels),
    )


def _computed(scene: Scene, renderer: IdRenderer, camera: int, outlines: Outlines, shared_s: float) -> _Sources:
    """Compute the truth of outlines from each source; the time for the outlines counts for each of them."""
    intrinsics, annotation = scene.cameras[camera].intrinsics, scene.annotation
    draw = full_frame_occlusion if annotation.render == "full" else rendered_occlusion
    seconds = {}

    def timed(source: str, compute: Callable[[], Occlusion]) -> Occlusion:
        started = time.perf_counter()
        occlusion = compute()
        seconds[source] = time.perf_counter() - started + shared_s
        return occlusion

    convex = np.flatnonzero(outlines.convex)  # the analytic source knows no others
    rendered = timed("rendered", lambda: draw(outlines, intrinsics, renderer, annotation.supersample))
    analytic = timed("analytic", lambda: analytic_occlusion(outlines.take(convex), intrinsics))
    rectangles = timed("rectangles", lambda: rectangle_occlusion(outlines))
    return _Sources(rendered, analytic.among(convex, len(outlines)), rectangles, seconds)


@dataclass(frozen=True, eq=False)
class _Vessels:
    """The vessels in a camera's frames, and what each source says about them."""

    camera: int
    steps: Indices
    outlines: Outlines
    rendered: Occlusion
    analytic: Occlusion
    rectangles: Occlusion

    @classmethod
    def of(cls, outlines: Outlines, sources: _Sources, camera: int, steps: Indices) -> _Vessels:
        rows = np.flatnonzero(outlines.boxed)
        seen = (occlusion.take(rows) for occlusion in (sources.rendered, sources.analytic, sources.rectangles))
        return cls(camera, steps, outlines.take(rows), *seen)

    def difference(self, row: int, badness: float, reason: str) -> VesselDifference:
        """A row with the boxes of all sources."""
        boxes = SourceBoxes(
            rendered_full=self.rendered.full_boxes_px[row].tolist(),
            rendered_visible=self.rendered.visible_boxes_px[row].tolist(),
            analytic_full=self.analytic.full_boxes_px[row].tolist(),
            analytic_visible=self.analytic.visible_boxes_px[row].tolist(),
            rectangles_visible=self.rectangles.visible_boxes_px[row].tolist(),
        )
        step, vessel = int(self.steps[self.outlines.frame[row]]), int(self.outlines.occluder[row])
        return VesselDifference(self.camera, step, vessel, badness, reason, boxes)


def _worst(differences: Comparison, vessels: _Vessels) -> tuple[VesselDifference, ...]:
    """The largest differences: unexplained ones first, those that the analytic source cannot tell last."""
    sides = np.abs(np.concatenate([differences.full_side_px, differences.visible_side_px], axis=1))
    size_px: Array = np.nan_to_num(sides).max(axis=1, initial=0.0) + np.where(differences.seen_differs, 1.0, 0.0)
    unknown = (differences.visible == Agreement.INTERSECTING) | (differences.worst == Agreement.NOT_COMPARABLE)
    size_px[unknown] *= 1e-3
    badness = size_px + 1e6 * (differences.worst == Agreement.UNEXPLAINED)
    reasons = [EXPLANATIONS[Agreement(reason)] for reason in differences.worst.tolist()]
    return tuple(
        vessels.difference(row, float(badness[row]), f"{reasons[row]}: {size_px[row]:.2f} px")
        for row in np.argsort(-badness)[:WORST].tolist()
    )


def _check_rule(vessels: _Vessels) -> RectangleRuleCheck:
    """Check the rectangle rule's visible boxes of occluded vessels against those from pixels."""
    rendered, rectangles = vessels.rendered, vessels.rectangles
    occluded = rendered.visible_px < rendered.silhouette_px
    visible, kept = rendered.visible_px > 0, rectangles.visible_px > 0
    off_px = np.nan_to_num(np.abs(rendered.visible_boxes_px - rectangles.visible_boxes_px)).max(axis=1, initial=0.0)
    off_px = np.where(visible & kept, off_px, 0.0)
    worst = None
    if occluded.any():
        row = int(np.argmax(np.where(occluded, off_px, -1.0)))
        worst = vessels.difference(row, float(off_px[row]), f"the rectangle rule is {off_px[row]:.0f} px off")
    return RectangleRuleCheck(
        occluded=int(occluded.sum()),
        off=int((occluded & (off_px > RULE_OFF_PX)).sum()),
        kept_hidden=int((occluded & ~visible & kept).sum()),
        dropped_visible=int((occluded & visible & ~kept).sum()),
        worst=worst,
    )
