"""Request of an export."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from modsim3d.runs.camera_sequences import CameraSequence, camera_sequences
from modsim3d.runs.locating import Attitude
from modsim3d.runs.stored_run import StoredRun


@dataclass(frozen=True, eq=False)
class ExportRequest:
    """A finished run, and which of its cameras are exported.

    Attributes:
        run: The run.
        cameras: Indices into the scene's cameras, ascending.
        masks: Whether the pixels of the vessels are written too.
        attitude: Of cameras on board: as the inertial unit measures it, or the true one.
    """

    run: StoredRun
    cameras: tuple[int, ...]
    masks: bool = False
    attitude: Attitude = "measured"

    @cached_property
    def sequences(self) -> tuple[CameraSequence, ...]:
        """The frames of the cameras, with what is true in them and what a tracker may read of them."""
        return camera_sequences(self.run, self.cameras)

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names of the cameras."""
        return tuple(self.run.scene.cameras[index].name for index in self.cameras)
