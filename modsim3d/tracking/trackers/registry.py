"""Trackers by their names: built-in ones and plug-ins, with their settings."""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Annotated, Any

import orjson
from pydantic import Field, ValidationError
from pydantic_core import PydanticSerializationError

from modsim3d.core.errors import InputError, ModsimError
from modsim3d.io.input_files import data_folder
from modsim3d.io.plugins import TRACKERS, Plugin, failed, installed_version, load_plugin
from modsim3d.io.strict_text import load_yaml
from modsim3d.io.validation import Strict, describe, shown
from modsim3d.scene.settings import plain
from modsim3d.tracking.trackers.command import DEFAULT_TIMEOUT_S, RUNS_OTHERS, CommandTracker, argument_files
from modsim3d.tracking.trackers.interface import Tracker
from modsim3d.tracking.trackers.names import BUILT_IN
from modsim3d.tracking.trackers.world_interface import WorldTracker
from modsim3d.tracks.tracks import Origin

AnyTracker = Tracker | WorldTracker | CommandTracker
Model = type[Tracker] | type[WorldTracker]

DEFAULTS = "the tracker's defaults"


class SettingsFile(Strict):
    """The content of a file."""

    # A sentence that says how the settings were chosen, and on which seeds.
    chosen: Annotated[str, Field(min_length=1)]
    settings: dict[str, Any] = Field(default_factory=dict)  # for every scene, in place of the tracker's defaults
    scenes: dict[str, dict[str, Any]] = Field(default_factory=dict)  # for the scenes of these names, in place of those


def chosen_settings(name: str, model: Model, scene: str) -> tuple[dict[str, Any], str]:
    """The settings of a tracker that were chosen for a scene, none where there is no file, and how, in a sentence. Its
    class, `model`, says what is right. Raises InputError if the file cannot be read, or what it sets is wrong."""
    path = data_folder("scenes") / "trackers" / f"{name}.yaml"
    if name not in BUILT_IN or not path.is_file():
        return {}, DEFAULTS
    source = f"settings of a tracker {path}"
    content = load_yaml(path, "settings of a tracker")
    try:
        file = SettingsFile.model_validate(content)
    except ValidationError as error:
        raise InputError(source, describe(error, SettingsFile)) from None
    for place, settings in [("settings",), file.settings], *((("scenes", at), file.scenes[at]) for at in file.scenes):
        try:
            model.model_validate(settings)
        except ValidationError as error:
            raise InputError(source, describe(error, model, *place)) from None
    if not file.settings and scene not in file.scenes:
        return {}, DEFAULTS
    return {**file.settings, **file.scenes.get(scene, {})}, file.chosen


_ALWAYS = ("numpy", "scipy")


@dataclass(frozen=True)
class NamedTracker:
    """A tracker with its settings."""

    name: str
    tracker: AnyTracker
    plugin: Plugin | None  # where it comes from; None if it is built in
    chosen: str  # where its settings come from, in a sentence

    def __str__(self) -> str:
        """Text for messages."""
        return f"the tracker '{self.name}'" if self.plugin is None else str(self.plugin)

    @property
    def origin(self) -> Origin:
        """Origin of its tracks. Raises ModsimError if a library that it needs is not installed, or its settings cannot
        be written as JSON."""
        if isinstance(self.tracker, CommandTracker):
            command = f"command {shlex.join(self.tracker.command)}"
            return Origin(self.name, self.tracker.settings, self.chosen, command, self.tracker.checksums())
        try:
            settings = self.tracker.model_dump(mode="json")
        except PydanticSerializationError as error:
            raise ModsimError(f"{self}: its settings cannot be written as JSON: {error}") from None
        packages = _ALWAYS + (() if self.plugin else BUILT_IN[self.name].packages)
        return Origin(
            tracker=self.name,
            settings=settings,
            chosen=self.chosen,
            package=self.plugin.package if self.plugin else f"modsim3d {installed_version('modsim3d')}",
            versions={package: self._version(package) for package in packages},
        )

    def _version(self, package: str) -> str:
        try:
            return installed_version(package)
        except PackageNotFoundError:
            raise ModsimError(f'{self} needs the library {package}: pip install "modsim3d[trackers]"') from None


def named_tracker(tracker: str | Model, settings: Mapping[str, object], scene: str | None) -> NamedTracker:
    """A built-in tracker or a plug-in by its name, or a class that is one. The settings are its defaults; in their
    place those that were chosen for all shipped scenes; in place of these those chosen for the scene of that name,
    unless it is None; and in place of all those that are given. Raises InputError if there is no such tracker, or a
    setting is wrong, and TypeError if the settings are no mapping."""
    if not isinstance(settings, Mapping):
        raise TypeError(f"settings: a mapping of names to values is needed (got {type(settings).__name__})")
    model, plugin = _model(tracker)
    name = tracker if isinstance(tracker, str) else model.__name__
    defaults, chosen = ({}, DEFAULTS) if scene is None else chosen_settings(name, model, scene)
    given = {str(key): plain(value) for key, value in settings.items()}
    return NamedTracker(name, _validated(model, {**defaults, **given}, name, plugin), plugin, _choice(chosen, given))


def command_tracker(
    command: Sequence[str],
    settings: Mapping[str, object],
    *,
    name: str | None = None,
    folder: Path | None = None,
    timeout_s: float = DEFAULT_TIMEOUT_S,
    files: Sequence[str] | None = None,
) -> NamedTracker:
    """A program as a tracker. `command` has its name and its arguments; it is started in `folder`, the working
    directory if None. `files` decide what it does beside its own, those among its arguments if None. Raises InputError
    if there is no such program or file, or the settings cannot be written as JSON, and TypeError if the command is
    text."""
    if isinstance(command, str):
        raise TypeError(f"command: a list of a program and its arguments is needed (got {shown(command)})")
    given, folder = {str(key): plain(value) for key, value in settings.items()}, (folder or Path()).absolute()
    own = tuple(argument_files(command, folder) if files is None else files)
    tracker = CommandTracker(command=tuple(command), folder=folder, timeout_s=timeout_s, settings=given, files=own)
    try:
        orjson.dumps(given)
    except TypeError as error:
        raise InputError("--command", [f"set: its settings cannot be written as JSON: {error}"]) from None
    named, *others = tracker.paths()
    called = others[0] if others and RUNS_OTHERS.fullmatch(Path(named).name) else named  # of `python3 tracker.py`
    return NamedTracker(name or Path(called).stem, tracker, None, "those that are given")


def _choice(chosen: str, given: Mapping[str, Any]) -> str:
    if not given:
        return chosen
    if chosen == DEFAULTS:
        return f"{chosen}, but for {', '.join(given)}"
    return f"{chosen.rstrip('.')}; but {', '.join(given)} given by the caller"


def _model(name: str | Model) -> tuple[Model, Plugin | None]:
    model: object = name
    plugin: Plugin | None = None
    if isinstance(name, type):
        plugin = Plugin(TRACKERS, name.__name__, f"the module {name.__module__}")
    elif name in BUILT_IN:
        model = getattr(import_module(BUILT_IN[name].module), BUILT_IN[name].class_name)
    else:
        model, plugin = load_plugin(TRACKERS, name, "--tracker", BUILT_IN)
    if isinstance(model, type):
        if issubclass(model, Tracker) and model.follow is not Tracker.follow:
            return model, plugin
        if issubclass(model, WorldTracker) and model.follow_world is not WorldTracker.follow_world:
            return model, plugin
    problem = f"{plugin} must be a class made from modsim3d.Tracker with a method follow, not {model!r}"
    raise InputError(f"--tracker {name}", [problem])


def _validated(model: Model, settings: dict[str, Any], name: str, plugin: Plugin | None) -> AnyTracker:
    source = f"settings of the tracker '{name}'"
    try:
        return model.model_validate(settings)
    except ValidationError as error:
        raise InputError(source, describe(error, model)) from None
    except Exception as error:  # a validator of a foreign model may raise anything
        if plugin is None:
            raise
        raise InputError(source, [str(failed(plugin, error))]) from error
