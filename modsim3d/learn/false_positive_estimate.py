"""False positives: how many, with which labels, how large and where."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.boxes import centres, sizes
from modsim3d.learn.entries import Entry, Key, columns_of_one, digits, nested
from modsim3d.learn.form import ratio
from modsim3d.learn.observed import Observed
from modsim3d.learn.resampling import Column, Resampling, widened

FALSE_NEEDED = 30
"""False detections that a distribution of sizes needs."""
GRID = (3, 4)
"""Rows and columns of the map of where false detections are."""
FALSE_FOR_EACH_CELL = 10
NOT_WRITTEN = "not written"
"""Remark on a number that is reported and does not stand in the detector file."""
_ASTRAY = 0.02
_ALMOST_ANY = 0.99


@dataclass(frozen=True)
class FalsePositiveForm:
    """The model of false positives.

    Attributes:
        sizes: Whether they have sizes of their own; those of vessels if not.
        grid: Rows and columns of the map of where they are; None where they are anywhere below the horizon.
    """

    model: str
    sizes: bool
    grid: tuple[int, int] | None
    notes: tuple[str, ...]

    def estimate(self, observed: Observed, resampling: Resampling) -> LearnedFalsePositives:
        """Rates and labels of each state, and the sizes and the map that all states share."""
        results, sizes_px = observed.labelled.results, observed.labelled.images.sizes_px
        image, boxes_px = results.image[observed.false_positives], results.boxes_px[observed.false_positives]
        return LearnedFalsePositives(
            self,
            _of_states(observed, self.model, resampling),
            _size(image, boxes_px, sizes_px[image], resampling) if self.sizes else None,
            _density(image, boxes_px, sizes_px[image], self.grid, resampling) if self.grid else None,
        )


@dataclass(frozen=True, eq=False)
class LearnedSize:
    """Width and height (2,) of false positives, scaled by a number whose logarithm is normal."""

    px: Entry
    log_std: Entry


@dataclass(frozen=True, eq=False)
class StateFalsePositives:
    """Shares of the labels (k,), false detections over all detections, and those in an image, in one state."""

    labels: Entry
    discovery_rate: Entry
    per_image: Entry


@dataclass(frozen=True, eq=False)
class LearnedFalsePositives:
    """Numbers of false positives: rates and labels of each state, sizes (None for those of vessels) and a map.

    The map has the share of each cell, in the grid's shape; None where there is none.
    """

    form: FalsePositiveForm
    states: tuple[StateFalsePositives, ...]
    size: LearnedSize | None
    density: Entry | None

    def sections(self) -> dict[str, dict[str, Any]]:
        """Model, map and sizes."""
        section: dict[str, Any] = {"model": self.form.model}
        if self.density is not None:
            density = self.density.estimate
            section |= {"placement": "density", "density": nested(density / density.max())}
        if self.size is not None:
            px, log_std = nested(self.size.px.estimate), digits(self.size.log_std.estimate)
            section["size"] = {"model": "lognormal", "px": px, "log_std": log_std}
        return {"false_positives": section}

    def state_section(self, state: int) -> dict[str, Any]:
        """Labels and rates."""
        learned = self.states[state]
        section: dict[str, Any] = {
            "false_positive_labels": columns_of_one(learned.labels.estimate),
            "false_discovery_rate": digits(min(float(learned.discovery_rate.estimate), 0.99)),
        }
        if self.form.model == "per_image":
            section["false_positives_per_image"] = digits(learned.per_image.estimate)
        return section


def choose_false_positives(observed: Observed, model: str = "auto") -> FalsePositiveForm:
    """The model of false positives that the data can carry; `auto` leaves the model of their number to them."""
    notes: list[str] = []
    false, needed = len(observed.false_positives), FALSE_FOR_EACH_CELL * GRID[0] * GRID[1]
    if false < FALSE_NEEDED:
        notes.append(f"false_positives.size: that of vessels; had {false} false detections, needs {FALSE_NEEDED}")
    known = bool(np.isfinite(observed.labelled.images.sizes_px).all())
    mapped = false >= needed and known
    if not mapped:
        why = f"had {false} false detections, needs {needed}" if known else "the size of some images is not known"
        notes.append(f"false_positives.placement: uniform below the horizon; {why}")
    chosen = _likelier(observed, notes) if model == "auto" else model
    return FalsePositiveForm(chosen, false >= FALSE_NEEDED, GRID if mapped else None, tuple(notes))


def _likelier(observed: Observed, notes: list[str]) -> str:
    """Whether the number of false detections follows that of the true ones, or is the same in every image."""
    images = len(observed.labelled.images)
    false = np.bincount(observed.labelled.results.image[observed.false], minlength=images).astype(np.float64)
    true = np.bincount(observed.labelled.results.image[observed.true], minlength=images).astype(np.float64)
    with_true, even = 0.0, 0.0
    for state in range(len(observed.states)):
        ours = observed.image_state == state
        total, n_true, n_images = false[ours].sum(), true[ours].sum(), ours.sum()
        if total == 0:
            continue
        # Matching may leave a few false detections where nothing else is: they do not decide it alone.
        shares = true[ours] / max(n_true, 1.0)
        expected = total * ((1 - _ASTRAY) * shares + _ASTRAY / n_images)
        with_true += float((false[ours] * np.log(expected)).sum())
        even += float(total * np.log(total / n_images))
    if even <= with_true:
        return "calibrated"
    notes.append(
        "false_positives: per_image, for their number does not follow that of the true detections "
        f"(log-likelihood {even:.1f} against {with_true:.1f})"
    )
    return "per_image"


def _of_states(observed: Observed, model: str, resampling: Resampling) -> tuple[StateFalsePositives, ...]:
    results, names = observed.labelled.results, observed.labelled.labels
    states, k = len(observed.states), len(names)
    image, label = results.image[observed.false_positives], results.label[observed.false_positives]
    labels = resampling.counts(image, observed.image_state[image] * k + label, (states, k))
    alone = labels.sum(axis=2)
    false, true = (
        resampling.counts(seen, observed.image_state[seen], (states,))
        for seen in (results.image[observed.false], results.image[observed.true])
    )
    chosen = np.flatnonzero(observed.image_state >= 0)
    images = resampling.counts(chosen, observed.image_state[chosen], (states,))
    overall = ratio(labels.sum(axis=1), alone.sum(axis=1, keepdims=True))
    overall = np.where(np.isfinite(overall), overall, 1 / k)
    learned = []
    for index, name in enumerate(observed.states):
        number, lonely = false[:, index], alone[:, index]
        table = ratio(labels[:, index], lonely[:, None])
        table = np.where(np.isfinite(table), table, overall)
        share = np.nan_to_num(ratio(number, number + true[:, index]))
        rate = np.nan_to_num(ratio(lonely, images[:, index]))
        remark = "" if model == "per_image" else NOT_WRITTEN
        learned.append(
            StateFalsePositives(
                Entry(
                    Key(("false_positive_labels",), name, (names,), own_table=True),
                    Column(table, "share", np.full(k, lonely[0])),
                ),
                Entry(Key(("false_discovery_rate",), name), Column(share, "share", number[0] + true[0, index])),
                Entry(Key(("false_positives_per_image",), name, remark=remark), Column(rate, "rate", images[0, index])),
            )
        )
    return tuple(learned)


def _density(image: Indices, boxes_px: Array, sizes_px: Array, grid: tuple[int, int], resampling: Resampling) -> Entry:
    """Share of the boxes (n, 4) whose centres are in each cell of images of such sizes (n, 2)."""
    rows, across = grid
    place = np.clip(np.floor(centres(boxes_px) / sizes_px * [across, rows]), 0, [across - 1, rows - 1]).astype(np.int64)
    counts = resampling.counts(image, place[:, 1] * across + place[:, 0], grid)
    total = counts.sum(axis=(1, 2), keepdims=True)
    column = Column(ratio(counts, total), "share", np.full(grid, total[0, 0, 0]))
    return Entry(Key(("false_positives", "density")), column)


def _size(image: Indices, boxes_px: Array, sizes_px: Array, resampling: Resampling) -> LearnedSize:
    """One shape, scaled by a number whose logarithm is normal; of boxes (n, 4) in images (n,) of such sizes (n, 2).

    The image's edge cuts boxes, so only those count whose centres are farther from it than half of almost any box.
    """
    half = np.quantile(sizes(boxes_px), _ALMOST_ANY, axis=0) / 2
    centre = centres(boxes_px)
    inner = np.all((centre > half) & ((centre < sizes_px - half) | np.isnan(sizes_px)), axis=1)
    if inner.sum() >= FALSE_NEEDED:
        image, boxes_px = image[inner], boxes_px[inner]
    sides = np.log(np.maximum(sizes(boxes_px), 1e-6))
    scale = sides.mean(axis=1)
    sums = resampling.sums(image, np.column_stack([np.ones(len(sides)), sides, scale, scale**2]))
    number = sums[:, 0]
    px = np.exp(sums[:, 1:3] / number[:, None])
    variance = (sums[:, 4] - sums[:, 3] ** 2 / number) / np.maximum(number - 1, 1)
    std = np.sqrt(np.maximum(variance, 0))
    count = float(len(sides))
    root = np.sqrt(count)
    return LearnedSize(
        Entry(
            Key(("false_positives", "size", "px"), axes=(("width", "height"),)),
            Column(widened(px, px[0] * std[0] / root), "positive", np.full(2, count)),
        ),
        Entry(
            Key(("false_positives", "size", "log_std")),
            Column(widened(std, std[0] / root / np.sqrt(2)), "positive", np.array(count)),
        ),
    )
