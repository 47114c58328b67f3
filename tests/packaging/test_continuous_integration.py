"""The workflow file of docs/continuous_integration.md runs the campaign of its page."""

from pathlib import Path

import pytest
import yaml

import modsim3d
from tests.packaging.test_documents import ROOT, blocks

PAGE = ROOT / "docs" / "continuous_integration.md"


def test_the_workflow_of_the_page_runs_a_campaign_and_keeps_its_page(call, tmp_path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    campaign, workflow = (text for _, text, file in blocks(PAGE) if file)
    Path("trial.yaml").write_text(campaign, encoding="utf-8")
    (job,) = yaml.safe_load(workflow)["jobs"].values()
    lines = [line.split() for step in job["steps"] for line in step.get("run", "").splitlines()]
    for words in lines:
        if words[0] == "modsim3d":
            status, said = call(*words[1:])
            assert status == 0, said
    assert [words[1:3] for words in lines if words[0] == "modsim3d"] == [["campaign", "run"], ["campaign", "report"]]
    assert f"modsim3d-{modsim3d.__version__}-" in next(words[-1] for words in lines if words[0] == "pip")
    assert all(Path(path).stat().st_size for path in job["steps"][-1]["with"]["path"].split())
    always = [step["if"] for step in job["steps"][-2:]]
    assert always == ["success() || failure()"] * 2  # also where a requirement failed
