"""Files of a campaign: relative to its file, found missing before the first run, and known by their checksums."""

import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml

from modsim3d.campaign.campaign import check_files
from modsim3d.campaign.folder import opened_campaign
from modsim3d.campaign.running import run_plan
from modsim3d.core.errors import InputError, ModsimError, OutputError
from modsim3d.io.input_files import data_folder
from tests.campaign.campaigns import checked_campaign, problems_of, run_campaign_file
from tests.campaign.one_process import ThisProcess

KEYS: dict[str, Any] = {
    "scene": "scenes/quay.yaml", "steps": 3, "seeds": {"traffic": 2}, "trackers": ["reference"],
    "vary": [{"grid": {"detector": ["mine.yaml", "experiment_1"]}}],
}  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a scene and two detectors, which is not the working directory."""
    (tmp_path / "work/scenes/detectors").mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    scenes = data_folder("scenes")
    shutil.copy(scenes / "harbour.yaml", tmp_path / "work/scenes/quay.yaml")
    shutil.copy(scenes / "detectors/thesis.yaml", tmp_path / "work/scenes/detectors")
    shutil.copy(scenes / "detectors/experiment_1.yaml", tmp_path / "work/mine.yaml")
    return tmp_path / "work"


def test_paths_are_relative_to_the_campaign_file(folder: Path) -> None:
    campaign = checked_campaign(folder, **KEYS)
    assert list(campaign.content["files"]) == ["mine.yaml", "scenes/quay.yaml"]
    assert [facts.states for facts in campaign.facts] == [("real_world",), ("real_world",)]
    own = checked_campaign(folder, **{**KEYS, "vary": []})
    assert list(own.content["files"]) == ["scenes/detectors/thesis.yaml", "scenes/quay.yaml"]


@pytest.mark.parametrize(("keys", "said"), [
    ({"scene": "scenes/pier.yaml"}, "scenes/pier.yaml"),
    ({"vary": [{"grid": {"detector": ["yours.yaml"]}}]}, "yours.yaml"),
    ({"vary": [{"grid": {"detector": [3]}}]}, "the name of a shipped one is text (got 3)"),
    ({"vary": [{"grid": {"state": ["fog"]}}]}, "fog"),
    ({"vary": [{"list": [{"state": "fog", "from": "nowhere"}]}]}, "nowhere"),
    ({"vary": [{"grid": {"detector.miss_rate": [0.1, 1.5]}}]}, "detector.miss_rate 1.5: a miss rate is a number"),
])  # fmt: skip
def test_what_is_missing_or_wrong_is_named_before_the_first_run(folder: Path, keys: dict[str, Any], said: str) -> None:
    assert said in "\n".join(problems_of(folder, **{**KEYS, **keys}))


@pytest.mark.parametrize("name", ["mine.yaml", "scenes/quay.yaml"])
def test_a_changed_file_is_named_when_a_campaign_goes_on_and_when_a_run_is_made_again(folder: Path, name: str) -> None:
    done = run_campaign_file(folder, **KEYS)
    assert set(done.table["status"].to_pylist()) == {"done"}
    check_files(opened_campaign(done.folder.path))
    content = yaml.safe_load((folder / name).read_text())
    changed = content["states"]["real_world"] if name == "mine.yaml" else content["vessels"]["ferry1"]
    changed |= {"false_discovery_rate": 0.2} if name == "mine.yaml" else {"length_m": 99.0}
    (folder / name).write_text(yaml.safe_dump(content, sort_keys=False))
    with pytest.raises(OutputError, match=f"holds a campaign with another plan: {name} changed"):
        run_campaign_file(folder, **KEYS)
    with pytest.raises(InputError, match=f"{name} has changed since the campaign was planned"):
        check_files(opened_campaign(done.folder.path))
    (folder / name).unlink()
    with pytest.raises(InputError, match=f"{name} cannot be read any more: No such file"):
        check_files(opened_campaign(done.folder.path))


def test_no_row_is_kept_of_a_file_that_changes_while_the_campaign_runs(folder: Path) -> None:
    """A comment is enough: what was read before and after it may differ."""
    campaign, before = checked_campaign(folder, **KEYS), (folder / "mine.yaml").read_bytes()
    (folder / "mine.yaml").write_bytes(before + b"# edited\n")
    with pytest.raises(ModsimError, match=r"mine\.yaml has changed since the campaign was planned: put it back"):
        run_plan(campaign, folder / "out", ThisProcess)
    assert not list((folder / "out").glob("done/*"))
    (folder / "mine.yaml").write_bytes(before)
    result = run_plan(checked_campaign(folder, **KEYS), folder / "out", ThisProcess)
    assert result is not None and set(result.table["status"].to_pylist()) == {"done"}
