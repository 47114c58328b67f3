"""Labelled sets made from random numbers."""

import numpy as np

from modsim3d.formats.labelled import Annotations, Images, LabelledSet, Results


def random_boxes(rng, count, extent=400.0):
    corner, side = rng.uniform(0, extent, (count, 2)), rng.uniform(20, 120, (count, 2))
    return np.concatenate([corner, corner + side], axis=1)


def images(count, size_px=(600.0, 600.0), time_s=None, half_planes=None):
    zeros = np.zeros(count, dtype=np.int64)
    names = tuple(f"image{k}" for k in range(count))
    times = np.full(count, np.nan) if time_s is None else time_s
    seas = np.full((count, 3), np.nan) if half_planes is None else half_planes
    return Images(names, np.tile(size_px, (count, 1)), zeros, zeros, zeros, times, seas)


def rows_of(image, label, boxes_px):
    columns = (np.asarray(each, dtype=np.int64) for each in (image, label))
    return *columns, np.asarray(boxes_px, dtype=float).reshape(-1, 4)


def truth(image, label, boxes_px, ignored=None, crowd=None, identity=None, visible=None):
    nothing, unknown = np.zeros(len(image), dtype=bool), np.full(len(image), np.nan)
    flags = [nothing if each is None else np.asarray(each, dtype=bool) for each in (ignored, crowd)]
    tracks = np.full(len(image), -1) if identity is None else np.asarray(identity, dtype=np.int64)
    fractions = unknown if visible is None else visible
    return Annotations(*rows_of(image, label, boxes_px), *flags, tracks, fractions, unknown)


def found(image, label, boxes_px, confidence, probabilities=None, origin=None):
    return Results(*rows_of(image, label, boxes_px), np.asarray(confidence, dtype=float), probabilities, origin)


def random_set(seed, image_count=12, labels=3, crowds=True, ties=False):
    """Crowded images, with regions that are ignored, images without truth and images without detections."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(0, 6 * image_count))
    image = np.sort(rng.integers(0, image_count, count))
    boxes, label = random_boxes(rng, count, 250), rng.integers(0, labels, count)
    crowd = rng.random(count) < (0.08 if crowds else 0)
    ignored = crowd | (rng.random(count) < (0.08 if crowds else 0))
    kept = np.repeat(rng.random(count) < 0.8, rng.integers(1, 3, count))
    source = np.repeat(np.arange(count), np.diff(np.append(np.flatnonzero(np.ones(count)), count)))[: len(kept)]
    source = source[rng.random(len(source)) < 0.9]
    moved = boxes[source] + rng.normal(0, 8, (len(source), 4))
    moved[:, 2:] = np.maximum(moved[:, 2:], moved[:, :2] + 4)
    extra = int(rng.integers(0, 2 * image_count))
    confidence = rng.random(len(source) + extra)
    seen_as = np.where(rng.random(len(source)) < 0.8, label[source], rng.integers(0, labels, len(source)))
    whole = found(
        np.concatenate([image[source], rng.integers(0, image_count, extra)]),
        np.concatenate([seen_as, rng.integers(0, labels, extra)]),
        np.concatenate([moved, random_boxes(rng, extra, 250)]),
        np.round(confidence, 1) if ties else confidence,
    )
    names = tuple("abcdefgh"[:labels])
    detections = whole.by_image()
    return LabelledSet(names, ("all",), images(image_count), truth(image, label, boxes, ignored, crowd), detections)
