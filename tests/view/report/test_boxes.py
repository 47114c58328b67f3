"""Boxes in the picture of a run's page: what the mouse is over, and what is chosen."""

import json

import numpy as np
import pytest

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
    """The first of them; its frame is shown."""
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


def test_a_press_on_a_false_alarm_shows_its_data_and_the_next_frame_forgets_it(opened):
    _, _, place, x, y = separate(opened, wrong=True)
    closeup = opened.pixels("closeup")
    opened.click(*over(opened, x, y))
    assert opened.run("[player.alarm, player.followed]") == [place, None]
    found = opened.run(f"player.stage.frames[0].detections[{place}]")
    said = opened.text("#chosen")
    assert "false" in said and f"{found['label']} {found['confidence']:.2f}" in said
    assert not np.array_equal(opened.pixels("closeup"), closeup)
    assert opened.after("ArrowRight", "player.alarm") is None


def test_the_smallest_box_under_the_mouse_is_meant_and_a_drag_chooses_nothing(opened):
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


def test_a_tap_chooses_the_vessel_and_says_what_it_is(opened):
    _, vessel, _, x, y = separate(opened, wrong=False)
    opened.fingers([opened.place(*over(opened, x, y))])
    look = "const look = () => player.followed === null ? setTimeout(look, 20) : done(); look();"
    opened.run(f"new Promise(done => {{ {look} }})")
    followed, name = opened.run(f"[player.followed, player.recording.facts.vessels[{vessel}].name]")
    assert followed == vessel and f" s: {name} (" in opened.text("#note")
    assert opened.run("document.querySelector('.tip').hidden")
