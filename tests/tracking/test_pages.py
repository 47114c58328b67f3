"""The pages have each setting with its default, and each key of scores."""

import re
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import get_args

import pytest

from modsim3d.tracking.scores.breakdown import Bin
from modsim3d.tracking.scores.occlusions import OcclusionEpisode
from modsim3d.tracking.scores.scoring import Part, SubsetScores
from modsim3d.tracking.trackers.names import BUILT_IN
from modsim3d.tracking.world.scoring import MetVessel

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "trackers.md").read_text(encoding="utf-8")
LIBRARY = ("sort", "bytetrack", "ocsort")


def defaults(name: str) -> dict[str, str]:
    """Settings of a tracker with the defaults that the page tells; the library's own stand in brackets behind them."""
    (section,) = (part for part in PAGE.split("\n## ") if f"`{name}`" in part.split("\n")[0])
    found: dict[str, str] = {}
    for line in section.splitlines():
        if line.startswith("| `"):
            names, _, *columns = (re.sub(r"\(.*?\)|`", "", cell).strip() for cell in line.strip("|").split("|"))
            told = columns[LIBRARY.index(name) if name in LIBRARY else 0]
            found |= dict(zip(names.split(", "), told.split(", "), strict=True))
    return found


@pytest.mark.parametrize("name", BUILT_IN)
def test_the_page_of_trackers_has_each_setting_with_its_default(name: str) -> None:
    model = getattr(import_module(BUILT_IN[name].module), BUILT_IN[name].class_name)
    told = defaults(name)
    for setting, field in model.model_fields.items():
        kind = type(field.default)
        assert kind(told[setting]) == field.default, setting


def test_the_pages_have_each_key_of_scores() -> None:
    kinds = {"scores": get_args(Part), "json": (SubsetScores, Bin, OcclusionEpisode), "world_tracks": (MetVessel,)}
    for page, parts in kinds.items():
        text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
        assert [each.name for part in parts for each in fields(part) if f"`{each.name}`" not in text] == [], page
