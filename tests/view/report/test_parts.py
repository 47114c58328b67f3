"""A recording in parts, the same wherever it is cut, and two images on a page: of two cameras, or of two runs."""

import hashlib
import json
import shutil
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modsim3d import Frame, RunDirectoryError, RunRows, load_scene, open_run, run_scene
from modsim3d.runs.counts import Outcome, frame_outcomes
from modsim3d.runs.frames import detected_rows
from modsim3d.runs.stored_run import StoredRun
from modsim3d.view.lights import ground_velocities
from modsim3d.view.plan_marks import _approach
from modsim3d.view.report import overview, part_columns, side_by_side
from modsim3d.view.report.overview import BEGINS, ENDS, Overview, ShownRows, VesselOutcome, steps_in_a_bin
from modsim3d.view.report.packing import StretchesBuilder
from modsim3d.view.report.recorder import clock, recording, time_text
from modsim3d.view.report.report import parts_folder, write_report
from modsim3d.view.report.side_by_side import check_same_truth, differences, paired_detections, write_side_by_side
from modsim3d.world.poses.base import generated_timestamps
from tests.scenes import write_scene
from tests.view.report.test_layout import PHONE, TABLET
from tests.view.report.unpacking import Unpacked, read

SIZE = (1440, 1000)
WORDS = {outcome: outcome.name.lower().replace("_", " ") for outcome in VesselOutcome}
WORDS |= {VesselOutcome.BELOW_HALF_IOU: "IoU below 0.5", VesselOutcome.DETECTED: "right"}
WORDS |= {VesselOutcome.OFF_VESSEL: "off its vessel"}


@pytest.fixture(scope="module")
def both(mistaken_folder, other_folder, tmp_path_factory):
    out, found = tmp_path_factory.mktemp("both") / "both.html", []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(side_by_side, "differences", lambda *runs: found.append(differences(*runs)) or found[0])
        return write_side_by_side(open_run(mistaken_folder), open_run(other_folder), out), found[0]


def test_both_runs_move_together_with_differences_as_moments(browser, both, mistaken_folder, other_folder, tmp_path):
    browser.call("Browser.setDownloadBehavior", behavior="allow", downloadPath=str(tmp_path))
    browser.open(both[0], SIZE, "#step=50")
    frames = browser.run("player.panes.map(({ recording, camera }) => recording.detections(player.index, camera))")
    for shown, folder in zip(frames, (mistaken_folder, other_folder), strict=True):
        expected = next(frame for frame in open_run(folder).frames(50, 51) if frame.camera == "bow").detections.boxes_px
        np.testing.assert_allclose([each["box"] for each in shown], expected, atol=0.051)
    titles = browser.run("[...document.querySelectorAll('.run')].map(each => each.textContent)")
    assert titles == [f"A {mistaken_folder.name}", f"B {other_folder.name}"]
    browser.click("[data-do=save]")
    said = "new Promise(done => setTimeout(() => done(document.querySelector('#note').textContent), 300))"
    run, scene = browser.run("[player.pane.run.replace(' ', '-'), player.recording.facts.name]")
    assert browser.run(said) == f"Saved as {scene}_{run}_bow_50.png"
    views = browser.after("+", "player.panes.map(pane => pane.picture.view)")
    assert views[0] == views[1]
    browser.click("#picture2")
    assert browser.run("player.pane.run").startswith("B ")
    assert browser.after("c", "player.panes.map(pane => pane.camera)") == [1, 1]
    assert browser.run("player.timeline.recording.name") == "B"
    browser.open(both[0], TABLET)
    said = browser.run("document.body.textContent")
    for folder in (mistaken_folder, other_folder):
        assert hashlib.sha256((folder / "detections.parquet").read_bytes()).hexdigest() in said
    sections = "[...document.querySelectorAll('section')]"
    settings = f"{sections}.find(each => each.querySelector('h2')?.textContent === 'Settings that differ')"
    assert "detector_seed" in browser.run(f"{settings}.textContent")
    browser.run("(document.querySelectorAll('.run')[1].textContent += ' with a name longer than the other one', 0)")
    one, other = browser.run("player.panes.map(pane => pane.canvas.getBoundingClientRect().toJSON())")
    assert (one["top"], one["height"]) == (other["top"], other["height"])
    browser.resize(PHONE)
    assert browser.run("document.documentElement.scrollWidth") == PHONE[0]
    page, found = both
    browser.open(page, SIZE)
    first = np.flatnonzero(found.camera == 0)
    first = first[np.lexsort((found.vessel[first], found.index[first]))]
    assert browser.after("x", "player.momentRow.kind") == "differs"
    browser.run("player.momentRow.show(player.moments.choose(0))")
    chosen = browser.run("[player.index, player.followed, player.moments.list.length]")
    assert chosen == [found.index[first[0]], found.vessel[first[0]], len(first)]
    lanes = browser.run("player.differenceLanes.lanes.map(([vessel]) => vessel)")
    assert lanes == sorted(set(found.vessel[first].tolist()))
    a, b = (WORDS[VesselOutcome(each)] for each in found.outcomes[first[0]])
    labels = browser.run("player.panes.map(pane => pane.picture.plates.map(plate => plate.text))")
    assert f"B: {b}" in labels[0] and f"A: {a}" in labels[1]
    assert "≠" in browser.run("player.list.rows[player.followed].cells[2].textContent")


def test_a_second_camera_is_beside_the_first_and_vessels_where_they_are(browser, mistaken_page, mistaken_folder):
    browser.open(mistaken_page, SIZE, "#step=30&beside=quay")
    assert browser.run("player.panes.map(pane => pane.facts.name)") == ["bow", "quay"]
    box = "each => each.getBoundingClientRect().toJSON()"
    left, right = browser.run(f"[...document.querySelectorAll('.pane canvas')].map({box})")
    assert left["right"] <= right["left"] and left["top"] == right["top"]
    browser.click("#picture2")
    assert browser.run("[player.camera, player.timeline.camera]") == [1, 1]
    assert "camera=bow&beside=quay" in browser.after("u", "location.hash")  # writes the address
    assert browser.after("g", "[player.panes.length, document.querySelector('#picture2')]") == [1, None]
    assert browser.after("g", "player.panes.map(pane => pane.facts.name)") == ["bow", "quay"]
    image = "document.querySelector('#picture2').toDataURL()"  # drawn at once
    drawn = "new Promise(done => requestAnimationFrame(() => { player.draw(); done(" + image + ") }))"
    assert browser.run(image) == browser.run(drawn)
    assert browser.run("document.querySelector('#beside').value") == "quay"
    assert browser.after("g", "player.panes.length") == 1
    browser.open(mistaken_page, SIZE, "#step=40")
    poses = open_run(mistaken_folder).scene.poses.poses(40, 41)
    places = browser.run("player.recording.places(40).vessels")
    assert [place is not None for place in places] == poses.present[0].tolist()
    shown = [[place["x"], place["y"]] for place in places if place]
    np.testing.assert_allclose(shown, poses.positions_m[0, poses.present[0], :2], atol=0.006)
    placed = browser.run("player.above.placed")
    chosen, box = placed[0], browser.run("document.querySelector('#above').getBoundingClientRect().toJSON()")
    browser.click("#above", chosen["x"] / box["width"], chosen["y"] / box["height"])
    near = [each["vessel"] for each in placed if abs(each["x"] - chosen["x"]) + abs(each["y"] - chosen["y"]) < 15]
    assert browser.run("player.followed") in near
    scene = open_run(mistaken_folder).scene
    here, moves = scene.poses.poses(40, 41).positions_m[0, :, :2], ground_velocities(scene, 40)
    browser.open(mistaken_page, SIZE, "#step=40")
    for vessel in (each for each in range(len(scene.vessels)) if each not in scene.own_ships):
        pair = [scene.own_ships[0], vessel]
        metres, seconds, _ = _approach(here[pair], moves[pair])
        browser.run(f"player.above.closest = null; player.followed !== {vessel} && player.choose({vessel})")
        found = browser.run("player.above.closest")
        assert (found is not None) == bool(np.isfinite(metres) and seconds > 0)
        if found:
            assert found["metres"] == pytest.approx(metres, rel=0.02, abs=1) and found["vessel"] == vessel


RADII = """(({ above }) => { const { context } = above, real = context.fillText, said = [];
    context.fillText = (text, x, y) => { said.push([text, x, y]); real.call(context, text, x, y); };
    player.draw(); context.fillText = real;
    return said.filter(([text]) => / (nm|cables)$/.test(text)); })(player)"""


def test_range_rings_lie_at_their_radii_about_the_camera_that_is_shown(browser, mistaken_page):
    for unit, metres, key in (("nm", 1852, "a"), ("cables", 185.2, "e")):
        browser.open(mistaken_page, SIZE, "#step=40&camera=quay")
        plain = browser.pixels("above").astype(int)
        assert browser.run(RADII) == []
        browser.click(f"#layer-{'nm' if unit == 'cables' else 'cables'}")  # of which one is shown at a time
        browser.press(key)
        assert browser.run("[player.shown.nm, player.shown.cables]") == [unit == "nm", unit == "cables"]
        assert unit in browser.after("u", "location.hash")
        place = "player.recording.places(40).cameras[1]"
        at = np.array(browser.run(f"(({{ x, y }}) => player.above.toCanvas(x, y))({place})"))
        scale = browser.run("player.above.toCanvas(1, 0)[0] - player.above.toCanvas(0, 0)[0]")
        changed, said = np.abs(browser.pixels("above").astype(int) - plain).sum(axis=2) > 60, browser.run(RADII)
        radii = [float(text.split()[0]) for text, _, _ in said]
        np.testing.assert_allclose(radii, radii[0] * np.arange(1, len(radii) + 1))
        assert len(radii) > 1 and all(text.endswith(f" {unit}") for text, _, _ in said)
        for radius, (_, *place) in zip(radii, said, strict=True):
            assert np.hypot(*(place - at)) == pytest.approx(radius * metres * scale, abs=5)  # its line of writing
        rows, columns = np.nonzero(changed[:-1])  # the last row is part of a pixel
        apart = np.hypot(columns + 0.5 - at[0], rows + 0.5 - at[1]) / (radii[0] * metres * scale)
        near_text = np.min([np.hypot(columns - x, rows - y) for _, x, y in said], axis=0) < 40
        assert np.abs(apart - np.rint(apart))[~near_text].max() * radii[0] * metres * scale < 2
        assert (~near_text).sum() > 100


def test_the_command_takes_two_runs_for_the_same_bytes(call, mistaken_folder, other_folder, run_folder, tmp_path):
    out, refused = tmp_path / "two.html", tmp_path / "no.html"
    assert call("report", mistaken_folder, other_folder, "--out", out, "--every", 20)[0] == 0
    assert json.loads(out.read_text().partition('id="facts-B">')[2].partition("</script>")[0])["every"] == 20
    wrong = {"show different truth": (run_folder,), "--tracks is for one run": (other_folder, "--tracks", "tracks")}
    wrong |= {"--look is for one run": (other_folder, "--look", "shaded"), "--look grim: needs": ("--look", "grim")}
    wrong["leave one out"] = ("--look", "shaded", "--pictures", "images")
    for words, arguments in wrong.items():
        status, said = call("report", mistaken_folder, *arguments, "--out", refused)
        assert status == 2 and words in " ".join(said.split()) and not refused.exists()
    runs = open_run(mistaken_folder), open_run(other_folder)
    pages = [write_side_by_side(*runs, tmp_path / name, every=10) for name in ("once.html", "again.html")]
    assert pages[0].read_bytes() == pages[1].read_bytes()
    with pytest.raises(RunDirectoryError, match="nothing to show"):
        write_side_by_side(replace(runs[0], steps=0), runs[0])


def outcome_in(frame: Frame, row: int) -> VesselOutcome:
    """Of a row of the truth, looked up one by one."""
    if not frame.truth.annotated[row]:
        return VesselOutcome.NOT_ANNOTATED
    if not frame.truth.detected[row]:
        return VesselOutcome.MISSED
    found = [flag for at, flag in zip(detected_rows(frame), frame_outcomes(frame), strict=True) if at == row]
    if not found or not found[0]:
        return VesselOutcome.DETECTED
    if found[0] & Outcome.OFF_VESSEL:
        return VesselOutcome.OFF_VESSEL
    return VesselOutcome.BELOW_HALF_IOU if found[0] & Outcome.BELOW_HALF_IOU else VesselOutcome.WRONG_CLASS


@pytest.mark.parametrize("every", [1, 7])
def test_stretches_are_the_steps_at_which_the_runs_differ(mistaken_folder, other_folder, every):
    first, second = open_run(mistaken_folder), open_run(other_folder)
    cameras, vessels = [camera.name for camera in first.scene.cameras], first.scene.vessel_names
    frames = {(one.camera, one.step): (one, other) for one, other in zip(first.frames(), second.frames(), strict=True)}
    expected = []
    for index, step in enumerate(range(0, first.steps, every)):
        for camera in cameras:
            taken = [taken for name, taken in frames if name == camera and taken <= step]
            one, other = frames[camera, max(taken)] if taken else (None, None)
            for row, vessel in enumerate(one.truth.vessels if one else ()):
                pair = outcome_in(one, row), outcome_in(other, row)
                if pair[0] != pair[1]:
                    expected.append((camera, vessel, index, *pair))
    outcomes = recording(first, every).outcomes
    found = differences(outcomes, recording(second, every).outcomes)
    stretches = zip(found.camera, found.vessel, found.index, found.until, found.outcomes.tolist(), strict=True)
    covered = [
        (cameras[camera], vessels[vessel], index, *pair)
        for camera, vessel, begin, until, pair in stretches
        for index in range(begin, until + 1)
    ]
    assert sorted(covered) == sorted(expected) and len(expected) > len(found.camera)  # some stretches last
    assert len(differences(outcomes, outcomes).camera) == 0


def test_paired_counts_are_of_all_and_other_truth_is_refused(mistaken_folder, other_folder, run_folder, tmp_path):
    rows = [RunRows.of(open_run(folder)) for folder in (mistaken_folder, other_folder)]
    table = [[int(cell.replace(",", "")) for cell in row[1:]] for row in paired_detections(*rows)]
    assert table[-1] == np.sum(table[:-1], axis=0).tolist()
    annotated, both_runs, only_a, only_b, neither = table[-1]
    assert annotated == int(rows[0].annotated.sum()) == both_runs + only_a + only_b + neither
    assert both_runs + only_a == int((rows[0].annotated & rows[0].detected).sum())
    assert both_runs + only_b == int((rows[1].annotated & rows[1].detected).sum())
    first = open_run(mistaken_folder)
    check_same_truth(first, open_run(other_folder))
    with pytest.raises(RunDirectoryError, match=r"show different truth, in the cameras: .*modsim3d.detect_run"):
        check_same_truth(first, open_run(run_folder))
    runs = []
    for far in (150, 151):
        boats = {"ferry": ([30.0, 8.0, 9.0], [[0, far, 10], [100, far, 12]])}
        scene = load_scene(write_scene(tmp_path, boats, steps=4), source="analytic")
        run_scene(scene, tmp_path / f"{far}")
        runs.append(open_run(tmp_path / f"{far}"))
    with pytest.raises(RunDirectoryError, match=r"in \w+ of ferry at step 0 of camera \w+: [\d.]+ against [\d.]+\."):
        check_same_truth(*runs)


PART = 7


@pytest.fixture(scope="module")
def run(mistaken_folder: Path) -> StoredRun:
    """A camera on board and one ashore with a frame rate of its own, obstacles, every kind of mistake."""
    return open_run(mistaken_folder)


@pytest.fixture(scope="module")
def whole(mistaken_page: Path) -> Unpacked:
    return read(mistaken_page)


@pytest.fixture(scope="module")
def cut_pages(run: StoredRun, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """With the parts in the page, and in files."""
    folder = tmp_path_factory.mktemp("cut into parts")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(part_columns, "MAX_SHOWN", PART)
        return write_report(run, folder / "cut.html"), write_report(run, folder / "run page.html", in_files=True)


def test_frames_moments_and_counts_are_the_same_wherever_a_run_is_cut(cut_pages, whole):
    cut = read(cut_pages[0])
    assert cut.facts["parts"] == -(-whole.facts["length"] // PART) > whole.facts["parts"] == 1
    assert cut.stored > whole.stored  # a frame that is still shown is in the next part again
    for name in ("shown", "taken"):
        np.testing.assert_array_equal(getattr(cut, name), getattr(whole, name))
    for both in ("columns", "overview"):
        one, other = getattr(cut, both), getattr(whole, both)
        assert set(one) == set(other)
        for name, column in one.items():
            np.testing.assert_array_equal(column, other[name], err_msg=name)
    for mine, others in zip(cut.outlines, whole.outlines, strict=True):
        assert [line.tolist() for line in mine] == [line.tolist() for line in others]
    facts, columns = whole.facts, whole.columns
    for camera in range(len(facts["cameras"])):
        missed = []
        for index, frame in enumerate(whole.shown[:, camera].tolist()):
            rows = slice(*columns["truthStart"][frame : frame + 2]) if frame >= 0 else slice(0)
            lost = columns["vessel"][rows][columns["flags"][rows] == 1]
            assert whole.overview[f"{camera}.missed"][index] == len(lost)
            missed += [(vessel, index) for vessel in lost.tolist()]
        kept = [whole.overview[f"{camera}.moments.missed.{name}"].tolist() for name in ("index", "long", "key")]
        moments = zip(*kept, strict=True)
        covered = [(vessel, index) for first, long, vessel in moments for index in range(first, first + long + 1)]
        assert sorted(covered) == sorted(missed) and kept[0] == sorted(kept[0])


def test_bins_hold_the_sums_of_their_steps(monkeypatch):
    steps, vessels, rng = 47, 3, np.random.default_rng(0)

    def columns() -> dict[str, np.ndarray]:
        made = Overview(steps, vessels, 2)
        made.add(shown)
        return {name: getattr(each, "values", each) for name, each in made.columns("", half=False).items()}

    rows, drawn = rng.permutation(steps * vessels)[:100], np.arange(40)
    masks = rng.random(100) < 0.8, rng.random(100) < 0.3  # annotated, missed
    of_truth = (rows // vessels, rows % vessels, *masks, rng.integers(0, 251, 100), np.ones((100, 2)))
    of_detections = (rows[drawn] // vessels, rows[drawn] % vessels, rng.choice([0, 1, 2, 4, 12], 40))
    shown = ShownRows(np.arange(steps), np.repeat([0, 1], [30, 17]), *of_truth, *of_detections)
    whole = columns()
    assert whole["vessels.fraction"].sum() == shown.fraction.sum()
    assert whole["false"].sum() == (shown.outcome == 1).sum()
    for name in ("MAX_BINS", "MIN_BINS"):
        monkeypatch.setattr(overview, name, 10)
    binned = columns()
    assert steps_in_a_bin(steps, vessels) == 5
    for name in (*overview.COUNTS, *(f"vessels.{each}" for each in overview.VESSEL_COUNTS)):
        sums = np.add.reduceat(whole[name].reshape(-1, steps), np.arange(0, steps, 5), axis=1).ravel()
        np.testing.assert_array_equal(binned[name], sums)
        assert sums.sum() > 0
    assert binned["state"].tolist() == [0] * 6 + [1] * 4
    for name in (each for each in whole if each.startswith("moments")):
        np.testing.assert_array_equal(binned[name], whole[name])


def test_stretches_are_what_became_of_each_vessel_and_places_those_of_the_scene(run, whole):
    names, expected = run.scene.vessel_names, {}
    for frame in (each for each in run.frames() if each.camera == run.scene.cameras[0].name):
        for row, name in enumerate(frame.truth.vessels):
            expected[name, frame.step] = outcome_in(frame, row)
    found = recording(run).outcomes[0]
    covered = {
        (names[vessel], step): VesselOutcome(outcome)
        for vessel, outcome, first, until in zip(found.vessel, found.outcome, found.first, found.until, strict=True)
        for step in range(first, until + 1)
    }
    assert covered == expected and set(expected.values()) == set(VesselOutcome)
    follows = (np.diff(found.vessel) == 0) & (found.until[:-1] + 1 == found.first[1:])
    assert np.all(np.diff(found.outcome)[follows])  # one stretch ends where the outcome changes
    scene, columns = run.scene, whole.columns
    poses = scene.poses.poses(0, run.steps)
    there = columns["placed"].reshape(-1, len(scene.vessels)) > 0
    np.testing.assert_array_equal(there, poses.present)
    places = columns["place"].reshape(*there.shape, 2) / 100
    np.testing.assert_allclose(places[there], poses.positions_m[there][:, :2], atol=0.0051)
    turned = columns["heading"].reshape(there.shape) * (2 * np.pi / 65536) - poses.headings_rad
    assert np.abs(np.angle(np.exp(1j * turned)))[there].max() < 1e-4
    low, high = whole.facts["extent"]
    assert ((low < poses.positions_m[..., :2]) & (poses.positions_m[..., :2] < high)).all()
    assert len(whole.facts["obstacles"]) == len(scene.obstacles) > 0


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 20)), unique=True), st.integers(1, 20))
def test_stretches_cover_what_was_added_and_do_not_touch(pairs, part):
    builder = StretchesBuilder()
    for first in range(0, 21, part):
        some = [pair for pair in pairs if first <= pair[1] < first + part]
        builder.add(*np.array(some, dtype=np.int64).reshape(-1, 2).T)
    found = builder.stretches()
    stretches = list(zip(found.key.tolist(), found.first.tolist(), found.until.tolist(), strict=True))
    assert [(key, index) for key, first, until in stretches for index in range(first, until + 1)] == sorted(pairs)
    assert {(key, until + 1) for key, _, until in stretches}.isdisjoint((key, first) for key, first, _ in stretches)


@given(st.integers(-(10**6), 10**6), st.integers(1, 5000), st.integers(1, 4), st.integers(1, 30))
def test_times_come_back_as_they_were_written(first, by, decimals, count):
    texts = [time_text(first + i * by, decimals) for i in range(count)]
    facts, columns = clock(texts)
    assert float(texts[0]) == pytest.approx(first / 10**decimals)
    units = facts["first"] + np.cumsum(columns["clock"].values)
    assert [time_text(int(unit), facts["decimals"]) for unit in units] == texts


def test_times_of_a_scene_are_whole_numbers_and_those_that_are_no_plain_decimals_are_kept_as_they_are():
    facts, columns = clock(generated_timestamps(6, 0.25))  # 0.0, 0.25, 0.5
    assert (facts, columns["clock"].values.tolist()) == ({"decimals": 2, "first": 0}, [0, 25, 25, 25, 25, 25])
    for texts in (["1", "2"], ["0.0", "1e3"], ["0.10", "0.2"], ["0.0", "99999999999.0"]):
        facts, columns = clock(texts)
        assert facts == {} and columns["clockTexts"].tobytes().decode().split("\n") == texts


AROUND = 20  # as in recording.js
FRAME = """JSON.stringify((it => [0, 1].map((camera) => [it.shapes({0}, camera).map((shape) => it.lines(shape)),
    it.truths({0}, camera), it.detections({0}, camera), it.state({0}, camera)]))(player.recording))"""


def test_the_browser_reads_the_same_from_files_and_says_what_is_missing(browser, run, whole, cut_pages, tmp_path):
    last, seen = run.steps - 1, []
    assert len(list(parts_folder(cut_pages[1]).iterdir())) == -(-run.steps // PART)
    for page in cut_pages:
        browser.open(page)
        said = [browser.run(f"player.recording.load({i}).then(() => {FRAME.format(i)})") for i in (0, 8, last)]
        seen.append([browser.run("player.recording.facts.timestamps"), *said])
        walk = f"for (let i = 0; i <= {last}; i += 3) await player.go(i); await player.go({last});"
        browser.run(f"(async () => {{ {walk} }})()")
        assert browser.run("player.recording.parts.size") < 12
        assert browser.run("[player.recording.ready(player.index), player.recording.ready(0)]") == [True, False]
    assert seen[0] == seen[1]
    boxes = browser.run(f"player.recording.truths({last}, 0).map((each) => [each.vessel, ...each.full])")
    frame = int(whole.shown[-1, 0])
    rows = slice(*whole.columns["truthStart"][frame : frame + 2])
    full = whole.columns["full"].reshape(-1, 4)[rows] * whole.facts["quantum"]
    np.testing.assert_allclose(boxes, np.column_stack([whole.columns["vessel"][rows], full]))
    page = Path(shutil.copytree(cut_pages[1].parent, tmp_path / "copy")) / cut_pages[1].name
    part = parts_folder(page) / "A-3.js"
    part.write_text("", encoding="utf-8")
    browser.open(page)
    browser.run(f"Promise.race([player.go({3 * PART}), new Promise(done => setTimeout(done, 1000))])")
    assert "A-3.js cannot be read" in browser.text("#failure") and browser.errors == []
    part.unlink()
    browser.open(page)
    browser.run(f"player.go({3 * PART})")
    assert "A-3.js cannot be read" in browser.text("#failure")
    assert browser.run("Promise.resolve(player.go(0)).then(() => document.querySelector('#failure').hidden)")
    wait = "new Promise(done => setTimeout(done, 100))"
    browser.run(f"Promise.resolve(player.go({3 * PART - AROUND})).then(() => {wait})")  # near it
    assert browser.run("document.querySelector('#failure').hidden")
    assert all("Uncaught" not in error for error in browser.errors)
    browser.errors.clear()  # those of the missing file


STEPS, VESSELS = 12, 3
FRACTIONS = st.sampled_from([None, 0, 250, *(int(limit) + k for limit in (BEGINS, ENDS) for k in (-1, 0, 1))])
RUNS = st.lists(st.lists(FRACTIONS, min_size=STEPS, max_size=STEPS), min_size=VESSELS, max_size=VESSELS)


def slowly(fractions: list[int | None]) -> list[bool]:
    """Whether one vessel is occluded at each step; it is not where it is not in the image."""
    occluded, found = False, []
    for fraction in fractions:
        occluded = fraction is not None and fraction <= (ENDS if occluded else BEGINS)
        found.append(occluded)
    return found


@settings(max_examples=60, deadline=None)
@given(RUNS, st.sets(st.integers(1, STEPS - 1)))
def test_occlusions_are_those_of_a_loop_over_steps_whatever_the_parts(fractions, cuts):
    overview = Overview(STEPS, VESSELS, 1)
    for start, stop in pairwise([0, *sorted(cuts), STEPS]):
        rows = [(i, v, fractions[v][i]) for i in range(start, stop) for v in range(VESSELS)]
        overview.add(shown_rows(np.arange(start, stop), [row for row in rows if row[2] is not None]))
    onsets = overview.stretches("hidden")
    found = np.zeros((VESSELS, STEPS), dtype=bool)
    for vessel, first, until in zip(onsets.key, onsets.first, onsets.until, strict=True):
        found[vessel, first : until + 1] = True
    np.testing.assert_array_equal(found, [slowly(each) for each in fractions])


def shown_rows(index, rows):
    """One camera at some steps: the step, the vessel and the visible fraction in 250ths of each row of the truth."""
    at, vessel, fraction = np.array(rows, dtype=np.int64).reshape(-1, 3).T
    none, every = np.empty(0, dtype=np.int64), np.ones(len(at), dtype=bool)
    of_truth = (at, vessel, every, ~every, fraction, np.zeros((len(at), 2), dtype=np.int64))
    return ShownRows(index, np.zeros_like(index), *of_truth, none, none, none.astype(np.uint8))
