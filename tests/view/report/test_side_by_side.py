"""Two images on a page, of two cameras or of two runs of the same truth, and where two runs differ."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest

from modsim3d import Frame, RunDirectoryError, RunRows, load_scene, open_run, run_scene
from modsim3d.runs.counts import Outcome, frame_outcomes
from modsim3d.runs.frames import detected_rows
from modsim3d.view.lights import ground_velocities
from modsim3d.view.map_marks import _approach
from modsim3d.view.report import side_by_side
from modsim3d.view.report.overview import VesselOutcome
from modsim3d.view.report.recorder import recording
from modsim3d.view.report.side_by_side import check_same_truth, differences, paired_detections, write_side_by_side
from tests.scenes import write_scene
from tests.view.report.test_layout import PHONE, TABLET

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


def test_both_runs_show_their_own_detections_and_move_together(browser, both, mistaken_folder, other_folder, tmp_path):
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


def test_images_are_level_and_the_page_fits_a_phone_and_names_inputs(browser, both, mistaken_folder, other_folder):
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


def test_differences_are_moments_lanes_and_labels(browser, both):
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


def test_paired_counts_are_of_all_annotated_vessels(mistaken_folder, other_folder):
    rows = [RunRows.of(open_run(folder)) for folder in (mistaken_folder, other_folder)]
    table = [list(map(int, row[1:])) for row in paired_detections(*rows)]
    assert table[-1] == np.sum(table[:-1], axis=0).tolist()
    annotated, both_runs, only_a, only_b, neither = table[-1]
    assert annotated == int(rows[0].annotated.sum()) == both_runs + only_a + only_b + neither
    assert both_runs + only_a == int((rows[0].annotated & rows[0].detected).sum())
    assert both_runs + only_b == int((rows[1].annotated & rows[1].detected).sum())


def test_a_second_camera_stands_beside_the_first(browser, mistaken_page):
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


def test_from_above_vessels_are_where_the_scene_has_them(browser, mistaken_page, mistaken_folder):
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


def test_the_closest_approach_to_own_ship_is_that_of_straight_courses(browser, mistaken_page, mistaken_folder):
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


def test_the_command_takes_two_runs(call, mistaken_folder, other_folder, run_folder, tmp_path):
    out, refused = tmp_path / "two.html", tmp_path / "no.html"
    assert call("report", mistaken_folder, other_folder, "--out", out, "--every", 20)[0] == 0
    assert json.loads(out.read_text().partition('id="facts-B">')[2].partition("</script>")[0])["every"] == 20
    wrong = {"show different truth": (run_folder,), "--tracks is for one run": (other_folder, "--tracks", "tracks")}
    wrong |= {"--look is for one run": (other_folder, "--look", "shaded"), "--look grim: needs": ("--look", "grim")}
    wrong["leave one out"] = ("--look", "shaded", "--pictures", "images")
    for words, arguments in wrong.items():
        status, said = call("report", mistaken_folder, *arguments, "--out", refused)
        assert status == 2 and words in " ".join(said.split()) and not refused.exists()


def test_the_same_runs_give_the_same_bytes_and_one_without_steps_none(mistaken_folder, other_folder, tmp_path):
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


def test_runs_of_other_truth_are_refused_with_what_differs(run_folder, mistaken_folder, other_folder, tmp_path):
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
