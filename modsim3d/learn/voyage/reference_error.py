"""Precision with which AIS tells where a vessel is, where it heads and how large it is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy import special

from modsim3d.core.arrays import Array, Indices, Mask
from modsim3d.geometry.camera import Camera
from modsim3d.geometry.camera_poses import CameraPoses, world_R_vehicle
from modsim3d.geometry.curved_sea import lowered
from modsim3d.io.strict_text import load_json
from modsim3d.learn.voyage.log_to_scene import hull_of, stacked
from modsim3d.scene.ais.scene_folder import REPORT
from modsim3d.scene.scene import Scene
from modsim3d.world.vessel_motion import PosesInWaves
from modsim3d.world.vessels import Vessel

POSITION_M = 10.0  # standard deviation of each coordinate of a position, by what receivers without correction say
POSITION_S = 300.0  # how long its error lasts: that of a receiver changes over minutes, with satellites and ionosphere
PARAMETERS = ("east", "north", "heading", "length", "beam", "air draft", "antenna along", "antenna across")
"""What the truth of a box depends on, in metres and radians."""
SLOW, CONSTANT = slice(0, 3), slice(3, 8)  # those whose errors change over minutes, and those that a vessel keeps
_REPORTED_DEG, _FROM_COURSE_DEG, _UNKNOWN_DEG = 1.0, 6.0, 45.0
"""A heading as it is sent; course or bearing in its place, off by leeway and current; none at all."""
_ROUNDED_M = float(np.sqrt(2 / 12))  # a length is the sum of two distances, each rounded to a metre
_TYPICAL = 0.3  # spread of a dimension within a ship type, as a share: "100 to 180 m", "10 to 14 m" in their table
_ANTENNA = 0.23
"""Spread of the antenna's place, taken to be amidships, as a share: it may be anywhere on four fifths of the hull."""
_SAME_M = 1e-9


@dataclass(frozen=True, eq=False)
class ReferenceNoise:
    """Standard deviations of the errors of truth."""

    std: Array  # of the `PARAMETERS` of each vessel, (V, 8)
    position_s: float  # correlation time of errors of position and heading
    reasons: Mapping[str, int]  # what is uncertain besides positions → number of vessels

    @classmethod
    def of(cls, scene: Scene, position_m: float = POSITION_M, position_s: float = POSITION_S) -> ReferenceNoise:
        """Noise of a scene's truth, given the standard deviation of each coordinate of a position and the correlation
        time of its error; after `modsim3d ais`, also of what its report lacks. Raises InputError if that is wrong."""
        file = scene.path.parent / REPORT
        content = load_json(file, "report") if file.is_file() else {}
        entries = content.get("vessels", {}) if isinstance(content, dict) else {}
        std, reasons = np.zeros((len(scene.vessels), len(PARAMETERS))), dict[str, int]()
        std[:, :2] = position_m
        for row, vessel in enumerate(scene.vessels):
            entry = entries.get(vessel.name)
            if isinstance(entry, dict):
                std[row, 2] = _heading_rad(entry)
                std[row, CONSTANT], missing = _dimensions(vessel, entry)
                for name in missing:
                    reasons[name] = reasons.get(name, 0) + 1
        return cls(std, position_s, reasons)

    @property
    def position_m(self) -> float:
        """Standard deviation of each coordinate of a position."""
        return float(self.std[0, 0])


def _heading_rad(entry: Mapping[str, Any]) -> float:
    """Spread of the errors of a vessel's headings, by how many of them were sent."""
    replaced = entry.get("replaced", {})
    messages = max(float(entry.get("messages", 1)), 1.0)
    filled = sum(replaced.get(f"heading_{name}", 0) for name in ("from_course", "from_bearing", "held"))
    unknown, filled = replaced.get("heading_unknown", 0) / messages, filled / messages
    sent = max(1 - filled - unknown, 0.0)
    degrees = np.sqrt(sent * _REPORTED_DEG**2 + filled * _FROM_COURSE_DEG**2 + unknown * _UNKNOWN_DEG**2)
    return float(np.radians(degrees))


def _dimensions(vessel: Vessel, entry: Mapping[str, Any]) -> tuple[Array, list[str]]:
    """Spread of length, beam, air draft and the antenna's place, (5,), and which are typical; a user's are known."""
    std, missing = np.zeros(5), []
    for place, name in enumerate(("length", "beam", "air_draft")):
        value = float(getattr(vessel, f"{name}_m"))
        if abs(float(entry.get(f"{name}_m", np.nan)) - value) > _SAME_M:
            continue
        typical = name in entry.get("defaults", ())
        std[place] = _TYPICAL * value if typical else _ROUNDED_M
        missing += [name.replace("_", " ")] if typical else []
    if "antenna" in entry.get("defaults", ()):
        std[3:] = _ANTENNA * vessel.length_m, _ANTENNA * vessel.beam_m
        missing.append("antenna's place")
    return std, missing


# ---- By how much a true box changes with the place ----

_STEPS = (0.5, 0.5, 0.005, 0.1, 0.1, 0.1)  # by how much places, headings and dimensions are moved to either side


@dataclass(frozen=True, eq=False)
class View:
    """Frames of one camera, with a row for each of F frames."""

    camera: Camera  # as it was registered
    poses: PosesInWaves  # vessels in each frame
    images: Indices  # rows of the labelled set's images, (F,)
    first_identity: int = 0  # that of the scene's first vessel in these images; `joined` sets count on
    moved: Mask | None = None  # which vessels registration has put where their detections are, (V,); None for none


def box_jacobians(scene: Scene, view: View, frame: Indices, vessel: Indices) -> Array:
    """Derivatives of boxes, centre x and y, width and height in px, uncut, by the `PARAMETERS`, (n, 4, 8), for rows
    `frame` of a view and the scene's vessels, (n,) each; nan for one that is absent or partly behind the camera."""
    placed = _PlacedVessels.of(scene, view, frame, vessel)
    result = np.full((len(frame), 4, len(PARAMETERS)), np.nan)
    for column, step in enumerate(_STEPS):
        move = np.zeros(len(_STEPS))
        move[column] = step
        result[..., column] = (placed.boxes(move) - placed.boxes(-move)) / (2 * step)
    cosine, sine = np.cos(placed.heading_rad)[:, None], np.sin(placed.heading_rad)[:, None]
    east, north = result[..., 0], result[..., 1]
    result[..., 6], result[..., 7] = cosine * east + sine * north, cosine * north - sine * east
    return result


@dataclass(frozen=True, eq=False)
class _PlacedVessels:
    """n vessels before a camera: hulls in VCF (n, K, 3), positions (n, 3), headings (n,), and rotations by waves."""

    camera: Camera
    camera_poses: CameraPoses
    unit_hulls: Array
    extents_m: Array
    positions_m: Array
    heading_rad: Array
    nominal_R_vessel: Array
    curved: bool

    @classmethod
    def of(cls, scene: Scene, view: View, frame: Indices, vessel: Indices) -> _PlacedVessels:
        """Vessels in some frames of a view."""
        poses = view.poses
        cameras = scene.camera_poses(view.camera, poses, np.arange(len(view.images)))
        cameras = CameraPoses(cameras.camera_R_world[frame], cameras.positions_m[frame])
        padded = stacked([hull_of(ship.solid) for ship in scene.vessels])
        heading = poses.poses.headings_rad[frame, vessel]
        present = poses.poses.present[frame, vessel]
        positions = np.where(present[:, None], poses.poses.positions_m[frame, vessel], np.nan)
        turned = np.swapaxes(world_R_vehicle(heading), -1, -2) @ poses.world_R_vessel[frame, vessel]
        extents = np.array([ship.extents_m for ship in scene.vessels])[vessel]
        curved = scene.sea == "curved"
        return cls(view.camera, cameras, padded[vessel], extents, positions, heading, turned, curved)

    def boxes(self, move: Array) -> Array:
        """Centre x and y, width and height once the first six parameters have moved, shape (6,) to (n, 4)."""
        positions = self.positions_m + np.array([move[0], move[1], 0.0])
        if self.curved:
            positions = lowered(positions, self.camera_poses.positions_m)
        rotations = world_R_vehicle(self.heading_rad + move[2]) @ self.nominal_R_vessel
        hulls = self.unit_hulls * (self.extents_m + move[3:])[:, None, :]
        world = hulls @ np.swapaxes(rotations, -1, -2) + positions[:, None, :]
        pixels = self.camera.intrinsics.project(self.camera_poses.to_camera(world))
        low, high = pixels.min(axis=1), pixels.max(axis=1)
        return np.concatenate([(low + high) / 2, high - low], axis=1)


# ---- Covariances that errors of truth give to errors of boxes ----

_DRAWS_AT_ONCE = 20
_KNOWN_TO = 0.1  # share to which standard deviations of errors of truth are known themselves: they are rules of thumb
_SEEN = np.array([[1, 0, 0, 0], [0, 1, 0, 0.5]])
"""What registration looks at: bearing and waterline, from centre x, centre y, width and height."""
_MOVED = slice(6, 8)  # the `PARAMETERS` that registration finds of a vessel
_MIN_M = 0.01
_SEEN_PX = 3.0  # standard deviation of errors of bearing and waterline; it hardly matters where a vessel is seen often


@dataclass(frozen=True, eq=False)
class ReferenceErrors:
    """The errors that n true boxes have from those of their vessels."""

    jacobians: Array  # from `box_jacobians`, (n, 4, 8)
    time_s: Array  # of each box, (n,)
    vessel: Indices  # of each box, (n,)
    noise: ReferenceNoise
    unit_px: Array  # unit of the learned errors, (n, 4)
    moved: Indices  # number of the fit that has moved each, such as the camera and the vessel; −1 for none, (n,)

    @property
    def change(self) -> Array:
        """Variance of that part of each error that changes with time, mean over the boxes, (4,)."""
        part = (self.jacobians * self.noise.std[self.vessel][:, None])[..., SLOW] / self.unit_px[..., None]
        return np.asarray((part**2).sum(axis=2).mean(axis=0))

    def covariances(self, draws: int, seed: int) -> Array:
        """Covariance of the errors about their mean in each draw, shape (draws, 4, 4)."""
        rng, count = np.random.default_rng([seed, 23]), max(len(self.vessel) - 1, 1)
        parts = [np.empty((0, 4, 4))]
        for errors in self._errors(rng, draws):
            about = errors - errors.mean(axis=1, keepdims=True)
            parts.append(np.swapaxes(about, 1, 2) @ about / count)
        larger = 1 + _KNOWN_TO * special.ndtri((rng.permutation(draws) + 0.5) / max(draws, 1))
        return np.asarray(np.concatenate(parts) * larger[:, None, None] ** 2)

    def _errors(self, rng: np.random.Generator, draws: int) -> Iterator[Array]:
        """Errors of the boxes, some draws at a time, shape (some, n, 4)."""
        times, frame = np.unique(self.time_s, return_inverse=True)
        frame = frame.ravel()
        scaled = self.jacobians * self.noise.std[self.vessel][:, None]
        slow_j, constant_j = scaled[..., SLOW], scaled[..., CONSTANT]
        kept = np.exp(-np.diff(times, prepend=times[:1]) / self.noise.position_s)
        vessels, constants = len(self.noise.std), CONSTANT.stop - CONSTANT.start
        for first in range(0, draws, _DRAWS_AT_ONCE):
            some = min(_DRAWS_AT_ONCE, draws - first)
            slow = rng.standard_normal((len(times), some, vessels, SLOW.stop))
            for k in range(1, len(times)):
                slow[k] = kept[k] * slow[k - 1] + np.sqrt(1 - kept[k] ** 2) * slow[k]
            own = rng.standard_normal((some, vessels, constants))
            errors: Array = np.einsum("nij,nsj->sni", slow_j, slow[frame, :, self.vessel])
            errors += np.einsum("nij,snj->sni", constant_j, own[:, self.vessel])
            for rows, slopes, fit in self._fits:
                seen = np.einsum("ij,snj->sni", _SEEN, errors[:, rows]).reshape(some, -1)
                errors[:, rows] -= np.einsum("nij,sj->sni", slopes, seen @ fit)
            yield errors / self.unit_px

    @cached_property
    def _fits(self) -> list[tuple[Indices, Array, Array]]:
        """Rows of each moved vessel (m,), their slopes (m, 4, 2), and the matrix that fits its shift, (2m, 2)."""
        fits = []
        for number in np.unique(self.moved[self.moved >= 0]).tolist():
            rows = np.flatnonzero(self.moved == number)
            slopes = self.jacobians[rows][..., _MOVED]
            seen = (_SEEN @ slopes).reshape(-1, 2) / _SEEN_PX
            expected_m = max(float(self.noise.std[self.vessel[rows[0]], 0]), _MIN_M)
            inverse = np.linalg.inv(seen.T @ seen + np.eye(2) / expected_m**2)
            fits.append((rows, slopes, seen / _SEEN_PX @ inverse))
        return fits
