"""Pictures of frames, and frame.plot(), which has axes around them; what they look like has been looked at."""

import pickle
import sys
from dataclasses import fields, replace

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.offsetbox import AnnotationBbox
from PIL import Image, ImageDraw

import modsim3d
from modsim3d import ModsimError, Scene, Window, load_scene, simulate_frames
from modsim3d.render.id_pass import PlainIds
from modsim3d.runs.counts import NOTHING_WRONG, Outcome, frame_outcomes
from modsim3d.view import frame_plot, palette
from modsim3d.view.pictures import id_buffer as ids_module
from modsim3d.view.pictures import legend as legend_module
from modsim3d.view.pictures.frame_picture import CameraView, FrameTracks, frame_picture, silhouette_mask
from modsim3d.view.pictures.id_buffer import ids_picture
from modsim3d.view.pictures.layers import DETECTIONS, NAMES, SCENE, WEATHER, Layers
from modsim3d.view.pictures.legend import LegendEntry, detection_entries, id_entries, legend, letters
from modsim3d.view.pictures.plain import Solids, background, below_horizon
from tests.scenes import crossing, mistaken_strait

SIZES = (320, 1280, 3600)


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Scene:
    return load_scene(crossing(tmp_path_factory.mktemp("painter")))


@pytest.fixture(scope="module")
def camera_views(scene) -> list[CameraView]:
    return [CameraView.of(scene, frame) for frame in simulate_frames(scene)]


@pytest.fixture(scope="module")
def hiding(camera_views) -> CameraView:
    """The ship hides a boat in part."""
    return next(view for view in camera_views if 0.05 < min(view.frame.truth.visible_fraction, default=1.0) < 0.95)


def count(picture: Image.Image, colour) -> int:
    return int((np.asarray(picture) == colour).all(axis=-1).sum())


def whole(camera_view: CameraView, width: int) -> Window:
    return Window.whole(camera_view.image_size_px, width)


@pytest.mark.parametrize("roll", [0.0, 0.1, -2.0, np.pi])
def test_sea_is_where_the_half_plane_says_and_outside_the_image_is_paper(roll):
    half_plane = np.array([np.sin(roll), np.cos(roll), -300 * np.cos(roll) - 400 * np.sin(roll)])
    picture = np.asarray(background(Window(-100, -50, 1, (1000, 700)), half_plane, (800, 600)))
    inside = (slice(50, 650), slice(100, 900))
    x, y = np.meshgrid(np.arange(800) + 0.5, np.arange(600) + 0.5)
    distance = half_plane[0] * x + half_plane[1] * y + half_plane[2]
    for colour, wanted in ((palette.SEA, distance > 1), (palette.SKY, distance < -1)):
        assert (picture[inside][wanted] == colour).all()
    outside = np.ones(picture.shape[:2], dtype=bool)
    outside[inside] = False
    assert (picture[outside] == palette.PAPER).all()


@pytest.mark.parametrize("width", SIZES)
def test_a_picture_has_the_size_asked_for_and_truth_where_it_is(hiding, width):
    window = whole(hiding, width)
    picture = frame_picture(hiding, window, Layers(truth=True), PlainIds())
    assert picture.size == (width, width * 3 // 4)
    for box in hiding.frame.truth.boxes_px[hiding.frame.truth.annotated]:
        x0, y0, x1, y1 = (round(side) for side in window.corners(box))
        assert picture.getpixel(((x0 + x1) // 2, y0)) == palette.TRUTH
        assert picture.getpixel((x0, (y0 + y1) // 2)) == palette.TRUTH


def shown_by(layer: str, view: CameraView) -> CameraView:
    """The view with something that a layer draws, where the scene does not have it."""
    truth, found = view.frame.truth, view.frame.detections
    boxes, none = truth.full_boxes_px, np.zeros(len(truth), dtype=bool)
    whole_boxes = replace(truth, boxes_px=boxes)
    changes = {
        "visible": {"truth": whole_boxes},
        "missed": {"truth": replace(whole_boxes, detected=none)},
        "mistakes": {"detections": replace(found, labels=("Buoy",) * len(found))},
        "false_positives": {"detections": replace(found, vessels=(None,) * len(found))},
    }
    if layer == "tracks":
        tracks = FrameTracks(np.arange(len(boxes)), boxes, none, none, (np.empty((0, 2)),) * len(boxes))
        return replace(view, tracks=tracks)
    return replace(view, frame=replace(view.frame, **changes.get(layer, {})))


@pytest.mark.parametrize("name", [field.name for field in fields(Layers)])
def test_each_layer_draws_something_and_only_when_it_is_on(camera_views, name):
    """Fractions and labels are drawn next to the boxes of others."""
    companions = {"labels": {"detections": True, "missed": True}, "mistakes": {"detections": True}}.get(name, {})
    without, with_it = Layers(**companions), replace(Layers(**companions), **{name: True})
    changed = 0
    for camera_view in (shown_by(name, each) for each in camera_views):
        window = whole(camera_view, 640)
        a, b = (np.asarray(frame_picture(camera_view, window, layers, PlainIds())) for layers in (without, with_it))
        changed += int((a != b).any(axis=-1).sum())
    assert changed > 0


@pytest.mark.parametrize("of_vessels", [True, False])
@pytest.mark.parametrize("kind", ["true", "merged", "split", "persistent_false_positive", "duplicate", "fragment"])
def test_the_one_detection_of_a_vessel_has_its_colour_and_others_are_drawn_as_false_ones(hiding, kind, of_vessels):
    found = hiding.frame.detections
    vessels = found.vessels if of_vessels else (None,) * len(found)
    detections = replace(found, vessels=vessels, kinds=(kind,) * len(found))
    camera_view = replace(hiding, frame=replace(hiding.frame, detections=detections))
    window = whole(camera_view, 1280)
    picture = frame_picture(camera_view, window, Layers.of(["detections", "false_positives"]), PlainIds())
    own = {camera_view.colour(vessel) for vessel in filter(None, found.vessels)}
    if of_vessels and kind in ("true", "merged", "split"):
        assert own and all(count(picture, colour) > 100 for colour in own)
    else:
        assert count(picture, palette.ALARM) > 100
        assert all(count(picture, colour) == 0 for colour in palette.VESSELS)


def test_lines_and_text_grow_with_the_picture_and_wires_go_through_the_corner_points(hiding):
    shares = []
    for width in SIZES:
        picture = frame_picture(hiding, whole(hiding, width), replace(DETECTIONS, silhouettes=False), PlainIds())
        plain = frame_picture(hiding, whole(hiding, width), Layers(horizon=True), PlainIds())
        shares.append((np.asarray(picture) != np.asarray(plain)).any(axis=-1).mean())
    assert shares[1] == pytest.approx(shares[2], rel=0.25)
    assert shares[0] > shares[1]  # on a thumbnail they stop growing smaller
    window = whole(hiding, 1280)
    picture = np.asarray(frame_picture(hiding, window, Layers(wires=True), PlainIds())).astype(int)
    plain = np.asarray(frame_picture(hiding, window, Layers(), PlainIds())).astype(int)
    for _, edges, corners in hiding.solids.shoeboxes():
        assert edges.shape == (12, 2, 2)
        np.testing.assert_allclose(np.linalg.norm(edges[:, :, None] - corners, axis=-1).min(axis=-1), 0, atol=1e-9)
        for x, y in window.to_picture(edges.mean(axis=1)):
            if 1 < x < 1278 and 1 < y < 958:
                i, j = int(y), int(x)
                assert np.abs(picture - plain)[i - 1 : i + 2, j - 1 : j + 2].max() > 20


def test_an_unknown_layer_is_refused_with_those_there_are_and_obstacles_have_letters_however_many_there_are():
    with pytest.raises(ModsimError, match=r"'ghosts'.*silhouettes, hatching"):
        Layers.of(["truth", "ghosts"])
    assert [letters(i) for i in (0, 25, 26, 51, 52, 701, 702)] == ["a", "z", "aa", "az", "ba", "zz", "aaa"]


def test_id_map_tells_obstacles_apart_and_names_them_in_the_key(renderer):
    scene = load_scene("strait")
    solids = Solids.at(scene, scene.cameras[1], 59)
    window = Window.whole(scene.cameras[1].intrinsics.image_size_px, 1280)
    picture = np.asarray(ids_picture(solids, window, renderer))
    ids, vessels = solids.ids(window, renderer), len(scene.vessels)
    names = [obstacle.name for obstacle in scene.obstacles]
    seen = {names[value - 1 - vessels] for value in np.unique(ids).tolist() if value > vessels}
    assert seen >= {"north_island", "north_hill"}
    for i, name in enumerate(names):
        here = ids == vessels + 1 + i
        if here.sum() > 500:
            assert (picture[here] == palette.obstacle_colour(i, name)).all(axis=-1).mean() > 0.8, name
    key = {entry.text: entry.colour for entry in id_entries(dict(enumerate(scene.vessel_names)), names)}
    assert key["a: north_island"] != key["b: north_hill"] != key["c: south_island"]
    assert len({palette.obstacle_colour(i, name) for i in range(4) for name in ("Big Island", "pier")}) == 8


def test_ids_are_those_of_the_pixel_centres_in_each_vessels_colour_with_its_number(hiding, renderer, monkeypatch):
    """Against the whole ID image, sampled: at a third of the size, the centre of a pixel is that of one of nine."""
    solids = hiding.solids
    large, small = (solids.ids(Window(0, 0, *rest), renderer) for rest in ((1, (801, 600)), (1 / 3, (267, 200))))
    assert (small > 0).any() and (large[1::3, 1::3] != small).mean() < 2e-4  # an edge through a centre
    written, beside = [], []
    monkeypatch.setattr(ids_module, "draw_labels", lambda canvas, labels, boxes: beside.extend(labels))
    monkeypatch.setattr(ImageDraw.ImageDraw, "text", lambda draw, at, text, **style: written.append(text))
    for width in (2400, 240):
        written.clear(), beside.clear()
        picture = np.asarray(ids_picture(hiding.solids, whole(hiding, width), renderer))
        ids = hiding.solids.ids(whole(hiding, width), renderer)
        assert sorted([*written, *(label.text for label in beside)]) == sorted(map(str, np.unique(ids[ids > 0])))
        for value in np.unique(ids[ids > 0]):
            same = (picture[ids == value] == palette.vessel_colour(int(value) - 1)).all(axis=-1)
            assert same.mean() > 0.5  # the rest is hatched by what it hides
        assert not (picture == picture[0, 0]).all(axis=-1)[ids > 0].any()
        for label in beside:
            x0, y0, x1, y1 = map(int, label.box)
            here = ids[y0:y1, x0:x1] == int(label.text)
            assert here.sum() == (ids == int(label.text)).sum()
            assert label.colour == palette.vessel_colour(int(label.text) - 1)
    assert beside


def test_a_crowded_legend_is_set_smaller_and_counts_those_without_room(monkeypatch):
    marks, shown, drawn = detection_entries(DETECTIONS, 2, NOTHING_WRONG), [], legend_module._entry
    names = [LegendEntry(f"{i}: vessel{i}", palette.vessel_colour(i), "filled") for i in range(300)]
    monkeypatch.setattr(legend_module, "_entry", lambda *a: (shown.append((a[1].text, a[-1])), drawn(*a)))
    for count, room_px, most_px, wanted in ((3, 100, 100, [15]), (30, 110, 110, range(16)), (300, 100, 200, [11])):
        shown.clear()
        assert legend([*marks, *names[:count]], 1280, 15, room_px).height <= most_px
        texts, sizes = [text for text, _ in shown], {size for _, size in shown}
        assert {entry.text for entry in marks} < set(texts) and sizes <= set(wanted)
        left_out = count - sum(": vessel" in text for text in texts)
        assert (f"and {left_out} more" in texts) == (count == 300) == (left_out > 0)
    assert legend([], 1280, 15, 100).height == 0


def test_hidden_parts_are_hatched_masks_cover_silhouettes_and_scenes_have_hues(hiding, camera_views, scene, renderer):
    truth, window = hiding.frame.truth, whole(hiding, 800)
    i = int(np.argmin(np.where(truth.visible_fraction > 0, truth.visible_fraction, 1.0)))
    plain, hatched = (frame_picture(hiding, window, Layers(hatching=on), PlainIds()) for on in (False, True))
    colour, hidden = hiding.colour(truth.vessels[i]), truth.silhouette_px[i] - truth.visible_px[i]
    assert count(plain, colour) == 0 and 0.3 * hidden < count(hatched, colour) < 0.7 * hidden
    for camera_view in camera_views:
        truth, solids = camera_view.frame.truth, camera_view.solids
        for row, owner in enumerate(solids.occluders.tolist()):
            i = truth.vessels.index(camera_view.vessels[owner])
            _, mask = silhouette_mask(solids, row, Window(0, 0, 1, (800, 600)))
            x0, y0, x1, y1 = truth.full_boxes_px[i]
            assert abs(int(mask.sum()) - truth.silhouette_px[i]) <= 2 * (x1 - x0 + y1 - y0) + 8
    camera, step = hiding.solids.camera, hiding.frame.step
    window = Window.whole(camera.intrinsics.image_size_px, 800)
    picture = np.asarray(frame_picture(hiding, window, SCENE, renderer)).astype(float)
    ids = Solids.at(scene, camera, step).ids(window, renderer)
    assert len(np.unique(ids)) > 3
    for value in np.unique(ids[ids > 0]).tolist():
        pixels = picture[ids == value]
        colour = np.array(palette.vessel_colour(value - 1), dtype=float)
        lightness = pixels @ colour / (colour @ colour)
        hue = np.linalg.norm(pixels - lightness[:, None] * colour, axis=1)
        assert np.median(hue) < 3 and 0.45 < np.median(lightness) <= 1.0
    assert (picture[0, 0] == palette.SKY).all() and (picture[-1, 0] == palette.SEA).all()


@pytest.fixture(scope="module")
def frame():
    """With a missed vessel and a false positive."""
    frames = simulate_frames(load_scene("harbour", mode=2, seed=3, steps=200, source="rectangles"))
    return next(f for f in frames if np.any(f.truth.annotated & ~f.truth.detected) and None in f.detections.vessels)


def drawn(figure: Figure) -> FigureCanvasAgg:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return canvas


@pytest.mark.parametrize("labels", [True, False])
def test_plot_is_the_picture_of_the_films(frame, labels):
    figure = frame.plot(labels=labels)
    pixels, area = np.asarray(drawn(figure).buffer_rgba())[..., :3], figure.axes[0].bbox
    size = round(area.width), round(area.height)
    layers = DETECTIONS if labels else DETECTIONS.without("labels", "fractions")
    window = Window(0.0, 0.0, size[0] / frame.image_size_px[0], size)
    nominal_px = round(1280 / 15 * 8 * figure.dpi / 72)  # text of 8 points
    view = CameraView.of(frame.scene, frame)
    picture = np.asarray(frame_picture(view, window, layers, PlainIds(), nominal_width_px=nominal_px))
    left, top = round(area.x0), len(pixels) - round(area.y0) - size[1]
    same = pixels[top : top + size[1], left : left + size[0]] == picture
    assert isinstance(figure, Figure) and same[3:-3, 3:-3].all()  # without the axes' own lines


def test_the_legend_names_what_is_wrong_in_the_frame(tmp_path, monkeypatch):
    drawn, legend = [], frame_plot.legend
    monkeypatch.setattr(frame_plot, "legend", lambda entries, *rest: drawn.append(entries) or legend(entries, *rest))
    frames = list(simulate_frames(load_scene(mistaken_strait(tmp_path))))
    for flag in Outcome:
        marked = next(f for f in frames if any(o & flag for o in frame_outcomes(f)))
        every = set(frame_outcomes(marked))
        marked.plot()
        expected = {NAMES[each] for each in Outcome if any(each & other for other in every)}
        named = {entry.text for entry in drawn[-1]} & set(NAMES.values())
        assert named == expected | {NAMES[Outcome.FALSE_POSITIVE]}


@pytest.mark.parametrize("zoom", [False, True])
def test_the_image_or_every_vessel_fills_the_figure_above_the_legend(frame, zoom):
    figure, (width, height), boxes = frame.plot(zoom=zoom), frame.image_size_px, frame.truth.full_boxes_px
    axes, image = figure.axes[0], figure.axes[0].bbox
    assert axes.get_title() == f"{frame.camera}, {frame.timestamp} s, detector {frame.state} ({WEATHER})"
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    if zoom:
        assert left <= boxes[:, 0].min() and right >= boxes[:, 2].max() and bottom - top < height
        assert top <= boxes[:, 1].min() and bottom >= boxes[:, 3].max()
    else:
        assert (left, right, bottom, top) == (0, width, height, 0)
    (key,) = (artist for artist in axes.artists if isinstance(artist, AnnotationBbox))
    place = key.get_window_extent(drawn(figure).get_renderer())
    assert -1 < place.y0 < place.y1 < image.y0
    assert image.width > 0.8 * figure.bbox.width and figure.bbox.height - image.height < 1.5 * figure.dpi


def test_plot_draws_on_given_axes_also_of_a_pickled_frame_and_says_what_it_needs(frame, monkeypatch):
    figure = Figure()
    whole, part = figure.subfigures(1, 2)
    (left, right), other = part.subplots(1, 2), whole.subplots()
    assert frame.plot(right) is frame.plot(other) is figure
    assert [len(axes.artists) for axes in (left, right, other)] == [0, 2, 2]
    assert pickle.loads(pickle.dumps(frame)).plot().axes
    with pytest.raises(ModsimError, match="simulate_frames"):
        replace(frame, scene=None).plot()
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    monkeypatch.delitem(sys.modules, "modsim3d.view.frame_plot")
    assert modsim3d.plot_frame.__doc__, "help(modsim3d) looks at every name"
    with pytest.raises(ModsimError, match=r"modsim3d\[view\]"):
        frame.plot()


def test_part_of_the_image_below_the_horizon_has_the_area_that_it_should():
    corners = np.array([[0, 0], [10, 0], [10, 100], [0, 100]], dtype=float)
    for plane, area in (((0, 1, -30), 700), ((0, -1, 30), 300), ((0, 0, 1), 1000), ((0, 0, -1), 0)):
        x, y = below_horizon(corners, corners, np.array(plane, dtype=float)).T
        assert abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) / 2 == pytest.approx(area), plane
        assert ((y >= 0) & (y <= 100)).all(), plane
