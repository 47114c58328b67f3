"""Boxes that their images cannot hold, in truth, in detections or in both, are named; honest ones are read."""

import json
import re

import numpy as np
import pytest

from modsim3d.core.errors import InputError
from modsim3d.formats.reading.builder import NO_OPTIONS, ReadOptions
from modsim3d.formats.reading.pair import read_pair, read_truth
from tests.formats.labelled_files import CHANGES, HEIGHT, WIDTH, Video, coco, mot, refused, yolo

SIZED = ReadOptions(image_size_px=(WIDTH, HEIGHT), labels=("boat", "sailboat", "ship"))
RIGHT = [CHANGES["right"]] * 2
WRITERS = {"COCO": (coco, "right", NO_OPTIONS), "MOT": (mot, "right", NO_OPTIONS), "YOLO": (yolo, "centres", SIZED)}
TOLD = {
    "corners": "but are the corners x_min, y_min, x_max, y_max",
    "exchanged": "x and y of the boxes are exchanged",
    "shares": "the boxes are shares of the image",
    "larger": "of the boxes lie outside their images",
}
CASES = [(kind, *case) for kind in ("COCO", "MOT") for case in TOLD.items()]
CASES += [("YOLO", change, TOLD[change]) for change in ("corners", "larger")]


@pytest.mark.parametrize("wrong", ["truth", "detections", "both"])
@pytest.mark.parametrize(("kind", "change", "told"), CASES)
def test_boxes_that_images_cannot_hold_are_refused_with_the_reading_that_fits(tmp_path, kind, change, told, wrong):
    write, right, options = WRITERS[kind]
    changes = [CHANGES[change if wrong in (each, "both") else right] for each in ("truth", "detections")]
    source = "detections" if wrong == "detections" else "ground truth"
    with pytest.raises(InputError) as error:
        read_pair("day", *write(tmp_path, Video.of(), *changes), options)
    assert told in str(error.value) or (kind == "YOLO" and "must be shares" in str(error.value)), error.value
    assert str(error.value).startswith(source)
    if wrong != "detections" and kind != "YOLO":
        with pytest.raises(InputError):
            read_truth(tmp_path / ("gt.json" if kind == "COCO" else "gt.txt"), options)


@pytest.mark.parametrize("kind", WRITERS)
def test_half_a_box_of_difference_is_refused_and_in_both_files_where_edges_show_it(tmp_path, kind):
    write, right, options = WRITERS[kind]
    other = "top left" if kind == "YOLO" else "centres"
    form = CHANGES["right" if kind == "YOLO" else other]
    for changes in ((CHANGES[right], form), (form, CHANGES[right])):
        refused("but are", *write(tmp_path, Video.of(), *changes), options)
    true = Video.of().true
    true[:, :2, 0], true[:, 2:, 0] = WIDTH - true[:, :2, 2], 0  # at both edges of the image, which cuts them
    refused("but are", *write(tmp_path, Video(true, true), form, form), options)


def grown(video, by_px):
    return np.concatenate([video.true[..., :2] - by_px, video.true[..., 2:] + 2 * by_px], -1)


def honest():
    """Files that are as they should be, and yet have something of those that are not."""
    video, near = Video.of(), np.array([[20.0, 15, 900, 700], [40, 30, 930, 690], [10, 12, 870, 720]])
    yield "noisy", Video.of(1, noise_px=6)
    yield "too large", Video.of(2, bias=1.25)
    yield "too small", Video.of(3, bias=0.7)
    yield "biased by a tenth of the box", Video(video.true, video.found + np.array([9.0, 4, 0, 0]))
    yield "small", Video(video.true * [1, 1, 0.1, 0.15], video.found * [1, 1, 0.1, 0.15])
    yield "overhang by a little", Video(grown(video, 4), grown(video, 4.5))
    yield "few", Video(video.true[:1, :3], video.found[:1, :3])
    yield "one near vessel", Video(np.tile(near[:1], (30, 1))[:, None], np.tile(near[1:2], (30, 1))[:, None])
    yield "near vessels", Video(np.tile(near, (9, 1, 1)), np.tile(near + 3, (9, 1, 1)))
    steps = np.arange(30.0)
    closing = np.stack([400 - 10 * steps, 300 - 5 * steps, 450 + 20 * steps, 320 + 10 * steps], -1)[:, None]
    yield "one that comes near", Video(closing, closing + np.random.default_rng(5).normal(0, 4, closing.shape))
    yield "upper left", Video(video.true * 0.2, video.found * 0.2)


@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.parametrize(("name", "video"), list(honest()), ids=[name for name, _ in honest()])
def test_honest_boxes_are_read_without_a_remark_on_them(tmp_path, kind, name, video):
    write, right, options = WRITERS[kind]
    length = {"length": len(video.true)} if kind == "MOT" else {}
    labelled = read_pair("day", *write(tmp_path, video, CHANGES[right], CHANGES[right], **length), options)
    assert len(labelled.annotations) == video.true.shape[0] * video.true.shape[1]
    biased = "such a bias" if "biased" in name else "eighth column"
    assert not [note for note in labelled.notes if "eighth column" not in note and biased not in note]


def test_whole_boxes_of_cut_vessels_are_a_remark(tmp_path):
    video = Video.of()
    whole = video.true + np.where(video.true[..., :1] + video.true[..., 2:3] >= WIDTH - 1, [0, 0, 60, 0], 0)
    whole[:, -1, 1] = HEIGHT - 20.0  # below the lower edge
    for changes in ("right", "right"), ("centres", "centres"):
        write = coco if changes[0] == "right" else yolo
        labelled = read_pair("day", *write(tmp_path, Video(whole, whole), *(CHANGES[c] for c in changes)), SIZED)
        assert any("boxes are not cut at the edge of the image" in note for note in labelled.notes)


def crossing(start, seed=0):
    """Whole boxes of four vessels that leave the image by its right edge, and what is detected of the whole boxes."""
    size = np.array([[160.0, 60], [200, 80], [120, 50], [90, 40]])
    left = np.array([start, start + 100, start + 50, 100.0]) + np.arange(40)[:, None] * np.array([4, 3, 2, 1])
    true = np.stack([left, np.broadcast_to(np.array([480.0, 500, 470, 700]), left.shape)], -1)
    true = np.concatenate([true, np.broadcast_to(size, true.shape)], -1)
    return Video(true, true + np.random.default_rng(seed).normal(0, 2, true.shape))


def test_whole_boxes_outside_are_a_remark_where_detections_inside_lie_on_them(tmp_path):
    for note in read_pair("day", *coco(tmp_path, crossing(830), *RIGHT, size=(1080, 1920))).notes:  # upright images
        assert "boxes are not cut at the edge of the image" in note or "lie outside their image" in note
    video = crossing(1820)
    truth, found = coco(tmp_path, video, *RIGHT)
    refused(TOLD["larger"], truth, found)
    results = [entry for entry in json.loads(found.read_text()) if entry["bbox"][0] < WIDTH - 20]
    for entry in results:
        entry["bbox"][2] = min(entry["bbox"][2], WIDTH - entry["bbox"][0])
    found.write_text(json.dumps(results))
    notes = read_pair("day", truth, found).notes
    assert any(note.startswith("ground truth") and TOLD["larger"] in note for note in notes)


def test_corners_near_the_upper_left_are_named_though_all_are_inside_but_of_one_vessel_a_remark(tmp_path):
    corners, small = [CHANGES["corners"]] * 2, Video(Video.of().true / 3, Video.of().found / 3)
    refused(TOLD["corners"], *coco(tmp_path, small, *corners))
    read_pair("day", *coco(tmp_path, small, *RIGHT))
    steps = np.arange(60.0)
    true = np.stack([60 + 9 * steps, 50 + 1.5 * steps, 110 + 9.4 * steps, 60 + 3 * steps], -1)[:, None]
    near = Video(true, true + np.random.default_rng(5).normal(0, 2, true.shape))  # and goes to the right
    assert sum(TOLD["corners"] in note for note in read_pair("day", *coco(tmp_path, near, *RIGHT)).notes) == 2
    mixed = true[np.random.default_rng(1).permutation(len(true))]  # photographs with a boat each
    refused(TOLD["corners"], *coco(tmp_path, Video(mixed, mixed), *RIGHT))
    refused(TOLD["corners"], *coco(tmp_path, Video.of(), *corners))


@pytest.mark.parametrize("kind", ["COCO", "MOT"])
def test_images_whose_sides_are_exchanged_and_boxes_in_per_cent_are_named(tmp_path, kind):
    write, right, options = WRITERS[kind]
    share, right = CHANGES["per cent"], CHANGES[right]
    files = write(tmp_path, Video.of(), right, right, (HEIGHT, WIDTH))
    refused(f"or width and height of the images are: {HEIGHT} x {WIDTH}", *files, options)
    told = "all boxes lie within 100 x 100 of 1920 x 1080 px: are they in per cent? must be in pixels"
    video = Video.of()
    inner = Video(video.true[:, :4], video.found[:, :4])
    notes = read_pair("day", *write(tmp_path, inner, share, share), options).notes
    assert sum(told in note for note in notes) == 2
    # boxes that reach from edge to edge of 100 x 100
    refused(re.escape(told), *write(tmp_path, video, share, share), options)
    with pytest.raises(InputError, match=re.escape(told)):
        read_truth(tmp_path / ("gt.json" if kind == "COCO" else "gt.txt"), options)
    for files in ((right, share), (share, right)):
        refused(r"those of an image of 100 x 100 px|are they in per cent\?", *write(tmp_path, video, *files), options)
    refused("those of an image of 100 x 100 px", *write(tmp_path, inner, right, share), options)


@pytest.mark.parametrize("change", ["from below", "half"])
@pytest.mark.parametrize("wrong", ["truth", "detections"])
def test_where_images_do_not_tell_which_file_is_wrong_both_are_named(tmp_path, change, wrong):
    form = CHANGES.get(change, lambda x, y, w, h: (x / 2, y / 2, w / 2, h / 2))
    changes = (form, CHANGES["right"]) if wrong == "truth" else (CHANGES["right"], form)
    truth, found = coco(tmp_path, Video.of(), *changes)
    with pytest.raises(InputError) as error:
        read_pair("day", truth, found)
    assert str(error.value).startswith(f"detections {found}")
    assert f"or ground truth {truth} is wrong, the other way round" in str(error.value)


@pytest.mark.parametrize("first_px", [0, 1])
@pytest.mark.parametrize("alike", [True, False])
def test_frames_off_by_one_are_told_alike_in_both_directions(tmp_path, alike, first_px):
    rng, steps = np.random.default_rng(3), np.arange(40.0)[:, None]
    speed = 6.0 if alike else np.array([8.0, -6, 5, 9])
    left = np.array([300.0, 900, 500, 700]) + steps * speed
    true = np.stack([left, 500 + 60 * np.arange(4) + 0 * left, 60 + 0 * left, 24 + 0 * left], -1)
    said = []
    for step in (-1, 1):
        truth, found = mot(tmp_path, Video(true, true + rng.normal(0, 0.2, true.shape) + first_px - 1))
        lines = [line.split(",", 1) for line in found.read_text().splitlines()]
        kept = [(int(frame) + step, rest) for frame, rest in lines if 1 <= int(frame) + step <= 40]
        found.write_text("".join(f"{frame},{rest}\n" for frame, rest in kept))
        try:
            said.append([note for note in read_pair("day", truth, found).notes if "frames" in note])
        except InputError as error:
            said.append(str(error))
    assert type(said[0]) is type(said[1]) and all("frames" in str(each) for each in said), said


def test_boxes_of_a_log_are_held_against_the_images_of_their_camera(tmp_path):
    from modsim3d.learn.voyage.log_to_scene import on_scene
    from modsim3d.learn.voyage.logs.log import LogOptions
    from modsim3d.learn.voyage.logs.reading import read_log
    from modsim3d.scene.reading import load_scene

    scene, video = load_scene("strait"), Video.of()
    names = {"left,top,width,height": "right", "left,top,right,bottom": "corners", "x1,y1,x2,y2": "corners"}

    def look(columns, change):
        boxes = [(k / 5, *map(float, CHANGES[change](*box))) for k, each in enumerate(video.found) for box in each]
        (tmp_path / "log.csv").write_text(f"time_s,{columns}\n" + "".join(f"{str(b)[1:-1]}\n" for b in boxes))
        return on_scene(read_log(tmp_path / "log.csv", LogOptions(frame_rate_hz=5)), scene, "bow")

    for columns, right in names.items():
        assert not any("edge of the image" in note for note in look(columns, right).notes)
    sizes, *corners = names
    wrong = [(sizes, form, TOLD[form]) for form in ("corners", "exchanged")]
    wrong += [(each, "right", r"has no area(.|\n)*are the last two width and height\?") for each in corners]
    for columns, form, told in wrong:
        with pytest.raises(InputError, match=told):
            look(columns, form)
    mot(tmp_path, video, detections=CHANGES["corners"])
    boxes = [[{"box_px": [y, x, y + h, x + w]} for x, y, w, h in each] for each in video.found.tolist()]
    frames = [{"time_s": k / 5, "detections": each} for k, each in enumerate(boxes)]
    (tmp_path / "log.jsonl").write_text("".join(f"{json.dumps(frame)}\n" for frame in frames))
    truth, _ = coco(tmp_path, video, CHANGES["right"], CHANGES["corners"])
    timed = json.loads(truth.read_text())
    for image in timed["images"]:
        image["time_s"] = image["id"] / 5
    truth.write_text(json.dumps(timed))
    for log, told in (("det.txt", "corners"), ("log.jsonl", "exchanged"), ("dt.json", "corners")):
        images = truth if log == "dt.json" else None
        with pytest.raises(InputError, match=TOLD[told]):
            on_scene(read_log(tmp_path / log, LogOptions(images=images)), scene, "bow")
