"""The scene that AIS gives of a true one: what is wrong with its positions, and who has no transponder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from modsim3d.core.arrays import Array
from modsim3d.scene.scene import Scene
from modsim3d.world.poses.base import Poses
from modsim3d.world.poses.replay import RecordedPoses


@dataclass(frozen=True)
class AisErrors:
    """What is wrong with the positions of AIS.

    Attributes:
        position_m: Standard deviation of each coordinate of a position.
        position_s: How long its error lasts: between two reports it keeps exp(−apart / position_s).
        delay_s: Standard deviation, over vessels, of how late their reports are.
        along_m: Of the antenna's place towards the bow of where it is said to be.
        across_m: Of the antenna's place to port.
        absent: Share of the vessels that have no transponder.
        reports_s: Time between two reports.
    """

    position_m: float = 0.0
    position_s: float = 0.0
    delay_s: float = 0.0
    along_m: float = 0.0
    across_m: float = 0.0
    absent: float = 0.0
    reports_s: float = 5.0

    def silent(self, scene: Scene, seed: int) -> tuple[str, ...]:
        """Vessels without a transponder, drawn from all but own ship."""
        others = [name for index, name in enumerate(scene.vessel_names) if index not in scene.own_ships]
        drawn = np.random.default_rng([seed, 1]).choice(others, round(self.absent * len(others)), replace=False)
        return tuple(drawn.tolist())


def as_reported(scene: Scene, seed: int, errors: AisErrors, silent: Sequence[str] | None = None) -> tuple[Scene, Array]:
    """The scene that AIS gives; own ships are known.

    Args:
        scene: The true one.
        seed: Of what is drawn.
        errors: What is wrong with it.
        silent: Vessels without a transponder; None for those that `errors` draws.

    Returns:
        The scene, and what was drawn for each vessel: along, across and delay, shape (V, 3).
    """
    rng = np.random.default_rng(seed)
    true, times_s = scene.poses.poses(0, scene.steps), scene.times_s(0, scene.steps)
    vessels, own = len(scene.vessels), list(scene.own_ships)
    wrong = rng.normal(0, (errors.along_m, errors.across_m, errors.delay_s), (vessels, 3))
    wrong[own] = 0
    along, across, delay = wrong.T[..., None]
    reports = np.arange(-errors.reports_s, times_s[-1] + errors.reports_s, errors.reports_s)
    noise = rng.normal(0, errors.position_m, (vessels, 2, len(reports)))
    if errors.position_s:
        lasting(noise, np.exp(-np.diff(reports) / errors.position_s))
    noise[own] = 0
    first_s = rng.uniform(0, errors.reports_s, vessels)  # in step with the frames, reports would tell the clock
    ahead = np.stack([np.cos(true.headings_rad), np.sin(true.headings_rad)], axis=-1)
    port = np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)
    velocity = _velocities(true, times_s)
    moved = true.positions_m.copy()
    moved[..., :2] += along * ahead + across * port - delay * velocity
    for vessel, axis in np.ndindex(noise.shape[:2]):
        moved[:, vessel, axis] += np.interp(times_s, reports + first_s[vessel], noise[vessel, axis])
    absent = errors.silent(scene, seed) if silent is None else silent
    present = true.present & ~np.isin(scene.vessel_names, list(absent))
    poses = RecordedPoses(scene.poses.timestamps, Poses(present, moved, true.headings_rad))
    return replace(scene, poses=poses), wrong


def _velocities(poses: Poses, times_s: Array) -> Array:
    """Velocities of vessels while they are there, in m/s, shape (S, V, 2)."""
    velocities = np.zeros((*poses.present.shape, 2))
    for vessel in range(poses.present.shape[1]):
        steps = np.flatnonzero(poses.present[:, vessel])
        if len(steps) > 1:
            velocities[steps, vessel] = np.gradient(poses.positions_m[steps, vessel, :2], times_s[steps], axis=0)
    return velocities


def lasting(noise: Array, kept: Array) -> None:
    """Make independent numbers (..., R) ones that last, of which a share is kept to the next, shape (R − 1,)."""
    for k, share in enumerate(kept.tolist(), 1):
        noise[..., k] = share * noise[..., k - 1] + np.sqrt(1 - share**2) * noise[..., k]
