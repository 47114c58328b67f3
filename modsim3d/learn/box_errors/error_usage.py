"""Which matches the box error of a state was learned from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.learn.box_error_fits.error_fit import ErrorFit
from modsim3d.learn.box_error_fits.matched_edges import MatchedEdges
from modsim3d.learn.observed.pairs import Pairs


@dataclass(frozen=True)
class UsedMatches:
    """Numbers of matches of a state.

    Attributes:
        state: Name of the state.
        matches: All matches of the state.
        used: Matches that count, of other states too where the state has too few.
        cut: Of these, those with a true side that the image's edge cuts.
        censored: Of these, those with a detected side on the image's edge and the true one inside.
        lost: Boxes that the distribution says failed the matching, for each that matches.
    """

    state: str
    matches: int
    used: int
    cut: int
    censored: int
    lost: float

    @classmethod
    def of(cls, state: str, pairs: Pairs, index: int, edges: MatchedEdges, fit: ErrorFit | None) -> UsedMatches:
        """From the boxes that were learned from and the fit."""
        lost = 0.0
        if fit is not None and fit.gate is not None:
            lost = float(np.expm1(-fit.gate.passing(fit.model)[0]).mean())
        return cls(
            state,
            int(np.count_nonzero(pairs.state == index)),
            len(edges),
            int(np.count_nonzero(~edges.counted.all(axis=1))),
            int(np.count_nonzero(edges.censored.any(axis=1))),
            lost,
        )

    @property
    def cells(self) -> tuple[str, ...]:
        """A row of the table."""
        share = self.lost / (1 + self.lost)
        return (
            self.state,
            f"{self.matches:,}",
            f"{self.used:,}",
            f"{self.cut:,}",
            f"{self.censored:,}",
            f"{100 * share:.2g} %" if share > 5e-4 else "–",
        )


TITLE = "Matches behind the box errors of the detector file"
HEADER = (
    "state",
    "matches",
    "used",
    "with a side cut by the image's edge, left out",
    "with a side detected on the image's edge",
    "boxes that fail the matching, by the fit",
)
