"""The page of a run with tracks: a lane each, in the vessel's colour, with marks of switches."""

import numpy as np

from modsim3d.runs.stored_run import open_run
from modsim3d.view import palette
from modsim3d.view.report.report import write_report
from tests.view.made_tracks import FALSE_TRACK, write_csv
from tests.view.report.conftest import FALSE, SWAP
from tests.view.report.unpacking import read

LANE = "player.lanes.lanes.find(lane => lane.number === {})"


def test_each_track_has_a_lane_in_its_vessels_colour_with_marks_and_boxes(browser, tracks_page, followed, pair):
    browser.open(tracks_page)
    mark = "({ index, switched, moved }) => [number, index, switched, moved]"
    marked = browser.run(f"player.lanes.lanes.flatMap(({{ number, marks }}) => marks.map({mark}))")
    assert sorted(marked) == [[number, SWAP, True, True] for number in sorted(pair)]
    assert "the vessel had another track" in browser.run(f"player.lanes.say({LANE.format(pair[0])}, {SWAP})")
    (only,) = browser.run(f"{LANE.format(FALSE_TRACK)}.stretches")
    assert [only["from"], only["to"], only["vessel"]] == [FALSE.start, FALSE.stop, None]
    assert browser.run(f"player.lanes.say({LANE.format(FALSE_TRACK)}, {FALSE.stop})") == f"track {FALSE_TRACK}: no box"
    for camera in (0, 1):  # in the order in which they begin
        mine = followed.tracks.take(followed.tracks.camera == camera)
        numbers, first = np.unique(mine.track, return_index=True)
        expected = numbers[np.argsort(first, kind="stable")].tolist()
        assert browser.run("player.lanes.lanes.map(lane => lane.number)") == expected and len(expected) > 2
        browser.press("c")
    assert followed.sentence() in browser.text("header")
    browser.open(tracks_page, hash="#step=0")
    at, high = browser.run(f"[player.lanes.lanes.indexOf({LANE.format(pair[0])}), player.lanes.high]")
    for step, vessel in ((SWAP - 3, pair[0]), (SWAP + 3, pair[1])):
        browser.run("player.lanes.panel.scrollTop = 0")
        x, y = browser.run(f"[player.timeline.x({step} + 0.5), ({at} + 0.4) * 13]")
        np.testing.assert_array_equal(browser.pixels("lanes")[int(y), int(x), :3], palette.vessel_colour(vessel))
    x, wide = browser.run(f"[player.timeline.x({SWAP + 3.5}), player.timeline.canvas.clientWidth]")
    browser.click("#lanes", x / wide, (at + 0.5) * 13 / high)
    assert browser.run("[player.index, player.followed]") == [SWAP + 3, pair[1]]
    said = browser.text("#laneHint")
    assert f"step {SWAP + 3}:" in said and f"track {pair[0]} follows " in said
    browser.open(tracks_page, hash=f"#step={SWAP}")
    with_boxes = browser.pixels()
    browser.press("k")
    assert not np.array_equal(browser.pixels(), with_boxes)
    browser.click("#layer-tracks")
    assert np.array_equal(browser.pixels(), with_boxes)
    assert browser.after("ArrowRight", "player.index") == SWAP + 1
    browser.run("player.go(0)")
    browser.run(
        "(({ lanes }) => { const [lane] = lanes.lanes, empty = { ...lane, stretches: [], marks: [] };"
        " const short = { ...empty, stretches: [{ from: 9, to: 10, vessel: null, pale: false }] };"
        " lanes.lanes.splice(0, Infinity, ...Array(500).fill(empty), short); lanes.prepare(0); })(player)"
    )
    assert browser.run("player.lanes.high") <= 320
    browser.run("player.go(9)")
    top, high, count = browser.run("[player.lanes.panel.scrollTop, player.lanes.high, player.lanes.lanes.length]")
    assert top <= (count - 1) * 13 < top + high


def test_every_kth_step_keeps_marks_and_without_tracks_is_no_lane(
    run_folder, followed, tmp_path, pair, page, tracks_page
):
    every = 7
    columns = read(write_report(open_run(run_folder), tmp_path / "page.html", every=every, followed=followed)).columns
    frames, marked = np.diff(columns["trackStart"]), columns["trackFlags"] & 2 > 0
    index = np.repeat(np.arange(len(frames)), frames)[marked] // 2  # of two cameras
    assert index.tolist() == [-(-SWAP // every)] * 2
    script = '<script type="module">'  # is the same on all pages
    plain, with_tracks = (path.read_text(encoding="utf-8").partition(script)[0] for path in (page, tracks_page))
    for part in ('id="lanes"', '"tracks"'):
        assert part not in plain and part in with_tracks


def test_command_takes_tracks_with_a_similarity_which_needs_them(call, run_folder, tmp_path, browser, rows, followed):
    missing, out = tmp_path / "nowhere", tmp_path / "page.html"
    for options, words in ((("--threshold", 0.3), "are for --tracks"), (("--tracks", missing), str(missing))):
        status, said = call("report", run_folder, *options, "--out", out)
        assert status == 2 and words in said and "Traceback" not in said
    assert not out.exists()
    file, out = write_csv(followed.tracks, rows, tmp_path / "made.csv"), tmp_path / "page.html"
    status, said = call("report", run_folder, "--tracks", file, "--out", out, "--every", 20)
    assert status == 0 and followed.sentence() in " ".join(said.split())
    assert read(out).facts["tracks"]["name"] == "made"
    options = ("--similarity", "centre:150", "--threshold", 0.3, "--every", 20, "--overwrite")
    assert call("report", run_folder, "--tracks", file, *options, "--out", out)[0] == 0
    browser.open(out)
    assert "1 - distance of centres / 150 px below 0.3" in browser.text("#legend")
    assert call("report", run_folder, "--tracks", file, "--out", file, "--overwrite")[0] == 2
    assert file.read_text(encoding="utf-8").startswith("camera,")
