"""Results of a simulated detector over the annotations of a labelled set."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Indices, run_starts
from modsim3d.core.errors import ModsimError
from modsim3d.detector.chain import Detector, target_statistics
from modsim3d.detector.model import DetectorModel, Performance
from modsim3d.detector.records import FALSE_KINDS, ON_VESSEL, CameraFrames, Targets
from modsim3d.formats.labelled import EVERYWHERE, LabelledSet, Results


@dataclass(frozen=True, eq=False)
class SequencePart:
    """Images of one sequence and size, as the detector takes them: frames and targets. With the rows of the images
    (S,), of the annotations in them that count (n,), and the state in each frame (S,)."""

    images: Indices
    rows: Indices
    frames: CameraFrames
    targets: Targets
    states: Indices


def parts_of(labelled: LabelledSet, image_state: Indices) -> Iterator[SequencePart]:
    """Split all images that have a state, shape (I,), by sequence and size. Raises ModsimError if a size is unknown."""
    images, annotations = labelled.images, labelled.annotations
    used = np.flatnonzero(image_state >= 0)
    if not np.isfinite(images.sizes_px[used]).all():
        raise ModsimError("the detector cannot be simulated over images whose size is not known")
    keys = np.column_stack([images.sequence[used], images.sizes_px[used].astype(np.int64)])
    for number, key in enumerate(np.unique(keys, axis=0)):
        ours = used[(keys == key).all(axis=1)]
        timed = bool(np.isfinite(images.time_s[ours]).all())
        ours = ours[np.argsort(images.time_s[ours], kind="stable")] if timed else ours
        times = images.time_s[ours] if timed else np.arange(len(ours), dtype=np.float64)
        times = times - times[0]
        if len(times) > 1 and np.any(np.diff(times) <= 0):
            times = np.arange(len(ours), dtype=np.float64)
        place = np.full(len(images), NOBODY)
        place[ours] = np.arange(len(ours))
        rows = np.flatnonzero((place[annotations.image] >= 0) & ~annotations.ignored)
        rows = rows[np.argsort(place[annotations.image[rows]], kind="stable")]
        frame = place[annotations.image[rows]]
        ordinal = np.arange(len(rows)) - np.searchsorted(frame, frame)
        identity = annotations.identity[rows]
        known = identity >= 0
        names, vessel = np.unique(np.where(known, identity, -1 - ordinal), return_inverse=True)
        given = images.half_planes[ours]
        half_planes = np.where(np.isnan(given), EVERYWHERE, given)
        size = (int(key[1]), int(key[2]))
        yield SequencePart(
            ours,
            rows,
            CameraFrames(f"sequence {number}", np.arange(len(ours)), times, size, half_planes),
            Targets(
                frame=frame,
                vessel=vessel.ravel(),
                label=annotations.label[rows],
                boxes_px=np.clip(annotations.boxes_px[rows], 0, [*size, *size]),
                visible_fraction=annotations.visible_fraction[rows],
                depth_m=annotations.depth_m[rows],
                vessel_ids=tuple(f"{name}" for name in names.tolist()),
            ),
            image_state[ours],
        )


def simulated(labelled: LabelledSet, image_state: Indices, model: DetectorModel, seed: int) -> LabelledSet:
    """Labelled set with the results of a simulated detector, in states of images of shape (I,)."""
    parts = list(parts_of(labelled, image_state))
    statistics = target_statistics(model, ((part.frames, part.targets) for part in parts))
    columns: list[Results] = []
    for part in parts:
        times = part.frames.times_s
        changes = run_starts(part.states)
        schedule = tuple((float(times[k]), int(part.states[k])) for k in changes)
        held = replace(model, performance=Performance(True, schedule), transition_interval_s=None)

        def clock(first: int, stop: int, times: Array = times) -> Array:
            return times[first:stop]

        drawn = Detector(held, seed, statistics, clock).detect(part.frames, part.targets)
        own = ~np.isin(drawn.kind, FALSE_KINDS) & (drawn.target >= 0)
        columns.append(
            Results(
                image=part.images[drawn.frame],
                label=drawn.label,
                boxes_px=drawn.boxes_px,
                confidence=drawn.confidence,
                origin=np.where(own, np.append(part.rows, NOBODY)[drawn.target], NOBODY),
                kind=drawn.kind,
                partner=np.append(part.rows, NOBODY)[np.where(drawn.kind == ON_VESSEL, drawn.target, drawn.partner)],
            )
        )
    names = ("image", "label", "boxes_px", "confidence", "origin", "kind", "partner")
    whole = Results(**{name: np.concatenate([getattr(part, name) for part in columns]) for name in names})
    return replace(labelled, results=whole.by_image())
