"""Misses that depend on what a vessel looks like, as log-odds added to those of its state."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.boxes import sizes
from modsim3d.detector.draws import log2
from modsim3d.detector.records import Targets

MAX_LOG_ODDS = 30.0  # beyond this a rate differs from 0 or 1 by less than 1e-13
_MIN_DISTANCE_M = 1.0


def visible_fraction(targets: Targets) -> Array:
    """Seen share of the silhouette, NaN where unknown, shape (n,)."""
    return targets.visible_fraction


def size_px(targets: Targets) -> Array:
    """Side of a square as large as the annotated box, at least a pixel, shape (n,)."""
    sides = np.maximum(sizes(targets.boxes_px), 0)
    return np.asarray(np.maximum(np.sqrt(sides[:, 0] * sides[:, 1]), 1.0))


def distance_m(targets: Targets) -> Array:
    """Depth before the camera, at least a metre, shape (n,)."""
    return np.maximum(targets.depth_m, _MIN_DISTANCE_M)


WHOLLY_VISIBLE = 0.999  # seen share from which a vessel counts as wholly visible: the rest may be rounding


def partly_hidden(targets: Targets) -> Array:
    """One where something of the vessel is hidden, else 0; NaN where that is unknown, shape (n,)."""
    seen = targets.visible_fraction
    return np.where(np.isnan(seen), np.nan, seen < WHOLLY_VISIBLE)


ATTRIBUTES = {
    "visible_fraction": visible_fraction,
    "partly_hidden": partly_hidden,
    "size_px": size_px,
    "distance_m": distance_m,
}


class Effect(Protocol):
    """Change of the odds of a miss by an attribute of a vessel."""

    @property
    def attribute(self) -> str:
        """One of `ATTRIBUTES`."""

    def of(self, targets: Targets) -> Array:
        """Log-odds added for each target, shape (n,); none where the attribute is unknown."""


@dataclass(frozen=True)
class Slope:
    """Log-odds that change by `log_odds` for each unit of an attribute, or for each doubling; not at the reference."""

    attribute: str
    log_odds: float
    reference: float
    doublings: bool

    def of(self, targets: Targets) -> Array:
        """Log-odds added for each target, shape (n,); none where the attribute is unknown."""
        values = ATTRIBUTES[self.attribute](targets)
        levels = np.where(np.isnan(values), self.reference, values)
        return self.log_odds * (log2(levels / self.reference) if self.doublings else levels - self.reference)


@dataclass(frozen=True)
class FactorTable:
    """Factors on the odds of a miss by ranges of an attribute between ascending edges, which are in the range above."""

    attribute: str
    edges: tuple[float, ...]
    odds: tuple[float, ...]

    def of(self, targets: Targets) -> Array:
        """Log-odds added for each target, shape (n,); none where the attribute is unknown."""
        values = ATTRIBUTES[self.attribute](targets)
        added = np.array([float(np.log(odds)) for odds in self.odds])
        return np.where(np.isnan(values), 0.0, added[np.searchsorted(self.edges, values, side="right")])


EFFECTS: Mapping[str, type[Effect]] = {"logistic": Slope, "table": FactorTable}  # by `dropout.model` in a detector file


@dataclass(frozen=True)
class Dropout:
    """Rate of misses as it depends on what a vessel looks like. Keys of the mappings are indices of states."""

    effects: tuple[Effect, ...] = ()  # of the vessel's attributes; their log-odds add up
    anchored: bool = False  # whether each state's rate is held as the average over the scene
    own: Mapping[int, tuple[Effect, ...]] = field(default_factory=dict)  # each replaces the shared one of its attribute
    intercepts: Mapping[int, tuple[float, ...]] = field(default_factory=dict)  # log-odds added to misses of each label

    @property
    def every_effect(self) -> tuple[Effect, ...]:
        """Effects that states share and those of single states."""
        return *self.effects, *(effect for effects in self.own.values() for effect in effects)

    def effects_of(self, state: int) -> tuple[Effect, ...]:
        """The effects that hold in a state."""
        return tuple({effect.attribute: effect for effect in (*self.effects, *self.own.get(state, ()))}.values())

    def log_odds(self, states: Indices, targets: Targets) -> Array:
        """Sum of the log-odds added for each target in a state of its own, shapes (n,)."""
        total = _sum(self.effects, targets)
        for state in self.own:
            total = np.where(states == state, _sum(self.effects_of(state), targets), total)
        return np.clip(total, -MAX_LOG_ODDS, MAX_LOG_ODDS)


def _sum(effects: tuple[Effect, ...], targets: Targets) -> Array:
    total = np.zeros(len(targets))
    for effect in effects:
        total = total + effect.of(targets)
    return total


def shifted_rate(rate: Array, log_odds: Array) -> Array:
    """Rates with log-odds added, shapes (n,); 0 and 1 stay what they are."""
    return np.asarray(special.expit(special.logit(rate) + log_odds))


def anchor(rate: float, log_odds: Array, weights: Array) -> float:
    """The log-odds to add to those of a sample (n,) so that the weighted mean of the changed rates is the rate; weights
    (n,). Found by bisection to 1e-12; 0 if there is no sample or nothing can be changed."""
    if not len(weights) or rate in (0.0, 1.0):
        return 0.0
    low, high = -2 * MAX_LOG_ODDS, 2 * MAX_LOG_ODDS
    while high - low > 1e-12:
        middle = (low + high) / 2
        mean = float(np.sum(weights * shifted_rate(np.array(rate), log_odds + middle)) / np.sum(weights))
        low, high = (middle, high) if mean < rate else (low, middle)
    return (low + high) / 2
