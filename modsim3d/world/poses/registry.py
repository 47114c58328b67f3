"""Pose sources by the name that they have in a scene file: `poses: {NAME: ...}`; built-in ones and plug-ins."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import cast

import numpy as np
from pydantic import BaseModel, ValidationError

from modsim3d.core.errors import InputError, ModsimError
from modsim3d.io.plugins import POSE_SOURCES, Plugin, failed, load_plugin, plugin_names
from modsim3d.io.validation import MAX_COORDINATE_M, describe
from modsim3d.world.poses.agents import AgentsKeys
from modsim3d.world.poses.base import PoseRequest, Poses, PoseSource, SourceKeys, TracksKeys
from modsim3d.world.poses.circular import CircularKeys
from modsim3d.world.poses.labelled import LABELS, LabelsKeys
from modsim3d.world.poses.replay import FileKeys, LivePoses, Step, StreamKeys, time_problems
from modsim3d.world.traffic.generate import TrafficKeys


class CheckedPoses:
    """The poses of a plug-in; errors name the plug-in."""

    def __init__(self, source: PoseSource, plugin: Plugin, vessels: int) -> None:
        """Raise ModsimError if times are not texts of increasing numbers; poses are checked when they are used."""
        self._source, self._plugin, self._vessels = source, plugin, vessels
        times = list(source.timestamps)
        if not times or not all(isinstance(text, str) for text in times):
            raise ModsimError("timestamps must be the texts of the steps' times, at least one")
        if problems := time_problems(times):
            raise ModsimError(problems[0])
        self.timestamps: Sequence[str] = times

    def poses(self, first: int, stop: int) -> Poses:
        """Poses at steps first to stop − 1. Raises ModsimError if the plug-in fails or returns something else."""
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


SOURCES: dict[str, type[SourceKeys]] = {
    "file": FileKeys,
    "circular": CircularKeys,
    "tracks": TracksKeys,
    "agents": AgentsKeys,
    "traffic": TrafficKeys,
    "stream": StreamKeys,
    LABELS: LabelsKeys,
}


@dataclass(frozen=True)
class NamedSource:
    """A scene's pose source: its name, its section of the scene file, and its plug-in; None if it is built in."""

    name: str
    keys: SourceKeys
    plugin: Plugin | None

    def vessels(self, request: PoseRequest) -> Mapping[str, Mapping[str, object]]:
        """Entries of the vessels that it draws, see `SourceKeys.vessels`; each entry of a plug-in is checked elsewhere.
        Raises InputError with every problem found, or if a plug-in fails or returns no mapping of names to mappings."""
        if self.plugin is None:
            return self.keys.vessels(request)
        with _failures_of(self.plugin):
            entries = self.keys.vessels(request)
            if not isinstance(entries, Mapping) or not all(isinstance(entry, Mapping) for entry in entries.values()):
                wanted = "a mapping of vessel ID to the mapping of a vessels file's entry"
                raise ModsimError(f"vessels() must return {wanted}")
            return {name: dict(entry) for name, entry in entries.items()}

    def build(self, request: PoseRequest) -> PoseSource:
        """The poses of a scene's vessels; see `SourceKeys.build`. Raises InputError with every problem found, or if a
        plug-in fails or returns no pose source."""
        if self.plugin is None:
            return self.keys.build(request)
        with _failures_of(self.plugin):
            source = self.keys.build(request)
            _check_files(self.keys.files, request)
            if not (hasattr(source, "timestamps") and callable(getattr(source, "poses", None))):
                wanted = "a pose source, with timestamps and poses(first, stop)"
                raise ModsimError(f"build() must return {wanted}, not {source!r}")
            vessels = len(request.names or ())
            if isinstance(source, LivePoses):
                return LivePoses(_checked_steps(source.steps, self.plugin, vessels), vessels, source.source)
            return CheckedPoses(source, self.plugin, vessels)


@contextmanager
def _failures_of(plugin: Plugin) -> Iterator[None]:
    """Name a plug-in in whatever it raises; with every problem in an `InputError`, it has done so itself."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"poses.{plugin.name}", [str(failed(plugin, error))]) from error


def read_source(poses: Mapping[str, object], scene: str) -> NamedSource:
    """The one source that a scene file names in its section `poses`; `scene` is its name in errors. Raises InputError
    if there is not exactly one, no such source, or its keys are wrong."""
    given = {name: keys for name, keys in poses.items() if keys is not None}
    if len(given) != 1:
        got = f" (got {', '.join(given)})" if given else ""
        names = ", ".join((*SOURCES, *plugin_names(POSE_SOURCES)))
        raise InputError(scene, [f"poses: give exactly one of {names}{got}"])
    ((name, keys),) = given.items()
    model, plugin = _model(name)
    try:
        read = model.model_validate(keys)
    except ValidationError as error:
        raise InputError(scene, describe(error, model, "poses", name)) from None
    except Exception as error:  # a validator of a foreign model may raise anything
        if plugin is None:
            raise
        raise InputError(f"poses.{name}", [str(failed(plugin, error))]) from error
    return NamedSource(name, cast(SourceKeys, read), plugin)


def _model(name: str) -> tuple[type[BaseModel], Plugin | None]:
    """The class that reads a source's section: a pydantic model that is also `SourceKeys`."""
    model: object = SOURCES.get(name)
    plugin = None
    if model is None:
        model, plugin = load_plugin(POSE_SOURCES, name, f"poses.{name}", SOURCES)
    if isinstance(model, type) and issubclass(model, BaseModel) and issubclass(model, SourceKeys):
        return model, plugin
    wanted = "a class made from modsim3d.plugins.PosesByTime, or from SourceKeys and a pydantic model"
    raise InputError(f"poses.{name}", [f"{plugin} must be {wanted}, not {model!r}"])
