"""The scene of a run: loaded once for each truth, with the detector of the run in place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from modsim3d.campaign.detectors.drawing import drawn_detector
from modsim3d.campaign.detectors.learned_file import LearnedUncertainty, read_uncertainty
from modsim3d.campaign.plan.conditions import Condition
from modsim3d.campaign.work.digests import digest
from modsim3d.campaign.work.latest import Latest
from modsim3d.detector.file.finding import find_detector, shipped_detectors
from modsim3d.detector.model import DetectorModel
from modsim3d.errors import InputError, ModsimError
from modsim3d.inputs.strict_json import load_json
from modsim3d.inputs.strict_yaml import load_yaml
from modsim3d.inputs.validation import shown
from modsim3d.learn.uncertainty import uncertainty_file
from modsim3d.scene.detector_choice import choose_detector, state_settings
from modsim3d.scene.reading import find_scene, load_scene, shipped_scenes
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

    def file(self, scene_file: Path) -> Path:
        """The detector file, given that of the scene.

        Raises:
            InputError: There is none.
        """
        if self.detector is not None:
            return find_detector(self.detector)
        placed = state_settings(self.state, self.state_from, None)
        named = next((str(setting.value) for setting in placed if setting.key == "detector"), None)
        return Path(named) if named else detector_file(scene_file)


def located(name: Any, folder: Path, shipped: Any) -> str:
    """A shipped name as it is, and a path from the folder.

    Raises:
        InputError: It is no text.
    """
    if not isinstance(name, str):
        raise InputError("campaign", [f"a file or the name of a shipped one is text (got {shown(name)})"])
    path = folder / name
    return name if name in shipped and not path.is_file() else str(path)


class Scenes:
    """Scenes of runs; the latest are kept, since a traffic that is drawn costs a second."""

    def __init__(self, steps: int | None, folder: Path, *, learned: bool = False) -> None:
        """Open nothing yet.

        Args:
            steps: Number of steps in place of the scenes'; None: theirs.
            folder: What paths in conditions are relative to.
            learned: Whether detectors are drawn from what `modsim3d learn` says of them, one for each traffic seed.
        """
        self._steps, self._folder, self._learned = steps, folder, learned
        self._scenes: Latest[tuple[str, Scene]] = Latest(4)
        self._detectors: Latest[DetectorModel] = Latest(64)
        self._known: Latest[tuple[Path, LearnedUncertainty]] = Latest(64)

    def of(self, condition: Condition, seed: int, detector_seed: int) -> Scene:
        """The scene of a run.

        Args:
            condition: The scene and the values of its keys.
            seed: Seed of the scene.
            detector_seed: Seed of the detector.

        Raises:
            InputError: The scene or the detector is wrong.
        """
        choice = self._choice(condition, seed)
        wanted = digest(condition.scene, condition.of_detector(), choice.settings)
        loaded_with, scene = self._scenes.get(
            digest(condition.scene, condition.of_truth(), seed), lambda: (wanted, self._load(condition, seed, choice))
        )
        if loaded_with != wanted:
            detector = self._detectors.get(wanted, lambda: _detector(choice, scene.path))
            scene = replace(scene, detector=detector)
        return replace(scene, detector_seed=detector_seed)

    def files(self, condition: Condition, scene: Scene) -> set[Path]:
        """The files that a scene of this condition is made of."""
        detector = DetectorChoice.of(condition.of_detector(), self._folder).file(scene.path)
        unsure = [uncertainty_file(detector)] if self._learned else []
        return {path.resolve() for path in (*scene.copy.read, detector, *unsure)}

    def _choice(self, condition: Condition, seed: int) -> DetectorChoice:
        """The detector of a traffic seed; a key that the campaign sets is not drawn, nor what is within it."""
        choice = DetectorChoice.of(condition.of_detector(), self._folder)
        if not self._learned:
            return choice
        scene = find_scene(located(condition.scene, self._folder, shipped_scenes()))
        named = digest(str(scene), choice.detector, choice.state, choice.state_from)
        file, known = self._known.get(named, lambda: _known(choice.file(scene)))
        try:
            drawn = drawn_detector(known, seed)
        except ModsimError as error:
            raise InputError(f"detector {file}", [str(error)]) from None
        left = {
            key: value for key, value in drawn.items() if not any(_is_within(key, each) for each in choice.settings)
        }
        return replace(choice, settings={**left, **choice.settings})

    def alone(self, condition: Condition, seed: int, detector_seed: int) -> Scene:
        """The same scene, loaded by itself: its copy in a run directory has the run's detector and its seed.

        Raises:
            InputError: The scene or the detector is wrong.
        """
        return self._load(condition, seed, self._choice(condition, seed), detector_seed)

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


def _is_within(key: str, other: str) -> bool:
    """Whether a key leads into what another one holds."""
    return key.startswith(f"{other}.")


def _known(file: Path) -> tuple[Path, LearnedUncertainty]:
    return file, read_uncertainty(file)


def detector_file(scene_file: Path) -> Path:
    """The detector file of a scene file.

    Raises:
        InputError: It names none.
    """
    data = (load_json if scene_file.suffix == ".json" else load_yaml)(scene_file, "scene")
    named = data.get("detector") if isinstance(data, dict) else None
    if not isinstance(named, str):
        raise InputError(f"scene {scene_file}", ["detector: is missing"])
    return find_detector(located(named, scene_file.resolve().parent, shipped_detectors()))
