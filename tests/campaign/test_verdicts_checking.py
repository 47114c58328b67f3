"""Requirements that cannot be judged are refused before the first run."""

import pytest
import yaml

from modsim3d.campaign.file.reading import read_campaign
from modsim3d.campaign.work.checking import checked
from modsim3d.errors import InputError

GOSPA = {"score": "gospa", "at_most": 50}
HOTA = {"score": "hota", "at_least": 0.5}
DETECTORS = {"vary": [{"grid": {"detector": ["thesis", "conditions/foggy_clear"]}}]}


@pytest.mark.parametrize(
    ("keys", "requirement", "said"),
    [
        ({"stop": "sequential"}, GOSPA, "require[0]: with stop: sequential a mean needs"),
        ({}, {**GOSPA, "where": {"state": "bad"}}, "require[0].score: gospa is not known of a state"),
        (DETECTORS, {**HOTA, "where": {"state": "bad"}}, "the detector of condition 1 has no state 'bad'"),
    ],
)
def test_a_requirement_that_cannot_be_judged_is_refused(keys, requirement, said, tmp_path):
    file = tmp_path / "campaign.yaml"
    content = {"scene": "harbour", "steps": 20, "trackers": ["bytetrack"], "require": [requirement], **keys}
    file.write_text(yaml.safe_dump(content))
    with pytest.raises(InputError) as refused:
        checked(read_campaign(file))
    assert any(said in problem for problem in refused.value.problems), refused.value.problems


def test_a_share_of_a_score_without_bounds_can_be_judged_sequentially(tmp_path):
    file = tmp_path / "campaign.yaml"
    requirement = {"score": "gospa", "at_most": 50, "in": 0.9}
    content = {
        "scene": "harbour",
        "steps": 20,
        "trackers": ["bytetrack"],
        "require": [requirement],
        "stop": "sequential",
    }
    file.write_text(yaml.safe_dump(content))
    assert checked(read_campaign(file)).plan.keys.require[0].share == 0.9
