"""The page of a campaign: what stands first, what it admits, and that it needs nothing else."""

import re
from dataclasses import replace

import pytest

from modsim3d.campaign.done_rows import with_plan
from modsim3d.campaign.folder import CampaignFolder, files_of_campaign
from modsim3d.campaign.keys import CampaignKeys, SearchKeys
from modsim3d.campaign.plan import Plan
from modsim3d.campaign.report.campaign_page import campaign_page, crash_sections, mean_sections
from modsim3d.campaign.report.search_page import search_page, write_page
from modsim3d.campaign.report.words import constant, requirement_sections, verdict_sentence
from modsim3d.campaign.verdicts.verdict import Verdict
from modsim3d.campaign.work.row import crashed_row, table_of
from modsim3d.view.pages import tables
from tests.campaign.campaigns import html_of_blocks, run_campaign_file
from tests.campaign.hand_made_tables import table_of_runs
from tests.campaign.test_report_numbers import plan_of, table_for


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    keys = {"scene": "harbour", "steps": 20, "seeds": {"traffic": 2}, "trackers": ["reference"]}
    vary, require = [{"grid": {"state": ["excellent", "terrible"]}}], [{"score": "hota", "at_least": 0.5}]
    return run_campaign_file(tmp_path_factory.mktemp("report"), "c.yaml", **keys, vary=vary, require=require).folder


@pytest.fixture(scope="module")
def html(campaign, tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "report.html"
    write_page(campaign, path)
    return path.read_text(encoding="utf-8")


def verdict(requirement, outcome, **more):
    given = {"text": "hota at least 0.5", "tracker": "sort", "condition": 0, "why": "It is so.", "confidence": 0.95}
    numbers = {"estimate": 0.55, "low": 0.52, "high": 0.58, "seeds": 8}
    return Verdict(requirement=requirement, outcome=outcome, **{**given, **numbers, **more})


def sentence(*outcomes):
    plan = plan_of(2, require=[{"score": "hota", "at_least": 0.5}] * len(outcomes))
    return verdict_sentence(plan, [verdict(place, outcome) for place, outcome in enumerate(outcomes)])


def test_the_first_sentence_counts_requirements():
    assert sentence("met", "met") == "✓ All 2 requirements are met, at 95 % confidence each."
    each = "✗ Not met: of 3 requirements 1 failed, 1 is undecided and 1 is met, at 95 % confidence each."
    assert sentence("met", "failed", "undecided") == each
    assert sentence("undecided") == "? Not decided: the requirement is undecided, at 95 % confidence each."
    assert sentence("failed", "failed").startswith("✗ Not met: all 2 requirements failed, at")
    assert "no requirements" in sentence()


def test_a_requirement_that_failed_in_one_condition_has_failed():
    plan = plan_of(2, require=[{"score": "hota", "at_least": 0.5}])
    found = [verdict(0, "met"), verdict(0, "failed", condition=1, why="Too low <here>.", crashed=1)]
    assert verdict_sentence(plan, found).startswith("✗ Not met")
    html = html_of_blocks(requirement_sections(plan, found))
    assert "✗ failed (1 failed, 1 met)" in html and "Too low &lt;here&gt;." in html
    assert html.index("✗ failed</td>") < html.index("✓ met</td>")


def noted(*rows):
    plan = plan_of(2, require=[{"score": "hota", "at_least": 0.5}])
    return html_of_blocks(requirement_sections(plan, [verdict(0, "failed", **row) for row in rows])).count("It is so.")


def test_a_row_says_only_what_its_interval_does_not():
    below = {"estimate": 0.4, "low": 0.3, "high": 0.45}
    assert noted(below) == 0
    assert noted(below | {"low": None, "high": None}) == 1
    assert noted(below | {"undefined": 2}) == 1
    assert noted(below | {"high": 0.49996}) == 1  # printed as 0.500, the threshold
    plan = plan_of(2, require=[{"score": "hota", "at_least": 0.5, "in": 0.95}])
    html = html_of_blocks(requirement_sections(plan, [verdict(0, "failed", low=0.1, high=0.6)]))
    assert re.search(r"<th>0\.0\d+ to 1; shaded: at least 0\.950</th>", html)  # the axis of a share ends at 1


def test_the_verdict_stands_before_all_numbers_and_the_page_names_what_they_mean_and_needs_no_network(campaign, html):
    assert campaign.finished
    body = html.partition("<body>")[2]
    assert "requirement" in (lead := re.search(r'<p class="lead">(.*?)</p>', body)[1])
    assert body.index(lead) < body.index("This traffic only") < body.index("<h2>Requirements") < body.index("<h2>Means")
    assert "Seeds change the detector and the waves; no result speaks of other traffic." in html
    assert "HOTA (0 to 1)" in html and "<h2>Scores against what is varied</h2>" in html
    assert re.search(r"<h3>Run \d+: reference, HOTA \S+ \(requirement 1\)</h3>", html)
    assert "1. hota at least 0.5" in html.partition("What each verdict rests on")[2] and "[0]" not in html
    assert not re.findall(r'(?:src|href)="(?!data:|#)', html) and "<script" not in html and len(html) < 3e6
    assert all(path.is_file() for path in files_of_campaign(campaign))


def test_keys_that_are_set_for_all_runs_are_named():
    plan = plan_of(2, set={"waves.apply_to": "all"}, vary=[{"grid": {"waves.level": ["small"]}}])
    assert constant(plan) == {"waves.apply_to": "all", "waves.level": "small"}
    assert tables.facts([("plan", "0" * 64)]).count("<wbr>") == 3  # a checksum may be broken for a narrow screen


def test_an_unfinished_campaign_says_so_first(campaign, tmp_path):
    other = CampaignFolder(tmp_path, campaign.facts, campaign.plan)
    page = campaign_page(other, table_of([]), [])
    assert '<p class="lead">Not finished: 0 of 4 runs are done, and nothing on this page is a verdict.</p>' in page


def test_crashes_are_grouped_by_their_error(campaign):
    rows = [crashed_row(number, "ValueError: <a>" if number < 2 else "KeyError: b") for number in range(3)]
    html = html_of_blocks(crash_sections(campaign, with_plan(table_of(rows), campaign.plan)))
    assert "3 runs of 3 crashed" in html and html.index("ValueError: &lt;a&gt;") < html.index("KeyError: b")
    assert f"campaign reproduce {campaign.path} 0 --out" in html
    assert html_of_blocks(crash_sections(campaign, table_for(plan_of(2)))) == ""


def test_the_means_of_a_sequential_campaign_prove_nothing():
    said = "these intervals describe and prove nothing"
    for stop in ("once", "sequential"):
        plan = plan_of(2, stop=stop)
        assert (said in html_of_blocks(mean_sections(plan, table_for(plan)))) == (stop == "sequential")


def test_a_search_is_no_rate_and_names_the_worst_first(campaign):
    search = SearchKeys.model_validate({"minimise": "hota", "over": {"waves.x_m": [0, 1]}, "budget": 4})
    keys = CampaignKeys.model_validate({"scenes": ["harbour"], "trackers": ["sort"], "search": search.model_dump()})
    folder = replace(campaign, plan=Plan.of(keys))
    scores = [{"hota": 0.6}, {"hota": 0.2}, {"status": "refused", "error": "waves break"}]
    table = table_of_runs({**each, "waves.x_m": 0.5, "traffic_seed": 7} for each in scores)
    html = search_page(folder, search, table)
    assert "The lowest HOTA of 3 trials is 0.200, in trial 1." in html and "no share or mean of them is a rate" in html
    assert "Not finished: 3 of 4 trials are done." in html and "waves break" in html
    assert re.findall(r'data-label="trial">(\d)</td><td class="number" data-label="HOTA">0\.', html) == ["1", "0"]
