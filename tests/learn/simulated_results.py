"""Results of a simulated detector over the annotations of a labelled set."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from modsim3d.core.arrays import NOBODY, Indices, run_starts
from modsim3d.detector.chain import Detector, target_statistics
from modsim3d.detector.model import DetectorModel, Performance
from modsim3d.detector.records import FALSE_KINDS, CameraFrames, Targets
from modsim3d.formats.labelled import EVERYWHERE, LabelledSet, Results


def simulated(labelled: LabelledSet, image_state: Indices, model: DetectorModel, seed: int) -> LabelledSet:
    """The set, whose images are one sequence of one size, with results in the states of its images, shape (I,)."""
    images, annotations = labelled.images, labelled.annotations
    ((_, width, height),) = np.unique(np.column_stack([images.sequence, images.sizes_px]), axis=0).astype(int).tolist()
    numbers, size = np.arange(len(images)), (width, height)
    times = images.time_s - images.time_s[0] if np.isfinite(images.time_s).all() else numbers.astype(np.float64)
    rows = np.flatnonzero(~annotations.ignored)
    rows = rows[np.argsort(annotations.image[rows], kind="stable")]
    frame, identity = annotations.image[rows], annotations.identity[rows]
    ordinal = np.arange(len(rows)) - np.searchsorted(frame, frame)
    names, vessel = np.unique(np.where(identity >= 0, identity, -1 - ordinal), return_inverse=True)
    half_planes = np.where(np.isnan(images.half_planes), EVERYWHERE, images.half_planes)
    frames = CameraFrames("sequence 0", numbers, times, size, half_planes)
    targets = Targets(
        frame=frame,
        vessel=vessel.ravel(),
        label=annotations.label[rows],
        boxes_px=np.clip(annotations.boxes_px[rows], 0, [*size, *size]),
        visible_fraction=annotations.visible_fraction[rows],
        depth_m=annotations.depth_m[rows],
        vessel_ids=tuple(map(str, names.tolist())),
    )
    schedule = tuple((float(times[k]), int(image_state[k])) for k in run_starts(image_state))
    held = replace(model, performance=Performance(True, schedule), transition_interval_s=None)
    census = target_statistics(model, [(frames, targets)])
    drawn = Detector(held, seed, census, lambda first, stop: times[first:stop]).detect(frames, targets)
    own = ~np.isin(drawn.kind, FALSE_KINDS) & (drawn.target >= 0)
    results = Results(
        image=drawn.frame,
        label=drawn.label,
        boxes_px=drawn.boxes_px,
        confidence=drawn.confidence,
        origin=np.where(own, np.append(rows, NOBODY)[drawn.target], NOBODY),
        kind=drawn.kind,
        partner=np.append(rows, NOBODY)[drawn.partner],
    )
    return replace(labelled, results=results.by_image())
