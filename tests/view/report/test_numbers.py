"""The list of vessels of a run's page, and the tables of all numbers of the chosen frame."""

import math

import pyarrow.compute as pc
import pyarrow.parquet as pq

STEP = 90
ROWS = "[...document.querySelectorAll('#{} tr')].map(row => [...row.cells].map(cell => cell.textContent))"
LEFT_OUT = {"camera", "step", "timestamp"}  # above the table
BOX = {f"{which}_{side}_px" for which in ("full", "visible") for side in ("x_min", "y_min", "x_max", "y_max")}
TENTHS = {*BOX, "silhouette_px", "visible_px", "depth_m"}
DIGITS = {**dict.fromkeys(TENTHS, 1), "visible_fraction": 4, "in_frame_fraction": 4}


def open_numbers(browser):
    """Press the key and wait until the tables are filled: a browser tells later that a part was browser."""
    browser.press("d")
    filled = "player.numbers.detections ? done(1) : setTimeout(look, 5)"
    browser.run(f"new Promise(done => {{ const look = () => {filled}; look(); }})")


def test_the_table_has_every_column_of_the_truth_and_is_copied_as_cells(browser, mistaken_page, mistaken_folder):
    browser.open(mistaken_page, hash=f"#step={STEP}")
    open_numbers(browser)
    header, *rows = browser.run(ROWS.format("numbersTruth"))
    table = pq.read_table(mistaken_folder / "truth.parquet")
    truth = table.filter((pc.field("step") == STEP) & (pc.field("camera") == "bow")).to_pylist()
    assert set(header) == set(table.column_names) - LEFT_OUT
    assert any(len(row["occluded_by"]) > 1 for row in truth)
    expected = {row["vessel"]: row for row in truth}
    assert [row[0] for row in rows] == [row["vessel"] for row in sorted(truth, key=lambda row: row["depth_m"])]
    for cells in (dict(zip(header, row, strict=True)) for row in rows):
        row = expected[cells["vessel"]]
        for name, digits in DIGITS.items():
            value = row[name]
            assert (cells[name] == "") == (value is None), name
            if value is not None:
                assert math.isclose(float(cells[name]), value, abs_tol=0.51 * 10**-digits, rel_tol=1e-6), name
        assert all(cells[name] == str(row[name]).lower() for name in ("annotated", "detected"))
        assert cells["label"] == row["label"]
        said = dict(part.split(": ") for part in cells["occluded_by"].split(", ") if part)
        assert list(said) == [each["id"] for each in sorted(row["occluded_by"], key=lambda each: -each["px"])]
        for each in row["occluded_by"]:
            assert math.isclose(float(said[each["id"]]), each["px"], abs_tol=0.06, rel_tol=1e-6)
    browser.call("Browser.grantPermissions", permissions=["clipboardReadWrite", "clipboardSanitizedWrite"])
    browser.click("#numbersCopy")
    text = browser.run("new Promise(done => setTimeout(() => done(navigator.clipboard.readText()), 50))")
    of, copied, detections = text.rstrip("\n").split("\n\n")
    assert of == f"bow, {browser.run('player.recording.facts.timestamps[player.index]')} s, step {STEP}"
    assert [line.split("\t") for line in copied.split("\n")] == [header, *rows]
    assert [line.split("\t") for line in detections.split("\n")] == browser.run(ROWS.format("numbersDetections"))


def test_the_detections_have_a_table_that_follows_steps_but_not_play(browser, mistaken_page, mistaken_folder):
    browser.open(mistaken_page, hash=f"#step={STEP}")
    browser.click("#numbers summary")
    browser.run("new Promise(done => setTimeout(done, 50))")  # the browser opens it in its own time
    header, *rows = browser.run(ROWS.format("numbersDetections"))
    table = pq.read_table(mistaken_folder / "detections.parquet")
    found = table.filter((pc.field("step") == STEP) & (pc.field("camera") == "bow")).to_pylist()
    assert len(rows) == len(found) > 3
    for cells, row in zip((dict(zip(header, row, strict=True)) for row in rows), found, strict=True):
        for name in ("detection", "label", "kind", "vessel", "state"):
            assert cells[name] == ("" if row[name] is None else str(row[name]))
        assert math.isclose(float(cells["confidence"]), row["confidence"], abs_tol=5.1e-4)
        assert math.isclose(float(cells["x_max_px"]), row["x_max_px"], abs_tol=0.051)
        assert (cells["outcome"] == "false positive") == (row["kind"] not in ("true", "merged", "split"))
    assert f"step {STEP}" in browser.text("#numbersOf")
    browser.run("(player.playback.playing = true, player.go(20))")
    assert f"step {STEP}" in browser.text("#numbersOf")
    browser.run("player.play(false)")
    assert "step 20" in browser.text("#numbersOf")
    browser.open(mistaken_page, hash=f"#step={STEP}")
    browser.run("(player.playback.playing = true, 0)")  # without a clock
    open_numbers(browser)
    assert len(browser.run(ROWS.format("numbersDetections"))) > 3
    place = browser.run("player.numbers.detections.findLastIndex(each => each.false)")
    click = f"document.querySelector('#numbersDetections').tBodies[0].rows[{place}].click()"
    for step, alarm in ((20, None), (STEP, place)):  # first one of another frame
        browser.run(f"(player.go({step}), {click})")
        assert browser.run("player.alarm") == alarm
    assert place >= 0


LISTED = "[...document.querySelectorAll('#vessels tr')].map(row => row.querySelector('button').textContent)"
FIND = "(find => {{ find.value = '{}'; find.dispatchEvent(new Event('input')); }})(document.querySelector('#find'))"
HERE = "player.stage.frames[0].truths"
VESSELS = "player.recording.facts.vessels"


def test_the_list_has_the_order_and_the_vessels_that_are_asked_for_says_so_and_stays_in_play(browser, mistaken_page):
    browser.open(mistaken_page, hash="#step=100")
    scene = browser.run(LISTED)
    browser.click("[data-order=distance]")
    assert browser.text("th[aria-sort]") == "Distance"
    here = browser.run(f"{HERE}.toSorted((a, b) => a.depth - b.depth).map(({{ vessel }}) => {VESSELS}[vessel].name)")
    assert browser.run(LISTED)[: len(here)] == here and set(browser.run(LISTED)) == set(scene)
    browser.click("[data-order=distance]")
    assert browser.run("document.querySelector('th[aria-sort]').ariaSort") == "descending"
    assert browser.run(LISTED)[: len(here)] == here[::-1]  # who is not in the image stays at the end
    browser.click("[data-order=distance]")
    assert browser.run(LISTED) == scene and browser.run("document.querySelector('th[aria-sort]')") is None
    browser.click("[data-order=outcome]")
    assert browser.run(LISTED) == scene  # mistakes first, then who is in the image, also unasked
    ranks = browser.run(f"{LISTED}.map(name => {HERE}.find(({{ vessel }}) => {VESSELS}[vessel].name === name)?.missed)")
    missed = ranks.count(True)
    assert missed > 0 and ranks[:missed] == [True] * missed
    browser.run("player.go(0)")
    browser.choose("which", "missed")
    before = browser.run(LISTED)
    browser.run("(player.playback.playing = true, player.go(100))")  # as the clock does
    assert browser.run(LISTED) == before
    browser.run("player.play(false)")
    assert browser.run(LISTED) != before
    browser.choose("which", "all")
    for which, test in (("here", "true"), ("missed", "missed")):
        browser.choose("which", which)
        expected = browser.run(f"{HERE}.filter(({{ missed }}) => {test}).map(({{ vessel }}) => {VESSELS}[vessel].name)")
        assert sorted(browser.run(LISTED)) == sorted(expected)
    browser.choose("which", "all")
    every = browser.run(LISTED)
    browser.run(FIND.format("BOAT"))
    assert 0 < len(browser.run(LISTED)) < len(every)
    labels = browser.run(f"Object.fromEntries({VESSELS}.map(({{ name, label }}) => [name, label]))")
    assert browser.run(LISTED) == [name for name in every if "boat" in f"{name} {labels[name]}"]
    assert browser.text("#listed") == f"{len(browser.run(LISTED))} of {len(every)}"
