"""The simplest way to write a pose source: poses as a function of time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from modsim3d.errors import ModsimError
from modsim3d.inputs.validation import Strict, nearest
from modsim3d.motion.poses.base import PoseRequest, Poses, SourceKeys

Place = tuple[Sequence[float], float]
"""Centre of the bottom plane in WCF, three metres, and the heading in radians."""


class PosesByTime(SourceKeys, Strict):
    """A pose source as a function of time. Its fields are its keys in the scene file."""

    def at(self, time_s: float, request: PoseRequest) -> Mapping[str, Place]:
        """Place and heading of each vessel that is present.

        The result may depend on the arguments only: it is called for times in any order, more than once, and in several
        processes.

        Returns:
            Vessel ID → place and heading; vessels that are not named are absent.
        """
        raise NotImplementedError

    def build(self, request: PoseRequest) -> TimedPoses:
        """Poses at the scene's steps."""
        return TimedPoses(request.timestamps, self.at, request)


@dataclass(frozen=True, eq=False)
class TimedPoses:
    """Poses from the function `at` of the time in seconds."""

    timestamps: Sequence[str]
    at: Callable[[float, PoseRequest], Mapping[str, Place]]
    request: PoseRequest

    def poses(self, first: int, stop: int) -> Poses:
        """Poses at steps first to stop − 1.

        Raises:
            ModsimError: `at` names a vessel that the scene does not have.
        """
        names = self.request.names or ()
        columns = {name: column for column, name in enumerate(names)}
        poses = Poses.absent(stop - first, len(names))
        for row, timestamp in enumerate(self.timestamps[first:stop]):
            for name, (position_m, heading_rad) in self.at(float(timestamp), self.request).items():
                if name not in columns:
                    raise ModsimError(f"at time {timestamp} s: no vessel '{name}' ({nearest(name, names)})")
                poses.present[row, columns[name]] = True
                poses.positions_m[row, columns[name]] = position_m
                poses.headings_rad[row, columns[name]] = heading_rad
        return poses
