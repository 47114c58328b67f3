"""Parameters of a registration, with units, and how far each may plausibly be from what the scene says."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.core.errors import ModsimError
from modsim3d.io.validation import nearest


@dataclass(frozen=True)
class CameraParameter:
    """One number of a registration."""

    name: str  # with the unit
    words: str  # what it is, in a sentence
    unit: str  # in text; empty if it has none
    plausible: float  # distance from the scene's value; data that know it no better than this do not know it


CAMERA = (
    CameraParameter("clock_s", "clock: seconds to add to the detector's times", "s", 10.0),
    CameraParameter("roll_deg", "roll of the camera", "°", 3.0),
    CameraParameter("pitch_deg", "pitch of the camera", "°", 3.0),
    CameraParameter("yaw_deg", "yaw of the camera", "°", 5.0),
    CameraParameter("height_m", "height of the camera", "m", 3.0),
    CameraParameter("focal_share", "focal length, as a share", "", 0.1),
    CameraParameter("k1", "lens distortion k1", "", 0.1),
)
MEAN_ERRORS = (
    CameraParameter("mean_x_px", "mean box error in x", "px", 5.0),
    CameraParameter("mean_y_px", "mean box error in y", "px", 5.0),
    CameraParameter("mean_width_share", "mean box error in width, as a share", "", 0.2),
    CameraParameter("mean_height_share", "mean box error in height, as a share", "", 0.2),
)
OF_A_VESSEL = (
    CameraParameter("along_m", "antenna, towards the bow of the centre", "m", 20.0),
    CameraParameter("across_m", "antenna, to port of the centre", "m", 5.0),
    CameraParameter("delay_s", "delay of its position reports", "s", 5.0),
)
NAMES = tuple(parameter.name for parameter in OF_A_VESSEL)
SHARED = (*CAMERA, *MEAN_ERRORS)
SHARED_NAMES = tuple(parameter.name for parameter in SHARED)
SHORT = {name.rsplit("_", 1)[0]: name for name in SHARED_NAMES if "_" in name}
"""Names without their units, which `fixed` takes too: `pitch` for `pitch_deg`."""
PLACE = {name: place for place, name in enumerate(SHARED_NAMES)}


@dataclass(frozen=True, eq=False)
class Values:
    """Values of all parameters: zero is what the scene says."""

    shared: Array  # those of `SHARED`, (11,)
    vessels: Array  # those of `OF_A_VESSEL` for each vessel, (V, 3)

    @classmethod
    def none(cls, vessels: int) -> Values:
        """Values of the scene: nothing is added."""
        return cls(np.zeros(len(SHARED)), np.zeros((vessels, len(OF_A_VESSEL))))

    def __getitem__(self, name: str) -> float:
        """A shared value by its name."""
        return float(self.shared[PLACE[name]])

    def scaled(self, names: Sequence[str]) -> Array:
        """Named shared values in plausible distances, shape (n,)."""
        return self.shared[[PLACE[name] for name in names]] / plausible(names)

    def changed(self, **by: float) -> Values:
        """Values with other shared ones."""
        shared = self.shared.copy()
        for name, value in by.items():
            shared[PLACE[name]] = value
        return Values(shared, self.vessels)

    def moved(self, name: str, step: float) -> Values:
        """Values with a step added to a shared one, or to one of all vessels."""
        shared, vessels = self.shared.copy(), self.vessels.copy()
        if name in PLACE:
            shared[PLACE[name]] += step
        else:
            vessels[:, NAMES.index(name)] += step
        return Values(shared, vessels)


def plausible(names: Iterable[str]) -> Array:
    """Plausible distances of named parameters from the scene's values, shape (n,)."""
    known = {parameter.name: parameter.plausible for parameter in (*SHARED, *OF_A_VESSEL)}
    return np.array([known[name] for name in names])


def held(names: Iterable[str]) -> Mask:
    """Mask of shared parameters by their names with or without unit, (11,). Raises ModsimError if there is no such."""
    mask = np.zeros(len(SHARED), dtype=bool)
    for name in names:
        full = SHORT.get(name, name)
        if full not in PLACE:
            raise ModsimError(f"fixed: no parameter '{name}' ({nearest(name, [*SHORT, 'k1'])})")
        mask[PLACE[full]] = True
    return mask


# ---- What is wrong with single vessels ----

ROUNDS = 60
PRIOR_VESSELS = 4.0
WORTH = 3e-3  # spreads below this share of the plausible distances are taken to be zero
AHEAD = ("ahead_m", "how far it is ahead of its reports, at its mean speed", "m")
SLOW_M_S = 0.3
SURE = 0.25
MIN_SPREAD = 1e-3  # the same of spreads within the steps, which then hardly change


@dataclass(frozen=True, eq=False)
class VesselEffects:
    """Offsets and delays of k vessels. Spreads are standard deviations over vessels, of the delay zero; the others are
    products with each vessel's slopes by along, across and delay, in metres and seconds."""

    vessels: Indices  # (k,)
    spreads: Array  # of along and across in metres, and of the delay, (3,)
    products: Array  # of the slopes with each other, (k, 3, 3)
    pulls: Array  # with residuals, negative, (k, 3)
    of_camera: Array  # with slopes by the p parameters of the camera, (k, 3, p)


def vessel_effects(
    slopes: Array, residuals: Array, of_camera: Array, vessel: Indices, together: float, prior_m: float | None = None
) -> VesselEffects:
    """Spreads that fit scaled residuals (m,), with all values of vessels zero, best. `slopes` are their derivatives by
    along, across and delay of the row's vessel, (m, 3), `of_camera` those by the p estimated parameters of the camera,
    (m, p). `together` rows, at least 1, count as one, because box errors last. A spread of `prior_m` that is expected
    counts as much as `PRIOR_VESSELS` vessels; None for no expectation."""
    vessels, scale = np.unique(vessel), plausible(NAMES)
    rows = [vessel == one for one in vessels]
    products = np.array([slopes[some].T @ slopes[some] for some in rows]) / together
    pulls = -np.array([slopes[some].T @ residuals[some] for some in rows]) / together
    shared = np.array([slopes[some].T @ of_camera[some] for some in rows]) / together
    spreads = restricted_spreads(
        (products * scale[:, None] * scale)[:, :2, :2],
        (pulls * scale)[:, :2],
        (shared * scale[:, None])[:, :2],
        of_camera.T @ of_camera / together,
        -of_camera.T @ residuals / together,
        np.full(2, 0.0 if prior_m is None else prior_m) / scale[:2],
    )
    return VesselEffects(vessels, np.append(spreads, 0.0) * scale, products, pulls, shared)


def restricted_spreads(
    products: Array, pulls: Array, shared: Array, of_camera: Array, pull_of_camera: Array, expected: Array
) -> Array:
    """Spreads of two effects over k vessels, (2,), by restricted likelihood: the camera, with p parameters, too, has to
    be found. Each step takes the mean square of the effects, as the data and the last spreads give them. Products of
    slopes by the effects, of each vessel, are `products` with each other, (k, 2, 2), `pulls` with residuals, negative,
    (k, 2), and `shared` with slopes by the parameters of the camera, (k, 2, p). `of_camera` (p, p) and `pull_of_camera`
    (p,) are those of the latter. Spreads are `expected`, (2,); zero for no expectation."""
    count, p = len(products), len(of_camera)
    joint, pull = np.zeros((p + 2 * count,) * 2), np.concatenate([pull_of_camera, pulls.ravel()])
    joint[:p, :p], joint[p:, :p] = of_camera, shared.reshape(-1, p)
    joint[:p, p:] = joint[p:, :p].T
    for row in range(count):
        place = slice(p + 2 * row, p + 2 * row + 2)
        joint[place, place] = products[row]
    squares, own = np.full(2, 0.1), np.arange(p, p + 2 * count)
    weight = PRIOR_VESSELS if expected.any() else 0.0
    for _ in range(ROUNDS):
        inverse = joint.copy()
        inverse[own, own] += np.tile(1 / np.maximum(squares, MIN_SPREAD**2), count)
        covariance = np.linalg.pinv(inverse, hermitian=True)
        values, variances = (covariance @ pull)[own], covariance[own, own]
        sums = (values**2 + variances).reshape(count, 2).sum(axis=0)
        squares = (sums + weight * expected**2) / (count + weight)
    return np.asarray(np.where(squares < WORTH**2, 0.0, np.sqrt(squares)))


def known_of(
    effects: VesselEffects, covariance: Array, speeds_m_s: Array, names: Sequence[str]
) -> list[tuple[str, str, str, float, float]]:
    """Determined values of each vessel: name, words, unit, value and standard error. An offset along and a delay look
    the same while a vessel keeps its speed; then only how far it is ahead of its reports is determined. To see this,
    the delay gets a spread that moves the vessel as far as that of the offset. A value is determined if its error is
    below a quarter of its spread. `covariance` (p, p) is that of the parameters of the camera, `speeds_m_s` (k,) are
    mean speeds, and `names` those of all the scene's vessels."""
    found, (moved, across, _) = [], effects.spreads.tolist()
    for row, (vessel, speed) in enumerate(zip(effects.vessels.tolist(), speeds_m_s.tolist(), strict=True)):
        spreads = np.array([moved, across, moved / max(speed, SLOW_M_S)])
        free = np.flatnonzero(spreads > 0)
        own, block = np.zeros((3, 3)), np.ix_(free, free)
        own[block] = np.linalg.inv(effects.products[row][block] + np.diag(1 / spreads[free] ** 2))
        reach = own @ effects.of_camera[row]
        value, errors = own @ effects.pulls[row], own + reach @ covariance @ reach.T
        about = [(AHEAD, np.array([-1.0, 0.0, speed]), moved)]
        about += [
            ((each.name, each.words, each.unit), axis, spread)
            for each, axis, spread in zip(OF_A_VESSEL, np.eye(3), spreads.tolist(), strict=True)
        ]
        for (name, words, unit), axis, spread in about:
            error = float(np.sqrt(axis @ errors @ axis))
            if spread > 0 and error < SURE * spread:
                found.append((f"{names[vessel]}.{name}", words, unit, float(axis @ value), error))
    return found
