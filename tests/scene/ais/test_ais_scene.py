"""From AIS files to a scene: what is kept, dropped, filled in and written; laws of projection, headings and tracks."""

import gzip
import math
import random
import runpy
from collections import Counter
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from modsim3d import load_detector, load_scene
from modsim3d.geometry.camera_poses import camera_R_parent, world_R_vehicle
from modsim3d.io.input_files import data_folder
from modsim3d.scene.ais import scene_folder, vessel_track
from modsim3d.scene.ais.hulls import TABLE, antenna_offset, group_of, hulls, ship_types
from modsim3d.scene.ais.messages import Particulars, SeaRegion, local_metres, median_place, reachable
from modsim3d.scene.ais.scene_folder import messages_read, messages_used, report, write_scene
from modsim3d.scene.ais.traffic import CLEARANCE_M, viewpoint
from modsim3d.scene.ais.vessel_track import HeadingSource, ReportedTrack, heading_rad, resample
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


NAN = math.nan
metres = st.floats(-5000, 5000)
angles = st.floats(-10, 10)


@given(st.floats(-80, 80), st.floats(-180, 180), st.floats(-300, 300), st.floats(-300, 300))
def test_local_metres_are_the_radii_of_curvature_times_angles_nearby(latitude, longitude, north_m, east_m):
    # WGS84: a = 6378137 m, 1/f = 298.257223563; meridian and transverse radii of curvature, e.g. Torge & Müller,
    # Geodesy (2012), eq. 4.13 to 4.15. What is left out grows with the square of the distance over the Earth's radius.
    a, f = 6378137.0, 1 / 298.257223563
    e2 = f * (2 - f)
    w = 1 - e2 * math.sin(math.radians(latitude)) ** 2
    meridian, transverse = a * (1 - e2) / w**1.5, a / w**0.5
    there = np.array([latitude + math.degrees(north_m / meridian)])
    across = transverse * math.cos(math.radians(latitude))
    eastward = np.array([longitude + math.degrees(east_m / across)])
    (east, north), *_ = local_metres(there, eastward, (latitude, longitude))
    tilted = 0.02 * (1 + math.tan(math.radians(abs(latitude))))  # metres; 300² / 6.4e6 = 0.014, times the tangent
    assert abs(east - east_m) < tilted and abs(north - north_m) < tilted


def test_origin_antenna_and_headings_have_the_signs_of_the_standard():
    latitude, longitude = median_place(np.array([52.0, 53.0, 54.0]), np.array([179.9, -179.9, 179.8]))
    assert latitude == 53.0 and abs(longitude) == pytest.approx(179.9)
    # A = 30 before the antenna, B = 10 behind: the middle is ahead. C = 6 to port, D = 2: the middle is to port.
    assert antenna_offset(30, 10, 6, 2) == (10, 2)
    assert antenna_offset(0, 40, 0, 8) is None  # only the size is known
    assert antenna_offset(0, 40, 4, 4) == (-20, 0)  # an antenna on the bow
    same_direction(heading_rad(np.array([0, 90, 180, 270])), np.pi * np.array([0.5, 0, -0.5, 1]))
    for reports, headings_deg, sources in (
        (([10, 10], [45, 50], [NAN, 47]), [45, 47], [COURSE, REPORT]),  # the course of a vessel that moves
        (([10] * 3, [NAN] * 3, [NAN] * 3, WAY), [90, 45, 0], [BEARING] * 3),  # between positions, without a course
        (([0.1, 10, 0.1, 0, 0.2], [10, 200, 77, 300, 5], [NAN] * 5), [200] * 5, [HELD, COURSE] + [HELD] * 3),
        (([10] * 4, [NAN] * 4, [NAN] * 4, *ACROSS_A_GAP), [90, 90, 0, 0], [BEARING] * 4),
        (([0, 0], [NAN, NAN], [NAN, NAN]), [0, 0], [NOTHING] * 2),  # north, with nothing to go by
    ):
        filled, source = headings_of(*reports)
        assert filled.tolist() == pytest.approx(headings_deg, abs=1e-9), reports
        assert source.tolist() == sources, reports


@pytest.mark.parametrize(("corners", "inside"), [((55, 12, 57, 13), 12.5), ((50, 179, 56, -179), 180.0)])
def test_region_holds_what_is_between_its_corners_in_any_order(corners, inside):
    for region in (SeaRegion.between(*corners), SeaRegion.between(*corners[2:], *corners[:2])):
        longitudes = np.array([inside, inside - 10, inside + 10])
        assert region.holds(np.full(3, 55.5), longitudes).tolist() == [True, False, False]
        assert not region.holds(np.array([60.0]), np.array([inside])).any()


@given(angles, metres, metres)
def test_hull_centre_turns_with_the_vehicle_frame(heading, ahead, to_port):
    found = vessel_track.to_hull_centre(np.zeros((1, 2)), np.array([heading]), ahead, to_port)
    np.testing.assert_allclose(found[0], (world_R_vehicle(heading) @ [ahead, to_port, 0])[:2], atol=1e-8)


@st.composite
def tracks(draw):
    speed = st.floats(-20, 20)
    reports = st.tuples(st.integers(1, 100), st.tuples(metres, metres), st.tuples(speed, speed), angles)
    steps, *columns = map(np.array, zip(*draw(st.lists(reports, min_size=1, max_size=12)), strict=True))
    return ReportedTrack(np.cumsum(steps).astype(np.float64), *columns)


def same_direction(a, b):
    np.testing.assert_allclose(np.cos(a - b), 1, atol=1e-9)


@given(tracks())
def test_resampling_at_the_reports_gives_the_reports(track):
    there, places, headings = resample(track, track.times_s, 50)
    assert there.all()
    np.testing.assert_allclose(places, track.places_m, atol=1e-8)
    same_direction(headings, track.headings_rad)


@given(st.tuples(metres, metres), st.floats(-15, 15), st.floats(-15, 15), st.booleans())
def test_a_straight_track_at_constant_speed_stays_straight(start, east, north, known):
    times = np.array([0.0, 7.0, 19.0, 60.0, 61.0, 300.0])
    velocity = np.array([east, north])
    places = np.array(start) + times[:, None] * velocity
    velocities = np.tile(velocity if known else [NAN, NAN], (6, 1))
    grid = np.arange(0, 300.5, 0.5)
    there, found, headings = resample(ReportedTrack(times, places, velocities, np.full(6, 0.3)), grid, 300)
    assert there.all()
    np.testing.assert_allclose(found, np.array(start) + grid[:, None] * velocity, atol=1e-7)
    np.testing.assert_allclose(headings, 0.3)


def test_a_turn_is_followed_where_speed_and_course_fit_the_way_and_a_long_gap_is_absence():
    # A circle of 500 m at 5 m/s, reported every 30 s (17°): the cubic errs by R θ⁴ / 384, the chord by R θ² / 8.
    radius, speed, every = 500.0, 5.0, 30.0
    theta, times, grid = speed * every / radius, np.arange(0, 301, every), np.arange(0, 300.25, 0.25)

    def around(t):
        """Unit vectors from the centre."""
        return np.stack([np.cos(speed * t / radius), np.sin(speed * t / radius)], axis=-1)

    headings = speed * times / radius + math.pi / 2
    turning = speed * np.stack([np.cos(headings), np.sin(headings)], axis=-1)
    curved, straight = (
        np.linalg.norm(resample(track, grid, 400)[1] - radius * around(grid), axis=1).max()
        for track in (ReportedTrack(times, radius * around(times), way, headings) for way in (turning, turning * NAN))
    )
    assert curved < 2 * radius * theta**4 / 384 and straight == pytest.approx(radius * theta**2 / 8, rel=0.02)
    times, places = np.array([0.0, 60.0]), np.array([[0.0, 0.0], [300.0, 0.0]])
    wrong = np.array([[0.0, 50.0], [0.0, 50.0]])
    _, found, _ = resample(ReportedTrack(times, places, wrong, np.zeros(2)), np.array([15.0, 30.0, 50.0]), 400)
    np.testing.assert_allclose(found, [[75, 0], [150, 0], [250, 0]])
    times = np.array([10.0, 20.0, 120.0, 130.0])
    track = ReportedTrack(times, np.zeros((4, 2)), np.full((4, 2), NAN), np.zeros(4))
    grid = np.arange(0, 141, 5.0)
    for max_gap_s, expected in ((99.9, [10, 15, 20, 120, 125, 130]), (100, [*range(10, 131, 5)])):
        there, *_ = resample(track, grid, max_gap_s)
        assert grid[there].tolist() == expected


@given(st.floats(0, 360), st.floats(-179, 179), st.floats(0, 1))
def test_heading_turns_along_the_shorter_arc(start, turn, share):
    headings = heading_rad(np.array([start, (start + turn) % 360]))
    track = ReportedTrack(np.array([0.0, 1.0]), np.zeros((2, 2)), np.full((2, 2), NAN), headings)
    *_, found = resample(track, np.array([share]), 10)
    same_direction(found, heading_rad(np.array([start + share * turn])))


def headings_of(speed, course, heading, places=None, times=None):
    number = len(speed)
    times = np.arange(number) * 10.0 if times is None else np.array(times)
    places = np.zeros((number, 2)) if places is None else np.array(places, dtype=float)
    arrays = (np.array(values, dtype=float) for values in (speed, course, heading))
    return vessel_track.fill_headings(times, places, *arrays, 100)


REPORT, COURSE, BEARING, HELD, NOTHING = HeadingSource
WAY, ACROSS_A_GAP = [[0, 0], [50, 0], [50, 50]], ([[0, 0], [50, 0], [0, 5000], [0, 5050]], [0, 10, 1000, 1010])


@given(st.integers(0, 19), st.floats(500, 1e5), st.floats(0, 2 * math.pi))
def test_one_wrong_position_is_dropped_wherever_it_stands(wrong, far, bearing):
    times = np.arange(20) * 10.0
    places = np.stack([times * 5, np.zeros(20)], axis=1)
    # Further than anything reached in half the track at 10 m/s.
    places[wrong] += (far + 1500) * np.array([math.cos(bearing), math.sin(bearing)])
    assert np.flatnonzero(~reachable(times, places, 10.0)).tolist() == [wrong]


def brute_force(times, places, fastest, slack):
    """The longest chain of pieces, by trying every choice of them."""
    number = len(times)

    def possible(i, j):
        return np.linalg.norm(places[j] - places[i]) <= fastest * (times[j] - times[i] + slack)

    cuts = [i for i in range(1, number) if not possible(i - 1, i)]
    pieces = list(zip([0, *cuts], [*cuts, number], strict=True))
    best = 0
    for choice in range(1, 2 ** len(pieces)):
        chosen = [piece for k, piece in enumerate(pieces) if choice >> k & 1]
        if all(possible(a[1] - 1, b[0]) for a, b in pairwise(chosen)):
            best = max(best, sum(stop - first for first, stop in chosen))
    return best


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(1, 20), st.integers(-200, 200)), min_size=1, max_size=9))
def test_reachable_keeps_as_many_as_any_choice_of_pieces(steps):
    times = np.cumsum([float(step) for step, _ in steps])
    places = np.array([[float(place), 0.0] for _, place in steps])
    kept = reachable(times, places, 5.0)
    assert kept.sum() == brute_force(times, places, 5.0, 1.0)
    assert (np.abs(np.diff(places[kept, 0])) <= 5.0 * (np.diff(times[kept]) + 1.0)).all()
