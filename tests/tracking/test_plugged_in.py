"""A tracker from an installed package, run by the command; pages of the documents have each setting with its default,
and each key of scores."""

import json
import re
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import get_args

import pyarrow.parquet as pq
import pytest

from modsim3d import InputError, StoredRun, track_run
from modsim3d.tracking.scores.breakdown import Bin
from modsim3d.tracking.scores.occlusions import OcclusionEpisode
from modsim3d.tracking.scores.scoring import Part, SubsetScores
from modsim3d.tracking.trackers.names import BUILT_IN
from modsim3d.tracking.world.collision import MetVessel
from tests.cli.bad_input.builders import Call
from tests.plugin_site import Site, site

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "tests" / "tracker_example"
SECTION = (ROOT / "docs" / "plugins.md").read_text(encoding="utf-8").split("\n## A tracker\n")[1].split("\n## ")[0]
__all__ = ["site"]  # a fixture


def test_the_page_quotes_the_package_that_is_tested_whose_tracker_has_ten_lines() -> None:
    for language, name in (("toml", "pyproject.toml"), ("python", "modsim3d_overlap.py")):
        blocks = re.findall(rf"```{language}\n(.*?)```", SECTION, flags=re.DOTALL)
        assert blocks == [(EXAMPLE / name).read_text(encoding="utf-8")]
    _, tracker = blocks[0].split("\n\n\n")
    assert len([line for line in tracker.splitlines() if line]) == 10


def test_an_installed_tracker_runs_by_name_with_its_settings(
    run: StoredRun, site: Site, tmp_path: Path, call: Call
) -> None:
    project = site.add_project(EXAMPLE)
    status, text = call("track", run.folder, "--tracker", "overlap", "--json", "--out", tmp_path / "a")
    assert status == 0, text
    said = json.loads(text.splitlines()[0])
    assert said["package"] == f"{project['name']} {project['version']}"
    assert (said["name"], said["settings"], said["chosen"]) == ("overlap", {"least_iou": 0.3}, "the tracker's defaults")
    detections, tracks = run.folder / "detections.parquet", pq.read_table(tmp_path / "a" / "tracks.parquet")
    rows = pq.read_metadata(detections).num_rows
    assert len(tracks) == rows == said["counts"]["boxes"] == said["counts"]["detections"]
    assert 0 < said["counts"]["tracks"] < len(tracks)
    strict = track_run(run, tmp_path / "b", tracker="overlap", settings={"least_iou": 1.1})
    assert strict.counts.tracks == len(tracks), "no two boxes are the same"
    with pytest.raises(InputError, match=r"least: unknown key \(did you mean 'least_iou'\?\)"):
        track_run(run, tmp_path / "c", tracker="overlap", settings={"least": 1})
    assert not (tmp_path / "c").exists()


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
        value = told[setting] == "true" if kind is bool else kind(told[setting])
        assert value == field.default, setting


def test_the_pages_have_each_key_of_scores() -> None:
    kinds = {"scores": get_args(Part), "json": (SubsetScores, Bin, OcclusionEpisode), "world_tracks": (MetVessel,)}
    for page, parts in kinds.items():
        text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
        assert [each.name for part in parts for each in fields(part) if f"`{each.name}`" not in text] == [], page
