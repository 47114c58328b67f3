"""Keys of a scene, and of the files that it names, that the caller sets in place of what is written there."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from modsim3d.core.errors import InputError
from modsim3d.core.paths import StrPath, as_path
from modsim3d.detector.file.reading import MISS_RATE, find_detector, is_miss_rate, parse_detector, with_miss_rate
from modsim3d.detector.file.schema import DetectorFile
from modsim3d.detector.file.unread_keys import unread_settings
from modsim3d.detector.model import DetectorModel
from modsim3d.io.strict_text import load_yaml, parse_yaml
from modsim3d.io.validation import find_condition, join_path, kind_of, model_at, nearest, nearest_key
from modsim3d.scene.keys import SceneKeys

KeyPath = tuple[str | int, ...]
FILE_SECTIONS = ("vessels", "detector")  # they may be the name of a file with what could also stand in their place
_INDEX = re.compile(r"\[(\d+)\]")


@dataclass(frozen=True)
class Setting:
    """A key and its new value."""

    key: str  # the keys that lead to it, with dots between them; those of the detector file are below `detector`
    value: Any  # as a YAML file would have it
    option: str = ""  # what messages call it in place of the key, such as `--set waves.level`; empty: the key
    may_be_unread: bool = True  # a detector may have no use for it

    @property
    def parts(self) -> tuple[str, ...]:
        """The keys that lead to it; an item of a list has its index as text."""
        return tuple(_INDEX.sub(r".\1", self.key).split("."))

    @property
    def name(self) -> str:
        """Name of the setting in messages."""
        return self.option or self.key


@dataclass(frozen=True)
class _Place:
    """Place of a setting in the files: `file` is what problems say before the path, empty for the scene file."""

    file: str
    path: KeyPath
    option: str

    def named(self, problem: str) -> str:
        """A problem of the value under the name of the option; empty if it is of something else."""
        place = self.file + join_path(*self.path)
        inside = problem.startswith(place) and problem[len(place) :][:1] in (":", ".", "[")
        return self.option + problem[len(place) :] if inside else ""

    def named_around(self, problem: str) -> str:
        """A problem of a section that holds the value, and the option; empty if it is of something else."""
        sections = (self.file + join_path(*self.path[:length]) for length in range(1, len(self.path)))
        return f"{problem} (after {self.option})" if any(problem.startswith(f"{name}: ") for name in sections) else ""


class Settings:
    """Settings of a scene and of the files that it names; `problems` has a line for each that is wrong in itself."""

    def __init__(self, settings: Iterable[Setting]) -> None:
        """Take the settings; those with fewer keys come first, so that the others go into what they set. Miss rates
        come last, since they change what others set."""
        self.problems: list[str] = []
        self._settings = sorted(settings, key=lambda setting: (is_miss_rate(setting.parts), len(setting.parts)))
        self._of_files: dict[str, list[Setting]] = {section: [] for section in FILE_SECTIONS}
        self._places: list[_Place] = []

    def in_scene(self, data: Any) -> Any:
        """The content of the scene file with the settings; those of files that it names are kept for `in_file`."""
        for setting in self._settings:
            section, *inside = setting.parts
            if inside and section in self._of_files and isinstance(data.get(section), str):
                self._of_files[section].append(setting)
            else:
                data = self._changed(data, setting)
        return data

    def in_file(self, section: str, content: Any, source: str) -> Any:
        """The content of a file that a section of the scene names, with the settings; `source` names it in errors."""
        for setting in self._of_files[section]:
            content = self._changed(content, setting, source, section)
        return content

    def detector_of(self, file: Path) -> tuple[dict[str, Any] | None, DetectorModel]:
        """The content of a detector file with the settings, None if there are none for it, and the detector."""
        content, source, settings = load_yaml(file, "detector"), f"detector {file}", self._of_files["detector"]
        changed = self.in_file("detector", content, source) if settings and isinstance(content, dict) else None
        model = parse_detector(content if changed is None else changed, source)
        paths = {".".join(setting.parts[1:]): setting for setting in settings if not setting.may_be_unread}
        unread = unread_settings(model, paths) if paths else {}
        self.problems += [f"{paths[path].name}: {reason}" for path, reason in unread.items()]
        return changed, model

    def option_of(self, key: str) -> str:
        """The option that sets a key of the scene; empty if none does."""
        return next((setting.option for setting in reversed(self._settings) if setting.key == key), "")

    def sets(self, key: str) -> bool:
        """Whether a key of the scene is set as a whole."""
        return any(setting.key == key for setting in self._settings)

    def named(self, problems: Iterable[str]) -> list[str]:
        """Problems with the option that the caller gave, where they are about what it has set."""
        return [self._named(problem) for problem in problems]

    def _named(self, problem: str) -> str:
        inside = (place.named(problem) for place in self._places)
        around = (place.named_around(problem) for place in self._places)
        return next(filter(None, (*inside, *around)), problem)

    def _changed(self, content: Any, setting: Setting, file: str = "", *prefix: str) -> Any:
        try:
            if prefix and is_miss_rate(setting.parts) and isinstance(content, dict):
                return with_miss_rate(content, setting.value, ".".join(setting.parts[2:-1]) or None, setting.name)
            content, path = changed(content, setting.parts[len(prefix) :], setting, prefix)
        except InputError as error:
            self.problems += [f"{error.source}: {problem}" for problem in error.problems]
            return content
        if setting.option:
            self._places.append(_Place(f"{file}: " if file else "", path[len(prefix) :], setting.option))
        return content


def replacing(values: Mapping[str, object]) -> list[Setting]:
    """The settings of those keys whose value is given, not None; keys of the annotation stand for themselves."""
    path = {key: f"annotation.{key}" for key in ("mode", "source", "supersample", "render")}
    return [Setting(path.get(key, key), plain(value)) for key, value in values.items() if value is not None]


def settings_of(values: Mapping[str, object], *, may_be_unread: bool = False) -> list[Setting]:
    """The settings that the option `--set` gives, from keys with dots to values; see `Setting` for the other argument.
    Raises TypeError if the values are no mapping."""
    if not isinstance(values, Mapping):
        raise TypeError(f"settings: a mapping of keys to values is needed (got {type(values).__name__})")
    return [Setting(str(key), plain(value), f"--set {key}", may_be_unread) for key, value in values.items()]


def plain(value: Any) -> Any:
    """A value as a YAML file would have it: NumPy's arrays and numbers are lists and numbers."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def read_settings(texts: Sequence[str], example: str = "waves.level=large") -> dict[str, object]:
    """Keys and values from texts such as the example; values are YAML, and the last one of a key counts. Raises
    InputError if a text has no key or no `=`, or its value is not YAML."""
    values: dict[str, object] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not (key and equals):
            raise InputError(f"--set {text}", [f"a key and a value are needed, as in {example}"])
        values[key.strip()] = parse_yaml(value, f"--set {key}")
    return values


def changed(content: Any, parts: Sequence[str], setting: Setting, where: KeyPath = ()) -> tuple[Any, KeyPath]:
    """The content with the new value in it, and the path to it; the given content stays as it is. `parts` are the keys
    that lead from the content to the value, and `where` is the path from the scene to the content. A key that replaces
    others, as `level` replaces the `spectrum` of waves, removes them. Raises InputError if no such key can be set."""
    if not parts:
        return setting.value, where
    if isinstance(content, list):
        index = _index(content, parts[0], setting, where)
        inner, path = changed(content[index], parts[1:], setting, (*where, index))
        return [*content[:index], inner, *content[index + 1 :]], path
    if content is None:
        content = {}
    if not isinstance(content, dict):
        problem = f"{join_path(*where)} is {kind_of(content)}, which has no keys that could be set"
        raise InputError(setting.name, [problem])
    key, rest = _split(content, parts)
    # None for a section whose keys are names, or depend on plug-ins.
    model = model_at(DetectorFile, where[1:]) if where[:1] == ("detector",) else model_at(SceneKeys, where)
    if key not in content:
        _check_new(content, key, bool(rest), model, setting, where)
    inner, path = changed(content.get(key), rest, setting, (*where, _text(key)))
    replaced = _others(model, _text(key)) if setting.value is not None else ()
    return {**{name: value for name, value in content.items() if _text(name) not in replaced}, key: inner}, path


def _text(key: object) -> str:
    """A key as text; YAML reads `true` as a truth value."""
    return ("true" if key else "false") if isinstance(key, bool) else str(key)


def _split(content: Mapping[Any, Any], parts: Sequence[str]) -> tuple[Any, Sequence[str]]:
    """The first key and the parts after it; names of vessels and cameras may have dots in them."""
    texts = {_text(name): name for name in content}
    for count in range(1, len(parts) + 1):
        if (text := ".".join(parts[:count])) in texts:
            return texts[text], parts[count:]
    return parts[0], parts[1:]


def _index(content: Sequence[Any], part: str, setting: Setting, where: KeyPath) -> int:
    if part.isdecimal() and int(part) < len(content):
        return int(part)
    problem = f"{join_path(*where)} is a list of {len(content)}: its items are 0 to {len(content) - 1} (got '{part}')"
    raise InputError(setting.name, [problem])


def _check_new(
    content: Mapping[Any, Any], key: str, inside: bool, model: type[BaseModel] | None, setting: Setting, where: KeyPath
) -> None:
    """Refuse a key that the section cannot have, and a value inside a name that the section has not."""
    if model is not None and key not in model.model_fields:
        miss_rate = [MISS_RATE] if is_miss_rate((*map(str, where), MISS_RATE)) else []
        hint = nearest_key(key, [*miss_rate, *model.model_fields])
        raise InputError(setting.name, [f"unknown key {join_path(*where, key)} ({hint})"])
    if model is None and inside:
        raise InputError(setting.name, [f"{join_path(*where)} has no '{key}' ({nearest(key, content)})"])


def _others(model: type[BaseModel] | None, key: str) -> set[str]:
    choices: tuple[tuple[tuple[str, ...], ...], ...] = getattr(model, "alternatives", ())
    replaced: set[str] = set()
    for groups in choices:
        own = [group for group in groups if key in group]
        if len(own) == 1:
            replaced |= {name for group in groups for name in group}.difference(own[0])
    return replaced


NO_DETECTOR = ""


def state_settings(state: str | None, state_from: StrPath | None, detector: StrPath | None) -> list[Setting]:
    """Settings that put the detector into one state for the whole scene. Raises InputError if `state_from` comes
    without a state or beside a detector, or has no detector of this name."""
    place = None if state_from is None else as_path(state_from, "state_from")
    if place is not None and (state is None or detector is not None):
        problem = "--state says which one to take from there: give both" if state is None else "so is --detector"
        raise InputError(f"--from {place}", ["is a detector in place of the scene's: " + problem])
    if state is None:
        return []
    forced = Setting("detector.performance.schedule", [[0, state]], "--state")
    if place is None:
        return [forced]
    if place.is_file():
        return [Setting("detector", str(place.resolve()), f"--from {place}"), forced]
    file = find_condition(state, place)
    return [Setting("detector", str(file.resolve()), f"--state {state} --from {place}")]


def choose_detector(
    detector: StrPath | None,
    *,
    settings: Mapping[str, object] | None = None,
    state: str | None = None,
    state_from: StrPath | None = None,
    may_be_unread: bool = False,
) -> tuple[DetectorModel, Path]:
    """A detector without a scene, and its file; see `load_scene` for what the arguments mean. Raises InputError if no
    detector is named, its file is wrong, or a setting is not one of the detector."""
    if detector is None and state_from is None:
        raise InputError("--detector", ["is missing: give a detector file, or --state NAME --from conditions"])
    for key in settings or {}:
        if key.partition(".")[0] != "detector" or "." not in key:
            raise InputError(f"--set {key}", ["there is no scene: set keys below detector only"])
    given = settings_of(settings or {}, may_be_unread=may_be_unread)
    whole = Settings([*state_settings(state, state_from, detector), *given])
    named = NO_DETECTOR if detector is None else str(find_detector(detector).absolute())
    file = Path(whole.in_scene({"detector": named})["detector"])
    source = f"detector {file}"
    try:
        _, model = whole.detector_of(file)
    except InputError as error:
        problems = whole.named(f"{source}: {problem}" for problem in error.problems)
        raise InputError(
            source, [problem.removeprefix(f"{source}: ") for problem in (*whole.problems, *problems)]
        ) from None
    if whole.problems:
        raise InputError(source, whole.problems)
    return model, file
