"""The likeliest distribution of each kind for the box errors of a state."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy import optimize

from modsim3d.arrays import Array, Mask
from modsim3d.learn.box_error_fits.error_fit import ErrorFit, fit_errors, fit_without_gate
from modsim3d.learn.box_error_fits.error_model import ErrorModel, Unit
from modsim3d.learn.box_error_fits.matched_edges import MatchedEdges
from modsim3d.learn.box_error_fits.student_t_fit import fit_student_t

_WHOLE_NEEDED = 10
_REGULAR = 1e-8
_LEAST_RATIO = 1e-6
_LEAST_SHARE, _MEAN_TO_STD = 0.05, np.sqrt(np.pi / 2)


@dataclass(frozen=True, eq=False)
class ErrorFits:
    """Distributions of the box errors of some boxes, each fitted when it is first asked for."""

    edges: MatchedEdges
    _found: dict[tuple[Unit, bool], ErrorFit | None] = field(default_factory=dict)

    def fit(self, unit: Unit, heavy: bool = False, least: float = -np.inf) -> ErrorFit | None:
        """The likeliest distribution of a kind; None where the errors determine none.

        One that will surely not reach the least log-likelihood that is asked of it is not fitted to the end.
        """
        if (unit, heavy) not in self._found:
            start = self._start(unit, heavy) if len(self.edges) else None
            self._found[unit, heavy] = None if start is None else fit_errors(start, self.edges, least)
        return self._found[unit, heavy]

    def chosen(self, unit: Unit, heavy: bool = False) -> ErrorFit | None:
        """The same; where so many boxes fail the matching that it has no maximum, as if matching cut off nothing."""
        found = self.fit(unit, heavy)
        if found is None or found.settled:
            return found
        start = self._start(unit, heavy)
        if start is not None:
            self._found[unit, heavy] = found = fit_without_gate(start, self.edges)
        return found

    def value(self, unit: Unit, heavy: bool = False, least: float = -np.inf) -> float:
        """Log-likelihood of the likeliest distribution of a kind, −∞ where there is none or it is below the least."""
        found = self.fit(unit, heavy, least)
        return -np.inf if found is None or not found.settled else found.value

    def unclipped(self, relative: bool) -> Array:
        """Errors of the boxes of which all edges are known, else of all, in pixels or sides, shape (m, 4)."""
        edges, chosen = self.edges, self._unclipped
        errors: Array = edges.errors_px[chosen] / (edges.sides_px[chosen] if relative else 1.0)
        return errors

    @cached_property
    def _unclipped(self) -> Mask:
        edges = self.edges
        chosen = edges.whole & edges.known.all(axis=1)
        if chosen.sum() < _WHOLE_NEEDED:
            chosen = edges.whole if edges.whole.any() else np.ones(len(edges), dtype=bool)
        return chosen

    def _start(self, unit: Unit, heavy: bool) -> ErrorModel | None:
        """A distribution near the likeliest one; None where errors are too few or determine each other."""
        if unit == "mixed":
            return self._start_of_mixed(heavy)
        errors = self.unclipped(unit == "relative")
        if not _regular(errors):
            return None
        if not heavy:
            return ErrorModel.of_moments(errors.mean(axis=0), np.cov(errors.T, bias=True), unit)
        found = fit_student_t(errors)
        return (
            None
            if found is None
            else ErrorModel.of_moments(found.mean, found.covariance, unit, found.degrees_of_freedom)
        )

    def _start_of_mixed(self, heavy: bool) -> ErrorModel | None:
        """From that in pixels, with standard deviations that follow the mean size of errors over the sides."""
        if heavy:
            return self._start_of_heavy_mixed()
        plain = self.fit("px")
        if plain is None:
            return None
        edges, model = self.edges, plain.model
        chosen = edges.whole
        std, growth = np.empty(4), np.empty(4)
        for k in range(4):
            sides = np.column_stack([np.ones(chosen.sum()), edges.sides_px[chosen, k]])
            found, _ = optimize.nnls(sides, _MEAN_TO_STD * np.abs(edges.errors_px[chosen, k] - model.mean[k]))
            std[k], growth[k] = max(found[0], _LEAST_SHARE * model.std[k]), found[1]
        return replace(model, std=std, growth=growth, unit="mixed", floor=_LEAST_SHARE * model.std)

    def _start_of_heavy_mixed(self) -> ErrorModel | None:
        """From normal mixed errors, with the tails of errors over their standard deviations."""
        normal = self.fit("mixed")
        tails = None if normal is None else fit_student_t(self.over_spread(normal.model))
        if normal is None or tails is None:
            return None
        ratio = np.sqrt(np.diag(tails.covariance))
        model = normal.model
        std = np.maximum(ratio * model.std, model.floor)
        return replace(model, std=std, growth=ratio * model.growth, freedom=tails.degrees_of_freedom)

    def over_spread(self, model: ErrorModel) -> Array:
        """Errors of `unclipped` boxes less their mean over their standard deviation by a distribution, shape (m, 4)."""
        mean, std = model.at(self.edges.sides_px[self._unclipped])
        errors: Array = (self.edges.errors_px[self._unclipped] - mean) / std
        return errors


def _regular(errors: Array) -> bool:
    """Whether errors (n, 4) have a covariance that is not singular."""
    if len(errors) < 2:
        return False
    matrix = np.cov(errors.T)
    std = np.sqrt(np.diag(matrix))
    if not np.all(std > _LEAST_RATIO * std.max()):
        return False
    return bool(np.linalg.eigvalsh(matrix / np.outer(std, std))[0] > _REGULAR)
