"""Bearing, inverse range and position of detected boxes, with their covariances."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from modsim3d.core.arrays import Array, Columns, Indices, Mask, run_starts
from modsim3d.core.boxes import sizes
from modsim3d.core.document import Result
from modsim3d.core.errors import ModsimError
from modsim3d.core.random_streams import Streams
from modsim3d.detector.box_error import BoxErrorSource
from modsim3d.detector.model import DetectorModel
from modsim3d.geometry.camera import Camera
from modsim3d.geometry.camera_poses import CameraPoses
from modsim3d.geometry.curved_sea import horizon_inverse_range, inverse_range, look
from modsim3d.io.validation import nearest
from modsim3d.scene.scene import Scene
from modsim3d.world.vessel_motion import PosesInWaves

FOOT_OF_ERRORS = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 1, 0, 0.5]], dtype=np.float64)
"""Centre column, centre row and row of the foot from centre, width and height."""
EDGES_OF_ERRORS = np.array([[1, 0, -0.5, 0], [1, 0, 0.5, 0], [0, 1, 0, 0.5]], dtype=np.float64)
"""Left, right and lower edge from the same."""
_DOUBLINGS = 60


@dataclass(frozen=True, eq=False)
class FootErrors(Columns):
    """Errors of n boxes in pixels: of the centre's column and row, the foot's row, and left, right and lower edge."""

    means: Array  # (n, 3)
    covariances: Array  # (n, 3, 3)
    edge_means: Array  # (n, 3)
    edge_stds: Array  # (n, 3)


def state_shares(model: DetectorModel) -> Array:
    """Probability of each performance state, given that there is a true detection, shape (states,). The long run of the
    chain from its initial state; a schedule of forced states is not looked at."""
    chain = (np.eye(len(model.states)) + model.transition_matrix) / 2  # the same long run, and no period
    for _ in range(_DOUBLINGS):
        chain = chain @ chain
        chain /= chain.sum(axis=0)
    detected = np.array([1 - state.confusion[-1].mean() for state in model.states])
    weights: Array = chain[:, model.initial_state] * detected
    return weights / weights.sum() if weights.sum() > 0 else chain[:, model.initial_state]


def foot_errors(model: DetectorModel, boxes_px: Array) -> FootErrors:
    """Distribution of the errors of detected boxes, shape (n, 4). Errors that grow with the box are worked out for the
    detected size less its mean error: the true one is not known."""
    source, shares = BoxErrorSource.from_model(model), state_shares(model)
    observed = np.maximum(sizes(boxes_px), 1.0)
    growth = _mixed(source, shares, observed)[0][:, 2:]
    means, covariances = _mixed(source, shares, np.maximum(observed - growth, 1.0))
    edges = EDGES_OF_ERRORS @ covariances @ EDGES_OF_ERRORS.T
    return FootErrors(
        means @ FOOT_OF_ERRORS.T,
        FOOT_OF_ERRORS @ covariances @ FOOT_OF_ERRORS.T,
        means @ EDGES_OF_ERRORS.T,
        np.sqrt(np.diagonal(edges, axis1=1, axis2=2)),
    )


def _mixed(source: BoxErrorSource, shares: Array, sizes_px: Array) -> tuple[Array, Array]:
    """Mean (n, 4) and covariance (n, 4, 4) over the states."""
    moments = [source.moments_px(np.full(len(sizes_px), state), sizes_px) for state in range(len(shares))]
    mean = sum((share * m for share, (m, _) in zip(shares, moments, strict=True)), np.zeros((len(sizes_px), 4)))
    covariance = np.zeros((len(sizes_px), 4, 4))
    for share, (state_mean, state_covariance) in zip(shares, moments, strict=True):
        apart = state_mean - mean
        covariance += share * (state_covariance + apart[:, :, None] * apart[:, None, :])
    return mean, covariance


_NO_TURN = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Viewpoints:
    """A camera at S ascending steps, with the attitude that is known of the vessel that carries it."""

    scene: Scene
    camera: Camera
    steps: Indices  # (S,)
    vessels: PosesInWaves  # at these steps; the carrier's roll, pitch and yaw are those that are known of it
    attitude_std_rad: Array  # of known roll, pitch and heading, (3,)

    @classmethod
    def of(cls, scene: Scene, camera: Camera, steps: Indices, *, measured: bool) -> Viewpoints:
        """Viewpoints with the attitude that the vessel's inertial unit measures, or with the true one. Raises
        InputError if the vessel that carries the camera has no pose at a step."""
        vessels, carrier = scene.motion.at(steps), camera.mount.vessel
        if carrier is None or not measured:
            return cls(scene, camera, steps, vessels, np.zeros(3))
        first, count = int(steps[0]), int(steps[-1] - steps[0]) + 1
        errors = scene.imu.attitude_errors(Streams(scene.seed), carrier, first, count)
        estimate = _turned(vessels, scene.vessel_names.index(carrier), errors[steps - first])
        return cls(scene, camera, steps, estimate, scene.imu.attitude_std_rad)

    def poses(self, turn_rad: tuple[float, ...] = _NO_TURN) -> CameraPoses:
        """Poses of the camera, if the known roll, pitch and heading of its vessel are turned by so much."""
        vessels = self.vessels
        if self.camera.mount.vessel is not None and any(turn_rad):
            carrier = self.scene.vessel_names.index(self.camera.mount.vessel)
            vessels = _turned(vessels, carrier, np.array(turn_rad))
        return self.scene.camera_poses(self.camera, vessels, self.steps)


def _turned(vessels: PosesInWaves, carrier: int, by_rad: Array) -> PosesInWaves:
    """Poses with other angles of one vessel; rotations of the hulls stay, as a camera's follow from angles."""
    angles = vessels.angles_rad.copy()
    angles[:, carrier] += by_rad
    return PosesInWaves(vessels.poses, angles, vessels.world_R_vessel)


Attitude = Literal["true", "measured"]
MAX_RANGE_ERROR = 0.05
"""Greatest standard deviation of the inverse range, over the inverse range, at which a position is given.
`script/campaign positions` measures what comes of it, and docs/positions.md says why it is so small."""
_EDGE_PX = 1e-3  # boxes are rounded to that
_CUT_STDS = 3.0
_STEP_PX, _STEP_RAD = 0.5, 1e-5
_STEPS_AT_ONCE = 4096


@dataclass(frozen=True, eq=False, repr=False)
class Locations(Result):
    """n boxes in the world. NaN stands for what is not given.

    Attributes:
        bearing_rad: Bearing of the middle of each box, counter-clockwise from w1, in (−π, π], shape (n,). NaN for a box
            that may be cut by the left or right edge of the image: it ends within three standard deviations of it.
        bearing_std_rad: Its standard deviation, shape (n,).
        inverse_range_per_m: 1/r, with r the horizontal distance from the camera to the point where the ray through the
            middle of the box's lower edge meets the sea, shape (n,). At or below the inverse range of the horizon (0
            on a flat sea) it means "at the horizon or beyond". NaN for a box that may be cut by the lower edge of the
            image, and for a camera rolled by more than 45°: the lower edge of its boxes is not that of the vessel.
        inverse_range_std_per_m: Its standard deviation, shape (n,).
        covariance_rad_per_m: Covariance of bearing and inverse range, shape (n,).
        positions_m: w1 and w2 of that point, shape (n, 2). NaN where the standard deviation of the inverse range is
            more than `MAX_RANGE_ERROR` of it: a first-order covariance of the position would be wrong.
        position_covariances_m2: Shape (n, 2, 2).
    """

    bearing_rad: Array
    bearing_std_rad: Array
    inverse_range_per_m: Array
    inverse_range_std_per_m: Array
    covariance_rad_per_m: Array
    positions_m: Array
    position_covariances_m2: Array

    def __len__(self) -> int:
        """Number of boxes."""
        return len(self.bearing_rad)


def locate(
    scene: Scene, camera: str, step: ArrayLike, boxes_px: ArrayLike, attitude: Attitude = "measured"
) -> Locations:
    """Places of the detections of a camera in the world, as far as a tracker can know.

        for frame in modsim3d.simulate_frames(modsim3d.load_scene("strait", steps=2)):
            found = modsim3d.locate(scene, frame.camera, frame.step, frame.detections.boxes_px)
            found.bearing_rad, found.inverse_range_per_m, found.positions_m

    Means and variances of the box's error are those of the scene's detector over its performance states; the means are
    taken out. Variances of the attitude are those of the scene's `imu`.

    Args:
        scene: The scene.
        camera: Name of the camera.
        step: Step of the boxes: one for all, or one for each, shape (n,).
        boxes_px: Detected boxes as x_min, y_min, x_max, y_max, shape (n, 4).
        attitude: Of a camera on board: as its vessel's inertial unit measures it, or the true one.

    Raises:
        ModsimError: There is no such camera, step or attitude, or the boxes have another shape.
        TypeError: The scene is no `Scene`.
    """
    chosen, steps, boxes = _checked(scene, camera, step, boxes_px, attitude)
    law = foot_errors(scene.detector, boxes)
    parts, order = [], np.argsort(steps, kind="stable")
    starts = run_starts(steps[order] // _STEPS_AT_ONCE)
    for rows in np.split(order, starts[1:]):
        at, frame = np.unique(steps[rows], return_inverse=True)
        if len(at):
            view = Viewpoints.of(scene, chosen, at, measured=attitude == "measured")
            parts.append(_locate(view, frame, boxes[rows], law.take(rows)))
    if not parts:
        return Locations(*(np.empty(shape) for shape in (*[(0,)] * 5, (0, 2), (0, 2, 2))))
    back = np.argsort(order, kind="stable")
    names = (field.name for field in fields(Locations))
    return Locations(*(np.concatenate([getattr(part, name) for part in parts])[back] for name in names))


def _checked(
    scene: Scene, camera: str, step: ArrayLike, boxes_px: ArrayLike, attitude: str
) -> tuple[Camera, Indices, Array]:
    if not isinstance(scene, Scene):
        raise TypeError(f"scene: a Scene is needed, such as load_scene gives (got {type(scene).__name__})")
    cameras = {scene_camera.name: scene_camera for scene_camera in scene.cameras}
    if camera not in cameras:
        raise ModsimError(f"{scene.title}: there is no camera '{camera}' ({nearest(str(camera), list(cameras))})")
    if attitude not in get_args(Attitude):
        raise ModsimError(f"attitude: '{attitude}' is neither 'true' nor 'measured'")
    boxes = np.asarray(boxes_px, dtype=np.float64)
    if boxes.ndim != 2 or boxes.shape[1] != 4:
        raise ModsimError(f"boxes_px: boxes of shape (n, 4) are needed (got {boxes.shape})")
    given = np.asarray(step)
    if given.shape not in ((), (len(boxes),)) or (given.size and not np.issubdtype(given.dtype, np.integer)):
        raise ModsimError(
            f"step: one whole number is needed, or {len(boxes)} of them (got {given.dtype} {given.shape})"
        )
    steps: Indices = np.broadcast_to(given.astype(np.int64), (len(boxes),))
    if len(steps) and not (steps.min() >= 0 and steps.max() < scene.steps):
        wrong = steps.min() if steps.min() < 0 else steps.max()
        raise ModsimError(f"{scene.title}: there is no step {wrong}; the scene has steps 0 to {scene.steps - 1}")
    return cameras[camera], steps, boxes


def points_of(boxes_px: Array) -> Array:
    """Column and row of the centre, and row of the foot, of boxes (n, 4), shape (n, 3)."""
    x_min, y_min, x_max, y_max = boxes_px.T
    return np.stack([(x_min + x_max) / 2, (y_min + y_max) / 2, y_max], axis=-1)


def directions(camera: Camera, poses: CameraPoses, points_px: Array) -> Array:
    """Bearing of the centre and flat inverse range of the foot, shape (n, 2), from `points_of` n boxes and n poses."""
    bearing = look(camera.intrinsics, poses, points_px[:, :2])[:, 0]
    return np.stack([bearing, look(camera.intrinsics, poses, points_px[:, [0, 2]])[:, 1]], axis=-1)


def _locate(view: Viewpoints, frame: Indices, boxes_px: Array, errors: FootErrors) -> Locations:
    """Boxes (n, 4), each in a frame of the viewpoints, shape (n,)."""
    points = points_of(boxes_px) - errors.means
    poses = _rows(view.poses(), frame)
    seen = directions(view.camera, poses, points)
    by_pixel = _pixel_derivatives(view.camera, poses, points)
    by_angle = _angle_derivatives(view, frame, points)
    covariance = by_pixel @ errors.covariances @ np.swapaxes(by_pixel, 1, 2)
    covariance += by_angle @ np.diag(view.attitude_std_rad**2) @ np.swapaxes(by_angle, 1, 2)
    horizon = horizon_inverse_range(poses.positions_m[:, 2], curved=view.scene.sea == "curved")
    inverse = inverse_range(seen[:, 1], horizon)
    covariance = _on_the_sea(seen[:, 1], horizon, covariance)
    left, right, lower = _cut(boxes_px, errors, view.camera.intrinsics.image_size_px).T
    across, down, _ = -poses.camera_R_world[:, :, 2].T
    footless = lower | ~(down > np.abs(across))  # of the image's four sides, another is nearest to down in the world
    return _locations(seen[:, 0], inverse, covariance, poses.positions_m[:, :2], horizon, left | right, footless)


def _cut(boxes_px: Array, errors: FootErrors, image_size_px: tuple[int, int]) -> Mask:
    """Whether the image may cut a vessel at its left, right and lower side, by its detected box, shape (n, 3). The box
    of a vessel that is cut ends at the edge of the image but for its error."""
    width, height = image_size_px
    inside = np.stack([boxes_px[:, 0], width - boxes_px[:, 2], height - boxes_px[:, 3]], axis=-1)
    expected = errors.edge_means * [1, -1, -1]
    return (inside <= _EDGE_PX) | (inside - expected <= _CUT_STDS * errors.edge_stds + _EDGE_PX)


def _rows(poses: CameraPoses, frame: Indices) -> CameraPoses:
    return CameraPoses(poses.camera_R_world[frame], poses.positions_m[frame])


def _pixel_derivatives(camera: Camera, poses: CameraPoses, points_px: Array) -> Array:
    """Derivatives of bearing and flat inverse range by the three coordinates of `points_of`, shape (n, 2, 3)."""
    columns = []
    for step in _STEP_PX * np.eye(3):
        change = directions(camera, poses, points_px + step) - directions(camera, poses, points_px - step)
        columns.append(_turn_least(change) / (2 * _STEP_PX))
    return np.stack(columns, axis=-1)


def _angle_derivatives(view: Viewpoints, frame: Indices, points_px: Array) -> Array:
    """Derivatives of the same by roll, pitch and heading of the vessel, shape (n, 2, 3)."""
    columns = []
    for step, std in zip(_STEP_RAD * np.eye(3), view.attitude_std_rad, strict=True):
        if not std:
            columns.append(np.zeros((len(points_px), 2)))
            continue
        more, less = (_rows(view.poses(tuple(turn.tolist())), frame) for turn in (step, -step))
        change = directions(view.camera, more, points_px) - directions(view.camera, less, points_px)
        columns.append(_turn_least(change) / (2 * _STEP_RAD))
    return np.stack(columns, axis=-1)


def _turn_least(changes: Array) -> Array:
    """Changes of bearing and inverse range, shape (n, 2), the first by less than half a turn."""
    changes[:, 0] = (changes[:, 0] + np.pi) % (2 * np.pi) - np.pi
    return changes


def _on_the_sea(flat_per_m: Array, horizon_per_m: Array, covariance: Array) -> Array:
    """Covariances of bearing and inverse range from those of bearing and flat inverse range, shape (n, 2, 2). The slope
    is between one standard deviation less and one more: at the horizon of a curved sea the curve's is infinite."""
    std = np.sqrt(covariance[:, 1, 1])
    more, less = (inverse_range(flat_per_m + side * std, horizon_per_m) for side in (1, -1))
    slope = np.where(std > 0, (more - less) / np.where(std > 0, 2 * std, 1.0), 1.0)
    scale = np.stack([np.ones_like(slope), slope], axis=-1)
    scaled: Array = covariance * scale[:, :, None] * scale[:, None, :]
    return scaled


def first_order(bearing_rad: Array, inverse_per_m: Array, covariance: Array, cameras_m: Array) -> tuple[Array, Array]:
    """Positions (n, 2) from bearings (n,) and inverse ranges (n,), NaN for NaN, and their covariances to first order
    (n, 2, 2). `covariance` is that of both, (n, 2, 2); `cameras_m` are w1 and w2 of the camera, (n, 2)."""
    range_m = (1 / inverse_per_m)[:, None]
    along = np.stack([np.cos(bearing_rad), np.sin(bearing_rad)], axis=-1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=-1)
    slope = np.stack([range_m * across, -(range_m**2) * along], axis=-1)
    return cameras_m + range_m * along, slope @ covariance @ np.swapaxes(slope, 1, 2)


def _locations(
    bearing: Array, inverse: Array, covariance: Array, cameras_m: Array, horizon: Array, beside: Mask, footless: Mask
) -> Locations:
    """Result for each box: see `Locations`."""
    no_bearing, no_range = beside | np.isnan(bearing), footless | np.isnan(inverse)
    bearing, inverse = np.where(no_bearing, np.nan, bearing), np.where(no_range, np.nan, inverse)
    deviation = np.sqrt(covariance[:, 1, 1])
    placed = (inverse > horizon) & (deviation <= MAX_RANGE_ERROR * inverse) & ~no_bearing
    positions, spreads = first_order(bearing, np.where(placed, inverse, np.nan), covariance, cameras_m)
    return Locations(
        bearing_rad=bearing,
        bearing_std_rad=np.where(no_bearing, np.nan, np.sqrt(covariance[:, 0, 0])),
        inverse_range_per_m=inverse,
        inverse_range_std_per_m=np.where(no_range, np.nan, deviation),
        covariance_rad_per_m=np.where(no_bearing | no_range, np.nan, covariance[:, 0, 1]),
        positions_m=positions,
        position_covariances_m2=spreads,
    )
