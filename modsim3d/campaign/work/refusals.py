"""What a scene, a detector or a tracker refuses, in the words of the campaign file: with the key and its value."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

from modsim3d.campaign.plan.conditions import TRACKER, Condition, layer_of
from modsim3d.detector.file.unread import unread_settings
from modsim3d.detector.model import DetectorModel
from modsim3d.errors import InputError, ModsimError
from modsim3d.inputs.validation import shown

_OPTIONS = {"state": "--state", "from": "--from", "detector": "--detector"}
"""Keys of a condition that messages of scenes call by the option of a command."""


def condition_problems(condition: Condition, error: ModsimError, section: str = "vary") -> Iterator[str]:
    """The problems of a condition, each with the varied key that it is about, or with all of them.

    Args:
        condition: The condition with the values of all its keys.
        error: What its scene, its detector or a tracker said.
        section: Where its keys are in the file.
    """
    if not isinstance(error, InputError):
        yield f"{_in_words(condition)}: {error}"
        return
    for problem in error.problems:
        said = f"{error.source}: {problem}"
        key = next((key for key in _longest_first(condition.all_values) if _is_about(key, problem, said)), None)
        if key is None:
            yield f"{_in_words(condition)}: {said}"
        else:
            source = f" ({error.source})" if layer_of(key) == "tracks" else ""
            place = section if key in condition.values else "set"
            yield f"{place}: {key} {shown(condition.all_values[key])}: {_without(problem, _option_of(key))}{source}"


def key_readings(condition: Condition, detector: DetectorModel, searched: Collection[str]) -> Iterator[tuple[str, str]]:
    """Each key of a condition's detector, and why that does not read it; empty if it does."""
    values = condition.all_values
    paths = {key.removeprefix("detector."): key for key in values if key.startswith("detector.")}
    found = unread_settings(detector, paths, [key.removeprefix("detector.") for key in searched]) if paths else {}
    for path, key in paths.items():
        place = "set" if key in condition.fixed else "search.over" if key in searched else "vary"
        yield key, f"{place}: {key} {shown(values[key])}: {found[path]}" if path in found else ""


def tracker_problems(place: int, error: ModsimError) -> Iterator[str]:
    """The problems of a tracker, with its place in the file."""
    for problem in error.problems if isinstance(error, InputError) else (str(error),):
        yield f"trackers[{place}]: {problem.removeprefix('--set ')}"


def _is_about(key: str, problem: str, said: str) -> bool:
    """Whether a problem, or what is said with its source, is about a key."""
    if layer_of(key) == "tracks":
        return problem.startswith(f"{_option_of(key)}:")
    return _option_of(key) in said


def _longest_first(values: Mapping[str, Any]) -> list[str]:
    return sorted(values, key=len, reverse=True)


def _option_of(key: str) -> str:
    """What messages call a key."""
    if key in _OPTIONS:
        return _OPTIONS[key]
    return key.removeprefix(f"{TRACKER}.") if layer_of(key) == "tracks" else f"--set {key}"


def _without(problem: str, option: str) -> str:
    """A problem without the option at its beginning."""
    rest = problem.removeprefix(option)
    return rest.removeprefix(":").strip() if rest.startswith((":", " ")) else rest


def _in_words(condition: Condition) -> str:
    """A scene, with the values of its keys."""
    values = ", ".join(f"{key} {shown(value)}" for key, value in condition.values.items())
    return f"{condition.scene} with {values}" if values else condition.scene
