"""Pages for those who use no mouse or do not see them: what axe-core finds, stops of the Tab key, keys."""

from collections import defaultdict
from pathlib import Path

import pytest

from tests.view.report.axe import grave_violations
from tests.view.report.test_layout import DESK, PHONE

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


def test_tab_comes_to_play_first_and_to_the_list_of_vessels_once(browser, page):
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


def test_every_control_has_a_name_in_words(browser, tracks_page):
    browser.open(tracks_page, PHONE)
    names = defaultdict(list)
    for node in browser.call("Accessibility.getFullAXTree")["nodes"]:
        if not node["ignored"]:
            names[node["role"]["value"]].append(node.get("name", {}).get("value", ""))
    for role in ("button", "combobox", "slider", "checkbox", "image"):
        assert names[role] and all(any(letter.isalpha() for letter in name) for name in names[role]), role


def test_keys_move_the_image_that_has_the_focus_and_step_otherwise(browser, page):
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


DOCUMENT = Path(__file__).parents[3] / "docs" / "report.md"
LISTED = """[...document.querySelectorAll('#keys dl div')].map(row =>
    [row.querySelector('dt').textContent.trim(), row.querySelector('dd').textContent])"""


def documented() -> list[list[str]]:
    lines = DOCUMENT.read_text(encoding="utf-8").partition("## Keys")[2].partition("\n## ")[0].splitlines()
    rows = [line for line in lines if line.startswith("| ") and not line.startswith(("| Key", "|---"))]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]


def test_the_list_of_keys_is_that_of_the_document_takes_the_focus_and_gives_it_back(browser, page):
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
