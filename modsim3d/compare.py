"""The sources of truth side by side on a scene: the check that an auditor can run.

The rendered truth is compared with the analytic one, every difference is given its reason, and the thesis's rectangle
rule is held against the pixels.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from modsim3d.annotate.analytic import analytic_occlusion
from modsim3d.annotate.comparison import EXPLANATIONS, Agreement, Comparison, compare_with_analytic
from modsim3d.annotate.full_frame import full_frame_occlusion, pixel_masks
from modsim3d.annotate.modes import SOURCES
from modsim3d.annotate.occlusion import Occlusion
from modsim3d.annotate.outlines import Outlines
from modsim3d.annotate.rectangle_rule import rectangle_occlusion
from modsim3d.annotate.rendered import rendered_occlusion
from modsim3d.annotate.shoebox_fit import Looseness, add_looseness
from modsim3d.arrays import Array, Indices
from modsim3d.camera import Camera
from modsim3d.errors import ModsimError
from modsim3d.render.id_pass import IdRenderer
from modsim3d.scene import Scene
from modsim3d.vessels import shoebox

BLOCK_STEPS = 50
WORST = 10
RULE_OFF_PX = 2.0
"""The rectangle rule's box is called wrong when a side is off by more."""


@dataclass(frozen=True)
class Case:
    """A vessel at a step that is worth a picture.

    Attributes:
        camera: Index into the scene's cameras.
        step: Of the scene.
        vessel: Index into the scene's vessels.
        badness: What cases are ranked by.
        reason: Why it is shown.
        boxes_px: Name of a box → x_min, y_min, x_max, y_max.
    """

    camera: int
    step: int
    vessel: int
    badness: float
    reason: str
    boxes_px: dict[str, list[float]]


@dataclass
class RectangleRule:
    """How the thesis's rectangle rule does on vessels that something hides.

    Attributes:
        occluded: Vessel-frames with a hidden pixel.
        off: Of those, seen by both, with a side more than 2 px off.
        kept_hidden: Wholly hidden, yet kept by the rule.
        dropped_visible: Visible, yet dropped by the rule.
        worst: The largest mistake.
    """

    occluded: int = 0
    off: int = 0
    kept_hidden: int = 0
    dropped_visible: int = 0
    worst: Case | None = None

    @property
    def wrong_share(self) -> float:
        """Share of occluded vessel-frames that the rule gets wrong."""
        wrong = self.off + self.kept_hidden + self.dropped_visible
        return wrong / self.occluded if self.occluded else 0.0


@dataclass
class Report:
    """What `modsim3d compare` found.

    Attributes:
        scene: Its name.
        supersample: Of the rendered source.
        steps: Steps that were looked at.
        frames: Camera images.
        vessel_frames: Vessels in them.
        occluded: Of those, with a hidden pixel.
        full: Agreement on full boxes → vessel-frames.
        visible: Agreement on visible boxes, fractions and visibility → vessel-frames.
        full_side_px: Largest side difference of each full box.
        visible_side_px: The same of visible boxes.
        fraction: Absolute differences of visible fractions.
        fraction_bound: What the boundary of each can explain.
        seen_differs: Vessel-frames that one source sees and the other does not.
        pixels_looked_at: Vessel-frames of which every pixel was checked.
        intersecting: Pairs of vessels whose boxes intersect → frames.
        rule: The rectangle rule against the rendered source.
        looseness: Vessel with a mesh → how much looser its shoebox is.
        seconds: Source → time spent.
        worst: The worst differences.
    """

    scene: str
    supersample: int
    steps: int = 0
    frames: int = 0
    vessel_frames: int = 0
    occluded: int = 0
    full: dict[Agreement, int] = field(default_factory=lambda: dict.fromkeys(Agreement, 0))
    visible: dict[Agreement, int] = field(default_factory=lambda: dict.fromkeys(Agreement, 0))
    full_side_px: list[Array] = field(default_factory=list)
    visible_side_px: list[Array] = field(default_factory=list)
    fraction: list[Array] = field(default_factory=list)
    fraction_bound: list[Array] = field(default_factory=list)
    seen_differs: int = 0
    pixels_looked_at: int = 0
    intersecting: dict[str, int] = field(default_factory=dict)
    rule: RectangleRule = field(default_factory=RectangleRule)
    looseness: dict[str, Looseness] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=lambda: dict.fromkeys(SOURCES, 0.0))
    worst: list[Case] = field(default_factory=list)

    @property
    def unexplained(self) -> int:
        """Vessel-frames with a difference that nothing explains, in full or visible boxes."""
        return self.full[Agreement.UNEXPLAINED] + self.visible[Agreement.UNEXPLAINED]

    def figures(self) -> dict[str, Any]:
        """Everything but the pictures, as plain values for `compare.json`."""
        full, visible = np.concatenate([[0.0], *self.full_side_px]), np.concatenate([[0.0], *self.visible_side_px])
        fraction, bound = np.concatenate([[0.0], *self.fraction]), np.concatenate([[0.0], *self.fraction_bound])
        frames = max(self.frames, 1)
        return {
            "format": 1,
            "scene": self.scene,
            "supersample": self.supersample,
            "steps": self.steps,
            "frames": self.frames,
            "vessel_frames": self.vessel_frames,
            "occluded": self.occluded,
            "unexplained": self.unexplained,
            "full_box": {**_spread(full), "verdicts": _named(self.full)},
            "visible_box": {**_spread(visible), "verdicts": _named(self.visible)},
            "visible_fraction": {
                "max": float(fraction.max()),
                "p99": float(np.quantile(fraction, 0.99)),
                "above_bound": int((fraction > bound).sum()),
                "largest_share_of_bound": float(np.max(fraction / np.where(bound > 0, bound, 1.0))),
            },
            "visible_at_all_differs": self.seen_differs,
            "pixels_looked_at": self.pixels_looked_at,
            "intersecting": self.intersecting,
            "rectangles_against_rendered": {
                "occluded": self.rule.occluded,
                "box_off_by_more_than_2_px": self.rule.off,
                "hidden_vessel_kept": self.rule.kept_hidden,
                "visible_vessel_dropped": self.rule.dropped_visible,
                "wrong_share": self.rule.wrong_share,
            },
            "shoebox_against_mesh": {name: loose.figures() for name, loose in sorted(self.looseness.items())},
            "ms_per_frame": {source: 1e3 * seconds / frames for source, seconds in self.seconds.items()},
        }


def _spread(sides: Array) -> dict[str, float]:
    return {"side_max_px": float(sides.max()), "side_p99_px": float(np.quantile(sides, 0.99))}


def _named(verdicts: dict[Agreement, int]) -> dict[str, int]:
    return {EXPLANATIONS[verdict]: count for verdict, count in verdicts.items()}


def compare_sources(
    scene: Scene,
    renderer: IdRenderer,
    *,
    every: int = 1,
    progress: Callable[[int], None] = lambda steps: None,
) -> Report:
    """Compare rendered, analytic and rectangle truth on every camera of a scene.

    Args:
        scene: From `load_scene`.
        renderer: Draws the ID buffers.
        every: Look at every K-th frame of each camera.
        progress: Called with the number of steps done since its last call.
    """
    if scene.live:
        raise ModsimError(
            f"scene {scene.path}: compare looks at a scene that is known, and a stream's steps are not: run it, and "
            "compare a scene with poses: {file: poses.jsonl} of its run directory"
        )
    report = Report(scene.name, scene.annotation.supersample)
    steps = np.arange(0, scene.steps, every)
    frames = [scene.frame_steps(camera, 0, scene.steps)[::every] for camera in scene.cameras]
    shoebox()  # loads what makes solids, which is no part of the time per frame
    for start in range(0, len(steps), BLOCK_STEPS):
        chosen = steps[start : start + BLOCK_STEPS]
        for index, camera in enumerate(scene.cameras):
            low, high = np.searchsorted(frames[index], (chosen[0], chosen[-1] + every))
            if low < high:
                _compare_camera(report, scene, renderer, index, camera, frames[index][low:high])
        report.steps += len(chosen)
        report.worst = sorted(report.worst, key=lambda case: -case.badness)[:WORST]
        progress(len(chosen))
    return report


def _compare_camera(
    report: Report,
    scene: Scene,
    renderer: IdRenderer,
    index: int,
    camera: Camera,
    steps: Indices,
) -> None:
    started = time.perf_counter()
    sight = scene.sight(camera, steps)
    everything = sight.outlines(camera.intrinsics, scene.vessels)
    shared = time.perf_counter() - started
    scale = scene.annotation.supersample
    draw = full_frame_occlusion if scene.annotation.render == "full" else rendered_occlusion
    known, boxed = np.flatnonzero(everything.convex), np.flatnonzero(everything.boxed)
    sources: dict[str, Callable[[], Occlusion]] = {
        "rendered": lambda: draw(everything, camera.intrinsics, renderer, scale),
        "analytic": lambda: analytic_occlusion(everything.take(known), camera.intrinsics),
        "rectangles": lambda: rectangle_occlusion(everything),
    }
    seen = {}
    for name, source in sources.items():
        started = time.perf_counter()
        seen[name] = source()
        report.seconds[name] += time.perf_counter() - started + shared
    for first, second in everything.occluder[known][seen["analytic"].intersecting]:
        pair = f"{scene.occluder_names[first]} and {scene.occluder_names[second]}"
        report.intersecting[pair] = report.intersecting.get(pair, 0) + 1
    found = compare_with_analytic(
        everything,
        camera.intrinsics,
        seen["rendered"],
        lambda row: pixel_masks(everything, camera.intrinsics, renderer, row, scale),
        scale,
    )
    seen["analytic"] = seen["analytic"].among(known, len(everything))
    seen = {name: occlusion.take(boxed) for name, occlusion in seen.items()}
    outlines = everything.take(boxed)
    report.frames += len(steps)
    report.vessel_frames += len(outlines)
    report.occluded += int((seen["rendered"].visible_px < seen["rendered"].silhouette_px).sum())
    _add_differences(report, found)
    place = _Place(index, steps, outlines, seen)
    _add_worst(report, found, place)
    _add_rule(report.rule, place)
    if len(known) < len(everything):
        shoeboxes = sight.outlines(camera.intrinsics, scene.vessels, as_shoeboxes=True)
        add_looseness(report.looseness, scene.vessels, outlines, shoeboxes)


def _add_differences(report: Report, found: Comparison) -> None:
    for verdict in Agreement:
        report.full[verdict] += int((found.full == verdict).sum())
        report.visible[verdict] += int((found.visible == verdict).sum())
    for kept, sides in (
        (report.full_side_px, np.abs(found.full_side_px)),
        (report.visible_side_px, np.abs(found.visible_side_px)),
    ):
        kept.append(sides[~np.isnan(sides).any(axis=1)].max(axis=1, initial=0.0))
    told = ~np.isnan(found.fraction)
    report.fraction.append(np.abs(found.fraction[told]))
    report.fraction_bound.append(found.fraction_bound[told])
    report.seen_differs += int((found.seen_differs & (found.visible != Agreement.INTERSECTING)).sum())
    report.pixels_looked_at += int(found.pixels_looked_at.sum())


@dataclass(frozen=True)
class _Place:
    """Where the rows of a comparison are, and what each source said of them."""

    camera: int
    steps: Indices
    outlines: Outlines
    seen: dict[str, Occlusion]

    def case(self, row: int, badness: float, reason: str) -> Case:
        boxes = {
            f"{source} {kind}": getattr(self.seen[source], f"{kind}_boxes_px")[row].tolist()
            for source in ("rendered", "analytic", "rectangles")
            for kind in ("full", "visible")
        }
        step = int(self.steps[self.outlines.frame[row]])
        return Case(self.camera, step, int(self.outlines.occluder[row]), badness, reason, boxes)


def _add_worst(report: Report, found: Comparison, place: _Place) -> None:
    """Unexplained differences come first, then the largest; what the analytic source cannot tell comes last."""
    sides = np.abs(np.concatenate([found.full_side_px, found.visible_side_px], axis=1))
    size = np.nan_to_num(sides).max(axis=1, initial=0.0) + np.where(found.seen_differs, 1.0, 0.0)
    size[(found.visible == Agreement.INTERSECTING) | (found.worst == Agreement.NOT_COMPARABLE)] *= 1e-3
    badness = size + 1e6 * (found.worst == Agreement.UNEXPLAINED)
    for row in np.argsort(-badness)[:WORST]:
        reason = EXPLANATIONS[Agreement(int(found.worst[row]))]
        report.worst.append(place.case(int(row), float(badness[row]), f"{reason}: {size[row]:.2f} px"))


def _add_rule(rule: RectangleRule, place: _Place) -> None:
    rendered, rectangles = place.seen["rendered"], place.seen["rectangles"]
    occluded = rendered.visible_px < rendered.silhouette_px
    drawn, kept = rendered.visible_px > 0, rectangles.visible_px > 0
    off = np.abs(rendered.visible_boxes_px - rectangles.visible_boxes_px)
    off = np.where(drawn & kept, np.nan_to_num(off).max(axis=1, initial=0.0), 0.0)
    rule.occluded += int(occluded.sum())
    rule.off += int((occluded & (off > RULE_OFF_PX)).sum())
    rule.kept_hidden += int((occluded & ~drawn & kept).sum())
    rule.dropped_visible += int((occluded & drawn & ~kept).sum())
    if occluded.any():
        row = int(np.argmax(np.where(occluded, off, -1.0)))
        if rule.worst is None or off[row] > rule.worst.badness:
            rule.worst = place.case(row, float(off[row]), f"the rectangle rule is {off[row]:.0f} px off")
