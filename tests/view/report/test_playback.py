"""Playing a run by one clock, from where the user goes, and its moments from one to the next."""

import pytest

from tests.view.report.conftest import STEPS

FRAMES = """new Promise((done) => {{
    let left = {};
    const next = () => (left-- ? requestAnimationFrame(next) : done());
    next();
}})"""
COARSE_AXIS = """(() => {
    const { timeline } = player, { recording } = timeline, { facts } = recording, places = [];
    facts.times = facts.times.filter((_, i) => i % 26 === 0);
    recording.length = timeline.to = facts.times.length;
    timeline.text = (context, text, x) => places.push([parseFloat(text), x + context.measureText(text).width / 2]);
    timeline.axis(timeline.still.getContext('2d'));
    return places;
})()"""


def test_one_clock_plays_from_where_the_user_goes_and_stops_at_the_end(browser, page):
    browser.open(page, hash="#step=150")
    browser.run("(player.playback.setSpeed(1), player.play(true))")
    for step in (20, 200):
        browser.run(f"(player.go({step}), {FRAMES.format(5)})")
        assert step <= browser.run("player.index") <= step + 5
    assert browser.run("player.playing")
    browser.run(
        "(() => { player.play(false); const { playback } = player, { tick } = playback; window.ticks = 0;"
        " playback.tick = (now) => { window.ticks++; tick.call(playback, now); }; player.play(true); })()"
    )
    for key in "[][][  ":
        browser.press(key)
    count = f"(window.ticks = 0, {FRAMES.format(10)}.then(() => window.ticks))"
    assert 8 <= browser.run(count) <= 12  # however often the speed has changed
    assert browser.after(" ", count) == 0
    browser.run(f"(player.playback.setSpeed(50), player.go({STEPS - 40}))")
    assert browser.after(" ", "player.playing")
    browser.run("new Promise(done => { const look = () => player.playing ? setTimeout(look, 20) : done(1); look(); })")
    assert browser.run("player.index") == STEPS - 1


def test_the_axis_has_its_times_evenly_where_steps_are_far_apart(browser, page):
    browser.open(page)
    inner = browser.run(COARSE_AXIS)[1:-1]
    apart = [(x - inner[0][1]) / (time - inner[0][0]) for time, x in inner[1:]]
    assert len(apart) > 2 and max(apart) - min(apart) < 0.05 * apart[0]


KEYS = {"missed": "m", "false": "f", "mislabelled": "l", "bad": "i", "off": "w", "hidden": "o", "state": "s"}


def test_each_kind_has_a_key_that_goes_to_the_next_and_with_shift_to_the_one_before(browser, page, mistaken_page):
    browser.open(mistaken_page)
    for kind, key in KEYS.items():
        browser.run("player.go(0)")
        places = browser.run(f"player.moments.of(0, '{kind}').map(({{ index }}) => index)")
        later = [index for index in places if index > 0]
        assert browser.after(key, "[player.index, document.querySelector('#kind').value]") == [later[0], kind]
        if len(later) == 1:
            browser.press(key)
            assert "This is the last" in browser.text("#note")
        else:
            assert browser.after(key, "player.index") == later[1], kind
            browser.press(key, shift=True)
        assert browser.run("player.index") == later[0], kind
    browser.run("player.go(0)")
    name = "document.querySelector('[data-do=next]').getAttribute('aria-label')"
    said, index = browser.after("o", f"[{name}, player.index]")
    browser.click("[data-do=next]")
    assert said == "Next onset of an occlusion" and browser.run("player.index") > index
    browser.open(page)  # its detector has one class
    index = browser.run("player.index")
    assert browser.after("l", "player.index") == index and browser.text("#note") == "C1 has no wrong class (label)"


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
    whole = {"first": 0, "last": len(times) - 1}
    assert browser.run("[player.loop.marked, player.loop.stretch]") == [None, whole]
