"""One run into a run directory, and what happened in it, in numbers."""

from __future__ import annotations

import platform
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.block import Block
from modsim3d.detector.records import FALSE_POSITIVE
from modsim3d.formats.run_directory import LOG_FILE, RunDirectory
from modsim3d.frames import Array
from modsim3d.scene import Scene
from modsim3d.simulate import Simulation, block_ranges, open_renderer, truth_block

FORMAT = 1
VERSIONED = ("modsim3d", "numpy", "scipy", "shapely", "pyarrow", "orjson")


@dataclass
class Counts:
    """What happened in a run, summed over cameras and steps.

    Attributes:
        frames: Camera images.
        vessel_frames: Vessels whose silhouette was in an image.
        seen: Of those, with a visible pixel.
        partly_hidden: With fewer visible pixels than silhouette pixels, but some.
        fully_hidden: With silhouette pixels, none of them visible.
        annotated: Given to the detector.
        detected: Of those, detected, under whatever label.
        missed: Annotated and not detected.
        mislabelled: Detected under another label.
        false_positives: Detections of nothing.
        clipped: Detections of a vessel whose box was cut at the image edge.
        redrawn: Detections whose first box error left less than a pixel of the box.
        below_half_iou: Detections of a vessel whose box has IoU < 0.5 with the annotated one: a matching
            evaluation counts such a one as a miss and a false detection.
    """

    frames: int = 0
    vessel_frames: int = 0
    seen: int = 0
    partly_hidden: int = 0
    fully_hidden: int = 0
    annotated: int = 0
    detected: int = 0
    missed: int = 0
    mislabelled: int = 0
    false_positives: int = 0
    clipped: int = 0
    redrawn: int = 0
    below_half_iou: int = 0

    def add(self, block: Block, scene: Scene) -> None:
        """Count a block."""
        labels = np.array([scene.detector.labels.index(vessel.label) for vessel in scene.vessels])
        for part in block.cameras:
            truth, drawn = part.truth, part.detections
            self.frames += len(block.timestamps)
            self.vessel_frames += len(truth)
            self.seen += int((truth.visible_px > 0).sum())
            self.partly_hidden += int(((truth.visible_px > 0) & (truth.visible_px < truth.silhouette_px)).sum())
            self.fully_hidden += int(((truth.visible_px == 0) & (truth.silhouette_px > 0)).sum())
            true = np.flatnonzero(drawn.kind != FALSE_POSITIVE)
            rows = part.truth_row()[true]
            self.annotated += len(part.target_rows)
            self.detected += int(part.detected().sum())
            self.mislabelled += int((drawn.label[true] != labels[truth.vessel[rows]]).sum())
            self.false_positives += len(drawn) - len(true)
            self.redrawn += int(drawn.redrawn.sum())
            annotated = truth.visible_boxes_px if scene.annotation.mode == 2 else truth.full_boxes_px
            boxes = drawn.boxes_px[true]
            self.below_half_iou += int((_iou(boxes, annotated[rows]) < 0.5).sum())
            asked = annotated[rows, 2:] - annotated[rows, :2] + drawn.errors_px[true, 2:]
            self.clipped += int((boxes[:, 2:] - boxes[:, :2] < asked - 1e-6).any(axis=1).sum())
        self.missed = self.annotated - self.detected


def _iou(a: Array, b: Array) -> Array:
    """Intersection over union of boxes, row by row, shape (n,)."""
    overlap = np.clip(np.minimum(a[:, 2:], b[:, 2:]) - np.maximum(a[:, :2], b[:, :2]), 0, None).prod(axis=1)
    union = (a[:, 2:] - a[:, :2]).prod(axis=1) + (b[:, 2:] - b[:, :2]).prod(axis=1) - overlap
    ratio: Array = overlap / union
    return ratio


@dataclass(frozen=True)
class RunResult:
    """A finished run.

    Attributes:
        folder: The run directory.
        counts: What happened.
        seconds: Wall-clock time.
        resumed_steps: Steps whose truth was taken from an interrupted run.
    """

    folder: Path
    counts: Counts
    seconds: float
    resumed_steps: int


def run_scene(
    scene: Scene,
    folder: Path,
    *,
    overwrite: bool = False,
    resume: bool = False,
    progress: Callable[[int], None] = lambda steps: None,
) -> RunResult:
    """Run a scene and write its run directory.

    Args:
        scene: From `load_scene`.
        folder: The run directory.
        overwrite: Replace a run that is there.
        resume: Continue an interrupted run that is there.
        progress: Called with the number of steps done since its last call.

    Raises:
        ModsimError: The scene asks for what cannot be, or the folder cannot be used.
    """
    started = time.perf_counter()
    simulation, counts, resumed = Simulation(scene), Counts(), 0
    with open_renderer(scene) as renderer:
        backend = renderer.context.description if renderer else "none"
        settings = _settings(scene, backend)
        with RunDirectory(folder, scene, settings, overwrite=overwrite, resume=resume) as directory:
            for first, stop in block_ranges(scene.steps):
                truth = directory.finished_truth(first, stop)
                if truth is None:
                    truth = truth_block(scene, first, stop, renderer)
                    directory.keep_truth(truth, first, stop)
                else:
                    resumed += stop - first
                block = simulation.detect(truth, first, stop)
                directory.write(block)
                counts.add(block, scene)
                progress(stop - first)
            directory.finish({**settings, "counts": asdict(counts)})
    seconds = time.perf_counter() - started
    (folder / LOG_FILE).write_text(
        f"finished {time.strftime('%Y-%m-%dT%H:%M:%S%z')} on {platform.node()}\n"
        f"{counts.frames} frames in {seconds:.3f} s, {resumed} steps taken from an interrupted run\n"
    )
    return RunResult(folder, counts, seconds, resumed)


def _settings(scene: Scene, backend: str) -> dict[str, Any]:
    """Everything that decides the content of the files; no times and no host names."""
    return {
        "format": FORMAT,
        "scene": scene.name,
        "scene_sha256": scene.sha256,
        "seed": scene.seed,
        "steps": scene.steps,
        "annotation": asdict(scene.annotation),
        "cameras": [camera.name for camera in scene.cameras],
        "backend": backend,
        "versions": {name: version(name) for name in VERSIONED},
    }
