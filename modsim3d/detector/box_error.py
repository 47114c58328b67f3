"""Box errors: the truth with an error, resampled where the box would degenerate."""

from __future__ import annotations

import functools
import itertools
import math
from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Indices, Mask, read_only
from modsim3d.core.boxes import at_least_a_pixel, clip, inside_image, move, sizes
from modsim3d.core.errors import ModsimError
from modsim3d.core.random_streams import Streams, grid_normals
from modsim3d.detector.draws import (
    BOX_ERROR_REDRAW_STREAMS,
    ErrorDistribution,
    LatentPurposes,
    size_factors,
    standardised,
)
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import CameraFrames, Targets

MAX_DRAWS = 10_000  # draws of the error of one box before its state counts as impossible for it
_FIRST_DRAWS, _MIN_DRAWS, _DRAWS_AT_ONCE = 4, 2, 2048  # of a box, of a box, of all boxes: they fit a cache
_SWEEPS = 10  # twice what four rows need


@dataclass(frozen=True, eq=False)
class MisplacedBoxes:
    """Boxes with their errors."""

    boxes_px: Array  # inside the image, at least one pixel wide and high, shape (n, 4)
    errors_px: Array  # what was added to centre, width and height before clipping, shape (n, 4)
    redrawn: Mask  # whether the first draw was degenerate and was resampled, shape (n,)


@dataclass(frozen=True, eq=False)
class TrueBoxes:
    """Boxes (n, 4) of n detected vessels before errors, at least a pixel wide and high, and their `state`, (n,)."""

    frames: CameraFrames
    targets: Targets
    state: Indices
    boxes_px: Array

    @classmethod
    def of(cls, frames: CameraFrames, states: Indices, targets: Targets) -> TrueBoxes:
        """The boxes of targets, given the state of each of S frames, shape (S,)."""
        return cls(frames, targets, states[targets.frame], at_least_a_pixel(targets.boxes_px, frames.image_size_px))


def symmetric_root(covariance: Array) -> Array:
    """The symmetric S with S · S = covariance, shapes (4, 4); unlike a Cholesky factor it allows singular ones. By
    Jacobi's rotations (Golub & Van Loan (2013), "Matrix Computations", section 8.5): they need no more than sums,
    products, quotients and square roots, so the root has the same bits everywhere, which a library's has not."""
    return _symmetric_root(tuple(map(tuple, covariance.tolist())))


@functools.lru_cache(maxsize=64)
def _symmetric_root(rows: tuple[tuple[float, ...], ...]) -> Array:
    """As `symmetric_root`, in lists, which are faster for so few numbers; read-only."""
    matrix, vectors = list(map(list, rows)), np.eye(len(rows)).tolist()
    for p, q in list(itertools.combinations(range(len(matrix)), 2)) * _SWEEPS:
        cosine, sine = _rotation(matrix[p][p], matrix[q][q], matrix[p][q])
        for row in (*matrix, *vectors):
            row[p], row[q] = cosine * row[p] - sine * row[q], sine * row[p] + cosine * row[q]
        pairs = list(zip(matrix[p], matrix[q], strict=True))
        matrix[p] = [cosine * one - sine * other for one, other in pairs]
        matrix[q] = [sine * one + cosine * other for one, other in pairs]
    roots = np.sqrt(np.maximum(np.diag(matrix), 0))
    terms = [root * column[:, None] * column for root, column in zip(roots, np.array(vectors).T, strict=True)]
    return read_only(sum(terms[1:], terms[0]))


def _rotation(first: float, second: float, between: float) -> tuple[float, float]:
    """Cosine and sine of the rotation that makes a symmetric matrix of two rows diagonal."""
    if between == 0:
        return 1.0, 0.0
    ratio = (second - first) / (2 * between)
    tangent = math.copysign(1 / (abs(ratio) + math.sqrt(ratio * ratio + 1)), ratio)
    cosine = 1 / math.sqrt(tangent * tangent + 1)
    return cosine, tangent * cosine


@dataclass(frozen=True, eq=False)
class BoxErrorSource:
    """Draws the box errors of a detector. An error is the mean plus the root of the covariance times a standardised
    error. `relative` errors are multiplied by the side of the box along their axis; `mixed` ones have a standard
    deviation σ₀ + k·side. Draws that leave less than a pixel of the box, clipped to the image, are resampled, so the
    errors of small boxes and of boxes at the edge do not have exactly the distribution in the file. A true side below
    one pixel is replaced by the whole pixel that contains its middle: otherwise a detector without errors could never
    see a vessel half a pixel high."""

    state_names: tuple[str, ...]
    means: Array  # in pixels, or in sides where relative, shape (states, 4)
    roots: Array  # symmetric roots of the covariances, shape (states, 4, 4)
    relative: Mask  # whether each state's errors are in sides of the box, shape (states,)
    growths: Array  # k over σ₀, in 1/px, for mixed states and else 0, shape (states, 4)
    distributions: tuple[ErrorDistribution, ...]

    @classmethod
    def from_model(cls, model: DetectorModel) -> BoxErrorSource:
        """The box errors of a detector model."""
        laws = [state.box_error for state in model.states]
        growth = np.array([law.growth for law in laws])
        return cls(
            tuple(state.name for state in model.states),
            read_only([law.mean for law in laws]),
            read_only([symmetric_root(law.covariance) for law in laws]),
            np.array([law.relative for law in laws]),
            read_only(growth / np.where(growth > 0, [law.std for law in laws], 1.0)),
            tuple(law.distribution for law in laws),
        )

    @property
    def extra_normals(self) -> int:
        """Normal numbers that an error needs beyond four, at most."""
        return max(distribution.extra_normals for distribution in self.distributions)

    @functools.cached_property
    def _one_distribution(self) -> bool:
        return len(set(self.distributions)) == 1

    def misplace(
        self, streams: Streams, true: TrueBoxes, latent: Array, purposes: LatentPurposes = BOX_ERROR_REDRAW_STREAMS
    ) -> MisplacedBoxes:
        """Add to each of n boxes an error made from standard normal numbers of shape (n, 4 + `extra_normals`). Raises
        ModsimError if a box stays degenerate in `MAX_DRAWS` draws."""
        image, truth = true.frames.image_size_px, true.boxes_px
        if not len(truth):
            return MisplacedBoxes(truth, truth, np.empty(0, dtype=bool))
        errors = self.errors_px(true.state, sizes(truth), latent)
        redrawn = ~inside_image(move(truth, errors), image)
        rows = np.flatnonzero(redrawn)
        errors[rows] = self._redraw(streams, purposes, true, rows)
        return MisplacedBoxes(clip(move(truth, errors), image), errors, redrawn)

    def errors_px(self, state: Indices, sizes_px: Array, latent: Array) -> Array:
        """Errors (n, ..., 4) from standard normal numbers (n, ..., 4 + `extra_normals`); see `draws` for why no `@`.
        States have shape (n,). Sizes are the width and height of the true boxes, at least a pixel, shape (n, 2)."""
        standard = self._standardised(state, latent)
        shape = (len(state), *([1] * (standard.ndim - 2)), 4)
        factor, spread = (array.reshape(shape) for array in self._size_factors(state, sizes_px))
        means, roots = self.means[state].reshape(shape), self.roots[state]
        errors = means
        for j in range(4):
            errors = errors + roots[:, :, j].reshape(shape) * standard[..., j, None]
        if self.growths.any():
            errors = np.where(spread > 1, means + spread * (errors - means), errors)
        return factor * errors

    def _size_factors(self, state: Indices, sizes_px: Array) -> tuple[Array, Array]:
        return size_factors(sizes_px, self.relative[state][:, None], self.growths[state])

    def _standardised(self, state: Indices, latent: Array) -> Array:
        """Standardised errors of each state's distribution, shape (n, ..., 4)."""
        if self._one_distribution:
            return standardised(self.distributions[0], latent)
        standard = np.empty((*latent.shape[:-1], 4))
        for index, distribution in enumerate(self.distributions):
            standard[state == index] = standardised(distribution, latent[state == index])
        return standard

    def moments_px(self, state: Indices, sizes_px: Array) -> tuple[Array, Array]:
        """Means (n, 4) and covariances (n, 4, 4) in pixels of errors before truncation. States have shape (n,), widths
        and heights of the true boxes (n, 2)."""
        factor, spread = self._size_factors(state, sizes_px)
        roots = (factor * spread)[:, :, None] * self.roots[state]
        return factor * self.means[state], roots @ np.swapaxes(roots, 1, 2)

    def in_file_units(self, state: Indices, sizes_px: Array, errors_px: Array) -> Array:
        """Undo what the size of a box does to its errors, so that they have the mean and covariance of the file. States
        have shape (n,), sizes (n, 2), errors and the result (n, ..., 4)."""
        if not (self.relative.any() or self.growths.any()):
            return errors_px
        shape = (len(state), *([1] * (errors_px.ndim - 2)), 4)
        factor, spread = (array.reshape(shape) for array in self._size_factors(state, sizes_px))
        means, scaled = self.means[state].reshape(shape), errors_px / factor
        return np.where(spread > 1, means + (scaled - means) / spread, scaled) if self.growths.any() else scaled

    def _redraw(self, streams: Streams, purposes: LatentPurposes, true: TrueBoxes, rows: Indices) -> Array:
        """Errors of some rows, (r, 4): the first acceptable draw of each row's own streams, so that others stay."""
        errors = np.empty((len(rows), 4))
        pending, drawn, draws = np.arange(len(rows)), 0, _FIRST_DRAWS
        while len(pending):
            left = rows[pending]
            if drawn == MAX_DRAWS:
                raise ModsimError(self._hopeless(true, left[0]))
            draws = min(max(min(draws, _DRAWS_AT_ONCE // len(left)), _MIN_DRAWS), MAX_DRAWS - drawn)
            latent = self._redrawn_normals(streams, purposes, true, left, drawn, draws)
            truth = true.boxes_px[left]
            candidates = self.errors_px(true.state[left], sizes(truth), latent)
            accepted = inside_image(move(truth[:, None], candidates), true.frames.image_size_px)
            success, first = accepted.any(axis=1), accepted.argmax(axis=1)
            errors[pending[success]] = candidates[success, first[success]]
            pending, drawn, draws = pending[~success], drawn + draws, 4 * draws
        return errors

    def _redrawn_normals(
        self, streams: Streams, purposes: LatentPurposes, true: TrueBoxes, rows: Indices, drawn: int, count: int
    ) -> Array:
        """Standard normal numbers of `count` redraws of some rows after those drawn, shape (r, count, 4 + extra)."""
        targets, frames = true.targets, true.frames
        owner, steps = targets.vessel[rows], frames.steps[targets.frame[rows]]
        parts = [
            streams.generated(
                purpose,
                frames.camera,
                owners=targets.vessel_ids,
                owner=owner,
                steps=steps,
                first=drawn * width,
                count=count * width,
            ).reshape(len(rows), count, width)
            for purpose, width in purposes.widths(self.extra_normals).items()
        ]
        return grid_normals(np.concatenate(parts, axis=2))

    def _hopeless(self, true: TrueBoxes, row: int) -> str:
        targets, frames, state = true.targets, true.frames, true.state[row]
        width, height = sizes(targets.boxes_px[row])
        mean = ", ".join(f"{value:g}" for value in self.means[state])
        step = int(frames.steps[targets.frame[row]])
        unit = "box sides" if self.relative[state] else "px"
        return (
            f"vessel '{targets.vessel_ids[targets.vessel[row]]}' at step {step} of camera '{frames.camera}': "
            f"in {MAX_DRAWS} draws of the box error of state '{self.state_names[state]}' (mean {mean} "
            f"{unit}) its box of {width:.4g} × {height:.4g} px never stays a pixel wide and high in the image; use "
            "a box_error that suits such boxes, or leave small ones out with the annotation's min_box_px"
        )
