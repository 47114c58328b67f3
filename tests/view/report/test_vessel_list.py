"""The list of vessels of a run's page: found, filtered and sorted."""

import pytest

from tests.view.report.test_page_in_browser import choose

NAMES = "[...document.querySelectorAll('#vessels tr')].map(row => row.querySelector('button').textContent)"
FIND = "(find => {{ find.value = '{}'; find.dispatchEvent(new Event('input')); }})(document.querySelector('#find'))"
TRUTH = "player.stage.frames[0].truths"
VESSELS = "player.recording.facts.vessels"


@pytest.fixture
def opened(browser, mistaken_page):
    browser.open(mistaken_page, hash="#step=100")
    return browser


def test_the_list_is_sorted_by_what_is_asked_for_and_says_so_and_stays_while_the_run_plays(opened):
    scene = opened.run(NAMES)
    opened.click("[data-order=distance]")
    assert opened.run("document.querySelector('th[aria-sort]').textContent") == "Distance"
    here = opened.run(f"{TRUTH}.toSorted((a, b) => a.depth - b.depth).map(({{ vessel }}) => {VESSELS}[vessel].name)")
    assert opened.run(NAMES)[: len(here)] == here and set(opened.run(NAMES)) == set(scene)
    opened.click("[data-order=distance]")
    assert opened.run("document.querySelector('th[aria-sort]').ariaSort") == "descending"
    assert opened.run(NAMES)[: len(here)] == here[::-1]  # who is not in the image stays at the end
    opened.click("[data-order=distance]")
    assert opened.run(NAMES) == scene and opened.run("document.querySelector('th[aria-sort]')") is None
    opened.click("[data-order=outcome]")
    ranks = opened.run(f"{NAMES}.map(name => {TRUTH}.find(({{ vessel }}) => {VESSELS}[vessel].name === name)?.missed)")
    missed = ranks.count(True)
    assert missed > 0 and ranks[:missed] == [True] * missed
    opened.run("player.go(0)")
    choose(opened, "which", "missed")
    before = opened.run(NAMES)
    opened.run("(player.playback.playing = true, player.go(100))")  # as the clock does
    assert opened.run(NAMES) == before
    opened.run("player.play(false)")
    assert opened.run(NAMES) != before
    choose(opened, "which", "all")


def test_the_list_shows_only_what_is_asked_for(opened):
    for which, test in (("here", "true"), ("missed", "missed")):
        choose(opened, "which", which)
        expected = opened.run(f"{TRUTH}.filter(({{ missed }}) => {test}).map(({{ vessel }}) => {VESSELS}[vessel].name)")
        assert sorted(opened.run(NAMES)) == sorted(expected)
    choose(opened, "which", "all")
    every = opened.run(NAMES)
    opened.run(FIND.format("BOAT"))
    assert 0 < len(opened.run(NAMES)) < len(every)
    labels = opened.run(f"Object.fromEntries({VESSELS}.map(({{ name, label }}) => [name, label]))")
    assert opened.run(NAMES) == [name for name in every if "boat" in f"{name} {labels[name]}"]
    assert opened.run("document.querySelector('#listed').textContent") == f"{len(opened.run(NAMES))} of {len(every)}"
