"""Exports of runs, and the formats by the name that `modsim3d export --format` takes; a new one is entered here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from modsim3d.core.errors import ModsimError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.core.written_files import OutputFiles

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


def export(
    run: StoredRun | StrPath,
    out: StrPath,
    *,
    format: str,
    cameras: str | Sequence[str] | None = None,
    masks: bool = False,
    true_attitude: bool = False,
    overwrite: bool = False,
) -> OutputFiles:
    """Write a run's truth and detections in another program's format.

        modsim3d.export("runs/first", "exported", format="coco")

    Args:
        run, out: A finished run or its directory; folder for the files.
        format: `mot`, `coco`, `yolo`, `csv`, `mcap` or `ais` (docs/export.md).
        cameras: Cameras to export; all if None.
        masks: Write which pixels each vessel has, whole and visible, in `coco`.
        true_attitude: Write the true attitude of cameras on board, not the measured one, in `csv`.
        overwrite: Replace files that are there.

    Raises:
        ModsimError: The run, the format or an argument is wrong, or the files cannot be written.
        TypeError: A path is neither text nor a path.
    """
    from modsim3d.io.overwrite_guard import claimed, claimed_folders
    from modsim3d.runs.files.overwrite import read_of_run
    from modsim3d.runs.selection import select_cameras
    from modsim3d.runs.stored_run import opened_run

    if format not in FORMATS:
        raise ModsimError(f"--format {format}: needs one of {', '.join(FORMATS)}")
    check_options(format, {"--masks": masks, "--true-attitude": true_attitude})
    chosen, run, out = FORMATS[format], opened_run(run), as_path(out, "out", "a folder")
    indices, read = tuple(sorted(select_cameras(run, cameras))), read_of_run(run.folder)
    request = ExportRequest(run, indices, masks, "true" if true_attitude else "measured")
    paths, folders = [out / name for name in chosen.files(request)], chosen.folders().items()
    with (
        claimed(paths, overwrite=overwrite, inputs=read),
        claimed_folders({out / name: pattern for name, pattern in folders}, overwrite=overwrite, inputs=read),
    ):
        chosen.write(request, out)
    return OutputFiles((*paths, *(out / name for name, _ in folders)), chosen.notes(request))


def check_options(chosen: str, given: Mapping[str, object], others: Mapping[str, Sequence[str]] | None = None) -> None:
    """Raise ModsimError if an option is given that a format does not take; `others` has those of further formats."""
    takers = {other: (*format_.options, "--camera") for other, format_ in FORMATS.items()} | dict(others or {})
    for name, value in given.items():
        if value and name not in takers[chosen]:
            right = " or ".join(other for other, options in takers.items() if name in options)
            raise ModsimError(f"{name} goes with --format {right}, not with {chosen}")
