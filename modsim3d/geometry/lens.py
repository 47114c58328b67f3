"""Lens distortion by the model of Brown (1971) and Conrady (1919), with OpenCV's names for the coefficients.

It maps the ideal picture plane of a pinhole, (c1 / c3, c2 / c3), to that of the lens. The map is one to one only up to
some distance from the axis; a scene with a lens whose image reaches further is refused.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modsim3d.arrays import Array

MOST_ITERATIONS = 100


@dataclass(frozen=True)
class Distortion:
    """x' = x · (1 + k1 r² + k2 r⁴ + k3 r⁶) + tangential terms with p1 and p2 (Brown, 1971)."""

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0

    def distort(self, ideal: Array) -> Array:
        """Distorted places of points of the ideal plane, both of shape (..., 2) and without unit."""
        x, y = np.moveaxis(ideal, -1, 0)
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        return np.stack(
            [
                x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x),
                y * radial + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y,
            ],
            axis=-1,
        )

    def jacobian(self, ideal: Array) -> Array:
        """Derivatives of `distort` at points of the ideal plane, shape (..., 2) to (..., 2, 2)."""
        x, y = np.moveaxis(ideal, -1, 0)
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3))
        slope = self.k1 + r2 * (2 * self.k2 + 3 * r2 * self.k3)  # derivative of the radial factor by r²
        cross = 2 * x * y * slope + 2 * self.p1 * x + 2 * self.p2 * y
        xx = radial + 2 * x * x * slope + 2 * self.p1 * y + 6 * self.p2 * x
        yy = radial + 2 * y * y * slope + 6 * self.p1 * y + 2 * self.p2 * x
        return np.stack([np.stack([xx, cross], axis=-1), np.stack([cross, yy], axis=-1)], axis=-2)

    def undistort(self, distorted: Array) -> Array:
        """The inverse of `distort`, by Newton's method, both of shape (..., 2); NaN where no ideal point is found."""
        ideal = np.array(distorted, dtype=np.float64)
        with np.errstate(all="ignore"):
            for _ in range(MOST_ITERATIONS):
                error = self.distort(ideal) - distorted
                (a, b), (c, d) = np.moveaxis(self.jacobian(ideal), (-2, -1), (0, 1))
                step = np.stack([d * error[..., 0] - b * error[..., 1], a * error[..., 1] - c * error[..., 0]], axis=-1)
                ideal = ideal - step / (a * d - b * c)[..., None]
                if np.abs(step).max(initial=0.0) < 1e-14:
                    break
            found = np.abs(self.distort(ideal) - distorted).max(axis=-1, keepdims=True) < 1e-9
        return np.where(found, ideal, np.nan)

    def one_to_one(self, ideal: Array) -> bool:
        """Whether the map is one to one between the axis and these points of the ideal plane, shape (n, 2)."""
        along = np.linspace(0.0, 1.0, 257)[:, None, None] * ideal
        jacobian = self.jacobian(along)
        determinant = jacobian[..., 0, 0] * jacobian[..., 1, 1] - jacobian[..., 0, 1] * jacobian[..., 1, 0]
        # A positive determinant and trace: mirrored along no axis, neither along one nor along both.
        trace = jacobian[..., 0, 0] + jacobian[..., 1, 1]
        return bool(np.all(np.isfinite(ideal)) and np.all(determinant > 0) and np.all(trace > 0))
