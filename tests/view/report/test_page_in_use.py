"""The run's page in use: its clock and moments, its address, mouse and fingers on the image, boxes under them."""

import json

import numpy as np
import pytest
from PIL import Image

from tests.run_folders import wait_for
from tests.view.report.conftest import STEPS

CLOCK = """(() => {
    let now = 0, last = 0, asked = new Map();
    performance.now = () => now;
    window.requestAnimationFrame = (call) => (asked.set(++last, call), last);
    window.cancelAnimationFrame = (number) => asked.delete(number);
    window.pass = (frames, seconds) => Array.from({ length: frames }, () => {
        const calls = [...asked.values()];
        asked.clear();
        now += 1000 * seconds / frames;
        for (const call of calls) call(now);
        return calls.length;
    });
})()"""
"""Frames come when the test says so, and as far apart: `pass` returns how many calls each has brought."""
COARSE_AXIS = """(() => {
    const { timeline } = player, { recording } = timeline, { facts } = recording, places = [];
    facts.times = facts.times.filter((_, i) => i % 26 === 0);
    recording.length = timeline.to = facts.times.length;
    timeline.text = (context, text, x) => places.push([parseFloat(text), x + context.measureText(text).width / 2]);
    timeline.axis(timeline.still.getContext('2d'));
    return places;
})()"""


def test_one_clock_plays_to_the_end_and_the_axis_has_its_times_evenly(browser, page):
    browser.open(page, hash="#step=150")
    step_s = browser.run(f"({CLOCK}, player.playback.setSpeed(1), player.play(true), player.recording.facts.times[1])")
    for step in (20, 200):
        browser.run(f"(player.go({step}), pass(1, 0))")
        assert browser.run(f"(pass(11, {5.5 * step_s}), player.index)") == step + 5
    assert browser.run("player.playing")
    for key in "[][][  ":
        browser.press(key)
    assert browser.run("pass(10, 0.1)") == [1] * 10  # however often the speed has changed
    assert browser.after(" ", "pass(10, 0.1)") == [0] * 10
    browser.run(f"(player.playback.setSpeed(50), player.go({STEPS - 40}))")
    assert browser.after(" ", f"(pass(9, {38.5 / 50 * step_s}), [player.index, player.playing])") == [STEPS - 2, True]
    assert browser.run(f"(pass(2, {step_s / 50}), [player.index, player.playing])") == [STEPS - 1, False]
    browser.open(page)
    inner = browser.run(COARSE_AXIS)[1:-1]
    apart = [(x - inner[0][1]) / (time - inner[0][0]) for time, x in inner[1:]]
    assert len(apart) > 2 and max(apart) - min(apart) < 0.05 * apart[0]


KEYS = {"missed": "m", "false": "f", "mislabelled": "l", "bad": "i", "off": "w", "hidden": "o", "state": "s"}


def test_each_kind_has_a_key_and_the_chosen_moment_plays_again_and_again(browser, page, mistaken_page):
    browser.open(mistaken_page)
    for kind, key in KEYS.items():
        browser.run("player.go(0)")
        places = browser.run(f"player.moments.of(0, '{kind}').map(({{ index }}) => index)")
        later = [index for index in places if index > 0]
        assert browser.after(key, "[player.index, document.querySelector('#kind').value]") == [later[0], kind]
        if len(later) == 1:
            browser.press(key)
            assert "No later" in browser.text("#note")
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


SETTLED = "new Promise(done => setTimeout(() => done(decodeURIComponent(location.hash)), 300))"


def test_the_address_follows_what_is_shown_and_names_that_are_not_there_are_passed_over(browser, page):
    for hash in ("camera=nowhere&vessel=nobody&layers=ghosts&x=%", "&=&layers=constructor,toString"):
        browser.open(page, hash=f"#vessel=&step=50&{hash}")
        assert browser.run("document.querySelector('#failure').hidden && player.shown.detections")
        assert browser.run("[player.index, player.camera, player.followed]") == [50, 0, None]
    browser.open(page)
    assert browser.run(SETTLED) == ""  # until something is done, and while the run plays
    browser.run("(player.playback.setSpeed(0.25), player.go(5), player.play(true))")
    assert browser.run(SETTLED) == ""
    browser.run("player.play(false)")
    assert browser.run(SETTLED) == browser.run("`#step=${player.index}&camera=C1`")
    browser.run("(player.look(1), player.go(120), player.choose(2))")
    browser.press("8")
    browser.press("1")
    layers = "full,visible,detections,false,missed,labels,names"
    vessel = browser.run("player.recording.facts.vessels[2].name")
    address = f"#step=120&camera=C2&vessel={vessel}&layers={layers}"
    assert browser.run(SETTLED) == address
    browser.open(page, hash=address)
    shown = "Object.keys(player.shown).filter(name => player.shown[name]).join(',')"
    controls = "document.querySelector('#layer-silhouettes').checked, document.querySelector('#camera').value"
    state = f"[player.index, player.camera, player.followed, {shown}, {controls}]"
    assert browser.run(state) == [120, 1, 2, layers, False, "1"]
    browser.run("(location.hash = '#step=50&camera=C1', new Promise(done => setTimeout(done, 50)))")
    usual = "silhouettes,full,visible,detections,false,missed,labels"
    # What a link leaves out is as usual, also in an open page.
    assert browser.run(state) == [50, 0, None, usual, True, "0"]


def test_the_link_is_copied_or_offered_in_a_field_and_the_picture_is_saved_with_a_caption(browser, page, tmp_path):
    browser.call("Browser.grantPermissions", permissions=["clipboardReadWrite", "clipboardSanitizedWrite"])
    browser.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    browser.open(page, hash="#step=40")
    browser.press("ArrowRight")
    browser.click("[data-do=link]")
    said = "new Promise(done => setTimeout(() => done(document.querySelector('#note').textContent), 50))"
    assert browser.run(said) == "Link copied"
    assert browser.run("navigator.clipboard.readText()") == page.resolve().as_uri() + "#step=41&camera=C1"
    browser.run("(Object.defineProperty(navigator, 'clipboard', { value: undefined }), player.actions.link())")
    field = "(field => [field.value, field.selectionEnd - field.selectionStart])(document.activeElement)"
    link = browser.run("location.href")
    assert browser.run(field) == [link, len(link)]
    browser.click("[data-do=save]")
    wait_for((path := tmp_path / "simulation_3_C1_41.png").is_file)
    with Image.open(path) as image:
        saved = image.convert("L")
    wide, high = browser.run("[player.pane.canvas.width, player.pane.canvas.height]")
    assert saved.size == (wide, high + 30)
    assert 100 < sum(saved.crop((0, high, wide, high + 30)).histogram()[:100]) < 0.2 * 30 * wide  # text on paper


VIEW = "player.picture.view"


@pytest.fixture
def phone(browser, page):
    browser.call("Emulation.setTouchEmulationEnabled", enabled=True, maxTouchPoints=2)
    browser.open(page, (390, 844))
    browser.run("document.querySelector('#picture').scrollIntoView({block: 'center', behavior: 'instant'})")
    yield browser
    browser.call("Emulation.setTouchEmulationEnabled", enabled=False)


def within_reach(browser):
    """Whether the view's middle is in the image, and the view is no larger than the image nor smaller than a 20th."""
    values = f"(v => [v.x, v.y, v.width, player.picture.aspect, ...player.pane.size])({VIEW})"
    x, y, width, aspect, wide, high = browser.run(values)
    whole = max(wide, high * aspect)
    in_image = 0 <= x + width / 2 <= wide and 0 <= y + width / aspect / 2 <= high
    return bool(in_image and whole / 20 * 0.999 <= width <= whole * 1.001)


def test_one_finger_scrolls_taps_and_seeks_and_two_zoom_and_move_the_image(phone):
    for selector in ("#picture", "#timeline"):
        x, y = phone.place(selector)
        before, *same = phone.run(f"[scrollY, {VIEW}, player.index]")
        phone.fingers(*([(x, y - down)] for down in range(0, 201, 20)))
        phone.settle()
        scrolled, *now = phone.run(f"[scrollY, {VIEW}, player.index]")
        assert scrolled > before + 100 and now == same, selector
    x, y = phone.place("#timeline", 0.8, 0.1)
    at = "player.timeline.indexAt({} - player.timeline.canvas.getBoundingClientRect().left)"
    phone.fingers([(x, y)])
    assert phone.run("player.index") == phone.run(at.format(x))
    phone.fingers(*([(x - left, y)] for left in range(0, 61, 10)))
    assert phone.run("player.index") == phone.run(at.format(x - 60)) < phone.run(at.format(x))
    x, y = phone.place("#picture")
    before, scrolled = phone.run(f"[{VIEW}, scrollY]")
    phone.fingers(*([(x - apart, y), (x + apart, y)] for apart in range(30, 91, 10)))
    after = phone.run(VIEW)
    assert after["width"] == pytest.approx(before["width"] / 3, rel=0.02)
    assert after["x"] + after["width"] / 2 == pytest.approx(before["x"] + before["width"] / 2, rel=0.02)
    phone.fingers(*([(x - 40 + right, y - right), (x + 40 + right, y - right)] for right in range(0, 41, 8)))
    moved = phone.run(VIEW)
    assert moved["x"] == pytest.approx(after["x"] - 40 * after["width"] / phone.run("player.pane.canvas.clientWidth"))
    assert moved["width"] == pytest.approx(after["width"])
    assert phone.run("[scrollY, visualViewport.scale]") == [scrolled, 1]
    phone.fingers([(x, y)])
    phone.fingers([(x, y)])
    assert phone.run(VIEW) == before


def drag(browser, dx, dy):
    x, y = browser.place("#picture")
    browser.mouse("mouseMoved", x, y)
    browser.mouse("mousePressed", x, y, button="left", buttons=1, clickCount=1)
    browser.mouse("mouseMoved", x + dx, y + dy, button="left", buttons=1)
    browser.mouse("mouseReleased", x + dx, y + dy, button="left", clickCount=1)


def test_the_wheel_scrolls_or_zooms_and_neither_zooming_nor_dragging_loses_the_image(browser, page):
    browser.open(page)
    browser.place("#picture")
    before, top = browser.run(f"[{VIEW}, scrollY]")
    browser.wheel("#picture", 100)
    browser.until(f"scrollY > {top}")
    assert browser.run(VIEW) == before
    assert "wheel zooms" in browser.text(".how:not([hidden])")
    browser.wheel("#picture", -400, control=True)
    after = browser.run(VIEW)
    assert after["width"] == pytest.approx(before["width"] / np.e, rel=1e-3)
    assert after["x"] + after["width"] / 2 == pytest.approx(before["x"] + before["width"] / 2, abs=after["width"] / 200)
    browser.open(page)
    before = browser.after("+", VIEW)
    drag(browser, 50, 0)
    assert browser.run(f"{VIEW}.x") == pytest.approx(before["x"] - 50 / browser.run("player.picture.scale"))
    for dx, dy in ((600, 400), (-600, -400)):
        for _ in range(8):
            drag(browser, dx, dy)
            assert within_reach(browser)
    for key in ("+", "-"):
        for _ in range(20):
            browser.press(key)
        assert within_reach(browser)


SEPARATE = """(() => { // a detection that no other box touches, as [step, vessel, x, y of its middle on the canvas]
  for (let index = 0; index < player.recording.length; index++) {
    player.go(index);
    const [{ truths, detections }] = player.stage.frames;
    const boxes = [...truths, ...detections].map(each => [each.vessel, each.full ?? each.box]);
    for (const each of detections.filter(({ false: wrong }) => wrong === WRONG)) {
      const [x0, y0, x1, y1] = each.box;
      const free = boxes.every(([vessel, box]) => box === each.box || (vessel === each.vessel && vessel !== null)
        || box[2] < x0 || box[0] > x1 || box[3] < y0 || box[1] > y1);
      if (!free || !player.picture.shows(each.box)) continue;
      return [index, each.vessel, detections.indexOf(each), ...player.picture.toCanvas((x0 + x1) / 2, (y0 + y1) / 2)];
    }
  }
})()"""


def separate(browser, wrong):
    found = browser.run(SEPARATE.replace("WRONG", str(wrong).lower()))
    browser.run(f"player.go({found[0]})")
    return found


def assert_ring(browser, truth):
    """White on the left of a vessel."""
    x, y = browser.run(f"(({{ full: [x0, y0, x1, y1] }}) => player.picture.toCanvas(x0, (y0 + y1) / 2))({truth})")
    left = browser.pixels()[int(y), max(int(x) - 13, 0) : int(x) - 4, :3]
    assert (left.min(axis=1) > 240).any()


def over(browser, x, y):
    """A place of the picture as shares of it."""
    wide, high = browser.run("[player.pane.canvas.clientWidth, player.pane.canvas.clientHeight]")
    return "#picture", x / wide, y / high


@pytest.fixture
def opened(browser, mistaken_page):
    browser.open(mistaken_page)
    return browser


def test_a_box_under_the_mouse_is_described_and_a_press_chooses_its_vessel_everywhere_until_escape(opened):
    _, vessel, _, x, y = separate(opened, wrong=False)
    before = opened.pixels()
    opened.hover(*over(opened, x, y))
    tip = opened.run("document.querySelector('.tip').innerText")
    name, found, truth = opened.run(
        f"(frame => [player.recording.facts.vessels[{vessel}].name,"
        f" frame.detections.find(each => each.vessel === {vessel}),"
        f" frame.truths.find(each => each.vessel === {vessel})])(player.stage.frames[0])"
    )
    assert tip.startswith(name) and f"{truth['depth']:.0f} m" in tip
    assert f"{found['label']} {found['confidence']:.2f}" in tip
    a, b = np.array(found["box"]), np.array(truth["target"])
    shared = np.prod(np.maximum(np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]), 0))
    iou = shared / (np.prod(a[2:] - a[:2]) + np.prod(b[2:] - b[:2]) - shared)
    assert f"IoU {iou:.2f}" in tip
    corners = np.minimum(a[:2], b[:2]).tolist(), np.maximum(a[2:], b[2:]).tolist()
    (left, top), (right, bottom) = (opened.run(f"player.picture.toCanvas(...{corner})") for corner in corners)
    changed_rows, changed_columns = np.nonzero(np.any(opened.pixels() != before, axis=-1))
    near = np.abs(changed_columns - (left + right) / 2) < (right - left) / 2 + 200
    near &= np.abs(changed_rows - (top + bottom) / 2) < (bottom - top) / 2 + 90
    assert near.any() and not near.all()  # wider lines, and pale ones
    opened.hover("#slider", 0.5, 0.5)
    assert opened.run("document.querySelector('.tip').hidden") and np.array_equal(opened.pixels(), before)
    timeline = opened.pixels("timeline")
    opened.click(*over(opened, x, y))
    assert opened.run("player.followed") == vessel and name in opened.text("#vessels tr.followed")
    assert opened.text("#chosen").startswith(name)
    assert not np.array_equal(opened.pixels("timeline"), timeline)
    opened.hover("#slider", 0.5, 0.5)
    assert_ring(opened, f"player.stage.frames[0].truths.find(each => each.vessel === {vessel})")
    opened.key("Escape", 27)
    assert opened.run("player.followed") is None and np.array_equal(opened.pixels("timeline"), timeline)
    opened.run("player.go(30)")  # a vessel that is chosen on the timeline has the ring too
    row = opened.run(
        "player.timeline.vessels.findIndex(vessel => player.stage.frames[0].truths.some(each => "
        "each.vessel === vessel && player.picture.toCanvas(each.full[0], 0)[0] > 20))"
    )
    top, high, height = opened.run("(t => [t.rowsTop, t.rowPx, t.height])(player.timeline)")
    x, wide = opened.run("[player.timeline.x(30.5), player.timeline.canvas.clientWidth]")
    opened.click("#timeline", x / wide, (top + (row + 0.5) * high) / height)
    assert opened.run("player.index") == 30
    assert_ring(opened, "player.stage.frames[0].truths.find(each => each.vessel === player.followed)")


def test_a_tap_chooses_a_press_shows_a_false_alarm_the_smallest_box_is_meant_and_a_drag_chooses_nothing(opened):
    _, _, place, x, y = separate(opened, wrong=True)
    closeup = opened.pixels("closeup")
    opened.click(*over(opened, x, y))
    assert opened.run("[player.alarm, player.followed]") == [place, None]
    found = opened.run(f"player.stage.frames[0].detections[{place}]")
    said = opened.text("#chosen")
    assert "false" in said and f"{found['label']} {found['confidence']:.2f}" in said
    assert not np.array_equal(opened.pixels("closeup"), closeup)
    assert opened.after("ArrowRight", "player.alarm") is None
    _, vessel, _, x, y = separate(opened, wrong=False)
    opened.fingers([opened.place(*over(opened, x, y))])
    opened.until("player.followed !== null")
    followed, name = opened.run(f"[player.followed, player.recording.facts.vessels[{vessel}].name]")
    assert followed == vessel and f" s: {name} (" in opened.text("#note")
    assert opened.run("document.querySelector('.tip').hidden")
    boxes = ([0, 0, 90, 90], [10, 10, 40, 40], [20, 20, 80, 80])
    truths = [{"vessel": i, "visible": None, "full": boxes[i], "target": boxes[i]} for i in range(3)]
    truths = [{**truth, "fraction": 0, "depth": 9, "missed": False} for truth in truths]
    frame = json.dumps({"truths": truths, "detections": []})
    opened.run("player.picture.fit([0, 0, 100, 50])")
    hit = f"(({{ hover }}) => hover.find({frame}, player.shown)?.vessel ?? null)(player.pane)"
    move = "player.pane.hover.at = player.picture.toCanvas({0}, {0})"
    assert [opened.run(f"({move.format(x)}, {hit})") for x in (5, 30, 60, 95)] == [0, 1, 2, None]
    opened.run("(player.pane.hover.at = null, player.home(), player.choose(0))")
    x, y = opened.place("#picture", 0.5, 0.02)
    for kind, dx in (("mousePressed", 0), ("mouseMoved", 40), ("mouseReleased", 40)):
        opened.mouse(kind, x + dx, y, button="left", buttons=1, clickCount=1)
    assert opened.run("player.followed") == 0
