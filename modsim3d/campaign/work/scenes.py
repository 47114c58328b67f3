"""The scene of a run: loaded once for each truth, with the detector of the run in place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from modsim3d.campaign.plan.conditions import Condition
from modsim3d.campaign.work.digests import digest
from modsim3d.campaign.work.latest import Latest
from modsim3d.detector.file.finding import shipped_detectors
from modsim3d.detector.model import DetectorModel
from modsim3d.inputs.strict_json import load_json
from modsim3d.inputs.strict_yaml import load_yaml
from modsim3d.scene.detector_choice import choose_detector
from modsim3d.scene.reading import load_scene, shipped_scenes
from modsim3d.scene.scene import Scene


@dataclass(frozen=True)
class DetectorChoice:
    """What decides a detector.

    Attributes:
        detector: A file, or the name of a shipped detector; None: the scene's.
        state: The state that it is in for the whole scene; None: it changes as the detector says.
        state_from: Where the state is from, as `--from`.
        settings: Keys below `detector`.
    """

    detector: str | None
    state: str | None
    state_from: str | None
    settings: Mapping[str, Any]

    @classmethod
    def of(cls, values: Mapping[str, Any], folder: Path) -> DetectorChoice:
        """From the values of a condition; paths in them are relative to the folder."""
        named, place = values.get("detector"), values.get("from")
        return cls(
            None if named is None else located(named, folder, shipped_detectors()),
            values.get("state"),
            None if place is None else located(place, folder, ("conditions",)),
            {key: value for key, value in values.items() if key.startswith("detector.")},
        )


def located(name: str, folder: Path, shipped: Any) -> str:
    """A shipped name as it is, and a path from the folder."""
    path = folder / name
    return name if name in shipped and not path.is_file() else str(path)


class Scenes:
    """Scenes of runs; the latest are kept, since a traffic that is drawn costs a second."""

    def __init__(self, steps: int | None, folder: Path) -> None:
        """Take the number of steps in place of the scenes', and the folder that paths in conditions are relative to."""
        self._steps, self._folder = steps, folder
        self._scenes: Latest[tuple[str, Scene]] = Latest(4)
        self._detectors: Latest[DetectorModel] = Latest(64)

    def of(self, condition: Condition, seed: int, detector_seed: int) -> Scene:
        """The scene of a run.

        Args:
            condition: The scene and the values of its keys.
            seed: Seed of the scene.
            detector_seed: Seed of the detector.

        Raises:
            InputError: The scene or the detector is wrong.
        """
        choice = DetectorChoice.of(condition.of_detector(), self._folder)
        wanted = digest(condition.scene, condition.of_detector())
        loaded_with, scene = self._scenes.get(
            digest(condition.scene, condition.of_truth(), seed), lambda: (wanted, self._load(condition, seed, choice))
        )
        if loaded_with != wanted:
            detector = self._detectors.get(wanted, lambda: _detector(choice, scene.path))
            scene = replace(scene, detector=detector)
        return replace(scene, detector_seed=detector_seed)

    def alone(self, condition: Condition, seed: int, detector_seed: int) -> Scene:
        """The same scene, loaded by itself: its copy in a run directory has the run's detector and its seed.

        Raises:
            InputError: The scene or the detector is wrong.
        """
        return self._load(condition, seed, DetectorChoice.of(condition.of_detector(), self._folder), detector_seed)

    def _load(self, condition: Condition, seed: int, choice: DetectorChoice, detector_seed: int | None = None) -> Scene:
        return load_scene(
            located(condition.scene, self._folder, shipped_scenes()),
            seed=seed,
            detector_seed=detector_seed,
            steps=self._steps,
            detector=choice.detector,
            settings={**condition.of_truth(), **choice.settings},
            state=choice.state,
            state_from=choice.state_from,
        )


def _detector(choice: DetectorChoice, scene_file: Path) -> DetectorModel:
    """The detector alone; the check of the campaign has loaded the scene with it once."""
    named = choice.detector
    if named is None and choice.state_from is None:
        named = str(detector_file(scene_file))
    return choose_detector(named, settings=choice.settings, state=choice.state, state_from=choice.state_from)[0]


@lru_cache(maxsize=64)
def detector_file(scene_file: Path) -> Path:
    """The detector file of a scene file, or the name of a shipped one."""
    data = (load_json if scene_file.suffix == ".json" else load_yaml)(scene_file, "scene")
    return Path(located(data["detector"], scene_file.resolve().parent, shipped_detectors()))
