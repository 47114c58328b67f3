"""Formats by the name that `modsim3d export --format` takes. To add one, write a module and enter it here."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from modsim3d.formats.writing.request import ExportRequest


@dataclass(frozen=True)
class Format:
    """A format.

    Attributes:
        module: Module below this package that writes it. It has `files`, which gives the paths inside the folder before
            anything is done, and `write`, which writes them all.
        content: What it writes, for the command's help.
        options: Options of the command that only some formats take, and this one.
    """

    module: str
    content: str
    options: tuple[str, ...] = ()

    def files(self, request: ExportRequest) -> tuple[str, ...]:
        """Paths, relative to the folder, of the files that `write` will write."""
        paths: tuple[str, ...] = self._imported().files(request)
        return paths

    def write(self, request: ExportRequest, folder: Path) -> None:
        """Write the files into a folder, which is made where it is not there."""
        self._imported().write(request, folder)

    def _imported(self) -> ModuleType:  # a format may need a library that is slow or missing
        return import_module(f"{__package__}.{self.module}")


FORMATS = {
    "coco": Format("coco", "gt.json and dt.json"),
    "csv": Format("csv", "tables with bearings and positions", ("attitude",)),
}
