"""A camera: intrinsics with skew and non-square pixels, projection, lens distortion, horizon.
Image: pixel (row i, column j) covers [j, j + 1) × [i, i + 1); the origin is the top-left corner of the top-left pixel,
so the image is [0, width] × [0, height]."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from modsim3d.core.arrays import Array, Indices, read_only
from modsim3d.geometry.camera_poses import Mount

# ---- Lens distortion by the model of Brown ----

MAX_ITERATIONS = 100


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
        across = x * radial + 2 * self.p1 * x * y + self.p2 * (r2 + 2 * x * x)
        down = y * radial + self.p1 * (r2 + 2 * y * y) + 2 * self.p2 * x * y
        return np.stack([across, down], axis=-1)

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
            for _ in range(MAX_ITERATIONS):
                error = self.distort(ideal) - distorted
                (a, b), (c, d) = np.moveaxis(self.jacobian(ideal), (-2, -1), (0, 1))
                step = np.stack([d * error[..., 0] - b * error[..., 1], a * error[..., 1] - c * error[..., 0]], axis=-1)
                ideal = ideal - step / (a * d - b * c)[..., None]
                if np.abs(step).max(initial=0.0) < 1e-14:
                    break
            exact = np.abs(self.distort(ideal) - distorted).max(axis=-1, keepdims=True) < 1e-9
        return np.where(exact, ideal, np.nan)

    def one_to_one(self, ideal: Array) -> bool:
        """Whether the map is one to one between the axis and these points of the ideal plane, shape (n, 2)."""
        along = np.linspace(0.0, 1.0, 257)[:, None, None] * ideal
        jacobian = self.jacobian(along)
        determinant = jacobian[..., 0, 0] * jacobian[..., 1, 1] - jacobian[..., 0, 1] * jacobian[..., 1, 0]
        # A positive determinant and trace: mirrored along no axis, neither along one nor along both.
        trace = jacobian[..., 0, 0] + jacobian[..., 1, 1]
        return bool(np.all(np.isfinite(ideal)) and np.all(determinant > 0) and np.all(trace > 0))


DEFAULT_NEAR_CLIP_M = 0.1
BORDER_POINTS = 64  # points on each side of the image at which a lens's field of view is measured
BEND_PX = 1 / 256  # greatest distance between the curve of a straight edge through a lens and the chords drawn for it
MAX_WINDOW = 10  # greatest size of the pinhole image of a distorted one, in sizes of the latter


@dataclass(frozen=True)
class Intrinsics:
    """The map from camera coordinates to pixels (Jessen & Mohr (2023), eq. 4.8–4.13)."""

    focal_px: tuple[float, float]  # f1 = f / Δp1 and f2 = f / Δp2
    principal_point_px: tuple[float, float]  # (a1, a2), from the top-left corner of the image
    image_size_px: tuple[int, int]  # width and height
    skew: float = 0.0  # s, in pixels
    near_clip_m: float = DEFAULT_NEAR_CLIP_M  # near plane along c3; nothing nearer is drawn or projected
    distortion: Distortion | None = None  # None for a pinhole

    @classmethod
    def from_lens(
        cls,
        focal_length_m: float,
        pixel_size_m: tuple[float, float],
        principal_point_px: tuple[float, float],
        image_size_px: tuple[int, int],
        skew: float = 0.0,
        near_clip_m: float = DEFAULT_NEAR_CLIP_M,
        distortion: Distortion | None = None,
    ) -> Intrinsics:
        """Intrinsics from the focal length and the pixel size of a data sheet (eq. 4.8, 4.9)."""
        focal_px = (focal_length_m / pixel_size_m[0], focal_length_m / pixel_size_m[1])
        return cls(focal_px, principal_point_px, image_size_px, skew, near_clip_m, distortion)

    @property
    def matrix(self) -> Array:
        """K = [[f1, s, a1], [0, f2, a2], [0, 0, 1]], shape (3, 3)."""
        (f1, f2), (a1, a2) = self.focal_px, self.principal_point_px
        return np.array([[f1, self.skew, a1], [0.0, f2, a2], [0.0, 0.0, 1.0]])

    @cached_property
    def inverse_matrix(self) -> Array:
        """K⁻¹, shape (3, 3)."""
        return read_only(np.linalg.inv(self.matrix))

    def project(self, points_camera: ArrayLike) -> Array:
        """Columns and rows of points in CCF, in metres, shape (..., 3) to (..., 2) (eq. 4.18). They are NaN for points
        nearer than the near plane, which have no image."""
        points = np.asarray(points_camera, dtype=np.float64)
        depth = points[..., 2]
        seen = np.where(depth >= self.near_clip_m, depth, np.nan)
        c1, c2 = points[..., 0] / seen, points[..., 1] / seen
        if self.distortion is not None:
            c1, c2 = np.moveaxis(self.distortion.distort(np.stack([c1, c2], axis=-1)), -1, 0)
        (f1, f2), (a1, a2) = self.focal_px, self.principal_point_px
        return np.stack([f1 * c1 + self.skew * c2 + a1, f2 * c2 + a2], axis=-1)

    def unproject(self, pixels: ArrayLike, depth_m: ArrayLike) -> Array:
        """Points in CCF, in metres, shape (..., 3), that pixels, shape (..., 2), show at depths along c3, shape (...).
        This is the inverse of `project`."""
        pixel, depth = np.asarray(pixels, dtype=np.float64), np.asarray(depth_m, dtype=np.float64)
        (f1, f2), (a1, a2) = self.focal_px, self.principal_point_px
        c2 = (pixel[..., 1] - a2) / f2
        c1 = (pixel[..., 0] - a1 - self.skew * c2) / f1
        if self.distortion is not None:
            c1, c2 = np.moveaxis(self.distortion.undistort(np.stack([c1, c2], axis=-1)), -1, 0)
        return np.stack([c1 * depth, c2 * depth, depth], axis=-1)

    @cached_property
    def pinhole(self) -> Intrinsics:
        """The camera without distortion, with an image so large that it contains the field of view of the lens.
        Straight lines stay straight in its image. A camera without distortion is its own pinhole."""
        if self.distortion is None:
            return self
        low, high = self._window()
        (a1, a2), (width, height) = self.principal_point_px, (high - low).astype(int).tolist()
        centre = a1 - low[0], a2 - low[1]
        return replace(self, principal_point_px=centre, image_size_px=(width, height), distortion=None)

    def through_lens(self, pinhole_px: ArrayLike) -> Array:
        """Pixels of the distorted image from those of the pinhole's image, both of shape (..., 2)."""
        pixels = np.asarray(pinhole_px, dtype=np.float64)
        if self.distortion is None:
            return pixels
        return self.project(self.pinhole.unproject(pixels, np.full(pixels.shape[:-1], self.near_clip_m)))

    @cached_property
    def chord_px(self) -> float:
        """The longest straight piece of the pinhole's image that the lens bends by no more than `BEND_PX`. A chord of
        length s is at most κ s² / 8 from a curve of curvature κ, which is greatest at the edge of the image."""
        if self.distortion is None:
            return math.inf
        border = self.pinhole.image_border()
        bent = self.through_lens(border)
        bends = [
            np.linalg.norm(self.through_lens(border + d) + self.through_lens(border - d) - 2 * bent, axis=1).max()
            for d in np.array([[1.0, 0.0], [0.0, 1.0], [0.7, 0.7], [0.7, -0.7]])
        ]
        return min(max(math.sqrt(8 * BEND_PX / (max(bends) + 1e-12)), 1.0), 256.0)

    def image_border(self) -> Array:
        """Points around the edge of the image in pixels, shape (n, 2)."""
        along = np.arange(BORDER_POINTS) / BORDER_POINTS
        corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float64)
        sides = corners[:, None] + along[:, None] * (np.roll(corners, -1, axis=0) - corners)[:, None]
        return sides.reshape(-1, 2) * self.image_size_px

    def _window(self) -> tuple[Array, Array]:
        """Least and greatest column and row, each of shape (2,), of the field of view in a pinhole's image."""
        seen = self.unproject(self.image_border(), np.ones(4 * BORDER_POINTS))
        pixels = replace(self, distortion=None, near_clip_m=0.5).project(seen)
        return np.floor(pixels.min(axis=0)) - 1, np.ceil(pixels.max(axis=0)) + 1

    def lens_problem(self) -> str | None:
        """Reason why no lens with these coefficients can make this image; None if one can."""
        if self.distortion is None:
            return None
        low, high = self._window()
        size = float(np.max(high - low))
        if not size <= MAX_WINDOW * max(self.image_size_px):
            return "the lens reaches only a part of the image: reduce the coefficients or the image size"
        window = self.pinhole.unproject(self.pinhole.image_border(), np.ones(4 * BORDER_POINTS))[:, :2]
        if not self.distortion.one_to_one(window):
            return "folds the image over itself: some pixels show two directions; reduce the coefficients"
        return None

    def sea_half_plane(self, camera_R_world: ArrayLike) -> Array:
        """The half-plane of the image that shows the sea, for any roll and pitch, from rotations WCF to CCF
        (..., 3, 3): (a, b, c) with a·x + b·y + c >= 0 on the sea, shape (..., 3), scaled so that the value is the
        distance from the horizon in pixels. (0, 0, ±1) if the camera looks straight down or up. The sea is flat, and
        the horizon is a straight line: distortion is left out. A pixel's ray K⁻¹ (x, y, 1) meets the sea where it
        points below the horizontal plane: n · ray <= 0 with n the world's vertical in camera axes."""
        up = np.asarray(camera_R_world, dtype=np.float64)[..., :, 2]
        line = (-up[..., None, :] @ self.inverse_matrix)[..., 0, :]  # one by one: many at once round otherwise
        length = np.hypot(line[..., 0], line[..., 1])
        level = length < 1e-12 * np.abs(line[..., 2])
        scaled: Array = line / np.where(level, 1.0, length)[..., None]
        if level.any():
            scaled[level, :2], scaled[level, 2] = 0.0, np.sign(line[level, 2])
        return scaled


@dataclass(frozen=True)
class Camera:
    """A virtual camera."""

    name: str
    intrinsics: Intrinsics
    mount: Mount
    frame_rate_hz: float | None = None  # None for a frame at every step of the scene
    start_offset_s: float = 0.0  # time from the scene's first step to the first frame


# ---- Half-spaces that bound what a camera shows, and triangles cut by them ----


def near_plane(intrinsics: Intrinsics) -> Array:
    """The half-space c3 >= near_clip_m as rows (n, d) with n · p >= d, shape (1, 4)."""
    return np.array([[0.0, 0.0, 1.0, intrinsics.near_clip_m]])


@lru_cache(maxsize=64)
def guard_planes(intrinsics: Intrinsics, guard_px: float) -> Array:
    """The half-spaces that project to the image and a band of `guard_px` around it, shape (4, 4). Each row is (n, d)
    with n · p >= d, read-only. The left one, x >= −guard, is (f1, s, a1 + guard) · p >= 0 in camera coordinates."""
    matrix, (width, height) = intrinsics.matrix, intrinsics.image_size_px
    left, top = matrix[0] + guard_px * matrix[2], matrix[1] + guard_px * matrix[2]
    right, bottom = (width + guard_px) * matrix[2] - matrix[0], (height + guard_px) * matrix[2] - matrix[1]
    return read_only(np.column_stack([np.array([left, right, top, bottom]), np.zeros(4)]))


def clip_triangles(triangles_camera: Array, half_spaces: Array) -> tuple[Array, Indices]:
    """The parts of triangles (T, 3, 3) in CCF that lie inside half-spaces, rows (n, d) with n · p >= d inside, (P, 4),
    as triangles (Sutherland & Hodgman, 1974), in the order and with the orientation of the triangles, (T', 3, 3); and
    the triangle that each is a part of, (T',)."""
    kept, source = triangles_camera, np.arange(len(triangles_camera))
    for plane in half_spaces:
        height = kept @ plane[:3] - plane[3]
        if not (height >= 0).all():
            kept, cut = _clip_by(kept, height)
            source = source[cut]
    return kept, source


def _clip_by(triangles: Array, height: Array) -> tuple[Array, Indices]:
    """The parts of triangles (T, 3, 3) where a linear function, `height` (T, 3) at the corners, is not negative. With
    the parts comes the triangle of each."""
    inside = height >= 0
    count = inside.sum(axis=1)
    whole, one, two = (np.flatnonzero(count == k) for k in (3, 1, 2))
    # Turned so that the odd corner, the one inside or the one outside, comes first.
    corners, heights = _turned(triangles, height, one, inside[one].argmax(axis=1))
    tip = np.stack([corners[0], _crossing(corners, heights, 0, 1), _crossing(corners, heights, 0, 2)], axis=1)
    corners, heights = _turned(triangles, height, two, inside[two].argmin(axis=1))
    first, last = _crossing(corners, heights, 1, 0), _crossing(corners, heights, 2, 0)
    near = np.stack([first, corners[1], corners[2]], axis=1)
    far = np.stack([first, corners[2], last], axis=1)
    source = np.concatenate([whole, one, two, two])
    order = np.argsort(source, kind="stable")
    return np.concatenate([triangles[whole], tip, near, far])[order], source[order]


def _turned(triangles: Array, height: Array, rows: Indices, first: Indices) -> tuple[list[Array], list[Array]]:
    """The corners of some triangles, three of shape (k, 3), and their heights, (k, 1), from the corner `first` on."""
    places = [(first + i) % 3 for i in range(3)]
    return [triangles[rows, place] for place in places], [height[rows, place][:, None] for place in places]


def _crossing(corners: list[Array], heights: list[Array], inner: int, outer: int) -> Array:
    """Points where edges leave the half-space, shape (k, 3). Computed from the inner corner, so that two triangles with
    a common edge get exactly the same point."""
    share = heights[inner] / (heights[inner] - heights[outer])
    return corners[inner] + share * (corners[outer] - corners[inner])
