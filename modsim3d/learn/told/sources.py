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
            InputError: A file cannot be read.
        """
        return (*self._files(), *(found for run in self.runs for found in run_inputs(run)))

    @property
    def seeds(self) -> tuple[tuple[str, str], ...]:
        """The seed of the bootstrap, and those of the runs."""
        of_runs = ((f"{name} of {run.folder}", seed) for run in self.runs for name, seed in run_seeds(run))
        return ("bootstrap", str(self.settings.seed)), *of_runs

    @property
    def made_before(self) -> tuple[tuple[str, str], ...]:
        """By which versions the runs were made."""
        return tuple(dict.fromkeys(found for run in self.runs for found in run_versions(run)))

    def _files(self) -> Iterator[Input]:
        files_of, rest = self._sorted()
        for place, pair in enumerate(zip(self.truth, self.detections, strict=True)):
            number = f" {place + 1}" if len(self.truth) > 1 else ""
            for what, given in zip((f"ground truth{number}", f"detections{number}"), pair, strict=True):
                if given.is_dir():
                    yield folder_input(what, given, files_of.get(given.absolute(), []))
                else:
                    yield file_input(what, given)
        yield from (file_input("also read", path) for path in rest)

    def _sorted(self) -> tuple[dict[Path, list[Path]], list[Path]]:
        """The files that were read by the path that they belong to, which is absolute, and those of none.

        A file belongs to the innermost of the given paths that it lies in. What is read of a run is listed with it.
        """
        given = {path.absolute() for path in (*self.truth, *self.detections)}
        runs = [run.folder.resolve() for run in self.runs]
        found: dict[Path, list[Path]] = {}
        rest: list[Path] = []
        for path in dict.fromkeys(self.read):
            if not path.is_file() or path.suffix.lower() in _IMAGES:
                continue
            whole = path.absolute()
            owner = next((each for each in (whole, *whole.parents) if each in given), None)
            if owner is not None:
                found.setdefault(owner, []).append(whole)
            elif not (runs and any(path.resolve().is_relative_to(run) for run in runs)):
                rest.append(path)
        return found, rest
