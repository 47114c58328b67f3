"""Learned box errors less the errors of truth, and how long they persist."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from modsim3d.arrays import Array, Indices, Mask
from modsim3d.display import counted
from modsim3d.learn.box_errors.error_moments import covariance, moments
from modsim3d.learn.learned import Learned
from modsim3d.learn.observed.pairs import ErrorSource, Pairs
from modsim3d.learn.persistence.persistence_fit import frame_interval_s, steps_between
from modsim3d.learn.told.report import Report
from modsim3d.scene.scene import Scene
from modsim3d.voyage.truth_noise.error_draws import TruthErrors
from modsim3d.voyage.truth_noise.jacobians import View, box_jacobians
from modsim3d.voyage.truth_noise.noise import TruthNoise
from modsim3d.voyage.truth_noise.persistence_left import share_left, time_left
from modsim3d.voyage.truth_noise.subtraction import LessNoise, less_noise

_MOST_FRAMES = 500
"""Frames that errors of truth are drawn in: they change over minutes."""
_LEAST_PAIRS = 10
_MOST_LOST = 0.02
"""Where matching cuts off more boxes than this for each match, errors as measured are too small."""
_TO_STD = 1.4826
"""Median absolute number to standard deviation of normal numbers."""
_SLOW = 5.0
"""Errors of truth last for ever, compared with those of the detector, if they last so many times as long."""


@dataclass(frozen=True)
class ComponentNoise:
    """Errors of one component of boxes in one state.

    Attributes:
        state: The state.
        component: `x`, `y`, `width` or `height`.
        unit: `px`, or `of the side`.
        std: Standard deviations: as learned, from errors of truth, at least, and as written; NaN where unknown.
        upper_bound: Whether errors of truth were not taken off.
    """

    state: str
    component: str
    unit: str
    std: tuple[float, ...]
    upper_bound: bool


@dataclass(frozen=True, eq=False)
class TakenOff:
    """A detector of which the errors of truth are taken off.

    Attributes:
        learned: What is written.
        states: The errors of each state; None where too few boxes tell the errors of truth.
        noise: The errors of truth.
        moved: Number of vessels whose places registration has found.
        slow: Whether errors of truth last far longer than those of the detector, so that they are taken off what
            persists as well.
    """

    learned: Learned
    states: tuple[LessNoise | None, ...]
    noise: TruthNoise
    moved: int
    slow: bool

    def sentences(self) -> Iterator[str]:
        """What was assumed, and what is an upper bound."""
        noise = self.noise
        if not noise.std.any():
            yield "errors of truth: none are assumed"
            return
        uncertain = "".join(
            f", {name} of {count} vessel{'s' if count > 1 else ''}" for name, count in noise.reasons.items()
        )
        less = f"; less what registration found of {counted(self.moved, 'vessel')}" if self.moved else ""
        yield (
            f"errors of truth: positions to {noise.position_m:g} m in each direction, for {noise.position_s:g} s"
            f"{uncertain}{less}"
        )
        for name, found in zip(self.learned.observed.states, self.states, strict=True):
            where = f"states.{name}.box_error.covariance"
            if found is None:
                yield f"{where}: an upper bound; too few matches tell how errors of truth show in it"
            elif found.bounds:
                which = "x, y, width and height" if len(found.bounds) == 4 else ", ".join(found.bounds)
                yield (
                    f"{where}: an upper bound in {which}, for it is not surely larger than what errors of truth give; "
                    "correlations with it are unknown"
                )
        yield from self._on_persistence()

    def _on_persistence(self) -> Iterator[str]:
        errors = self.learned.numbers.box_errors
        if errors.box_s is None or not self.noise.std.any():
            return
        key = "box_s" if errors.box_vessel_share is None else "box_vessel_share"
        if self.slow:
            but = " (but for the components that are upper bounds)" if any(s and s.bounds for s in self.states) else ""
            yield f"persistence.{key}: less what persists of errors of truth{but}, as if they lasted for ever"
        else:
            yield f"persistence.{key}: an upper bound; errors of truth persist for about as long"

    def components(self) -> Iterator[ComponentNoise]:
        """The errors of each state and component of boxes."""
        for name, found in zip(self.learned.observed.states, self.states, strict=True):
            if found is None:
                continue
            unit = "px" if found.errors.unit != "relative" else "of the side"
            columns = np.stack([found.before, found.noise_std, found.at_least, found.after])
            for k, component in enumerate(("x", "y", "width", "height")):
                std = tuple(columns[:, k].tolist())
                yield ComponentNoise(name, component, unit, std, not found.taken_off[k])

    def rows(self) -> list[tuple[str, ...]]:
        """A row of `HEADER` for each state and component."""
        return [
            (
                *(each.state, each.component, each.unit),
                *("–" if np.isnan(std) else f"{std:.3g}" for std in each.std),
                "upper bound" if each.upper_bound else "",
            )
            for each in self.components()
        ]


TITLE = "Standard deviations of box errors, with and without errors of truth"
HEADER = ("state", "error of", "unit", "learned", "from errors of truth", "at least", "written", "")


def take_off_truth_noise(
    learned: Learned, scene: Scene, views: Sequence[View], noise: TruthNoise, level: float = 0.95, seed: int = 0
) -> TakenOff:
    """Take errors of truth off the learned box errors, where what is left is surely positive.

    Args:
        learned: What was learned; the identities of its annotations are indices of the scene's vessels, see `View`.
        scene: The scene that truth was made from.
        views: Its vessels as each camera saw them.
        noise: How well the vessels are known.
        level: Level of the intervals that must not reach 0.
        seed: Seed of the draws of errors of truth.
    """
    box_errors, pairs = learned.numbers.box_errors, learned.observed.pairs
    if not noise.std.any():
        return TakenOff(learned, (None,) * len(box_errors.states), noise, 0, False)
    rows = len(learned.resampling.weights)
    jacobians = _Jacobians.of(learned, scene, views)
    states: list[LessNoise | None] = []
    for index, (errors, form) in enumerate(zip(box_errors.states, learned.form.box_errors.states, strict=True)):
        ours = pairs.edges.whole if form.source is not ErrorSource.ALL_PAIRS else pairs.sure
        if form.source is ErrorSource.OWN_STATE:
            ours = ours & (pairs.state == index)
        relative = errors.unit == "relative"
        of_truth = jacobians.errors(pairs, ours, relative, noise)
        if of_truth is None or rows < 2:
            states.append(None)
            continue
        drawn = of_truth.covariances(rows - 1, seed + index)
        found = np.concatenate([drawn.mean(axis=0, keepdims=True), drawn])
        lost = box_errors.used[index].lost
        measured = _measured(learned, ours, relative)
        at_least = _changes(learned, ours, relative, of_truth.change, noise.position_s)
        cut_off = lost > _MOST_LOST
        states.append(less_noise(errors, found, pairs.sides_px[ours], level, measured, at_least, cut_off))
    box_s, share = box_errors.box_s, box_errors.box_vessel_share
    slow = box_s is not None and float(box_s.estimate) * _SLOW <= noise.position_s
    if slow and box_s is not None:
        part = _part_of_truth(states, pairs, rows)
        if share is not None:
            share = share_left(share, part)
        else:
            box_s = time_left(box_s, part, frame_interval_s(learned.observed.labelled))
    numbers = replace(
        box_errors,
        states=tuple(old if new is None else new.errors for old, new in zip(box_errors.states, states, strict=True)),
        box_s=box_s,
        box_vessel_share=share,
    )
    written = replace(learned, numbers=replace(learned.numbers, box_errors=numbers))
    return TakenOff(written, tuple(states), noise, len(np.unique(jacobians.vessel[jacobians.moved >= 0])), slow)


def report_less_truth_noise(
    report: Report, scene: Scene, views: Sequence[View], noise: TruthNoise
) -> tuple[Report, TakenOff]:
    """The same for a report: its learned numbers without errors of truth, and remarks that say so."""
    found = take_off_truth_noise(report.learned, scene, views, noise, report.level)
    remarks = (*report.remarks_on_data, *found.sentences())
    return replace(report, learned=found.learned, remarks_on_data=remarks), found


@dataclass(frozen=True, eq=False)
class _Jacobians:
    """Derivatives of true boxes (n, 4, 8), with times, vessels and fits (n,), for pairs at `place` (n,).

    See `TruthErrors` for `moved`.
    """

    place: Indices
    jacobians: Array
    time_s: Array
    vessel: Indices
    moved: Indices

    @classmethod
    def of(cls, learned: Learned, scene: Scene, views: Sequence[View]) -> _Jacobians:
        """Those of pairs in at most so many images of each camera."""
        pairs, labelled = learned.observed.pairs, learned.observed.labelled
        identity, vessel = labelled.annotations.identity[pairs.rows], np.full(len(pairs), -1)
        moved = np.full(len(pairs), -1)
        places, found = [np.empty(0, dtype=np.int64)], [np.empty((0, 4, 8))]
        for number, view in enumerate(views):
            some = np.unique(np.linspace(0, len(view.images) - 1, _MOST_FRAMES).round().astype(np.int64))
            frame = np.full(len(labelled.images), -1)
            frame[view.images[some]] = some
            place = np.flatnonzero((frame[pairs.image] >= 0) & (identity >= 0))
            if not len(place):
                continue
            vessel[place] = identity[place] - view.first_identity
            if view.moved is not None:
                moved[place] = np.where(view.moved[vessel[place]], number * len(scene.vessels) + vessel[place], -1)
            jacobians = box_jacobians(scene, view, frame[pairs.image[place]], vessel[place])
            told = np.isfinite(jacobians).all(axis=(1, 2))
            places.append(place[told])
            found.append(jacobians[told])
        place = np.concatenate(places)
        time_s = labelled.images.time_s[pairs.image[place]]
        return cls(place, np.concatenate(found), time_s, vessel[place], moved[place])

    def errors(self, pairs: Pairs, chosen: Mask, relative: bool, noise: TruthNoise) -> TruthErrors | None:
        """Errors of truth of some pairs; None of too few."""
        ours = chosen[self.place]
        if ours.sum() < _LEAST_PAIRS:
            return None
        unit_px = pairs.sides_px[self.place[ours]] if relative else np.ones((int(ours.sum()), 4))
        columns = self.jacobians[ours], self.time_s[ours], self.vessel[ours]
        return TruthErrors(*columns, noise, unit_px, self.moved[ours])


def _measured(learned: Learned, ours: Mask, relative: bool) -> Array:
    """Covariances of the errors of some pairs (m,) in each replicate, shape (rows, 4, 4)."""
    pairs = learned.observed.pairs
    _, std, correlation = moments(learned.resampling, pairs.image[ours], pairs.errors(ours, relative))
    return np.stack([covariance(*each) for each in zip(np.nan_to_num(std), np.nan_to_num(correlation), strict=True)])


def _changes(learned: Learned, ours: Mask, relative: bool, noise: Array, lasting_s: float) -> Array:
    """Standard deviations of what changes of the errors to the next frame, shape (4,), NaN where few frames tell.

    Less what changes of errors of truth with these variances (4,).
    """
    pairs, place = learned.observed.pairs, np.flatnonzero(ours)
    steps = steps_between(learned.observed.labelled, pairs.rows[place])
    if len(steps) < _LEAST_PAIRS:
        return np.full(4, np.nan)
    errors = pairs.errors(ours, relative)
    apart = np.abs(errors[steps.later] - errors[steps.earlier])
    change = (_TO_STD * np.median(apart, axis=0)) ** 2 / 2  # a wrong match must not pull
    of_truth = noise * -np.expm1(-steps.apart_s / lasting_s).mean()
    left: Array = np.sqrt(np.maximum(change - of_truth, 0))
    return left


def _part_of_truth(states: Sequence[LessNoise | None], pairs: Pairs, rows: int) -> Array:
    """Share of the whitened errors of all states that was taken off, shape (rows,)."""
    counts = np.bincount(pairs.state, minlength=len(states)).astype(np.float64)
    parts = np.stack([np.zeros(rows) if each is None else each.share for each in states])
    part: Array = np.clip(counts @ parts / max(counts.sum(), 1.0), 0, 1 - 1e-6)
    return part
