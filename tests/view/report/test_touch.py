"""Mouse and fingers on the run's page: the page can be scrolled over the image, and the image does not get lost."""

import numpy as np
import pytest

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


def test_one_finger_scrolls_the_page_over_image_and_timeline_where_a_tap_or_a_way_sideways_seeks(phone):
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


def test_two_fingers_zoom_and_move_the_image_and_not_the_page(phone):
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


def test_the_wheel_scrolls_the_page_and_with_control_zooms_towards_the_mouse(browser, page):
    browser.open(page)
    browser.place("#picture")
    before, top = browser.run(f"[{VIEW}, scrollY]")
    browser.wheel("#picture", 100)
    look = f"const look = () => scrollY > {top} ? done(1) : requestAnimationFrame(look); look();"
    browser.run(f"new Promise(done => {{ {look} }})")
    assert browser.run(VIEW) == before
    assert "wheel zooms" in browser.text(".how:not([hidden])")
    browser.wheel("#picture", -400, control=True)
    after = browser.run(VIEW)
    assert after["width"] == pytest.approx(before["width"] / np.e, rel=1e-3)
    assert after["x"] + after["width"] / 2 == pytest.approx(before["x"] + before["width"] / 2, abs=after["width"] / 200)


def drag(browser, dx, dy):
    x, y = browser.place("#picture")
    browser.mouse("mouseMoved", x, y)
    browser.mouse("mousePressed", x, y, button="left", buttons=1, clickCount=1)
    browser.mouse("mouseMoved", x + dx, y + dy, button="left", buttons=1)
    browser.mouse("mouseReleased", x + dx, y + dy, button="left", clickCount=1)


def test_dragging_moves_the_image_and_neither_it_nor_zooming_loses_it(browser, page):
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
