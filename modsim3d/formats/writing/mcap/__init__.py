"""A ROS 2 bag in MCAP of what a tracker may read, and beside it one of the truth.

The bag that a tracker plays names no vessel but own ship. docs/ros.md has topics, types and frames.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from modsim3d.formats.writing.mcap.bag import open_bag
from modsim3d.formats.writing.mcap.definitions import message_types
from modsim3d.formats.writing.mcap.messages import Messages
from modsim3d.formats.writing.mcap.names import bag_names
from modsim3d.formats.writing.mcap.recording import Recording
from modsim3d.formats.writing.mcap.stamps import stamps_ns
from modsim3d.formats.writing.request import ExportRequest
from modsim3d.outputs.placing import make_folder, put_in_place

BAGS = ("detections", "truth")
"""Folders of the bags; the first is a tracker's."""
FILES = tuple(f"{bag}/{name}" for bag in BAGS for name in (f"{bag}.mcap", "metadata.yaml"))


def files(request: ExportRequest) -> tuple[str, ...]:
    """The paths of the files.

    Raises:
        ModsimError: rosbags is not installed, the run has no step, or its names or times cannot be those of a bag.
    """
    _recording(request)
    return FILES


def write(request: ExportRequest, folder: Path) -> None:
    """Write a run."""
    run, store = request.run, message_types()
    if run.stored is not None:
        run.stored.check_checksums()
    recording = _recording(request)
    with _bag_folders(folder) as (tracker_folder, truth_folder), ExitStack() as bags:
        tracker, truth = (bags.enter_context(open_bag(each, store)) for each in (tracker_folder, truth_folder))
        recording.begin(tracker, truth)
        for block in run.blocks():
            recording.write(block, tracker, truth)


def _recording(request: ExportRequest) -> Recording:
    run = request.run
    run.check_has_steps()
    messages, scene = Messages(message_types()), run.scene
    return Recording(scene, bag_names(request), stamps_ns(scene.timestamps(0, run.steps), scene.title), messages)


@contextmanager
def _bag_folders(folder: Path) -> Iterator[list[Path]]:
    """Folders to write the bags to; all of their files get their places when all are complete."""
    work = folder / ".mcap.partial"
    with ExitStack() as places:
        for bag in BAGS:
            make_folder(folder / bag)
        final = {name: places.enter_context(put_in_place(folder / name)) for name in FILES}
        places.callback(shutil.rmtree, work, ignore_errors=True)
        shutil.rmtree(work, ignore_errors=True)  # of a command that was killed
        yield [work / bag for bag in BAGS]
        for name, partial in final.items():
            (work / name).replace(partial)
