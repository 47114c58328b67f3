"""Voyages with known answers: known boats, kayaks without a transponder, and false positives that flicker."""

from dataclasses import dataclass

import numpy as np

from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Rule, match
from modsim3d.learn.matches import Outcomes
from tests.formats.labelled_files import found, images, truth

WIDTH_PX, HEIGHT_PX, HORIZON_PX = 1200.0, 700.0, 200.0
RATE_HZ, FOUND = 2.0, 0.9
IOU = Rule()
SEA = [0.0, 1.0, -HORIZON_PX]


@dataclass(frozen=True)
class Flicker:
    """False positives: how many an image, which share stays, and for how long; or none in an empty share."""

    per_image: float = 0.3
    share: float = 0.4
    lifetime_s: float = 3.0


def boxes_at(x, y, size):
    return np.column_stack([x - size / 2, y - size / 3, x + size / 2, y + size / 3])


def voyage(seed, frames=600, boats=4, kayaks=1, flicker=Flicker(), kayak_s=150.0, above=0):
    """A set of one condition; of the boats, `kayaks` come and go unannotated; `above` of them fly over the horizon."""
    rng = np.random.default_rng(seed)
    time = np.arange(frames) / RATE_HZ
    known, rows = [], []
    for boat in range(boats):
        x, y = 150 + 250 * boat + 0.3 * time, np.full(frames, 420.0 + 30 * boat)
        known.append((np.arange(frames), np.full(frames, boat), boxes_at(x, y, 60.0)))
        hit = np.flatnonzero(rng.random(frames) < FOUND)
        rows.append((hit, _moved(rng, known[-1][2][hit])))
    for kayak in range(kayaks):
        start = rng.uniform(-kayak_s / 2, time[-1])
        there = np.flatnonzero((time >= start) & (time <= start + rng.exponential(kayak_s) + kayak_s / 2))
        y = HORIZON_PX - 90 if kayak < above else rng.uniform(HORIZON_PX + 20, HORIZON_PX + 140)
        x = rng.uniform(100, 900) + rng.choice([-1, 1]) * 1.5 * (time[there] - time[there[0]])
        hit = rng.random(len(there)) < FOUND
        rows.append((there[hit], _moved(rng, boxes_at(x[hit], np.full(hit.sum(), y), 30.0))))
    rows.append(_flicker(rng, time, flicker))
    image, boxes = (np.concatenate(column) for column in zip(*rows, strict=True))
    inside = (boxes[:, 2] > 0) & (boxes[:, 0] < WIDTH_PX)
    results = found(image[inside], np.zeros(inside.sum()), boxes[inside], rng.uniform(0.3, 1, inside.sum())).by_image()
    truths = [np.concatenate(column) for column in zip(*known, strict=True)]
    return labelled_set(results, truth(truths[0], 0 * truths[0], truths[2], identity=truths[1]), frames)


def labelled_set(results, annotated, frames, rate_hz=RATE_HZ, seas=SEA):
    """A set of one class and one condition, whose half planes may be the same in all frames."""
    half_planes = np.broadcast_to(seas, (frames, 3)).copy()
    shots = images(frames, (WIDTH_PX, HEIGHT_PX), np.arange(frames) / rate_hz, half_planes)
    return LabelledSet(("boat",), ("all",), shots, annotated.by_image(), results.by_image())


def observed(labelled, rule=IOU):
    state = np.zeros(len(labelled.images), dtype=np.int64)
    return Outcomes(labelled, match(labelled, rule, 0.2), ("all",), state, 0.2, frozenset({"merges", "splits"}))


def _moved(rng, boxes):
    return boxes + rng.normal(0, 1.5, boxes.shape)


def _flicker(rng, time, flicker):
    """Single ones, and ones that live for an exponential time, so many an image on average."""
    single = np.repeat(np.arange(len(time)), rng.poisson(flicker.per_image * (1 - flicker.share), len(time)))
    span = time[-1] + 20 * flicker.lifetime_s
    births = rng.poisson(flicker.per_image * flicker.share / flicker.lifetime_s * span) if flicker.share else 0
    born = rng.uniform(-20 * flicker.lifetime_s, time[-1], births)
    life = rng.exponential(flicker.lifetime_s, births)
    image, boxes = [single], [_places(rng, len(single))]
    for first, lived, place in zip(born, life, _places(rng, births), strict=True):
        there = np.flatnonzero((time >= first) & (time < first + lived))
        image.append(there)
        boxes.append(np.tile(place, (len(there), 1)))
    return np.concatenate(image), np.concatenate(boxes)


def _places(rng, count):
    x, y = rng.uniform(50, WIDTH_PX - 50, count), rng.uniform(HORIZON_PX + 10, HEIGHT_PX - 50, count)
    return boxes_at(x, y, rng.uniform(15, 60, count))
