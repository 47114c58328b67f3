"""Moments of a run's page: from one to the next, and again and again."""

import pytest

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
    browser.run("player.go(0)")
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
    said = "[player.index, document.querySelector('#note').textContent]"
    assert browser.run(said) == [index, "C1 has no wrong class (label)"]


def test_the_chosen_moment_plays_again_and_again_with_two_seconds_on_both_sides(browser, mistaken_page):
    browser.open(mistaken_page)
    browser.press("m")
    browser.run(  # one that ends long before the run does
        "(moments => player.momentRow.show(moments.choose("
        "moments.list.findIndex(({ index, until }) => index > 20 && until < 100))))(player.moments)"
    )
    browser.run("player.playback.setSpeed(50)")
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
    assert browser.run("player.playing") and seen[-2:] == [last, first]
    browser.run("(player.play(false), player.go(0))")  # outside: the whole run repeats
    assert browser.run("player.loop.marked") is None
    assert browser.run("player.loop.stretch") == {"first": 0, "last": len(times) - 1}
