"""Labels are off each other; wrong classes and boxes that do not fit are marked in pictures and named in legends."""

from dataclasses import replace
from functools import reduce
from operator import or_

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from modsim3d import CameraView, StoredRun, load_scene, open_run, simulate_frames
from modsim3d.core.boxes import intersections
from modsim3d.render.id_pass import PlainIds
from modsim3d.runs.counts import NOTHING_WRONG, Outcome, frame_outcomes
from modsim3d.runs.frames import detected_rows
from modsim3d.runs.selection import select
from modsim3d.view import palette
from modsim3d.view.films.plan import FilmPlan, mistakes_in, vessels_in
from modsim3d.view.films.renderer import FilmRenderer
from modsim3d.view.pictures import close_up, contact_sheet, frame_picture
from modsim3d.view.pictures.canvas import Canvas, Label, Window, draw_labels, text_size
from modsim3d.view.pictures.contact_sheet import pick_highlights
from modsim3d.view.pictures.layers import DETECTIONS, NAMES, WEATHER, Layers, fate, is_a
from modsim3d.view.pictures.legend import detection_entries
from modsim3d.view.sea_and_sky import RenderStyle
from tests.scenes import crossing

ORANGE, BOX = (200, 100, 0), (0.0, 0.0, 30.0, 10.0)


def placed(labels, size, keep_clear):
    """Text and plate of each label that is placed."""
    canvas, found = Canvas(Image.new("RGB", size)), []
    canvas.plate = lambda x, y, text, colour: found.append((text, (x, y, *np.add((x, y), canvas.plate_size(text)))))
    assert draw_labels(canvas, labels, keep_clear) == len(found)
    return found


def drawn_plates(boxes, width, height):
    labels = [Label(tuple(box), "Vessel 0.67", ORANGE) for box in boxes]
    return [plate for _, plate in placed(labels, (width, height), boxes)]


def texts_drawn(labels, size, keep_clear):
    return [text for text, _ in placed(labels, size, keep_clear)]


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


def test_a_label_stands_on_its_box_keeps_its_place_and_covers_no_boat():
    ((x0, _, _, y1),) = drawn_plates([[300.0, 200.0, 400.0, 260.0]], 1280, 853)
    assert (x0, y1) == (300, 200 - 2)
    assert len(drawn_plates([[600.0, 400.0, 630.0, 420.0]] * 8, 1280, 853)) == 8  # there is room for all
    assert drawn_plates([[-90.0, 0.0, -10.0, 50.0], [0.0, 900.0, 50.0, 950.0]], 1280, 853) == []
    boats = {name: (40.0 + 30 * i, 100.0, 65.0 + 30 * i, 120.0) for i, name in enumerate("abcd")}
    places = []
    for texts in (
        ("boat 0.61", "boat 0.99", "boat 0.70", "boat 0.58"),
        ("boat 0.71", "boat 0.51", "boat 0.44", "boat 0.93"),
    ):
        labels = [Label(box, text, ORANGE, vessel=name) for (name, box), text in zip(boats.items(), texts, strict=True)]
        found = placed(sorted(labels, key=lambda label: label.text), (320, 200), [*boats.values()])
        places.append({text: plate[:2] for text, plate in found})
        places[-1] = [places[-1][text] for text in texts]
    assert places[0] == places[1]
    places = np.array([[10.0, 0.0, 20.0, 10.0], [9.0, 9.0, 12.0, 12.0]])
    np.testing.assert_array_equal(intersections(places[:, None], np.array([[0.0, 0.0, 10.0, 10.0]])), [[0.0], [1.0]])
    # Thirty boats in two rows: the labels go to the free sea and sky.
    boats = [[40.0 * i + 20, y, 40.0 * i + 55, y + 30] for i in range(15) for y in (300.0, 350.0)]
    plates = np.array(drawn_plates(boats, 640, 640))
    assert len(plates) == 30 and intersections(plates[:, None], np.array(boats)).max() == 0


def test_a_text_is_shortened_only_where_it_would_cover_a_boat_and_its_words_stand_apart():
    beside, label = [(36.0, 0.0, 100.0, 40.0)], Label(BOX, "Vessel 0.67", ORANGE, short="0.67")
    assert texts_drawn([label], (100, 40), []) == ["Vessel 0.67"]
    assert texts_drawn([label], (100, 40), beside) == ["0.67"]
    assert texts_drawn([Label(BOX, "Vessel 0.67", ORANGE)], (100, 40), beside) == ["Vessel 0.67"]
    hidden, seen = Label(BOX, "hidden", ORANGE, optional=True), Label(BOX, "seen", ORANGE)
    assert texts_drawn([hidden, seen], (60, 24), []) == ["seen"]
    assert texts_drawn([hidden], (60, 40), []) == ["hidden"]
    assert texts_drawn([hidden], (60, 40), [(0.0, 0.0, 60.0, 40.0)]) == []
    for width in (640, 960, 1280):
        canvas = Canvas(Image.new("RGB", (width, 400)))
        wide, joined = canvas.plate_size("ship2, 74 % seen")[0], canvas.plate_size("ship2,74%seen")[0]
        assert (wide - joined) / 3 >= canvas.text_px / 5, width


MARKED = Layers.of(["detections", "mistakes"])
ALL = reduce(or_, Outcome)


@pytest.fixture(scope="module")
def seen(tmp_path_factory) -> CameraView:
    """A frame in which the sail is detected."""
    scene = load_scene(crossing(tmp_path_factory.mktemp("marks")), source="analytic")
    frame = next(frame for frame in simulate_frames(scene) if "sail" in frame.detections.vessels)
    return CameraView.of(scene, frame)


def with_detection(seen: CameraView, away_px: float, label: str = "Vessel", size: float = 60.0) -> CameraView:
    """The frame with one detection: a square whose upper left corner is away from that of the sail's annotated box."""
    truth, boxes_px = seen.frame.truth, seen.frame.truth.boxes_px.copy()
    sail = truth.vessels.index("sail")
    corner = boxes_px[sail, :2].copy()
    boxes_px[sail, 2:] = corner + 60.0
    box_px = np.add([[*corner, *(corner + size)]], (away_px, 0, away_px, 0))
    one = {"labels": (label,), "kinds": ("true",), "vessels": ("sail",), "confidence": np.array([0.7])}
    only = replace(seen.frame.detections, **one, boxes_px=box_px, errors_px=np.zeros((1, 4)))
    return replace(seen, frame=replace(seen.frame, truth=replace(truth, boxes_px=boxes_px), detections=only))


def drawn(camera_view: CameraView, layers: Layers = MARKED) -> np.ndarray:
    """The whole image at its own size."""
    window = Window.whole(camera_view.image_size_px, camera_view.image_size_px[0])
    return np.asarray(frame_picture.frame_picture(camera_view, window, layers, PlainIds(), nominal_width_px=1280))


def box_of(camera_view: CameraView) -> list[int]:
    return [round(side) for side in camera_view.frame.detections.boxes_px[0].tolist()]


def is_alarm(pixels: np.ndarray) -> np.ndarray:
    """Vermilion, also where a slanted line is half over something else."""
    return np.abs(pixels.astype(int) - palette.ALARM).sum(axis=-1) < 90


def test_a_right_box_is_solid_a_wrong_class_fills_its_corner_and_a_bad_box_is_dashed_and_joined(seen):
    right, wrong = with_detection(seen, 0), with_detection(seen, 0, "Buoy")
    assert frame_outcomes(right.frame) == [NOTHING_WRONG]
    picture, (x0, y0, x1, y1) = drawn(right), box_of(right)
    assert (picture[y0, x0:x1] == right.colour("sail")).all() and not is_alarm(picture).any()
    np.testing.assert_array_equal(picture, drawn(right, Layers(detections=True)))
    picture = drawn(wrong)
    corner = is_alarm(picture[y0 + 1 : y0 + 9, x1 - 9 : x1 - 1])
    assert corner[np.triu_indices(8, 1)].all() and not is_alarm(picture[y0:y1, x0 : x1 - 18]).any()
    assert not is_alarm(drawn(wrong, Layers(detections=True))).any()
    for size, least, most in ((60, 0.4, 0.7), (12, 0, 0.8), (16, 0, 0.8), (40, 0, 0.8)):
        bad = with_detection(seen, 40, size=size)
        assert frame_outcomes(bad.frame) == [Outcome.BELOW_HALF_IOU]
        picture, (x0, y0, x1, _) = drawn(bad), box_of(bad)
        assert least <= (picture[y0, x0:x1] == bad.colour("sail")).all(axis=-1).mean() < most
        assert not is_alarm(picture).any()
    off = with_detection(seen, 200)
    assert frame_outcomes(off.frame) == [Outcome.BELOW_HALF_IOU | Outcome.OFF_VESSEL]
    picture, (x0, y0, x1, y1) = drawn(off), box_of(off)
    row, left, middle = (y0 + y1) // 2, x0 - 200 + 60, (x0 + x1) // 2
    assert is_alarm(picture[row - 1 : row + 2, left + 2 : middle]).any(axis=0).all()
    assert not is_alarm(picture[:, : left - 2]).any()


@pytest.fixture
def labels(monkeypatch) -> list[Label]:
    collected = []
    monkeypatch.setattr(frame_picture, "draw_labels", lambda canvas, labels, boxes: collected.extend(labels))
    return collected


@pytest.fixture(scope="module")
def run(mistaken_folder) -> StoredRun:
    return open_run(mistaken_folder)


def test_highlights_have_each_kind_of_mistake_and_the_fate_in_a_merged_box_is_said(run):
    said, areas = [], {}
    highlights = pick_highlights(run.finished_tables, run.scene)
    for highlight in highlights:
        said.append(contact_sheet._caption(highlight, run.frame(highlight.camera, highlight.step)))
        x0, y0, x1, y1 = highlight.focus_px
        assert x0 < x1 and y0 < y1
    for ending in ("detected", "with IoU below 0.5", "by a box off the vessel", "missed"):
        assert any(text.endswith(ending) for text in said), ending
    assert any("detected as " in text for text in said) and any(text.startswith("a false positive") for text in said)
    assert len(set(said)) == len(said)
    for frame in run.frames():
        for row, outcome in zip(detected_rows(frame), frame_outcomes(frame), strict=True):
            if row is not None and outcome & Outcome.OFF_VESSEL:
                x0, y0, x1, y1 = frame.truth.boxes_px[row]
                areas[frame.camera, frame.step, frame.truth.vessels[row]] = (x1 - x0) * (y1 - y0)
    chosen = [(each.camera, each.step, each.vessel) for each in highlights if not each.what]  # about a detection
    assert max(areas, key=areas.__getitem__) in chosen
    frame = next(frame for frame in run.frames() if "merged" in frame.detections.kinds)
    annotated = np.array(frame.truth.vessels)[frame.truth.annotated].tolist()
    assert "detected, in one box with another" in [fate(frame, vessel) for vessel in annotated]


def test_each_picture_of_the_sheet_points_at_what_it_is_about_and_names_only_that(run, labels, monkeypatch):
    arrows: list[tuple] = []
    monkeypatch.setattr(close_up.Canvas, "arrow", lambda canvas, *arrow: arrows.append(arrow))
    for highlight in pick_highlights(run.finished_tables, run.scene):
        labels.clear(), arrows.clear()
        frame = run.frame(highlight.camera, highlight.step)
        camera_view = CameraView.of(run.scene, frame)
        contact_sheet._tile(highlight, camera_view, PlainIds())
        assert {label.vessel for label in labels} <= {highlight.vessel}
        assert highlight.vessel is not None or len(labels) == 1
        wide, high = contact_sheet.PANEL_PX
        window = Window.around(highlight.focus_px, camera_view.image_size_px, (wide, high))
        x0, y0, x1, y1 = window.corners(np.array(highlight.focus_px))
        (((x, y), (right, down), length),) = arrows
        assert x0 - 9 <= x <= x1 + 9 and y0 - 9 <= y <= y1 + 9
        assert 0 <= x - right * length <= wide and 0 <= y - down * length <= high
        assert "obstacle:" not in contact_sheet._caption(highlight, frame)


def test_captions_are_cut_arrows_cover_no_boat_and_the_legend_names_the_mistakes():
    def said(layers, mistakes):
        return {entry.text for entry in detection_entries(layers, 2, mistakes)}

    none = said(DETECTIONS, NOTHING_WRONG)
    assert said(DETECTIONS, ALL) - none == {"wrong class", "IoU below 0.5", "off its vessel"}
    assert said(DETECTIONS, Outcome.MISLABELLED) - none == {"wrong class"}
    assert said(replace(DETECTIONS, mistakes=False), ALL) == none
    short, long = "short", 20 * "a long name "
    cut = contact_sheet._shortened(long, 17, 400)
    assert contact_sheet._shortened(short, 17, 400) == short
    assert 380 < text_size(cut, 17)[2] <= 400 and cut.endswith("…") and long.startswith(cut[:-1])
    row = {"occluded_by": [{"id": "obstacle:south_hill", "px": 9.0}], "visible_fraction": 0.5}
    assert contact_sheet._hidden_by(row) == "50 % hidden by south_hill"
    box, above = (300.0, 200.0, 340.0, 230.0), (250.0, 120.0, 390.0, 195.0)
    size = (720, 440)
    arrows = [close_up._arrow(box, others, size, 56) for others in ([box], [box, above])]
    assert arrows == [((320.0, 192.0), (0, 1)), ((320.0, 238.0), (0, -1))]
    assert close_up._arrow((300.0, 10.0, 340.0, 30.0), [], size, 56) == ((320.0, 38.0), (0, -1))


def test_labels_say_true_classes_false_alarms_and_hidden_shares_and_stay_at_their_vessel(seen, labels):
    layers = replace(MARKED, labels=True, false_positives=True)
    drawn(with_detection(seen, 0, "Buoy"), layers)
    drawn(with_detection(seen, 200), layers)
    frame = with_detection(seen, 0).frame
    kinds = {"false_positive": "false", "persistent_false_positive": "false", "duplicate": "duplicate"}
    for kind in kinds:
        drawn(replace(seen, frame=replace(frame, detections=replace(frame.detections, kinds=(kind,)))), layers)
    said = [(label.text, label.colour) for label in labels]
    assert said[:2] == [("Buoy 0.70, is a Vessel", palette.ALARM), ("Vessel 0.70", seen.colour("sail"))]
    assert said[2:] == [(f"{remark}: Vessel 0.70", palette.ALARM) for remark in kinds.values()]
    assert [is_a(label) for label in ("ferry", "oil tanker", "")] == ["is a ferry", "is an oil tanker", "is a "]
    labels.clear()
    share = np.full(len(seen.frame.truth), 0.77)
    truth = replace(seen.frame.truth, visible_fraction=share, detected=share > 0)
    drawn(replace(seen, frame=replace(seen.frame, truth=truth)), Layers(fractions=True))
    assert {label.text for label in labels} == {f"{name}, 77 % seen" for name in truth.vessels}
    labels.clear()
    for away_px in (0.0, 25.0, 80.0):
        drawn(with_detection(seen, away_px), DETECTIONS)
    truth = seen.frame.truth
    at_sail = tuple(truth.full_boxes_px[truth.vessels.index("sail")].tolist())
    assert [label.box for label in labels if label.vessel == "sail" and "0.70" in label.text] == [at_sail] * 3


def test_a_film_names_mistakes_vessels_and_numbers_that_are_there_and_weather_not_drawn(run):
    for steps in ((0, 10), (40, 41), (0, run.steps)):
        times = [float(text) for text in run.scene.timestamps(*steps)]
        selection = select(run, (0, 1), from_s=times[0], to_s=times[-1])
        shown = [frame for step in selection.step_frames() for frame in step.frames if frame is not None]
        expected = reduce(or_, (outcome for frame in shown for outcome in frame_outcomes(frame)), NOTHING_WRONG)
        assert mistakes_in(selection) == expected
        layout = FilmPlan(("detections",), (0, 1), 640, mistakes=expected).layout(run.scene)
        named = {entry.text for entry in layout.entries} & {NAMES[flag] for flag in Outcome}
        assert named == {NAMES[flag] for flag in Outcome if flag & expected} | {"false positive"}
    selection, names = select(run, (1,), from_s=0, to_s=1), run.scene.vessel_names
    frames = [frame for step in selection.step_frames() for frame in step.frames if frame is not None]
    shown = {vessel for frame in frames for vessel in frame.truth.vessels}
    assert {names[index] for index in vessels_in(selection)} == shown
    box = tuple(frames[0].truth.full_boxes_px[0].tolist())
    assert names.index(frames[0].truth.vessels[0]) in vessels_in(selection, (box,))
    assert vessels_in(selection, ((0.0, 0.0, 1.0, 1.0),)) == ()  # the sky
    plan = FilmPlan(("scene",), (1,), 640, vessels=vessels_in(selection))
    assert {entry.text.split(": ")[1] for entry in plan.layout(run.scene).entries} == shown
    few, many = (FilmPlan(("scene",), (0,), 640, vessels=tuple(range(count))) for count in (12, 13))
    assert not few.layers_of("scene").numbers and many.layers_of("scene").numbers
    (step,) = select(run, (0, 1), from_s=0, to_s=0).step_frames()
    for style, is_told in ((RenderStyle(), True), (RenderStyle(shaded=True, night=True), False)):
        plan = FilmPlan(("detections",), (0, 1), 640, style=style, boxes_on_scene=style.shaded)
        head = FilmRenderer(run.scene, plan, PlainIds())._head(step)
        assert head[-1 - is_told].startswith("detector ") and (head[-1] == WEATHER) == is_told
