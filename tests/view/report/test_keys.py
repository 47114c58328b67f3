"""Keys of a run's page: the list of them, and what it says, which the document repeats."""

from pathlib import Path

DOCUMENT = Path(__file__).parents[3] / "docs" / "report.md"
LISTED = """[...document.querySelectorAll('#keys dl div')].map(row =>
    [row.querySelector('dt').textContent.trim(), row.querySelector('dd').textContent])"""


def escape(browser):
    """Press Escape as the browser itself sees it; it closes a dialog."""
    for kind in ("rawKeyDown", "keyUp"):
        browser.call("Input.dispatchKeyEvent", type=kind, key="Escape", code="Escape", windowsVirtualKeyCode=27)


def documented() -> list[list[str]]:
    lines = DOCUMENT.read_text(encoding="utf-8").partition("## Keys")[2].partition("\n## ")[0].splitlines()
    rows = [line for line in lines if line.startswith("| ") and not line.startswith(("| Key", "|---"))]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows]


def test_the_list_of_keys_is_that_of_the_document_takes_the_focus_and_gives_it_back(browser, page):
    browser.open(page, hash="#step=50")
    listed = browser.run(LISTED)
    (of_tracks,) = [row for row in documented() if row[0] == "K"]
    assert [row for row in documented() if row != of_tracks] == listed
    browser.run("document.querySelector('#slider').focus()")
    browser.press("?")
    assert browser.run("document.querySelector('dialog').matches(':modal')")
    assert browser.run("document.querySelector('dialog').contains(document.activeElement)")
    browser.press("ArrowRight")  # belongs to the dialog now
    assert browser.run("player.index") == 50
    escape(browser)
    assert not browser.run("document.querySelector('dialog').open")
    assert browser.run("document.activeElement.id") == "slider"
    browser.click("[data-do=keys]")
    assert browser.run("document.querySelector('dialog').open")
    browser.press("?")
    assert not browser.run("document.querySelector('dialog').open")
    browser.run("document.querySelector('#find').focus()")
    browser.press("n")  # a letter of the search
    assert browser.run("[player.index, document.querySelector('#find').value]") == [50, "n"]
