"""Numbers and texts of labelled files that cannot be what their column or key says."""

import json
from dataclasses import replace

import numpy as np
import pytest

from modsim3d.cli.detect import parsed_names
from modsim3d.core.errors import InputError
from modsim3d.formats.reading.builder import Problems, ReadOptions, read_flag
from modsim3d.formats.reading.pair import read_pair, read_truth
from tests.formats.labelled_files import CHANGES, HEIGHT, NAMES, WIDTH, Video, coco, mot, refused, yolo

RIGHT = CHANGES["right"]
VIDEO = Video.of()
SIZED = ReadOptions(image_size_px=(WIDTH, HEIGHT))


def read_mot(folder, options=ReadOptions(), **given):  # noqa: B008
    return read_pair("day", *mot(folder, VIDEO, **given), options)


def has(labelled, *parts):
    return [part for part in parts if not any(part in note for note in labelled.notes)] == []


FLAGS = [(each, True) for each in (1, 1.0, True, "1", "true", " True ", "1.0")]
FLAGS += [(each, False) for each in (None, 0, 0.0, False, "0", "false", "FALSE")]


def test_flags_are_numbers_truth_values_or_texts_and_nothing_else():
    for value, flag in FLAGS:
        problems = Problems("a file")
        assert read_flag(value, "flag", "here", problems) is flag and not problems.count
    for value in ("no", "yes", "", "2", 2, -1, 0.5, [], {}, [0], "none", "nan"):
        problems = Problems("a file")
        read_flag(value, "flag", "here", problems)
        assert problems.count == 1


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


def test_separators_of_spreadsheets_and_decimal_commas_are_named(tmp_path):
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


def test_columns_of_other_data_sets_are_no_visibility_and_what_is_read_is_told(tmp_path):
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


def test_numbers_of_frames_are_held_against_the_sequence(tmp_path):
    assert has(read_mot(tmp_path, length=3), "seqinfo.ini says 3 frames (seqLength), and the last with a box is 40")
    assert has(read_mot(tmp_path, length=400), "seqinfo.ini says 400 frames (seqLength), and the last with a box is 40")
    assert not has(read_mot(tmp_path, length=40), "seqLength") and not has(read_mot(tmp_path, length=0), "seqLength")
    with pytest.raises(InputError, match=r"frame must be a whole number from 1 (.|\n)*in this file perhaps from 0"):
        read_mot(tmp_path, first=0)
    given = mot(tmp_path, Video.of(noise_px=1))
    lines = given[1].read_text().splitlines()
    shifted = (line.partition(",") for line in lines if not line.startswith("1,"))  # nothing is detected in the first
    given[1].write_text("".join(f"{int(frame) - 1},{rest}\n" for frame, _, rest in shifted))
    refused("frames count from 0, must count from 1", *given)


def test_options_that_do_nothing_and_sizes_that_are_not_used_are_told(tmp_path):
    labelled = read_mot(tmp_path, ReadOptions(image_size_px=(640, 480), category_offset=1))
    assert has(labelled, "--image-size is not used: seqinfo.ini says 1920 x 1080", "--category-offset is not used: MOT")
    given = ReadOptions(("a", "b", "c"), (640, 480), frame_rate_hz=5)
    labelled = read_pair("day", *coco(tmp_path, VIDEO, RIGHT, RIGHT), given)
    assert has(labelled, "--labels is not used: COCO", "--image-size is not used: COCO")
    given = ReadOptions(NAMES, (WIDTH, HEIGHT), frame_rate_hz=5, category_offset=-1)
    labelled = read_pair("day", *yolo(tmp_path, VIDEO), given)
    assert has(labelled, "--frame-rate is not used: YOLO", "--category-offset is not used: YOLO")


def test_numbers_of_classes_that_differ_between_the_files_of_mot_get_one_name_by_labels_without_gaps(tmp_path):
    from modsim3d.learn.learn_detector import LearnOptions, learn_detector
    from modsim3d.learn.learned import LearnSettings

    labelled = read_mot(tmp_path, found_tail="0.9,8,-1,-1")
    told = learn_detector(labelled, LearnSettings(replicates=20), LearnOptions()).remarks
    assert any("In MOT, --labels can give the numbers of both files one name" in remark for remark in told)
    labelled = read_mot(tmp_path, ReadOptions(("boat",) * 8), found_tail="0.9,8,-1,-1")
    assert labelled.labels == ("boat",) and labelled.ids.labels == (1,)
    assert parsed_names("a, b,", "--labels") == ("a", "b")
    with pytest.raises(InputError, match="the name 2 is empty"):
        parsed_names("a,,b", "--labels")


def test_a_track_that_stands_where_a_confidence_should_is_named(tmp_path):
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


def test_the_marks_of_a_seqinfo_are_passed_over_and_truth_alone_says_the_same(tmp_path):
    truth, found = mot(tmp_path, VIDEO, tail=lambda k, j: "1,1,0")
    info = tmp_path / "seqinfo.ini"
    info.write_bytes(b"\xef\xbb\xbf" + info.read_bytes())
    assert len(read_pair("day", truth, found).images) == 40
    labelled, kind = read_truth(truth)
    assert kind == "MOT" and has(labelled, "the visibility of 240 of 240 boxes is 0", "the eighth column is the class")
    mot(tmp_path, VIDEO, tail=lambda k, j: f"{int(j > 0)},1,{int(j > 0)}")  # what is hidden is not considered
    assert not has(read_truth(truth)[0], "boxes is 0")
