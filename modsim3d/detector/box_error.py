"""Where the detector puts a box: normal errors, drawn anew where the box would degenerate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array, Indices, Mask, read_only
from modsim3d.boxes import at_least_a_pixel, clip, inside_image, move, sizes
from modsim3d.detector.model import DetectorModel
from modsim3d.detector.records import Frames, Targets
from modsim3d.errors import ModsimError
from modsim3d.random_streams import Purpose, Streams

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
    """Multivariate normal (e_x, e_y, e_w, e_h) (Jessen & Mohr (2023), section 7.6.2), truncated.

    The thesis has them in pixels. `relative` ones are multiplied by the side of the box along their axis; `mixed`
    ones have mean and correlation in pixels and a standard deviation σ₀ + k·side.

    A draw counts only if the box, clipped to the image, is at least one pixel wide and high; this rules out
    sides turned inside out and boxes outside the image. Others are drawn anew, so the errors of small boxes
    and of boxes at the edge do not have exactly the asked distribution. Two boundary cases:

    - A truth side below one pixel is taken for the whole pixel its middle is in, and the error added to
      that. Otherwise a detector without errors could never see a vessel half a pixel high.
    - A box at the edge is judged after clipping: a sliver thinner than a pixel is drawn anew as well.

    Attributes:
        state_names: For messages.
        means: In pixels, or in sides where relative, shape (states, 4).
        roots: Symmetric roots of the covariances, shape (states, 4, 4).
        relative: Whether each state's errors are in sides of the box, shape (states,).
        growths: k over σ₀, in 1/px, for mixed states and else 0, shape (states, 4).
    """

    state_names: tuple[str, ...]
    means: Array
    roots: Array
    relative: Mask
    growths: Array

    @classmethod
    def from_model(cls, model: DetectorModel) -> NormalBoxError:
        """The box error of a detector model."""
        roots = [symmetric_root(state.box_error_covariance_px2) for state in model.states]
        names = tuple(state.name for state in model.states)
        relative = np.array([state.box_error_unit == "relative" for state in model.states])
        stds = np.sqrt([np.diag(state.box_error_covariance_px2) for state in model.states])
        growth = model.column("box_error_growth")
        growths = read_only(growth / np.where(growth > 0, stds, 1.0))
        return cls(names, model.column("box_error_mean_px"), read_only(roots), relative, growths)

    def misplace(
        self,
        streams: Streams,
        frames: Frames,
        states: Indices,
        targets: Targets,
        standard: Array,
        purpose: Purpose = Purpose.BOX_ERROR_REDRAW,
    ) -> Misplaced:
        """Boxes with an error each.

        Args:
            streams: For what has to be drawn anew.
            frames: The frames.
            states: Of each frame, shape (S,).
            targets: Whose boxes; n of them.
            standard: The standard normal numbers that their errors are made from, shape (n, 4).
            purpose: Use of the numbers that are drawn anew.

        Raises:
            ModsimError: A box stays degenerate in `MOST_DRAWS` draws.
        """
        image, state = frames.image_size_px, states[targets.frame]
        truth = at_least_a_pixel(targets.boxes_px, image)
        errors = self.errors_px(state, sizes(truth), standard)
        redrawn = ~inside_image(move(truth, errors), image)
        bad = np.flatnonzero(redrawn)
        for start in range(0, len(bad), _ROWS_AT_ONCE):
            rows = bad[start : start + _ROWS_AT_ONCE]
            generators = [_generator(streams, purpose, frames, targets, row) for row in rows]
            errors[rows] = self._redraw(generators, frames, state, targets, truth, rows)
        return Misplaced(clip(move(truth, errors), image), errors, redrawn)

    def errors_px(self, state: Indices, sizes_px: Array, standard: Array) -> Array:
        """Errors from standard normal numbers; see `draws` for why no `@`.

        Args:
            state: Shape (n,).
            sizes_px: Width and height of the true boxes, at least a pixel, shape (n, 2).
            standard: Shape (n, ..., 4).
        """
        shape = (len(state), *([1] * (standard.ndim - 2)), 4)
        means = np.broadcast_to(self.means[state].reshape(shape), standard.shape)
        errors = means
        for j in range(4):
            errors = errors + self.roots[state, :, j].reshape(shape) * standard[..., j, None]
        sides = np.tile(sizes_px, 2).reshape(shape)
        grows = self.growths[state].reshape(shape)
        if np.any(self.growths):
            errors = np.where(grows > 0, means + (1 + grows * sides) * (errors - means), errors)
        if np.any(self.relative):
            errors = np.where(self.relative[state].reshape(*shape[:-1], 1), errors * sides, errors)
        return errors

    def in_file_units(self, state: Indices, sizes_px: Array, errors_px: Array) -> Array:
        """Errors as if every box had the mean and covariance that the file names: the inverse of what size does.

        Args:
            state: Shape (n,).
            sizes_px: Shape (n, 2).
            errors_px: Shape (n, ..., 4).
        """
        shape = (len(state), *([1] * (errors_px.ndim - 2)), 4)
        means, grows = self.means[state].reshape(shape), self.growths[state].reshape(shape)
        sides = np.tile(sizes_px, 2).reshape(shape)
        scaled = np.where(self.relative[state].reshape(*shape[:-1], 1), errors_px / sides, errors_px)
        return np.where(grows > 0, means + (scaled - means) / (1 + grows * sides), scaled)

    def _redraw(
        self,
        generators: list[np.random.Generator],
        frames: Frames,
        state: Indices,
        targets: Targets,
        truth: Array,
        rows: Indices,
    ) -> Array:
        """Errors of some rows, shape (r, 4): the first acceptable draw of each row's own generator."""
        errors = np.empty((len(rows), 4))
        pending, drawn, batch = np.arange(len(rows)), 0, _FIRST_BATCH
        while len(pending):
            if drawn == MOST_DRAWS:
                raise ModsimError(self._hopeless(frames, state, targets, rows[pending[0]]))
            batch = min(batch, MOST_DRAWS - drawn)
            standard = np.stack([generators[i].standard_normal((batch, 4)) for i in pending])
            candidates = self.errors_px(state[rows[pending]], sizes(truth[rows[pending]]), standard)
            accepted = inside_image(move(truth[rows[pending], None], candidates), frames.image_size_px)
            found, first = accepted.any(axis=1), accepted.argmax(axis=1)
            errors[pending[found]] = candidates[found, first[found]]
            pending, drawn, batch = pending[~found], drawn + batch, min(4 * batch, _LARGEST_BATCH)
        return errors

    def _hopeless(self, frames: Frames, state: Indices, targets: Targets, row: int) -> str:
        width, height = sizes(targets.boxes_px[row])
        mean = ", ".join(f"{value:g}" for value in self.means[state[row]])
        step = int(frames.steps[targets.frame[row]])
        unit = "box sides" if self.relative[state[row]] else "px"
        return (
            f"vessel '{targets.vessel_ids[targets.vessel[row]]}' at step {step} of camera '{frames.camera}': "
            f"in {MOST_DRAWS} draws of the box error of state '{self.state_names[state[row]]}' (mean {mean} "
            f"{unit}) its box of {width:.4g} × {height:.4g} px never stays a pixel wide and high in the image; use "
            "a box_error that suits such boxes, or leave small ones out with the annotation's min_box_px"
        )


def _generator(streams: Streams, purpose: Purpose, frames: Frames, targets: Targets, row: int) -> np.random.Generator:
    """The redraws of one row: a stream apart, so that the first draws of later steps stay as they were."""
    vessel = targets.vessel_ids[targets.vessel[row]]
    step = int(frames.steps[targets.frame[row]])
    return streams.generator(purpose, frames.camera, vessel, step=step)
