"""Parts of a campaign that know nothing of each other, and what is made of them."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from modsim3d.campaign.done_rows import DoneRows
from modsim3d.campaign.folder import planned
from modsim3d.core.errors import ModsimError, OutputError
from tests.campaign.campaigns import no_engine
from tests.campaign.engines.campaigns import Campaigns, content
from tests.campaign.one_process import ThisProcess


def test_shards_make_each_run_once_and_the_command_without_them_gathers(campaigns: Campaigns, out: Path) -> None:
    made = set[Path]()
    for part, engine in ((3, ThisProcess), (1, ThisProcess), (2, ThisProcess), (1, no_engine)):
        before = {path: path.read_bytes() for path in made}
        campaigns.run_part("plain", engine, out, part, 3)
        made = set((out / "done").iterdir())
        assert {path: path.read_bytes() for path in before} == before
    assert not (out / "results").exists()
    campaigns.check_end(out, no_engine)
    campaigns.run_part("plain", no_engine, out, 2, 3)  # a job that starts when all is over
    assert content(out) == campaigns.reference


def test_shards_are_even_where_all_runs_share_one_truth(campaigns: Campaigns, out: Path) -> None:
    for part in (1, 2, 3, 4):
        campaigns.run_part("still", ThisProcess, out, part, 4)
        assert len(DoneRows(planned(campaigns.checked("still"), out)).read().numbers()) == 2 * part


def test_what_depends_on_other_runs_is_refused(campaigns: Campaigns, out: Path) -> None:
    with pytest.raises(ModsimError, match="stop: sequential looks at the runs of all parts"):
        campaigns.run_part("sequential", no_engine, out, 1, 2)
    with pytest.raises(ModsimError, match=r"--shard 3/2: there are the parts 1/2 to 2/2"):
        campaigns.run_part("plain", no_engine, out, 3, 2)
    assert not (out).exists()


def test_shards_that_start_at_once_agree_on_the_plan(campaigns: Campaigns, out: Path) -> None:
    campaign = campaigns.checked()
    with ThreadPoolExecutor(16) as threads:
        found = list(threads.map(lambda _: planned(campaign, out), range(64)))
    assert len({each.work.plan_sha256 for each in found}) == 1
    assert sorted(path.name for path in (out).iterdir()) == ["campaign.yaml", "done", "plan.json"]
    with pytest.raises(OutputError, match="another plan"):
        planned(campaigns.checked("fatal"), out)
