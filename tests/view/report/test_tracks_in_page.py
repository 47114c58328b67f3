"""The page of a run with tracks, a lane each, or of a labelled video: the user's pictures below the boxes, no map."""

import gc
from contextlib import nullcontext
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
from PIL import Image

import modsim3d
from modsim3d.core.errors import ModsimError
from modsim3d.runs.stored_run import open_run
from modsim3d.view import palette
from modsim3d.view.report.images import film_frames, image_facts
from modsim3d.view.report.report import write_report
from tests.formats.labelled_video.videos import coco, mot, write
from tests.view.conftest import FALSE_TRACK, write_csv
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


def test_every_kth_step_keeps_marks_and_no_tracks_no_lanes(run_folder, followed, tmp_path, pair, page, tracks_page):
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


FRAMES, SIZE = 45, (640, 480)


def colour_of(frame: int) -> tuple[int, int, int]:
    return 4 * frame, 200 - 4 * frame, 60


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    """A picture of one colour for each frame."""
    (tmp_path / "pictures").mkdir()
    for frame in range(FRAMES):
        Image.new("RGB", SIZE, colour_of(frame)).save(tmp_path / "pictures" / f"{frame + 1}.png")
    return tmp_path / "pictures"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return modsim3d.detect_truth(mot(tmp_path / "bay"), tmp_path / "run", detector="thesis").folder


def test_each_frame_is_shown_over_its_own_picture_and_there_is_no_map(tmp_path, run, pictures, browser) -> None:
    page = write_report(modsim3d.open_run(run), tmp_path / "page.html", pictures=pictures)
    browser.open(page)
    for index in (0, 17, FRAMES - 1):
        browser.run(f"player.go({index})")
        browser.run("new Promise(done => setTimeout(done, 300))")
        x, y = browser.place("#picture", 0.97, 0.97)
        browser.screenshot(tmp_path / "seen.png")
        seen = np.array(Image.open(tmp_path / "seen.png").convert("RGB"))[int(y), int(x)]
        assert np.abs(seen.astype(int) - colour_of(index)).max() <= 3, index
    assert browser.run("document.querySelector('#above').hidden")
    browser.click("[data-do=save]")
    browser.run("new Promise(done => setTimeout(done, 300))")
    assert "does not let this page save your pictures" in browser.text("body")
    assert "1 labelled video shows of 3 vessels" in browser.text("body")


@pytest.mark.parametrize(("left", "right", "there", "wanted"), [  # two cameras' files, pictures, what is shown or said
    (r"val\9.png val/8.PNG", "", "7.png 8.png 9.PNG", "9.PNG 8.png"),
    ("a/1.png b/1.png", "d.png c.png", "a/1.png b/1.png 1.png d.png c.png", "a/1.png b/1.png d.png c.png"),
    ("a/1.png b/1.png", "", "1.png 2.png", "of its own for 'b/1.png', which labels name .1 of 2.: the path below"),
    ("7.png -", "", "7.png 8.png", "own for '101', an image whose file labels do not name .1 of 2."),
    ("2.jpg", "2.png", "left/1.png left/2.png right/1.png right/2.png", "left/2.png right/2.png"),
])  # fmt: skip
def test_pictures_are_those_that_labels_name(tmp_path: Path, left: str, right: str, there: str, wanted: str) -> None:
    labels = coco({"left": len(left.split()), "right": len(right.split())})
    for image, name in zip(labels["images"], f"{left} {right}".split(), strict=True):
        image["file_name"] = name.strip("-")
    for name in there.split():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        Image.new("RGB", SIZE).save(tmp_path / name)
    truth = write(tmp_path / "gt.json", labels)
    run = modsim3d.detect_truth(truth, tmp_path / "run", truth_alone=True, frame_rate_hz=5)
    with pytest.raises(ModsimError, match=wanted) if " for " in wanted else nullcontext():
        facts = image_facts(modsim3d.open_run(run.folder), tmp_path, tmp_path / "page.html", 1)
        assert [file for each in facts for file in each["files"]] == wanted.split()


# Of an ffmpeg that has ended by itself, imageio-ffmpeg leaves the pipes to the garbage collector.
@pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")
def test_a_film_becomes_pictures_and_other_pictures_are_refused(tmp_path: Path, run: Path, pictures: Path) -> None:
    film = np.stack([np.full((*SIZE[::-1], 3), colour_of(frame), dtype=np.uint8) for frame in range(FRAMES)])
    iio.imwrite(tmp_path / "film.mp4", film, fps=10, macro_block_size=1)
    opened = modsim3d.open_run(run)
    folder = film_frames(tmp_path / "film.mp4", tmp_path / "decoded", opened)
    assert len(list(folder.iterdir())) == FRAMES
    iio.imwrite(tmp_path / "fast.mp4", np.repeat(film, 3, axis=0), fps=30, macro_block_size=1)
    film_frames(tmp_path / "fast.mp4", folder, opened)
    for frame in (0, 20, FRAMES - 1):  # by time, whatever the film's rate
        seen = np.array(Image.open(folder / f"{frame + 1:06d}.jpg"))[240, 320].astype(int)
        assert np.abs(seen - colour_of(frame)).max() <= 12, frame
    (tmp_path / "empty").mkdir()
    (pictures / "45.png").unlink()
    Image.new("RGB", (64, 48)).save(folder / "000001.jpg")
    for images, said in (
        (pictures, "has 44 pictures, and camera 'bay' has 45 frames"),
        (folder, "has 64 × 48 px, and 'bay' 640 × 480"),
        (tmp_path / "empty", "has no pictures"),
        (tmp_path / "nowhere", "is no folder of pictures"),
    ):
        with pytest.raises(ModsimError, match=said):
            write_report(opened, tmp_path / "page.html", pictures=images)
    with pytest.raises(ModsimError, match="cannot be read as a film"):
        film_frames(run / "run.json", tmp_path / "other", opened)
    iio.imwrite(tmp_path / "short.mp4", film[:9], fps=10, macro_block_size=1)
    with pytest.raises(ModsimError, match=r"ends after 9 pictures at 10 a second, and the run after 4.4 s"):
        film_frames(tmp_path / "short.mp4", folder, opened)
    gc.collect()
    assert len(list(folder.iterdir())) == FRAMES
