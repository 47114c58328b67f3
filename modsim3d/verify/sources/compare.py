"""Compares the sources of truth on a scene: the check that an auditor can run. OpenGL draws every frame, with a
projection and an order of its own, and the rendered source must have the same pixels. Every difference between these
and the analytic truth is explained. The idealised rectangle rule is held against the rendered truth."""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.errors import ModsimError
from modsim3d.render.id_pass import IdRenderer, Region
from modsim3d.scene.scene import Scene
from modsim3d.truth.analytic import PixelMasks, analytic_occlusion, rectangle_occlusion
from modsim3d.truth.crosscheck.comparison import CheckCounts, Difference, FrameValues, check_frame, mask_of
from modsim3d.truth.crosscheck.drawing import Drawing
from modsim3d.truth.full_frame import full_frame_occlusion
from modsim3d.truth.occlusion import Occlusion
from modsim3d.truth.outlines import Outlines
from modsim3d.truth.rendered import rendered_occlusion, rendered_spans, spans_of_frame
from modsim3d.truth.silhouettes import Spans
from modsim3d.verify.sources import agreement
from modsim3d.verify.sources.agreement import Agreement, Comparison, Findings, VesselDifference, figures_of
from modsim3d.view.pictures.comparison_picture import SourceBoxes
from modsim3d.world.vessels import shoebox


@dataclass(frozen=True, eq=False)
class FastPath:
    """Result of the fast path of the rendered source for outlines."""

    outlines: Outlines  # the vessels and obstacles in F frames
    occlusion: Occlusion  # their counts, boxes and occluders
    spans: tuple[Spans, Spans]  # their pixels: of whole silhouettes, and of what is visible

    def masks(self, row: int, drawings: Sequence[Drawing]) -> PixelMasks:
        """The pixels of a row, in a buffer like that of the drawings of the F frames."""
        like = drawings[0]
        region = Region.around(self.outlines.boxes_px[row] * like.supersample, like.size_px)
        silhouette, visible = (mask_of(spans.take(spans.row == row), region) for spans in self.spans)
        return PixelMasks(region, silhouette, visible)

    def compare(
        self, drawings: Sequence[Drawing], boxed: Mask, names: Sequence[str], renderer: IdRenderer
    ) -> tuple[CheckCounts, dict[int, str], int]:
        """Draw the F frames, and compare: how much was drawn; row → how it differs; and the number of vessels that were
        drawn and have no row. `drawings` has one of each frame; `boxed` says which of the scene's V vessels get a box
        if they are in the image, shape (F, V); `names` are those of the scene's occluders."""
        truth = self.occlusion.truth(self.outlines, np.arange(len(drawings)), camera=0)
        checked = CheckCounts(from_spans=int((~truth.drawn).sum()), from_buffers=int(truth.drawn.sum()))
        words: dict[int, str] = {}  # row → how it differs
        missing = 0
        for frame, drawing in enumerate(drawings):
            silhouettes, visible = (spans_of_frame(spans, self.outlines, frame) for spans in self.spans)
            claims = FrameValues(truth.take(truth.step == frame), silhouettes, visible, areas={})
            vessels = set(np.flatnonzero(boxed[frame]).tolist())
            while True:  # until all vessels that differ are left out
                try:
                    checked += check_frame(drawing, renderer, claims, vessels, names)
                    break
                except Difference as clash:
                    own = claims.truth.vessel == clash.vessel
                    claims, vessels = replace(claims, truth=claims.truth.take(~own)), vessels - {clash.vessel}
                    missing += not own.any()
                    row = (
                        self.outlines.boxed & (self.outlines.frame == frame) & (self.outlines.occluder == clash.vessel)
                    )
                    text = f"{clash.what}: {clash.truth} in the truth, {clash.drawn} drawn"
                    words |= dict.fromkeys(np.flatnonzero(row).tolist(), text)
        return checked, words, missing


BLOCK_STEPS = 50
WORST = 10  # number of vessels, those with the largest differences, that the report shows
RULE_OFF_PX = 2.0  # the rectangle rule's box counts as wrong where a side is off by more
AGREED_PX, AGREED_FIRST = 1.0, 1e6
"""A mistake of the rule where no side of the other two boxes differs by more is shown rather than a larger one."""


@dataclass(frozen=True, eq=False)
class SourceComparison:
    """Result of `modsim3d check truth` over all frames that it looked at, and the figures of `compare.json`."""

    findings: Findings
    figures: agreement.ComparisonFigures


def compare_sources(
    scene: Scene, renderer: IdRenderer, *, every: int = 1, progress: Callable[[int], None] = lambda steps: None
) -> SourceComparison:
    """Compare rendered, drawn, analytic and rectangle truth on every K-th frame of each camera of a scene, K being
    `every`. `progress` is called with the number of steps since its last call. Raises ModsimError for a live scene."""
    if scene.live:
        raise ModsimError(
            f"{scene.title}: check truth needs a scene whose steps are known, and this one is live: run it, and "
            "compare a scene with poses: {file: poses.jsonl} of its run directory"
        )
    steps = np.arange(0, scene.steps, every)
    frames = [scene.frame_steps(camera, 0, scene.steps)[::every] for camera in scene.cameras]
    shoebox()  # loads the library that makes solids, so that the time per frame does not include it
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


def _compare_frames(scene: Scene, renderer: IdRenderer, camera: int, steps: Indices) -> Findings:
    """Compare the sources on the frames that a camera takes at some steps."""
    intrinsics, supersample = scene.cameras[camera].intrinsics, scene.annotation.supersample
    full = scene.annotation.render == "full"
    started = time.perf_counter()
    sight = scene.sight(scene.cameras[camera], steps)
    outlines = sight.outlines()
    sources, seconds = _occlusions(scene, renderer, camera, outlines, shared_s=time.perf_counter() - started)
    spans = rendered_spans(outlines, intrinsics, renderer, supersample, full=full)
    fast = FastPath(outlines, sources["rendered"], spans)
    drawings = [sight.drawing(row, supersample) for row in range(len(steps))]
    checked, differing, missing = fast.compare(drawings, sight.others, scene.occluder_names, renderer)
    masks_of = partial(fast.masks, drawings=drawings)
    differences = agreement.compare_with_analytic(outlines, intrinsics, sources["rendered"], masks_of, supersample)
    boxed = np.flatnonzero(outlines.boxed)
    words = {int(boxed.searchsorted(row)): text for row, text in differing.items()}
    differences.visible[list(words)] = Agreement.UNEXPLAINED
    seen = {source: occlusion.take(boxed) for source, occlusion in sources.items()}
    vessels = _Vessels(camera, steps, outlines.take(boxed), seen)
    fits = {}
    if not outlines.convex.all():
        fits = agreement.shoebox_fits(scene.vessels, vessels.outlines, sight.outlines(as_shoeboxes=True))
    names, pairs = scene.occluder_names, outlines.occluder[sources["analytic"].intersecting].tolist()
    return Findings(
        frames=len(steps),
        drawn=checked,
        differing=len(words),
        missing=missing,
        differences=differences,
        rule=_check_rule(vessels),
        intersecting=Counter(f"{names[first]} and {names[second]}" for first, second in pairs),
        shoebox_fits=fits,
        seconds=seconds,
        worst=_worst(differences, vessels, words),
    )


def _occlusions(
    scene: Scene, renderer: IdRenderer, camera: int, outlines: Outlines, shared_s: float
) -> tuple[dict[str, Occlusion], dict[str, float]]:
    """Occlusion of outlines by each source, and its computing time with that of the outlines, `shared_s`."""
    intrinsics, annotation = scene.cameras[camera].intrinsics, scene.annotation
    draw = full_frame_occlusion if annotation.render == "full" else rendered_occlusion
    compute = {
        "rendered": lambda: draw(outlines, intrinsics, renderer, annotation.supersample),
        "analytic": lambda: analytic_occlusion(outlines, intrinsics),
        "rectangles": lambda: rectangle_occlusion(outlines),
    }
    occlusions, seconds = {}, {}
    for source in compute:
        started = time.perf_counter()
        occlusions[source] = compute[source]()
        seconds[source] = time.perf_counter() - started + shared_s
    return occlusions, seconds


@dataclass(frozen=True, eq=False)
class _Vessels:
    """The vessels in a camera's frames, and what each source says about them."""

    camera: int
    steps: Indices
    outlines: Outlines
    sources: dict[str, Occlusion]

    def difference(self, row: int, badness: float, reason: str) -> VesselDifference:
        """A row with the boxes of all sources."""
        boxes = SourceBoxes(
            rendered_full=self.sources["rendered"].full_boxes_px[row].tolist(),
            rendered_visible=self.sources["rendered"].visible_boxes_px[row].tolist(),
            analytic_full=self.sources["analytic"].full_boxes_px[row].tolist(),
            analytic_visible=self.sources["analytic"].visible_boxes_px[row].tolist(),
            rectangles_visible=self.sources["rectangles"].visible_boxes_px[row].tolist(),
        )
        step, vessel = int(self.steps[self.outlines.frame[row]]), int(self.outlines.occluder[row])
        return VesselDifference(self.camera, step, vessel, badness, reason, boxes)


def _worst(differences: Comparison, vessels: _Vessels, words: dict[int, str]) -> tuple[VesselDifference, ...]:
    """The largest differences, unexplained ones first, those left to pixels last. `words` say how drawn rows differ."""
    sides = np.abs(np.concatenate([differences.full_side_px, differences.visible_side_px], axis=1))
    size_px: Array = np.nan_to_num(sides).max(axis=1, initial=0.0) + np.where(differences.seen_differs, 1.0, 0.0)
    size_px[differences.visible == Agreement.INTERSECTING] *= 1e-3
    badness = size_px + 1e6 * (differences.worst == Agreement.UNEXPLAINED)
    reasons = [agreement.EXPLANATIONS[Agreement(reason)] for reason in differences.worst.tolist()]
    return tuple(
        vessels.difference(row, float(badness[row]), f"{reasons[row]}: {words.get(row, f'{size_px[row]:.2f} px')}")
        for row in np.argsort(-badness)[:WORST].tolist()
    )


def _check_rule(vessels: _Vessels) -> agreement.RectangleRuleCheck:
    """Check the rectangle rule's visible boxes of occluded vessels against those from pixels."""
    rendered, rectangles = vessels.sources["rendered"], vessels.sources["rectangles"]
    occluded = rendered.visible_px < rendered.silhouette_px
    visible, kept = rendered.visible_px > 0, rectangles.visible_px > 0
    off_px = np.nan_to_num(np.abs(rendered.visible_boxes_px - rectangles.visible_boxes_px)).max(axis=1, initial=0.0)
    off_px = np.where(visible & kept, off_px, 0.0)
    worst = None
    if occluded.any():
        # Where the other sources agree, a picture shows the rule's mistake alone.
        between = np.abs(rendered.visible_boxes_px - vessels.sources["analytic"].visible_boxes_px)
        agreed = (between <= AGREED_PX).all(axis=1)
        badness = np.where(occluded, off_px + AGREED_FIRST * (agreed & (off_px > RULE_OFF_PX)), -1.0)
        row = int(np.argmax(badness))
        worst = vessels.difference(row, float(badness[row]), f"the rectangle rule is {off_px[row]:.0f} px off")
    return agreement.RectangleRuleCheck(
        occluded=int(occluded.sum()),
        off=int((occluded & (off_px > RULE_OFF_PX)).sum()),
        kept_hidden=int((occluded & ~visible & kept).sum()),
        dropped_visible=int((occluded & visible & ~kept).sum()),
        worst=worst,
    )
