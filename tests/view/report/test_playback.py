"""Playing a run: by one clock, from where the user goes."""

from tests.view.report.conftest import STEPS

FRAMES = """new Promise((done) => {{
    let left = {};
    const next = () => (left-- ? requestAnimationFrame(next) : done());
    next();
}})"""
COARSE_AXIS = """(() => {
    const { timeline } = player, { recording } = timeline, { facts } = recording, places = [];
    facts.times = facts.times.filter((_, i) => i % 26 === 0);
    recording.length = facts.times.length;
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
    for key in "[][][ ":
        browser.press(key)
    browser.press(" ")
    count = f"(window.ticks = 0, {FRAMES.format(10)}.then(() => window.ticks))"
    assert 8 <= browser.run(count) <= 12  # however often the speed has changed
    browser.press(" ")
    assert browser.run(count) == 0
    browser.run(f"(player.playback.setSpeed(50), player.go({STEPS - 40}))")
    browser.press(" ")
    assert browser.run("player.playing")
    browser.run("new Promise(done => { const look = () => player.playing ? setTimeout(look, 20) : done(1); look(); })")
    assert browser.run("player.index") == STEPS - 1


def test_the_axis_has_its_times_evenly_where_steps_are_far_apart(browser, page):
    browser.open(page)
    inner = browser.run(COARSE_AXIS)[1:-1]
    apart = [(x - inner[0][1]) / (time - inner[0][0]) for time, x in inner[1:]]
    assert len(apart) > 2 and max(apart) - min(apart) < 0.05 * apart[0]
