"""A run directory as an input of a page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from modsim3d.runs.files.block_files import KEPT_TRUTH, SETTINGS_FILE
from modsim3d.runs.files.replacing import RUN_FILE, SCENE_FOLDER, UNFINISHED
from modsim3d.runs.stored_run import StoredRun
from modsim3d.view.pages.provenance import Input, file_input, folder_input, sha256_of, versions_in_words

_TABLES = {
    "truth.parquet": "truth of the run",
    "frames.parquet": "frames and states of the run",
    "detections.parquet": "detections of the run",
}
CHANGED = "not the file that the run wrote: run.json has another checksum"


def run_inputs(run: StoredRun) -> tuple[Input, ...]:
    """Scene, detector, manifest and tables of a run, with the checksums that the files have now.

    An interrupted run has its settings and the truth that it has kept in place of the last two.

    Raises:
        InputError: A file cannot be read.
    """
    work = run.folder if run.finished else run.folder / UNFINISHED
    scene_folder, copy = work / SCENE_FOLDER, run.scene.copy
    listing = RUN_FILE if run.finished else SETTINGS_FILE
    scene = Input(
        "scene of the run",
        str(scene_folder / copy.names[0]),
        run.settings["scene_sha256"],
        f"of the scene and every file that it names; {listing} has it as scene_sha256",
    )
    detector = scene_folder / str(copy.document["detector"])
    found = [scene, _run_file(run, detector, "detector file of the run")]
    if not run.finished:
        kept = folder_input("truth that the run has kept", work, work.glob(KEPT_TRUTH))
        return (*found, file_input("settings of the run", work / SETTINGS_FILE), kept)
    tables = [_run_file(run, run.folder / name, what) for name, what in _TABLES.items()]
    return (*found, file_input("manifest of the run", run.folder / RUN_FILE), *tables)


def _run_file(run: StoredRun, path: Path, what: str) -> Input:
    """A file that the run has listed with its checksum; a file that was changed since stands out."""
    found = sha256_of(path)
    listed = (run.settings.get("files") or {}).get(path.relative_to(run.folder).as_posix(), {}).get("sha256", found)
    return Input(what, str(path), found, "" if listed == found else CHANGED, listed != found)


def track_inputs(name: str, path: Path | None) -> Iterator[Input]:
    """The files with the tracks of a tracker."""
    if path is None:
        yield Input(f"tracks of {name}", "given in memory", None)
    elif path.is_dir():
        files = [each for each in path.rglob("*") if each.is_file() and not each.name.startswith(".")]
        yield folder_input(f"tracks of {name}", path, files)
    else:
        yield file_input(f"tracks of {name}", path)


def run_seeds(run: StoredRun) -> tuple[tuple[str, str], ...]:
    """The seeds of a run."""
    seeds = {"scene": run.scene.seed, "detector": run.scene.detector_seed, "traffic": run.settings.get("traffic_seed")}
    return tuple((name, str(seed)) for name, seed in seeds.items() if seed is not None)


def run_versions(run: StoredRun) -> tuple[tuple[str, str], ...]:
    """The versions that made a run, and its renderer."""
    settings = run.settings
    found = [
        ("The run was made with", versions_in_words(settings["versions"])),
        ("The run's renderer", settings["backend"]),
    ]
    if truth := settings.get("truth_versions"):
        found.insert(1, ("Its truth was made with", versions_in_words(truth)))
    if settings.get("plugins"):
        found.append(("Plug-ins", ", ".join(f"{name} of {package}" for name, package in settings["plugins"].items())))
    return tuple(found)
