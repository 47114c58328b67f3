"""A detector by its file or condition, with settings: what stands for the detector of a scene, also without a scene."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from modsim3d.detector.file.finding import find_detector
from modsim3d.detector.model import DetectorModel
from modsim3d.errors import InputError
from modsim3d.inputs.conditions import find_condition
from modsim3d.paths import StrPath, as_path
from modsim3d.scene.settings import Setting, Settings, settings_of

NO_DETECTOR = ""


def state_settings(state: str | None, state_from: StrPath | None, detector: StrPath | None) -> list[Setting]:
    """What puts the detector into one state for the whole scene.

    Raises:
        InputError: `state_from` comes without a state or beside a detector, or has no detector of this name.
    """
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
    """A detector without a scene, and its file; see `load_scene` for what the arguments mean.

    Raises:
        InputError: No detector is named, its file is wrong, or a setting is not one of the detector.
    """
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
        known = whole.named(f"{source}: {problem}" for problem in error.problems)
        raise InputError(
            source, [problem.removeprefix(f"{source}: ") for problem in (*whole.problems, *known)]
        ) from None
    if whole.problems:
        raise InputError(source, whole.problems)
    return model, file
