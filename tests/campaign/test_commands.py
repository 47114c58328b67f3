"""The commands campaign run, status and table, and campaigns from Python."""

import io
import json
import shutil
from dataclasses import replace
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from rich.console import Console
from scipy import stats

import modsim3d as package
from modsim3d import ModsimError, OutputError, Verdict
from modsim3d.campaign.folder import opened_campaign
from modsim3d.campaign.means import same_detections
from modsim3d.campaign.report.campaign_page import crash_sections
from modsim3d.campaign.report.search_page import report_campaign
from modsim3d.campaign.running import run_plan
from modsim3d.cli.campaign_run import exit_status
from modsim3d.cli.terminal_tables import print_blocks
from modsim3d.core.text import three_digits_with_interval
from modsim3d.io.overwrite_guard import locked_folder
from tests.campaign.campaigns import campaign_file, checked_campaign, interrupt, no_engine, run_campaign_file
from tests.campaign.one_process import ThisProcess
from tests.cli.conftest import Modsim3d
from tests.cli.test_json import documented

SMALL: dict[str, Any] = {"scene": "harbour", "steps": 20, "seeds": {"traffic": 3}}
KEYS = {
    **SMALL, "vary": [{"grid": {"state": ["excellent", "bad"]}}], "trackers": ["sort", "reference"],
    "require": [{"score": "hota", "at_least": 0.01}],
}  # fmt: skip
RUNS = 12


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished campaign, with its file beside it; tests leave it as it is."""
    return run_campaign_file(tmp_path_factory.mktemp("finished"), "tiny.yaml", **KEYS).folder.path


@pytest.fixture(scope="module")
def file(finished: Path) -> Path:
    return finished.with_suffix(".yaml")


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A campaign that was interrupted after its first task; tests leave it as it is."""
    folder = tmp_path_factory.mktemp("begun")
    with pytest.raises(KeyboardInterrupt):
        run_plan(checked_campaign(folder, **KEYS), folder / "tiny", ThisProcess, progress=interrupt)
    return folder / "tiny"


def test_a_campaign_is_introduced_run_and_judged(modsim3d: Modsim3d, file: Path, finished: Path) -> None:
    said = modsim3d("campaign", "run", file, "--out", finished)
    assert said.status == 0, said.err
    lines = [" ".join(line.split()) for line in said.out.splitlines()]
    assert f"runs {RUNS} = 2 conditions × 3 traffic seeds × 2 trackers" in lines
    assert "scenes harbour (this traffic only), 20 steps" in lines
    assert "required mean HOTA at least 0.01 (95 % confidence)" in lines and f"{RUNS} runs, 4 met" in lines
    assert "the results hold for this traffic only" in said.err


def test_an_interrupted_campaign_says_how_to_go_on(modsim3d, file, tmp_path, monkeypatch):
    monkeypatch.setattr("modsim3d.campaign.running.run_plan", interrupt)
    said = modsim3d("campaign", "run", file, "--out", tmp_path)
    assert said.status == 130 and f"runs that are done are kept in {tmp_path}: the same command goes on" in said.err


@pytest.mark.parametrize(
    ("library", "cluster"), [("trackeval", None), ("distributed", "tcp://127.0.0.1:9"), ("dask_jobqueue", "slurm:2")]
)
def test_a_missing_library_is_told_before_the_scenes_are_read(modsim3d, file, tmp_path, monkeypatch, library, cluster):
    def version(name: str) -> str:
        if name == library:
            raise PackageNotFoundError(name)
        return "1.0"

    monkeypatch.setattr("modsim3d.campaign.work.scenes.installed_version", version)
    monkeypatch.setattr("modsim3d.campaign.dask.find_spec", lambda name: None if name == library else name)
    monkeypatch.setattr("modsim3d.campaign.work.scenes.load_scene", no_engine)
    options = () if cluster is None else ("--cluster", cluster)
    said = modsim3d("campaign", "run", file, "--out", tmp_path / "out", *options)
    assert said.status == 2 and said.err.count("\n") == 1
    assert f'pip install "modsim3d[{"trackers" if cluster is None else "cluster"}]"' in said.err
    assert not (tmp_path / "out").exists()


def test_a_part_is_made_and_the_whole_gathered(modsim3d, file, tmp_path, finished, in_this_process):
    out = tmp_path / "out"
    said = modsim3d("campaign", "run", file, "--out", out, "--workers", 1, "--shard", "1/2", "--json")
    assert (said.status, json.loads(said.out)["finished"]) == (0, False)
    assert package.run_campaign(file, out, workers=1).table.equals(package.open_campaign(finished).table)


def test_commands_that_are_printed_can_be_pasted(modsim3d, file, finished, begun, tmp_path):
    out = shutil.copytree(finished, tmp_path / "with space")
    said = modsim3d("campaign", "run", file, "--out", out)
    assert f"modsim3d campaign report '{out}'" in said.out and f"modsim3d campaign table '{out}'" in said.out
    said = modsim3d("campaign", "run", file, "--out", out, "--shard", "1/2")
    assert f"modsim3d campaign run {file} --out '{out}'" in said.out
    crashed = pa.table({"run": [7], "tracker": ["sort"], "status": ["crashed"], "error": ["ValueError: no"]})
    console = Console(width=400, record=True, file=io.StringIO())
    print_blocks(console, crash_sections(opened_campaign(out), crashed))
    assert f"modsim3d campaign reproduce '{out}' 7 --out '{out}/runs/7'" in console.export_text()


def test_exit_status() -> None:
    one = Verdict(0, "hota at least 0.6", "sort", 0, "met", "", 0.95, None, None, None, 1)
    for outcomes, status in (("", 0), ("met", 0), ("met undecided", 3), ("undecided failed", 1), ("met failed", 1)):
        assert exit_status(tuple(replace(one, outcome=outcome) for outcome in outcomes.split())) == status, outcomes


def test_json_has_the_documented_keys(modsim3d: Modsim3d, file: Path, finished: Path) -> None:
    for command, *line in (("run", file, "--out", finished), ("status", finished), ("table", finished)):
        found = json.loads(modsim3d("campaign", command, *line, "--json").out)
        assert set(found) == documented(f"campaign {command}") and found["finished"] is True, command


def test_status_says_who_works_on_a_campaign_and_of_parts_that_are_all_done_what_is_left(modsim3d, begun, tmp_path):
    with locked_folder(begun):
        said = modsim3d("campaign", "status", begun)
    assert said.status == 0 and "worked on by " in said.out
    said = modsim3d("campaign", "status", begun)
    assert said.status == 0 and f"of {RUNS} runs are done, 0 of them crashed" in said.out
    assert "nobody holds its folder" in said.out and "requirements so far" in said.out
    assert not any(f" {outcome}" in said.out for outcome in ("met,", "failed,"))
    found = json.loads(modsim3d("campaign", "status", begun, "--json").out)
    assert 0 < found["done"] < RUNS and not found["finished"] and found["left_s"] is found["worked_on_by"] is None
    campaign = checked_campaign(tmp_path, scene="harbour", steps=20, trackers=["reference"])
    run_plan(campaign, tmp_path / "out", ThisProcess, shard=(1, 1))
    said = modsim3d("campaign", "status", tmp_path / "out")
    assert "1 of 1 runs are done" in said.out and "the same command, without --shard, writes results" in said.out


def test_means_are_those_of_a_plain_loop_over_traffic_seeds_of_which_runs_count_once(finished: Path) -> None:
    campaign = package.open_campaign(finished)
    rows = campaign.table.to_pylist()
    for row in campaign.means(["state"], ["hota"]):
        values = [each["hota"] for each in rows if all(each[key] == value for key, value in row.values.items())]
        mean, found = float(np.mean(values)), row.means["hota"]
        low, high = stats.t.interval(0.95, len(values) - 1, mean, stats.sem(values))
        assert (found.value, found.low, found.high) == pytest.approx((mean, low, high))
        assert (found.seeds, row.runs, row.crashed) == (3, 3, 0)
    assert [(row.runs, row.means["hota"].seeds) for row in campaign.means([], ["hota"])] == [(6, 3), (6, 3)]


def test_tables_are_written_as_csv_and_parquet(modsim3d: Modsim3d, finished: Path, tmp_path: Path) -> None:
    means, runs = tmp_path / "means.csv", tmp_path / "runs.parquet"
    line = ("campaign", "table", finished, "--by", "state", "--score", "hota")
    assert modsim3d(*line, "--out", means).status == 0
    columns = ["state", "tracker", "runs", "crashed", "hota", "hota_low", "hota_high", "hota_seeds"]
    table = pyarrow.csv.read_csv(means)
    assert table.column_names == columns and len(table) == 4
    assert modsim3d("campaign", "table", finished, "--by", "run", "--out", runs).status == 0
    assert pq.read_table(runs).equals(package.open_campaign(finished).table)
    assert modsim3d(*line, "--out", means).status == 2


@pytest.mark.parametrize(("line", "part"), [
    *((f"run FILE --shard {wrong}", "--shard: needs K/N") for wrong in ("0/3", "4/3", "3", "1/0", "a/b", "1/200000")),
    *((f"{command} OUT", "is no folder of a campaign") for command in ("status", "table")),
    ("table FINISHED --by stat", "--by stat: is not varied in this campaign (did you mean 'state'?)"),
    ("table FINISHED --score hotta", "--score hotta: there is no such score in this campaign (did you mean 'hota'?)"),
    ("table FINISHED --score tracker", "--score tracker: there is no such score"),
    ("table FINISHED --by run", "--by run writes a file: name it with --out"),
    ("table FINISHED --out means.txt", "the name must end in .csv or .parquet"),
])  # fmt: skip
def test_wrong_options_are_one_line_and_leave_nothing(modsim3d, file, finished, tmp_path, line, part):
    for name, path in {"FILE": file, "OUT": tmp_path / "out", "FINISHED": finished}.items():
        line = line.replace(name, str(path))
    said = modsim3d("campaign", *line.split())
    assert (said.status, said.out, said.err.count("\n")) == (2, "", 1) and part in said.err
    assert not (tmp_path / "out").exists()


def test_a_campaign_shows_itself(finished: Path, begun: Path) -> None:
    campaign = package.open_campaign(finished)
    assert repr(campaign) == f"<Campaign {finished}: {RUNS} runs, 4 met>"
    html = campaign._repr_html_()
    assert html.startswith("<table>") and html.count("<tr>") == 5 and "excellent" in html
    assert "not finished" in repr(package.open_campaign(begun))


def test_another_plan_and_layers_among_the_rows_are_refused_as_python_does(modsim3d, file, finished, tmp_path):
    other = campaign_file(tmp_path, "other.yaml", **{**KEYS, "seeds": {"traffic": 4}})
    said = modsim3d("campaign", "run", other, "--out", finished)
    assert said.status == 2 and "another plan: seeds.traffic is 3 there and 4 now" in said.err
    other = campaign_file(tmp_path, "other.yaml", **{**KEYS, "steps": 21})
    with pytest.raises(OutputError, match="steps is 20 there and 21 now"):
        package.run_campaign(other, finished)
    for cache in ("results", "done/cache"):
        said = modsim3d("campaign", "run", file, "--out", tmp_path / "out", "--cache", tmp_path / "out" / cache)
        assert said.status == 2 and "is for the rows of the campaign: choose another folder" in said.err
    with pytest.raises(ModsimError, match="workers"):
        package.run_campaign(file, tmp_path / "out", workers=0)
    with pytest.raises(TypeError, match="folder of the campaign"):
        package.run_campaign(file, 3)  # type: ignore[arg-type]
    assert not (tmp_path / "out").exists()


SAME = "the detections are the same in all runs"


@pytest.mark.usefixtures("in_this_process")
def test_conditions_with_the_same_detections_are_told_in_print_in_json_and_on_the_page(modsim3d, tmp_path):
    low = {"grid": {"detector.operating_threshold": [0.2, 0.21]}}  # nothing is as low
    file = campaign_file(tmp_path, scene="harbour", steps=3, trackers=["reference"], vary=[low])
    said = modsim3d("campaign", "run", file, "--out", tmp_path / "out")
    assert said.status == 0 and SAME in " ".join(said.err.split())
    again = modsim3d("campaign", "run", file, "--out", tmp_path / "out", "--json")
    (warning,) = [text for text in json.loads(again.out)["warnings"] if SAME in text]
    assert "runs with detector.operating_threshold 0.2, detector.operating_threshold 0.21: what differs" in warning
    report_campaign(tmp_path / "out", tmp_path / "page.html")
    assert SAME.capitalize() in (tmp_path / "page.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(("key", "values"), [
    ("detector.operating_threshold", [0.2, 0.65]), ("tracker.lost_s", [1, 2]), ("state", ["excellent", "bad"])
])  # fmt: skip
def test_conditions_that_differ_and_settings_of_trackers_are_not_told(tmp_path, key, values):
    keys = {"steps": 3, "trackers": ["reference"], "vary": [{"grid": {key: values}}]}
    found = run_campaign_file(tmp_path, **{**SMALL, **keys})
    assert same_detections(found.folder.plan, found.table) == []


def test_a_tracker_that_reports_nothing_meets_no_score_and_terminal_and_page_say_so(modsim3d, tmp_path, monkeypatch):
    late = {"tracker": "sort", "name": "late", "set": {"minimum_consecutive_frames": 19}}
    limits = {"hota": {"at_least": 0.01}, "assa": {"at_least": 0.01, "resting_on": 0.01}}
    limits |= {"rmse_px": {"at_most": 500}, "false_positives": {"at_most": 1000}}
    require = [{"score": score, **limit} for score, limit in limits.items()]
    folder = run_campaign_file(tmp_path, "needy.yaml", **SMALL, trackers=["sort", late], require=require).folder.path
    verdicts = json.loads((folder / "verdicts.json").read_text())["verdicts"]
    found = {(each["text"].split()[0], each["tracker"]): each for each in verdicts}
    outcomes = {key: each["outcome"] for key, each in found.items()}
    assert [outcomes[score, "sort"] for score in ("hota", "assa", "rmse_px")] == ["met", "undecided", "undecided"]
    assert [outcomes[score, "late"] for score in ("assa", "rmse_px")] == ["failed", "failed"]
    assert (found["assa", "late"]["nothing"], found["assa", "late"]["seeds"]) == (3, 3)
    assert all(each["this_traffic_only"] for each in verdicts)
    assert found["false_positives", "sort"]["met_without_tracks"] and not found["hota", "sort"]["met_without_tracks"]
    said = modsim3d("campaign", "run", tmp_path / "needy.yaml", "--out", folder)
    text = " ".join(said.out.split())
    assert said.status == 1 and "sort, ? undecided: Over 3 traffic seeds" in text
    assert "No tracks at all would meet it too" in text
    failed = text.partition("2. AssA at least 0.01 resting on 1 %: ✗ failed")[2]
    assert "late, ✗ failed: Over 3 traffic seeds no run has AssA. In 3 runs the tracker" in failed
    assert "interval, each end 95 %" in text and "those of the requirements" in text
    _, _, means = said.out.partition("Means")
    (line,) = [line for line in means.splitlines() if line.startswith("sort")]
    of_hota = found["hota", "sort"]
    assert three_digits_with_interval(*(of_hota[key] for key in ("estimate", "low", "high"))) in " ".join(line.split())
    never = "can never be met by this plan: rmse_px is a mean over what the tracker manages"
    assert never in " ".join(said.err.split())
    assert said.out.count(f"{verdicts[0]['estimate']:.3f}") >= 2  # with the verdict, and among the means
    monkeypatch.setattr("modsim3d.campaign.report.campaign_page.WORST", 1)  # drawing them is most of the time
    assert modsim3d("campaign", "report", folder, "--out", tmp_path / "page.html").status == 0
    text = (tmp_path / "page.html").read_text(encoding="utf-8").replace("\xa0", " ")
    assert "mean [interval, each end 95 %]" in text and "those of the requirements" in text
    assert "runs with nothing to score" in text and "No tracks at all would meet it too" in text
