"""Pose sources by the name that they have in a scene file: `poses: {NAME: ...}`."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import BaseModel, ValidationError

from modsim3d.errors import InputError
from modsim3d.poses.agents import AgentsKeys
from modsim3d.poses.base import SourceKeys
from modsim3d.poses.circular import CircularKeys
from modsim3d.poses.replay import FileKeys
from modsim3d.poses.tracks import TracksKeys
from modsim3d.validation import describe, nearest

SOURCES: dict[str, type[SourceKeys]] = {
    "file": FileKeys,
    "circular": CircularKeys,
    "tracks": TracksKeys,
    "agents": AgentsKeys,
}


def read_source(poses: Mapping[str, object], scene: str) -> tuple[str, SourceKeys]:
    """The one source that a scene file names.

    Args:
        poses: The section of the scene file.
        scene: What to call the scene in an error.

    Returns:
        Its name and its keys.

    Raises:
        InputError: There is not exactly one, no such source, or its keys are wrong.
    """
    given = {name: keys for name, keys in poses.items() if keys is not None}
    unknown = [f"poses.{name}: no such pose source ({nearest(name, SOURCES)})" for name in given if name not in SOURCES]
    if unknown:
        raise InputError(scene, unknown)
    if len(given) != 1:
        got = f" (got {', '.join(given)})" if given else ""
        raise InputError(scene, [f"poses: give exactly one of {', '.join(SOURCES)}{got}"])
    ((name, keys),) = given.items()
    model = SOURCES[name]
    assert issubclass(model, BaseModel)
    try:
        return name, model.model_validate(keys)
    except ValidationError as error:
        raise InputError(scene, describe(error, model, "poses", name)) from None
