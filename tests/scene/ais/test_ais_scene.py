"""From files to a scene: what is kept, dropped, filled in and written."""

import gzip
import random
import runpy
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import yaml

from modsim3d import load_detector, load_scene
from modsim3d.geometry.camera_poses import camera_R_parent
from modsim3d.io.input_files import data_folder
from modsim3d.scene.ais import scene_folder
from modsim3d.scene.ais.hulls import TABLE, group_of, hulls, ship_types
from modsim3d.scene.ais.messages import Particulars, local_metres
from modsim3d.scene.ais.scene_folder import messages_read, messages_used, report, write_scene
from modsim3d.scene.ais.traffic import CLEARANCE_M, viewpoint
from modsim3d.scene.ais.vessel_track import heading_rad
from tests.scene.ais.ais_builders import SAMPLE_NAMES, SAMPLES, old_file, only, row, traffic_of

THESIS = data_folder("scenes") / "detectors" / "thesis.yaml"


def written(folder: Path, *paths: Path, **options) -> dict[str, bytes]:
    """The scene's files, and the report without what it says of the input files."""
    traffic = traffic_of(*paths, **options)
    write_scene(traffic, folder, THESIS)
    said = {key: value for key, value in report(traffic).items() if key != "files"}
    names = ("scene.yaml", "vessels.json", "poses.json.gz", "detector.yaml")
    return {name: (folder / name).read_bytes() for name in names} | {"report": repr(said).encode()}


@pytest.mark.parametrize("name", SAMPLE_NAMES)
def test_every_sample_becomes_a_scene_that_loads_whatever_the_order_of_its_messages(tmp_path, name):
    files = written(tmp_path / "scene", SAMPLES / name)
    scene = load_scene(tmp_path / "scene" / "scene.yaml")
    assert (scene.steps, len(scene.vessels)) == (361, 10) and scene.poses.poses(0, 361).present.sum() == 3448
    head, *lines = (SAMPLES / name).read_text().splitlines()
    messages: list[str] = []
    for line in lines:
        if "VDM,2,2," in line:  # parts of one message stay together
            messages[-1] += f"\n{line}"
        else:
            messages.append(line)
    random.Random(1).shuffle(messages)
    (tmp_path / name).write_text("\n".join([head, *messages]) + "\n")
    assert written(tmp_path / "shuffled", tmp_path / name) == files


def test_several_files_packed_and_mixed_are_one_traffic(tmp_path):
    header, *lines = (SAMPLES / "danish.csv").read_text().splitlines(keepends=True)
    one, two = tmp_path / "one.csv", tmp_path / "two.data"
    one.write_text(header + "".join(lines[:99]))
    two.write_bytes(gzip.compress((header + "".join(lines[99:])).encode()))
    assert written(tmp_path / "a", SAMPLES / "danish.csv") == written(tmp_path / "b", two, one)
    mixed = traffic_of(SAMPLES / "danish.csv", SAMPLES / "receiver.nmea")
    assert len(mixed.vessels) == 10
    assert mixed.dropped["duplicate"] == 2 * 251 - 250  # each file has 251 positions, one of them twice


def test_sample_vessels_are_where_the_script_drove_them():
    script = runpy.run_path(str(SAMPLES.parents[2] / "script" / "make_ais_samples"))
    traffic = traffic_of(SAMPLES / "danish.csv", origin=script["ORIGIN"])
    ships = {ship.mmsi: ship for ship in script["SHIPS"]}
    for vessel in traffic.vessels:
        ship = ships[vessel.mmsi]
        a, b, c, d = ship.dimensions
        for place, step in enumerate(vessel.steps):
            east, north, course = ship.at(float(traffic.grid.timestamps[step]))
            angle = heading_rad(course)
            ahead, port = (0.0, 0.0) if a == c == 0 else ((a - b) / 2, (c - d) / 2)
            cosine, sine = np.cos(angle), np.sin(angle)
            centre = [east + ahead * cosine - port * sine, north + ahead * sine + port * cosine]
            # Headings are rounded to a degree, which moves the centre by up to 0.5° of the antenna's distance from
            # it; 0.6 m where a report of the speed is missing in a turn.
            slack = 0.7 + np.deg2rad(0.6) * np.hypot(ahead, port)
            np.testing.assert_allclose(vessel.places_m[place], centre, atol=slack)
            assert abs(np.angle(np.exp(1j * (vessel.headings_rad[place] - angle)))) < np.deg2rad(1.1)


@pytest.mark.parametrize("name", SAMPLE_NAMES)
def test_every_message_is_accounted_for(name):
    traffic = traffic_of(SAMPLES / name, region=None, start_s=1704362400 + 60, duration_s=120, max_gap_s=30)
    used, of_vessels = messages_used(traffic), sum(vessel.messages for vessel in traffic.vessels)
    assert used >= of_vessels and (traffic.elsewhere or used == of_vessels)
    assert set(traffic.dropped) <= {*scene_folder.REASONS, "particulars_only"}
    assert messages_read(traffic) == used + sum(traffic.dropped.values())


def steady(*changes: tuple[int, dict[str, object]], **common: object) -> list[str]:
    """Rows ten seconds apart of a vessel that goes east at 10 kn from 56° N, 12° E, some of them changed."""
    degrees = 10 * 1852 / 3600 * 10 / (6378137.0 * 1.00215 * np.cos(np.radians(56)) / 57.29577951)
    places = [{"longitude": round(12 + place * degrees, 7), **common} for place in range(30)]
    for place, values in changes:
        places[place] |= values
    return [row(10 * place, **values) for place, values in enumerate(places)]


def test_what_is_of_no_use_is_dropped_and_counted(tmp_path):
    for changed, reason in (
        *((place, "no_position") for place in ({"latitude": 91.0}, {"longitude": 181.0}, {"latitude": ""})),
        ({"latitude": 0.0, "longitude": 0.0}, "no_position"),
        *(({"mmsi": mmsi}, "not_a_ship") for mmsi in (992190001, 2190001, 111219001)),
        ({"longitude": 200.0}, "impossible_position"),
        ({"latitude": 56.02}, "jump"),
        ({"speed": "fast"}, "unreadable"),
    ):
        traffic = traffic_of(old_file(tmp_path, *steady((7, changed))))
        assert (dict(+traffic.dropped), only(traffic).messages) == ({reason: 1}, 29), changed
        whole = only(traffic_of(old_file(tmp_path, *steady()), origin=traffic.origin))
        np.testing.assert_allclose(only(traffic).places_m, whole.places_m, atol=0.05)


def test_missing_values_are_replaced_and_counted(tmp_path):
    for changed, replaced in (
        ({"heading": 511.0}, "heading_from_course"),
        ({"heading": ""}, "heading_from_course"),
        ({"course": 360.0}, "course_from_heading"),
        ({"course": 360.0, "heading": 511.0}, "heading_from_bearing"),
        ({"speed": 102.3}, "speed_unknown"),
        ({"speed": 0.1, "heading": 511}, "heading_held"),
    ):
        traffic = traffic_of(old_file(tmp_path, *steady((7, changed))))
        vessel = only(traffic)
        expected = {replaced: 1} | ({"course_unknown": 1} if replaced == "heading_from_bearing" else {})
        assert dict(vessel.replaced) == report(traffic)["replaced"] == expected, changed
        np.testing.assert_allclose(vessel.headings_rad, 0, atol=1e-3)
        whole = only(traffic_of(old_file(tmp_path, *steady()), origin=traffic.origin))
        # A speed of 0.1 kn that is wrong bends the way by less than it is believed to.
        np.testing.assert_allclose(vessel.places_m, whole.places_m, atol=10 if changed.get("speed") == 0.1 else 0.05)


def test_dimensions_are_the_latest_from_the_four_distances_or_those_of_the_ship_type(tmp_path):
    groups = {70: "cargo", 36: "sailing", "": "unknown", 1025: "tug", "60.0": "passenger"}
    for code, size in (*((code, (0, "")) for code in groups), (70, (1022, 126)), (70, (1e-9, 0.09))):
        hull = only(traffic_of(old_file(tmp_path, *steady(ship_type=code, length=size[0], beam=size[1])))).hull
        typical, defaults = ship_types()[groups[code]], set(hull.defaults)
        assert (hull.length_m, hull.beam_m, hull.air_draft_m) == (typical.length_m, typical.beam_m, typical.air_draft_m)
        assert {"length", "beam", "antenna"} <= defaults and ("type" in defaults) == (groups[code] == "unknown")
    rows = steady((20, {"length": 110, "ship_type": 80}), (21, {"length": 0, "ship_type": 0}))[:22]
    for order in (rows, rows[::-1]):
        hull = only(traffic_of(old_file(tmp_path, *order))).hull
        assert (hull.length_m, hull.beam_m, hull.group) == (110, 20, "tanker")
    for dimensions, length, beam, antenna in (
        ((30, 70, 5, 15), 100, 20, True),
        ((0, 100, 0, 20), 100, 20, False),  # the size without the antenna's place
        ((511, 70, 63, 15), 130, 20, False),  # the fields' largest values mean "or more"
        ((300, 200, 5, 15), 130, 20, False),  # longer than any ship
        ((0, 0, 5, 15), 130, 20, False),
    ):
        text, sizes = np.array(["70"], dtype=object), np.array([*dimensions, np.nan, np.nan], dtype=float)[:, None]
        hull = hulls(Particulars(np.array([1]), np.zeros(1), text, text, *sizes), [1])[1]
        found = (hull.length_m, hull.beam_m), "antenna" not in hull.defaults, (hull.ahead_m, hull.to_port_m)
        assert found == ((length, beam), antenna, (-20, -5) if antenna else (0, 0)), dimensions


def test_gaps_are_absence_slow_vessels_lie_still_and_window_and_time_step_make_the_time_grid(tmp_path):
    rows = [text for place, text in enumerate(steady()) if not 5 < place < 20]
    vessel = only(traffic_of(old_file(tmp_path, *rows), max_gap_s=120))
    assert np.setdiff1d(np.arange(vessel.steps[-1]), vessel.steps).tolist() == list(range(51, 200))
    whole = traffic_of(old_file(tmp_path, *rows), max_gap_s=150)
    assert len(only(whole).steps) == len(whole.grid.times_s)
    rows = [row(60 * k, speed=0.0, course=(77 * k) % 360, heading=511, length=3, beam=1) for k in range(5)]
    vessel = only(traffic_of(old_file(tmp_path, *rows)))
    assert np.ptp(vessel.steps) == len(vessel.steps) - 1 and np.ptp(vessel.headings_rad) == 0
    assert np.ptp(vessel.places_m, axis=0).tolist() == [0, 0]
    path, start = old_file(tmp_path, *steady()), 1704362400.0
    traffic = traffic_of(path, start_s=start + 15, duration_s=1, time_step_s=0.2)
    assert traffic.grid.timestamps == ("0.0", "0.2", "0.4", "0.6", "0.8", "1.0")
    # Reports up to the longest gap away carry the track over the edges.
    assert (len(only(traffic).steps), only(traffic).messages) == (len(traffic.grid.times_s), 30)
    assert only(traffic_of(path, start_s=start - 10, end_s=start + 10)).steps.tolist() == list(range(10, 21))
    whole = only(traffic_of(path, origin=traffic.origin))
    np.testing.assert_allclose(only(traffic).places_m[-1], whole.places_m[16], atol=1e-6)
    places = only(traffic_of(old_file(tmp_path, *steady()), origin=(56.0, 12.0))).places_m
    np.testing.assert_allclose(places[0], [0, 0], atol=1e-6)
    np.testing.assert_allclose(places[-1], [290 * 10 * 1852 / 3600, 0], atol=2)  # to the east
    np.testing.assert_allclose(places[-1], local_metres(np.array([56.0]), np.array([12.0239157]), (56, 12))[0], atol=5)


def test_layouts_of_the_same_traffic_give_the_same_scene_with_labels_by_type(tmp_path):
    write_scene(traffic_of(SAMPLES / "danish.csv", labels_by_type=True, labels={"tug": "Workboat"}), tmp_path, THESIS)
    scene = load_scene(tmp_path / "scene.yaml")
    assert {vessel.label for vessel in scene.vessels} == set(scene.detector.labels)
    assert "Workboat" in scene.detector.labels and "Tanker" in scene.detector.labels
    table = yaml.safe_load(TABLE.read_text())
    codes = Counter(code for entry in table.values() for a, b in entry["codes"] for code in range(a, b + 1))
    words = Counter(word for entry in table.values() for word in entry["words"])
    assert max(codes.values()) == max(words.values()) == 1
    assert set(range(20, 100)) - set(codes) == {38, 39}  # reserved
    assert set(range(1001, 1026)) <= set(codes) and len({entry["label"] for entry in table.values()}) == len(table)
    assert group_of("Cargo") == group_of("74") == group_of("70.0") == "cargo"
    assert group_of("15") == group_of("something") == group_of("") == "unknown"
    old = written(tmp_path / "old", SAMPLES / "marinecadastre.csv")
    assert old == written(tmp_path / "new", SAMPLES / "marinecadastre_2025.csv")
    danish, nmea = (traffic_of(SAMPLES / name, origin=(56.03, 12.65)) for name in ("danish.csv", "receiver.nmea"))
    for one, other in zip(danish.vessels, nmea.vessels, strict=True):
        assert (one.hull, one.replaced) == (other.hull, other.replaced)
        np.testing.assert_array_equal(one.steps, other.steps)
        # Sentences hold 1/10000 of a minute, half of which is 0.09 m; Danish files hold 0.06 m.
        np.testing.assert_allclose(one.places_m, other.places_m, atol=0.3)
        np.testing.assert_allclose(one.headings_rad, other.headings_rad, atol=0.01)


@pytest.mark.parametrize("labels", [["Vessel"], ["A", "B"], [f"L{k}" for k in range(7)]])
def test_detector_for_several_labels_misses_as_often_as_the_one_for_one(tmp_path, labels):
    text = scene_folder.detector_text(THESIS, labels)
    (tmp_path / "detector.yaml").write_text(text, encoding="utf-8")
    assert list(load_detector(tmp_path / "detector.yaml").labels) == labels
    effect = "dropout: {model: logistic, size_px: {per_unit: -0.01, reference: 0}, intercept: [0.5]}\n"
    (tmp_path / "learned.yaml").write_text(THESIS.read_text() + effect, encoding="utf-8")
    (tmp_path / "spread.yaml").write_text(scene_folder.detector_text(tmp_path / "learned.yaml", labels))
    assert load_detector(tmp_path / "spread.yaml").dropout.intercepts[0] == (0.5,) * len(labels)
    single, spread = yaml.safe_load(THESIS.read_text()), yaml.safe_load(text)
    for name, state in spread["states"].items():
        matrix = np.array(state["confusion"])
        np.testing.assert_allclose(matrix[-1], single["states"][name]["confusion"][1][0])
        np.testing.assert_allclose(np.diag(matrix), single["states"][name]["confusion"][0][0])
        np.testing.assert_allclose(matrix.sum(axis=0), 1)


def test_camera_looks_at_the_busiest_water_and_no_hull_comes_near():
    traffic = traffic_of(SAMPLES / "danish.csv")
    camera = traffic.camera
    place, target = np.array(camera.position_m), np.array([*camera.target_m, 0.0])
    direction = camera_R_parent(0, camera.pitch_rad, camera.yaw_rad) @ (target - place)
    np.testing.assert_allclose(direction[:2], 0, atol=0.5)  # the target is on the optical axis
    assert direction[2] > 0
    for vessel in traffic.vessels:
        assert np.linalg.norm(vessel.places_m - place[:2], axis=1).min() > vessel.hull.length_m / 2 + CLEARANCE_M - 1


@pytest.mark.parametrize("seed", range(6))
def test_camera_is_clear_of_hulls_in_any_traffic(seed):
    rng = np.random.default_rng(seed)
    number = 40 * seed + 1
    places = rng.uniform(-3000, 3000, (30, number, 2)) * rng.uniform(0.01, 1)
    present = rng.uniform(size=(30, number)) < 0.8
    present[0, 0] = True
    half = rng.uniform(2, 200, number)
    camera = viewpoint(np.nonzero(present)[1], places[present], half)
    assert (np.linalg.norm(places - np.array(camera.position_m[:2]), axis=-1) > half + CLEARANCE_M - 1)[present].all()


def test_traffic_too_wide_for_a_plane_is_said(tmp_path):
    rows = [*steady(), row(0, 59.0, mmsi=219000002), row(10, 59.0, mmsi=219000002)]
    for path, wide in ((SAMPLES / "danish.csv", False), (old_file(tmp_path, *rows, name="wide.csv"), True)):
        tables = scene_folder.summary_rows(traffic_of(path))
        said = {name: meaning for _, table in tables for name, _, meaning in table}
        assert ("take less, with --region" in said["farthest"]) == wide


def test_of_reports_of_the_same_time_one_is_kept_whichever_comes_first_and_those_of_several_vessels_all(tmp_path):
    changes = ({"latitude": 56.0002}, {"heading": 511}, {"speed": 11.0}, {"course": 95.0}, {"longitude": 12.0079})
    rows = steady() + [steady((15, changed))[15] for changed in changes]
    one, other = (traffic_of(old_file(tmp_path, *order)) for order in (rows, rows[::-1]))
    assert one.dropped["duplicate"] == other.dropped["duplicate"] == 5
    np.testing.assert_array_equal(only(one).places_m, only(other).places_m)
    np.testing.assert_array_equal(only(one).headings_rad, only(other).headings_rad)
    rows = [*(row(k) for k in (0, 10, 20)), *(row(k, 56.01, mmsi=219000002) for k in (20, 30))]
    traffic = traffic_of(old_file(tmp_path, *rows))
    assert traffic.dropped["duplicate"] == 0 and [vessel.messages for vessel in traffic.vessels] == [3, 2]
