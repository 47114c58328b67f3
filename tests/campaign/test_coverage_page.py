"""The sections of a page on what a campaign covered, and on what its verdicts rest."""

import re
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from modsim3d.campaign.keys import CampaignKeys
from modsim3d.campaign.report.coverage import coverage_sections, empty_draws, numbers_in_words, trace_sections
from modsim3d.campaign.running import CampaignResult
from modsim3d.campaign.verdicts.verdict import Verdict
from tests.campaign.campaigns import html_of_blocks, run_campaign_file

RATE = "detector.states.excellent.false_discovery_rate"
KEYS: dict[str, Any] = {
    "scene": "harbour", "steps": 20, "seeds": {"traffic": 3}, "vary": [{"uniform": {RATE: [0.02, 0.3]}}],
    "trackers": ["sort", {"tracker": "sort", "name": "patient", "set": {"lost_s": 9}}],
}  # fmt: skip


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> CampaignResult:
    return run_campaign_file(tmp_path_factory.mktemp("coverage"), **KEYS)


def lines_of(page: str) -> dict[str, list[str]]:
    """The cells of each row of tables, by the first one."""
    cells = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr>(<td.*?)</tr>", page)]
    return {each[0]: each[1:] for each in cells}


def test_a_truth_is_counted_once_however_many_runs_are_over_it_and_what_is_empty_is_not_covered(result):
    table, page = result.table, html_of_blocks(coverage_sections(result.folder, result.table))
    assert len(set(table["truth_key"].to_pylist())) == 1  # the traffic of the harbour is not drawn
    assert len(set(table["detections_key"].to_pylist())) == 3
    names = [name for name in table.column_names if name.startswith("covered.")]
    assert len({tuple(row.values()) for row in table.select(names).to_pylist()}) == 1  # over a truth it is the same
    lines = lines_of(page)
    assert "6 of 6 runs are done, over 1 different truth and 1 traffic seed." in page
    assert "The traffic of harbour is not drawn: it is the same for every seed, and counts as one." in page
    assert (frames := table["covered.frames.range_200_500_m"][0].as_py()) > 0
    assert lines["200 to 500 m"] == [f"{frames:,}", "6", "1"]
    assert lines["Vessel"] == [f"{table['covered.vessels.Vessel'][0].as_py()}", "6", "1"]
    assert lines["excellent"] == [f"{3 * 20}", "6", "3"]  # the states are drawn by each of three detector seeds
    assert lines["5000 m and more"] == ["–", "–", "–"] and re.search(r"<li>Range: [^<]*5000 m and more</li>", page)
    assert re.search(r"<li>Sea: [^<]*moderate \(1.25 to 2.5 m\)", page)
    assert re.search(rf"<li>{RATE}: no draw from ", page)
    assert "there is no own ship that could meet another" in page and "no claim is made about it" in page
    assert "lost_s 9" in lines["patient"][2] and "lost_s 9" not in lines["sort"][2] and lines["sort"][-1] == "all"


def test_runs_that_crashed_cover_nothing(result: CampaignResult) -> None:
    def page(*status: str) -> str:
        table = result.table.set_column(result.table.column_names.index("status"), "status", pa.array(status))
        return html_of_blocks(coverage_sections(result.folder, table))

    one = page("crashed", *["done"] * 5)
    assert "5 of 6 runs are done" in one and "1 more crashed" in one and lines_of(one)["200 to 500 m"][1] == "5"
    assert "0 of 6 runs are done" in page(*["crashed"] * 6)


def test_a_verdict_is_traced_to_its_runs_seeds_checksums_and_commands(result: CampaignResult) -> None:
    verdict = Verdict(0, "hota < 1 & more", "patient", 0, "met", "", 0.95, 0.5, 0.4, 0.6, 3)
    page = html_of_blocks(trace_sections(result.folder, result.table, [verdict]))
    facts, (condition,) = result.folder.facts, result.folder.facts["conditions"]
    (line,) = (cells for name, cells in lines_of(page).items() if name.startswith("1. "))
    assert line == ["patient", "0", "met", "1, 3, 5 (3 of them)", "1000000–1000002 (3 of them)", "3"]
    assert "1. HOTA &lt; 1 &amp; more" in page and facts["sha256"] in page
    assert condition["truth_sha256"][:16] in page and condition["detector_sha256"][:16] in page
    versions = {**facts["versions"], **condition["trackers"]["sort"]["versions"]}
    assert "trackers" in versions and all(lines_of(page)[name] == [version] for name, version in versions.items())
    assert f"modsim3d campaign reproduce {result.folder.path} 0 --out run_0" in page
    assert f"modsim3d campaign run {result.folder.path}/campaign.yaml --out campaign_again" in page
    assert f"{RATE} differ from seed to seed" in page


def test_a_trace_shows_the_first_of_very_many_verdicts_and_may_have_none(result: CampaignResult) -> None:
    verdicts = [Verdict(place, "hota", "sort", 0, "met", "", 0.95, 0.5, 0.4, 0.6, 3) for place in range(300)]
    page = html_of_blocks(trace_sections(result.folder, result.table, verdicts))
    assert "200. HOTA" in page and "201. hota" not in page and "100 more are in verdicts.json." in page
    nothing = result.table.slice(0, 0)
    page = html_of_blocks(trace_sections(result.folder, nothing, []))
    assert "no requirements" in page and "campaign reproduce" in page
    assert "none" in html_of_blocks(trace_sections(result.folder, nothing, verdicts[:1]))


def test_numbers_are_said_in_few_words() -> None:
    for numbers, said in (
        ([], "none"), ([7], "7"), ([0, 1, 2, 3], "0–3 (4 of them)"),
        ([0, 4, 8, 12, 16], "0, 4, … 16 (5 of them, 4 apart)"),
        ([0, 1, 4, 5, 9], "0–1, 4–5, 9 (5 of them)"),
        ([*range(0, 6), *range(9, 40, 3)], "0–5, 9, 12, 15, 18, 21 and 6 ranges more (17 of them)"),
    ):  # fmt: skip
        assert numbers_in_words(np.array(numbers, dtype=np.int64)) == said


def draws(ranges: dict[str, Any], columns: dict[str, list[Any]]) -> list[str]:
    keys = CampaignKeys.model_validate({"scene": "harbour", "trackers": ["sort"], "vary": [{"uniform": ranges}]})
    return empty_draws(keys, pa.table({"status": ["done"] * len(next(iter(columns.values()))), **columns}))


def test_parts_of_ranges_that_no_draw_came_near_and_choices_that_were_never_drawn_are_said() -> None:
    tenths = (np.arange(10) / 10 + 0.05).tolist()
    log = {"low": 1, "high": 100, "scale": "log"}
    for key, drawn, said in (
        ([0, 1], [0.05, 0.15, *tenths[4:]], ["x: no draw from 0.2 to 0.4"]),
        ([0, 1], tenths, []),
        (log, (10 ** (np.arange(9) / 5 + 0.1)).tolist(), ["x: no draw from 63.1 to 100"]),
        ({"choices": [1, 2, 3]}, [1.0, 3.0], ["x: 2: never drawn"]),
        ({"choices": [1, 2]}, [2.0, 1.0], []),
        ({"choices": ["a", 2, True]}, ["a", "2"], ["x: true: never drawn"]),
        ({"choices": ["a", "b"]}, ["b"], ["x: a: never drawn"]),
    ):
        assert draws({"x": key}, {"x": drawn}) == said, key
    along = (np.arange(40) / 40 + 0.01).tolist()
    (said,) = draws({"x": [0, 1], "y": [0, 1]}, {"x": along, "y": along})
    assert said == "x with y: no draw in 12 of 16 squares of quarters of both ranges"
