"""Requests of exports, and the formats by the name that `modsim3d export --format` takes; a new one is entered here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the command's help shows the formats, and needs no run
    from modsim3d.runs.camera_sequences import CameraSequence
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
        from modsim3d.runs.camera_sequences import camera_sequences

        return camera_sequences(self.run, self.cameras)

    @property
    def camera_names(self) -> tuple[str, ...]:
        """Names of the cameras."""
        return tuple(self.run.scene.cameras[index].name for index in self.cameras)


@dataclass(frozen=True)
class Format:
    """A format."""

    # Module below this package that writes it. It has `files`, which gives the paths inside the folder before anything
    # is done, and `write`, which writes them all. It may have `notes`.
    module: str
    content: str  # for the command's help
    options: tuple[str, ...] = ()  # of the command, that it takes beside those that every format takes

    def files(self, request: ExportRequest) -> tuple[str, ...]:
        """Paths, relative to the folder, of the files that `write` will write."""
        paths: tuple[str, ...] = self._imported().files(request)
        return paths

    def notes(self, request: ExportRequest) -> tuple[str, ...]:
        """Remarks on the files for the user."""
        module = self._imported()
        return module.notes(request) if hasattr(module, "notes") else ()

    def folders(self) -> Mapping[str, str]:
        """The pattern of the names in each folder of which `write` makes everything; relative to the folder. A format
        with a file for each frame has them as `FOLDERS`."""
        return getattr(self._imported(), "FOLDERS", {})

    def write(self, request: ExportRequest, folder: Path) -> None:
        """Write the files into a folder, which is made where it is not there."""
        self._imported().write(request, folder)

    def _imported(self) -> ModuleType:  # a format may need a library that is slow or missing
        return import_module(f"{__package__}.{self.module}")


FORMATS = {
    "mot": Format("mot", "sequences of MOTChallenge for trackers and their evaluators"),
    "coco": Format("coco", "gt.json and dt.json", options=("--masks",)),
    "yolo": Format("yolo", "labels, predictions and data.yaml"),
    "csv": Format("csv", "tables with bearings and positions", options=("--true-attitude",)),
    "mcap": Format("mcap", "ROS 2 bags: detections, and truth apart"),
    "ais": Format("ais.log", "the log of an AIS receiver, ais.nmea, and ais_truth.csv"),
}
