"""The recording for Rerun, read back with Rerun's own reader, and tracks in it, in pictures and films."""

import sys
from io import BytesIO
from itertools import combinations

import numpy as np
import pyarrow as pa
import pytest
from PIL import Image
from rerun.chunk import RrdReader

from modsim3d import load_scene, open_run, run_scene
from modsim3d.core.arrays import NOBODY
from modsim3d.runs.counts import Outcome, frame_outcomes
from modsim3d.runs.frames import detected_rows
from modsim3d.tracks.tracks import Similarity, Tracks
from modsim3d.view import palette
from modsim3d.view.films.plan import FilmLayout
from modsim3d.view.followed_tracks import FollowedTracks
from modsim3d.view.rerun_boxes import TEXT
from modsim3d.view.rerun_recording import export_rerun, fill
from tests.cli.bad_input.builders import answer, refusal
from tests.command_line import call
from tests.run_folders import interrupt
from tests.scenes import crossing
from tests.view.conftest import FALSE_TRACK, as_set, perfect, swapped, with_false, write_csv

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
    out = export_rerun(mistaken_folder, tmp_path_factory.mktemp("mistaken"), every=SOME)
    return open_run(mistaken_folder), read(out.path)


def latest(entity: dict[int | None, dict[str, object]], step: int) -> dict[str, object]:
    return entity[max(at for at in entity if at is not None and at <= step)]


def test_boxes_labels_sea_sky_and_silhouettes_are_in_it_and_the_viewer_opens_with_them(run, recording, written):
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


def test_what_went_wrong_is_named_at_detections_and_no_two_names_lie_on_each_other(mistaken):
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


def test_vessels_cameras_and_obstacles_stand_as_in_the_scene_and_states_have_the_pages_colours(run, recording):
    detector, names = recording["/detector/C0"], [state.name for state in open_run(run).scene.detector.states]
    colours = palette.state_colours(len(names))
    assert detector[None]["values"] == names
    assert detector[None]["colors"] == [int.from_bytes(bytes([*colour, 255])) for colour in colours]
    for frame in open_run(run).frames():
        if frame.step % EVERY == 0:
            assert latest({k: v for k, v in detector.items() if k is not None}, frame.step)["state"] == [frame.state]
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


TRACKED_STEPS, WIDTH, STEP = 12, 1600, 9


@pytest.fixture(scope="module")
def followed(rows) -> FollowedTracks:
    """One track on each vessel and a false one all the time."""
    return FollowedTracks.of(as_set(with_false(perfect(rows), range(TRACKED_STEPS))), rows, Similarity())


@pytest.fixture(scope="module")
def tracks(rows, followed, tmp_path_factory):
    return write_csv(followed.tracks, rows, tmp_path_factory.mktemp("csv") / "made.csv")


def test_tracks_and_trails_have_the_colour_of_the_vessel_or_alarm(call, exact_run, followed, tracks, tmp_path):
    options = (*f"--width {WIDTH} --crop none --layers tracks --tracks".split(), tracks, "--out", tmp_path / "a.png")
    said = answer(call, ("view", "frame", exact_run, STEP, *options))
    assert followed.sentence() in " ".join(said.split())
    with Image.open(tmp_path / "a.png") as written:  # under the head line, with two pixels for one of the image
        picture = np.asarray(written)[FilmLayout(WIDTH, 1, (), ()).head_px :].astype(int)
    here = followed.rows_of(STEP)
    assert here.stop - here.start >= 3
    for number, (x0, y0, _, y1) in zip(followed.tracks.track[here], followed.tracks.boxes_px[here], strict=True):
        colour = palette.ALARM if number == FALSE_TRACK else palette.vessel_colour(int(number))
        left = picture[int(2 * y0) + 2 : int(2 * y1) - 2, int(2 * x0) + 2 : int(2 * x0) + 4]
        share = (left == colour).all(axis=-1).mean()
        assert share > (0.4 if number == FALSE_TRACK else 0.6), number  # a false one is dashed
    trail = followed.trail_px(here.start + followed.tracks.track[here].tolist().index(2))
    assert len(trail) == 3  # a step a second, two seconds back
    for x, y in (trail[:-1] + trail[1:]) / 2:
        around = picture[int(2 * y) - 2 : int(2 * y) + 3, int(2 * x) - 2 : int(2 * x) + 3]
        assert (np.abs(around - palette.vessel_colour(2)).max(axis=-1) < 40).any()


def test_tracks_not_drawn_are_refused_or_change_nothing_and_films_are_the_same_bytes(call, exact_run, tracks, tmp_path):
    for name, options in {"a": (), "b": ("--tracks", tracks)}.items():
        layers = ("--layers", "horizon,truth,detections,labels", "--width", 640)
        arguments = (STEP, *layers, *options, "--out", tmp_path / f"{name}.png")
        answer(call, ("view", "frame", exact_run, *arguments))
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    options = ("--kind", "detections", "--every", 4, "--width", 320, "--tracks", tracks)
    for workers in (1, 2):
        out = ("--workers", workers, "--out", tmp_path / f"{workers}.gif")
        answer(call, ("view", "film", exact_run, *options, *out))
    assert (tmp_path / "1.gif").read_bytes() == (tmp_path / "2.gif").read_bytes()
    for line in (("film", exact_run), ("frame", exact_run, 3)):
        line = ("view", *line, "--kind", "scene", "--tracks", tracks, "--overwrite")
        refusal(call, line, "--tracks works with --kind detections, all, plan and map")
    cut = interrupt(load_scene(str(crossing(tmp_path, 400)), source="analytic"), tmp_path / "cut")
    for line in (("report", cut), ("export", cut, "--format", "rerun"), ("view", "frame", cut, 0)):
        said = refusal(call, (*line, "--tracks", tracks, "--out", tmp_path / "x.png"))
        assert "tracks need a finished one" in " ".join(said.split())


def test_rerun_has_the_tracks_with_number_and_vessel(call, exact_run, rows, followed, tracks, tmp_path):
    said = answer(call, ("export", exact_run, "--format", "rerun", "--tracks", tracks, "--out", tmp_path))
    assert followed.sentence() in " ".join(said.split())
    found, names = read(tmp_path / "run.rrd"), [*rows.scene.vessel_names, "nothing"]
    for step in range(TRACKED_STEPS):
        here = followed.rows_of(step)
        numbers, vessels = followed.tracks.track[here].tolist(), followed.vessel[here].tolist()
        entity = found["/world/cameras/C0/image/tracks"][step]
        assert entity["labels"] == [f"#{n} on {names[v]}" for n, v in zip(numbers, vessels, strict=True)]
        centre = (followed.tracks.boxes_px[here, :2] + followed.tracks.boxes_px[here, 2:]) / 2
        np.testing.assert_allclose(entity["centers"], centre, rtol=1e-5)
        assert found["/counts/C0/tracks"][step]["scalars"] == [len(numbers)]
        assert found["/counts/C0/false_tracks"][step]["scalars"] == [1]
    plot = views(tmp_path / "run.rrd")["tracks, and those on nothing"]
    assert plot == ("TimeSeries", ["/counts/C0/tracks", "/counts/C0/false_tracks"])


BOAT, SAIL = 0, 1


def follow(rows, tracks, *similarity):
    return FollowedTracks.of(as_set(tracks), rows, Similarity(*similarity))


def test_tracks_of_the_truth_have_no_switch_and_those_that_swap_or_end_switch_or_move(rows):
    shown = follow(rows, perfect(rows))
    np.testing.assert_array_equal(shown.vessel, shown.tracks.track)
    assert not (shown.switched | shown.moved | shown.unscored | shown.false).any()
    assert shown.sentence() == "Tracks of made: 3 tracks on 3 vessels, 0 identity switches, 0 false tracks."
    none = follow(rows, perfect(rows).take(np.zeros(0, dtype=np.int64)))
    assert none.sentence() == "Tracks of made: 0 tracks on 0 vessels, 0 identity switches, 0 false tracks."
    row = int(np.flatnonzero((shown.tracks.track == SAIL) & (shown.tracks.step == 2))[0])
    mine = shown.tracks.take((shown.tracks.track == SAIL) & (shown.tracks.step <= 2))  # two seconds of a step each
    centres = (mine.boxes_px[:, :2] + mine.boxes_px[:, 2:]) / 2
    np.testing.assert_allclose(shown.trail_px(row), centres[::-1], rtol=1e-12)
    shown = follow(rows, with_false(perfect(rows), range(3, 6)))
    np.testing.assert_array_equal(shown.false, shown.tracks.track == FALSE_TRACK)
    assert shown.vessel[shown.false].tolist() == [NOBODY] * 3
    assert shown.sentence().endswith("4 tracks on 3 vessels, 0 identity switches, 1 false track.")
    tracks = perfect(rows).take(perfect(rows).track == 2)
    beside = tracks.boxes_px + np.tile((tracks.boxes_px[:, 2] - tracks.boxes_px[:, 0])[:, None], 4) * (1, 0, 1, 0)
    moved = Tracks.of(1, tracks.frame, tracks.track, beside)
    assert follow(rows, moved).false.all() and not follow(rows, moved, "centre", 2000.0, 0.1).false.any()
    hidden = (rows.numbers("visible_px") == 0) & (rows.numbers("silhouette_px") > 0)
    assert hidden.any()
    shown = follow(rows, Tracks.of(1, rows.truth_frame, rows.truth_vessel, rows.boxes_px("full")))
    on = set(zip(rows.truth_frame[hidden].tolist(), rows.truth_vessel[hidden].tolist(), strict=True))
    kept = shown.tracks.take(shown.unscored)
    assert set(zip(kept.frame.tolist(), kept.track.tolist(), strict=True)) == on
    np.testing.assert_array_equal(shown.vessel[shown.unscored], kept.track)
    tracks = perfect(rows)
    shown = follow(rows, swapped(tracks, BOAT, SAIL, 6))
    for marked in (shown.switched, shown.moved):
        first = [shown.tracks.step[(shown.tracks.step >= 6) & (shown.vessel == vessel)].min() for vessel in (0, 1)]
        places = sorted(zip(shown.vessel[marked].tolist(), shown.tracks.step[marked].tolist(), strict=True))
        assert places == [(BOAT, first[0]), (SAIL, first[1])]
    assert "2 identity switches" in shown.sentence()
    number = np.where((tracks.track == SAIL) & (tracks.step >= 5), 7, tracks.track)
    shown = follow(rows, Tracks.of(1, tracks.frame, number, tracks.boxes_px))
    assert shown.tracks.track[shown.switched].tolist() == [7] and not shown.moved.any()
    assert "4 tracks on 3 vessels, 1 identity switch, 0" in shown.sentence()
    some = tracks.take(((tracks.track == SAIL) & (tracks.step < 2)) | ((tracks.track == 2) & (tracks.step >= 4)))
    shown = follow(rows, Tracks.of(1, some.frame, np.full(len(some), 5), some.boxes_px))
    assert shown.moved.sum() == 1 and not shown.switched.any()
