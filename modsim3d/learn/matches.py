"""Data of the estimators of a detector's parameters: annotations and detections, matched, state by state."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property

import numpy as np
from scipy import optimize

from modsim3d.core.arrays import Array, Columns, Indices, Mask
from modsim3d.core.boxes import centres, errors_between, move, sizes
from modsim3d.detector.false_positive_placement import depths_px, sea_levels
from modsim3d.formats.labelled import EVERYWHERE, LabelledSet
from modsim3d.formats.matching import Matching, Rule
from modsim3d.learn.box_errors.fit import ErrorFit, fit_errors, fit_without_gate
from modsim3d.learn.box_errors.matched_edges import ErrorModel, MatchedEdges, Unit, fit_student_t
from modsim3d.learn.match_types import BoxTypes, counted_as
from modsim3d.learn.persistence import Steps, frame_interval_s, steps_between

# ---- The likeliest distribution of each kind for the box errors of a state ----

_REGULAR = 1e-8
_MIN_RATIO = 1e-6
_MIN_SHARE, _MEAN_TO_STD = 0.05, np.sqrt(np.pi / 2)


@dataclass(frozen=True, eq=False)
class ErrorFits:
    """Distributions of the box errors of some boxes, each fitted when it is first asked for."""

    edges: MatchedEdges
    _found: dict[tuple[Unit, bool], ErrorFit | None] = field(default_factory=dict)
    _again: dict[Unit, ErrorFit] = field(default_factory=dict)

    def fit(self, unit: Unit, heavy: bool = False, least: float = -np.inf) -> ErrorFit | None:
        """The likeliest law of a kind, or None; one that surely misses the asked log-likelihood is not fitted on."""
        if (unit, heavy) not in self._found:
            start = self._start(unit, heavy) if len(self.edges) else None
            self._found[unit, heavy] = None if start is None else fit_errors(start, self.edges, least)
        return self._found[unit, heavy]

    def likeliest_normal(self, unit: Unit) -> ErrorFit | None:
        """Likeliest normal errors that were found, perhaps not settled; begun from Student's t too if that settles."""
        fit, heavy = self.fit(unit), self._found.get((unit, True))
        if fit is None or fit.settled:
            return fit
        if unit not in self._again and heavy is not None:
            self._again[unit] = again = fit_errors(replace(heavy.model, freedom=np.inf), self.edges)
            if again.settled:
                self._found[unit, False] = again
        again = self._again.get(unit, fit)
        return again if again.settled or again.value > fit.value else fit

    def chosen(self, unit: Unit, heavy: bool = False) -> ErrorFit | None:
        """Fit; where so many boxes fail the matching that it has no maximum, as if matching cut off nothing."""
        fit = self.fit(unit, heavy)
        if fit is None or fit.settled:
            return fit
        start = self._start(unit, heavy)
        if start is not None:
            self._found[unit, heavy] = fit = fit_without_gate(start, self.edges)
        return fit

    def value(self, unit: Unit, heavy: bool = False, least: float = -np.inf) -> float:
        """Log-likelihood of the likeliest distribution of a kind, −∞ where there is none or it is below the least."""
        fit = self.fit(unit, heavy, least)
        return -np.inf if fit is None or not fit.settled else fit.value

    def unclipped(self, relative: bool) -> Array:
        """Errors of the boxes of which all edges are known, else of all, in pixels or sides, shape (m, 4)."""
        edges, chosen = self.edges, self.edges.unclipped
        return edges.errors_px[chosen] / (edges.sides_px[chosen] if relative else 1.0)

    def _start(self, unit: Unit, heavy: bool) -> ErrorModel | None:
        """A distribution near the likeliest one; None where errors are too few or determine each other."""
        if unit == "mixed":
            return self._start_of_mixed(heavy)
        errors = self.unclipped(unit == "relative")
        if not _regular(errors):
            return None
        if not heavy:
            return ErrorModel.of_moments(errors.mean(axis=0), np.cov(errors.T, bias=True), unit)
        student_t = fit_student_t(errors)
        if student_t is None:
            return None
        return ErrorModel.of_moments(student_t.mean, student_t.covariance, unit, student_t.degrees_of_freedom)

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
            line, _ = optimize.nnls(sides, _MEAN_TO_STD * np.abs(edges.errors_px[chosen, k] - model.mean[k]))
            std[k], growth[k] = max(line[0], _MIN_SHARE * model.std[k]), line[1]
        return replace(model, std=std, growth=growth, unit="mixed", floor=_MIN_SHARE * model.std)

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
        mean, std = model.at(self.edges.sides_px[self.edges.unclipped])
        return (self.edges.errors_px[self.edges.unclipped] - mean) / std


def _regular(errors: Array) -> bool:
    """Whether errors (n, 4) have a covariance that is not singular."""
    if len(errors) < 2:
        return False
    matrix = np.cov(errors.T)
    std = np.sqrt(np.diag(matrix))
    if not np.all(std > _MIN_RATIO * std.max()):
        return False
    return bool(np.linalg.eigvalsh(matrix / np.outer(std, std))[0] > _REGULAR)


# ---- Annotations that were detected, with the errors of their boxes ----


class ErrorSource(Enum):
    """Pairs from which a state's box error is learned: the first set that has enough with all sides in the image."""

    OWN_STATE = "pairs of the state"
    ALL_STATES = "pairs of all states"
    ALL_PAIRS = "pairs of all states, with sides that the image's edge cuts as they were measured"


@dataclass(frozen=True, eq=False)
class Pairs:
    """Annotations that were detected: their rows, images, states and confidences, shapes (m,)."""

    rows: Indices
    image: Indices
    state: Indices
    confidence: Array
    annotated_px: Array  # annotated box, x_min, y_min, x_max, y_max, shape (m, 4)
    error_px: Array  # e_x, e_y, e_w, e_h of the detected box, shape (m, 4)
    image_px: Array  # width and height of the image, NaN where unknown, shape (m, 2)
    rule: Rule  # by which they match
    unsure: Mask | None = None  # whether the annotated box tells nothing of box errors; None if that is so of none
    _fits: dict[tuple[ErrorSource, int], ErrorFits] = field(default_factory=dict)

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.rows)

    @cached_property
    def sides_px(self) -> Array:
        """Width, height, width, height, at least a pixel: what relative errors are relative to; shape (m, 4)."""
        return np.tile(np.maximum(sizes(self.annotated_px), 1.0), 2)

    @cached_property
    def edges(self) -> MatchedEdges:
        """Evidence of each edge of the boxes on their errors."""
        boxes_px = move(self.annotated_px, self.error_px)
        edges = MatchedEdges.of(self.annotated_px, boxes_px, self.image_px, self.image, self.rule)
        return edges if self.unsure is None else edges.without(self.unsure)

    @property
    def sure(self) -> Mask:
        """Mask of the annotated boxes that tell something of box errors, shape (n,); all if fewer than two do."""
        unsure = np.zeros(len(self), dtype=bool) if self.unsure is None else self.unsure
        return ~unsure if np.count_nonzero(~unsure) > 1 else np.ones(len(self), dtype=bool)

    def errors(self, chosen: Mask, relative: bool) -> Array:
        """Errors of some rows in pixels, or in sides of the box, shape (chosen, 4)."""
        return self.error_px[chosen] / (self.sides_px[chosen] if relative else 1.0)

    def fits(self, source: ErrorSource, state: int) -> ErrorFits:
        """Distributions of the errors that those of a state are learned from."""
        key = (source, state if source is ErrorSource.OWN_STATE else -1)
        if key not in self._fits:
            usable = self.edges.usable
            if source is ErrorSource.ALL_PAIRS:
                edges = self.edges.take(self.sure).as_measured()
            else:
                edges = self.edges.take(usable & (self.state == state) if source is ErrorSource.OWN_STATE else usable)
            self._fits[key] = ErrorFits(edges)
        return self._fits[key]


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Annotations that are to be detected, and what became of them at a least confidence. Images have a state, −1 for
    none, (I,). `without` are the models of `learned.RICHER` left out."""

    labelled: LabelledSet
    matched: Matching
    states: tuple[str, ...]
    image_state: Indices
    threshold: float
    without: frozenset[str] = frozenset()

    @cached_property
    def kinds(self) -> BoxTypes:
        """Types that detections count as: second boxes, parts of vessels and boxes around two are told from others."""
        return counted_as(self.labelled, self.matched, self.image_state >= 0, self.without)

    @cached_property
    def rows(self) -> Indices:
        """Rows of the annotations that count, shape (n,)."""
        return np.flatnonzero(self.matched.sought & (self.image_state[self.labelled.annotations.image] >= 0))

    @cached_property
    def detection(self) -> Indices:
        """Row of the result that detects each annotation, −1 where none does, shape (n,)."""
        return self.kinds.detection[self.rows]

    @cached_property
    def in_merged_box(self) -> Mask:
        """Whether each annotation is in the box of another one, so that nobody knows if it was missed, shape (n,)."""
        return self.kinds.in_merged_box[self.rows]

    @cached_property
    def false(self) -> Indices:
        """Rows of the results that are false positives, second boxes and parts of vessels included, shape (f,)."""
        return self.kinds.false

    @cached_property
    def false_positives(self) -> Indices:
        """Rows of the false positives that are neither a second box nor a part of a vessel, shape (g,)."""
        return self.kinds.false_positives

    @cached_property
    def found(self) -> Indices:
        """Places of the annotations that have a detection of their own; of two in one box the larger, shape (m,)."""
        return np.flatnonzero(self.detection >= 0)

    @cached_property
    def true(self) -> Indices:
        """Rows of the results that are the one detection of an annotation, or of two in one box, shape (m,)."""
        return np.sort(self.detection[self.detection >= 0])

    @cached_property
    def unambiguous(self) -> Mask:
        """Whether each annotation, if missed, would be known to be, (n,): larger ones may hide it where boxes merge."""
        return ~self.kinds.ambiguous[self.rows]

    @cached_property
    def false_sightings(self) -> FalseSightings:
        """The false positives with their places relative to the horizon."""
        return FalseSightings.of(self)

    @cached_property
    def image(self) -> Indices:
        """Image of each annotation, shape (n,)."""
        return self.labelled.annotations.image[self.rows]

    @cached_property
    def state(self) -> Indices:
        """State in the image of each annotation, shape (n,)."""
        return self.image_state[self.image]

    @cached_property
    def label(self) -> Indices:
        """True label of each annotation, shape (n,)."""
        return self.labelled.annotations.label[self.rows]

    @cached_property
    def thing(self) -> Indices:
        """Number of the thing that each annotation is of, in its sequence, −1 where it has no identity, shape (n,)."""
        identity = self.labelled.annotations.identity[self.rows]
        keys = np.column_stack([self.labelled.images.sequence[self.image], identity])
        number: Indices = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
        return np.where(identity >= 0, number, -1)

    @cached_property
    def missed(self) -> Mask:
        """Whether each annotation was missed, shape (n,)."""
        return (self.detection < 0) & ~self.in_merged_box

    @cached_property
    def detected_label(self) -> Indices:
        """Label that each annotation was detected as, k where it has no box of its own, shape (n,)."""
        labels, k = self.labelled.results.label, len(self.labelled.labels)
        label = labels[self.detection] if len(labels) else np.zeros(len(self.rows), dtype=np.int64)
        return np.where(self.detection < 0, k, label)

    @cached_property
    def steps(self) -> Steps:
        """Consecutive annotations of the same thing, of those that are unambiguous, as places among `rows`."""
        place = np.flatnonzero(self.unambiguous)
        steps = steps_between(self.labelled, self.rows[place])
        return Steps(place[steps.earlier], place[steps.later], steps.apart_s)

    @cached_property
    def pairs(self) -> Pairs:
        """Annotations that were detected by a box of their own, with the errors of the detected boxes."""
        place = self.found[self.kinds.one_vessel[self.detection[self.found]]]
        rows, detection = self.rows[place], self.detection[place]
        annotations, results = self.labelled.annotations, self.labelled.results
        image, box_px = annotations.image[rows], annotations.boxes_px[rows]
        return Pairs(
            rows,
            image,
            self.image_state[image],
            results.confidence[detection],
            box_px,
            errors_between(results.boxes_px[detection], box_px),
            self.labelled.images.sizes_px[image],
            self.matched.rule,
            None if annotations.unsure_box is None else annotations.unsure_box[rows],
        )


# ---- What the times of frames say ----

_USUAL_RUNS = 24


def usual_run_s(observed: Outcomes) -> float:
    """Length of runs of frames in which misses that persist look independent; 0 where frames are not consecutive."""
    times = observed.labelled.images.time_s
    if not len(observed.steps):
        return 0.0
    return float(np.nanmax(times) - np.nanmin(times)) / _USUAL_RUNS


def kept_share(observed: Outcomes, correlation_s: float) -> float:
    """Share of noise with a correlation time, 0 if it does not persist, that is kept from one frame to the next."""
    return float(np.exp(-frame_interval_s(observed.labelled) / correlation_s)) if correlation_s > 0 else 0.0


# ---- False positives as seen by a camera whose horizon may be known ----

_EDGE_PX = 1.0


@dataclass(frozen=True, eq=False)
class FalseSightings(Columns):
    """The n false positives of a labelled set, ordered by image."""

    image: Indices  # shape (n,)
    boxes_px: Array  # x_min, y_min, x_max, y_max, shape (n, 4)
    image_px: Array  # width and height of the image, NaN where unknown, shape (n, 2)
    half_planes: Array  # the sea's side of the horizon in the image, everywhere where unknown, shape (n, 3)
    known: Mask  # whether the image has a horizon that is known, shape (n,)

    @classmethod
    def of(cls, observed: Outcomes) -> FalseSightings:
        """False positives of a labelled set."""
        results, images = observed.labelled.results, observed.labelled.images
        rows = observed.false_positives
        image = results.image[rows]
        given = images.half_planes[image]
        known: Mask = np.asarray(np.isfinite(given).all(axis=1) & given[:, :2].any(axis=1))  # see `EVERYWHERE`
        sea = np.where(known[:, None], given, EVERYWHERE)
        return cls(image, results.boxes_px[rows], images.sizes_px[image], sea, known)

    @cached_property
    def centres_px(self) -> Array:
        """Shape (n, 2)."""
        return centres(self.boxes_px)

    @cached_property
    def sizes_px(self) -> Array:
        """Width and height, at least a pixel, shape (n, 2)."""
        return np.maximum(sizes(self.boxes_px), 1.0)

    @cached_property
    def depth_px(self) -> Array:
        """Distance of the centre below the horizon, shape (n,)."""
        return depths_px(self.half_planes, self.centres_px)

    @cached_property
    def along_px(self) -> Array:
        """Distance of the centre from the left edge along the horizon, shape (n,)."""
        flat = np.hypot(self.half_planes[:, 0], self.half_planes[:, 1])
        cosine = np.abs(self.half_planes[:, 1]) / np.where(flat > 0, flat, 1.0)
        return self.centres_px[:, 0] / np.where(cosine > 0, cosine, 1.0)

    @cached_property
    def places_px(self) -> tuple[Array, Array]:
        """First and last row of the image in which the centre may lie, shapes (n,); the image's edge cuts boxes."""
        row = self.centres_px[:, 1]
        return np.where(self.cut[:, 1], 0.0, row), np.where(self.cut[:, 3], self.image_px[:, 1], row)

    @cached_property
    def cut(self) -> Mask:
        """Whether the left, upper, right and lower side lies on the image's edge, shape (n, 4)."""
        with np.errstate(invalid="ignore"):
            far: Mask = self.boxes_px[:, 2:] >= self.image_px - _EDGE_PX
        near: Mask = self.boxes_px[:, :2] <= _EDGE_PX
        return np.concatenate([near, far], axis=1)

    @cached_property
    def whole(self) -> Mask:
        """Whether no edge cuts the box, nor its level below the horizon between the left and the right edge, (n,)."""
        (a, b, _), (x, y) = self.half_planes.T, self.centres_px.T
        with np.errstate(divide="ignore", invalid="ignore"):
            left, right = y + a / b * x, y + a / b * (x - self.image_px[:, 0])
            outside = (np.minimum(left, right) < 0) | (np.maximum(left, right) > self.image_px[:, 1])
        return np.asarray(~outside & ~self.cut.any(axis=1))

    @cached_property
    def levels(self) -> tuple[Array, Array, Indices]:
        """Depths and widths of the sea in distinct images of known size, (k, nodes), and which is each row's, (n,)."""
        distinct, row = np.unique(np.column_stack([self.half_planes, self.image_px]), axis=0, return_inverse=True)
        depth, width = np.empty((len(distinct), 0)), np.empty((len(distinct), 0))
        for size in np.unique(distinct[:, 3:], axis=0):
            of_size = (distinct[:, 3:] == size).all(axis=1)
            some = sea_levels(distinct[of_size, :3], (int(size[0]), int(size[1])))
            if not depth.shape[1]:
                depth, width = (np.empty((len(distinct), nodes.shape[1])) for nodes in some)
            depth[of_size], width[of_size] = some
        return depth, width, row.ravel()

    @cached_property
    def areas(self) -> Array:
        """Area of the sea above each level of each distinct image, shape (k, nodes)."""
        depth, width, _ = self.levels
        pieces = (width[:, 1:] + width[:, :-1]) / 2 * np.diff(depth, axis=1)
        return np.concatenate([np.zeros((len(depth), 1)), np.cumsum(pieces, axis=1)], axis=1)

    @cached_property
    def level_px(self) -> Array:
        """The depth in one image of the set at which as much of the sea lies above as above each row, shape (n,)."""
        (depth, _, row), area = self.levels, self.areas
        if not len(depth):
            return np.empty(0)
        share = area / np.maximum(area[:, -1:], 1e-9)
        reference = int(np.argsort(area[:, -1])[len(area) // 2])
        result = np.empty(len(self))
        order = np.argsort(row, kind="stable")
        for rows in np.split(order, np.flatnonzero(np.diff(row[order])) + 1):
            k = row[rows[0]]
            above = np.interp(self.depth_px[rows], depth[k], share[k])
            result[rows] = np.interp(above, share[reference], depth[reference])
        return result
