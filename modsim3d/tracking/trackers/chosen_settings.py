"""Settings of the built-in trackers that were chosen for the shipped scenes: `scenes/trackers/NAME.yaml`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any

from pydantic import Field, ValidationError

from modsim3d.errors import InputError
from modsim3d.inputs.shipped import data_folder
from modsim3d.inputs.strict_yaml import load_yaml
from modsim3d.inputs.validation import Strict, describe
from modsim3d.tracking.trackers.interface import Tracker
from modsim3d.tracking.trackers.names import BUILT_IN

DEFAULTS = "the tracker's defaults"


class SettingsFile(Strict):
    """The content of a file.

    Attributes:
        chosen: How the settings were chosen, and on which seeds, in a sentence.
        settings: Settings for every scene, in place of the tracker's defaults.
        scenes: Settings for the scenes of these names, in place of those.
    """

    chosen: Annotated[str, Field(min_length=1)]
    settings: dict[str, Any] = Field(default_factory=dict)
    scenes: dict[str, dict[str, Any]] = Field(default_factory=dict)


@dataclass(frozen=True)
class ChosenSettings:
    """Settings for a scene, and where they come from in a sentence."""

    settings: dict[str, Any] = field(default_factory=dict)
    chosen: str = DEFAULTS


def chosen_settings(name: str, model: type[Tracker], scene: str) -> ChosenSettings:
    """The settings of a tracker that were chosen for a scene; none where there is no file.

    Args:
        name: Name of the tracker.
        model: Its class, which says what is right.
        scene: Name of the scene.

    Raises:
        InputError: The file cannot be read, or what it sets is wrong.
    """
    path = data_folder("scenes") / "trackers" / f"{name}.yaml"
    if name not in BUILT_IN or not path.is_file():
        return ChosenSettings()
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
        return ChosenSettings()
    return ChosenSettings({**file.settings, **file.scenes.get(scene, {})}, file.chosen)
