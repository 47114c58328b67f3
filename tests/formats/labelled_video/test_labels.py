"""Which of the detector's labels the classes of a file are."""

import numpy as np

from modsim3d.formats.labelled_video.detect_truth import class_numbers
from modsim3d.formats.labelled_video.targets import FileClasses, to_labels


def test_classes_of_mot_are_known_by_the_names_that_learning_gives_them() -> None:
    classes = FileClasses("MOT", ("class_1", "class_2", "class_3"), (1, 2, 3))
    used = np.array([True, False, True])
    labels = ("class_3", "class_1", "class_9")
    found, notes = to_labels(classes, used, None, labels)
    assert (found.tolist(), notes) == ([1, -1, 0], [])
    assert class_numbers(classes, found.tolist(), labels) == {"class_3": 3, "class_1": 1, "class_9": 4}


def test_several_categories_may_be_one_label_whose_number_is_that_of_the_first() -> None:
    classes = FileClasses("COCO", ("ferry", "tug", "buoy"), (7, 5, 6))
    found, _ = to_labels(classes, np.array([True, True, True]), ("ship", "ship", "-"), ("boat", "ship"))
    assert found.tolist() == [1, 1, -1]
    assert class_numbers(classes, found.tolist(), ("boat", "ship", "kayak")) == {"boat": 8, "ship": 7, "kayak": 9}
