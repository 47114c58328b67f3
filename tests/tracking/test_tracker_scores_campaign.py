"""A small sample of the campaign `tracker_scores`, and its committed result."""

import json
import re
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.special import stdtrit

from benchmarks.campaigns import tracker_scores
from benchmarks.tracker_trials import looks, mean_and_interval, on_the_sea, perfect_detector, tracks_lost_when_hidden
from modsim3d import load_scene, score_world
from modsim3d.tracking.score_outcome import ONE_RUN

ROOT = Path(__file__).resolve().parents[2]
CAMPAIGNS = ROOT / "docs" / "campaigns"


@pytest.fixture(scope="module")
def data() -> dict:
    return json.loads((CAMPAIGNS / "tracker_scores.json").read_text(encoding="utf-8"))


def test_the_committed_page_and_lines_of_the_readme_are_what_the_campaign_makes_of_its_figures(data: dict) -> None:
    page = (CAMPAIGNS / "tracker_scores.md").read_text(encoding="utf-8")
    assert page == tracker_scores.page(data)
    # Not reached: the page says so, and nothing else may be wrong.
    assert [problem.partition(":")[0] for problem in tracker_scores.problems(data)] == ["fairway", "harbour"]
    below = page.partition("HOTA is below 0.9 in ")[2].partition(".\n")[0]
    too_low = {name for name, each in data["perfect"].items() if each["reference"]["hota"]["mean"] < 0.9}
    assert {name for name in data["perfect"] if f"`{name}`" in below} == too_low
    assert set(tracker_scores.readme_table(data)) <= set((ROOT / "README.md").read_text(encoding="utf-8").splitlines())


def test_the_spread_that_a_score_warns_of_is_the_largest_in_the_campaign(data: dict) -> None:
    """The standard deviation of n values is half the interval of their mean, times √n / t."""
    halves = [line[key] for lines in data["scenes"].values() for line in lines for key in ("hota", "hota_centre")]
    spread = [each["half"] * np.sqrt(each["n"]) / stdtrit(each["n"] - 1, 0.975) for each in halves]
    assert f"up to {max(spread):.1g}, so" in ONE_RUN


def rows_of(scene: str, traffic_seed: int, detector_seed: int, tracker: str, hota: float, survived: list) -> dict:
    keys = ("hota", "hota_centre", "deta", "assa", "idf1", "id_switches", "false_tracks")
    scores = dict.fromkeys(keys, hota) | {"hota_centre": hota / 2, "states": {"clear": hota}, "occlusions": survived}
    seeds = {"scene": scene, "traffic_seed": traffic_seed, "detector_seed": detector_seed}
    return seeds | {"tracker": tracker} | scores


@pytest.fixture(scope="module")
def rows() -> tuple[list[dict], ...]:
    """Three traffics of the fairway, and another scene's detector seeds; the first tracker is 0.1 better on each."""
    every = (*tracker_scores.TRACKERS, *tracker_scores.ORACLES)
    drawn, others, misses = [], [], []
    for k, tracker in enumerate(every):
        for seed in (1, 2, 3):
            better, survived = 0.1 * (k == 0), [[seed, seed - 1], [10 * seed, 5], [4, 4], [0, 0]]
            hota = 0.2 * seed + better
            drawn += [rows_of("fairway", seed, look, tracker, hota, survived) for look in (seed, seed + 1)]
        for name in tracker_scores.SCENES[1:]:
            others += [rows_of(name, 0, look, tracker, 0.5 + look / 10, [[2, 1]] * 4) for look in (0, 1)]
    alone = [
        rows_of(name, seed, seed, tracker, 0.95, [[0, 0]] * 4)
        for name in tracker_scores.SCENES
        for seed in ((1, 2) if name == "fairway" else (0,))
        for tracker in ("reference", "lost when hidden")
    ]
    for tracker in tracker_scores.TRACKERS:
        for rate in tracker_scores.MISS_RATES:
            for seed in (1, 2):
                row = rows_of("fairway", seed, seed, tracker, 0.9 - rate * (1 + seed / 100), [[0, 0]] * 4)
                misses.append(row | {"miss_rate": rate})
    places = [(name, seed, look) for name in tracker_scores.SCENES for seed in (1, 2) for look in (1, 2)]
    in_world = [
        {"scene": name, "traffic_seed": seed, "detector_seed": look, "tracker": line}
        | dict.fromkeys(keys, 10.0 * seed + k)
        for name, seed, look in places
        for k, line in enumerate(tracker_scores.WORLD_TRACKERS)
        for keys in [tracker_scores.WORLD]
    ]
    return drawn + others, alone, misses, in_world


def test_rows_are_stored_as_they_were_and_the_page_is_made_of_them_alone(rows: tuple, tmp_path, monkeypatch) -> None:
    pq.write_table(tracker_scores.rows_table(*rows), tmp_path / tracker_scores.ROWS)
    for part, again in zip(rows, tracker_scores.stored_rows(tmp_path / tracker_scores.ROWS), strict=True):
        assert [{key: row[key] for key in given} for given, row in zip(part, again, strict=True)] == part
    monkeypatch.setattr("sys.argv", ["tracker_scores", "--stored", "--out", str(tmp_path)])
    assert tracker_scores.main() == 0
    data = json.loads((tmp_path / "tracker_scores.json").read_text())
    text = (tmp_path / "tracker_scores.md").read_text()
    assert (data["seeds"], data["looks"], data["other_looks"], data["miss_seeds"]) == (3, 2, 2, 2)
    assert (data["world"]["seeds"], data["world"]["looks"], data["world"]["other_looks"]) == (2, 2, 4)
    gospa = data["world"]["scenes"]["fairway"][1]["gospa_m"]  # 11 and 21, of two traffics
    assert (gospa["mean"], gospa["n"]) == (16, 2) and text.count("| world_gnn with AIS | 16 ± 64 | ") == 6
    assert f"SHA-256 {data['rows']}" in text and tracker_scores.ROWS in text
    assert "| reference − sort | 0.100 |" in text  # the same difference on all seeds has no interval
    readme = tracker_scores.readme_table(data)
    assert "| Difference | HOTA by centre on `fairway` |" in readme and "| reference − sort | 0.050 |" in readme


def test_survives_is_the_share_of_all_occlusions_that_stand_beside_it(rows: tuple) -> None:
    """Of 1, 2 and 3 occlusions in two looks each 0, 1 and 2 are survived: 6 of 12, and no mean of 0, 1/2 and 2/3."""
    first, second, third, none = tracker_scores.table(rows[0], "fairway")[0]["occlusions"]
    assert (first["survived"], first["all"], first["mean"], first["n"]) == (6, 12, 0.5, 3)
    # By hand: sums of seeds (0, 2), (2, 4), (4, 6); residuals -1, 0, 1; √(3/2 · 2) / 12 · t(2).
    assert first["half"] == pytest.approx(stdtrit(2, 0.975) * np.sqrt(3) / 12)
    assert (second["survived"], second["all"]) == (30, 120)
    assert (third["mean"], third["half"]) == (1, None) and none["mean"] is None
    assert tracker_scores.cell(third) == "1.00"


def test_scores_fall_with_the_miss_rate_and_a_perfect_detector_lets_the_reference_reach_0_9() -> None:
    every = [tracker_scores.miss_trial(("simulation_1", 5, rate, 100)) for rate in (0.0, 0.4)]
    for sound, missing in zip(*every, strict=True):
        assert sound["hota"] > missing["hota"]
    reference, lost_when_hidden = tracker_scores.perfect_trial(("simulation_2", 0, 150))
    assert reference["hota"] > tracker_scores.PERFECT_LEAST and lost_when_hidden["deta"] == 1


def test_true_boxes_on_the_sea_lie_within_a_length_of_their_vessels_and_each_line_has_its_scores_in_metres() -> None:
    detector = perfect_detector(load_scene("simulation_1").detector.labels)
    ((_, rows),) = looks("simulation_1", 5, 1, 15, detector)
    scored = score_world(rows, on_the_sea(rows, tracks_lost_when_hidden(rows))).flat()
    assert scored["rmse_m"] < 8 and scored["followed_share"] > 0.95
    found = tracker_scores.world_trial(("simulation_1", 5, 1, 15))
    assert [row["tracker"] for row in found] == list(tracker_scores.WORLD_TRACKERS)
    assert all(row["gospa_m"] >= 0 and set(tracker_scores.WORLD) < set(row) for row in found)


def test_an_interval_is_student_s_and_detector_seeds_of_one_traffic_count_as_one_but_of_the_only_one() -> None:
    """Of 1, 2, 3: mean 2, standard deviation 1, and the 97.5 % quantile of t with 2 degrees of freedom is 4.3027."""
    found = mean_and_interval([1.0, None, 2.0, 3.0])
    assert found == {"n": 3, "mean": 2, "half": pytest.approx(4.302653 / np.sqrt(3), rel=1e-6)}
    assert mean_and_interval([5.0]) == {"n": 1, "mean": 5.0, "half": None}
    rows = [{"traffic_seed": seed, "hota": value} for seed, value in ((1, 0.2), (1, 0.4), (2, 0.5), (2, 0.7))]
    found = tracker_scores.nested(rows, "hota")
    assert found["n"] == 2 and found["mean"] == pytest.approx(0.45)
    found = tracker_scores.nested([{"traffic_seed": 0, "hota": value} for value in (0.2, 0.4, 0.6)], "hota")
    assert found["n"] == 3 and found["half"] is not None


def test_an_interval_is_never_shown_without_width(data: dict) -> None:
    page = (CAMPAIGNS / "tracker_scores.md").read_text(encoding="utf-8")
    assert not re.search(r"± 0\.0*[^0-9.]", page) and "± 0.00 " not in tracker_scores.page(data)
    means = [{"mean": 0.98, "half": 0.0031}, {"mean": 0.98, "half": 0.0012}, {"mean": 1.0, "half": 0.0}]
    cells = [tracker_scores.cell(each) for each in (*means, mean_and_interval([1.0] * 19))]
    assert cells == ["0.98 ± 0.003", "0.98 ± 0.001", "1.00", "1.00"]
