"""The scene of a run: loaded once for each truth, with the detector of the run in place."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any, Generic, TypeVar

import orjson

from modsim3d.campaign.drawn_detectors import LearnedUncertainty, drawn_detector, read_uncertainty
from modsim3d.campaign.keys import TrackerKeys
from modsim3d.campaign.plan import Condition
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.detector.file.reading import content_of, find_detector, shipped_detectors
from modsim3d.detector.model import DetectorModel
from modsim3d.io.input_files import data_folder, file_sha256
from modsim3d.io.plugins import installed_version
from modsim3d.io.strict_text import load_json, load_yaml
from modsim3d.io.validation import shown
from modsim3d.learn.learned_detector import uncertainty_file
from modsim3d.runs.run import VERSIONED
from modsim3d.scene.reading import find_scene, load_scene, shipped_scenes
from modsim3d.scene.scene import Scene
from modsim3d.scene.settings import choose_detector, state_settings
from modsim3d.tracking.trackers.registry import NamedTracker, command_tracker, named_tracker


def digest(*parts: Any) -> str:
    """The SHA-256 of values as JSON, in hexadecimal."""
    content = orjson.dumps(parts, option=orjson.OPT_SORT_KEYS | orjson.OPT_NON_STR_KEYS | orjson.OPT_SERIALIZE_NUMPY)
    return hashlib.sha256(content).hexdigest()


def truth_digest(scene: Scene, backend: str) -> str:
    """Digest of the truth: the scene without its detector, and the versions of what makes it, with the `backend`."""
    packages = {name: installed_version(name) for name in VERSIONED}
    plugins = [[plugin.group, plugin.name, plugin.package, plugin.sha256] for plugin in scene.plugins]
    return digest(scene.copy.truth_sha256(), scene.seed if scene.truth_has_seed else None, packages, plugins, backend)


def plan_digest(facts: Mapping[str, Any]) -> str:
    """Digest of all that decides the results, given the content of `plan.json`."""
    campaign = {key: value for key, value in facts["campaign"].items() if key != "keep"}  # which decides no row
    conditions = [{key: value for key, value in entry.items() if key != "values"} for entry in facts["conditions"]]
    plugins = [facts["plugins"]] if facts.get("plugins") else []
    return digest(campaign, conditions, facts["versions"], *plugins)


def detector_digest(detector: DetectorModel) -> str:
    """Digest of a detector that was read from a file, with what was set."""
    return digest(content_of(detector))


def versions() -> dict[str, str]:
    """Version of every package that decides a row; ModsimError if TrackEval, which makes the scores, is missing."""
    try:
        return {name: installed_version(name) for name in (*VERSIONED, "trackeval")}
    except PackageNotFoundError:
        raise ModsimError('the scores of a campaign need TrackEval: pip install "modsim3d[trackers]"') from None


def tracker_of(keys: TrackerKeys, settings: Mapping[str, Any], scene: str | None, folder: Path) -> NamedTracker:
    """A tracker of the campaign with settings of a condition, for the scene of a name as `named_tracker`; programs are
    started in the folder of the campaign file. Raises InputError if there is no such tracker, or a setting is wrong."""
    given = {**keys.settings, **settings}
    if keys.command is None:
        return named_tracker(keys.tracker or "", given, scene)
    return command_tracker(
        keys.command, given, name=keys.label, folder=folder, timeout_s=keys.timeout_s, files=keys.files
    )


def checksums(paths: Iterable[Path], base: Path) -> dict[str, str]:
    """The SHA-256 of files by their paths, which are relative to the folder `base` of the campaign file if they are in
    it. Those that ship with the package are left out, since its version is known."""
    shipped = (data_folder("scenes").resolve(), data_folder("meshes").resolve())
    own = sorted(path for path in set(paths) if not any(path.is_relative_to(folder) for folder in shipped))
    return {_name(path, base): file_sha256(path) for path in own}


def changed_files(files: Mapping[str, str], base: Path) -> list[str]:
    """Files that differ from their checksums, one line for each."""
    problems = []
    for name, expected in files.items():
        try:
            if file_sha256(base / name) != expected:
                problems.append(f"{name} has changed since the campaign was planned")
        except OSError as error:
            problems.append(f"{name} cannot be read any more: {error.strerror or error}")
    return problems


def differing_files(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """The files of two plans whose checksums differ; none if the plans are not of the same files."""
    return [name for name in now if before[name] != now[name]] if before.keys() == now.keys() else []


def _name(path: Path, base: Path) -> str:
    return path.relative_to(base).as_posix() if path.is_relative_to(base) else path.as_posix()


T = TypeVar("T")


class LruCache(Generic[T]):
    """The last few things by their keys."""

    def __init__(self, most: int) -> None:
        """Keep so many."""
        self._most = most
        self._kept: dict[str, T] = {}

    def get(self, key: str, make: Callable[[], T]) -> T:
        """Value of the key, made if it is not there."""
        value = self._kept.pop(key) if key in self._kept else make()
        self._kept[key] = value  # the last one from now on
        if len(self._kept) > self._most:
            del self._kept[next(iter(self._kept))]
        return value


@dataclass(frozen=True)
class DetectorChoice:
    """Settings that decide a detector."""

    detector: str | None  # a file, or the name of a shipped one; None: the scene's
    state: str | None  # for the whole scene; None: it changes as the detector says
    state_from: str | None  # where the state is from, as `--from`
    settings: Mapping[str, Any]  # keys below `detector`

    @classmethod
    def of(cls, values: Mapping[str, Any], folder: Path) -> DetectorChoice:
        """From the values of a condition; paths in them are relative to the folder."""
        named, place = values.get("detector"), values.get("from")
        return cls(
            None if named is None else resolve(named, folder, shipped_detectors()),
            values.get("state"),
            None if place is None else resolve(place, folder, ("conditions",)),
            {key: value for key, value in values.items() if key.startswith("detector.")},
        )

    def file(self, scene_file: Path) -> Path:
        """The detector file, given that of the scene; InputError if there is none."""
        if self.detector is not None:
            return find_detector(self.detector)
        placed = state_settings(self.state, self.state_from, None)
        named = next((str(setting.value) for setting in placed if setting.key == "detector"), None)
        return Path(named) if named else detector_file(scene_file)


def resolve(name: Any, folder: Path, shipped: Any) -> str:
    """A shipped name as it is, and a path from the folder; InputError if it is no text."""
    if not isinstance(name, str):
        raise InputError("campaign", [f"a file or the name of a shipped one is text (got {shown(name)})"])
    path = folder / name
    return name if name in shipped and not path.is_file() else str(path)


class Scenes:
    """Scenes of runs; the latest are kept, since a traffic that is drawn costs a second."""

    def __init__(self, steps: int | None, folder: Path, *, learned: bool = False) -> None:
        """Take the number of steps, None for that of each scene, and the folder that paths in conditions are relative
        to. `learned` draws detectors from what `modsim3d learn` says of them, one for each traffic seed."""
        self._steps, self.folder, self._learned = steps, folder, learned
        self._scenes: LruCache[tuple[str, Scene]] = LruCache(4)
        self._detectors: LruCache[DetectorModel] = LruCache(64)
        self._known: LruCache[tuple[Path, LearnedUncertainty]] = LruCache(64)

    def of(self, condition: Condition, seed: int, detector_seed: int) -> Scene:
        """Scene of a run with its seed and that of its detector; InputError if the scene or the detector is wrong."""
        choice = self._choice(condition, seed)
        wanted = digest(condition.scene, condition.of_detector(), choice.settings)
        loaded_with, scene = self._scenes.get(
            digest(condition.scene, condition.of_truth(), seed), lambda: (wanted, self._load(condition, seed, choice))
        )
        if loaded_with != wanted:
            scene = replace(scene, detector=self._detectors.get(wanted, lambda: _detector(choice, scene.path)))
        return replace(scene, detector_seed=detector_seed)

    def files(self, condition: Condition, scene: Scene) -> set[Path]:
        """The files that a scene of this condition is made of."""
        detector = DetectorChoice.of(condition.of_detector(), self.folder).file(scene.path)
        unsure = [uncertainty_file(detector)] if self._learned else []
        return {path.resolve() for path in (*scene.copy.read, detector, *unsure)}

    def _choice(self, condition: Condition, seed: int) -> DetectorChoice:
        """The detector of a traffic seed; a key that the campaign sets is not drawn, nor what is within it."""
        choice = DetectorChoice.of(condition.of_detector(), self.folder)
        if not self._learned:
            return choice
        scene = find_scene(resolve(condition.scene, self.folder, shipped_scenes()))
        named = digest(str(scene), choice.detector, choice.state, choice.state_from)
        file, uncertainty = self._known.get(named, lambda: _uncertainty(choice.file(scene)))
        try:
            drawn = drawn_detector(uncertainty, seed)
        except ModsimError as error:
            raise InputError(f"detector {file}", [str(error)]) from None
        within = tuple(f"{key}." for key in choice.settings)
        left = {key: value for key, value in drawn.items() if not key.startswith(within)}
        return replace(choice, settings={**left, **choice.settings})

    def alone(self, condition: Condition, seed: int, detector_seed: int) -> Scene:
        """Scene loaded by itself: its copy in a run directory has the run's detector and its seed. Raises InputError if
        the scene or the detector is wrong."""
        return self._load(condition, seed, self._choice(condition, seed), detector_seed)

    def _load(self, condition: Condition, seed: int, choice: DetectorChoice, detector_seed: int | None = None) -> Scene:
        return load_scene(
            resolve(condition.scene, self.folder, shipped_scenes()),
            seed=seed,
            detector_seed=detector_seed,
            steps=self._steps,
            detector=choice.detector,
            settings={**condition.of_truth(), **choice.settings},
            state=choice.state,
            state_from=choice.state_from,
            may_be_unread=True,
        )


def _detector(choice: DetectorChoice, scene_file: Path) -> DetectorModel:
    """The detector alone; the check of the campaign has loaded the scene with it once."""
    named = choice.detector
    if named is None and choice.state_from is None:
        named = str(detector_file(scene_file))
    return choose_detector(
        named, settings=choice.settings, state=choice.state, state_from=choice.state_from, may_be_unread=True
    )[0]


def _uncertainty(file: Path) -> tuple[Path, LearnedUncertainty]:
    return file, read_uncertainty(file)


def detector_file(scene_file: Path) -> Path:
    """Detector file of a scene file; InputError if it names none."""
    data = (load_json if scene_file.suffix == ".json" else load_yaml)(scene_file, "scene")
    named = data.get("detector") if isinstance(data, dict) else None
    if not isinstance(named, str):
        raise InputError(f"scene {scene_file}", ["detector: is missing"])
    return find_detector(resolve(named, scene_file.resolve().parent, shipped_detectors()))
