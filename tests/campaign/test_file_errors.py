"""A campaign file: every problem at once, with key and value, before anything is written; also of requirements."""

from pathlib import Path

import pytest

from modsim3d.campaign.keys import read_campaign, shipped_campaigns
from modsim3d.campaign.work.checking import checked
from modsim3d.core.errors import InputError
from tests.campaign.campaigns import checked_campaign, problems_of
from tests.cli.conftest import Modsim3d

HARBOUR = "scene: harbour\nsteps: 20\ntrackers: [sort]\n"


def problems(tmp_path: Path, text: str) -> tuple[str, ...]:
    path = tmp_path / "campaign.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as refused:
        checked(read_campaign(path))
    assert str(path) in refused.value.source
    return refused.value.problems


@pytest.mark.parametrize(("text", "parts"), [
    ("", ["the file is empty"]),
    ("[]", ["a mapping of keys is needed (got a list)"]),
    ("scene: harbour\n", ["trackers: missing"]),
    ("scene: harbour\ntracker: sort\n", ["tracker: unknown key (did you mean 'trackers'?)"]),
    (HARBOUR + "scenes: [strait]\n", ["give either scene or scenes"]),
    (HARBOUR + "seeds: {trafic: 3}\nrequire: [{inn: 1}]\n", ["seeds.trafic: unknown key (did", "(did you mean 'in'?)"]),
    (HARBOUR + "vary: [{grid: {state: [good]}, pairs: {x: [1]}}]\n", ["vary[0]: give exactly one of grid, pairs"]),
    (HARBOUR + "require: [{score: hota}]\n", ["require[0]: give either at_least or at_most"]),
    (HARBOUR + "score: {similarity: centre}\n", ["score: similarity centre needs scale_px"]),
    (HARBOUR + "vary: [{pairs: {a: [1, 2], b: [1]}}]\n", ["as many values"]),
    (HARBOUR + "vary: [{uniform: {a: [2, 1]}}]\n", ["below high"]),
    (HARBOUR + "vary: [{uniform: {a: {low: 0, high: 1, scale: log}}}]\n", ["above 0"]),
    (HARBOUR + "vary: [{uniform: {a: [1, 2, 3]}}]\n", ["two numbers"]),
    (HARBOUR + "seed: 0\n", ["must be at least 1"]),
    (HARBOUR + "vary: [{list: [{steps: 3}]}]\n", ["vary: 'steps' cannot be varied here: the key steps"]),
    (HARBOUR + "vary: [{grid: {state: [good]}}, {pairs: {state: [bad]}}]\n", ["'state' is varied by two factors"]),
    (HARBOUR + "vary: [{grid: {state: [good, god]}}]\n", ["vary: state 'god': unknown state 'god' (did you mean"]),
    (HARBOUR + "vary: [{grid: {state: [good, bad, good]}}]\n", ["conditions 0 and 2 are the same (state 'good')"]),
    (HARBOUR + "vary: [{grid: {waves.levl: [small]}}]\n", ["vary: waves.levl 'small': unknown key waves.levl"]),
    (HARBOUR + "vary: [{grid: {tracker.lost: [3]}}]\n", ["tracker.lost 3: unknown key (did you mean 'lost_s'?)"]),
    (HARBOUR + "vary: [{grid: {detector: [thesi]}}]\n", ["harbour with detector 'thesi'", "thesi: no such file"]),
])  # fmt: skip
def test_a_problem_is_named_with_its_key_and_value(tmp_path: Path, text: str, parts: list[str]) -> None:
    found = "\n".join(problems(tmp_path, text))
    for part in parts:
        assert part in found


def test_all_problems_are_found_at_once_and_a_refused_value_of_many_conditions_once_at_both_ends_of_a_range(tmp_path):
    text = "scene: harbur\nsteps: 20\ntrackers: [srt, {tracker: sort, set: {lost: 3}}]\n"
    text += "require: [{score: hotta, at_least: 0.5}]\n"
    found = problems(tmp_path, text)
    places = ["scenes[0]", "trackers[0]", "trackers[1]", "require[0].score"]
    assert [problem.partition(":")[0] for problem in found] == places
    for name in ("harbour", "sort", "lost_s", "hota"):
        assert sum(f"did you mean '{name}'?" in problem for problem in found) == 1
    text = HARBOUR + "vary: [{grid: {waves.level: [small, 9], state: [good, bad]}}]\n"
    assert problems(tmp_path, text) == ("vary: waves.level 9: text is needed (got 9)",)
    found = "\n".join(problems(tmp_path, HARBOUR + "vary: [{uniform: {detector.false_positives.rate: [-1, 1001]}}]\n"))
    assert "rate -1" in found and "rate 100" in found


def test_a_plan_that_is_too_large_is_refused_with_its_number(tmp_path: Path) -> None:
    many = ", ".join(f"k{n}: [1,2,3,4,5,6,7,8,9,0]" for n in range(7))
    for line, said in (
        (f"vary: [{{grid: {{{many}}}}}]\n", "10,000,000 conditions"),
        ("seeds: {traffic: 1000000, detector: 10}\n", "10,000,000 runs, and at most 5,000,000 are possible"),
    ):
        (found,) = problems(tmp_path, HARBOUR + line)
        assert said in found


def test_nothing_is_written_for_a_wrong_file(tmp_path: Path, modsim3d: Modsim3d) -> None:
    path = tmp_path / "campaign.yaml"
    path.write_text(HARBOUR + "vary: [{grid: {state: [god]}}]\n")
    said = modsim3d("campaign", "run", path, "--out", tmp_path / "out")
    assert (said.status, said.out) == (2, "")
    assert said.err.startswith(f"modsim3d: campaign {path}:\n  vary: state 'god'") and not (tmp_path / "out").exists()


def test_a_shipped_campaign_has_no_problem_and_another_name_a_hint() -> None:
    runs = {name: len(checked(read_campaign(name)).plan) for name in shipped_campaigns()}
    assert runs["example"] == 24 and min(runs.values()) > 0
    with pytest.raises(InputError, match=r"no shipped campaign has this name .*example"):
        read_campaign("exmple")


STRAIT = "scene: strait\nsteps: 3\ntrackers: [reference]\n"


@pytest.mark.parametrize(("text", "said"), [
    ("vary: [{grid: {detector.states.clear.false_discovery_rate: [0.1, 0.6]}}]\n",
     "vary: detector.states.clear.false_discovery_rate 0.1: model per_image does not read it: set "
     "detector.false_positives.rate"),
    ("set: {detector.states.haze.false_discovery_rate: 0.6}\n",
     "set: detector.states.haze.false_discovery_rate 0.6: model per_image does not read it: set "
     "detector.states.haze.false_positives_per_image"),
    ("vary: [{uniform: {detector.confidence_threshold: [0.3, 0.4]}}]\n", "set detector.operating_threshold"),
    ("vary: [{grid: {detector.false_positives.merge_overlap: [0.1, 0.4]}}]\n",
     "vary: detector.false_positives.merge_overlap 0.1: merges is 0: set detector.false_positives.merges"),
    ("vary: [{grid: {state: [haze], detector.false_positives.rate: [0.1, 0.4]}}]\n",
     "each state has a rate of its own: set detector.states.haze.false_positives_per_image"),
])  # fmt: skip
def test_a_key_that_no_condition_reads_is_refused(tmp_path: Path, text: str, said: str) -> None:
    (found,) = problems(tmp_path, STRAIT + text)
    assert said in found


@pytest.mark.parametrize("text", [
    "vary: [{grid: {state: [clear, haze], detector.states.haze.confidence.visibility_slope: [0.1, 0.2]}}]\n",
    "vary: [{grid: {detector.false_positives.merges: [0, 0.5], "
    "detector.false_positives.merge_overlap: [0.2, 0.5]}}]\n",
    "vary: [{uniform: {detector.operating_threshold: [0.2, 0.6]}}]\n",
    "search: {minimise: hota, budget: 4, over: {detector.false_positives.merges: [0, 1], "
    "detector.false_positives.merge_overlap: [0.1, 0.9]}}\n",
])  # fmt: skip
def test_a_key_that_a_condition_reads_is_taken(tmp_path: Path, text: str) -> None:
    path = tmp_path / "campaign.yaml"
    path.write_text(STRAIT + text)
    assert len(checked(read_campaign(path)).plan) > 0


KEYS = {"scene": "harbour", "steps": 20, "trackers": ["bytetrack"]}
GOSPA = {"score": "gospa", "at_most": 50}
HOTA = {"score": "hota", "at_least": 0.5}
RECALL = {"score": "recall", "at_least": 0.8, "in": 0.5}
SURVIVED = {"score": "occlusions_survived", "at_least": 0.6, "in": 0.5}
NO_WORSE = {"score": "siap_completeness", "of": "new", "minus": "old", "at_least": -0.02}
DETECTORS = {"vary": [{"grid": {"detector": ["thesis", "conditions/foggy_clear"]}}]}
GRID = {"vary": [{"grid": {"state": ["good", "bad"], "waves.level": ["small", "large"]}}]}
PAIRS = {"vary": [{"pairs": {"state": ["good", "bad"], "waves.level": ["small", "large"]}}]}
DRAWN = {"vary": [{"uniform": {"state": {"choices": ["good", "bad"]}}}]}
TWO_CAMERAS = {"scene": "simulation_3", "trackers": ["reference"]}
OLD_AND_NEW = {"trackers": [{"tracker": "sort", "name": "old"}, {"tracker": "bytetrack", "name": "new"}]}


@pytest.mark.parametrize(("keys", "requirement", "said"), [
    ({"stop": "sequential"}, GOSPA, "require[0]: with stop: sequential a mean needs"),
    ({}, {**GOSPA, "where": {"state": "bad"}}, "require[0].score: gospa is not known by state (known: hota, "),
    ({}, {**HOTA, "where": {"state": "foggy"}}, "require[0].where.state: there is no 'foggy' (known: "),
    (DETECTORS, {**HOTA, "where": {"state": "bad"}}, "the detector of condition 1 has no state 'bad'"),
    (GRID, {**HOTA, "where": {"state": "baad"}}, "where.state: there is no 'baad' (did you mean 'bad'?)"),
    (GRID, {**HOTA, "where": {"waves.level": ["small", "huge"]}}, "where.waves.level: there is no 'huge'"),
    (GRID, {**HOTA, "where": {"waves.level": []}}, "require[0].where.waves.level: names no value"),
    (GRID, {**HOTA, "where": {"tracker": "sort"}}, "require[0].where.tracker: there is no 'sort'"),
    (PAIRS, {**HOTA, "where": {"state": "bad", "waves.level": "small"}}, "no condition has these values together"),
    (DRAWN, {**HOTA, "where": {"state": "bad"}}, "require[0].where.state: is drawn for each traffic seed"),
    ({}, {**HOTA, "in": 99}, "require[0].in: needs a share between 0 and 1, as in 0.99 (got 99)"),
    ({}, {**HOTA, "in": 1}, "no number of runs shows that every seed is right"),
    ({}, {**HOTA, "confidence": 95}, "require[0].confidence: needs a probability of 0.5 or more and below 1"),
    # Parts that no run has, and scores that are not known of a part.
    ({}, {**RECALL, "where": {"visible_fraction": "half"}},
     "visible_fraction: there is no 'half' (known: 1, 0.75 to 1, 0.5 to 0.75, 0.25 to 0.5, below 0.25)"),
    ({}, {**RECALL, "where": {"range": 7}}, "range: there is no 7 (known: 0 to 100, 100 to 200, 200 to 400, 400 to"),
    (TWO_CAMERAS, {**HOTA, "where": {"camera": "bow"}}, "camera: there is no 'bow' (known: "),
    ({}, {**HOTA, "where": {"camera": "quay"}}, "the scene of condition 0 has no other camera: leave it out"),
    ({}, {**RECALL, "where": {"range": "0 to 100", "size": "0 to 16"}},
     "where: range and size each divide the runs, and only one may: leave all but one out"),
    ({}, RECALL, "score: recall is known of parts of the runs only: `where` needs one of visible_fraction, occlusion"),
    ({}, {**SURVIVED, "where": {"size": "0 to 16"}}, "occlusions_survived is not known by size (known: recall)"),
    (TWO_CAMERAS, {**RECALL, "where": {"camera": "C1"}}, "recall is not known by camera (known: hota, deta, assa"),
    ({}, {**HOTA, "where": {"occlusion": "3 to 10"}}, "hota is not known by occlusion (known: recall, occlusions_surv"),
    # Differences that name no two trackers.
    (OLD_AND_NEW, {**NO_WORSE, "minus": None}, "require[0]: a difference needs both of and minus"),
    (OLD_AND_NEW, {**NO_WORSE, "of": "newest"}, "of: there is no tracker 'newest' (did you mean 'new'?)"),
    (OLD_AND_NEW, {**NO_WORSE, "minus": "ancient"}, "minus: there is no tracker 'ancient' (known: old, new)"),
    (OLD_AND_NEW, {**NO_WORSE, "minus": "new"}, "require[0]: of and minus are both 'new'"),
    (OLD_AND_NEW, {**NO_WORSE, "where": {"tracker": "new"}}, "require[0]: a difference names its trackers with of and"),
])  # fmt: skip
def test_a_requirement_that_cannot_be_judged_is_one_problem(keys, requirement, said, tmp_path):
    (problem,) = problems_of(tmp_path, **{**KEYS, **keys}, require=[requirement])
    assert said in problem


def test_a_family_has_one_confidence(tmp_path):
    (said,) = problems_of(tmp_path, **KEYS, level="family", require=[HOTA, {**HOTA, "confidence": 0.9}])
    assert said == "level: family has one confidence for all requirements, and these have 0.9 and 0.95"


def test_a_share_of_a_score_without_bounds_can_be_judged_sequentially_and_a_bin_may_be_called_by_a_number(tmp_path):
    whole = {**RECALL, "where": {"visible_fraction": 1}}  # the bin is called "1", and YAML reads a number
    campaign = checked_campaign(tmp_path, **KEYS, require=[{**GOSPA, "in": 0.9}, whole], stop="sequential")
    assert [each.share for each in campaign.plan.keys.require] == [0.9, 0.5]
