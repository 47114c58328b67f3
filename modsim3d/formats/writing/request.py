"""What is to be exported."""

from __future__ import annotations

from dataclasses import dataclass

from modsim3d.positions.locating import Attitude
from modsim3d.runs.stored_run import StoredRun


@dataclass(frozen=True, eq=False)
class ExportRequest:
    """A finished run, and which of its cameras are exported.

    Attributes:
        run: The run.
        cameras: Indices into the scene's cameras, ascending.
        attitude: Of cameras on board: as the inertial unit measures it, or the true one.
    """

    run: StoredRun
    cameras: tuple[int, ...]
    attitude: Attitude = "measured"

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names of the cameras."""
        return tuple(self.run.scene.cameras[index].name for index in self.cameras)
