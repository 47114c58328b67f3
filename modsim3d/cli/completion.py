"""Completions for the Tab key, found without loading more than the command line itself."""

from __future__ import annotations

from pathlib import Path

from modsim3d.io.input_files import data_folder

_SCENE_FILES = (".yaml", ".yml", ".json")


def complete_scene(incomplete: str) -> list[str]:
    """Shipped scenes, and scene files of the working directory, that begin so.

    Where no shipped scene does, there is nothing, and the shell completes the names of files and folders by itself.
    """
    return _completed(incomplete, data_folder("scenes"), _SCENE_FILES)


def complete_campaign(incomplete: str) -> list[str]:
    """Shipped campaigns, and YAML files of the working directory, that begin so; or nothing, as for scenes."""
    return _completed(incomplete, data_folder("scenes") / "campaigns", _SCENE_FILES[:2])


def _completed(incomplete: str, folder: Path, endings: tuple[str, ...]) -> list[str]:
    shipped = [path.stem for path in sorted(folder.glob("*.yaml")) if path.stem.startswith(incomplete)]
    if not shipped:
        return []
    files = (path.name for path in sorted(Path().iterdir()) if path.suffix in endings and path.is_file())
    return shipped + [name for name in files if name.startswith(incomplete)]


def complete_tracker(incomplete: str) -> list[str]:
    """Names of trackers that begin so."""
    from modsim3d.tracking.trackers.names import tracker_names

    return [name for name in tracker_names() if name.startswith(incomplete)]
