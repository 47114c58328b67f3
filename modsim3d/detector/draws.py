"""From uniform numbers to draws: which number belongs to what, and inverse distribution functions. All of it works
element by element. A matrix product may round differently with the number of rows, and how a run is split into chunks
must not show in its output. What comes from a logarithm, an exponential or a quantile is rounded at once (`on_grid`),
so that the processor does not show either."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal, NamedTuple, Protocol

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Indices, Mask, read_only
from modsim3d.core.random_streams import Purpose, Streams, grid_normals, on_grid
from modsim3d.detector.records import CameraFrames, Targets

# ---- The distribution of box errors in a performance state ----

ERROR_NORMALS = 4  # standard normal numbers that every box error is made from: one for each component
ErrorUnit = Literal["px", "relative", "mixed"]


class ErrorDistribution(Protocol):
    """A law of standardised errors, with mean zero and covariance one: four independent standard normal numbers times
    one random scale. `keys` are its own keys in a detector file's `box_error`: its fields."""

    keys: ClassVar[tuple[str, ...]]

    @property
    def extra_normals(self) -> int:
        """Normal numbers that the scale is made from."""

    def scales(self, extra: Array) -> Array:
        """Scales from independent standard normal numbers of shape (..., extra), shape (...)."""


@dataclass(frozen=True)
class Normal:
    """The multivariate normal distribution (Jessen & Mohr (2023), section 7.6.2)."""

    keys: ClassVar[tuple[str, ...]] = ()
    extra_normals = 0

    def scales(self, extra: Array) -> Array:
        """One, shape (...)."""
        return np.ones(extra.shape[:-1])


@dataclass(frozen=True)
class StudentT:
    """The multivariate t distribution of ν > 2 degrees of freedom, scaled to have the identity as covariance: a normal
    number times √((ν − 2) / w), with w chi-square of ν degrees of freedom and common to the four components."""

    degrees_of_freedom: float

    keys: ClassVar[tuple[str, ...]] = ("degrees_of_freedom",)
    extra_normals = 1

    def scales(self, extra: Array) -> Array:
        """From one normal number each, read as its probability and that as the quantile of w, shape (...)."""
        chi_square = 2 * special.gammaincinv(self.degrees_of_freedom / 2, special.ndtr(extra[..., 0]))
        return np.asarray(np.sqrt((self.degrees_of_freedom - 2) / chi_square))


def standardised(distribution: ErrorDistribution, latent: Array) -> Array:
    """Standardised errors from normal numbers of shape (..., at least 4 + extra), shape (..., 4)."""
    normal, extra = latent[..., :ERROR_NORMALS], distribution.extra_normals
    if not extra:
        return normal
    return normal * on_grid(distribution.scales(latent[..., ERROR_NORMALS : ERROR_NORMALS + extra]))[..., None]


ERROR_DISTRIBUTIONS: Mapping[str, type[ErrorDistribution]] = {"normal": Normal, "student_t": StudentT}
"""By the name that `box_error.law` has in a detector file."""


def size_factors(sizes_px: Array, relative: Mask | bool, growths: Array) -> tuple[Array, Array]:
    """Factors on box errors and on their distance from the mean by the size (..., 2) of the true box, at least a pixel;
    shapes (..., 4). Errors that are relative are in sides of the box. `growths` are k over σ₀ of `mixed` errors, whose
    standard deviation is σ₀ + k·side, in 1/px; 0 for others. Both are broadcast with shape (..., 4)."""
    sides = np.concatenate([sizes_px, sizes_px], axis=-1)
    return np.where(relative, sides, 1.0), 1 + growths * sides


@dataclass(frozen=True, eq=False)
class BoxErrorLaw:
    """The distribution of (e_x, e_y, e_w, e_h) before degenerate boxes are resampled. The unit is `px`; `relative`, in
    sides of the box; or `mixed`, in pixels with standard deviations that grow."""

    mean: Array  # in pixels, or in sides of the box if relative, shape (4,)
    covariance: Array  # in the square of the mean's unit, symmetric, positive semi-definite, shape (4, 4)
    unit: ErrorUnit = "px"
    growth: Array = field(default_factory=lambda: read_only(np.zeros(4)))  # of mixed spreads, px per px of the side
    distribution: ErrorDistribution = field(default_factory=Normal)  # of standardised errors

    @property
    def relative(self) -> bool:
        """Whether errors are in sides of the box."""
        return self.unit == "relative"

    @property
    def std(self) -> Array:
        """Standard deviations in the mean's unit, shape (4,)."""
        return np.sqrt(np.diag(self.covariance))


_LN_2 = math.log(2)
_MAX_COUNTED = 16


def keyed_uniforms(
    streams: Streams, purpose: Purpose, frames: CameraFrames, frame: Indices, owner: Indices, owners: Sequence[str]
) -> Array:
    """Uniform numbers, (n, width of the purpose), of a camera, an owner (a vessel, say) and a step, given the index of
    each row into the frames and into `owners`, shapes (n,)."""
    if not len(frame):
        return np.empty((0, purpose.uniforms))
    return streams.uniforms_of(purpose, frames.camera, owners=owners, owner=owner, steps=frames.steps[frame])


def step_uniforms(streams: Streams, purpose: Purpose, *names: str, steps: Indices) -> Array:
    """Uniform numbers that belong to names and a step, shape (n, width of the purpose), at steps (n,) in any order."""
    if not len(steps):
        return np.empty((0, purpose.uniforms))
    first, last = int(steps.min()), int(steps.max())
    return streams.uniforms(purpose, *names, first=first, count=last - first + 1)[steps - first]


def target_uniforms(streams: Streams, purpose: Purpose, frames: CameraFrames, targets: Targets) -> Array:
    """Uniform numbers of each target's vessel at its step, shape (n, width of the purpose)."""
    return keyed_uniforms(streams, purpose, frames, targets.frame, targets.vessel, targets.vessel_ids)


class LatentPurposes(NamedTuple):
    """Streams of the normal numbers behind box errors: four for the error, and those that its distribution adds."""

    error: Purpose
    shape: Purpose

    def widths(self, extra: int) -> dict[Purpose, int]:
        """Count of the numbers that each stream gives if the distribution adds `extra`."""
        return {self.error: ERROR_NORMALS} | ({self.shape: extra} if extra else {})


BOX_ERROR_STREAMS = LatentPurposes(Purpose.BOX_ERROR, Purpose.BOX_ERROR_SHAPE)
BOX_ERROR_REDRAW_STREAMS = LatentPurposes(Purpose.BOX_ERROR_REDRAW, Purpose.BOX_ERROR_REDRAW_SHAPE)
DUPLICATE_STREAMS = LatentPurposes(Purpose.DUPLICATE, Purpose.DUPLICATE_SHAPE)
DUPLICATE_REDRAW_STREAMS = LatentPurposes(Purpose.DUPLICATE_REDRAW, Purpose.DUPLICATE_REDRAW_SHAPE)


def latent_normals(
    streams: Streams, purposes: LatentPurposes, frames: CameraFrames, targets: Targets, extra: int
) -> Array:
    """Independent standard normal numbers behind the box error of each target, shape (n, 4 + extra)."""
    parts = [target_uniforms(streams, purpose, frames, targets) for purpose in purposes.widths(extra)]
    return grid_normals(np.concatenate(parts, axis=1))


def select(targets: Targets, rows: Indices) -> Targets:
    """The targets of rows of shape (k,)."""
    columns = ("frame", "vessel", "label", "boxes_px", "visible_fraction", "depth_m")
    return replace(targets, **{name: getattr(targets, name)[rows] for name in columns})


def log2(values: Array) -> Array:
    """Logarithm to base two on the grid, same shape."""
    return on_grid(special.xlogy(1.0, values) / _LN_2)


def cumulative(probabilities: Array) -> Array:
    """Distribution function along the last axis, same shape; its last entry is exactly one."""
    sums: Array = np.cumsum(probabilities, axis=-1)
    return sums / sums[..., -1:]


def low_uniforms(uniforms: Array) -> Array:
    """Two more uniform numbers from each of n, out of the binary digits that a choice does not need, shape (n, 2)."""
    return uniforms[:, None] * [2.0**20, 2.0**36] % 1


def choose(distribution: Array, uniforms: Array) -> Indices:
    """Inverse of distribution functions (n, k) or (k,) from `cumulative` at uniform numbers (n,): indices (n,), of
    which none has probability zero."""
    chosen: Indices = (uniforms[:, None] >= distribution).sum(axis=-1, dtype=np.int64)
    return chosen  # np.asarray would be one more call a step


def poisson_quantile(uniforms: Array, mean: Array) -> Indices:
    """Least k with Pr(Poisson(mean) <= k) >= u; 0 where the mean is 0. Shapes (n,)."""
    counts = np.zeros(len(uniforms), dtype=np.int64)
    some = (mean > 0).nonzero()[0]
    for _ in range(_MAX_COUNTED):  # to count up is faster than the inverse, and enough for most
        if not len(some):
            return counts
        some = some[special.pdtr(counts[some], mean[some]) < uniforms[some]]
        counts[some] += 1
    u, m = uniforms[some], mean[some]
    upper = np.ceil(special.pdtrik(u, m))
    lower = np.maximum(upper - 1, 0)
    # The continuous inverse can land a hair above an integer: look one lower, as scipy.stats does.
    counts[some] = np.where(special.pdtr(lower, m) >= u, lower, upper)
    return counts
