"""Labels of the detector for the classes of a file, and what is visible of boxes, from the boxes alone."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from modsim3d.formats.labelled_video.detect_truth import class_numbers
from modsim3d.formats.labelled_video.targets import FileClasses, to_labels, visible_fractions

SIDE = 12
CORNER = st.integers(0, SIDE - 1)
BOX = st.tuples(CORNER, CORNER, st.integers(1, 8), st.integers(1, 8))


def painted(boxes: np.ndarray) -> list[float]:
    """The same by painting pixels, one box after the other."""
    fractions = []
    for one in boxes:
        image = np.zeros((40, 40), dtype=bool)
        for x_min, y_min, x_max, y_max in boxes[boxes[:, 3] > one[3]]:
            image[y_min:y_max, x_min:x_max] = True
        part = image[one[1] : one[3], one[0] : one[2]]
        fractions.append(1 - part.mean())
    return fractions


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.lists(BOX, min_size=1, max_size=7))
def test_a_box_is_hidden_by_all_boxes_with_a_lower_foot_as_painting_shows(given_boxes: list[tuple[int, ...]]) -> None:
    boxes = np.array([[x, y, x + width, y + height] for x, y, width, height in given_boxes])
    images = np.zeros(len(boxes), dtype=np.int64)
    found = visible_fractions(images, boxes.astype(float), boxes[:, 3].astype(float))
    assert np.allclose(found, painted(boxes), atol=1e-12)
    shuffled = np.random.default_rng(len(boxes)).permutation(len(boxes))
    again = visible_fractions(images, boxes[shuffled].astype(float), boxes[shuffled, 3].astype(float))
    assert np.allclose(again, found[shuffled], atol=1e-12)


def test_boxes_of_other_images_and_of_the_same_foot_which_may_be_cut_hide_nothing() -> None:
    boxes = np.tile([[0.0, 0.0, 10.0, 10.0]], (3, 1))
    assert visible_fractions(np.array([0, 0, 1]), boxes, boxes[:, 3]).tolist() == [1, 1, 1]
    assert visible_fractions(np.array([0, 0, 1]), boxes, np.array([9.0, 10.0, 99.0])).tolist() == [0, 1, 1]
    boxes = np.array([[0.0, 0, 10, 10], [5, 0, 15, 10]])  # the foot counts where it was before the box was cut
    assert visible_fractions(np.zeros(2, dtype=np.int64), boxes, np.array([14.0, 11.0])).tolist() == [1, 0.5]


def test_classes_of_mot_have_the_names_that_learning_gives_them_and_several_may_be_one_label() -> None:
    classes = FileClasses("MOT", ("class_1", "class_2", "class_3"), (1, 2, 3))
    labels = ("class_3", "class_1", "class_9")
    found, notes = to_labels(classes, np.array([True, False, True]), None, labels)
    assert (found.tolist(), notes) == ([1, -1, 0], [])
    assert class_numbers(classes, found.tolist(), labels) == {"class_3": 3, "class_1": 1, "class_9": 4}
    classes = FileClasses("COCO", ("ferry", "tug", "buoy"), (7, 5, 6))  # whose label's number is that of the first
    found, _ = to_labels(classes, np.array([True, True, True]), ("ship", "ship", "-"), ("boat", "ship"))
    assert found.tolist() == [1, 1, -1]
    assert class_numbers(classes, found.tolist(), ("boat", "ship", "kayak")) == {"boat": 8, "ship": 7, "kayak": 9}
