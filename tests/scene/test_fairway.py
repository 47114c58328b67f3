"""The shipped scene with drawn traffic: a sample of `script/campaign traffic`, and what is wrong is found."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from benchmarks.campaigns.traffic import RateTest, rates_of, verdict
from benchmarks.traffic_measures import Drawn, measure
from modsim3d.cli.run_summary import traffic_in_words
from modsim3d.core.arrays import Array
from modsim3d.scene.reading import draws_traffic, load_scene, shipped_scenes
from modsim3d.world.encounters import hull_tracks

CAMPAIGN = Path(__file__).parents[2] / "docs" / "campaigns" / "traffic.json"
Change = Callable[[Array, Array], ArrayLike]


@pytest.fixture(scope="module")
def drawn() -> Drawn:
    return Drawn.of_seed("fairway", 1)


def test_traffic_of_two_seeds_is_as_asked_and_differs(drawn: Drawn) -> None:
    rows = [measure(drawn, 1), measure(Drawn.of_seed("fairway", 2), 2)]
    assert verdict(rows, rates_of(rows, drawn.scene, drawn.keys)) == []
    assert len(drawn.craft) > 10
    assert {craft.asked.kind for craft in drawn.craft if craft.asked} > {"head_on", "overtaking", "overtaken"}
    assert {vessel.label for vessel in drawn.scene.vessels} == {"boat", "sailboat", "ship"}


def to_port(own: Array, _: Array) -> Array:
    ahead = own[1] - own[0]
    return own + 250 * np.array([-ahead[1], ahead[0]]) / np.hypot(*ahead)


@pytest.mark.parametrize(
    ("section", "change", "said"),
    [
        ("leisure", lambda own, first: np.add(first, (0.0, 5.0)), "hulls come to 0.00 m"),
        ("leisure", lambda own, first: [602.0, -408.0], "a hull comes to 0.00 m of land"),
        ("leisure", lambda own, first: np.add(own, (0.0, 1500.0)), "is outside her area at"),
        ("lanes", lambda own, first: own[0] + 3 * (own - own[0]), "m/s, asked for"),
        ("lanes.fairway", to_port, "to starboard of the middle of her lane"),
        ("encounters.head_on", lambda own, first: np.add(own, (0.0, 2.0)), "head_on: "),
    ],
)
def test_a_vessel_that_is_not_as_asked_is_found(drawn: Drawn, section: str, change: Change, said: str) -> None:
    """A vessel of a section that is there at the first step, from its own track and that of the first vessel."""
    there = np.isfinite(drawn.tracks.headings_rad[0])
    columns = (drawn.column(craft) for craft in drawn.craft if section in craft.section)
    column, centres = next(filter(there.__getitem__, columns)), drawn.tracks.centres_m.copy()
    centres[:, column] = change(centres[:, column], centres[:, 0])
    faults = measure(replace(drawn, tracks=replace(drawn.tracks, centres_m=centres)), 1)["faults"]
    assert any(said in fault for fault in faults), faults


def test_rates_that_are_not_as_asked_are_found() -> None:
    """The committed rows as they are, and without half of what enters the fairway."""
    scene = Drawn.of_seed("fairway", 0)
    rows: list[dict[str, Any]] = json.loads(CAMPAIGN.read_bytes())["seeds"]
    assert verdict(rows, rates_of(rows, scene.scene, scene.keys)) == [] and len(rows) == 200
    assert rows[0]["vessels"] == len(scene.scene.vessels), "run script/campaign traffic again: the traffic has changed"
    for row in rows:
        row["lanes"]["fairway"]["entering"] //= 2
    assert any("lanes.fairway: enter" in said for said in verdict(rows, rates_of(rows, scene.scene, scene.keys)))
    assert verdict([rows[0], rows[0]], []) == ["two seeds have the same traffic"]


def test_two_sided_tests_are_exact() -> None:
    binomial = [RateTest.binomial("x", count, 10, 0.5).p_value for count in (0, 10)]
    assert [*binomial, RateTest.poisson("x", 0, 3.0).p_value] == pytest.approx([2 / 1024] * 2 + [2 * np.exp(-3)])
    assert RateTest.poisson("x", 3, 3.0).p_value == pytest.approx(1.0, abs=0.2)


def test_a_shorter_run_shows_the_beginning_of_the_same_traffic(drawn: Drawn) -> None:
    short = load_scene("fairway", seed=1, steps=40)
    one, other = ([(v.name, v.label, v.length_m) for v in scene.vessels] for scene in (short, drawn.scene))
    assert one == other
    np.testing.assert_array_equal(hull_tracks(short.vessels, short.poses, 40).centres_m, drawn.tracks.centres_m[:40])


def test_only_scenes_whose_traffic_is_drawn_say_so() -> None:
    drawn = {name for name, path in shipped_scenes().items() if draws_traffic(path)}
    assert drawn == {"simulation_1", "fairway", "small_target"}
    assert traffic_in_words(load_scene("fairway", seed=7, steps=2)).startswith("drawn from seed 7;")
    assert traffic_in_words(load_scene("strait")).startswith("this traffic only;")
