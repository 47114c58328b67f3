"""What a detector was learned from, for the page of what was learned."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from modsim3d.learn.learned import Settings
from modsim3d.runs.stored_run import StoredRun
from modsim3d.view.pages.provenance import Input, file_input, folder_input
from modsim3d.view.pages.run_inputs import run_inputs, run_seeds, run_versions

_IMAGES = frozenset({".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp"})
"""Of an image nothing but its size is read."""


@dataclass(frozen=True, eq=False)
class Sources:
    """Files and runs that were learned from.

    Attributes:
        truth: Ground truth, as it was given: a file or a folder for each condition.
        detections: The results on each.
        runs: Runs in place of both, or beside them.
        read: Every file that was opened; also those that are not named, such as `data.yaml`.
        settings: How was learned.
        made_by: The command, or the call from Python.
    """

    truth: tuple[Path, ...]
    detections: tuple[Path, ...]
    runs: tuple[StoredRun, ...]
    read: tuple[Path, ...]
    settings: Settings
    made_by: str

    @property
    def names(self) -> tuple[str, ...]:
        """The labelled sets and the runs, as they were given."""
        return tuple(str(path) for path in (*self.truth, *(run.folder for run in self.runs)))

    @property
    def inputs(self) -> tuple[Input, ...]:
        """All files with their checksums.

        Raises:
            OSError: A file cannot be read.
        """
        return (*self._files(), *(found for run in self.runs for found in run_inputs(run)))

    @property
    def seeds(self) -> tuple[tuple[str, str], ...]:
        """The seed of the bootstrap, and those of the runs."""
        of_runs = ((f"{run.folder}, {name}", seed) for run in self.runs for name, seed in run_seeds(run))
        return ("bootstrap", str(self.settings.seed)), *of_runs

    @property
    def made_before(self) -> tuple[tuple[str, str], ...]:
        """By which versions the runs were made."""
        return tuple(dict.fromkeys(found for run in self.runs for found in run_versions(run)))

    def _files(self) -> Iterator[Input]:
        read = dict.fromkeys(path for path in self.read if path.is_file() and path.suffix.lower() not in _IMAGES)
        folders = [run.folder for run in self.runs]
        rest = [path for path in read if not any(path.is_relative_to(folder) for folder in folders)]
        for place, pair in enumerate(zip(self.truth, self.detections, strict=True)):
            number = f" {place + 1}" if len(self.truth) > 1 else ""
            for what, given in zip((f"ground truth{number}", f"detections{number}"), pair, strict=True):
                mine = [path for path in rest if path.is_relative_to(given)]
                rest = [path for path in rest if path not in mine]
                if given.is_dir():
                    yield folder_input(what, given, mine)
                else:
                    yield file_input(what, given)
        yield from (file_input("also read", path) for path in rest)
