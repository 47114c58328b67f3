"""Tracks in the world from files."""

from __future__ import annotations

from modsim3d.errors import InputError
from modsim3d.paths import StrPath, as_path
from modsim3d.runs.stored_run import StoredRun
from modsim3d.tracks.files.text_table import source_of
from modsim3d.tracks.world_bag import read_world_bag
from modsim3d.tracks.world_csv import IN_SCENE, ON_EARTH, header, read_world_csv
from modsim3d.tracks.world_rows import checked
from modsim3d.tracks.world_tracks import WorldTracks

BAG_FILE = "metadata.yaml"
"""What every ROS 2 bag has in its folder."""
BAG_ENDINGS = (".mcap", ".db3")
IN_IMAGE = "x_min_px"


def is_world(path: StrPath) -> bool:
    """Whether a file or folder has tracks in the world: a ROS 2 bag, or CSV with places in the world and no boxes."""
    path = as_path(path, "path", "tracks")
    if path.is_dir():
        return (path / BAG_FILE).is_file()
    if path.suffix.lower() in BAG_ENDINGS:
        return True
    try:
        columns = ",".join(header(path)).translate(str.maketrans(";\t|", ",,,")).split(",")  # which the reader refuses
    except InputError:  # whoever reads it says so
        return False
    return IN_IMAGE not in columns and any(name in columns for name in IN_SCENE + ON_EARTH)


def read_world_tracks(path: StrPath, run: StoredRun, topic: str | None = None) -> WorldTracks:
    """Read tracks in the world.

    Args:
        path: A CSV file, or the folder of a ROS 2 bag.
        run: The run that the tracker was given.
        topic: The bag's topic; None for the only one that can be.

    Raises:
        InputError: The file is wrong, or is not of this run; each problem says where it is.
        ModsimError: rosbags is not installed, and a bag needs it.
    """
    path = as_path(path, "path", "tracks")
    run.check_has_steps()
    if path.suffix.lower() in BAG_ENDINGS and path.is_file():
        if not (path.parent / BAG_FILE).is_file():
            raise InputError(source_of(path), [f"{BAG_FILE} is missing beside it: give the whole folder of the bag"])
        path = path.parent
    if path.is_dir():
        return checked(read_world_bag(path, run, topic), run)
    if topic is not None:
        raise InputError(source_of(path), ["a topic is for a ROS 2 bag"])
    return checked(read_world_csv(path, run), run)
