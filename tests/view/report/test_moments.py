"""Moments of a run's page: from one to the next, and again and again."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from modsim3d.view.report.overview import Overview, ShownRows
from modsim3d.view.report.part_columns import in_250ths

KEYS = {"missed": "m", "false": "f", "mislabelled": "l", "bad": "i", "off": "w", "hidden": "o", "state": "s"}


def test_each_kind_has_a_key_that_goes_to_the_next_and_with_shift_to_the_one_before(browser, mistaken_page):
    browser.open(mistaken_page)
    for kind, key in KEYS.items():
        browser.run("player.go(0)")
        places = browser.run(f"player.moments.of(0, '{kind}').map(({{ index }}) => index)")
        later = [index for index in places if index > 0]
        browser.press(key)
        assert browser.run("[player.index, document.querySelector('#kind').value]") == [later[0], kind]
        if len(later) == 1:
            browser.press(key)
            assert "This is the last" in browser.run("document.querySelector('#note').textContent")
        else:
            browser.press(key)
            assert browser.run("player.index") == later[1], kind
            browser.press(key, shift=True)
        assert browser.run("player.index") == later[0], kind


def test_buttons_are_named_after_the_kind_that_is_chosen(browser, mistaken_page):
    browser.open(mistaken_page)
    browser.press("o")
    name = "document.querySelector('[data-do=next]').getAttribute('aria-label')"
    assert browser.run(name) == "Next onset of an occlusion"
    index = browser.run("player.index")
    browser.click("[data-do=next]")
    assert browser.run("player.index") > index


def test_a_kind_that_the_camera_has_none_of_is_said_to_be_missing(browser, page):
    browser.open(page)  # its detector has one class
    index = browser.run("player.index")
    browser.press("l")
    assert browser.run("player.index") == index
    assert browser.run("document.querySelector('#note').textContent") == "C1 has no wrong class (label)"


@pytest.mark.parametrize(
    ("seen", "expected"),
    [
        ([1, 0.99, 1, 0.99, 0.95, 1], []),
        ([1, 0.95, 0.89, 0.95, 0.88, 0.97, 0.99, 0.5], [(2, 5), (7, 7)]),
        ([0.3, 0, 0.3, None, 0.3], [(0, 2), (4, 4)]),  # out of the image in between
    ],
)
def test_flicker_is_no_onset_of_an_occlusion(seen, expected):
    found = Overview(len(seen), 2, 1)
    for part in (slice(0, 3), slice(3, None)):  # moments go on from part to part
        shown = {index: each for index, each in list(enumerate(seen))[part] if each is not None}
        found.add(shown_rows(list(shown), in_250ths(np.array(list(shown.values()), dtype=float))))
    onsets = found.stretches("hidden")
    assert list(zip(onsets.first.tolist(), onsets.until.tolist(), strict=True)) == expected
    assert set(onsets.key.tolist()) <= {1}


def shown_rows(index: list[int], fraction: NDArray[np.uint8]) -> ShownRows:
    """One camera that sees vessel 1 at some steps and detects nothing."""
    count, none = len(index), np.empty(0, dtype=np.int64)
    at = np.array(index, dtype=np.int64)
    return ShownRows(
        index=at,
        state=np.zeros(count, dtype=np.int64),
        truth_index=at,
        vessel=np.ones(count, dtype=np.int64),
        annotated=np.ones(count, dtype=bool),
        missed=np.zeros(count, dtype=bool),
        fraction=fraction.astype(np.int64),
        rows=np.zeros((count, 2), dtype=np.int64),
        drawn_index=none,
        drawn_vessel=none,
        outcome=none.astype(np.uint8),
    )


def test_the_chosen_moment_plays_again_and_again_with_two_seconds_on_both_sides(browser, mistaken_page):
    browser.open(mistaken_page)
    browser.press("m")
    browser.run(  # one that ends long before the run does
        "(moments => player.goTo(moments.choose("
        "moments.list.findIndex(({ index, until }) => index > 20 && until < 100))))(player.moments)"
    )
    browser.run("player.setSpeed(50)")
    browser.press("r")
    first, last = browser.run("[player.loop.marked.first, player.loop.marked.last]")
    times, moment = browser.run("[Array.from(player.recording.facts.times), player.moments.list[player.moments.place]]")
    assert times[first] == pytest.approx(times[moment["index"]] - 2)
    assert times[last] == pytest.approx(times[moment["until"]] + 2)
    seen = browser.run(
        "new Promise(done => { const seen = [player.index]; player.play(true); const look = () => {"
        " if (seen.at(-1) !== player.index) seen.push(player.index);"
        " if (seen.at(-1) < seen.at(-2)) done(seen); else requestAnimationFrame(look); }; look(); })"
    )
    assert browser.run("player.playing")
    assert seen[-2] == last
    assert seen[-1] == first
    browser.run("(player.play(false), player.go(0))")  # outside: the whole run repeats
    assert browser.run("player.loop.marked") is None
    assert browser.run("player.loop.stretch") == {"first": 0, "last": len(times) - 1}
