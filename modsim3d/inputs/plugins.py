"""Plug-ins: parts from other packages, found by the group and name of their entry point."""

from __future__ import annotations

import traceback
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from modsim3d.errors import InputError, ModsimError
from modsim3d.inputs.validation import nearest

POSE_SOURCES = "modsim3d.pose_sources"
WAVE_LEVELS = "modsim3d.wave_levels"
SHAPES = "modsim3d.shapes"
TRACKERS = "modsim3d.trackers"


@dataclass(frozen=True)
class Plugin:
    """The origin of a part.

    Attributes:
        group: Entry point group.
        name: What scene files and commands call it.
        package: Name and version of the package.
    """

    group: str
    name: str
    package: str

    def __str__(self) -> str:
        """Text for messages."""
        return f"the plug-in '{self.name}' of {self.package}"


def plugin_names(group: str) -> tuple[str, ...]:
    """Names of the installed plug-ins of a group, sorted."""
    return tuple(sorted({point.name for point in entry_points(group=group)}))


def load_plugin(group: str, name: str, path: str, built_in: Iterable[str] = ()) -> tuple[object, Plugin]:
    """The object that an entry point names, and its origin.

    Args:
        group: Entry point group.
        name: What the scene file or the command calls it.
        path: The key or option that names it, for errors.
        built_in: Names that need no plug-in, for the hint at an unknown name.

    Raises:
        InputError: There is no such plug-in, more than one, or it cannot be imported.
    """
    found = list(entry_points(group=group, name=name))
    if not found:
        hint = nearest(name, [*built_in, *plugin_names(group)])
        raise InputError(path, [f"nothing is called '{name}' here, and no plug-in of {group} ({hint})"])
    if len(found) > 1:
        packages = " and ".join(sorted(_package(point) for point in found))
        raise InputError(path, [f"{packages} both bring a plug-in '{name}' of {group}: uninstall one of them"])
    (point,) = found
    plugin = Plugin(group, name, _package(point))
    try:
        return point.load(), plugin
    except Exception as error:  # a foreign module may raise anything
        raise InputError(path, [f"{plugin} cannot be loaded from {point.value}: {_summary(error)}"]) from error


def failed(plugin: Plugin, error: Exception) -> ModsimError:
    """The error of a plug-in in one line, with the name of the plug-in and where it failed."""
    return ModsimError(
        f"{plugin}: {error}" if isinstance(error, ModsimError) else f"{plugin} failed: {_summary(error)}"
    )


def _package(point: EntryPoint) -> str:
    return f"{point.dist.name} {point.dist.version}" if point.dist else "an unknown package"


def _summary(error: Exception) -> str:
    text = " ".join(str(error).split())
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {text} ({Path(last.filename).name}, line {last.lineno})"
