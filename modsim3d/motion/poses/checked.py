"""Pose sources of plug-ins: built, and checked whenever they are used, so that errors name the plug-in."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from modsim3d.errors import InputError, ModsimError
from modsim3d.inputs.plugins import Plugin, failed
from modsim3d.inputs.validation import MAX_COORDINATE_M
from modsim3d.motion.poses.base import PoseRequest, Poses, PoseSource, SourceKeys
from modsim3d.motion.poses.live import LivePoses, Step
from modsim3d.motion.poses.replay import time_problems


class CheckedPoses:
    """The poses of a plug-in; errors name the plug-in."""

    def __init__(self, source: PoseSource, plugin: Plugin, vessels: int) -> None:
        """Check the times. Poses are checked when they are used.

        Raises:
            ModsimError: The times are not texts of increasing numbers.
        """
        self._source, self._plugin, self._vessels = source, plugin, vessels
        times = list(source.timestamps)
        if not times or not all(isinstance(text, str) for text in times):
            raise ModsimError("timestamps must be the texts of the steps' times, at least one")
        if problems := time_problems(times):
            raise ModsimError(problems[0])
        self.timestamps: Sequence[str] = times

    def poses(self, first: int, stop: int) -> Poses:
        """Poses at steps first to stop − 1.

        Raises:
            ModsimError: The plug-in fails or returns something else.
        """
        try:
            poses = self._source.poses(first, stop)
        except Exception as error:
            raise failed(self._plugin, error) from error
        _check(poses, (stop - first, self._vessels), self._plugin)
        return poses


def _check(poses: Poses, shape: tuple[int, int], plugin: Plugin) -> None:
    wanted = {"present": (bool, shape), "positions_m": (float, (*shape, 3)), "headings_rad": (float, shape)}
    for name, (kind, size) in wanted.items():
        values = getattr(poses, name, None)
        if not isinstance(values, np.ndarray) or values.dtype != kind or values.shape != size:
            got = f"{values.dtype} {values.shape}" if isinstance(values, np.ndarray) else type(values).__name__
            raise ModsimError(f"{plugin}: {name} must be an array of {kind.__name__} {size}, not {got}")
        if not (np.abs(values[poses.present] if kind is float else values) <= MAX_COORDINATE_M).all():
            raise ModsimError(f"{plugin}: {name} must be finite and at most {MAX_COORDINATE_M:g}")


def _checked_steps(steps: Iterable[Step], plugin: Plugin, vessels: int) -> Iterator[Step]:
    """The steps of a live source as they arrive."""
    arrive = iter(steps)
    while True:
        try:
            timestamp, poses = next(arrive)
        except StopIteration:
            return
        except Exception as error:
            raise failed(plugin, error) from error
        _check(poses, (1, vessels), plugin)
        yield str(timestamp), poses


def _check_files(files: object, request: PoseRequest) -> None:
    """The files that a source names must exist, since a run copies them."""
    if not isinstance(files, tuple | list) or not all(isinstance(file, str) for file in files):
        raise ModsimError(f"files must be the names of files as the scene file has them, not {files!r}")
    for file in files:
        if not (request.folder / file).is_file():
            raise ModsimError(f"files names {file!r}, which is no file")


def plugin_vessels(keys: SourceKeys, plugin: Plugin, request: PoseRequest) -> Mapping[str, Mapping[str, object]]:
    """Entries of the vessels that a plug-in draws; each entry is checked elsewhere.

    Raises:
        InputError: The plug-in fails, or returns something that is no mapping of names to mappings.
    """
    try:
        entries = keys.vessels(request)
        if not isinstance(entries, Mapping) or not all(isinstance(entry, Mapping) for entry in entries.values()):
            raise ModsimError("vessels() must return a mapping of vessel ID to the mapping of a vessels file's entry")
        return {name: dict(entry) for name, entry in entries.items()}
    except InputError:
        raise
    except ModsimError as error:
        raise InputError(f"poses.{plugin.name}", [f"{plugin}: {error}"]) from error
    except Exception as error:
        raise InputError(f"poses.{plugin.name}", [str(failed(plugin, error))]) from error


def build_plugin(keys: SourceKeys, plugin: Plugin, request: PoseRequest) -> PoseSource:
    """The pose source of a plug-in.

    Raises:
        InputError: The plug-in fails, or returns something that is no pose source.
    """
    try:
        source = keys.build(request)
        _check_files(keys.files, request)
        if not (hasattr(source, "timestamps") and callable(getattr(source, "poses", None))):
            raise ModsimError(
                f"build() must return a pose source, with timestamps and poses(first, stop), not {source!r}"
            )
        vessels = len(request.names or ())
        if isinstance(source, LivePoses):
            return LivePoses(_checked_steps(source.steps, plugin, vessels), vessels, source.source)
        return CheckedPoses(source, plugin, vessels)
    except InputError:
        raise
    except ModsimError as error:
        raise InputError(f"poses.{plugin.name}", [f"{plugin}: {error}"]) from error
    except Exception as error:
        raise InputError(f"poses.{plugin.name}", [str(failed(plugin, error))]) from error
