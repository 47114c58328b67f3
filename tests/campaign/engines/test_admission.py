"""Workers that may not work on a campaign say why."""

import platform
from dataclasses import replace
from pathlib import Path

import pytest

from modsim3d.campaign import serving
from modsim3d.campaign.serving import check_worker
from modsim3d.core.errors import ModsimError
from tests.campaign.engines.campaigns import Campaigns


@pytest.mark.parametrize("package", ["fragile", "numpy"])
def test_a_worker_with_other_versions_is_refused(campaigns, out, monkeypatch, package):
    here, _ = campaigns.planned(out)
    check_worker(here.work)
    here_is, other = serving.version(package), {**serving.versions(), "numpy": "9.9"}
    if package == "numpy":
        monkeypatch.setattr(serving, "versions", lambda: other)
    else:
        monkeypatch.setattr(serving, "version", lambda name: "9.9")
    with pytest.raises(ModsimError, match=f"on {platform.node()} has .*{package} 9.9 instead of {here_is}"):
        check_worker(here.work)


def test_a_worker_that_finds_another_campaign_or_a_damaged_plan_is_refused(campaigns: Campaigns, out: Path) -> None:
    here, _ = campaigns.planned(out)
    with pytest.raises(ModsimError, match="finds another campaign at"):
        check_worker(replace(here.work, plan_sha256="0" * 64))
    (here.path / "plan.json").write_bytes(b"{}")
    with pytest.raises(ModsimError, match=r"plan\.json is damaged"):
        check_worker(here.work)
