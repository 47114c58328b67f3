"""Where the detector puts a box: normal errors, drawn anew where the box would degenerate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.detector.boxes import Mask, at_least_a_pixel, clip, move, sizes
from modsim3d.detector.draws import normals, target_uniforms
from modsim3d.detector.model import DetectorModel, read_only
from modsim3d.detector.records import Array, Frames, Indices, Targets
from modsim3d.errors import ModsimError
from modsim3d.random_streams import Streams

MOST_DRAWS = 10_000
"""Redraws of one box before its state is called impossible for it."""
_ROWS_AT_ONCE = 256
_FIRST_BATCH, _LARGEST_BATCH = 8, 2048
_ROUNDING_PX = 1e-9


@dataclass(frozen=True, eq=False)
class Misplaced:
    """Boxes with their errors.

    Attributes:
        boxes_px: Inside the image, at least one pixel wide and high, shape (n, 4).
        errors_px: What was added to centre, width and height before clipping, shape (n, 4).
        redrawn: Whether the first draw was degenerate, shape (n,).
    """

    boxes_px: Array
    errors_px: Array
    redrawn: Mask


def symmetric_root(covariance: Array) -> Array:
    """The symmetric S with S · S = covariance; singular ones have it too, unlike a Cholesky factor."""
    eigenvalues, vectors = np.linalg.eigh(covariance)
    root: Array = (vectors * np.sqrt(np.maximum(eigenvalues, 0))) @ vectors.T
    return root


@dataclass(frozen=True, eq=False)
class NormalBoxError:
    """Multivariate normal (e_x, e_y, e_w, e_h) in pixels (Jessen & Mohr (2023), section 7.6.2), truncated.

    A draw counts only if the box, clipped to the image, is at least one pixel wide and high; this rules out
    sides turned inside out and boxes outside the image. Others are drawn anew, so the errors of small boxes
    and of boxes at the edge do not have exactly the asked distribution. Two boundary cases:

    - A truth side below one pixel is taken for the whole pixel its middle is in, and the error added to
      that. Otherwise a detector without errors could never see a vessel half a pixel high.
    - A box at the edge is judged after clipping: a sliver thinner than a pixel is drawn anew as well.

    Attributes:
        state_names: For messages.
        means_px: Shape (states, 4).
        roots_px: Symmetric roots of the covariances, shape (states, 4, 4).
    """

    state_names: tuple[str, ...]
    means_px: Array
    roots_px: Array

    @classmethod
    def from_model(cls, model: DetectorModel) -> NormalBoxError:
        """The box error of a detector model."""
        roots = [symmetric_root(state.box_error_covariance_px2) for state in model.states]
        names = tuple(state.name for state in model.states)
        return cls(names, model.column("box_error_mean_px"), read_only(roots))

    def misplace(self, streams: Streams, frames: Frames, states: Indices, targets: Targets) -> Misplaced:
        """Boxes with an error each.

        Raises:
            ModsimError: A box stays degenerate in `MOST_DRAWS` draws.
        """
        image, state = frames.image_size_px, states[targets.frame]
        truth = at_least_a_pixel(targets.boxes_px, image)
        uniforms = target_uniforms(streams, "detector.box_error", frames, targets, width=4)
        errors = self._errors(state, normals(uniforms))
        redrawn = ~_acceptable(move(truth, errors), image)
        bad = np.flatnonzero(redrawn)
        for start in range(0, len(bad), _ROWS_AT_ONCE):
            rows = bad[start : start + _ROWS_AT_ONCE]
            errors[rows] = self._redraw(streams, frames, state, targets, truth, rows)
        return Misplaced(clip(move(truth, errors), image), errors, redrawn)

    def _errors(self, state: Indices, standard: Array) -> Array:
        """Errors in pixels from standard normal numbers of shape (n, ..., 4); see `draws` for why no `@`."""
        shape = (len(state), *([1] * (standard.ndim - 2)), 4)
        errors = np.broadcast_to(self.means_px[state].reshape(shape), standard.shape)
        for j in range(4):
            errors = errors + self.roots_px[state, :, j].reshape(shape) * standard[..., j, None]
        return errors

    def _redraw(
        self, streams: Streams, frames: Frames, state: Indices, targets: Targets, truth: Array, rows: Indices
    ) -> Array:
        """Errors of some rows, shape (r, 4): the first acceptable draw of each row's own generator."""
        generators = [_generator(streams, frames, targets, row) for row in rows]
        errors = np.empty((len(rows), 4))
        pending, drawn, batch = np.arange(len(rows)), 0, _FIRST_BATCH
        while len(pending):
            if drawn == MOST_DRAWS:
                raise ModsimError(self._hopeless(frames, state, targets, rows[pending[0]]))
            batch = min(batch, MOST_DRAWS - drawn)
            standard = np.stack([generators[i].standard_normal((batch, 4)) for i in pending])
            candidates = self._errors(state[rows[pending]], standard)
            accepted = _acceptable(move(truth[rows[pending], None], candidates), frames.image_size_px)
            found, first = accepted.any(axis=1), accepted.argmax(axis=1)
            errors[pending[found]] = candidates[found, first[found]]
            pending, drawn, batch = pending[~found], drawn + batch, min(4 * batch, _LARGEST_BATCH)
        return errors

    def _hopeless(self, frames: Frames, state: Indices, targets: Targets, row: int) -> str:
        width, height = sizes(targets.boxes_px[row])
        mean = ", ".join(f"{value:g}" for value in self.means_px[state[row]])
        step = int(frames.steps[targets.frame[row]])
        return (
            f"vessel '{targets.vessel_ids[targets.vessel[row]]}' at step {step} of camera '{frames.camera}': "
            f"in {MOST_DRAWS} draws of the box error of state '{self.state_names[state[row]]}' (mean {mean} "
            f"px) its box of {width:.4g} × {height:.4g} px never stays a pixel wide and high in the image; "
            "use a box_error that suits such boxes, or leave small ones out with the annotation's min_box_px"
        )


def _generator(streams: Streams, frames: Frames, targets: Targets, row: int) -> np.random.Generator:
    """The redraws of one row: a stream apart, so that the first draws of later steps stay as they were."""
    vessel = targets.vessel_ids[targets.vessel[row]]
    step = int(frames.steps[targets.frame[row]])
    return streams.generator("detector.box_error_redraw", frames.camera, vessel, step=step)


def _acceptable(boxes_px: Array, image_size_px: tuple[int, int]) -> Mask:
    large: Mask = sizes(clip(boxes_px, image_size_px)) >= 1 - _ROUNDING_PX
    return large[..., 0] & large[..., 1]
