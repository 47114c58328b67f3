"""Conditions whose detections are the same in all runs are told: in print, in JSON and on the page."""

import json
from pathlib import Path

import pytest

from modsim3d.campaign.folder import opened_campaign
from modsim3d.campaign.means import same_detections
from modsim3d.campaign.report.search_page import write_page
from tests.campaign.campaigns import campaign_file, run_campaign_file
from tests.cli.conftest import Modsim3d

KEYS = {"scene": "harbour", "steps": 3, "seeds": {"traffic": 2}, "trackers": ["reference"]}
SAID = "the detections are the same in all runs"


@pytest.mark.usefixtures("in_this_process")
def test_conditions_with_the_same_detections_are_told_everywhere(tmp_path: Path, modsim3d: Modsim3d) -> None:
    low = {"grid": {"detector.operating_threshold": [0.2, 0.21]}}  # nothing is as low
    file = campaign_file(tmp_path, **KEYS, vary=[low])
    said = modsim3d("campaign", "run", file, "--out", tmp_path / "out")
    assert said.status == 0 and SAID in " ".join(said.err.split())
    again = modsim3d("campaign", "run", file, "--out", tmp_path / "out", "--json")
    (warning,) = [text for text in json.loads(again.out)["warnings"] if SAID in text]
    assert "runs with detector.operating_threshold 0.2, detector.operating_threshold 0.21: what differs" in warning
    page = tmp_path / "page.html"
    write_page(opened_campaign(tmp_path / "out"), page)
    assert SAID.capitalize() in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("key", ["detector.operating_threshold", "tracker.lost_s", "state"])
def test_conditions_that_differ_and_settings_of_trackers_are_not_told(tmp_path: Path, key: str) -> None:
    values = {"detector.operating_threshold": [0.2, 0.65], "tracker.lost_s": [1, 2], "state": ["excellent", "bad"]}
    found = run_campaign_file(tmp_path, **KEYS, vary=[{"grid": {key: values[key]}}])
    assert same_detections(found.folder.plan, found.table) == []
