"""The recording for Rerun, read back with Rerun's own reader, holds the run."""

import sys
from io import BytesIO
from itertools import combinations

import numpy as np
import pyarrow as pa
import pytest
from PIL import Image
from rerun.chunk import RrdReader

from modsim3d import load_scene, open_run, run_scene
from modsim3d.runs.counts import Outcome, frame_outcomes
from modsim3d.runs.frames import detected_rows
from modsim3d.view import palette
from modsim3d.view.rerun_boxes import TEXT
from modsim3d.view.rerun_recording import export_rerun, fill
from tests.command_line import call
from tests.scenes import crossing

STEPS, EVERY = 14, 2
SOME = 20  # every so many steps of a longer run are recorded


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rerun")
    pier = {"polygon_m": [[900, 300], [950, 300], [950, 320], [900, 320]], "height_m": 5}
    run_scene(load_scene(crossing(folder, STEPS, obstacles={"pier": pier}), source="analytic"), folder / "run")
    return folder / "run"


def read(path):
    """Entity → step (None for what never changes) → component → values."""
    found: dict[str, dict[int | None, dict[str, object]]] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        for row in batch.drop_columns([c for c in ("log_time", "time") if c in batch.schema.names]).to_pylist():
            values = {name.rpartition(":")[2]: value for name, value in row.items() if value is not None}
            found.setdefault(chunk.entity_path, {}).setdefault(row.get("step"), {}).update(values)
    return found


def views(path):
    """What the viewer shows when it opens a recording: title → kind of view and what is in it."""
    reader, values = RrdReader(path), {}
    (blueprint,) = reader.blueprints()
    for chunk in reader.stream(store=blueprint).to_chunks():
        batch = chunk.to_record_batch()
        for name in (name for name in batch.schema.names if pa.types.is_list(batch.schema.field(name).type)):
            values.setdefault(chunk.entity_path, {})[name.rpartition(":")[2]] = batch[name].to_pylist()[-1]
    return {
        view["display_name"][0]: (view["class_identifier"][0], values[f"{entity}/ViewContents"]["query"])
        for entity, view in values.items()
        if "class_identifier" in view
    }


@pytest.fixture(scope="module")
def written(run, tmp_path_factory):
    out = tmp_path_factory.mktemp("out") / "new" / "run.rrd"
    with pytest.MonkeyPatch.context() as monkeypatch:
        assert call(monkeypatch, "export", run, "--format", "rerun", "--out", out.parent, "--every", EVERY) == 0
    return out


@pytest.fixture(scope="module")
def recording(written):
    return read(written)


@pytest.fixture(scope="module")
def mistaken(mistaken_folder, tmp_path_factory):
    """A run with every kind of mistake, and its recording."""
    out = export_rerun(mistaken_folder, tmp_path_factory.mktemp("mistaken"), every=SOME)
    return open_run(mistaken_folder), read(out.path)


def latest(entity: dict[int | None, dict[str, object]], step: int) -> dict[str, object]:
    """What an entity shows at a step: what was logged last."""
    return entity[max(at for at in entity if at is not None and at <= step)]


def test_boxes_and_labels_of_every_shown_frame_are_in_it_and_the_viewer_opens_with_them(run, recording, written):
    assert views(written) == {
        "camera C0": ("2D", ["$origin/**"]),
        "world": ("3D", views(written)["world"][1]),
        "missed and false": ("TimeSeries", ["/counts/C0/missed", "/counts/C0/false"]),
        "performance state of the detector": ("StateTimeline", ["/detector/C0"]),
    }
    frames = {frame.step: frame for frame in open_run(run).frames()}
    image = "/world/cameras/C0/image"
    truth, found = recording[f"{image}/truth"], recording[f"{image}/detections"]
    assert set(truth) == set(found) == set(range(0, STEPS, EVERY))
    for step, frame in ((step, frame) for step, frame in frames.items() if step % EVERY == 0):
        for entity, boxes in ((truth, frame.truth.full_boxes_px), (found, frame.detections.boxes_px)):
            centres, halves = (np.reshape(entity[step][name], (-1, 2)) for name in ("centers", "half_sizes"))
            np.testing.assert_allclose(np.hstack([centres - halves, centres + halves]), boxes, rtol=1e-5, atol=1e-3)
        assert [text.removesuffix(" missed") for text in truth[step]["labels"]] == list(frame.truth.vessels)


def test_the_camera_sees_sky_sea_and_silhouettes(run, recording):
    scene, frames = open_run(run).scene, {frame.step: frame for frame in open_run(run).frames()}
    (camera,), image = scene.cameras, "/world/cameras/C0/image"
    (scale,) = recording[f"{image}/scene"][None]["scale"]
    for step in range(0, STEPS, EVERY):
        half_plane = scene.sea_half_planes(camera, np.array([step]))[0]
        (ends,) = latest(recording[f"{image}/horizon"], step)["strips"]
        np.testing.assert_allclose(np.array(ends) @ half_plane[:2] + half_plane[2], 0, atol=1e-3)
        (blob,) = latest(recording[f"{image}/scene"], step)["blob"]
        with Image.open(BytesIO(bytes(blob))) as picture:
            np.testing.assert_allclose(picture.size * np.array(scale[:2]), camera.intrinsics.image_size_px)
            pixels = np.asarray(picture.convert("RGB"))
        (left, right), (_, height) = np.array(ends) / scale[:2], picture.size
        empty = 0
        for column in range(0, picture.width, 16):
            row = left[1] + (column + 0.5 - left[0]) / (right[0] - left[0]) * (right[1] - left[1])
            above = (pixels[:, column] == palette.SKY).all(axis=1).sum()
            if above + (pixels[:, column] == palette.SEA).all(axis=1).sum() == height:
                assert abs(above - row) <= 1, (step, column)
                empty += 1
        assert empty > 3
        lines = latest(recording[f"{image}/silhouettes"], step)
        found, truth = dict(zip(lines["labels"], map(np.array, lines["strips"]), strict=True)), frames[step].truth
        for name, box, share in zip(truth.vessels, truth.full_boxes_px, truth.visible_fraction, strict=True):
            np.testing.assert_allclose([*found[name].min(axis=0), *found[name].max(axis=0)], box, atol=scale[0] + 1)
            if share == 1 and (box[2:] - box[:2]).min() > 4 * scale[0]:
                column, row = ((box[:2] + box[2:]) / 2 / scale[:2]).astype(int)
                colour = palette.darker(palette.vessel_colour(scene.vessel_names.index(name)))
                assert tuple(pixels[row, column]) == colour, (step, name)


def test_a_hole_in_a_silhouette_is_not_filled():
    picture, square = Image.new("P", (40, 40), 0), np.array([(0.0, 0), (1, 0), (1, 1), (0, 1)])
    fill(picture, [10 + 5 * square[::-1], 2 + 30 * square], 7)
    assert [picture.getpixel((place, place)) for place in (5, 20, 12, 38)] == [7, 7, 0, 0]


def test_what_went_wrong_is_named_and_no_two_names_lie_on_each_other(mistaken):
    (run, found), shown, hidden = mistaken, 0, 0
    sizes = {camera.name: camera.intrinsics.image_size_px for camera in run.scene.cameras}
    for frame in (frame for frame in run.frames() if frame.step % SOME == 0):
        image, places = f"/world/cameras/{frame.camera}/image", []
        missed, false = (found[f"{image}/{name}"][frame.step] for name in ("missed", "false"))
        assert len(missed["labels"] or []) == (frame.truth.annotated & ~frame.truth.detected).sum()
        assert len(false["labels"] or []) == sum(bool(each & Outcome.FALSE_POSITIVE) for each in frame_outcomes(frame))
        for boxes in (missed, false):
            columns = [boxes[key] or [] for key in ("labels", "centers", "half_sizes")]
            for text, centre, half in zip(*columns, strict=True):
                assert not text or text.endswith(" missed") or text.startswith("false: ")
                hidden += not text
                if text:
                    places.append(np.array([centre[0], centre[1] + half[1]]) / sizes[frame.camera])
        assert all((abs(one - other) >= np.array(TEXT) - 1e-5).any() for one, other in combinations(places, 2))
        shown += len(places)
        for name in ("truth", "detections"):
            assert found[f"{image}/{name}"][frame.step]["show_labels"] == [False]
    assert shown and hidden


def test_states_have_the_colours_of_the_pages(run, recording):
    detector, names = recording["/detector/C0"], [state.name for state in open_run(run).scene.detector.states]
    colours = palette.state_colours(len(names))
    assert detector[None]["values"] == names
    assert detector[None]["colors"] == [int.from_bytes(bytes([*colour, 255])) for colour in colours]
    for frame in open_run(run).frames():
        if frame.step % EVERY == 0:
            assert latest({k: v for k, v in detector.items() if k is not None}, frame.step)["state"] == [frame.state]


def test_detections_say_what_is_wrong_with_them(mistaken):
    (run, found), said = mistaken, set()
    for frame in (frame for frame in run.frames() if frame.step % SOME == 0):
        image, outcomes, rows = f"/world/cameras/{frame.camera}/image", frame_outcomes(frame), detected_rows(frame)
        off = [i for i, outcome in enumerate(outcomes) if outcome & Outcome.OFF_VESSEL]
        lines = np.reshape(found[f"{image}/off_vessel"][frame.step]["strips"] or [], (-1, 2, 2))
        assert len(lines) == len(off)
        for line, i in zip(lines, off, strict=True):
            box, true_box = frame.detections.boxes_px[i], frame.truth.boxes_px[rows[i]]
            np.testing.assert_allclose(line[0], (box[:2] + box[2:]) / 2, atol=1e-3)
            assert np.all((line[1] >= true_box[:2] - 1e-3) & (line[1] <= true_box[2:] + 1e-3))
        tags = found[f"{image}/detections"][frame.step]["labels"] or []
        for tag, outcome, row in zip(tags, outcomes, rows, strict=True):
            assert tag.startswith("false: ") == bool(outcome & Outcome.FALSE_POSITIVE)
            mislabelled = row is not None and f", is a {frame.truth.labels[row]}" in tag
            assert mislabelled == bool(outcome & Outcome.MISLABELLED)
            assert tag.endswith(", off its vessel") == bool(outcome & Outcome.OFF_VESSEL)
            assert tag.endswith(", IoU below 0.5") == (outcome & ~Outcome.MISLABELLED == Outcome.BELOW_HALF_IOU)
            said |= {flag.name for flag in outcome}
        counted = {"false": Outcome.FALSE_POSITIVE, "wrong_class": Outcome.MISLABELLED}
        counted |= {"below_half_iou": Outcome.BELOW_HALF_IOU, "off_vessel": Outcome.OFF_VESSEL}
        for name, flag in counted.items():
            (value,) = found[f"/counts/{frame.camera}/{name}"][frame.step]["scalars"]
            assert value == sum(1 for outcome in outcomes if outcome & flag)
    assert said == {flag.name for flag in Outcome}


def test_vessels_cameras_and_obstacles_stand_in_the_world_as_in_the_scene(run, recording):
    scene, ever = open_run(run).scene, []
    poses = scene.poses.poses(0, STEPS)
    for index, name in enumerate(scene.vessel_names):
        entity = recording[f"/world/vessels/{name}"]
        for step in range(0, STEPS, EVERY):
            assert ("translation" in entity.get(step, {})) == poses.present[step, index]
            if poses.present[step, index]:
                np.testing.assert_allclose(entity[step]["translation"][0], poses.positions_m[step, index], rtol=1e-5)
        vanished, there = [step for step, row in entity.items() if "is_recursive" in row], poses.present[:, index]
        assert vanished == [s for s in range(EVERY, STEPS, EVERY) if there[s - EVERY] and not there[s]]
        ever += vanished
    assert ever
    (camera,) = scene.cameras
    lens = recording["/world/cameras/C0/image"][None]
    np.testing.assert_allclose(np.reshape(lens["image_from_camera"], (3, 3)).T, camera.intrinsics.matrix, rtol=1e-6)
    pose = recording["/world/cameras/C0"][0]
    camera_R_world = scene.sight(camera, np.array([0])).camera_poses.camera_R_world[0]
    # Rerun stores matrices column by column: read row by row, this is the transpose of world_R_camera.
    np.testing.assert_allclose(np.reshape(pose["mat3x3"], (3, 3)), camera_R_world, atol=1e-6)
    corners = np.array(recording["/world/obstacles/pier"][None]["vertex_positions"]).reshape(-1, 3)
    assert len(corners) == 3 * 12  # a prism over a rectangle
    np.testing.assert_allclose((corners.min(axis=0), corners.max(axis=0)), ((900, 300, 0), (950, 320, 5)))


def test_a_missing_sdk_or_a_file_for_a_folder_is_one_message(monkeypatch, capsys, run, tmp_path):
    (tmp_path / "file").touch()
    assert call(monkeypatch, "export", run, "--format", "rerun", "--out", tmp_path / "file") == 2
    assert f"{tmp_path / 'file'} is a file, and run.rrd is to be written into a folder" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert call(monkeypatch, "export", run, "--format", "rerun", "--out", tmp_path / "x") == 2
    # Without an empty bar before it.
    assert capsys.readouterr().err == "modsim3d: --format rerun needs the Rerun SDK: pip install 'modsim3d[rerun]'\n"
