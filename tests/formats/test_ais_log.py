"""`modsim3d export --format ais`: the log of a whole run, read by pyais and by `modsim3d ais`."""

import csv
import io
import json
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from pyais.messages import NMEASentenceFactory
from pyais.stream import IterMessages
from scipy import stats

from modsim3d.core.errors import ModsimError
from modsim3d.core.random_streams import Streams
from modsim3d.formats.writing.ais.log import EPOCH_S, files, notes, reports, write
from modsim3d.formats.writing.ais.sensors import stations, stays
from modsim3d.formats.writing.export_formats import ExportRequest
from modsim3d.runs.run import run_scene
from modsim3d.runs.stored_run import open_run
from modsim3d.scene.ais.messages import local_metres
from modsim3d.scene.ais.options import Options
from modsim3d.scene.ais.traffic import read_traffic
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene
from tests.command_line import call as command
from tests.runs.test_stream import lines as live_lines
from tests.runs.test_stream import live_scene
from tests.scene.ais.ais_builders import SAMPLES
from tests.scenes import camera_keys

STEPS, STEP_S = 500, 1.0
ORIGIN = (56.03, 12.65)
SIZES = {"own": (12, 4), "big ship": (180, 28), "turner": (60, 10), "sloop": (10, 3), "anchored": (80, 13)}
SIZES |= {"visitor": (45, 9), "canoe": (4.5, 0.8), "219000001": (30, 8)}
BOW = camera_keys(400, 300, mount={"vessel": "own", "position_m": [4, 0, 4]})
SHORE = camera_keys(400, 300, pose={"position_m": [-900, -900, 20]})


def tracks():
    """Positions and headings of the vessels of `SIZES`, shapes (T, N, 2) and (T, N)."""
    t = np.arange(STEPS) * STEP_S
    circle = np.deg2rad(t)
    straight = {"own": (0.0, 0.0, 5.0, 0.0), "big ship": (200.0, 400.0, 6.0, 6.0), "sloop": (300.0, -200.0, -3.0, 1.0)}
    straight |= {"anchored": (500.0, -600.0, 0.0, 0.0), "visitor": (-200.0, 900.0, 0.0, -7.0)}
    straight |= {"canoe": (150.0, 90.0, 1.0, 0.0), "219000001": (-500.0, -300.0, 0.0, 13.0)}
    places, headings = {}, {}
    for name, (w1, w2, v1, v2) in straight.items():
        places[name] = np.stack([w1 + v1 * t, w2 + v2 * t], axis=-1)
        headings[name] = np.full(STEPS, np.arctan2(v2, v1))
    places["turner"] = np.stack([900 + 250 * np.cos(circle), 900 + 250 * np.sin(circle)], axis=-1)
    headings["turner"] = circle + np.pi / 2
    away = (t < 60) | ((t > 200) & (t < 300)) | (t > 430)
    places["visitor"][away] = headings["visitor"][away] = np.nan
    return np.stack([places[name] for name in SIZES], axis=1), np.stack([headings[name] for name in SIZES], axis=1)


def scene_of(steps: int = STEPS, **keys: Any) -> Scene:
    positions, headings = (values[:steps] for values in tracks())
    size = {name: {"length_m": length, "beam_m": beam} for name, (length, beam) in SIZES.items()}
    content = {
        "vessels": {name: {**sides, "air_draft_m": 6, "label": "Vessel"} for name, sides in size.items()},
        "poses": {"positions_m": positions, "headings_rad": headings, "time_step_s": STEP_S},
        "cameras": {"bow": BOW, "shore": SHORE},
        "origin": {"latitude_deg": ORIGIN[0], "longitude_deg": ORIGIN[1]},
        "annotation": {"mode": 2, "source": "analytic", "allow_camera_inside": True},
        "detector": "thesis",
        "ais": {"vessels": {"sloop": "B"}, "drop_out": 0.1},
    }
    return Scene.from_dict({"seed": 3, **content, **keys})


@dataclass(frozen=True)
class Line:
    """A message of a log: what pyais decodes, the second of its tag block, and whether own ship sent it."""

    message: Any
    time_s: int
    own: bool


def read(text: bytes) -> list[Line]:
    """All messages of a log, by pyais; every checksum holds and every part is there."""
    found, parts = [], []
    for raw in text.splitlines(keepends=True):
        assert raw.endswith(b"\r\n")
        sentence = NMEASentenceFactory.produce(raw)
        sentence.tag_block.init()
        assert sentence.is_valid and sentence.tag_block.is_valid
        assert len(raw.split(b"\\")[2]) <= 82
        parts.append(raw)
        if sentence.frag_num == sentence.frag_cnt:
            (whole,) = IterMessages(parts)
            found.append(Line(whole.decode(), int(sentence.tag_block.receiver_timestamp), sentence.type == "VDO"))
            parts = []
    assert not parts
    return found


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ais") / "run"
    run_scene(scene_of(waves={"level": "large", "apply_to": "all"}), folder)
    return folder


@pytest.fixture(scope="module")
def out(run, tmp_path_factory):
    folder = tmp_path_factory.mktemp("log")
    write(ExportRequest(open_run(run), (0, 1)), folder)
    return folder


@pytest.fixture(scope="module")
def log(out):
    return read((out / "ais.nmea").read_bytes())


@pytest.fixture(scope="module")
def vessels(out):
    """MMSI → vessel, of those that send."""
    rows = csv.DictReader(io.StringIO((out / "ais_truth.csv").read_text()))
    return {int(row["mmsi"]): row["vessel"] for row in rows if row["mmsi"]}


def positions(log, vessels=None, name=None):
    """Reports of position, of a vessel or of all."""
    found = [each for each in log if each.message.msg_type in (1, 3, 18)]
    return [each for each in found if name is None or vessels[each.message.mmsi] == name]


def sent(scene: Scene, steps: int) -> list[Any]:
    """What the vessels of a scene without an own ship send."""
    return list(reports(scene, steps, stations(scene, ())))


def fix_s(line) -> int:
    """The second at which a position was taken: the last before the tag block's that ends like the report's."""
    since = line.time_s - EPOCH_S
    return since - (since - line.message.second) % 60


def test_the_log_is_in_order_by_class_and_reports_lie_about_the_truth_as_noise_explains(log, vessels, out):
    times = [each.time_s for each in log]
    assert times == sorted(times)
    own = [each for each in positions(log) if each.own]
    assert {vessels[each.message.mmsi] for each in own} == {"own"}
    assert [each.time_s - EPOCH_S for each in own] == [fix_s(each) for each in own] == list(range(STEPS))
    assert not [each for each in log if not each.own and vessels[each.message.mmsi] == "own"]
    first = next(each.message for each in log if each.message.msg_type == 5 and each.own)
    assert (first.to_bow + first.to_stern, first.to_port + first.to_starboard) == (12, 4)
    text = (out / "ais.nmea").read_bytes()
    decoded = " ".join(str(each.message) for each in log)
    for name in SIZES.keys() - {"219000001"}:
        assert name.encode() not in text.lower() and name.upper() not in decoded.upper()
    assert {each.message.shipname.split()[0] for each in log if each.message.msg_type == 5} == {"SIM"}
    kinds: dict[str, set[int]] = {}
    for each in log:
        kinds.setdefault(vessels[each.message.mmsi], set()).add(each.message.msg_type)
    assert "canoe" not in kinds
    assert kinds["sloop"] <= {18, 24} and 18 in kinds["sloop"]
    assert kinds["anchored"] <= {3, 5} and kinds["turner"] <= {1, 3, 5}
    assert kinds["big ship"] <= {1, 5}
    rows = {row["vessel"]: row for row in csv.DictReader(io.StringIO((out / "ais_truth.csv").read_text()))}
    assert list(rows) == list(SIZES)
    assert rows["canoe"] == {"vessel": "canoe", "ais_class": "none", "mmsi": "", "own_ship": "0"}
    assert (rows["own"]["ais_class"], rows["own"]["own_ship"], rows["sloop"]["ais_class"]) == ("A", "1", "B")
    assert rows["219000001"]["mmsi"] == "219000001"
    # Through the sides and the heading of a report, as a reader has to, from the antenna to the hull's centre
    truth, headings = tracks()
    column = {name: k for k, name in enumerate(SIZES)}
    sides = {s.mmsi: s.sides_m for s in stations(scene_of(), (0,))}
    errors: dict[str, list[Any]] = {}
    for each in positions(log):
        message, second = each.message, fix_s(each)
        name = vessels[message.mmsi]
        assert each.time_s - EPOCH_S - second in (0, 1)
        place = local_metres(np.array([message.lat]), np.array([message.lon]), ORIGIN)[0]
        bow, stern, port, starboard = sides[message.mmsi]
        heading = headings[second, column[name]]
        ahead = np.array([np.cos(heading), np.sin(heading)])
        centre = place + ahead * (bow - stern) / 2 + np.array([-ahead[1], ahead[0]]) * (port - starboard) / 2
        errors.setdefault(name, []).append(centre - truth[second, column[name]])
        if message.msg_type != 18:
            off = message.heading - (90 - np.rad2deg(heading))
            assert abs((off + 180) % 360 - 180) < 12  # yaw in waves, compass, rounding
    for name, found in errors.items():
        root = np.sqrt(np.mean(np.square(found)))
        # A few independent errors of 3 m in each track, and up to a few metres from waves that swing the antenna.
        assert root < 3 * 3 + 2, name
    everything = np.concatenate([np.array(found[:: len(found) // 2 + 1]) for found in errors.values()])
    assert 1 < np.sqrt(np.mean(everything**2)) < 6


def test_the_same_run_gives_the_same_bytes_and_neither_another_vessel_nor_blocks_show(run, out, tmp_path, monkeypatch):
    write(ExportRequest(open_run(run), (0, 1)), tmp_path)
    for name in ("ais.nmea", "ais_truth.csv"):
        assert (tmp_path / name).read_bytes() == (out / name).read_bytes()
    first, again, other = (list(reports(scene_of(60, seed=s), 60, stations(scene_of(60), ()))) for s in (3, 3, 4))
    assert first == again != other
    everyone, waves = sent(scene_of(200), 200), {"level": "large", "apply_to": "all"}
    without = {"vessels": {"sloop": "none", "own": "none"}, "drop_out": 0.1}
    assert set(sent(scene_of(200, ais=without), 200)) < set(everyone)
    assert sent(scene_of(200, sea="curved"), 200) == everyone
    whole = sent(scene_of(100, waves=waves), 100)
    monkeypatch.setattr("modsim3d.formats.writing.ais.sensors.BLOCK_STEPS", 7)
    assert sent(scene_of(100, waves=waves), 100) == whole


def test_a_track_is_steady_where_the_heading_passes_the_world_s_first_axis_and_no_number_is_drawn_twice(monkeypatch):
    turner = [station for station in stations(scene_of(), ()) if station.name == "turner"]
    ((stay,),) = stays(scene_of(), STEPS, turner)
    assert np.rad2deg(stay.turn_rad_s) == pytest.approx(1.0, abs=1e-6)
    assert np.linalg.norm(stay.velocity_m_s, axis=1) == pytest.approx(np.deg2rad(1) * np.hypot(250, 15), rel=1e-3)
    assert np.rad2deg(np.ptp(stay.heading_rad)) == pytest.approx(STEPS - 1) and not stay.at_rest
    drawn: list[tuple[Any, ...]] = []
    uniforms = Streams.uniforms

    def recorded(self, purpose, *names, first, count):
        drawn.extend((purpose, *names, step) for step in range(first, first + count))
        return uniforms(self, purpose, *names, first=first, count=count)

    monkeypatch.setattr(Streams, "uniforms", recorded)
    assert sent(scene_of(), STEPS)
    assert len(drawn) == len(set(drawn)) > 0


def test_what_is_lost_is_others_and_a_camera_ashore_has_no_own_ship(run):
    """Own ship's receiver has its reports from its own station; class B sends its size after its name."""
    scene = scene_of(ais={"drop_out": 1})
    assert {(each.own, each.kind) for each in reports(scene, 20, stations(scene, (0,)))} == {(True, 0), (True, 1)}
    scene = scene_of(ais={"vessels": {"sloop": "B"}, "drop_out": 0})
    sloop = next(station for station in stations(scene, ()) if station.name == "sloop")
    found = list(reports(scene, STEPS, (sloop,)))
    name, size = (next(each.time_s for each in found if each.kind == kind) for kind in (1, 2))
    assert 26 <= (size - name) % 360 <= 34
    scene = open_run(run).scene
    carried = stations(scene, ())
    assert carried[0].ais_class == "B" and not any(station.own for station in carried)  # as any boat of twelve metres
    found = [each for each in reports(scene, 200, carried) if each.mmsi == carried[0].mmsi]
    assert found and not any(each.own for each in found)


def test_vessels_send_as_often_as_they_should_and_modsim3d_ais_finds_their_tracks(log, vessels, out):
    """Interval 3⅓ s, and 6 s twice, as far as nothing is lost; 500 s with a tenth of the reports lost."""
    for name, interval in (("turner", 10 / 3), ("big ship", 6.0), ("219000001", 2.0)):
        low, high = stats.binom.ppf([1e-4, 1 - 1e-4], round(STEPS / interval), 0.9)
        assert low - 3 <= len(positions(log, vessels, name)) <= high + 1
    assert 2 <= len(positions(log, vessels, "anchored")) <= 3
    assert 11 <= len(positions(log, vessels, "sloop")) <= 17
    seconds = np.array([fix_s(each) for each in positions(log, vessels, "visitor")])
    assert (((seconds >= 60) & (seconds <= 200)) | ((seconds >= 300) & (seconds <= 430))).all()
    assert (seconds < 200).sum() > 10 and (seconds >= 300).sum() > 10

    def of(name, field):
        return np.array([getattr(each.message, field) for each in positions(log, vessels, name)])

    knots = np.sqrt(72) * 3600 / 1852
    assert of("big ship", "speed").mean() == pytest.approx(knots, abs=0.1)
    assert of("big ship", "course").mean() == pytest.approx(45, abs=0.5)
    assert (of("anchored", "status") == 1).all() and (of("big ship", "status") == 0).all()
    assert (of("anchored", "speed") < 3).all()
    turn = of("turner", "turn")
    assert np.median(turn) == pytest.approx(-60, abs=4)  # a degree a second to port
    assert (of("own", "turn") == -128).all()  # too short for a gyrocompass
    assert (of("sloop", "heading") == 511).all()
    traffic = read_traffic([out / "ais.nmea"], Options(origin=ORIGIN))
    assert sum(traffic.dropped.values()) == traffic.dropped["particulars_only"]
    truth, headings = tracks()
    shown = {vessels[track.mmsi]: track for track in traffic.vessels}
    assert set(shown) == {vessels[mmsi] for mmsi in vessels}
    offset = round(traffic.grid.start_s - EPOCH_S)
    for column, name in enumerate(SIZES):
        if name not in ("own", "big ship", "turner", "219000001"):
            continue  # of the others some have no name and size in this time, or come and go
        track = shown[name]
        steps = track.steps + offset
        errors = np.linalg.norm(track.places_m - truth[steps, column], axis=1)
        # The tag block's second is up to a second late, and without its size the hull is off by half of it.
        known = "antenna" not in track.hull.defaults
        speed = np.linalg.norm(truth[1, column] - truth[0, column])
        assert np.median(errors) < 3 * 3 + speed + (0 if known else SIZES[name][0] / 2), name
        turned = np.abs(np.angle(np.exp(1j * (track.headings_rad - headings[steps, column]))))
        assert np.rad2deg(np.median(turned)) < 5, name
    assert "antenna" not in shown["own"].hull.defaults
    assert (shown["own"].hull.length_m, shown["own"].hull.beam_m) == (12, 4)


def test_a_scene_of_modsim3d_ais_knows_where_it_lies(monkeypatch, tmp_path, capsys):
    scene = ("ais", SAMPLES / "danish.csv", "--out", tmp_path / "scene", "--origin", "56.03,12.65")
    assert command(monkeypatch, *scene) == 0
    made = load_scene(tmp_path / "scene", steps=10, source="analytic")
    assert made.origin == ORIGIN
    run_scene(made, tmp_path / "run")
    capsys.readouterr()
    document = json.loads((tmp_path / "run" / "scene" / "scene.json").read_text())
    assert document["origin"] == {"latitude_deg": 56.03, "longitude_deg": 12.65}
    assert command(monkeypatch, "export", tmp_path / "run", "--format", "ais", "--out", tmp_path / "out") == 0
    assert not capsys.readouterr().err
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"ais.nmea", "ais_truth.csv"}
    found = read((tmp_path / "out" / "ais.nmea").read_bytes())
    known = {int(name) for name in made.vessel_names}
    assert {each.message.mmsi for each in found} <= known and found
    assert all(abs(each.message.lat - 56.03) < 0.1 and abs(each.message.lon - 12.65) < 0.1 for each in positions(found))


def exported(scene: Scene, folder) -> list[Line]:
    run_scene(scene, folder / "run")
    write(ExportRequest(open_run(folder / "run"), (0, 1)), folder / "out")
    return read((folder / "out" / "ais.nmea").read_bytes())


def test_nobody_sends_or_a_live_run_are_exported_and_a_log_has_one_own_ship(tmp_path, monkeypatch, capsys):
    nobody = {"vessels": dict.fromkeys(SIZES, "none")}
    assert not exported(scene_of(ais=nobody, steps=5), tmp_path / "nobody")
    assert (tmp_path / "nobody" / "out" / "ais.nmea").read_bytes() == b""
    assert (tmp_path / "nobody" / "out" / "ais_truth.csv").read_text().count("none") == len(SIZES)
    (own, *_) = [each for each in exported(scene_of(steps=1), tmp_path / "one") if each.own]
    assert (own.message.speed, own.message.course, own.time_s) == (102.3, 360.0, EPOCH_S)
    text = "".join(live_lines(21)).encode()
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(text)))
    run_scene(live_scene(tmp_path), tmp_path / "live")
    opened = open_run(tmp_path / "live")
    request = ExportRequest(opened, (0,))
    write(request, tmp_path / "sent")
    found = read((tmp_path / "sent" / "ais.nmea").read_bytes())
    assert [fix_s(each) for each in positions(found) if each.own] == [0, 1, 2]
    assert notes(request) == ("the scene has no origin, so w1 = w2 = 0 is at latitude 0, longitude 0",)
    other = camera_keys(400, 300, mount={"vessel": "turner", "position_m": [9, 0, 8]})
    cameras = {"bow": BOW, "other": other, "shore": SHORE}
    run_scene(scene_of(cameras=cameras, steps=3), tmp_path / "run")
    export = ("export", tmp_path / "run", "--format", "ais", "--out", tmp_path / "out")
    assert command(monkeypatch, *export) == 2
    said = capsys.readouterr().err
    assert "the cameras are on board 'own' and 'turner'" in said and "--camera" in said and "Traceback" not in said
    assert not (tmp_path / "out").exists()
    assert command(monkeypatch, *export, "--camera", "other", "--camera", "shore") == 0
    rows = csv.DictReader(io.StringIO((tmp_path / "out" / "ais_truth.csv").read_text()))
    assert [row["vessel"] for row in rows if row["own_ship"] == "1"] == ["turner"]
    with pytest.raises(ModsimError, match="one own ship"):
        files(ExportRequest(open_run(tmp_path / "run"), (0, 1)))
