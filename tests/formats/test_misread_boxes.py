"""Boxes, numbers and texts of labelled files that cannot be what they say are named; honest ones are read."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from modsim3d.cli.detect import parsed_names
from modsim3d.core.errors import InputError
from modsim3d.formats.reading.builder import NO_OPTIONS, Problems, ReadOptions, read_flag
from modsim3d.formats.reading.pair import read_pair, read_truth
from tests.formats.labelled_files import CHANGES, HEIGHT, NAMES, WIDTH, Video, coco, mot, refused, yolo

NAMED = ReadOptions(image_size_px=(WIDTH, HEIGHT), labels=("boat", "sailboat", "ship"))
BOTH_RIGHT = [CHANGES["right"]] * 2
WRITERS = {"COCO": (coco, "right", NO_OPTIONS), "MOT": (mot, "right", NO_OPTIONS), "YOLO": (yolo, "centres", NAMED)}
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


def crossing(start, seed=0):
    """Whole boxes of four vessels that leave the image by its right edge, and what is detected of the whole boxes."""
    size = np.array([[160.0, 60], [200, 80], [120, 50], [90, 40]])
    left = np.array([start, start + 100, start + 50, 100.0]) + np.arange(40)[:, None] * np.array([4, 3, 2, 1])
    true = np.stack([left, np.broadcast_to(np.array([480.0, 500, 470, 700]), left.shape)], -1)
    true = np.concatenate([true, np.broadcast_to(size, true.shape)], -1)
    return Video(true, true + np.random.default_rng(seed).normal(0, 2, true.shape))


def test_whole_boxes_of_cut_vessels_are_a_remark_and_corners_near_the_upper_left_are_named(tmp_path):
    video = Video.of()
    whole = video.true + np.where(video.true[..., :1] + video.true[..., 2:3] >= WIDTH - 1, [0, 0, 60, 0], 0)
    whole[:, -1, 1] = HEIGHT - 20.0  # below the lower edge
    for changes in ("right", "right"), ("centres", "centres"):
        write = coco if changes[0] == "right" else yolo
        labelled = read_pair("day", *write(tmp_path, Video(whole, whole), *(CHANGES[c] for c in changes)), NAMED)
        assert any("boxes are not cut at the edge of the image" in note for note in labelled.notes)
    for value, flag in FLAGS:
        problems = Problems("a file")
        assert read_flag(value, "flag", "here", problems) is flag and not problems.count
    for value in ("no", "yes", "", "2", 2, -1, 0.5, [], {}, [0], "none", "nan"):
        problems = Problems("a file")
        read_flag(value, "flag", "here", problems)
        assert problems.count == 1
    for note in read_pair(
        "day", *coco(tmp_path, crossing(830), *BOTH_RIGHT, size=(1080, 1920))
    ).notes:  # upright images
        assert "boxes are not cut at the edge of the image" in note or "lie outside their image" in note
    video = crossing(1820)
    truth, found = coco(tmp_path, video, *BOTH_RIGHT)
    refused(TOLD["larger"], truth, found)
    results = [entry for entry in json.loads(found.read_text()) if entry["bbox"][0] < WIDTH - 20]
    for entry in results:
        entry["bbox"][2] = min(entry["bbox"][2], WIDTH - entry["bbox"][0])
    found.write_text(json.dumps(results))
    notes = read_pair("day", truth, found).notes
    assert any(note.startswith("ground truth") and TOLD["larger"] in note for note in notes)
    corners, small = [CHANGES["corners"]] * 2, Video(Video.of().true / 3, Video.of().found / 3)
    refused(TOLD["corners"], *coco(tmp_path, small, *corners))
    read_pair("day", *coco(tmp_path, small, *BOTH_RIGHT))
    steps = np.arange(60.0)
    true = np.stack([60 + 9 * steps, 50 + 1.5 * steps, 110 + 9.4 * steps, 60 + 3 * steps], -1)[:, None]
    near = Video(true, true + np.random.default_rng(5).normal(0, 2, true.shape))  # and goes to the right
    assert sum(TOLD["corners"] in note for note in read_pair("day", *coco(tmp_path, near, *BOTH_RIGHT)).notes) == 2
    mixed = true[np.random.default_rng(1).permutation(len(true))]  # photographs with a boat each
    refused(TOLD["corners"], *coco(tmp_path, Video(mixed, mixed), *BOTH_RIGHT))
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


RIGHT = CHANGES["right"]
VIDEO = Video.of()
SIZED = ReadOptions(image_size_px=(WIDTH, HEIGHT))


def read_mot(folder, options=ReadOptions(), **given):  # noqa: B008
    return read_pair("day", *mot(folder, VIDEO, **given), options)


def has(labelled, *parts):
    return [part for part in parts if not any(part in note for note in labelled.notes)] == []


FLAGS = [(each, True) for each in (1, 1.0, True, "1", "true", " True ", "1.0")]
FLAGS += [(each, False) for each in (None, 0, 0.0, False, "0", "false", "FALSE")]


@pytest.mark.parametrize("key", ["iscrowd", "ignore"])
def test_flags_of_coco_are_read_whatever_their_type_and_what_is_left_out_is_told(tmp_path, key):
    truth, found = coco(tmp_path, VIDEO, RIGHT, RIGHT)
    content = json.loads(truth.read_text())
    boats = [entry for entry in content["annotations"] if entry["category_id"] == 1]

    def read(value):
        for entry in boats:
            entry[key] = value
        truth.write_text(json.dumps(content))
        return read_pair("day", truth, found)

    for value, flag in FLAGS:
        labelled = read(value)
        assert labelled.annotations.ignored.sum() == flag * len(boats)
        assert has(labelled, f"{len(boats)} of 240 annotations are", "among them all of 'boat'") is flag
    for value in ("no", 2, []):
        with pytest.raises(InputError, match=rf"annotations\[0\]: {key} must be 0 or 1, false or true"):
            read(value)


WORLD = {"negative": (-5.7158, -1), "as classes": (2.7, 1.31)}


@pytest.mark.parametrize(("place", "found"), WORLD.values(), ids=WORLD)
def test_places_in_the_world_are_neither_classes_nor_visibility(tmp_path, place, found):
    tail = lambda k, j: f"1,{place + 0.7 * j:g},{2.26 + k / 9:g},0.45"  # noqa: E731
    labelled = read_mot(tmp_path, tail=tail, found_tail=f"0.9,{found},{5.1 if found > 0 else -1},0")
    assert labelled.labels == ("object",) and np.isnan(labelled.annotations.visible_fraction).all()
    assert has(labelled, f"gt.txt: columns eight to ten are places in the world, as in MOT15 (gt.txt line 1: {place:g}")
    with pytest.raises(InputError, match=r"gt.txt line 1: has no class") as error:
        read_mot(tmp_path, tail=tail, found_tail="0.9,1,-1,-1")
    assert f"places in the world, as in MOT15 (gt.txt line 1: {place:g}" in str(error.value)
    truth, found = mot(tmp_path, VIDEO, tail=tail)
    found.write_text("1,-1,10,20,30,40,7.5,-1,-1,-1\n")
    with pytest.raises(InputError) as error:
        read_pair("day", truth, found)
    assert "places in the world" not in str(error.value)
    truth.write_text(truth.read_text().replace("1,1,", "1,1.5,", 1))
    with pytest.raises(InputError, match="identity must be") as error:
        read_pair("day", truth, found)
    assert "places in the world" not in str(error.value)
    with pytest.raises(InputError, match=rf"class must be a whole number \(got {place:g}\)"):
        read_mot(tmp_path, tail=lambda k, j: f"1,{place + 0.7 * j:g},0.9")


def test_separators_of_spreadsheets_are_named_and_columns_of_other_data_sets_are_no_visibility(tmp_path):
    for mark, told in (
        (lambda text: text.replace(",", ";"), "its cells have semicolons between them, must have commas"),
        (lambda text: text.replace(",", "\t"), "its cells have tabs between them, must have commas"),
        (lambda text: f"sep=,\n{text}", "line 1 is for spreadsheets alone, leave it out"),
        (lambda text: "sep=;\n" + text.replace(",", ";"), "line 1 is for spreadsheets alone, leave it out"),
        (lambda text: text.replace(",", ";").replace(".", ","), "must have commas, and points in numbers"),
        (lambda text: text.replace(",", "\t").replace(".", ","), "must have commas, and points in numbers"),
    ):
        for wrong in (0, 1):
            files = mot(tmp_path, VIDEO)
            files[wrong].write_text(mark(files[wrong].read_text()))
            refused(told, *files)
        folders = yolo(tmp_path, VIDEO)
        for text in ("0,0.5,0.5,0.1,0.1\n", "0 0,5 0,5 0,1 0,1\n"):
            (folders[0] / "labels" / "003.txt").write_text(text)
            refused(r"must be numbers.*: commas stand neither between nor in them", *folders, SIZED)
    labelled = read_mot(tmp_path, tail=lambda k, j: f"1,1,{int(j < 1)},0")
    assert np.isnan(labelled.annotations.visible_fraction).all()
    assert has(labelled, "truncation and occlusion, as in VisDrone", "the ninth is 0 in 200 of 240 lines")
    labelled = read_mot(tmp_path, tail=lambda k, j: "1,1,0")
    assert has(labelled, "the visibility of 240 of 240 boxes is 0: they count as fully hidden")
    labelled = read_mot(tmp_path, tail=lambda k, j: f"1,{j % 2 + 1},0.4", found_tail="0.9,1,-1,-1")
    assert labelled.labels == ("class_1", "class_2") and (labelled.annotations.visible_fraction == 0.4).all()
    told = "the eighth column is the class, where 1 is 'class_1', 2 is 'class_2'; the ninth is the visibility"
    assert has(labelled, told)
    labelled = read_mot(tmp_path, tail=lambda k, j: "1,1,-1,-1")
    assert np.isnan(labelled.annotations.visible_fraction).all()


WRONG_TAILS = {
    "1,1,87": r"visibility must be from 0 to 1, or -1 if it is not known \(got 87\)(.|\n)*per cent must be divided",
    "0.87,1,1": r"the flag, must be 0 or 1, false or true \(got 0.87\)(.|\n)*the seventh column may be confidences",
    "2,1,1": r"the seventh number, the flag, must be 0 or 1, false or true \(got 2\)",
    "1,1.5,1": r"class must be a whole number \(got 1.5\)",
}


@pytest.mark.parametrize(("tail", "told"), WRONG_TAILS.items())
def test_numbers_that_no_column_of_mot_has_are_refused_one_by_one(tmp_path, tail, told):
    with pytest.raises(InputError, match=told):
        read_mot(tmp_path, tail=lambda k, j: tail)
    given = mot(tmp_path, VIDEO, tail=lambda k, j: tail if (k, j) == (3, 2) else "1,1,1")
    labelled = read_pair("day", *given, ReadOptions(skip_bad=True))
    assert len(labelled.annotations) == 239 and has(labelled, "1 entries left out")
    given[0].write_text(given[0].read_text().replace("1,2,", "1,2.5,", 1))
    refused(r"identity must be a whole number \(got 2.5\)", *given)


def test_numbers_of_frames_are_held_against_the_sequence_and_options_that_do_nothing_told(tmp_path):
    assert has(read_mot(tmp_path, length=3), "seqinfo.ini says 3 frames (seqLength), and the last with a box is 40")
    assert has(read_mot(tmp_path, length=400), "seqinfo.ini says 400 frames (seqLength), and the last with a box is 40")
    assert not has(read_mot(tmp_path, length=40), "seqLength") and not has(read_mot(tmp_path, length=0), "seqLength")
    given = mot(tmp_path, Video.of(noise_px=1))
    lines = given[1].read_text().splitlines()
    shifted = (line.partition(",") for line in lines if not line.startswith("1,"))  # nothing is detected in the first
    given[1].write_text("".join(f"{int(frame) - 1},{rest}\n" for frame, _, rest in shifted))
    refused("frames count from 0, must count from 1", *given)
    labelled = read_mot(tmp_path, ReadOptions(image_size_px=(640, 480), category_offset=1))
    assert has(labelled, "--image-size is not used: seqinfo.ini says 1920 x 1080", "--category-offset is not used: MOT")
    given = ReadOptions(("a", "b", "c"), (640, 480), frame_rate_hz=5)
    labelled = read_pair("day", *coco(tmp_path, VIDEO, RIGHT, RIGHT), given)
    assert has(labelled, "--labels is not used: COCO", "--image-size is not used: COCO")
    given = ReadOptions(NAMES, (WIDTH, HEIGHT), frame_rate_hz=5, category_offset=-1)
    labelled = read_pair("day", *yolo(tmp_path, VIDEO), replace(given, first_frame=0))
    assert has(labelled, "--first-frame is not used: YOLO", "--category-offset is not used: YOLO")
    truth, found = mot(tmp_path, VIDEO, tail=lambda k, j: "1,1,0")
    info = tmp_path / "seqinfo.ini"
    info.write_bytes(b"\xef\xbb\xbf" + info.read_bytes())
    assert len(read_pair("day", truth, found).images) == 40
    labelled, kind = read_truth(truth)
    assert kind == "MOT" and has(labelled, "the visibility of 240 of 240 boxes is 0", "the eighth column is the class")
    mot(tmp_path, VIDEO, tail=lambda k, j: f"{int(j > 0)},1,{int(j > 0)}")  # what is hidden is not considered
    assert not has(read_truth(truth)[0], "boxes is 0")


def test_numbers_of_classes_that_differ_get_one_name_and_a_track_in_place_of_a_confidence_is_named(tmp_path):
    from modsim3d.learn.learn_detector import LearnOptions, learn_detector
    from modsim3d.learn.learned_detector import LearnSettings

    labelled = read_mot(tmp_path, found_tail="0.9,8,-1,-1")
    told = learn_detector(labelled, LearnSettings(replicates=20), LearnOptions()).remarks
    assert any("In MOT, --labels can give the numbers of both files one name" in remark for remark in told)
    labelled = read_mot(tmp_path, ReadOptions(("boat",) * 8), found_tail="0.9,8,-1,-1")
    assert labelled.labels == ("boat",) and labelled.ids.labels == (1,)
    assert parsed_names("a, b,", "--labels") == ("a", "b")
    with pytest.raises(InputError, match="the name 2 is empty"):
        parsed_names("a,,b", "--labels")
    with pytest.raises(InputError, match="whole numbers may be tracks or classes, not confidences"):
        read_mot(tmp_path, found_tail="7,-1,-1,-1")
    labelled = read_mot(tmp_path, found_tail="1,-1,-1,-1")
    assert has(labelled, "all 240 confidences are 1: if that is the number of a track")
    folders = yolo(tmp_path, VIDEO)
    for tail, told in ((" 0.9 12", None), (" 12", "whole numbers may be tracks"), (" 0.9 0.5", "has 7 numbers")):
        for path in folders[1].glob("*.txt"):
            path.write_text("".join(f"{' '.join(line.split()[:5])}{tail}\n" for line in path.read_text().splitlines()))
        if told:
            refused(told, *folders, SIZED)
        else:
            assert (read_pair("day", *folders, SIZED).results.confidence == 0.9).all()


NAME_FILES = {
    "classes.txt": "boat\nsailboat\nship\n",
    "labels/classes.txt": "\ufeffboat\r\nsailboat\r\nship\r\n",
    "obj.names": "boat\nsailboat\nship",
    "labels/obj.names": "boat\nsailboat\nship\n\n",
    "data.yaml": "names: [boat, sailboat, ship]\n",
    "dataset.yaml": "path: .\nnames:\n  0: boat\n  1: sailboat\n  2: ship\n",
    "labels/classes.txt ": "boat, sailboat, ship\n",
    "classes.txt ": "['boat', 'sailboat', 'ship']\n",
}


@pytest.mark.parametrize(("file", "text"), NAME_FILES.items())
def test_names_of_classes_are_found_in_the_files_of_other_programs(tmp_path, file, text):
    folders = yolo(tmp_path, VIDEO)
    (folders[0] / file.strip()).write_bytes(text.encode())
    labelled = read_pair("day", *folders, SIZED)
    assert labelled.labels == NAMES and not has(labelled, "no name is known")


def test_cvats_folders_are_read_as_they_are_and_classes_without_names_are_told(tmp_path):
    truth, found = yolo(tmp_path, VIDEO)
    told = f"{truth}: no name is known of class_0, class_1, class_2: give --labels or classes.txt"
    assert told in read_pair("day", truth, found, SIZED).notes
    (truth / "data.yaml").write_text("names: {0: boat, 2: ship}\n")
    labelled = read_pair("day", truth, found, SIZED)
    assert labelled.labels == ("boat", "class_1", "ship") and has(labelled, "no name is known of class_1: give")
    given = replace(SIZED, labels=("a", "class_1", "b"))
    assert not has(read_pair("day", truth, found, given), "no name is known")
    (truth / "data.yaml").unlink()
    (truth / "labels").rename(truth / "obj_train_data")
    (truth / "obj.names").write_text("boat\nsailboat\nship\n")
    (truth / "obj.data").write_text("classes = 3\nnames = data/obj.names\n")
    (truth / "train.txt").write_text("data/obj_train_data/000.png\ndata/obj_train_data/without.png\n")
    for folder in (truth, truth / "obj_train_data"):
        labelled = read_pair("day", folder, found, SIZED)
        assert labelled.labels == NAMES and ("without" in labelled.images.names) is (folder == truth)


@pytest.mark.parametrize(
    ("file", "text", "told"),
    [("data.yaml", "names: boat sailboat ship\n", r"names: must be a list of names \(got 'boat sailboat ship'\)"),
     ("dataset.yaml", "names: 3\n", r"names: must be a list of names \(got 3\)"),
     ("classes.txt", "boat\n\nship\n", "the class 1, counted from 0, has no name"),
     ("data.yaml", 'names: [boat, "", ship]\n', "the class 1, counted from 0, has no name"),
     ("data.yaml", "names: [boat, ~, ship]\n", "the class 1, counted from 0, has no name"),
     ("classes.txt", "# classes\nboat\nsailboat\nship\n", "the first class would be '# classes'"),
     ("classes.txt", "0: boat\n1: sailboat\n2: ship\n", "the first class would be '0: boat'"),
     ("obj.names", "0 boat\n1 sailboat\n2 ship\n", "the first class would be '0 boat'")],
)  # fmt: skip
def test_files_of_names_that_have_none_are_refused(tmp_path, file, text, told):
    folders = yolo(tmp_path, VIDEO)
    (folders[0] / file).write_text(text)
    refused(told, *folders, SIZED)
