"""The worst runs of a campaign: which they are, and each of them again."""

import json
import shlex
import shutil
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from modsim3d import ModsimError, load_scene, run_scene
from modsim3d.campaign import reproduce
from modsim3d.campaign.folder import CampaignFolder
from modsim3d.campaign.keys import CampaignKeys
from modsim3d.campaign.plan import Plan
from modsim3d.campaign.ranking import WorstRun, score_of_run, worst_runs
from modsim3d.campaign.report.campaign_page import moment_block
from modsim3d.campaign.reproduce import remade
from modsim3d.campaign.running import CampaignResult
from modsim3d.campaign.verdicts.verdict import Outcome, Verdict
from modsim3d.campaign.work import layers
from modsim3d.campaign.work.row import row_of, rules_of
from modsim3d.io.atomic_write import encoded
from modsim3d.runs.files.run_directory import RunDirectory
from modsim3d.tracking import worst_film
from modsim3d.tracking.scores.scored_run import ScoredRun
from modsim3d.tracking.worst_film import WIDTH_PX, Story, moment_pictures
from modsim3d.tracking.worst_moment import NOBODY, row_to_show
from modsim3d.view.pictures.canvas import Label
from tests.campaign.campaigns import interrupt, run_campaign_file
from tests.cli.conftest import Modsim3d
from tests.run_folders import run_files
from tests.tracking.hand_made import box, hand_made

CAMPAIGN: dict[str, Any] = {
    "scene": "harbour", "steps": 20, "seeds": {"traffic": 2, "detector": 2},
    "vary": [{"grid": {"state": ["good", "terrible"], "detector.operating_threshold": [0.2]}}],
    "trackers": ["sort", {"tracker": "sort", "name": "hasty", "set": {"minimum_consecutive_frames": 1}}],
    "score": {"similarity": "centre", "scale_px": 200},
    "require": [{"score": "hota", "at_least": 0.9}, {"score": "false_track_s", "at_most": 0}],
}  # fmt: skip
CRASHES = 5  # the number of the run that crashes


def crash(*_: object) -> None:
    raise ValueError("the filter has lost its mind")


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> CampaignResult:
    with pytest.MonkeyPatch.context() as patch:
        made, calls = layers.run_tracker, count()

        def run_tracker(*arguments: Any) -> object:
            return crash() if next(calls) == CRASHES else made(*arguments)

        patch.setattr(layers, "run_tracker", run_tracker)
        result = run_campaign_file(tmp_path_factory.mktemp("worst"), **CAMPAIGN)
    assert result.table["status"].to_pylist().count("crashed") == 1
    return result


@pytest.fixture
def again(campaign: CampaignResult, modsim3d: Modsim3d, tmp_path: Path) -> Modsim3d:
    """The command that makes a run of the campaign again, into the folder `again`, with more options."""
    line = "campaign", "reproduce", campaign.folder.path
    return lambda number, *options: modsim3d(*line, number, "--out", tmp_path / "again", *options)


def verdict(requirement: int, outcome: Outcome, tracker: str = "sort", condition: int = 0) -> Verdict:
    return Verdict(requirement, "", tracker, condition, outcome, "", 0.95, None, None, None, 2)


def found(campaign: CampaignResult, *verdicts: Verdict, count: int = 5) -> list[WorstRun]:
    return worst_runs(campaign.folder, campaign.table, verdicts, count)


def values(campaign: CampaignResult, score: str, tracker: str | None = None, condition: int = 0) -> list[float]:
    rows = [row for row in campaign.table.to_pylist() if row["status"] == "done"]
    return [row[score] for row in rows if tracker is None or (row["tracker"], row["condition"]) == (tracker, condition)]


def test_without_requirements_runs_that_crashed_come_first_and_then_the_lowest_hota(campaign: CampaignResult) -> None:
    first, *rest = found(campaign, count=4)
    assert (first.number, first.score, first.value, first.moment_s, first.film) == (CRASHES, "status", None, None, "")
    assert first.error == "ValueError: the filter has lost its mind"
    lowest = sorted(values(campaign, "hota"))[:3]
    assert [(each.score, each.value) for each in rest] == [("hota", value) for value in lowest]


def test_failed_requirements_take_turns_and_come_before_undecided_ones_and_no_run_is_named_twice(campaign):
    failed = verdict(1, "failed", "hasty", 1), verdict(0, "failed", "hasty", 0)
    first, second, *_ = found(campaign, verdict(0, "undecided"), *failed)[1:]
    assert (first.score, first.value) == ("false_track_s", max(values(campaign, "false_track_s", "hasty", 1)))
    assert (second.score, second.value) == ("hota", min(values(campaign, "hota", "hasty", 0)))
    undecided = [each for each in found(campaign, verdict(0, "undecided"), *failed, count=99) if each.tracker == "sort"]
    assert [each.value for each in undecided[-4:]] == sorted(values(campaign, "hota", "sort", 0))
    every = found(campaign, verdict(0, "failed"), verdict(1, "failed"), verdict(0, "met", "hasty"), count=99)
    assert len(every) == len({each.number for each in every}) == 9
    assert every[1].score == "hota"  # the first requirement that names a run says why
    by_run = [score_of_run(campaign.folder, campaign.table, [verdict(1, "failed", "hasty")], each) for each in (9, 8)]
    assert by_run == ["false_track_s", ""]


def test_a_requirement_on_a_state_ranks_by_the_scores_in_it(tmp_path: Path) -> None:
    requirement = {"score": "hota", "where": {"state": ["good", "bad"]}, "at_least": 0.5}
    keys = CampaignKeys.model_validate({"scene": "harbour", "trackers": ["sort"], "require": [requirement]})
    folder = CampaignFolder(tmp_path, {}, Plan.of(keys))
    same = {"condition": 0, "traffic_seed": 0, "detector_seed": 0, "status": "done", "tracker": "sort", "worst_s": 1.0}
    scores = {"state.good.hota": [0.9, 0.5, 0.3, None], "state.bad.hota": [0.9, 0.1, 0.8, None]}
    facts = {"run": [0, 1, 2, 3], **{name: [value] * 4 for name, value in same.items()}}
    worst = worst_runs(folder, pa.table({**facts, "hota": [0.1, 0.9, 0.9, 0.9], **scores}), [verdict(0, "failed")])
    assert [each.number for each in worst] == [1, 2, 0]  # nothing is known of the last one in these states


def test_a_run_made_again_has_the_row_of_the_campaign_and_its_picture_shows_the_tracks_at_the_moment(campaign):
    worst, rules = found(campaign)[1], rules_of(campaign.folder.keys.score)
    made = remade(campaign.folder, worst.number)
    row, stored = row_of(worst.number, made, campaign.folder.keys.score), campaign.table.to_pylist()[worst.number]
    assert {name: stored[name] for name in row} == row and row["worst_s"] == worst.moment_s is not None
    scored = (ScoredRun.of(made.rows, made.tracks.take(np.arange(n)), rules) for n in (len(made.tracks), 0))
    (before, after), without = (moment_pictures(Story.of(each, worst.moment_s)) for each in scored)
    assert before.size == after.size and before.width == WIDTH_PX and after not in (before, *without)
    assert len(encoded(after, optimize=True)) < 300_000
    caption = moment_block(campaign.folder, worst.number, "sort", worst.moment_s, "occlusions_survived").caption
    assert f"after {worst.moment_s:.1f} s, with sort. There is no lost occlusion to show" in caption
    with pytest.raises(ModsimError, match=r"has runs 0 to 15 \(got 16\)"):
        remade(campaign.folder, 16)


def test_of_a_switch_a_lost_vessel_and_a_false_track_the_switch_is_shown_then_the_vessel_then_the_track() -> None:
    truth = [(step, vessel, box(100 * vessel)) for step in range(4) for vessel in (0, 1)]
    false, lost = [(3, 20, box(400))], [(step, 7, box(100)) for step in (0, 1)]
    switch, stays = ([(step, number if step == 3 else 8, box()) for step in range(4)] for number in (9, 8))
    shown = []
    hidden = [(*row, 0.0 if row[:2] in ((1, 0), (2, 0)) else 1.0) for row in truth]  # nobody sees her before the switch
    for rows, tracks in (truth, switch + false + lost), (hidden, switch), (truth, stays + false + lost), ([], false):
        story = Story.of(hand_made(rows, tracks, 4), 3.0)
        close_up = story.close_up([story.before, story.lost])
        shown.append((story.before, story.lost, [*close_up.captions.values()], sorted(close_up.tracks)))
        labels = [Label((0, 0, 1, 1), f"#{number}", (0, 0, 0)) for number in (7, 8, 9, 20)]
        assert [label.text for label in labels if close_up.wanted(label)] == [f"#{each}" for each in shown[-1][-1]]
    a, b = story.scored.rows.scene.vessel_names[:2]
    assert shown == [
        (2, 3, [f"{a}: track #8", f"{a}: track #9"], [8, 9]),
        (0, 3, [f"{a}: track #8", f"{a}: track #9"], [8, 9]),
        (1, 3, [f"{b}: track #7", f"{b}: no track"], [7]),
        (3, 3, ["track #20 on nothing"], [20]),
    ]
    share = {4: None, 6: 0.2, 7: 0.2}  # at 4 she is too small to be scored, and the other track has her already
    seen = [(k, 0, box(), share.get(k, 1.0)) for k in range(9)] + [(k, 1, box(50, 0, 40)) for k in range(9)]
    tracks = [(k, 7 + k // 2, box()) for k in range(6)] + [(k, k // 7, box(50, 0, 40)) for k in range(9)]
    scored = hand_made(seen, [*tracks, (1, 20, box(400))], 9)
    picked = [Story.of(scored, 1.0, row_to_show(scored, x)) for x in ("idf1", "occlusions_survived", "state.haze.assa")]
    assert [(each.vessel, each.before, each.lost) for each in picked] == [(0, 3, 5), (0, 5, 8), (NOBODY, 1, 1)]


def test_the_command_makes_the_run_that_the_options_of_run_make(campaign, again, modsim3d, tmp_path):
    said, out = again(15), tmp_path / "again"
    assert said.status == 0 and "Every column is as in the campaign." in said.out
    assert f"modsim3d score {out} {out}_tracks --similarity centre:200.0" in said.out
    planned = campaign.folder.plan.run(15)
    keys = {"settings": {"detector.operating_threshold": 0.2}, "detector_seed": planned.detector_seed}
    run_scene(load_scene("harbour", steps=20, state="terrible", seed=planned.traffic_seed, **keys), tmp_path / "plain")
    assert run_files(out) == run_files(tmp_path / "plain")
    said = modsim3d("score", out, f"{out}_tracks", "--similarity", "centre:200", "--json")
    assert json.loads(said.out)["trackers"][0]["hota"] == campaign.table["hota"][15].as_py()


def test_the_command_that_films_the_moment_follows_the_one_that_makes_a_run(campaign, modsim3d, tmp_path, monkeypatch):
    monkeypatch.setattr(worst_film, "AROUND_S", 0.5)
    worst = found(replace(campaign, folder=replace(campaign.folder, path=tmp_path / "c")))[4]
    shutil.copytree(campaign.folder.path, tmp_path / "c")
    film = shlex.split(worst.film)[1:]
    assert modsim3d(*shlex.split(worst.again)[1:]).status == 0
    out = tmp_path / "c" / "runs" / str(worst.number)
    log, tracks = out / "run.log", out.with_name(f"{out.name}_tracks") / "tracks.json"
    before = log.stat().st_mtime_ns, tracks.stat().st_mtime_ns
    said = modsim3d(*film)
    assert said.status == 0, said.err
    assert f"{out} was there already" in said.out and (out / "detections.mp4").stat().st_size > 10_000
    assert (log.stat().st_mtime_ns, tracks.stat().st_mtime_ns) == before
    assert "Every column is as in the campaign." in said.out
    again = modsim3d(*film)
    assert again.status == 2 and "detections.mp4 exists: use --overwrite" in again.err
    filmed = json.loads(modsim3d(*film, "--overwrite", "--json").out)["film"]
    assert (filmed["path"], log.stat().st_mtime_ns > before[0]) == (str(out / "detections.mp4"), True)
    assert (filmed["from_s"], filmed["to_s"]) == (worst.moment_s - 0.5, worst.moment_s + 0.5)
    monkeypatch.setattr(reproduce, "score_of_run", lambda *_: "id_switches")
    filmed = json.loads(modsim3d(*film, "--overwrite", "--json").out)["film"]
    assert (filmed["from_s"], filmed["to_s"]) == (4, 5) and worst.moment_s != 4.5


def test_an_interrupted_run_is_gone_on_with_and_another_run_or_tracker_is_refused(again, tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(RunDirectory, "finish", interrupt)
        said = again(2)
    assert said.status == 130 and "the same command goes on" in said.err and again(2).status == 0
    out, (other_tracker, other_seed, other_state) = tmp_path / "again", map(again, (3, 0, 6))
    assert other_tracker.status == other_seed.status == other_state.status == 2
    assert "tracks.parquet exists: use --overwrite" in other_tracker.err
    assert all(f"{out}" in said.err and "use --overwrite" in said.err for said in (other_seed, other_state))
    tables = [out / "detections.parquet", out.with_name("again_tracks") / "tracks.parquet"]
    for table in reversed(tables):  # a damaged file is not taken for the run
        content = table.read_bytes()
        table.write_bytes(content[:-9] + bytes(9))
        assert again(2).status == 2
        table.write_bytes(content)
    assert again(2).status == 0


def test_a_run_that_crashed_crashes_again(again: Modsim3d, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reproduce, "track_run", lambda *_, **__: crash())
    said = again(CRASHES, "--film")
    assert said.status == 0 and "The run crashed again, with the error that the campaign has." in said.out
    assert "ValueError: the filter has lost its mind\n  " in said.out and "in crash" in said.out
    assert "Traceback" not in said.out + said.err
    said = again(0, "--out", tmp_path / "other")
    assert said.status == 1 and "The run crashed." in said.out


def test_a_run_that_comes_out_otherwise_names_the_versions(again: Modsim3d, monkeypatch: pytest.MonkeyPatch) -> None:
    now = reproduce.versions()
    monkeypatch.setattr(reproduce, "versions", lambda: {**now, "numpy": "9.9"})
    monkeypatch.setattr(reproduce, "row_of", lambda *made: {**row_of(*made), "hota": 0.5})
    said = again(0)
    assert said.status == 1 and "1 columns are not as in the campaign: hota." in said.out
    assert f"The campaign was made with other versions: numpy {now['numpy']} → 9.9." in said.out
