"""What the data determine, and what they cannot tell apart.

Singular vectors of the Jacobian, scaled so that every residual has a unit error and every parameter a unit plausible
distance, with a small singular value are combinations that the data do not tell: another value of all of them together
fits as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices
from modsim3d.voyage.registration.covariance import Knowledge, Linear
from modsim3d.voyage.registration.parameters import SHARED, SHARED_NAMES, plausible

COMMON_DELAY = "common_delay_s"
KNOWN = 0.5
"""A value is determined if its standard error is below this share of its plausible distance."""
IN_GROUP = 0.2
"""Components of a singular vector, or exchanges in plausible distances, below this are left out of a group."""
GIVEN_UP_FIRST = (
    *("k1", "mean_width_share", "mean_height_share", "mean_x_px", "mean_y_px"),
    *("roll_deg", "focal_share", "height_m", "pitch_deg", "yaw_deg", "clock_s"),
)
"""Of values that cannot be told apart, the first of these is held at the scene's."""


@dataclass(frozen=True)
class Group:
    """Parameters that the data cannot tell apart.

    Attributes:
        held: The one that is held, and by which the others would change.
        exchange: Other names, and by how much each changes when `held` grows by one of its units.
    """

    held: str
    exchange: tuple[tuple[str, float], ...]

    def words(self) -> str:
        """For example: `mean_y_px is held; 1 px of it looks like +0.044° of pitch_deg`."""
        units = {parameter.name: parameter.unit for parameter in SHARED} | {COMMON_DELAY: "s"}
        if not self.exchange:
            return f"{self.held}: the detections say nothing of it"
        one = "0.01" if units[self.held] == "" else "1"
        parts = [f"{change * float(one):+.3g}{_gap(units[name])} of {name}" for name, change in self.exchange]
        return f"{self.held} is held; {one}{_gap(units[self.held])} of it looks like {', '.join(parts)}"


def _gap(unit: str) -> str:
    return unit if unit in ("", "°") else f" {unit}"


def undetermined(linear: Linear, names: tuple[str, ...], cluster: Indices) -> list[Group]:
    """Which of the named values are to be held because the data do not determine them, each with its group.

    Args:
        linear: The fit, in plausible distances, a column for each name.
        names: The names.
        cluster: Stretches of time of a vessel, within which errors go together, shape (m,).
    """
    kept, groups = list(range(len(names))), []
    while kept:
        part = Linear(linear.slopes[:, kept], linear.residuals)
        turn, errors = directions(part, part.known_by(cluster))
        worst = int(np.argmax(errors))
        if errors[worst] < KNOWN:
            break
        members = [names[kept[i]] for i in np.flatnonzero(np.abs(turn[worst]) >= IN_GROUP)]
        given_up = next(name for name in GIVEN_UP_FIRST if name in members)
        kept.remove(names.index(given_up))
        groups.append(exchange(linear, names, given_up, [names[i] for i in kept if names[i] in members]))
    return groups


def directions(linear: Linear, known: Knowledge) -> tuple[Array, Array]:
    """Right singular vectors of the scaled Jacobian, shape (p, p), and the standard errors along them, shape (p,)."""
    _, singular, turn = np.linalg.svd(np.linalg.qr(linear.slopes)[1])
    rows = np.einsum("ki,ij,kj->k", turn, known.covariance, turn)
    errors = np.sqrt(np.maximum(rows, 0.0))
    return turn, np.maximum(errors, 1 / np.maximum(singular, 1e-12))


def exchange(linear: Linear, names: tuple[str, ...], held: str, others: list[str]) -> Group:
    """By how much others change if a held value were another, from the least squares of the slopes."""
    columns = [names.index(name) for name in others]
    if not columns:
        return Group(held, ())
    slope = linear.slopes[:, names.index(held)]
    share, *_ = np.linalg.lstsq(linear.slopes[:, columns], slope, rcond=None)
    scales = {
        **dict(zip(SHARED_NAMES, plausible(SHARED_NAMES), strict=True)),
        COMMON_DELAY: plausible(["delay_s"])[0],
    }
    sizes = np.abs(share) * np.linalg.norm(linear.slopes[:, columns], axis=0)
    carried = sizes >= IN_GROUP * max(float(np.linalg.norm(slope)), 1e-300)
    changes = [
        (name, float(-change * scales[name] / scales[held]))
        for name, change, large in zip(others, share, carried, strict=True)
        if large
    ]
    return Group(held, tuple(changes))
