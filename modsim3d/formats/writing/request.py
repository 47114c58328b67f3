"""Request of an export."""

from dataclasses import dataclass
from functools import cached_property

from modsim3d.runs.camera_sequences import CameraSequence, camera_sequences
from modsim3d.runs.locating import Attitude
from modsim3d.runs.stored_run import StoredRun


@dataclass(frozen=True, eq=False)
class ExportRequest:
    """A finished run, and which of its cameras are exported."""

    run: StoredRun
    cameras: tuple[int, ...]  # indices into the scene's cameras, ascending
    masks: bool = False  # whether the pixels of the vessels are written too
    attitude: Attitude = "measured"  # of cameras on board: as the inertial unit measures it, or the true one

    @cached_property
    def sequences(self) -> tuple[CameraSequence, ...]:
        """The frames of the cameras, with what is true in them and what a tracker may read of them."""
        return camera_sequences(self.run, self.cameras)

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names of the cameras."""
        return tuple(self.run.scene.cameras[index].name for index in self.cameras)
