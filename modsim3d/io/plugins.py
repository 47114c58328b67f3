"""Plug-ins: parts from other packages, found by the group and name of their entry point."""

import hashlib
import re
import sys
import traceback
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import EntryPoint, entry_points, version
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from weakref import WeakKeyDictionary

from modsim3d.core.errors import InputError, ModsimError
from modsim3d.io.validation import nearest

POSE_SOURCES = "modsim3d.pose_sources"
WAVE_LEVELS = "modsim3d.wave_levels"
SHAPES = "modsim3d.shapes"
TRACKERS = "modsim3d.trackers"
_MADE = re.compile(r"^(\.\./)+(bin|Scripts)/|(^|/)__(pycache|editable)__|^[^/]*\.(dist|egg)-info/|\.(pyc|pth)$|~$")
"""Names of files that Python, installers and editors make."""

installed_version = cache(version)  # of a package, once in a process: all that it says of itself has to be parsed


@dataclass(frozen=True)
class Plugin:
    """The origin of a part."""

    group: str  # of its entry point
    name: str  # what scene files and commands call it
    package: str  # with its version
    files: Mapping[str, str] = field(default_factory=dict, hash=False)  # SHA-256 by path, as Python loaded them

    def __str__(self) -> str:
        """Text for messages."""
        return f"the plug-in '{self.name}' of {self.package}"

    @property
    def key(self) -> str:
        """Group and name, as `run.json` and plans have them."""
        return f"{self.group}:{self.name}"

    @property
    def sha256(self) -> str:
        """Checksum of its files and their paths."""
        return hashlib.sha256("".join(f"{digest} {name}\n" for name, digest in self.files.items()).encode()).hexdigest()


def plugin_names(group: str) -> tuple[str, ...]:
    """Names of the installed plug-ins of a group, sorted."""
    return tuple(sorted({point.name for point in entry_points(group=group)}))


def load_plugin(group: str, name: str, path: str, built_in: Iterable[str] = ()) -> tuple[object, Plugin]:
    """The object that an entry point names, and its origin. `path` is the key or option that names it, for errors;
    `built_in` are names that need no plug-in, for the hint at an unknown one. Raises InputError if there is no such
    plug-in, more than one, or it cannot be imported."""
    points = list(entry_points(group=group, name=name))
    if not points:
        hint = nearest(name, [*built_in, *plugin_names(group)])
        raise InputError(path, [f"nothing is called '{name}' here, and no plug-in of {group} ({hint})"])
    if len(points) > 1:
        packages = " and ".join(sorted(_package(point) for point in points))
        raise InputError(path, [f"{packages} both bring a plug-in '{name}' of {group}: uninstall one of them"])
    (point,) = points
    try:
        loaded, module = point.load(), sys.modules[point.module]
        if module not in _LOADED:
            _LOADED[module] = own_files(point)
        return loaded, Plugin(group, name, _package(point), _LOADED[module])
    except (Exception, SystemExit) as error:  # a foreign module may raise anything
        plugin = Plugin(group, name, _package(point))
        raise InputError(path, [f"{plugin} cannot be loaded from {point.value}: {_summary(error)}"]) from error


_LOADED: WeakKeyDictionary[ModuleType, dict[str, str]] = WeakKeyDictionary()
"""Files of plug-ins whose modules this process has loaded: what is on the disk later may be another."""


def changed_plugins(plugins: Mapping[str, Mapping[str, str]], since: str) -> list[str]:
    """The files of plug-ins that are not as expected, one line for each. `plugins` has the checksums of the files of
    each plug-in by its `key`, as they were at `since`. Raises InputError if a plug-in is not installed, or cannot be
    loaded."""
    problems = []
    for key, expected in plugins.items():
        group, _, name = key.partition(":")
        _, plugin = load_plugin(group, name, key)
        (point,) = entry_points(group=group, name=name)
        now = own_files(point)
        if now == expected != plugin.files:
            problems.append(f"{plugin}: this process has loaded it before it was changed: start it again")
        problems += [f"{file} of {plugin} has changed since {since}" for file in differing(expected, now)]
    return problems


def differing(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Names whose checksums differ, or that are not in both."""
    return [name for name in {**before, **now} if before.get(name) != now.get(name)]


def own_files(point: EntryPoint) -> dict[str, str]:
    """SHA-256 of the files of a plug-in's package by their paths, sorted; what Python and installers make is left out.
    They are those in the record of its distribution, and all files in its packages but for hidden ones: neither files
    downloaded into them nor an editable installation are in the record."""
    dist = point.dist
    files = {file.as_posix(): Path(str(dist.locate_file(file))) for file in dist.files or ()} if dist else {}
    for module in {point.module, *(entry.module for entry in (dist.entry_points if dist else ()))}:
        files |= _of_package(module)
    contents = {name: path.read_bytes() for name, path in files.items() if not _MADE.search(name) and path.is_file()}
    if dist and (named := dist.read_text("entry_points.txt")):
        contents["entry_points.txt"] = named.encode()
    return {name: hashlib.sha256(content).hexdigest() for name, content in sorted(contents.items())}


def _of_package(module: str) -> Iterator[tuple[str, Path]]:
    """All files of the package that a module is in, or the file of a module in none."""
    name, _, rest = module.partition(".")
    spec = find_spec(name)
    while spec and spec.origin is None and rest:  # a namespace, in which others may have packages too
        inner, _, rest = rest.partition(".")
        if not (package := find_spec(f"{name}.{inner}")) or package.submodule_search_locations is None:
            break
        name, spec = package.name, package
    folders = spec.submodule_search_locations if spec else ()
    if folders is None and spec and spec.origin:
        yield Path(spec.origin).name, Path(spec.origin)
    for folder in map(Path, folders or ()):
        inside = {path: f"/{path.relative_to(folder).as_posix()}" for path in folder.rglob("*")}
        yield from ((name.replace(".", "/") + at, path) for path, at in inside.items() if "/." not in at)


def failed(plugin: Plugin, error: Exception | SystemExit) -> ModsimError:
    """The error of a plug-in in one line, with the name of the plug-in and where it failed."""
    return ModsimError(
        f"{plugin}: {error}" if isinstance(error, ModsimError) else f"{plugin} failed: {_summary(error)}"
    )


def _package(point: EntryPoint) -> str:
    return f"{point.dist.name} {point.dist.version}" if point.dist else "an unknown package"


def _summary(error: Exception | SystemExit) -> str:
    text = " ".join(str(error).split())
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__}: {text} ({Path(last.filename).name}, line {last.lineno})"
