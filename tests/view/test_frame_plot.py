"""frame.plot(): the picture shows what the frame says, and imports no plotting library before it is asked for."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

from modsim3d.errors import ModsimError
from modsim3d.runs.outcomes import Outcome, frame_outcomes
from modsim3d.runs.pipeline import simulate_frames
from modsim3d.scene.reading import load_scene
from modsim3d.view import palette
from modsim3d.view.frame_plot import BAD_BOX
from modsim3d.view.outcome_words import NAMES
from modsim3d.view.pictures.plain import below_horizon
from tests.scenes import mistaken_strait


@pytest.fixture(scope="module")
def frames():
    return list(simulate_frames(load_scene("harbour", mode=2, seed=3, steps=200, source="analytic")))[120:]


@pytest.fixture(scope="module")
def frame(frames):
    """With a missed vessel and a false positive, and few others, so that there is room for all labels."""
    suitable = [f for f in frames if np.any(f.truth.annotated & ~f.truth.detected) and None in f.detections.vessels]
    return min(suitable, key=lambda f: len(f.truth.vessels) + len(f.detections))


def boxes_of(figure, colour, dashed=None):
    (axes,) = figure.axes
    found = [
        p for p in axes.patches if isinstance(p, Rectangle) and p.get_edgecolor()[:3] == tuple(np.divide(colour, 255))
    ]
    kept = [p for p in found if dashed is None or (p.get_linestyle() == "--") == dashed]
    return np.array([np.ravel(p.get_bbox()) for p in kept]).reshape(-1, 4)


def test_plot_returns_a_figure_with_the_boxes_of_the_frame(frame):
    figure = frame.plot()
    assert isinstance(figure, Figure)
    truth, found = frame.truth, frame.detections
    np.testing.assert_allclose(boxes_of(figure, palette.TRUTH, dashed=True), truth.full_boxes_px)
    missed = truth.boxes_px[truth.annotated & ~truth.detected]
    np.testing.assert_allclose(boxes_of(figure, palette.ALARM, dashed=False), missed)
    false = found.boxes_px[[vessel is None for vessel in found.vessels]]
    np.testing.assert_allclose(boxes_of(figure, palette.ALARM, dashed=True), false)
    name = next(vessel for vessel in found.vessels if vessel is not None)
    colour = palette.vessel_colour(frame.scene_vessels.index(name))
    mine = found.boxes_px[[vessel == name for vessel in found.vessels]]
    assert any(np.allclose(row, mine[0]) for row in boxes_of(figure, colour))
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert any(text.startswith(f"{name}: ") for text in texts)
    assert len(texts) == len(missed) + len(found)


def test_plot_marks_what_is_wrong_and_names_it_in_its_legend(tmp_path):
    frames = list(simulate_frames(load_scene(mistaken_strait(tmp_path))))
    by_kind = {flag: next(f for f in frames if any(o & flag for o in frame_outcomes(f))) for flag in Outcome}
    for flag, marked in by_kind.items():
        outcomes, found = frame_outcomes(marked), marked.detections
        (axes,) = marked.plot().axes
        every = set(map(int, outcomes))
        named = {text.get_text() for text in axes.get_legend().get_texts()}
        assert NAMES[flag] in named
        assert named & set(NAMES.values()) == {NAMES[each] for each in Outcome if any(each & other for other in every)}
        bad = found.boxes_px[[outcome & Outcome.BELOW_HALF_IOU > 0 for outcome in outcomes]]
        dashed = [p for p in axes.patches if isinstance(p, Rectangle) and p.get_linestyle() == BAD_BOX]
        np.testing.assert_allclose(np.reshape([np.ravel(p.get_bbox()) for p in dashed], (-1, 4)), bad)
        lines = [line.get_xydata() for line in axes.lines if line.get_marker() == "o"]
        off = found.boxes_px[[outcome & Outcome.OFF_VESSEL > 0 for outcome in outcomes]]
        starts = np.reshape([line[0] for line in lines], (-1, 2))
        np.testing.assert_allclose(starts, (off[:, :2] + off[:, 2:]) / 2)
        flags = np.reshape([line.get_xydata()[0] for line in axes.lines if line.get_marker() == "v"], (-1, 2))
        mislabelled = [outcome & Outcome.MISLABELLED > 0 for outcome in outcomes]
        np.testing.assert_allclose(flags, found.boxes_px[mislabelled][:, [2, 1]])
    wrong = by_kind[Outcome.MISLABELLED]
    texts = [text.get_text() for text in wrong.plot().axes[0].texts]
    assert any(", is a " in text for text in texts)


def test_picture_has_sea_below_and_sky_above_the_horizon(frame):
    nobody = replace(frame.detections, vessels=(None,) * len(frame.detections))
    bare = replace(frame, truth=replace(frame.truth, vessels=()), detections=nobody)
    figure = bare.plot(labels=False)
    figure.axes[0].set_axis_off()
    _, sea = [patch for patch in figure.axes[0].patches if isinstance(patch, Polygon)]
    a, b, c = frame.sea_half_plane
    corners = sea.get_xy()
    assert np.all(corners @ [a, b] + c >= -1e-6)
    assert 0 < corners[:, 1].min() < corners[:, 1].max() == frame.image_size_px[1]


def test_image_edges_are_the_limits_and_zoom_keeps_every_vessel_in_sight(frame):
    axes = frame.plot().axes[0]
    width, height = frame.image_size_px
    assert (axes.get_xlim(), axes.get_ylim()) == ((0, width), (height, 0))
    near = frame.plot(zoom=True, labels=False).axes[0]
    (left, right), (bottom, top) = near.get_xlim(), near.get_ylim()
    boxes = frame.truth.full_boxes_px
    assert left <= boxes[:, 0].min() and right >= boxes[:, 2].max()
    assert top <= boxes[:, 1].min() and bottom >= boxes[:, 3].max()
    assert (bottom - top) < height
    assert not near.texts


def test_labels_do_not_lie_on_each_other_and_a_zoomed_figure_is_as_flat_as_what_it_shows(frames):
    frame = max(frames, key=lambda each: len(each.detections))
    for zoom in (False, True):
        figure = frame.plot(zoom=zoom)
        figure.draw_without_rendering()
        (axes,) = figure.axes
        plates = [note.get_window_extent() for note in axes.texts]
        assert len(plates) > 10
        assert not any(one.overlaps(other) for i, one in enumerate(plates) for other in plates[:i])
        image = axes.get_window_extent()
        assert max(plate.x1 for plate in plates) <= image.x1
        assert image.width > 0.8 * figure.bbox.width and figure.bbox.height - image.height < 1.5 * figure.dpi


def test_plot_draws_on_axes_that_it_is_given(frame):
    figure = Figure()
    left, right = figure.subplots(1, 2)
    assert frame.plot(right) is figure
    assert right.patches and not left.patches


def test_plot_draws_on_axes_of_a_figure_within_a_figure(frame):
    figure = Figure()
    part = figure.subfigures(1, 2)[1]
    assert frame.plot(part.subplots()) is figure
    assert part.axes[0].patches


@pytest.mark.parametrize("plane, area", [((0, 1, -30), 700), ((0, -1, 30), 300), ((0, 0, 1), 1000), ((0, 0, -1), 0)])
def test_part_of_the_image_below_the_horizon_has_the_area_that_it_should(plane, area):
    corners = np.array([[0, 0], [10, 0], [10, 100], [0, 100]], dtype=float)
    x, y = below_horizon(corners, corners, np.array(plane, dtype=float)).T
    assert abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) / 2 == pytest.approx(area)


def test_without_matplotlib_the_error_names_the_extra(frame, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(ModsimError, match=r"modsim3d\[view\]"):
        frame.plot()


def test_frames_import_no_plotting_library():
    script = (
        "import sys, modsim3d\n"
        "list(modsim3d.simulate_frames(modsim3d.load_scene('simulation_1', steps=2, source='analytic')))\n"
        "sys.exit('matplotlib' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0
