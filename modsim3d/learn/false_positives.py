"""False positives: how many, with which labels, how large and where."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.boxes import centres, sizes
from modsim3d.core.text import in_percent
from modsim3d.learn.bootstrap import Column, Entry, Key, Resampling, columns_of_one, digits, nested, ratio, widened
from modsim3d.learn.matches import FalseSightings, Outcomes
from modsim3d.learn.persistent_false_positives import LifetimeFit, NoLifetime, find_lifetime
from modsim3d.learn.persistent_pairs import FALSE_FOR_EACH_CELL, GRID, PlaceFit, Placing, cells_of

FALSE_NEEDED = 30  # false positives that a distribution of sizes needs
NOT_WRITTEN = "not written"  # remark on a number that is reported and does not stand in the detector file
_ASTRAY = 0.02
_ALMOST_ANY = 0.99


@dataclass(frozen=True)
class FalsePositiveForm:
    """The model of false positives."""

    model: str
    sizes: bool  # whether they have sizes of their own; those of vessels if not
    placing: Placing
    notes: tuple[str, ...]
    lifetime_s: float = 0.0  # mean lifetime of those that stay; 0 where none do
    drifts: bool = False  # whether those drift

    def estimate(self, observed: Outcomes, resampling: Resampling) -> LearnedFalsePositives:
        """Rates and labels of each state, and the sizes, places and persistence that all states share."""
        sightings, lasting = observed.false_sightings, None
        if self.lifetime_s:
            fit = find_lifetime(observed, _mean_number(observed, self.model), known=True)
            lasting = fit if isinstance(fit, LifetimeFit) else None
        inflation = lasting.inflation if lasting else 1.0
        return LearnedFalsePositives(
            self,
            _of_states(observed, self.model, resampling, inflation),
            _size(sightings, resampling, inflation) if self.sizes else None,
            _place(sightings, self.placing, resampling, lasting),
            self._persistence(lasting, resampling) if self.lifetime_s else None,
        )

    def _persistence(self, lasting: LifetimeFit | None, resampling: Resampling) -> LearnedPersistence:
        """Lifetime, speed and share; of data without two frames, in which nothing can stay, a share of 0."""
        rows, none = len(resampling.weights), np.array(0.0)
        lifetime = Column(np.full(rows, self.lifetime_s), "positive", none)
        share, drift = Column(np.zeros(rows), "capped", none), Column(np.zeros(rows), "positive", none)
        if lasting is not None:
            (lifetime, share), drift = lasting.columns(resampling), lasting.drift.column(resampling)
        section = ("false_positives", "persistence")
        return LearnedPersistence(
            Entry(Key((*section, "lifetime_s")), lifetime),
            Entry(Key((*section, "drift_px_s")), drift) if self.drifts else None,
            Entry(Key((*section, "share")), share),
        )


@dataclass(frozen=True, eq=False)
class LearnedSize:
    """Width and height (2,) of false positives, scaled by a number whose logarithm is normal."""

    px: Entry
    log_std: Entry


@dataclass(frozen=True, eq=False)
class StateFalsePositives:
    """Shares of the labels (k,), false positives over all detections, and those in an image, in one state."""

    labels: Entry
    discovery_rate: Entry
    per_image: Entry


@dataclass(frozen=True, eq=False)
class LearnedPersistence:
    """Lifetime, speed (None where they do not drift) and share of those that stay."""

    lifetime_s: Entry
    drift_px_s: Entry | None
    share: Entry


@dataclass(frozen=True, eq=False)
class LearnedFalsePositives:
    """Numbers of false positives."""

    form: FalsePositiveForm
    states: tuple[StateFalsePositives, ...]  # rates and labels of each state
    size: LearnedSize | None  # None for the sizes of vessels
    place: Entry | None  # of the placement; of a map the share of each cell, in the grid's shape; None without any
    persistence: LearnedPersistence | None  # None where none stay

    def sections(self) -> dict[str, dict[str, Any]]:
        """Model, map and sizes."""
        section: dict[str, Any] = {"model": self.form.model}
        if self.place is not None:
            value = self.place.estimate
            if self.form.placing == "density":
                section |= {"placement": "density", "density": nested(value / value.max())}
            elif self.form.placing == "horizon_band":
                section |= {"placement": "horizon_band", "band_px": digits(value)}
            else:
                section["far_half_px"] = digits(value)
        if self.size is not None:
            px, log_std = nested(self.size.px.estimate), digits(self.size.log_std.estimate)
            section["size"] = {"model": "lognormal", "px": px, "log_std": log_std}
        if self.persistence is not None:
            stays = self.persistence
            drift = {} if stays.drift_px_s is None else {"drift_px_s": digits(stays.drift_px_s.estimate)}
            share = digits(np.clip(stays.share.estimate, 0, 1))  # a corrected one may be above 1
            section["persistence"] = {"lifetime_s": digits(stays.lifetime_s.estimate), **drift, "share": share}
        return {"false_positives": section}

    def state_section(self, state: int) -> dict[str, Any]:
        """Labels and rates."""
        learned = self.states[state]
        section: dict[str, Any] = {"false_positive_labels": columns_of_one(learned.labels.estimate)}
        if self.form.model == "per_image":
            return section | {"false_positives_per_image": digits(learned.per_image.estimate)}
        return section | {"false_discovery_rate": digits(min(float(learned.discovery_rate.estimate), 0.99))}


def choose_false_positives(observed: Outcomes, model: str = "auto") -> FalsePositiveForm:
    """The model of false positives that the data can carry; `auto` leaves the model of their number to them."""
    notes: list[str] = []
    false = len(observed.false_sightings)
    sized = false >= FALSE_NEEDED and "sizes" not in observed.without
    if false < FALSE_NEEDED:
        notes.append(f"false_positives.size: that of vessels; had {false:,} false positives, needs {FALSE_NEEDED}")
    chosen = _likelier(observed, notes) if model == "auto" else model
    lasting: LifetimeFit | NoLifetime = NoLifetime("left out")
    if "lasting" not in observed.without:
        lasting = find_lifetime(observed, _mean_number(observed, chosen))
        if isinstance(lasting, NoLifetime):
            notes.append(f"false_positives.persistence: none; {lasting.why}")
    if isinstance(lasting, NoLifetime):
        return FalsePositiveForm(chosen, sized, _placing(observed, (1.0, 1.0), notes), tuple(notes))
    placing = _placing(observed, lasting.worth, notes)
    if lasting.lifetime_s > lasting.frame_s * lasting.frames:
        notes.append("false_positives.persistence.lifetime_s: longer than any sequence lasts, so it is hardly known")
    if not lasting.drifts:
        notes.append("false_positives.persistence.drift_px_s: 0; no speed along the horizon can be told from 0")
    return FalsePositiveForm(chosen, sized, placing, tuple(notes), lasting.lifetime_s, lasting.drifts)


def _placing(observed: Outcomes, worth: tuple[float, float], notes: list[str]) -> Placing:
    """Placement of false positives, as far as the data carry it; see `LifetimeFit.worth`."""
    if "places" in observed.without:
        return "uniform"
    sightings = observed.false_sightings
    false, needed = len(sightings), FALSE_FOR_EACH_CELL * GRID[0] * GRID[1]
    where, known = "false_positives.placement:", bool(sightings.known.all())
    uniform = "uniform below the horizon" if known else "uniform"
    if not np.isfinite(observed.labelled.images.sizes_px).all():
        notes.append(f"{where} {uniform}; the size of some images is not known")
        return "uniform"
    if false < FALSE_NEEDED:
        notes.append(f"{where} {uniform}; had {false:,} false positives, needs {FALSE_NEEDED}")
        return "uniform"
    if not known:
        reason = "the horizon of some images is not known (--horizon)"
        if false < needed:
            reason = f"{reason}, and a map needs {needed:,} false positives, had {false:,}"
            notes.append(f"{where} {uniform}; {reason}")
            return "uniform"
        notes.append(f"{where} a map; {reason}")
        return "density"
    placing, gain = PlaceFit(sightings, *worth).choose()
    deep = np.quantile(sightings.depth_px, 0.9)
    above = float((sightings.depth_px < 0).mean())
    lie = f"{in_percent(above, 1)} of {false:,} false positives lie above the horizon"
    lie += f", and 90 % less than {deep:.3g} px below it"
    if placing == "uniform":
        notes.append(f"{where} {uniform}; no other is clearly likelier; {lie}")
    else:
        notes.append(f"{where} {placing}, for it is likelier than uniform (log-likelihood {gain:.1f} higher); {lie}")
    return placing


def _in_images(observed: Outcomes, rows: Indices) -> Array:
    """Number of some results in each image, shape (I,)."""
    images = observed.labelled.results.image[rows]
    return np.bincount(images, minlength=len(observed.labelled.images)).astype(np.float64)


def _mean_number(observed: Outcomes, model: str) -> Array:
    """Mean number of false positives in each image under a model of their number, shape (I,)."""
    images = len(observed.labelled.images)
    false, follows = _in_images(observed, observed.false_positives), np.ones(images)
    if model != "per_image":
        follows = _in_images(observed, observed.true)
    expected = np.zeros(images)
    for state in range(len(observed.states)):
        in_state = observed.image_state == state
        expected[in_state] = follows[in_state] * false[in_state].sum() / max(follows[in_state].sum(), 1.0)
    return expected


def _likelier(observed: Outcomes, notes: list[str]) -> str:
    """Whether the number of false positives follows that of the true ones, or is the same in every image."""
    false, true = _in_images(observed, observed.false), _in_images(observed, observed.true)
    with_true, even = 0.0, 0.0
    for state in range(len(observed.states)):
        in_state = observed.image_state == state
        total, n_true, n_images = false[in_state].sum(), true[in_state].sum(), in_state.sum()
        if total == 0:
            continue
        # Matching may leave a few false positives where nothing else is: they do not decide it alone.
        expected = total * ((1 - _ASTRAY) * (true[in_state] / max(n_true, 1.0)) + _ASTRAY / n_images)
        with_true += float((false[in_state] * np.log(expected)).sum())
        even += float(total * np.log(total / n_images))
    if even <= with_true:
        return "calibrated"
    notes.append(
        "false_positives: per_image, for their number does not follow that of the true detections "
        f"(log-likelihood {even:.1f} against {with_true:.1f})"
    )
    return "per_image"


def _of_states(observed: Outcomes, model: str, drawn: Resampling, inflation: float) -> tuple[StateFalsePositives, ...]:
    results, names = observed.labelled.results, observed.labelled.labels
    states, k = len(observed.states), len(names)
    image, label = results.image[observed.false_positives], results.label[observed.false_positives]
    labels = drawn.counts(image, observed.image_state[image] * k + label, (states, k))
    alone = labels.sum(axis=2)
    false, true = (
        drawn.counts(seen, observed.image_state[seen], (states,))
        for seen in (results.image[observed.false], results.image[observed.true])
    )
    chosen = np.flatnonzero(observed.image_state >= 0)
    images = drawn.counts(chosen, observed.image_state[chosen], (states,))
    overall = ratio(labels.sum(axis=1), alone.sum(axis=1, keepdims=True))
    overall = np.where(np.isfinite(overall), overall, 1 / k)
    learned = []
    for index, name in enumerate(observed.states):
        number, lonely = false[:, index], alone[:, index]
        table = ratio(labels[:, index], lonely[:, None])
        table = np.where(np.isfinite(table), table, overall)
        share = np.nan_to_num(ratio(number, number + true[:, index]))
        rate = np.nan_to_num(ratio(lonely, images[:, index]))
        share_remark, rate_remark = (NOT_WRITTEN, "") if model == "per_image" else ("", NOT_WRITTEN)
        keys = (
            Key(("false_positive_labels",), name, (names,), own_table=True),
            Key(("false_discovery_rate",), name, remark=share_remark),
            Key(("false_positives_per_image",), name, remark=rate_remark),
        )
        columns = (
            Column(table, "share", np.full(k, lonely[0]), inflation),
            Column(share, "share", number[0] + true[0, index], inflation),
            Column(rate, "rate", images[0, index], inflation),
        )
        learned.append(StateFalsePositives(*map(Entry, keys, columns)))
    return tuple(learned)


def _place(seen: FalseSightings, placing: Placing, resampling: Resampling, lasting: LifetimeFit | None) -> Entry | None:
    """The parameter of the placement; of a map the share of the false positives whose centres are in each cell."""
    worth = lasting.worth if lasting else (1.0, 1.0)
    if placing == "horizon_band":
        return Entry(Key(("false_positives", "band_px")), PlaceFit(seen, *worth).band_px(resampling))
    if placing == "far_half_px":
        return Entry(Key(("false_positives", "far_half_px")), PlaceFit(seen, *worth).far_half_px(resampling))
    if placing == "uniform":
        return None
    column, row = cells_of(seen.centres_px, seen.image_px)
    counts = resampling.counts(seen.image, row * GRID[1] + column, GRID)
    total = counts.sum(axis=(1, 2), keepdims=True)
    shares = Column(ratio(counts, total), "share", np.full(GRID, total[0, 0, 0]), worth[0])
    return Entry(Key(("false_positives", "density")), shares)


def _size(sightings: FalseSightings, resampling: Resampling, inflation: float) -> LearnedSize:
    """One shape, scaled by a number whose logarithm is normal. The image's edge cuts boxes, so only those count whose
    centres are farther from it than half of almost any box."""
    image, boxes_px, sizes_px = sightings.image, sightings.boxes_px, sightings.image_px
    half = np.quantile(sizes(boxes_px), _ALMOST_ANY, axis=0) / 2 if len(boxes_px) else np.zeros(2)
    centre = centres(boxes_px)
    inner = np.all((centre > half) & ((centre < sizes_px - half) | np.isnan(sizes_px)), axis=1)
    if inner.sum() >= FALSE_NEEDED:
        image, boxes_px = image[inner], boxes_px[inner]
    sides = np.log(np.maximum(sizes(boxes_px), 1e-6))
    scale = sides.mean(axis=1)
    sums = resampling.sums(image, np.column_stack([np.ones(len(sides)), sides, scale, scale**2]))
    number = sums[:, 0]
    px = np.exp(ratio(sums[:, 1:3], number[:, None]))
    std = np.sqrt(np.maximum((sums[:, 4] - ratio(sums[:, 3] ** 2, number)) / np.maximum(number - 1, 1), 0))
    count = max(float(len(sides)) / inflation, 1.0)
    root = np.sqrt(count)
    px_column = Column(widened(px, px[0] * std[0] / root), "positive", np.full(2, count))
    std_column = Column(widened(std, std[0] / root / np.sqrt(2)), "positive", np.array(count))
    px_key = Key(("false_positives", "size", "px"), axes=(("width", "height"),))
    return LearnedSize(Entry(px_key, px_column), Entry(Key(("false_positives", "size", "log_std")), std_column))
