"""Which reader a pair of files, or a file of truth alone, is for."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from modsim3d.boxes import centre_form, sizes
from modsim3d.errors import InputError
from modsim3d.formats.horizon import with_horizon
from modsim3d.formats.labelled import NOBODY, LabelledSet
from modsim3d.formats.reading.builder import NO_OPTIONS, ReadOptions
from modsim3d.formats.reading.coco import read_coco
from modsim3d.formats.reading.mot import read_mot
from modsim3d.formats.reading.yolo import read_yolo
from modsim3d.paths import StrPath, as_path
from modsim3d.tracks.files.box_forms import CENTRE, MOT, TOP_LEFT
from modsim3d.tracks.files.diagnosis import BoxRows, KnownBoxes, misreading


def read_pair(condition: str, truth: StrPath, detections: StrPath, options: ReadOptions = NO_OPTIONS) -> LabelledSet:
    """Read one condition: folders are YOLO's, `.txt` and `.csv` are MOT's, anything else is COCO's.

    Raises:
        InputError: The files are wrong, or of two kinds.
    """
    truth, detections = as_path(truth, "truth"), as_path(detections, "detections")
    missing = [(what, path) for what, path in (("truth", truth), ("detections", detections)) if not path.exists()]
    if missing:
        raise InputError(f"condition {condition}", [f"{what} {path}: no such file or folder" for what, path in missing])
    kinds = [_kind(path) for path in (truth, detections)]
    if kinds[0] != kinds[1]:
        raise InputError(
            f"condition {condition}", [f"{truth} looks like {kinds[0]} and {detections} like {kinds[1]}: give one kind"]
        )
    read = {"COCO": read_coco, "MOT": read_mot, "YOLO": read_yolo}[kinds[0]]
    labelled = read(condition, truth, detections, options)
    if problem := misreading(*_compared(labelled, kinds[0])):
        if not problem.slight:
            raise InputError(f"detections {detections}", [problem.told])
        note = f"{condition}: {problem.told}, or the detector has such a bias, which is learned"
        labelled = replace(labelled, notes=(*labelled.notes, note))
    return with_horizon(labelled, options.horizon)


def _compared(labelled: LabelledSet, kind: str) -> tuple[BoxRows, KnownBoxes]:
    """The most confident detections, as many as there are annotations, in the form of their file; and the annotations.

    The size of images that do not say it is taken to be as far as annotations reach.
    """
    images, results, sought = labelled.images, labelled.results, ~labelled.annotations.ignored
    annotated_px = labelled.annotations.boxes_px[sought]
    rows = np.sort(np.argsort(-results.confidence, kind="stable")[: len(annotated_px)])
    image, boxes_px, last = results.image[rows], results.boxes_px[rows], len(images) - 1
    form = {"COCO": TOP_LEFT, "MOT": MOT, "YOLO": CENTRE}[kind]
    numbers = centre_form(boxes_px) if form is CENTRE else np.hstack([boxes_px[:, :2] + form.first_px, sizes(boxes_px)])
    reach_px = annotated_px[:, 2:].max(axis=0, initial=1.0)
    image_px = np.where(np.isnan(images.sizes_px), reach_px, images.sizes_px)[image]
    beside = (np.clip(image + step, 0, last) for step in (-1, 1))
    near = (np.where((to != image) & (images.sequence[to] == images.sequence[image]), to, NOBODY) for to in beside)
    known = KnownBoxes("an annotation", labelled.annotations.image[sought], annotated_px)
    return BoxRows(numbers, form, image_px, image, *near), known


def read_truth(truth: StrPath, options: ReadOptions = NO_OPTIONS) -> tuple[LabelledSet, str]:
    """Read the truth of a labelled video without any detections, and say of which kind it is: `MOT` or `COCO`.

    Raises:
        InputError: The file is wrong, or it is a folder, as YOLO's are.
    """
    path = as_path(truth, "truth")
    if not path.exists():
        raise InputError(f"truth {path}", ["no such file"])
    kind = _kind(path)
    if kind == "YOLO":
        raise InputError(f"truth {path}", ["is a folder: a file with tracks is needed, MOT gt.txt or COCO JSON"])
    return {"COCO": read_coco, "MOT": read_mot}[kind](path.stem, path, None, options), kind


def _kind(path: Path) -> str:
    return "YOLO" if path.is_dir() else "MOT" if path.suffix in (".txt", ".csv") else "COCO"
