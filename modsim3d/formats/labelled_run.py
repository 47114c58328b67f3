"""A run directory as a labelled set: its truth, its detections, and which vessel each detection came from."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from modsim3d.core.arrays import NOBODY, Indices, Mask, positions
from modsim3d.core.boxes import iou, unions
from modsim3d.core.paths import StrPath
from modsim3d.detector.records import FALSE_KINDS, KINDS, MERGED, ON_VESSEL
from modsim3d.formats.labelled import Annotations, Images, LabelledSet, Results
from modsim3d.formats.matching import image_pairs
from modsim3d.runs.files.tables import indices, number_column
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import StoredRun, opened_run


def labelled_run(run: StoredRun | StrPath, cameras: Sequence[int] | None = None) -> tuple[LabelledSet, StoredRun]:
    """Read a run as a labelled set, with an image for each frame and a condition for each performance state. Images are
    of the cameras with these indices; of all if None."""
    run = opened_run(run)
    rows, detector = RunRows.of(run), run.scene.detector
    count = len(run.scene.cameras)
    frames = rows.frames[np.lexsort((rows.frames // count, rows.frames % count))]  # in order of camera and step
    frames = frames[np.isin(frames % count, range(count) if cameras is None else cameras)]
    truth, states = _truth(rows, frames), tuple(state.name for state in detector.states)
    results, least = _results(rows, frames, truth), detector.operating_threshold or 0.0
    return LabelledSet(detector.labels, states, _images(rows, frames), truth, results, dropped_below=least), run


def _images(rows: RunRows, frames: Indices) -> Images:
    cameras = rows.scene.cameras
    step, camera = frames // len(cameras), frames % len(cameras)
    half_planes = np.empty((len(frames), 3))
    for index, scene_camera in enumerate(cameras):
        own_rows = np.flatnonzero(camera == index)  # in order of step
        half_planes[own_rows] = rows.scene.sea_half_planes(scene_camera, step[own_rows])
    sizes_px = np.array([camera.intrinsics.image_size_px for camera in cameras], dtype=np.float64)
    return Images(
        names=tuple(f"{cameras[c].name} {s}" for c, s in zip(camera.tolist(), step.tolist(), strict=True)),
        sizes_px=sizes_px[camera],
        condition=rows.states_of(frames),
        source=np.zeros(len(frames), dtype=np.int64),
        sequence=camera,
        time_s=np.asarray(rows.scene.times_s(0, rows.scene.steps))[step],
        half_planes=half_planes,
    )


def _truth(rows: RunRows, frames: Indices) -> Annotations:
    image, scene = positions(frames, rows.truth_frame), rows.scene
    annotated = np.flatnonzero(rows.annotated & (image >= 0))
    return Annotations(
        image=image[annotated],
        label=indices(rows.truth, "label", scene.detector.labels)[annotated],
        boxes_px=rows.boxes_px("visible" if scene.annotation.mode == 2 else "full")[annotated],
        ignored=np.zeros(len(annotated), dtype=bool),
        crowd=np.zeros(len(annotated), dtype=bool),
        identity=rows.truth_vessel[annotated],
        visible_fraction=rows.numbers("visible_fraction")[annotated],
        depth_m=rows.numbers("depth_m")[annotated],
    ).by_image()


def _results(rows: RunRows, frames: Indices, truth: Annotations) -> Results:
    """The detections of all images; a detection has the origin that it is the box of, a second box has none."""
    image, vessels = positions(frames, rows.detection_frame), len(rows.scene.vessels)
    kind = indices(rows.detections, "kind", KINDS)
    own = (~np.isin(kind, FALSE_KINDS) | (kind == ON_VESSEL)) & (rows.detection_vessel >= 0)
    kept = np.flatnonzero(image >= 0)
    results = Results(
        image=image[kept],
        label=indices(rows.detections, "label", rows.scene.detector.labels)[kept],
        boxes_px=rows.detection_boxes_px()[kept],
        confidence=number_column(rows.detections, "confidence")[kept],
        origin=positions(
            truth.image * vessels + truth.identity, np.where(own, image * vessels + rows.detection_vessel, NOBODY)[kept]
        ),
        kind=kind[kept],
    ).by_image()
    truth_image = positions(frames, rows.truth_frame)
    keys = (truth_image * vessels + rows.truth_vessel)[rows.detected & (truth_image >= 0)]
    partner = _partners(results, truth, np.isin(truth.image * vessels + truth.identity, keys))
    origin, on_vessel = results.origin, results.kind == ON_VESSEL
    assert origin is not None  # as given above
    partner[on_vessel] = origin[on_vessel]
    return replace(results, origin=np.where(on_vessel, NOBODY, origin), partner=partner)


def _partners(results: Results, truth: Annotations, detected: Mask) -> Indices:
    """Row of the smaller vessel of each merged box, else −1: (D,). Smaller ones are `detected` (T,) and have no box of
    their own. Tables do not say whose box each is in: the pair in the image whose common box fits best comes first."""
    partner, origin = np.full(len(results), NOBODY), results.origin
    merged = np.flatnonzero(results.kind == MERGED)
    if origin is None or not len(merged):
        return partner
    boxless = detected.copy()
    boxless[origin[origin >= 0]] = False
    rows = np.flatnonzero(boxless)
    first, second = (np.concatenate(parts) for parts in zip(*_same_image(results, merged, truth, rows), strict=True))
    both_px = unions(truth.boxes_px[origin[first]], truth.boxes_px[second])
    taken = set[int]()
    for place in np.argsort(-iou(results.boxes_px[first], both_px), kind="stable").tolist():
        box, vessel = int(first[place]), int(second[place])
        if partner[box] < 0 and vessel not in taken:
            partner[box] = vessel
            taken.add(vessel)
    return partner


def _same_image(
    results: Results, merged: Indices, truth: Annotations, rows: Indices
) -> Iterator[tuple[Indices, Indices]]:
    """Pairs of some detections and some annotations in the same image, as rows."""
    yield merged[:0], rows[:0]
    images = int(max(results.image.max(initial=0), truth.image.max(initial=0))) + 1
    for first, second in image_pairs(results.image[merged], truth.image[rows], images):
        yield merged[first], rows[second]
