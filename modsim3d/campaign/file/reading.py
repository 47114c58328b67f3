"""Reads a campaign file, and checks all that can be checked before the first run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from modsim3d.campaign.file.keys import CampaignKeys
from modsim3d.errors import InputError
from modsim3d.inputs.shipped import data_folder
from modsim3d.inputs.strict_yaml import load_yaml
from modsim3d.inputs.validation import describe, kind_of, nearest
from modsim3d.paths import StrPath, as_path


@dataclass(frozen=True)
class CampaignFile:
    """A campaign file that was read.

    Attributes:
        path: The file.
        keys: What is in it.
    """

    path: Path
    keys: CampaignKeys

    @property
    def base(self) -> Path:
        """The folder that its paths are relative to."""
        return self.path.resolve().parent


def shipped_campaigns() -> dict[str, Path]:
    """Campaigns that come with the package, by name."""
    return {path.stem: path for path in sorted((data_folder("scenes") / "campaigns").glob("*.yaml"))}


def find_campaign(campaign: StrPath) -> Path:
    """The file that a path or the name of a shipped campaign stands for.

    Raises:
        InputError: There is no such file and no such name.
        TypeError: It is neither text nor a path.
    """
    path, shipped = as_path(campaign, "campaign", "a path or the name of a shipped campaign"), shipped_campaigns()
    if path.is_file() or str(campaign) not in shipped:
        if not path.is_file():
            hint = nearest(str(campaign), shipped)
            raise InputError(f"campaign {path}", [f"no such file, and no shipped campaign has this name ({hint})"])
        return path
    return shipped[str(campaign)]


def read_campaign(campaign: StrPath) -> CampaignFile:
    """Read a campaign file.

    Raises:
        InputError: With every problem of its keys.
        TypeError: It is neither text nor a path.
    """
    path = find_campaign(campaign)
    data = load_yaml(path, "campaign")
    if not isinstance(data, dict):
        needed = f"a mapping of keys is needed (got {kind_of(data)})"
        raise InputError(f"campaign {path}", ["the file is empty" if data is None else needed])
    try:
        keys = CampaignKeys.model_validate(data)
    except ValidationError as error:
        raise InputError(f"campaign {path}", _in_words(error)) from None
    return CampaignFile(path, keys)


def _in_words(error: ValidationError) -> list[str]:
    """The problems, without the colon that stands before one of the whole file."""
    return [problem.removeprefix(": ") for problem in describe(error, CampaignKeys)]
