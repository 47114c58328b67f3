"""The parts of what vessels would send by AIS: who carries what, when it is sent, how it is measured and encoded."""

from itertools import product

import numpy as np
import pytest
from pyais import decode
from scipy import stats

from modsim3d.core.random_streams import Streams
from modsim3d.formats.writing.ais import log, reporting, sensors
from modsim3d.geometry.kinematics import KNOT_M_S
from modsim3d.scene.ais.messages import local_metres, places
from modsim3d.world.vessels import Vessel


def seen(seconds, speed_kn=10.0, heading_deg=90.0, first_s=0, **other):
    n = np.zeros(seconds)
    columns = {"speed_kn": n + speed_kn, "heading_deg": n + heading_deg, "course_deg": n + 45, "turn_deg_min": n}
    place = {"latitude_deg": n + 56, "longitude_deg": n + 12}
    return sensors.SensorReadings(times_s=first_s + np.arange(seconds), **(place | columns | other))


def station(ais_class="A", length_m=90.0, mmsi=219000001, sides_m=(60, 30, 7, 8)):
    return sensors.Station(0, "the-ferry", mmsi, ais_class, 60, False, length_m, sides_m, 5.0)


def sent(fields):
    text = log.lines(log.payload(fields), False, "A", 3, 0.0)
    return decode(*[line.split("\\")[2].encode() for line in text.splitlines()])


USUAL = [("ship", 180, False, ("A", 0)), ("ship", 20, False, ("A", 0)), ("boat", 19.9, False, ("B", 0))]
USUAL += [("boat", 4.9, False, ("none", 0)), ("Vessel", 4.9, True, ("A", 0)), ("kayak", 60, False, ("none", 0))]
USUAL += [("sailboat", 44, False, ("B", 36)), ("Sailing", 45, False, ("A", 36)), ("motorboat", 9, False, ("B", 37))]
USUAL += [("Fishing", 15, False, ("A", 30)), ("Fishing", 14.9, False, ("B", 30)), ("ferry", 9, False, ("A", 60))]
USUAL += [("HighSpeed", 30, False, ("A", 40)), ("Cargo", 130, False, ("A", 70)), ("Tug", 12, False, ("A", 52))]


@pytest.mark.parametrize("ais_class", ["A", "B"])
@pytest.mark.parametrize("size", [(90, 15), (8.5, 2.8), (0.4, 0.2), (24, 7), (399, 61)])
def test_the_sides_give_the_size_and_the_antenna_is_where_they_say(size, ais_class):
    bow, stern, port, starboard = sides = sensors.antenna_sides(Vessel("x", "y", *size, 4), ais_class)
    assert bow + stern == max(round(size[0]), 1)
    assert port + starboard == max(round(size[1]), 1)
    assert bow >= 1 <= port  # A = C = 0 would mean that only the size is known
    ahead, to_port, _ = station(sides_m=sides).antenna_m
    assert (ahead + bow, -ahead + stern) == ((bow + stern) / 2, (bow + stern) / 2)
    assert (to_port + port, -to_port + starboard) == ((port + starboard) / 2, (port + starboard) / 2)


INTERVALS = [(0, "A", True, 180), (2.9, "A", True, 180), (3.1, "A", True, 10), (0, "A", False, 10)]
INTERVALS += [(13.9, "A", False, 10), (14.1, "A", False, 6), (22.9, "A", False, 6), (23.1, "A", False, 2)]
INTERVALS += [(np.nan, "A", False, 10), (1.9, "B", False, 180), (2.1, "B", False, 30), (40, "B", False, 30)]


def test_class_ids_and_intervals_are_those_of_the_standard_and_a_slower_ship_keeps_its_interval():
    for label, length_m, own, expected in USUAL:
        assert sensors.usual(Vessel("x", label, length_m, 3, 3), own) == expected, label
    names = ["219000001", "own", "982190001", "119000001", "21900000", "", "kutter æøå"]
    numbers = sensors.mmsi_of(names)
    assert (numbers[0], numbers[2]) == (219000001, 982190001)
    assert all(numbers[k] // 1_000_000 == 799 for k in (1, 3, 4, 5, 6))
    assert sensors.mmsi_of(["other", "own"])[1] == numbers[1]
    names = [f"vessel {k}" for k in range(3000)]
    numbers = sensors.mmsi_of(names)
    assert len(set(numbers)) == len(names)
    assert len({int(number) for number in sensors.mmsi_of([*names, *map(str, numbers)])}) == 2 * len(names)
    drawn = sorted((number - sensors.MADE_UP_MMSI) / 1e6 for number in numbers)
    assert stats.kstest(drawn, "uniform").pvalue > 1e-3
    # ITU-R M.1371-5, annex 1, tables 1 and 2.
    for speed_kn, ais_class, at_rest, expected in INTERVALS:
        found = reporting.rate(seen(10, speed_kn), ais_class, at_rest)
        assert (found.intervals_s == expected).all(), (speed_kn, ais_class)
        assert (found.between == (expected == 180 and ais_class == "A")).all()
    # It changes course when it is more than 5° from the mean of half a minute.
    for speed_kn, expected in ((5, 10 / 3), (18, 2), (30, 2)):
        found = reporting.rate(seen(120, speed_kn, heading_deg=np.arange(120.0)), "A", False)
        assert (found.intervals_s[60:] == expected).all()
        assert (found.between[60:] == (speed_kn < 23)).all()
    assert (reporting.rate(seen(120, 5, heading_deg=np.arange(120.0)), "B", False).intervals_s == 30).all()
    heading = np.concatenate([np.zeros(60), np.full(100, 6.0)])  # the mean is 5° behind for 5 s: 6 · 25/30 = 5
    changing = reporting.changes_course(seen(160, heading_deg=heading))
    assert np.flatnonzero(changing).tolist() == list(range(60, 60 + 4 + 20 + 1 - 1))
    assert not reporting.changes_course(seen(160, heading_deg=heading * 0.8)).any()
    speed = np.concatenate([np.full(100, 20.0), np.full(400, 5.0)])
    found = reporting.rate(seen(500, speed), "A", False).intervals_s
    assert (found == np.where(np.arange(500) < 280, 6, 10)).all()
    faster = reporting.rate(seen(500, speed[::-1]), "A", False).intervals_s
    assert (faster == np.where(np.arange(500) < 400, 10, 6)).all()
    times, intervals = np.arange(100, 400), np.concatenate([np.full(150, 180.0), np.full(150, 10.0)])
    due = reporting.due_times(times, intervals, 399.0, phase=0.5)
    assert due[:4].tolist() == [190.0, 250.0, 260.0, 270.0] and due[-1] == 390.0
    assert reporting.due_times(times, intervals[::-1], 399.0, phase=0.0).tolist() == list(range(110, 250, 10))


@pytest.mark.parametrize(("ais_class", "interval"), [("A", 10.0), ("A", 10 / 3), ("A", 2.0), ("A", 180.0), ("B", 30.0)])
def test_reports_come_at_their_interval_on_the_slots_of_a_minute(ais_class, interval):
    seconds = 200_000 if interval > 100 else 20_000
    times = np.arange(seconds)
    running = reporting.ReportingRate(np.full(seconds, interval), times < 0)
    schedule = reporting.position_schedule(times, seconds - 1.0, running, ais_class, phase=0.37)
    numbers = np.random.default_rng(3).random((len(schedule.due_s), 2))
    found = reporting.heard(schedule, times, seconds - 1.0, 0.0, numbers)
    gaps = np.diff(found.times_s)
    spread = schedule.spread_s[0]
    assert spread == (5 if ais_class == "B" else min(interval / 10, 2))
    assert abs(gaps.mean() - interval) < 2 * spread / len(gaps) + 1e-9
    assert np.abs(gaps - interval).max() <= 2 * spread + 60 / 2250
    assert np.std(gaps) == pytest.approx(spread * np.sqrt(2 / 3), rel=0.1)
    slots = found.times_s * 2250 / 60
    assert np.abs(slots - np.rint(slots)).max() < 1e-6
    age = found.times_s - times[found.rows]
    assert age.min() >= 0.2 - 1e-9 and age.max() <= 1.2
    if spread >= 1:  # else the phase shows
        assert stats.kstest(age - 0.2, "uniform").pvalue > 1e-4


def resting(times_s, heading_rad=0.3, velocity=(0.0, 0.0)):
    n = len(times_s)
    motion = np.tile([1000.0, -500.0], (n, 1)), np.tile(velocity, (n, 1)), np.full(n, heading_rad), np.zeros(n)
    return sensors.Stay(times_s, float(times_s[-1]), *motion, True)


def test_the_asked_share_of_reports_is_lost_and_others_scatter_about_the_truth():
    times = np.arange(100_000)
    every_ten = reporting.ReportingRate(np.full(100_000, 10.0), times < 0)
    schedule = reporting.position_schedule(times, 99_999.0, every_ten, "A", 0.0)
    draws = np.random.default_rng(1).random((len(schedule.due_s), 2))
    kept = len(reporting.heard(schedule, times, 99_999.0, 0.1, draws).times_s)
    everything = len(reporting.heard(schedule, times, 99_999.0, 0.0, draws).times_s)
    assert stats.binomtest(everything - kept, everything, 0.1).pvalue > 1e-3
    assert len(reporting.heard(schedule, times, 99_999.0, 1.0, draws).times_s) == 0
    assert np.diff(reporting.static_schedule(times, 99_999.0, 0.5).due_s) == pytest.approx(360)
    times = np.arange(50, 62)  # nothing is sent before there is a fix or after the vessel has left
    schedule = reporting.position_schedule(times, 61.0, reporting.ReportingRate(np.full(12, 2.0), times < 0), "A", 0.99)
    found = reporting.heard(schedule, times, 61.0, 0.0, np.random.default_rng(0).random((len(schedule.due_s), 2)))
    assert found.times_s.min() >= 50.2 and found.times_s.max() <= 61
    assert (found.rows >= 0).all()
    assert (times[found.rows] <= found.times_s).all()
    late = reporting.Schedule(np.full(200, 60.5), np.full(200, 2.0))
    found = reporting.heard(late, times, 61.0, 0.0, np.random.default_rng(1).random((200, 2)))
    assert 60 < len(found.times_s) < 160 and found.times_s.max() <= 61
    streams, origin, stay = Streams(4), (56.0, 12.0), resting(np.array([0, 1, 400]))
    errors = []
    for vessel in range(500):
        found = sensors.measured(stay, sensors.Noise.of(f"v{vessel}", streams, 401), origin, 3.0)
        errors.append(local_metres(found.latitude_deg, found.longitude_deg, origin) - [1000.0, -500.0])
    scaled = np.array(errors) / 3.0  # vessel, second, axis
    for second in range(3):
        low, high = stats.chi2.ppf([5e-4, 1 - 5e-4], 1000)
        assert low < (scaled[:, second] ** 2).sum() < high
    shared = np.corrcoef(scaled[:, 0].ravel(), scaled[:, 1].ravel())[0, 1]
    assert shared == pytest.approx(0.99, abs=0.003)
    assert abs(np.corrcoef(scaled[:, 0].ravel(), scaled[:, 2].ravel())[0, 1]) < 0.12  # 0.99⁴⁰⁰ = 0.018
    exact = sensors.measured(stay, sensors.Noise.of("v0", streams, 401), origin, 0.0)
    assert local_metres(exact.latitude_deg, exact.longitude_deg, origin) == pytest.approx(np.tile([1000, -500], (3, 1)))
    streams, stay = Streams(9), resting(np.arange(400), velocity=(3.0, 4.0))
    found = [sensors.measured(stay, sensors.Noise.of(f"v{k}", streams, 401), (0.0, 0.0), 3.0) for k in range(60)]
    speed = np.array([each.speed_kn for each in found]) * KNOT_M_S
    assert speed.mean() == pytest.approx(5.0, abs=0.002)
    assert speed.std() == pytest.approx(0.05, rel=0.03)
    course = np.array([each.course_deg for each in found])
    assert course.mean() == pytest.approx(np.rad2deg(np.arctan2(3, 4)), abs=0.02)
    assert course.std() == pytest.approx(np.rad2deg(0.05 / 5), rel=0.03)
    heading = np.array([each.heading_deg for each in found])
    assert heading.std(axis=1).mean() == pytest.approx(sensors.COMPASS_NOISE_DEG, rel=0.03)
    offsets = heading.mean(axis=1) - (90 - np.rad2deg(0.3))
    low, high = stats.chi2.ppf([5e-4, 1 - 5e-4], 60)
    assert low < (offsets**2).sum() / (sensors.COMPASS_OFFSET_DEG**2 + sensors.COMPASS_NOISE_DEG**2 / 400) < high


@pytest.mark.parametrize("origin", [(0.0, 0.0), (56.0, 12.6), (-70.0, 179.999), (78.2, -15.0)])
def test_headings_are_from_true_north_where_the_vessel_is(origin):
    """North of a place, found by a step along its meridian, against the world's second axis."""
    motion = np.array([[30_000.0, 8000.0]]), np.zeros((1, 2)), np.zeros(1), np.zeros(1)
    stay, errors = sensors.Stay(np.array([0]), 0.0, *motion, True), sensors.Noise.of("x", Streams(0), 401)
    found = sensors.measured(stay, errors, origin, 0.0)
    step = local_metres(found.latitude_deg + np.array([0.0, 1e-4]), found.longitude_deg.repeat(2), origin)
    east, north = np.diff(step, axis=0)[0]
    offset = float(found.heading_deg[0]) - (90 - np.rad2deg(np.arctan2(east, north)))
    assert abs(offset) < 5 * np.hypot(sensors.COMPASS_OFFSET_DEG, sensors.COMPASS_NOISE_DEG)
    flat = sensors.measured(resting(np.array([0]), 0.0), errors, (0.0, 0.0), 0.0)
    assert offset == pytest.approx(float(flat.heading_deg[0]) - 90, abs=0.02)


@pytest.mark.parametrize("origin", [(0.0, 0.0), (56.03, 12.65), (-70.0, 179.999), (89.9, 10.0)])
def test_places_and_local_metres_undo_each_other(origin):
    metres = np.random.default_rng(2).uniform(-2e5, 2e5, (200, 2))
    latitude, longitude = places(metres, origin)
    assert local_metres(latitude, longitude, origin) == pytest.approx(metres, abs=1e-3)
    assert (longitude >= -180).all() and (longitude < 180).all()
    none = places(np.zeros((0, 2)), origin)
    assert len(none[0]) == len(none[1]) == 0


def test_fields_come_back_as_they_were_sent_or_not_available_and_static_data_without_ids():
    tenths, rng = np.arange(1023), np.random.default_rng(8)
    latitude, longitude = rng.uniform(-90, 90, 1023), rng.uniform(-180, 180, 1023)  # in all quarters of the earth
    motion = {"speed_kn": tenths / 10 + 0.04, "course_deg": tenths * 3.6 - 1800.0}
    found = seen(1023, latitude_deg=latitude, longitude_deg=longitude, **motion)
    for row, ais_class in product(range(0, 1023, 3), "AB"):
        anchored = row % 2 == 1
        message = sent(log.position_fields(station(ais_class), found, row, False, anchored))
        assert message.speed == tenths[row] / 10
        assert message.course == round(10 * found.course_deg[row]) % 3600 / 10
        assert message.second == row % 60
        assert message.msg_type == (18 if ais_class == "B" else 3 if anchored else 1)
        assert abs(message.lat - latitude[row]) <= 0.5 / 600_000 + 5e-7  # the decoder rounds to six decimals
        assert abs(message.lon - longitude[row]) <= 0.5 / 600_000 + 5e-7
    found = seen(1, speed_kn=np.nan, course_deg=np.full(1, np.nan), heading_deg=359.6)
    message = sent(log.position_fields(station(length_m=30), found, 0, True, False))
    assert (message.speed, message.course, message.heading, message.turn) == (102.3, 360.0, 0, log.NO_TURN)
    assert (message.status, message.accuracy, message.raim, message.maneuver) == (1, False, False, 0)
    boat = sent(log.position_fields(station("B"), found, 0, True, False))
    assert (boat.speed, boat.course, boat.heading) == (102.3, 360.0, 511)
    assert boat.cs and boat.radio == 917510  # as carrier-sense stations send it
    for speed_kn in (500.0, 102.3):
        assert sent(log.position_fields(station(), seen(1, speed_kn=speed_kn), 0, False, False)).speed == 102.2
    for turn in (0, 0.01, 1, 10, 126.9, 127, 128, 127.5, 500, 708, 5000):
        for side in (1, -1):
            fields = log.position_fields(station(), seen(1, turn_deg_min=np.full(1, side * turn)), 0, False, False)
            values = [value - 48 if value < 88 else value - 56 for value in log.payload(fields)[0].encode()]
            number = int("".join(f"{value:06b}" for value in values)[42:50], 2)
            number -= 256 if number > 127 else 0
            assert number == side * min(round(4.733 * np.sqrt(turn)), 126), (turn, side)
            assert abs(log.turn_field(side * turn)) <= 708.8
    ship = sent(log.static_fields(station(), 0))
    assert (ship.msg_type, ship.shipname, ship.callsign, ship.ship_type) == (5, "SIM 219000001", "S3MDXHD", 60)
    assert (ship.to_bow, ship.to_stern, ship.to_port, ship.to_starboard) == (60, 30, 7, 8)
    assert (ship.month, ship.day, ship.hour, ship.minute, ship.imo, ship.draught) == (0, 0, 24, 60, 0, 0)
    name, size = (sent(log.static_fields(station("B"), part)) for part in (0, 1))
    assert (name.msg_type, name.partno, name.shipname) == (24, 0, "SIM 219000001")
    assert (size.msg_type, size.partno, size.callsign, size.to_bow, size.to_starboard) == (24, 1, "S3MDXHD", 60, 8)
    assert sent(log.static_fields(station("B", mmsi=982190001), 1)).mothership_mmsi == 0
    message = log.payload(log.position_fields(station(), seen(1), 0, False, False))
    for second in range(300):
        (line,) = log.lines(message, True, "B", 0, second + 0.9).splitlines()
        _, tag, sentence = line.split("\\")
        text, _, check = tag.partition("*")
        total = 0
        for letter in text.encode():
            total ^= letter
        assert check == f"{total:02X}"
        assert text == f"c:{log.EPOCH_S + second}"
        assert sentence.startswith("!AIVDO,1,1,,B,")
