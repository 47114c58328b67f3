"""The maths around the network, without weights; the comparison on real pictures, on small files of its form."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw

from benchmarks.campaigns.real_pictures import PAGE, RESULTS
from benchmarks.processes import ROOT
from benchmarks.real_pictures.compared import compared
from benchmarks.real_pictures.page import page
from benchmarks.real_pictures.sets import DETECTIONS, DETECTORS, LABELS, checksums, pictures, river, streets
from benchmarks.stand_in import pixel_detector as network
from modsim3d.core.boxes import iou
from modsim3d.core.errors import ModsimError
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import open_run
from modsim3d.tracks.true_tracks import TrueTracks

SIZE_PX = (1280, 720)
SEA, HULL = (40, 60, 90), (250, 20, 20)


class RedSession:
    """A network that finds what is red in its input: one box around it, with the confidence 0.8."""

    def run(self, output_names, input_feed):
        red, green, _ = input_feed["images"][0]
        rows, columns = np.nonzero(red > green + 0.4)
        output = np.zeros((1, 84, 3), dtype=np.float32)
        if len(rows):
            low, high = np.array([columns.min(), rows.min()]), np.array([columns.max(), rows.max()]) + 1
            output[0, :4, 1] = *((low + high) / 2), *(high - low)
            output[0, 4 + network.BOAT, 1] = 0.8
        return [output]


def output_of(*boxes: tuple[float, float, float, float, float, int]) -> np.ndarray:
    """Output of a network: centre, width, height, score and class of each box."""
    output = np.zeros((1, 84, len(boxes)), dtype=np.float32)
    for k, (*box, score, label) in enumerate(boxes):
        output[0, :4, k] = box
        output[0, 4 + label, k] = score
    return output


def test_an_image_is_made_square_by_grey_and_without_onnxruntime_the_error_says_what_to_install(monkeypatch):
    given = network.View(0, 0, *SIZE_PX).input(Image.new("RGB", SIZE_PX, (255, 0, 51)))
    assert given.shape == (1, 3, network.INPUT_PX, network.INPUT_PX)
    np.testing.assert_allclose(given[0, :, 139], 114 / 255, atol=1e-6)
    np.testing.assert_allclose(given[0, :, 500], 114 / 255, atol=1e-6)
    np.testing.assert_allclose(given[0, :, 140:500], np.broadcast_to([[[1]], [[0]], [[0.2]]], (3, 360, 640)), atol=1e-6)
    # A crop of the network's own size is not resampled.
    noise = np.random.default_rng(1).integers(0, 256, (720, 1280, 3), dtype=np.uint8)
    given = network.View(320, 40, 640, 640).input(Image.fromarray(noise))
    np.testing.assert_array_equal(np.rint(given[0] * 255).transpose(1, 2, 0), noise[40:680, 320:960])
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ModsimError, match=r"needs onnxruntime: pip install"):
        network.open_session(Path("weights.onnx"))


def test_boxes_come_back_into_the_image_and_are_cut_only_by_an_edge_inside_it():
    whole, crop = network.View(0, 0, *SIZE_PX), network.View(320, 40, 640, 640)
    inside, of_another_class = (320, 210, 40, 20, 0.6, network.BOAT), (100, 300, 40, 20, 0.9, network.BOAT + 1)
    beyond, grey = (0, 320, 100, 40, 0.6, network.BOAT), (320, 60, 80, 40, 0.6, network.BOAT)
    for view, output, expected in (
        (whole, output_of(inside, of_another_class), [600, 120, 680, 160]),
        (crop, output_of(inside, of_another_class), [620, 240, 660, 260]),
        (whole, output_of(beyond, grey), [0, 320, 100, 400]),
    ):
        boxes, scores = view.boxes(output)
        np.testing.assert_allclose(boxes, [expected])
        np.testing.assert_allclose(scores, [0.6], rtol=1e-6)
    box = np.array([[0.0, 300, 60, 340], [580, 300, 640, 340], [300, 300, 400, 340]])
    assert network.View(0, 40, 640, 640).cut(box, SIZE_PX).tolist() == [False, True, False]
    assert network.View(0, 0, 1280, 720).cut(np.array([[0.0, 0, 1280, 720]]), SIZE_PX).tolist() == [False]


@pytest.mark.parametrize(("horizon_px", "y"), [(360.0, 40), (-500.0, 0), (300.0, 0), (5000.0, 80)])
def test_crops_lie_at_the_horizon_and_inside_the_image(horizon_px, y):
    whole, *crops = network.views_of(SIZE_PX, horizon_px, 3, 640)
    assert whole == network.View(0, 0, *SIZE_PX) and crops == [network.View(x, y, 640, 640) for x in (0, 320, 640)]


def test_a_whole_box_wins_against_a_cut_one_of_the_same_vessel_and_otherwise_the_most_confident_comes_first():
    large = [100.0, 100, 300, 200]
    for other, other_is_cut, kept in (
        ([200.0, 100, 300, 200], True, [0]),  # a part of the same vessel, though it is surer
        ([500.0, 100, 600, 200], True, [1, 0]),  # elsewhere
        ([200.0, 120, 260, 200], False, [1, 0]),  # a whole one in front of a larger one
    ):
        boxes, confidence = np.array([large, other]), np.array([0.3, 0.9])
        found = network.without_repeats(boxes, confidence, np.array([False, other_is_cut]))
        np.testing.assert_array_equal(found.boxes_px, boxes[kept])
        np.testing.assert_array_equal(found.confidence, confidence[kept])
    alone = network.without_repeats(boxes[1:], np.array([0.9]), np.array([True]))
    np.testing.assert_array_equal(alone.boxes_px, boxes[1:])
    # The order of the views does not matter.
    rng = np.random.default_rng(4)
    corner = rng.uniform(0, 300, (60, 2))
    boxes = np.concatenate([corner, corner + rng.uniform(20, 200, (60, 2))], axis=1)
    confidence, cut = rng.integers(1, 6, 60) / 8, rng.random(60) < 0.3
    found = network.without_repeats(boxes, confidence, cut)
    order = rng.permutation(60)
    again = network.without_repeats(boxes[order], confidence[order], cut[order])
    np.testing.assert_array_equal(again.boxes_px, found.boxes_px)
    assert (iou(found.boxes_px[:, None], found.boxes_px[None]) - np.eye(len(found.boxes_px))).max() <= 0.5


@pytest.mark.parametrize("box", [(100, 330, 130, 350), (620, 340, 660, 360), (200, 300, 1100, 400), (0, 350, 50, 380)])
def test_a_vessel_has_one_box_wherever_crops_cut_it_and_a_sea_without_vessels_none(box):
    detector, sea = network.PixelDetector(RedSession()), Image.new("RGB", SIZE_PX, SEA)
    assert detector.detect(sea, 360.0).boxes_px.shape == (0, 4)
    ImageDraw.Draw(sea).rectangle((box[0], box[1], box[2] - 1, box[3] - 1), fill=HULL)
    found = detector.detect(sea, 360.0)
    assert len(found.boxes_px) == 1
    np.testing.assert_allclose(found.boxes_px[0], box, atol=4)
    np.testing.assert_allclose(found.confidence, [0.8], rtol=1e-6)


FRAMES, CARS, FILMS = 30, 4, (0, 1, 2, 3)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Cars that pass, a van, a region without labels, and a detector that misses a tenth of them."""
    folder, rng = tmp_path_factory.mktemp("data"), np.random.default_rng(0)
    found = folder / DETECTIONS / DETECTORS["rrc"].folder
    for each in (folder / LABELS, found):
        each.mkdir(parents=True)
    for film in FILMS:
        truth, detected = [], []
        for frame in range(FRAMES):
            truth.append(f"{frame} -1 DontCare -1 -1 -10 1100 20 1200 60 -1 -1 -1 -1000 -1000 -1000 -10")
            detected.append(f"{frame},1110,25,1150,50,0.9")
            for car in range(CARS):
                x, y = 100 + 250 * car + frame * (car - 1.5), 150 + 20 * car
                kind = "Van" if car == 3 else "Car"
                truth.append(
                    f"{frame} {car} {kind} 0 {car % 4} 0 {x} {y} {x + 90} {y + 60} 1.5 1.6 4 0 1 {15 + 10 * car} 0"
                )
                if rng.random() < 0.9:
                    box = np.array([x, y, x + 90, y + 60]) + rng.normal(0, 2, 4)
                    detected.append(f"{frame},{','.join(f'{side:.2f}' for side in box)},{rng.uniform(0.5, 1.2):.3f}")
        (folder / LABELS / f"{film:04d}.txt").write_text("\n".join(truth))
        (found / f"{film:04d}.txt").write_text("\n".join(detected))
    return folder


def test_films_are_compared_by_what_the_other_half_taught(data: Path, tmp_path: Path) -> None:
    films = pictures(data, tmp_path, "rrc", FILMS)
    run = open_run(films[0].run)
    truth, regions = run.table("truth"), run.scene.labels.regions
    seen = {name: set(truth[name].to_pylist()) for name in ("vessel", "visible_fraction")}
    assert seen == {"vessel": {"0", "1", "2"}, "visible_fraction": {0.3, 0.7, 1.0}}
    assert (len(regions), int(regions.crowd.sum())) == (2 * FRAMES, FRAMES)
    results = compared(films, tmp_path, seeds=1, workers=1)
    assert [film["name"] for film in results["films"]] == ["0000", "0001", "0002", "0003"]
    for tracker, each in results["differences"]["i"].items():
        assert each["hota"]["films"] == 4 and each["hota"]["real"] > 0.5, tracker
        assert abs(each["hota"]["mean"]) < 0.15, tracker
    text = page({"rrc": {"judged": results, "halves": results, "sha256": checksums(data, FILMS, "rrc")}})
    gap = results["differences"]["i"]["sort"]["hota"]["mean"]
    assert f"{abs(gap):.3f}" in text and "films that were kept for the end" in text and "box of 32 px to 96 px" in text
    (data / LABELS / "0000.txt").rename(data / LABELS / "gone.txt")
    with pytest.raises(ModsimError, match=r"0000.txt: cannot be read"):
        pictures(data, tmp_path / "other", "rrc", FILMS)


def test_a_river_is_ten_films_with_the_identities_of_the_file_and_streets_count_frames_from_one(tmp_path):
    (tmp_path / "fvessel").mkdir()
    lines = [f"{frame},{boat},{100 + frame + 500 * boat},700,200,80,1,1,1,1" for frame in range(100) for boat in (0, 1)]
    for name in ("gt_tracking", "re_detection"):
        (tmp_path / "fvessel" / f"Video-01_{name}.txt").write_text("\n".join(lines))
    films = river(tmp_path, tmp_path / "work")
    runs = [open_run(film.run) for film in films]
    assert [run.steps for run in runs] == [10] * 10
    assert all(len(np.unique(TrueTracks.of(RunRows.of(run)).identity)) == 2 for run in runs)
    assert all(run.settings["counts"]["detected"] == 20 for run in runs)
    for name in ("TUD-Campus", "TUD-Stadtmitte"):
        (tmp_path / "tud" / name).mkdir(parents=True)
        for file, first, last in (("gt.txt", 7, 1), ("det.txt", -1, 0.5)):
            lines = [f"{frame},{first},{100 + frame},200,50,100,{last},-1,-1,-1" for frame in range(1, 31)]
            (tmp_path / "tud" / name / file).write_text("\n".join(lines))
    runs = [open_run(film.run) for film in streets(tmp_path, tmp_path / "work")]
    assert [(run.steps, run.settings["counts"]["detected"]) for run in runs] == [(30, 30)] * 2


def test_the_committed_page_and_the_readme_say_what_the_numbers_say():
    assert PAGE.read_text(encoding="utf-8") == page(json.loads(RESULTS.read_text(encoding="utf-8")))
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    films = json.loads((ROOT / "docs" / "campaigns" / "stand_in.json").read_text(encoding="utf-8"))
    cars = json.loads(RESULTS.read_text(encoding="utf-8"))
    for results, rung, sign, said in (
        (films, "i", 1, "was {} too high"),
        (films, "a", -1, "thesis's model made it {} too low"),
        (cars["rrc"]["judged"], "i", -1, "was {} too low behind one"),
        (cars["yolov3"]["judged"], "i", -1, "and {} behind another"),
    ):
        gaps = sorted(sign * each["hota"]["mean"] for each in results["differences"][rung].values())
        assert said.format(f"{gaps[0]:.2f} to {gaps[-1]:.2f}") in readme, (rung, gaps)
