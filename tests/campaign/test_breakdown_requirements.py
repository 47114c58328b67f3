"""Requirements on a part of the runs that only the simulator can tell: a bin of a breakdown, or a camera."""

from contextlib import closing
from typing import Any

import pytest

from modsim3d.campaign.verdicts.verdict import judge
from modsim3d.campaign.verdicts.wording import score_name, warnings_of
from modsim3d.campaign.work.layers import RunLayers
from modsim3d.campaign.work.row import rules_of
from modsim3d.tracking.scores.breakdown import BINS
from modsim3d.tracking.scores.scored_run import ScoredRun
from modsim3d.tracking.scores.scoring import scores_of
from tests.campaign.campaigns import campaign_file, run_campaign_file
from tests.campaign.hand_made_tables import plan_of, table_of_runs

RECALL = {"score": "recall", "at_least": 0.8, "in": 0.5}
SURVIVED = {"score": "occlusions_survived", "at_least": 0.6, "in": 0.5, "where": {"occlusion": "3 to 10"}}
HALF = "visible_fraction.0.5 to 0.75"
LONG = "occlusion.3 to 10"


def rows_with(*columns: dict[str, Any]) -> Any:
    return table_of_runs({"hota": 0.1, **each} for each in columns)


def test_recall_is_judged_in_each_bin_that_is_named_and_on_a_share_of_it_where_one_is_asked_for() -> None:
    require = [{"visible_fraction": ["0.5 to 0.75", "1", 1]}, {"range": "0 to 100"}]
    plan = plan_of(5, [{**RECALL, "where": require[0]}, {**RECALL, "resting_on": 0.9, "where": require[1]}])
    columns = {f"{HALF}.recall": 0.5, "range.0 to 100.recall": 0.85}
    columns |= {f"{HALF}.vessel_frames": 9, "range.0 to 100.vessel_frames": 9}
    rows = ({**columns, "visible_fraction.1.recall": 0.9 + run / 100} for run in range(5))
    half, whole, near = judge(plan, rows_with(*rows))
    assert (half.outcome, whole.outcome, near.outcome, near.nothing) == ("failed", "met", "failed", 5)
    assert half.text == "recall at least 0.8 in visible_fraction 0.5 to 0.75, in 50 % of traffic seeds"
    assert half.values == {"visible_fraction": "0.5 to 0.75"}
    assert "It rests on 85 % of vessel-frames" in near.why


def test_a_run_without_vessel_frames_in_the_bin_is_left_out_and_one_without_tracks_has_no_recall() -> None:
    empty, missed = {f"{HALF}.vessel_frames": 0}, {f"{HALF}.vessel_frames": 4, f"{HALF}.recall": 0.0}
    good = {f"{HALF}.vessel_frames": 4, f"{HALF}.recall": 1.0}
    plan = plan_of(7, [{**RECALL, "where": {"visible_fraction": "0.5 to 0.75"}}])
    (verdict,) = judge(plan, rows_with(empty, missed, *[good] * 5))
    assert (verdict.seeds, verdict.undefined, verdict.nothing, verdict.estimate) == (6, 1, 0, 5 / 6)
    assert "1 traffic seed without recall in visible_fraction 0.5 to 0.75 left out: 1000000. The truth" in verdict.why


def survival(survived: float | None, judged: int, to_survive: int) -> dict[str, Any]:
    counts = {"occlusions": 4, "occlusions_judged": judged, "occlusions_to_survive": to_survive}
    return {f"{LONG}.{name}": value for name, value in {**counts, "occlusions_survived": survived}.items()}


def test_survival_by_length_is_managed_by_the_tracker_as_survival_of_all_is() -> None:
    """Where there is an occlusion to survive, a tracker that follows nothing before it is at fault."""
    rows = rows_with(survival(None, 0, 2), survival(None, 0, 0), *[survival(0.75, 4, 4)] * 8)
    without, resting = (judge(plan_of(10, [{**SURVIVED, **share}]), rows)[0] for share in ({}, {"resting_on": 0.5}))
    assert (resting.outcome, resting.seeds, resting.nothing, resting.undefined) == ("met", 9, 1, 1)
    assert without.outcome == "undecided" and "`resting_on`, as in" in without.why
    assert "mean over runs" in resting.why and "% of occlusions" in resting.why


@pytest.mark.parametrize(("group", "good", "bad"), [("camera", "bow", "stern"), ("state", "clear", "haze")])
def test_a_camera_and_a_state_within_the_runs_have_columns_of_their_own(group, good, bad) -> None:
    plan = plan_of(5, [{"score": "hota", "at_least": 0.4, "in": 0.5, "where": {group: [good, bad]}}])
    row = {f"{group}.{good}.hota": 0.5, f"{group}.{bad}.hota": 0.3, f"{group}.{good}.vessel_frames": 3}
    met, failed = judge(plan, rows_with(*[row] * 5))
    assert (met.outcome, failed.outcome, failed.values) == ("met", "failed", {group: bad})
    assert met.text == f"hota at least 0.4 in {group} {good}, in 50 % of traffic seeds"


@pytest.mark.parametrize(
    ("score", "group", "name"), [("recall", "size", "16 to 32"), ("hota", "camera", "bow"), ("hota", "state", "haze")]
)
def test_no_mean_of_a_part_of_the_runs_is_met_by_what_was_measured_of_whole_runs(score, group, name) -> None:
    plan = plan_of(40, [{"score": score, "at_least": 0.4, "where": {group: name}}])
    rows = ({f"{group}.{name}.{score}": 0.8 + run / 1000, f"{group}.{name}.vessel_frames": 9} for run in range(40))
    (verdict,) = judge(plan, rows_with(*rows))
    assert verdict.outcome == "undecided" and "ask for a share of seeds with `in`" in verdict.why
    (warning,) = warnings_of(plan)
    assert f"a mean of {score_name(score)} by {group} was not measured to hold" in warning


@pytest.mark.usefixtures("in_this_process")
def test_the_terminal_and_the_page_name_the_part_and_a_mean_has_one_interval(modsim3d, tmp_path, monkeypatch):
    monkeypatch.setattr("modsim3d.campaign.report.campaign_page.WORST", 1)  # drawing them is most of the time
    recall = {"score": "recall", "at_least": 0.1, "where": {"range": ["100 to 200", "400 to 800"]}}
    require = [recall, {"score": "hota", "at_least": 0.1, "where": {"state": ["excellent", "terrible"]}}]
    keys = {"scene": "harbour", "steps": 20, "seeds": {"traffic": 2}, "trackers": ["reference"]}
    said = modsim3d("campaign", "run", campaign_file(tmp_path, **keys, require=require), "--out", tmp_path / "out")
    assert said.status in (1, 3), said.err
    _, _, means = said.out.partition("Means")
    assert "those of the requirements" in " ".join(means.split())
    for column in ("recall in range 100 to 200", "recall in range 400 to 800", "HOTA in state excellent"):
        assert column in means
    (line,) = [line for line in means.splitlines() if line.startswith("reference")]
    assert line.split()[2:4] == ["–", "0.321"] and not line.split()[4].startswith("[")  # nothing is in the first range
    assert modsim3d("campaign", "report", tmp_path / "out").status == 0
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "recall at least 0.1, range 100 to 200 or 400 to 800" in page
    assert "HOTA at least 0.1, state excellent or terrible" in page
    assert all(f'data-label="range">{name}</td>' in page for name in ("100 to 200", "400 to 800"))


def test_rows_of_a_campaign_have_the_bins_of_the_scores_and_are_judged_by_them(tmp_path) -> None:
    frames = {**RECALL, "at_least": 0.1, "in": 0.2, "where": {"range": [*BINS["range"]]}}
    require = [frames, {**SURVIVED, "resting_on": 0.5}]
    result = run_campaign_file(tmp_path, scene="fairway", steps=60, trackers=["reference"], require=require)
    plan, keys = result.folder.plan, result.folder.keys
    (row,) = result.table.to_pylist()
    with closing(RunLayers(keys, tmp_path, tmp_path / "layers")) as layers:
        made = layers.layers_of(plan.run(0))
    scores = scores_of(ScoredRun.of(made.rows, made.tracks, rules_of(keys.score)))
    nothing = {"vessel_frames": 0, "recall": None, "occlusions": 0, "judged": 0, "survived": None, "to_survive": 0}
    for group in scores.breakdown:
        for name in BINS.get(group.name, ()):
            found = next((vars(each) for each in group.rows if each.bin == name), nothing)
            columns = {"vessel_frames": "vessel_frames", "recall": "recall"}
            if group.name == "occlusion":
                counts = {f"occlusions_{each}": each for each in ("judged", "survived", "to_survive")}
                columns |= {"occlusions": "occlusions", **counts}
            for column, value in columns.items():
                assert row[f"{group.name}.{name}.{column}"] == found[value], (group.name, name, column)
    assert sum(row[f"range.{name}.vessel_frames"] for name in BINS["range"]) == row["true_positives"] + row["misses"]
    assert sum(row[f"occlusion.{name}.occlusions"] for name in BINS["occlusion"]) == row["occlusions"]
    seen = [int(row[f"range.{name}.vessel_frames"] > 0) for name in BINS["range"]]
    assert [verdict.seeds for verdict in judge(plan, result.table)[: len(seen)]] == seen
