"""Labels stay inside the picture and off each other."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from modsim3d.core.boxes import intersections
from modsim3d.view.pictures.canvas import Canvas, Label, draw_labels

ORANGE, BOX = (200, 100, 0), (0.0, 0.0, 30.0, 10.0)


def drawn(labels, size, keep_clear):
    """Text and plate of each label that is drawn."""
    canvas, found = Canvas(Image.new("RGB", size)), []
    canvas.plate = lambda x, y, text, colour: found.append((text, (x, y, *np.add((x, y), canvas.plate_size(text)))))
    assert draw_labels(canvas, labels, keep_clear) == len(found)
    return found


def drawn_plates(boxes, width, height):
    labels = [Label(tuple(box), "Vessel 0.67", ORANGE) for box in boxes]
    return [plate for _, plate in drawn(labels, (width, height), boxes)]


def texts_drawn(labels, size, keep_clear):
    return [text for text, _ in drawn(labels, size, keep_clear)]


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([(320, 213), (1280, 853), (90, 20)]), st.integers(0, 25))
def test_plates_are_in_the_picture_and_share_no_pixel(seed, size, count):
    rng = np.random.default_rng(seed)
    low = rng.uniform(-0.2, 1.1, (count, 2)) * size
    boxes = np.concatenate([low, low + rng.uniform(1, 200, (count, 2))], axis=1).tolist()
    plates = drawn_plates(boxes, *size)
    assert len(plates) <= count
    for i, (x0, y0, x1, y1) in enumerate(plates):
        assert x0 >= 0 and y0 >= 0 and x1 <= size[0] and y1 <= size[1]
        for a0, b0, a1, b1 in plates[:i]:
            assert min(x1, a1) <= max(x0, a0) or min(y1, b1) <= max(y0, b0)


def test_a_label_alone_stands_on_its_box_and_one_of_a_box_outside_the_picture_is_left_out():
    ((x0, _, _, y1),) = drawn_plates([[300.0, 200.0, 400.0, 260.0]], 1280, 853)
    assert (x0, y1) == (300, 200 - 2)
    assert len(drawn_plates([[600.0, 400.0, 630.0, 420.0]] * 8, 1280, 853)) == 8  # there is room for all
    assert drawn_plates([[-90.0, 0.0, -10.0, 50.0], [0.0, 900.0, 50.0, 950.0]], 1280, 853) == []


def test_labels_of_vessels_keep_their_places_whichever_is_most_confident_and_whatever_the_digits():
    boats = {name: (40.0 + 30 * i, 100.0, 65.0 + 30 * i, 120.0) for i, name in enumerate("abcd")}
    places = []
    for texts in (
        ("boat 0.61", "boat 0.99", "boat 0.70", "boat 0.58"),
        ("boat 0.71", "boat 0.51", "boat 0.44", "boat 0.93"),
    ):
        labels = [Label(box, text, ORANGE, vessel=name) for (name, box), text in zip(boats.items(), texts, strict=True)]
        found = drawn(sorted(labels, key=lambda label: label.text), (320, 200), [*boats.values()])
        places.append({text: plate[:2] for text, plate in found})
        places[-1] = [places[-1][text] for text in texts]
    assert places[0] == places[1]


def test_places_never_lie_on_taken_ones():
    places = np.array([[10.0, 0.0, 20.0, 10.0], [9.0, 9.0, 12.0, 12.0]])
    np.testing.assert_array_equal(intersections(places[:, None], np.array([[0.0, 0.0, 10.0, 10.0]])), [[0.0], [1.0]])


def test_labels_cover_no_boat_where_there_is_room_elsewhere():
    """Thirty boats in two rows: the labels go to the free sea and sky."""
    boats = [[40.0 * i + 20, y, 40.0 * i + 55, y + 30] for i in range(15) for y in (300.0, 350.0)]
    plates = np.array(drawn_plates(boats, 640, 640))
    assert len(plates) == 30 and intersections(plates[:, None], np.array(boats)).max() == 0


def test_a_text_is_shortened_only_where_it_would_cover_a_boat_and_an_optional_label_gives_way():
    beside, label = [(36.0, 0.0, 100.0, 40.0)], Label(BOX, "Vessel 0.67", ORANGE, short="0.67")
    assert texts_drawn([label], (100, 40), []) == ["Vessel 0.67"]
    assert texts_drawn([label], (100, 40), beside) == ["0.67"]
    assert texts_drawn([Label(BOX, "Vessel 0.67", ORANGE)], (100, 40), beside) == ["Vessel 0.67"]
    hidden, seen = Label(BOX, "hidden", ORANGE, optional=True), Label(BOX, "seen", ORANGE)
    assert texts_drawn([hidden, seen], (60, 24), []) == ["seen"]
    assert texts_drawn([hidden], (60, 40), []) == ["hidden"]
    assert texts_drawn([hidden], (60, 40), [(0.0, 0.0, 60.0, 40.0)]) == []


def test_words_stand_apart_in_any_size():
    for width in (640, 960, 1280):
        canvas = Canvas(Image.new("RGB", (width, 400)))
        wide, joined = canvas.plate_size("ship2, 74 % seen")[0], canvas.plate_size("ship2,74%seen")[0]
        assert (wide - joined) / 3 >= canvas.text_px / 5, width
