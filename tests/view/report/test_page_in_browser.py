"""The page of a run in a real browser: it plays, obeys mouse and keyboard, lists vessels and numbers."""

import json
import math
import re
from collections import defaultdict
from itertools import pairwise

import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest

from modsim3d import detect_run, load_scene, open_run, run_scene
from modsim3d.runs.counts import Outcome, frame_outcomes
from modsim3d.runs.frames import detected_rows
from modsim3d.view import palette
from modsim3d.view.films.request import parse_look
from modsim3d.view.report.overview import WHOLE
from modsim3d.view.report.part_columns import in_250ths
from modsim3d.view.report.report import write_report
from modsim3d.view.report.side_by_side import write_side_by_side
from tests.scenes import camera_keys, crossing, write_scene
from tests.view.report.conftest import STEPS

FAULTS = ("missed", "mislabelled", "bad", "off")
FLAGS = {"false": Outcome.FALSE_POSITIVE, "mislabelled": Outcome.MISLABELLED}
FLAGS |= {"bad": Outcome.BELOW_HALF_IOU, "off": Outcome.OFF_VESSEL}


@pytest.fixture(scope="module")
def crowded(run_folder):
    """A step at which the first camera sees a vessel hidden in part, a miss and a false positive."""
    for frame in (frame for frame in open_run(run_folder).frames() if frame.camera == "C1"):
        truth, kinds = frame.truth, set(frame.detections.kinds)
        hidden = (truth.visible_fraction > 0) & (truth.visible_fraction < 1)
        if hidden.any() and (truth.annotated & ~truth.detected).any() and {"true", "false_positive"} <= kinds:
            return frame.step
    raise AssertionError("no such step")


def test_page_asks_for_nothing_and_slider_timeline_and_layers_choose_what_is_shown(browser, page, crowded, run_folder):
    browser.open(page, hash=f"#step={crowded}")
    assert browser.run("[player.recording.length, document.querySelector('#failure').hidden]") == [STEPS, True]
    before = browser.pixels()
    slide = "slider.value = 20; slider.dispatchEvent(new Event('input'));"
    browser.run(f"(slider => {{ {slide} }})(document.querySelector('#slider'))")
    assert browser.run("player.index") == 20 and "step 20 of" in browser.text("#status")
    assert not np.array_equal(browser.pixels(), before)
    left, wide = browser.run("[player.timeline.left, player.timeline.wide]")
    across = (left + 0.75 * wide) / (left + wide)
    browser.hover("#timeline", across, 0.1)
    browser.click("#timeline", across, 0.1)
    index = browser.run("player.index")
    assert index == pytest.approx(0.75 * STEPS, abs=1) and f"step {index}:" in browser.text("#hint")
    top, row, height, vessels = browser.run("(t => [t.rowsTop, t.rowPx, t.height, t.vessels])(player.timeline)")
    browser.click("#timeline", 0.9, (top + 1.5 * row) / height)
    assert browser.run("player.followed") == vessels[1]
    assert [url.partition("#")[0] for url in browser.requests] == [page.resolve().as_uri()]
    browser.open(page, hash=f"#step={crowded}")
    browser.press("9")  # false positives may be far from any vessel
    everything, names = browser.pixels(), browser.run("Object.keys(player.shown)")
    assert names[:8] == ["silhouettes", "full", "visible", "detections", "false", "missed", "labels", "names"]
    for number, name in enumerate(names[:8], start=1):
        browser.click(f"#layer-{name}")
        assert not np.array_equal(browser.pixels(), everything), name
        browser.press(str(number))
        assert np.array_equal(browser.pixels(), everything), name
    rows = "player.recording[name](player.index, player.camera).length"
    # Detections twice: in the image and, by their bearings, on the plan.
    own = browser.run(f"['shapes', 'truths', 'detections', 'detections'].reduce((sum, name) => sum + {rows}, 0)")
    browser.press("ArrowLeft")
    assert browser.after("ArrowRight", "player.drawn.rows") == own > 0  # a frame looks at its own rows only
    only = "for (const name in player.shown) player.shown[name] = name === 'silhouettes'; player.whole();"
    browser.run(f"(() => {{ {only} }})()")
    run, seam = open_run(run_folder), 12  # image pixels: the dark line around a silhouette
    frame = run.frame("C1", crowded)
    picture, boxes, looked_at = browser.pixels(), frame.truth.full_boxes_px, 0
    for name, box in zip(frame.truth.vessels, boxes, strict=True):
        others = boxes[np.any(boxes != box, axis=1)]
        x, y = (box[:2] + box[2:]) / 2
        if np.any((others[:, 0] - seam <= x) & (x <= others[:, 2] + seam)):
            continue  # the middle may be another's
        column, row = browser.run(f"player.picture.toCanvas({x}, {y})")
        colour = palette.darker(palette.vessel_colour(run.scene.vessel_names.index(name)))
        np.testing.assert_array_equal(picture[int(row), int(column), :3], colour)
        looked_at += 1
    assert looked_at


def test_the_close_up_is_of_a_mistake_and_legend_and_timeline_have_what_the_run_has(browser, page, mistaken_page):
    browser.open(page, hash="#step=0")
    picture, empty = browser.pixels(), browser.run("player.stage.frames[0].truths.length")
    assert empty == 0 and (picture[len(picture) * 3 // 10 - 8 :][:16, :, :3].min(axis=2) > 250).any()  # white letters
    browser.open(mistaken_page, hash="#step=0")
    for step in browser.run("player.recording.moments(0, 'missed').slice(0, 5).map(({ index }) => index)"):
        browser.run(f"player.go({step})")
        assert browser.run("document.querySelector('#vessels .chosen').matches('.wrong')"), step
    browser.open(mistaken_page)
    legend, every = browser.text("#legend"), browser.run("player.timeline.rowsTop")
    assert all(word in legend for word in ("wrong class", "IoU below 0.5", "off its vessel", "missed"))
    browser.open(page)  # its detector has one class
    legend = browser.text("#legend")
    assert "wrong class" not in legend.partition("Strips")[0] and "IoU below 0.5" in legend
    assert browser.run("player.timeline.rowsTop") < every


def test_keyboard_alone_is_enough_and_the_scheme_is_the_systems_or_the_buttons(browser, page):
    browser.open(page, hash="#step=50")
    last = STEPS - 1
    arrows = (("ArrowRight", False, 51), ("ArrowLeft", False, 50), ("ArrowRight", True, 60), ("ArrowLeft", True, 50))
    ends = (("End", False, last), ("ArrowRight", False, last), ("Home", False, 0))
    for key, shift, expected in (*arrows, *ends):
        browser.press(key, shift)
        assert browser.run("player.index") == expected, key
    browser.press("n")
    first = browser.run("player.index")
    for key in "nb":
        browser.press(key)
    assert browser.run("player.index") == first
    missed = browser.run("player.recording.truths(player.index, player.camera).filter(truth => truth.missed)")
    assert browser.run("player.followed") in [truth["vessel"] for truth in missed]
    assert browser.after("c", "[player.camera, document.querySelector('#camera').value]") == [1, "1"]
    width = browser.run("player.picture.view.width")
    assert browser.after("+", "player.picture.view.width") == pytest.approx(width / 1.5)
    assert browser.after("9", "player.picture.view.width") >= 2464
    browser.run("document.querySelector('[data-do=forward]').focus({focusVisible: true})")
    assert browser.run("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    before = browser.run("player.index")
    assert browser.after(" ", "[player.index, player.playing]") == [before + 1, False]  # the button that has the focus
    colour = "getComputedStyle(document.body).backgroundColor"
    browser.open(page)
    light, timeline = browser.run(colour), browser.pixels("timeline")
    browser.scheme("dark")
    dark = browser.run(f"new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done({colour}))))")
    assert sum(map(int, dark[4:-1].split(","))) < 150 < 600 < sum(map(int, light[4:-1].split(",")))
    assert not np.array_equal(browser.pixels("timeline"), timeline)
    browser.click("#theme")
    assert browser.run(colour) == light and np.array_equal(browser.pixels("timeline"), timeline)


def test_names_are_text_and_a_slow_camera_shows_the_last_frame_that_it_took(browser, tmp_path):
    boats = {
        "<script>window.hacked = 1</script>": ([10.0, 4.0, 3.0], [[0, 150, 10], [100, 150, 12]]),
        "</script><img src=x onerror='window.hacked = 2'>": ([30.0, 8.0, 9.0], [[0, 100, 30], [12, 100, -30]]),
        "{{columns}} & ${name}": ([8.0, 3.0, 2.0], [[0, 220, -10], [100, 200, -10]]),
    }
    run_scene(load_scene(write_scene(tmp_path, boats, steps=12), source="analytic"), tmp_path / "run")
    browser.open(write_report(open_run(tmp_path / "run")))
    for key in ("v", "v", "End", "Home"):
        browser.press(key)
    browser.hover("#timeline", 0.5, 0.8)
    assert browser.run("[window.hacked, document.images.length]") == [None, 0]
    assert all(name in browser.text("#vessels") for name in boats)
    assert "{{columns}} & ${name}" in browser.text("section:nth-of-type(3)")
    usual = camera_keys(pose={"position_m": [0, 0, 10]})
    cameras = {"C0": usual, "slow": {**usual, "frame_rate_hz": 0.25, "start_offset_s": 2}}
    run_scene(load_scene(crossing(tmp_path, 12, cameras=cameras), source="analytic"), tmp_path / "slow")
    browser.open(write_report(open_run(tmp_path / "slow")))
    browser.run("player.look(1)")
    said = []
    for step in (1, 2, 5, 6):
        browser.run(f"player.go({step})")
        said.append(browser.text("#status").partition("frame")[2])
    assert said[0].startswith(" yet") and said[1] == said[3] == "" and said[2].startswith(" of step 2")
    places = "((step, camera) => player.recording.truths(step, camera).map(({ full }) => full))"
    assert browser.run(f"{places}(1, 1)") == [] != browser.run(f"{places}(5, 1)") == browser.run(f"{places}(2, 0)")
    assert browser.run("document.querySelector('#failure').hidden")


def test_moments_are_of_their_kind(browser, mistaken_page, mistaken_folder):
    run, occluded, states = open_run(mistaken_folder), {}, []
    names, wrong = run.scene.vessel_names, defaultdict(set)  # of each kind: steps and vessels
    for frame in (frame for frame in run.frames() if frame.camera == "bow"):
        truth = frame.truth
        # An occlusion begins where 10% are hidden and ends where 98% are seen: flicker neither begins nor ends one.
        occluded = {
            name: seen <= (0.98 if occluded.get(name) else 0.9) * WHOLE
            for name, seen in zip(truth.vessels, in_250ths(truth.visible_fraction).tolist(), strict=True)
        }
        hidden = np.array(list(occluded.values()))
        states.append(frame.state)
        if frame.state != states[0]:
            wrong["state"].add((frame.step, None))
        for kind, which in (("missed", truth.annotated & ~truth.detected), ("hidden", hidden)):
            wrong[kind].update((frame.step, truth.vessels[i]) for i in np.flatnonzero(which))
        for row, outcome in zip(detected_rows(frame), frame_outcomes(frame), strict=True):
            for kind in (kind for kind, flag in FLAGS.items() if outcome & flag):
                wrong[kind].add((frame.step, None if row is None else truth.vessels[row]))
    browser.open(mistaken_page)
    kinds = browser.run("[...document.querySelector('#kind').options].map(option => option.value)")
    assert set(kinds) == {kind for kind, found in wrong.items() if found} >= {"hidden", "state", *FLAGS}
    assert sum(before != after for before, after in pairwise(states)) == 1
    for kind in kinds:
        browser.choose("kind", kind)
        moments = browser.run("player.moments.list")
        covered = {
            (step, None if moment["vessel"] is None else names[moment["vessel"]])
            for moment in moments
            for step in range(moment["index"], moment["until"] + 1)
        }
        assert covered == wrong[kind], kind
        starts = ((moment["index"], moment["vessel"]) for moment in moments)  # frames in a row are one moment
        assert {(moment["until"] + 1, moment["vessel"]) for moment in moments}.isdisjoint(starts)
        listed = browser.run("[...document.querySelector('#moment').options].map(option => option.value)")
        assert listed == ["", *map(str, range(len(moments)))]
        browser.choose("moment", str(len(moments) - 1))
        index, followed = browser.run("[player.index, player.followed]")
        assert index == moments[-1]["index"] and (kind == "state" or followed == moments[-1]["vessel"])


COUNTED = """(() => {
    const counts = ({ columns: of }) => Object.fromEntries(Object.keys(of).map(name => [name, [...of[name]]]));
    const places = [...document.querySelectorAll('.result div, section:nth-of-type(-n+4) td, #differing')];
    const texts = places.map(each => each.textContent.replace(/[\\u2007\\u2008]/g, ''));
    return [player.stage.recordings.map(counts), texts, player.differences?.found ?? []]; })()"""


@pytest.mark.parametrize("seeds", [[None], [None, 77]])
def test_a_least_confidence_gives_the_page_of_runs_with_it(browser, mistaken_folder, other_folder, tmp_path, seeds):
    write, least = (write_report, write_side_by_side)[len(seeds) - 1], {"detector.operating_threshold": 0.5}
    kept = [detect_run(mistaken_folder, tmp_path / f"{seed}", seed=seed, settings=least).folder for seed in seeds]
    browser.open(write(*map(open_run, kept), out=tmp_path / "kept.html"))
    (expected, *others), runs = browser.run(COUNTED), [open_run(mistaken_folder), open_run(other_folder)][: len(seeds)]
    browser.open(write(*runs, out=tmp_path / "all.html"), hash="#step=90&confidence=0.5")
    browser.until("player.threshold.tallies")
    counts, *texts_and_differences = browser.run(COUNTED)
    counts_there = [{name: each[name] for name in of} for each, of in zip(counts, expected, strict=True)]
    assert [counts_there, *texts_and_differences] == [expected, *others]
    table = runs[0].tables()["detections"].to_pylist()
    rows = [row for row in table if row["camera"] == "bow" and row["confidence"] >= 0.5]
    detected, missed, false = map(int, re.findall(r"\d+", browser.text("#leastCounts")))
    assert [sum(counts[0][f"0.{of}"]) for of in ("annotated", "missed", "false")] == [detected + missed, missed, false]
    assert false == sum(row["kind"] not in ("true", "merged", "split") for row in rows)
    assert browser.run("player.stage.frames[0].detections.length") == sum(row["step"] == 90 for row in rows)
    browser.click("#least")
    assert browser.after("ArrowRight", "player.index") == 90  # it moves the slider


def test_the_timeline_zooms_around_the_step_and_goes_along_with_it(browser, tracks_page):
    browser.open(tracks_page, hash="#step=100")
    place = browser.run("player.timeline.x(100)")
    browser.click("[data-do=timeIn]")
    first, stop = browser.run("(t => [t.from, t.to])(player.timeline)")
    assert stop - first == STEPS // 2 and browser.run("player.timeline.x(100)") == pytest.approx(place, abs=5)
    browser.run(f"player.go({stop + 20})")
    first, stop = browser.run("(t => [t.from, t.to])(player.timeline)")
    assert first <= browser.run("player.index") < stop == first + STEPS // 2
    across = browser.run("(t => (t.left + 0.5 * t.wide) / (t.left + t.wide))(player.timeline)")
    browser.click("#timeline", across, 0.1)
    assert browser.run("player.index") == pytest.approx(first + STEPS // 4, abs=1)
    browser.click("[data-do=timeWhole]")
    assert browser.run("[player.timeline.from, player.timeline.to]") == [0, STEPS]


def test_mistakes_are_in_picture_list_and_gallery_and_a_line_joins_a_box_to_its_vessel(browser, mistaken_page):
    browser.open(mistaken_page)
    browser.choose("kind", "false")
    browser.run("(player.picture.fit([0, 0, 20, 10]), 0)")
    detections = "player.recording.detections(player.index, player.camera)"
    boxes = browser.after("n", f"{detections}.filter(each => each.false)")
    assert boxes and all(browser.run(f"player.picture.shows({json.dumps(each['box'])})") for each in boxes)
    browser.choose("kind", "mislabelled")
    vessel = browser.after("n", "player.followed")
    (found,) = browser.run(f"{detections}.filter(each => each.vessel === {vessel} && !each.false)")
    label, alarm = browser.run(f"(it => [it.vessels[{vessel}].label, it.colours.alarm])(player.recording.facts)")
    said = f"{found['label']} {found['confidence']:.2f}, is a"
    (plate,) = [plate for plate in browser.run("player.picture.plates") if plate["text"].startswith(said)]
    assert found["label"] != label and plate["text"].endswith(label) and plate["colour"] == alarm
    assert f"as {found['label']}" in browser.text("#vessels tr.chosen")
    browser.choose("kind", "off")
    browser.press("n")
    assert "off it" in browser.text("#vessels tr.chosen") and "off their vessel" in browser.text("#status")
    for name in ("labels", "false", "missed"):  # so that nothing else is red
        browser.click(f"#layer-{name}")
    apart, place, box, truth = browser.run(
        "player.moments.list.map(({ index, vessel }, place) => {"
        "  const box = player.recording.detections(index, 0).find(each => each.vessel === vessel && !each.false).box;"
        "  const truth = player.recording.truths(index, 0).find(each => each.vessel === vessel).target;"
        "  const apart = Math.max(truth[0] - box[2], box[0] - truth[2], truth[1] - box[3], box[1] - truth[3]);"
        "  return [apart, place, box, truth]; }).sort((a, b) => b[0] - a[0])[0]"
    )
    browser.choose("moment", str(place))
    assert apart > 3
    browser.run(f"(player.picture.lookAt({json.dumps(box)}, player.pane.size), player.draw())")
    middle = np.add(box[:2], box[2:]) / 2
    near = 0.8 * middle + 0.2 * np.clip(middle, truth[:2], truth[2:])
    column, row = browser.run(f"player.picture.toCanvas(...{near.tolist()})")
    around = browser.pixels()[int(row) - 1 : int(row) + 3, int(column) - 1 : int(column) + 3, :3].reshape(-1, 3)
    assert (np.abs(around.astype(int) - palette.ALARM).sum(axis=1) < 90).any()
    browser.open(mistaken_page, hash="#step=0")
    browser.click("#mistakes summary")
    browser.until("document.querySelector('#mistakesCount').textContent.includes(' of ')")
    kinds = ("missed", "false", "mislabelled", "bad", "off")
    counts = {kind: browser.run(f"player.recording.momentCount(0, '{kind}')") for kind in kinds}
    assert browser.text("#mistakesCount").startswith(f"{sum(counts.values())} of {sum(counts.values())} in ")
    browser.choose("byKind", "missed")
    browser.choose("byRange", "1")
    browser.run("new Promise(done => setTimeout(done, 100))")
    shown = int(browser.text("#mistakesCount").split()[0])
    thumbs = browser.run("[...document.querySelectorAll('#thumbs button')].map((each) => each.textContent)")
    assert 0 < len(thumbs) == min(shown, 48) and shown < counts["missed"]
    assert all("missed" in each and 100 <= int(each.split()[-2]) <= 200 for each in thumbs)
    browser.click("#thumbs button")
    browser.run("new Promise(done => setTimeout(done, 100))")
    truth = browser.run("player.stage.frames[0].truths.find(({ vessel }) => vessel === player.followed)")
    assert truth["missed"] and 100 <= truth["depth"] < 200
    assert thumbs[0].startswith(f"{browser.run('player.recording.facts.timestamps[player.index]')} s")


def test_pictures_of_the_scene_are_below_boxes_of_mistakes_and_not_while_it_plays(browser, mistaken_folder, tmp_path):
    run = open_run(mistaken_folder)
    browser.open(write_report(run, tmp_path / "look.html", every=60, look=parse_look("shaded")))
    images = browser.run("player.recording.facts.images.map(({ files, shown }) => [files.length, shown])")
    for camera, (count, shown) in enumerate(images):
        of = f"{[*FAULTS]}.flatMap((kind) => player.recording.moments({camera}, kind).map(({{ index }}) => index))"
        chosen = {index for index, place in enumerate(shown) if place >= 0}
        assert len(chosen) == count > 0 and max(shown) == count - 1 and chosen <= set(browser.run(of))
    index = next(index for index, place in enumerate(images[0][1]) if place >= 0)
    browser.run(f"new Promise(done => {{ player.whole(); player.go({index}); setTimeout(done, 500); }})")
    width, height = browser.run("player.pane.size")
    x, y = browser.run(f"player.picture.toCanvas({width / 2}, 9)")
    seen, at = browser.pixels(), (int(y), int(x), slice(0, 3))
    aspect = browser.run(f"(image => image.naturalWidth / image.naturalHeight)(player.recording.image({index}, 0))")
    assert aspect == pytest.approx(width / height, rel=0.005) and tuple(seen[at]) != palette.SKY
    browser.run("(player.playback.playing = true, player.draw(), 0)")
    assert tuple(browser.pixels()[at]) == palette.SKY


STEP = 90
ROWS = "[...document.querySelectorAll('#{} tr')].map(row => [...row.cells].map(cell => cell.textContent))"
LEFT_OUT = {"camera", "step", "timestamp"}  # above the table
BOX = {f"{which}_{side}_px" for which in ("full", "visible") for side in ("x_min", "y_min", "x_max", "y_max")}
TENTHS = {*BOX, "silhouette_px", "visible_px", "depth_m"}
DIGITS = {**dict.fromkeys(TENTHS, 1), "visible_fraction": 4, "in_frame_fraction": 4}


def open_numbers(browser):
    """Press the key and wait until the tables are filled: a browser tells later that a part was browser."""
    browser.press("d")
    browser.until("player.numbers.detections")


def test_the_tables_have_every_column_are_copied_and_follow_steps_not_play(browser, mistaken_page, mistaken_folder):
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
        assert 0 <= row["confidence"] - float(cells["confidence"]) < 1e-3
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
