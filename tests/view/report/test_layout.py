"""The run's page on a desk, a tablet and a phone, light and dark, and for those who use no mouse or do not see it."""

import json
import re
from collections import defaultdict
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from modsim3d import load_scene, open_run, run_scene
from modsim3d.view import palette
from modsim3d.view.report.report import write_report
from tests.scenes import write_scene
from tests.view.report.browser import grave_violations
from tests.view.test_page_parts import CVD, contrast

DESK, TABLET, PHONE = (1440, 1000), (1024, 768), (390, 844)
MEASURE = Path(__file__).with_name("layout.js").read_text(encoding="utf-8")
PLAYER = files("modsim3d.view.report") / "player"
BOATS = 50
ONE_MISS = """(context => {
    const column = {x: 0, seen: 1000, sum: 1000, missed: 1, bad: 0, off: 0, mislabelled: 0};
    paintStrip(context, [column], 1, 0, '#e69f00', false);
    const opacity = [...context.getImageData(0, 0, 1, 20).data].filter((_, k) => k % 4 === 3);
    return [opacity, SEEN_PX + STRIP_GAP_PX + MARK_ROW_PX];
})(document.createElement('canvas').getContext('2d'))"""
CUT_OFF = """[...document.querySelectorAll('{} button')].filter((each) => each.scrollWidth > each.clientWidth)
    .map((each) => each.textContent)"""


@pytest.fixture(scope="module")
def crowd_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fifty boats in rows, some with long names, for a few steps."""
    folder, boats = tmp_path_factory.mktemp("crowd"), {}
    for k in range(BOATS):
        way = [[t, 60 + 40 * (k // 8), 8 * (k % 8) - 28 + t / 9] for t in (0, 9)]
        boats[f"boat_{k}" + "_of_the_long_name" * (k % 7 == 0)] = ([10.0, 4.0, 3.0], way)
    run_scene(load_scene(str(write_scene(folder, boats, steps=8)), source="analytic"), folder / "run")
    return write_report(open_run(folder / "run"))


def test_every_colour_of_texts_stands_out_from_every_surface() -> None:
    found = dict(re.findall(r"--(\w+): light-dark\((.*?)\)", (PLAYER / "base.css").read_text(encoding="utf-8")))
    colours = {name: [bytes.fromhex(each[1:]) for each in pair.split(", ")] for name, pair in found.items()}
    for text in ("ink", "soft", "accent", "alarm"):
        for surface in ("paper", "card", "track"):
            for ink, behind in zip(colours[text], colours[surface], strict=True):
                assert contrast([*ink], [*behind]) >= 4.5, (text, surface)


def measured(browser, what):
    return list(browser.run(f"(() => {{ {MEASURE}; return layout.{what}(); }})()"))


def pale_texts(browser):
    texts = measured(browser, "texts")
    assert texts
    return [(text, found) for text, ink, behind in texts if (found := contrast(ink, behind)) < 4.5]


def player_value(browser, expression):
    """The value of an expression in which functions and constants of the player's script are known."""
    scripts = "\n".join((PLAYER / name).read_text(encoding="utf-8") for name in ("colours.js", "strips.js"))
    return browser.run(f"(() => {{ {scripts}; return {expression}; }})()")


@pytest.mark.parametrize("which", ["page", "crowd_page"])
def test_at_each_size_nothing_overlaps_or_sticks_out_and_focus_shows_whole(browser, which, request, tmp_path):
    browser.open(request.getfixturevalue(which), DESK)
    for size in (DESK, TABLET, PHONE):
        browser.resize(size)
        browser.settle()
        for scheme in ("light", "dark"):
            browser.scheme(scheme)
            browser.settle()
            browser.run("scrollTo(0, 0)")  # where the focus was may be anywhere
            browser.screenshot(tmp_path / "page.png")
            with Image.open(tmp_path / "page.png") as image:
                assert image.size == size
                brightness = np.median(np.asarray(image.convert("L"))[:40])
            assert brightness > 200 if scheme == "light" else brightness < 60
        browser.scheme("light")
        assert measured(browser, "overlaps") == measured(browser, "outside") == measured(browser, "badRings") == []
        assert browser.run("document.documentElement.scrollWidth") <= size[0]
        assert browser.run(CUT_OFF.format(".vessels thead")) == [], size
        assert all("long" in name for name in browser.run(CUT_OFF.format("#vessels"))), size


@pytest.mark.parametrize("size", [DESK, PHONE])
def test_what_matters_is_seen_at_once_and_the_hint_inside_the_window_beside_the_pointer(browser, page, size):
    browser.open(page, size)
    if size == DESK:
        for name in ("#picture", "#closeup", "#play", "#moment", "#status", "#layers label:last-child"):
            place = browser.run(f"(() => {{ {MEASURE}; return layout.seen({json.dumps(name)}); }})()")
            assert 0 <= place["top"] < place["bottom"] <= DESK[1], name
        assert browser.run("player.timeline.canvas.getBoundingClientRect().top") + 60 < DESK[1]
    corners = "(({ left, top, right, bottom }) => [left, top, right, bottom])"
    for block, down in (("end", 0.97), ("start", 0.03)):
        browser.run(f"(player.timeline.canvas.scrollIntoView({{block: '{block}', behavior: 'instant'}}), 0)")
        x0, y0, x1, y1 = browser.run(f"{corners}(player.timeline.canvas.getBoundingClientRect())")
        for across in (0.01, 0.5, 0.995):
            x, y = x0 + across * (x1 - x0), y0 + down * (y1 - y0)
            browser.mouse("mouseMoved", x, y)
            hint = f"{corners}(document.querySelector('#hint:not([hidden])').getBoundingClientRect())"
            left, top, right, bottom = browser.run(hint)
            assert left >= 0 and top >= 0 and right <= size[0] and bottom <= size[1]
            assert not (left < x < right and top < y < bottom)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_texts_and_graphics_stand_out_and_what_went_wrong_has_rows_of_its_own(browser, page, mistaken_page, scheme):
    browser.scheme(scheme)
    browser.open(page, DESK)
    opacity, bottom = player_value(browser, ONE_MISS)
    assert opacity[bottom - 2 : bottom + 1] == [255, 255, 0]  # one miss among a thousand frames
    assert pale_texts(browser) == []
    for names in (("alarm", "paper"), ("alarm", "track"), ("edge", "paper"), ("edge", "card"), ("accent", "paper")):
        mark, behind = (player_value(browser, f"colourOf('--{name}')") for name in names)
        assert all(contrast(mark, behind, sight) >= 3 for sight in (None, *CVD)), names
    for colour in (each for states in range(1, 7) for each in palette.state_colours(states)):  # under their names
        ink = player_value(browser, f"channels(distinctFrom('{palette.css(colour)}'))")
        assert contrast(ink, colour) >= 4.5
    browser.open(mistaken_page, DESK)
    rows, row, left = browser.run("(t => [t.vessels.map(v => t.topOf(v)), t.rowPx, t.left])(player.timeline)")
    seen_top, seen, marks = player_value(browser, "[seenTopOf(true), SEEN_PX, MARK_ROW_PX]")
    alarm = tuple(map(int, player_value(browser, "colourOf('--alarm')")[4:-1].split(",")))
    browser.run("player.go(player.recording.length - 1)")  # the playhead stands at the end
    picture = browser.pixels("timeline")[:, int(left) + 1 : -12]
    found = 0
    for top in (round(row) for row in rows):
        assert not picture[top + seen_top - 1].any() and not picture[top + seen_top + seen].any()  # gaps
        for part in (picture[top : top + seen_top - 1], picture[top + seen_top + seen + 1 :][:marks]):
            drawn = part[part[..., 3] > 0]
            assert (drawn == (*alarm, 255)).all()
            found += len(drawn)
    assert found and row == seen_top + seen + 1 + marks + player_value(browser, "ROW_GAP_PX")


def test_fifty_vessels_keep_their_names_and_the_rows_scroll_under_a_fixed_axis(browser, crowd_page):
    browser.open(crowd_page, DESK)
    vessels, row, whole, shown = browser.run(
        "(t => [t.vessels.length, t.rowPx, t.panel.scrollHeight, t.panel.clientHeight])(player.timeline)"
    )
    assert vessels == BOATS and row >= 14 and shown <= 500 < whole
    before = browser.pixels("timeline")
    browser.run(f"player.choose({vessels - 1})")
    browser.settle()
    after = browser.pixels("timeline")
    top, rows_top, rows = browser.run("(t => [t.topOf(t.followed), t.rowsTop, t.rowsPx])(player.timeline)")
    assert rows_top <= top <= rows_top + rows - row
    assert (after[int(rows_top + rows) :] == before[int(rows_top + rows) :]).all()  # the axis
    assert (after[: int(rows_top)] == before[: int(rows_top)]).all()
    assert (after[int(top) : int(top + row), 8:120, 3] > 128).sum() > 30  # the name
    browser.hover("#timeline", 0.5, (top + row / 2) / browser.run("player.timeline.height"))
    assert f"boat_{vessels - 1}" in browser.text("#hint")


BLANK = """(() => {
    const blank = (canvas) => {
        const { width, height } = canvas;
        const copy = new OffscreenCanvas(width, height).getContext('2d', {willReadFrequently: true});
        copy.drawImage(canvas, 0, 0);
        return new Set(new Uint32Array(copy.getImageData(0, 0, width, height).data.buffer)).size < 4;
    };
    return [...document.querySelectorAll('canvas')].filter((each) => each.checkVisibility() && each.clientHeight)
        .filter((each) => !each.width || blank(each)).map((each) => each.id || each.parentElement.id);
})()"""
CONTROLS = """[...document.querySelectorAll(
    '.player button, .player input:not([type=search]), .player select, .player summary')]
    .filter((each) => each.checkVisibility() && each.id !== 'save' && each.dataset.do !== 'keys')"""
USE = """((each) => {{
    if (each.matches('select')) {{
        each.selectedIndex = each.options.length - 1;
        each.dispatchEvent(new Event('change', {{bubbles: true}}));
    }} else if (each.matches('[type=range]')) {{
        each.value = (Number(each.min) + Number(each.max)) / 2;
        each.dispatchEvent(new Event('input', {{bubbles: true}}));
    }} else each.click();
    return each.id || each.dataset.do || each.title || each.textContent;
}})({}[{}])"""


@pytest.mark.parametrize("size", [DESK, PHONE])
def test_no_canvas_is_blank_after_any_control(browser, tracks_page, size):
    browser.open(tracks_page, size, hash=f"#step={BOATS}")
    for number in range(browser.run(f"{CONTROLS}.length")):
        used = browser.run(USE.format(CONTROLS, number))
        browser.settle()
        assert browser.run(f"player.waiting?.then(() => {BLANK}) ?? {BLANK}") == [], used


STOPS = """(() => { const { id, ariaLabel, textContent, tagName } = document.activeElement;
return tagName === 'BODY' ? '' : id || ariaLabel || textContent.trim(); })()"""


@pytest.mark.parametrize(("which", "scheme", "size"), [("page", "light", DESK), ("tracks_page", "dark", PHONE)])
def test_axe_finds_nothing_serious_on_the_page_of_a_run(browser, which, scheme, size, request):
    browser.scheme(scheme)
    browser.open(request.getfixturevalue(which), size)
    browser.run("(document.querySelectorAll('details').forEach(each => { each.open = true; }), 0)")
    assert grave_violations(browser) == []


def test_axe_finds_what_is_wrong(browser, tmp_path):
    """That none is found on sound pages means something."""
    page = tmp_path / "bad.html"
    page.write_text("<!doctype html><html lang=en><title>a</title><h1>a</h1><button></button>", encoding="utf-8")
    browser.visit(page, PHONE)
    assert [found for found in grave_violations(browser) if found.startswith("button-name")]


def stops(browser, most):
    """What the Tab key comes to, until it leaves the page."""
    found: list[str] = []
    browser.run("document.activeElement.blur()")
    while len(found) < most:
        browser.key("Tab", 9)
        found.append(str(browser.run(STOPS)))
        if not found[-1] or found[-1] in found[:-1]:
            return found[:-1]
    return found


def test_every_control_has_a_name_in_words(browser, tracks_page):
    browser.open(tracks_page, PHONE)
    names = defaultdict(list)
    for node in browser.call("Accessibility.getFullAXTree")["nodes"]:
        if not node["ignored"]:
            names[node["role"]["value"]].append(node.get("name", {}).get("value", ""))
    for role in ("button", "combobox", "slider", "checkbox", "image"):
        assert names[role] and all(any(letter.isalpha() for letter in name) for name in names[role]), role


DOCUMENT = Path(__file__).parents[3] / "docs" / "report.md"
LISTED = """[...document.querySelectorAll('#keys dl div')].map(row =>
    [row.querySelector('dt').textContent.trim(), row.querySelector('dd').textContent])"""


def documented() -> list[list[str]]:
    lines = DOCUMENT.read_text(encoding="utf-8").partition("## Keys")[2].partition("\n## ")[0].splitlines()
    rows = [line for line in lines if line.startswith("| ") and not line.startswith(("| Key", "|---"))]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]


def test_tab_comes_to_play_first_keys_move_what_has_the_focus_and_are_those_of_the_document(browser, page):
    browser.open(page, DESK)
    order, vessels = stops(browser, 60), browser.run("player.recording.facts.vessels.map(({ name }) => name)")
    assert order[:4] == ["theme", "play", "One step back", "One step on"]
    assert {"slider", "moment", "camera", "picture", "layer-labels", "timeline"} <= set(order)
    assert len([stop for stop in order if stop in vessels]) == 1 and not {"", "◐"} & set(order)
    assert order[-1] == "Table" or len(order) < 40
    index = browser.run("(document.querySelector('#vessels button').focus(), player.index)")
    browser.press("ArrowDown")
    followed = browser.after("ArrowDown", "[document.activeElement.textContent, player.index]")
    assert followed == [vessels[2], index] and browser.after(" ", "player.followed") == 2
    browser.open(page, hash="#step=50")
    before = browser.after("+", "(player.pane.canvas.focus(), player.picture.view)")
    browser.press("ArrowRight", shift=True)
    after, index = browser.run("[player.picture.view, player.index]")
    assert after["x"] == pytest.approx(before["x"] + 0.1 * before["width"]) and index == 50
    browser.press("ArrowRight")
    assert [browser.run("player.index"), browser.run("player.picture.view")] == [51, after]
    browser.run("player.timeline.canvas.focus()")  # there up and down choose a vessel
    vessels, names = browser.run("[player.timeline.vessels, player.recording.facts.vessels.map(({ name }) => name)]")
    for key, place in (("ArrowDown", 0), ("ArrowDown", 1), ("ArrowUp", 0)):
        assert browser.after(key, "player.followed") == vessels[place]
    browser.press("ArrowRight")
    said = browser.text("#hint:not([hidden])")
    assert "step 52:" in said and names[vessels[0]] in said
    attributes = "['role', 'aria-valuenow', 'aria-valuetext'].map(name => player.timeline.canvas.getAttribute(name))"
    assert browser.run(attributes) == ["slider", "52", said]
    assert browser.after("Escape", "document.querySelector('#hint').hidden")
    browser.open(page, hash="#step=50")
    (of_tracks,) = [row for row in documented() if row[0] == "K"]
    assert [row for row in documented() if row != of_tracks] == browser.run(LISTED)
    browser.run("(document.querySelector('#slider').focus(), window.keys = document.querySelector('dialog'), 0)")
    assert browser.after("?", "[keys.matches(':modal'), keys.contains(document.activeElement)]") == [True, True]
    assert browser.after("ArrowRight", "player.index") == 50  # belongs to the dialog now
    browser.key("Escape", 27)
    assert browser.run("[keys.open, document.activeElement.id]") == [False, "slider"]
    browser.click("[data-do=keys]")
    assert browser.run("keys.open") and not browser.after("?", "keys.open")
    browser.run("document.querySelector('#find').focus()")  # whose letters are those of the search
    assert browser.after("n", "[player.index, document.querySelector('#find').value]") == [50, "n"]
