"""Matches and fits in turn, with ever closer gates, until the matches stay."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from modsim3d.core.arrays import Array, Columns, Indices, Mask
from modsim3d.core.boxes import clip, sizes
from modsim3d.core.errors import ModsimError
from modsim3d.core.statistics import MAD_TO_STD
from modsim3d.learn.voyage.registration.model import BoxModel, HidingBodies, same_frame
from modsim3d.learn.voyage.registration.parameters import MEAN_ERRORS, NAMES, PLACE, SHARED_NAMES, Values, plausible


@dataclass(frozen=True, eq=False)
class BoxesAtTimes:
    """n detected boxes in F frames of one camera, empty ones too. Times count from the scene's first step."""

    times_s: Array  # of each frame, ascending, (F,)
    frame: Indices  # of each box, (n,)
    boxes_px: Array  # left, top, right and bottom edge, (n, 4)

    def __post_init__(self) -> None:
        """Raise ModsimError if shapes do not fit, times do not ascend, a box has no frame, or a number is infinite."""
        count = len(self.frame)
        if self.times_s.ndim != 1 or self.boxes_px.shape != (count, 4):
            shapes = f"times {self.times_s.shape}, frames {self.frame.shape}, boxes {self.boxes_px.shape}"
            raise ModsimError(f"detections: shapes (F,), (n,) and (n, 4) are needed (got {shapes})")
        if not (np.isfinite(self.times_s).all() and np.isfinite(self.boxes_px).all()):
            raise ModsimError("detections: a time or an edge of a box is not a finite number")
        if np.any(np.diff(self.times_s) <= 0):
            at = int(np.flatnonzero(np.diff(self.times_s) <= 0)[0])
            after = f"{self.times_s[at + 1]:g} s follows {self.times_s[at]:g} s"
            raise ModsimError(f"detections: the times of frames must ascend, but {after}")
        if count and not 0 <= self.frame.min() <= self.frame.max() < len(self.times_s):
            raise ModsimError(f"detections: a box is in a frame that is not among the {len(self.times_s)} frames")

    def some(self, most_frames: int) -> BoxesAtTimes:
        """At most so many of the frames, evenly spread, with their boxes."""
        if len(self.times_s) <= most_frames:
            return self
        kept = np.unique(np.linspace(0, len(self.times_s) - 1, most_frames).round().astype(int))
        number = np.full(len(self.times_s), -1)
        number[kept] = np.arange(len(kept))
        inside = number[self.frame] >= 0
        return BoxesAtTimes(self.times_s[kept], number[self.frame][inside], self.boxes_px[inside])


# ---- Detections matched to vessels ----

EDGE_PX = 3.0  # an edge this near the image's border may be cut by it
MAX_OFF_CENTRE = 0.75  # how far from the image's centre, in shares of its size, a point may be by the scene's own lens
SIZE_RATIO = 2.5
LESS_SURE = 0.5  # a match is clear if it is nearer, by this factor, than the next vessel and the next detection


@dataclass(frozen=True, eq=False)
class Sightings(Columns):
    """Matched detections, n rows in order of frame."""

    detection: Indices  # row of the detected box
    frame: Indices
    time_s: Array  # of the frame, by the detector's clock
    vessel: Indices
    boxes_px: Array  # detected left, top, right and bottom edge, (n, 4)
    usable: Mask  # which of these edges are neither cut by the image nor hidden, (n, 4)
    expected_px: Array  # the box that the values give with which it was matched, not cut at the image, (n, 4)
    corners_m: Array  # the vertex of the vessel that makes each edge, in VCF, (n, 4, 3)


@dataclass(frozen=True, eq=False)
class Predictions:
    """Places where the vessels' boxes should be in the frames, m rows in order of frame: all that overlap the image."""

    frame: Indices
    vessel: Indices
    boxes_px: Array
    corners_m: Array
    usable: Mask


def predict(model: BoxModel, hiding: HidingBodies, values: Values, times_s: Array) -> Predictions:
    """The boxes of all vessels in frames at times of the detector's clock, shape (F,), with some values."""
    vessels = len(model.hulls_m)
    frame, vessel = np.divmod(np.arange(len(times_s) * vessels), vessels)
    boxes, corners = model.boxes(values, times_s[frame], vessel)
    size = np.array(model.traffic.camera.intrinsics.image_size_px, dtype=np.float64)
    with np.errstate(invalid="ignore"):
        shown = np.flatnonzero(np.all((boxes[:, 2:] > 0) & (boxes[:, :2] < size), axis=1))
    frame, vessel, boxes, corners = frame[shown], vessel[shown], boxes[shown], corners[shown]
    hidden = hiding.hidden(values, times_s[frame], vessel, corners, frame)
    seen = np.flatnonzero(~hidden.all(axis=1))
    tips = model.pixels(values, times_s[frame], vessel, corners)
    # Of a ship that a side of the image cuts, the highest and lowest points may lie beyond that side.
    usable = np.all((tips > EDGE_PX) & (tips < size - EDGE_PX), axis=-1) & ~hidden
    # A k1 below the scene's folds points from far outside into the image.
    straight = model.pixels(values.changed(k1=0.0), times_s[frame], vessel, corners)
    usable &= np.all(np.abs(straight / size - 0.5) < MAX_OFF_CENTRE, axis=-1)
    return Predictions(frame[seen], vessel[seen], boxes[seen], corners[seen], usable[seen])


def inside(boxes_px: Array, size_px: Array) -> Mask:
    """Mask of the edges of boxes (n, 4) that are clear of the image's border."""
    return (boxes_px > EDGE_PX) & (boxes_px < np.tile(size_px, 2) - EDGE_PX)


def match(detections: BoxesAtTimes, predicted: Predictions, size_px: tuple[int, int], gates_px: Array) -> Sightings:
    """Detections and vessels of a frame that are each other's nearest, clearly, by centre's column and lower edge in
    shares of the gate, and widths. `gates_px` are the greatest distances in columns and rows, (m, 2)."""
    box, row = same_frame(detections.frame, predicted.frame)
    detected, expected = detections.boxes_px[box], clip(predicted.boxes_px, size_px)[row]
    gates = gates_px[row]
    across = (detected[:, [0, 2]] - expected[:, [0, 2]]).mean(axis=1) / gates[:, 0]
    down = (detected[:, 3] - expected[:, 3]) / gates[:, 1]
    widths = [np.maximum(sizes(boxes)[:, 0], 1.0) for boxes in (detected, expected)]
    wider = np.log(widths[0] / widths[1]) / np.log(SIZE_RATIO)
    distance = across**2 + down**2 + wider**2
    near = np.flatnonzero((np.abs(across) < 1) & (np.abs(down) < 1) & (np.abs(wider) < 1))
    box, row, distance = box[near], row[near], distance[near]
    clear = _clearest(box, distance) & _clearest(row, distance)
    box, row = box[clear], row[clear]
    order = np.lexsort((row, predicted.frame[row]))
    box, row = box[order], row[order]
    frame, boxes = predicted.frame[row], detections.boxes_px[box]
    usable = predicted.usable[row] & inside(boxes, np.array(size_px, dtype=np.float64))
    columns = predicted.vessel[row], boxes, usable, predicted.boxes_px[row], predicted.corners_m[row]
    return Sightings(box, frame, detections.times_s[frame], *columns)


def _clearest(owner: Indices, distance: Array) -> Mask:
    """Mask of the pairs that are the nearest of their owner, and nearer than the next by a factor."""
    order = np.lexsort((distance, owner))
    first = np.ones(len(order), dtype=bool)
    first[1:] = owner[order][1:] != owner[order][:-1]
    following = np.full(len(order), np.inf)
    following[:-1] = np.where(first[1:], np.inf, distance[order][1:])
    clear = np.zeros(len(order), dtype=bool)
    clear[order] = first & (distance[order] <= LESS_SURE * following)
    return clear


# ---- What a match says ----

KINDS = ("centre", "left", "right", "waterline", "width", "height")
OF_EDGES = np.array(  # each kind from the left, top, right and bottom edge, shape (6, 4)
    [[0.5, 0, 0.5, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [-1, 0, 1, 0], [0, -1, 0, 1]], dtype=np.float64
)
OF_MEAN_ERRORS = np.array(  # each kind from the errors of the box in x, y, width and height in pixels, shape (6, 4)
    [[1, 0, 0, 0], [1, 0, -0.5, 0], [1, 0, 0.5, 0], [0, 1, 0, 0.5], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=np.float64
)
SIDE = np.array([0, 0, 0, 1, 0, 1])  # whether a kind's error grows with the box's width (0) or height (1)
MIN_PX = 0.3
BINS = 6


@dataclass(frozen=True, eq=False)
class SightingResiduals:
    """Residuals of n sightings: m rows, one for each sighting and kind that its usable edges allow."""

    sightings: Sightings
    row: Indices  # of the sighting, (m,)
    kind: Indices  # into `KINDS`, (m,)
    observed_px: Array  # what was detected, (m,)
    size_px: Array  # expected width or height, whichever the kind's error grows with, (m,)

    @classmethod
    def of(cls, sightings: Sightings, *, use_sizes: bool) -> SightingResiduals:
        """Residuals of sightings. One side alone counts where the other is not usable."""
        left, top, right, bottom = sightings.usable.T
        both, tall = left & right, top & bottom
        kinds = [both, left & ~right, right & ~left, bottom, both & use_sizes, tall & use_sizes]
        row, kind = np.nonzero(np.stack(kinds, axis=1))
        sides = np.maximum(sizes(sightings.expected_px[row]), 1.0)
        size = np.take_along_axis(sides, SIDE[kind][:, None], axis=1)[:, 0]
        return cls(sightings, row, kind, (OF_EDGES[kind] * sightings.boxes_px[row]).sum(axis=1), size)

    @property
    def vessel(self) -> Indices:
        """Vessel of each row, shape (m,)."""
        return self.sightings.vessel[self.row]

    def px(self, model: BoxModel, values: Values) -> Array:
        """Detected less expected in pixels, shape (m,)."""
        seen, used = self.sightings, OF_EDGES[self.kind]
        edges = model.edges(values, seen.time_s, seen.vessel, seen.corners_m)[self.row]
        expected = (used * np.where(used == 0, 0.0, edges)).sum(axis=1)
        first = PLACE[MEAN_ERRORS[0].name]
        shift: Array = self.of_mean_errors @ values.shared[first : first + len(MEAN_ERRORS)]
        return np.asarray(self.observed_px - expected - shift)

    @cached_property
    def of_mean_errors(self) -> Array:
        """Shift of each detection by a unit of each of `MEAN_ERRORS`, in pixels, shape (m, 4)."""
        unit = np.ones((len(self.row), 4))
        unit[:, 2:] = np.maximum(sizes(self.sightings.expected_px[self.row]), 1.0)
        return np.asarray(OF_MEAN_ERRORS[self.kind] * unit)

    def spreads_px(self, residuals_px: Array) -> Array:
        """Spread of residuals in px, (m,): by kind, and size with enough rows, 1.48 times the median absolute residual,
        which no wrong match pulls, about zero in bins of size, between which its logarithm interpolates."""
        spread = np.ones(len(self.row))
        for kind in range(len(KINDS)):
            rows = np.flatnonzero(self.kind == kind)
            if not len(rows):
                continue
            size, absolute = np.log(self.size_px[rows]), np.abs(residuals_px[rows])
            bins = np.array_split(np.argsort(size, kind="stable"), min(BINS, max(len(rows) // 40, 1)))
            middle = np.array([np.median(size[some]) for some in bins])
            typical = np.array([max(MAD_TO_STD * np.median(absolute[some]), MIN_PX) for some in bins])
            spread[rows] = np.exp(np.interp(size, middle, np.log(typical)))
        return spread


# ---- The values that fit matched detections best ----

SOFT = 1.5  # spreads beyond which a residual counts less (the soft loss of `scipy.optimize.least_squares`)
MAX_EVALUATIONS = 12
STEP = 1e-3  # step of the numerical derivatives, in plausible distances
MEAN_NAMES = tuple(parameter.name for parameter in MEAN_ERRORS)


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Parameters that a fit looks for, as one vector. `spreads` say how far the values of vessels are from zero, as
    standard deviations; a value with zero is not looked for."""

    shared: tuple[str, ...]  # names of shared ones, in the order of `SHARED`
    spreads: Array  # of along, across and delay, (3,)
    vessels: Indices  # those whose values are looked for, (k,)

    @property
    def own(self) -> Indices:
        """Indices of along, across and delay that are looked for."""
        return np.flatnonzero(self.spreads > 0)

    @property
    def places(self) -> list[int]:
        """Places of the shared ones in `Values.shared`."""
        return [PLACE[name] for name in self.shared]

    def vector(self, values: Values) -> Array:
        """Values as a vector in plausible distances, and of vessels in their spreads."""
        own = values.vessels[np.ix_(self.vessels, self.own)] / self.spreads[self.own]
        return np.concatenate([values.shared[self.places] / plausible(self.shared), own.ravel()])

    def values(self, vector: Array, start: Values) -> Values:
        """The values of a vector; others as at the start."""
        shared, vessels = start.shared.copy(), start.vessels.copy()
        count = len(self.shared)
        shared[self.places] = vector[:count] * plausible(self.shared)
        own = vector[count:].reshape(len(self.vessels), len(self.own))
        vessels[np.ix_(self.vessels, self.own)] = own * self.spreads[self.own]
        return Values(shared, vessels)


def derivatives(model: BoxModel, residuals: SightingResiduals, values: Values, names: tuple[str, ...]) -> Array:
    """Derivatives of residuals in px by named parameters, per unit, (m, len(names)); a vessel's are of its own rows."""
    columns = np.empty((len(residuals.row), len(names)))
    here = residuals.px(model, values)
    for column, (name, scale) in enumerate(zip(names, plausible(names), strict=True)):
        if name in MEAN_NAMES:
            columns[:, column] = -residuals.of_mean_errors[:, MEAN_NAMES.index(name)]
            continue
        step = STEP * scale
        columns[:, column] = (residuals.px(model, values.moved(name, step)) - here) / step
    return columns


def fit(
    model: BoxModel,
    residuals: SightingResiduals,
    start: Values,
    unknowns: Unknowns,
    spreads_px: Array,
    *,
    tied: bool = False,
    most: int | None = None,
) -> Values:
    """The values that fit best, from a start; see `Unknowns` for those that are looked for. With `tied`, shared ones
    are held near the scene's values, each as by one measurement with the plausible distance as its standard deviation,
    so that what the data do not determine stays where it is. `most` ends a rough fit after so many evaluations."""
    vessel_names = [NAMES[own] for own in unknowns.own]
    place = np.full(len(model.hulls_m), -1)
    place[unknowns.vessels] = np.arange(len(unknowns.vessels))
    row_of, count = place[residuals.vessel], len(unknowns.shared)
    priors = len(unknowns.vessels) * len(vessel_names)
    ties = count if tied else 0
    weights = np.concatenate([plausible(unknowns.shared), unknowns.spreads[unknowns.own]])

    def of(vector: Array) -> Array:
        px = residuals.px(model, unknowns.values(vector, start))
        return np.concatenate([np.nan_to_num(px / spreads_px, nan=1e3), vector[count - ties :]])

    def slopes(vector: Array) -> Array:
        values = unknowns.values(vector, start)
        block = derivatives(model, residuals, values, (*unknowns.shared, *vessel_names)) * weights / spreads_px[:, None]
        block = np.nan_to_num(block, nan=0.0)
        jacobian = np.zeros((len(block) + ties + priors, count + priors))
        jacobian[: len(block), :count] = block[:, :count]
        rows = np.flatnonzero(row_of >= 0)
        for own in range(len(vessel_names)):
            jacobian[rows, count + row_of[rows] * len(vessel_names) + own] = block[rows, count + own]
        jacobian[len(block) :, count - ties :] = np.eye(ties + priors)
        return jacobian

    first = unknowns.vector(start)
    best = least_squares(
        of, first, slopes, loss="soft_l1", f_scale=SOFT, xtol=1e-4, ftol=1e-5, max_nfev=most or MAX_EVALUATIONS
    )
    return unknowns.values(best.x, start)


FIRST = ("clock_s", "yaw_deg", "pitch_deg")
THEN = (*FIRST, "roll_deg", "height_m", "focal_share")
GATES_DEG = (1.5, 1.0, 0.6)
GATE_SHARE = 0.3  # a gate grows by this share of the box's size, as errors of boxes do
SPREADS = 4.5  # the last gates in spreads of the residuals
MAX_ROUNDS = 10
SAME = 0.003  # the matches stay if fewer than this share of them change
MIN_FIT = 10
ROUGH = 4  # iterations of a rough fit


@dataclass(frozen=True, eq=False)
class Alignment:
    """Values, the matches that they give, and their residuals with spreads in pixels, shapes (m,)."""

    values: Values
    sightings: Sightings
    residuals: SightingResiduals
    spreads_px: Array


@dataclass(frozen=True, eq=False)
class Aligner:
    """Input of an alignment from the scene and the detections."""

    model: BoxModel
    hiding: HidingBodies
    boxes: BoxesAtTimes
    free: tuple[str, ...]  # names of the shared parameters that may change
    use_sizes: bool  # so that widths and heights count

    def first(self, start: Values) -> Alignment:
        """A rough alignment from a guess."""
        values = start
        for gate_deg, names in zip(GATES_DEG, (FIRST, THEN, SHARED_NAMES), strict=True):
            predicted = predict(self.model, self.hiding, values, self.boxes.times_s)
            gate = np.radians(gate_deg) * self.model.traffic.camera.intrinsics.focal_px[0]
            sightings = self._match(predicted, gate + GATE_SHARE * sizes(predicted.boxes_px))
            aligned = self._fitted(sightings, values, self._unknowns(names), tied=True, most=ROUGH)
            values = aligned.values
        return aligned

    def until_stable(
        self, aligned: Alignment, unknowns: Unknowns, *, tied: bool, rounds: int = MAX_ROUNDS
    ) -> Alignment:
        """Match and fit until the matches stay, at most so many times."""
        for _ in range(rounds):
            predicted = predict(self.model, self.hiding, aligned.values, self.boxes.times_s)
            sightings = self._match(predicted, self._close_gates(aligned, predicted))
            before, aligned = aligned.sightings, self._fitted(sightings, aligned.values, unknowns, tied=tied)
            was, now = (seen.detection * len(self.model.hulls_m) + seen.vessel for seen in (before, sightings))
            if len(np.setxor1d(was, now)) <= SAME * max(len(sightings), 1):
                break
        return aligned

    def matched(self, aligned: Alignment) -> Alignment:
        """The matches of the detections with the values of another alignment, and no fit."""
        predicted = predict(self.model, self.hiding, aligned.values, self.boxes.times_s)
        sightings = self._match(predicted, self._close_gates(aligned, predicted))
        return self._fitted(sightings, aligned.values, self._unknowns(()), tied=False)

    def _unknowns(self, names: tuple[str, ...]) -> Unknowns:
        chosen = tuple(name for name in names if name in self.free)
        return Unknowns(chosen, np.zeros(3), np.empty(0, dtype=np.int64))

    def all_unknowns(self) -> Unknowns:
        """All shared ones that may change."""
        return self._unknowns(SHARED_NAMES)

    def _match(self, predicted: Predictions, gates_px: Array) -> Sightings:
        return match(self.boxes, predicted, self.model.traffic.camera.intrinsics.image_size_px, gates_px)

    def _fitted(
        self, sightings: Sightings, start: Values, unknowns: Unknowns, *, tied: bool, most: int | None = None
    ) -> Alignment:
        residuals = SightingResiduals.of(sightings, use_sizes=self.use_sizes)
        values = start
        for _ in range(2 if most else 1):  # the spreads follow from the residuals, which follow from the fit
            spreads = residuals.spreads_px(np.nan_to_num(residuals.px(self.model, values), nan=0.0))
            if len(residuals.row) < MIN_FIT or not unknowns.shared:
                break
            values = fit(self.model, residuals, values, unknowns, spreads, tied=tied, most=most)
        return Alignment(values, sightings, residuals, spreads)

    def _close_gates(self, aligned: Alignment, predicted: Predictions) -> Array:
        """Gates from the spreads of the residuals of centres and waterlines, which grow with size, shape (m, 2)."""
        residuals, gates = aligned.residuals, np.empty((len(predicted.frame), 2))
        px = np.abs(np.nan_to_num(residuals.px(self.model, aligned.values), nan=0.0))
        for axis, kind in enumerate((KINDS.index("centre"), KINDS.index("waterline"))):
            rows: Indices = np.flatnonzero(residuals.kind == kind)
            typical = np.median(px[rows] / usual_px(residuals.size_px[rows])) if len(rows) else 1.0
            gates[:, axis] = SPREADS * MAD_TO_STD * max(typical, 0.5) * usual_px(sizes(predicted.boxes_px)[:, axis])
        return gates


def usual_px(size_px: Array) -> Array:
    """The usual size of box errors, in pixels, of boxes of a width or height."""
    return 1 + 0.05 * size_px
