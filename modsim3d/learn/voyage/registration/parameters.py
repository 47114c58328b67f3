"""Parameters of a registration, with units, and how far each may plausibly be from what the scene says."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student_t

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
    distances = {parameter.name: parameter.plausible for parameter in (*SHARED, *OF_A_VESSEL)}
    return np.array([distances[name] for name in names])


def flags(names: Iterable[str]) -> Mask:
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
    """Offsets and delays of k vessels: spreads, of the delay zero, and products with slopes by along, across, delay."""

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
        squares = ((values**2 + variances).reshape(count, 2).sum(axis=0) + weight * expected**2) / (count + weight)
    return np.asarray(np.where(squares < WORTH**2, 0.0, np.sqrt(squares)))


def vessel_values(
    effects: VesselEffects, covariance: Array, speeds_m_s: Array, names: Sequence[str]
) -> list[tuple[str, str, str, float, float]]:
    """Determined values of each vessel: name, words, unit, value and standard error. An offset along and a delay look
    the same while a vessel keeps its speed; then only how far it is ahead of its reports is determined. To see this,
    the delay gets a spread that moves the vessel as far as that of the offset. A value is determined if its error is
    below a quarter of its spread. `covariance` (p, p) is that of the parameters of the camera, `speeds_m_s` (k,) are
    mean speeds, and `names` those of all the scene's vessels."""
    values, (moved, across, _) = [], effects.spreads.tolist()
    for row, (vessel, speed) in enumerate(zip(effects.vessels.tolist(), speeds_m_s.tolist(), strict=True)):
        spreads = np.array([moved, across, moved / max(speed, SLOW_M_S)])
        free = np.flatnonzero(spreads > 0)
        own, block = np.zeros((3, 3)), np.ix_(free, free)
        own[block] = np.linalg.inv(effects.products[row][block] + np.diag(1 / spreads[free] ** 2))
        reach = own @ effects.of_camera[row]
        value, errors = own @ effects.pulls[row], own + reach @ covariance @ reach.T
        about = [(AHEAD, np.array([-1.0, 0.0, speed]), moved)]
        about += [
            ((parameter.name, parameter.words, parameter.unit), axis, spread)
            for parameter, axis, spread in zip(OF_A_VESSEL, np.eye(3), spreads.tolist(), strict=True)
        ]
        for (name, words, unit), axis, spread in about:
            error = float(np.sqrt(axis @ errors @ axis))
            if spread > 0 and error < SURE * spread:
                values.append((f"{names[vessel]}.{name}", words, unit, float(axis @ value), error))
    return values


LEVEL = 0.95
MAX_DEGREES = 1e4
FULL = 1e-9


@dataclass(frozen=True, eq=False)
class Knowledge:
    """Precision of p estimated values. Box errors of a vessel are correlated in time, and its dimensions, antenna and
    delay of reports are wrong in all frames alike. So vessels are the clusters of a sandwich covariance, with the
    bias-reduced correction CR2 and the degrees of freedom of Bell & McCaffrey (2002), "Bias reduction in standard
    errors for linear regression with multi-stage samples", Survey Methodology 28: what rests on few vessels gets a wide
    interval. A second sandwich, with stretches of time of a vessel as clusters, bounds it from below, because what one
    vessel alone determines leaves no residual by which the first could judge. With offsets, so does what their spreads
    would give."""

    covariance: Array  # (p, p)
    half_widths: Array  # half of the 95 % interval of each, (p,)
    errors: Array  # standard error of each, (p,)


@dataclass(frozen=True, eq=False)
class Linear:
    """A fit as a linear regression with unit errors: what its covariance follows from."""

    slopes: Array  # derivatives of the scaled residuals, (m, p)
    residuals: Array  # scaled, as the loss takes them, (m,)

    @classmethod
    def of_soft_loss(cls, slopes: Array, residuals: Array, soft: float) -> Linear:
        """The regression that a fit with the soft loss equals near its solution: with influence ψ(r) = r / √(1 + (r /
        soft)²), information is the mean of ψ' times the slopes' product."""
        growth = 1 + (residuals / soft) ** 2
        kept = float(np.mean(growth**-1.5)) if len(residuals) else 1.0
        return cls(np.sqrt(kept) * slopes, residuals / np.sqrt(growth) / np.sqrt(kept))

    def whitened(self, shared: Array, cluster: Indices) -> Linear:
        """Regression whose rows share errors in a cluster, of standard deviations (m, q): times (1 + Z Zᵀ)^(−1/2)."""
        slopes, residuals = self.slopes.copy(), self.residuals.copy()
        for rows in clusters(cluster):
            basis, upper = np.linalg.qr(shared[rows])
            spread, turn = np.linalg.eigh(upper @ upper.T)
            axes = basis @ turn
            less = 1 / np.sqrt(1 + np.maximum(spread, 0.0)) - 1
            slopes[rows] += axes @ (less[:, None] * (axes.T @ slopes[rows]))
            residuals[rows] += axes @ (less * (axes.T @ residuals[rows]))
        return Linear(slopes, residuals)

    @property
    def information(self) -> Array:
        """Shape (p, p)."""
        return self.slopes.T @ self.slopes

    def known_by(self, cluster: Indices, degrees: float | None = None) -> Knowledge:
        """Covariance and intervals with clusters of rows, shape (m,), and degrees of freedom if they are known."""
        bread = np.linalg.pinv(self.information, hermitian=True)
        scores, reaches, squares = [], [], []
        for rows in clusters(cluster):
            basis, upper = np.linalg.qr(self.slopes[rows])
            left, axes = np.linalg.eigh(np.eye(len(upper)) - upper @ bread @ upper.T)
            root = np.where(left > FULL, 1 / np.sqrt(np.maximum(left, FULL)), 0.0)
            adjusted = axes @ (root[:, None] * (axes.T @ upper))
            scores.append(adjusted.T @ (basis.T @ self.residuals[rows]))
            weights = adjusted @ bread  # in the basis of the cluster, one column a value
            reaches.append(upper.T @ weights)
            squares.append((weights**2).sum(axis=0))
        sums = np.array(scores)
        covariance = bread @ (sums.T @ sums) @ bread
        errors = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
        freedom = _degrees(np.array(reaches), np.array(squares), np.asarray(bread, dtype=np.float64))
        half = errors * student_t.ppf((1 + LEVEL) / 2, freedom if degrees is None else degrees)
        return Knowledge(covariance, half, errors)

    def known_by_model(self, together: float, degrees: float) -> Knowledge:
        """Covariance and intervals if the rows' errors are as the whitening has them. `together` rows count as one, and
        the spreads of what vessels share have so many degrees of freedom."""
        covariance = together * np.linalg.pinv(self.information, hermitian=True)
        errors = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
        return Knowledge(np.asarray(covariance), errors * student_t.ppf((1 + LEVEL) / 2, degrees), errors)


def wider(first: Knowledge, second: Knowledge) -> Knowledge:
    """Wider interval of each value, with the error that goes with it; the covariance is scaled to the errors."""
    errors = np.where(first.half_widths >= second.half_widths, first.errors, second.errors)
    scale = errors / np.maximum(np.sqrt(np.diagonal(first.covariance)), 1e-300)
    scale = np.where(np.isfinite(scale), scale, 1.0)
    covariance = first.covariance * scale[:, None] * scale
    return Knowledge(covariance, np.maximum(first.half_widths, second.half_widths), errors)


def _degrees(reaches: Array, squares: Array, bread: Array) -> Array:
    """Degrees of freedom of each value, (p,), from unit errors (Bell & McCaffrey, 2002). The variance estimate is a sum
    of squares of correlated normals, one for each cluster; its first two moments are those of a scaled chi-square.
    `reaches` are slopes times weights of each cluster, (clusters, p, p), `squares` squared weights, (clusters, p), and
    `bread` the inverse of the information, (p, p)."""
    degrees = np.empty(squares.shape[1])
    for value in range(len(degrees)):
        reach = reaches[:, :, value]
        spread = np.diag(squares[:, value]) - reach @ bread @ reach.T
        degrees[value] = np.trace(spread) ** 2 / max(float((spread**2).sum()), 1e-300)
    return np.clip(degrees, 1.0, MAX_DEGREES)


def covering(knowledge: Knowledge, others: Sequence[Array]) -> Knowledge:
    """Intervals that also hold those about other values, which are so far from these, each of shape (p,)."""
    away = np.max(np.abs(others), axis=0, initial=0.0) if len(others) else 0.0
    return replace(knowledge, half_widths=knowledge.half_widths + away)


def clusters(cluster: Indices) -> Iterator[Indices]:
    """The rows of each cluster, in order of its number."""
    order = np.argsort(cluster, kind="stable")
    yield from (part for part in np.split(order, np.flatnonzero(np.diff(cluster[order])) + 1) if len(part))


# ---- What the data determine, and what they cannot tell apart ----

COMMON_DELAY = "common_delay_s"
KNOWN = 0.5  # a value is determined if its standard error is below this share of its plausible distance
IN_GROUP = 0.2  # components of a singular vector, or exchanges in plausible distances, below this are left out
GIVEN_UP_FIRST = (  # of values that cannot be told apart, the first of these is held at the scene's
    *("k1", "mean_width_share", "mean_height_share", "mean_x_px", "mean_y_px"),
    *("roll_deg", "focal_share", "height_m", "pitch_deg", "yaw_deg", "clock_s"),
)


@dataclass(frozen=True)
class ConfoundedGroup:
    """Parameters that the data cannot tell apart."""

    held: str  # the one that is held
    exchange: tuple[tuple[str, float], ...]  # other names, and their changes when `held` grows by one of its units

    def words(self) -> str:
        """For example: `mean_y_px is held; 1 px of it looks like +0.044° of pitch_deg`."""
        units = {param.name: param.unit if param.unit in ("", "°") else f" {param.unit}" for param in SHARED}
        units[COMMON_DELAY] = " s"
        if not self.exchange:
            return f"{self.held}: the detections say nothing of it"
        one = "0.01" if units[self.held] == "" else "1"
        parts = [f"{change * float(one):+.3g}{units[name]} of {name}" for name, change in self.exchange]
        return f"{self.held} is held; {one}{units[self.held]} of it looks like {', '.join(parts)}"


def undetermined(linear: Linear, names: tuple[str, ...], cluster: Indices) -> list[ConfoundedGroup]:
    """Named values held as the data do not determine them, each with its group. The fit, in plausible distances, has a
    column for each name; `cluster` (m,) are stretches of a vessel within which errors go together."""
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


def directions(linear: Linear, knowledge: Knowledge) -> tuple[Array, Array]:
    """Right singular vectors of the scaled Jacobian, shape (p, p), and the standard errors along them, shape (p,)."""
    _, singular, turn = np.linalg.svd(np.linalg.qr(linear.slopes)[1])
    errors = np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", turn, knowledge.covariance, turn), 0.0))
    return turn, np.maximum(errors, 1 / np.maximum(singular, 1e-12))


def exchange(linear: Linear, names: tuple[str, ...], held: str, others: list[str]) -> ConfoundedGroup:
    """Changes of others if a held value were another, from the least squares of the slopes."""
    if not others:
        return ConfoundedGroup(held, ())
    slope, slopes = linear.slopes[:, names.index(held)], linear.slopes[:, [names.index(name) for name in others]]
    share, *_ = np.linalg.lstsq(slopes, slope, rcond=None)
    own, *scales = plausible("delay_s" if name == COMMON_DELAY else name for name in (held, *others))
    changes = -share * scales / own
    carried = np.abs(share) * np.linalg.norm(slopes, axis=0) >= IN_GROUP * max(float(np.linalg.norm(slope)), 1e-300)
    return ConfoundedGroup(held, tuple((others[k], float(changes[k])) for k in np.flatnonzero(carried)))
