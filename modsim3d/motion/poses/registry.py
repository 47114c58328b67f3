"""Pose sources by the name that they have in a scene file: `poses: {NAME: ...}`; built-in ones and plug-ins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import cast

from pydantic import BaseModel, ValidationError

from modsim3d.errors import InputError
from modsim3d.inputs.plugins import POSE_SOURCES, Plugin, failed, load_plugin, plugin_names
from modsim3d.inputs.validation import describe
from modsim3d.motion.poses.agents import AgentsKeys
from modsim3d.motion.poses.base import PoseRequest, PoseSource, SourceKeys
from modsim3d.motion.poses.checked import build_plugin, plugin_vessels
from modsim3d.motion.poses.circular import CircularKeys
from modsim3d.motion.poses.replay import FileKeys
from modsim3d.motion.poses.stream import StreamKeys
from modsim3d.motion.poses.tracks import TracksKeys
from modsim3d.motion.poses.traffic import TrafficKeys

SOURCES: dict[str, type[SourceKeys]] = {
    "file": FileKeys,
    "circular": CircularKeys,
    "tracks": TracksKeys,
    "agents": AgentsKeys,
    "traffic": TrafficKeys,
    "stream": StreamKeys,
}


@dataclass(frozen=True)
class NamedSource:
    """A scene's pose source: its name, its section of the scene file, and its plug-in; None if it is built in."""

    name: str
    keys: SourceKeys
    plugin: Plugin | None

    def vessels(self, request: PoseRequest) -> Mapping[str, Mapping[str, object]]:
        """Entries of the vessels that it draws; see `SourceKeys.vessels`."""
        return self.keys.vessels(request) if self.plugin is None else plugin_vessels(self.keys, self.plugin, request)

    def build(self, request: PoseRequest) -> PoseSource:
        """The poses of a scene's vessels; see `SourceKeys.build`."""
        return self.keys.build(request) if self.plugin is None else build_plugin(self.keys, self.plugin, request)


def read_source(poses: Mapping[str, object], scene: str) -> NamedSource:
    """The one source that a scene file names in its section `poses`; `scene` is its name in errors.

    Raises:
        InputError: There is not exactly one, no such source, or its keys are wrong.
    """
    given = {name: keys for name, keys in poses.items() if keys is not None}
    if len(given) != 1:
        got = f" (got {', '.join(given)})" if given else ""
        known = ", ".join((*SOURCES, *plugin_names(POSE_SOURCES)))
        raise InputError(scene, [f"poses: give exactly one of {known}{got}"])
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
    found: object = SOURCES.get(name)
    plugin = None
    if found is None:
        found, plugin = load_plugin(POSE_SOURCES, name, f"poses.{name}", SOURCES)
    if isinstance(found, type) and issubclass(found, BaseModel) and issubclass(found, SourceKeys):
        return found, plugin
    problem = (
        f"{plugin} must be a class made from modsim3d.motion.poses.PosesByTime, or from SourceKeys and a pydantic "
        f"model, not {found!r}"
    )
    raise InputError(f"poses.{name}", [problem])
