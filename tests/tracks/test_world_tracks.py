"""Tracks in the world, read from CSV and from ROS 2 bags."""

import shutil
import sys
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from modsim3d.core.errors import InputError, ModsimError
from modsim3d.io.ros_bag import DETECTIONS_3D, ODOMETRY, VISION_MSGS
from modsim3d.runs.stored_run import StoredRun
from modsim3d.scene.ais.messages import places
from modsim3d.tracks.tracks import WorldTracks
from modsim3d.tracks.world_reading import is_world, read_world_tracks
from tests.tracks.track_files import CROSSER, ORIGIN, PLACES_M, TIMES_S, VELOCITIES_M_S, sea_run, write_csv

TWO = [CROSSER, 3]
STATE_COVARIANCE = np.array([[9.0, 1, 0.5, 0.2], [1, 4, 0.1, 0.3], [0.5, 0.1, 0.25, 0.05], [0.2, 0.3, 0.05, 0.16]])


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> StoredRun:
    return sea_run(tmp_path_factory.mktemp("sea") / "run")


def rows() -> dict[str, Any]:
    """Two tracks at all steps: the crosser and the anchored vessel."""
    w1, w2 = PLACES_M[:, TWO].reshape(-1, 2).T
    v1, v2 = np.tile(VELOCITIES_M_S[TWO], (len(TIMES_S), 1)).T
    times_s, track = np.repeat(TIMES_S, 2), ["a", "b"] * len(TIMES_S)
    return {"time_s": times_s, "track": track, "w1_m": w1, "w2_m": w2, "v1_m_s": v1, "v2_m_s": v2}


def changed(drop: str = "", **columns: Any) -> dict[str, Any]:
    """The rows without the columns that begin with one of some words, and with others."""
    kept = {name: values for name, values in rows().items() if not drop or not name.startswith(tuple(drop.split()))}
    many = 2 * len(TIMES_S)
    return kept | {name: np.full(many, value) if np.ndim(value) == 0 else value for name, value in columns.items()}


def all_at(latitude_deg: float, longitude_deg: float) -> dict[str, Any]:
    """The rows, all at one place."""
    return changed("w1 w2", latitude_deg=latitude_deg, longitude_deg=longitude_deg)


def with_covariances(size: int) -> dict[str, Any]:
    names, units = ("w1", "w2", "v1", "v2"), ("m2", "m2_s", "m2_s2")
    columns = {}
    for i in range(size):
        for j in range(i, size):
            what = f"{names[i]}_variance" if i == j else f"{names[i]}_{names[j]}_covariance"
            columns[f"{what}_{units[(i > 1) + (j > 1)]}"] = STATE_COVARIANCE[i, j]
    return changed(**columns)


def equal(one: WorldTracks, other: WorldTracks, places_m: float = 0.0) -> None:
    assert one.track_names == other.track_names
    np.testing.assert_array_equal(one.track, other.track)
    for name in ("time_s", "position_m", "velocity_m_s", "covariance"):
        close = places_m if name == "position_m" else 0.0
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=0, atol=close or 1e-6)


@pytest.fixture
def read_csv(run: StoredRun, tmp_path: Path) -> Callable[[dict[str, Any]], WorldTracks]:
    return lambda columns: read_world_tracks(write_csv(tmp_path / "t.csv", columns), run)


def test_csv_is_read_by_track_and_time_with_covariances_or_latitude_and_longitude(read_csv):
    tracks = read_csv(rows())
    assert (tracks.track_names, tracks.name, tracks.interval_s) == (("a", "b"), "t", 0.5)
    np.testing.assert_array_equal(tracks.time_s, np.tile(TIMES_S, 2))
    np.testing.assert_allclose(tracks.position_m, np.concatenate([PLACES_M[:, vessel] for vessel in TWO]))
    assert np.isnan(tracks.covariance).all()
    equal(read_csv(changed("time_s", step=np.repeat(np.arange(len(TIMES_S)), 2))), tracks)
    empty = read_csv({name: [] for name in rows()})
    assert (len(empty), empty.track_names, empty.interval_s) == (0, (), 0)
    times_s = np.array([0.0, 1.0, 5.0, 7.0])
    for track, interval_s in (([0, 0, 1, 2], 1), ([0, 1, 2, 3], 0)):  # that between estimates of one track
        found = WorldTracks.of("t", np.array(track), tuple("abcd")[: max(track) + 1], times_s, np.zeros((4, 2)))
        assert found.interval_s == interval_s
    tracks = read_csv(with_covariances(4))
    np.testing.assert_array_equal(tracks.covariance, np.broadcast_to(STATE_COVARIANCE, (len(tracks), 4, 4)))
    of_position = read_csv(with_covariances(2)).covariance
    np.testing.assert_array_equal(of_position[:, :2, :2], tracks.covariance[:, :2, :2])
    assert np.isnan(of_position[:, 2:]).all()
    in_scene = rows()
    latitude, longitude = places(np.column_stack([in_scene["w1_m"], in_scene["w2_m"]]), ORIGIN)
    # w2 at a place east of the origin points to the left of north there, by the convergence of the meridians.
    turn = np.deg2rad(longitude - ORIGIN[1]) * np.sin(np.deg2rad(latitude))
    course = np.arctan2(in_scene["v1_m_s"], in_scene["v2_m_s"]) + turn
    speed = np.hypot(in_scene["v1_m_s"], in_scene["v2_m_s"])
    polar = {"speed_m_s": speed, "course_deg": np.rad2deg(course)}
    for velocity in (polar, {"v_east_m_s": speed * np.sin(course), "v_north_m_s": speed * np.cos(course)}):
        columns = {"latitude_deg": latitude, "longitude_deg": longitude, **velocity}
        equal(read_csv(changed("w1 w2 v1 v2", **columns)), read_csv(in_scene), places_m=0.001)


def test_tracks_on_the_sea_are_told_from_those_in_images(tmp_path: Path) -> None:
    assert is_world(write_csv(tmp_path / "a.csv", {"track": [1], "w1_m": [2], "w2_m": [3]}))
    assert is_world(write_csv(tmp_path / "b.csv", {"track": [1], "longitude_deg": [2]}))
    assert not is_world(write_csv(tmp_path / "c.csv", {"track": [1], "x_min_px": [2], "w1_m": [3]}))
    assert not is_world(write_csv(tmp_path / "d.csv", {"1": [1], "2": [2]}))
    assert not is_world(tmp_path) and not is_world(tmp_path / "nowhere")
    (tmp_path / "metadata.yaml").touch()
    assert is_world(tmp_path)


STEPS, STEP_0 = np.repeat(np.arange(len(TIMES_S)), 2), "line 2: time_s 0 is that of step 0, but step is"
WRONG: dict[str, tuple[dict[str, Any], str]] = {
    "no track": (changed("track", name="a"), "has no column track"),
    "no time": (changed("time_s"), "has no column time_s, .* and no column step"),
    "no place": (changed("w1 w2"), r"must have one position: w1_m and w2_m or latitude_deg .* \(got none\)"),
    "half a place": (changed("w2"), "has not all of w1_m, w2_m: w2_m is missing"),
    "two places": (changed(latitude_deg=63.4, longitude_deg=10.4), r"one position.*\(got more than one\)"),
    "half a covariance": (changed(w1_variance_m2=1.0), "w1_w2_covariance_m2, w2_variance_m2 is missing"),
    "a slip": (changed("v2", v2_ms=1.0), "unknown column 'v2_ms': did you mean v2_m_s"),
    "text": (changed(w1_m="east"), r"line 2: w1_m must be a number \(got 'east'\)"),
    "a gap": (changed(w1_m=np.append(np.zeros(119), np.nan)), "line 121: has no position"),
    "a track without a name": (changed(track=["a", ""] * 60), "line 3: track is empty"),
    "too late": (changed(time_s=np.repeat(TIMES_S, 2) + 1), "line 118: time 30 s is outside .* 0 to 29.5 s"),
    "a step too far": (changed("time_s", step=60), r"line 2: step must be .* 0 to 59, the run's last \(got 60\)"),
    "half a step": (changed("time_s", step=0.5), r"line 2: step must be a whole number .* \(got 0.5\)"),
    "twice": (changed(track="a"), "line 3: a track may be there once at a time .*'a' again"),
    "step and time": (changed(step=np.roll(STEPS, 2)), rf"{STEP_0} 59: leave out the column that is wrong"),
    "step from 1": (changed(step=STEPS + 1), rf"{STEP_0} 1"),
    "no covariance": (
        changed(w1_variance_m2=1.0, w1_w2_covariance_m2=2.0, w2_variance_m2=1.0),
        "line 2: the covariance of the position is not positive definite",
    ),
    **{
        unit: (changed(time_s=np.repeat(TIMES_S, 2) * by), rf"is outside of the run.*they seem to be {unit}, must be")
        for unit, by in (("milliseconds", 1e3), ("microseconds", 1e6), ("nanoseconds", 1e9))
    },
    "lost digits": (
        changed(track=["2.19E+08", "2.20E+08"] * 60),
        r"line 2: track is a number in scientific notation that has lost digits.*\(got '2.19E\+08'\)",
    ),
    "infinite": (changed(v1_m_s=np.inf), r"line 2: v1_m_s must be a number \(got 'inf'\)"),
    "millimetres": (changed(w1_m=2e5, w2_m=0.0), "more than 100 km .* millimetres, must be metres"),
    "elsewhere": (changed(w1_m=3e12, w2_m=0.0), "more than 100 km .* metres along w1 and w2"),
    "swapped": (all_at(10.4, 63.4), "more than 100 km .*: latitude and longitude seem to be swapped"),
    "swapped by far": (all_at(120.0, 30.0), r"line 2: is no latitude.*\(got 120 and 30\): are latitude and longitude"),
    "radians": (all_at(*np.deg2rad(ORIGIN)), "seem to be radians, must be degrees"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_with_csv_is_said(name: str, read_csv) -> None:
    columns, said = WRONG[name]
    with pytest.raises(InputError, match=said):
        read_csv(columns)


def test_a_step_beside_a_time_may_be_rounded_and_steps_without_the_first_are_refused(read_csv):
    step_s = float(np.median(np.diff(TIMES_S)))
    steps = STEPS.astype(float)
    steps[3] = np.nan
    found = read_csv(changed(time_s=np.repeat(TIMES_S, 2) + 0.4 * step_s, step=steps))
    np.testing.assert_allclose(found.time_s, np.tile(TIMES_S + 0.4 * step_s, 2))
    later = {"track": ["a"] * 59, "step": range(59), "w1_m": PLACES_M[1:, CROSSER, 0], "w2_m": PLACES_M[1:, CROSSER, 1]}
    with pytest.raises(InputError, match=r"steps of the positions are a step too low: was the first step left out\?"):
        read_csv(later)
    for names in (["1e10", "12345e06"], ["0e02", "1e03"]):
        assert len(read_csv(changed(track=names * 60))) == 120


def near(noise_m: float) -> np.ndarray:
    """Positions of a tracker whose estimates are some metres off, shape (120, 2)."""
    exact = np.column_stack([rows()["w1_m"], rows()["w2_m"]])
    return exact + np.random.default_rng(3).normal(0, noise_m, exact.shape)


OWN_M = np.repeat(PLACES_M[:, 0], 2, axis=0)
"""Own ship makes 5 m/s along w1, so that its axes are the scene's but for where they begin."""
MISREAD: dict[str, tuple[Any, str]] = {
    "swapped": (lambda at: at[:, ::-1], "w1_m and w2_m of the positions are exchanged"),
    "mirrored w1": (lambda at: at * (-1, 1), "w1_m counts the other way round"),
    "mirrored w2": (lambda at: at * (1, -1), "w2_m counts the other way round"),
    "turned": (lambda at: -at, "w1_m and w2_m count the other way round"),
    "km": (lambda at: at / 1000, "seem to be kilometres, must be metres"),
    "nautical miles": (lambda at: at / 1852, "seem to be nautical miles"),
    "feet": (lambda at: at / 0.3048, "seem to be feet"),
    "cm": (lambda at: at * 100, "seem to be centimetres"),
    "quarter": (lambda at: at[:, ::-1] * (-1, 1), "the positions are turned by a right angle"),
    "relative": (lambda at: at - OWN_M, "relative to own ship, must be from the scene's zero"),
}


@pytest.mark.parametrize(("name", "noise_m"), [(name, noise_m) for name in MISREAD for noise_m in (0.0, 5.0)])
def test_positions_that_fit_in_another_reading_are_refused(name: str, noise_m: float, read_csv) -> None:
    change, said = MISREAD[name]
    w1, w2 = np.asarray(change(near(noise_m))).T
    with pytest.raises(InputError, match=rf"{said}.*then half of them are within .* m of a vessel"):
        read_csv(changed(w1_m=w1, w2_m=w2))


def test_a_tracker_that_is_right_late_or_lost_or_wrong_about_ranges_is_not_refused(read_csv) -> None:
    """Its errors are its own: a second late, far off, of false tracks all over the scene or lying still."""
    late = PLACES_M[np.maximum(np.arange(len(TIMES_S)) - 2, 0)][:, TWO].reshape(-1, 2)
    wild = np.random.default_rng(1).uniform(-100, 300, late.shape)
    ranges = [OWN_M + (near(5.0) - OWN_M) * factor for factor in (0.5, 0.7, 1.3, 1.5, 2.0, 2.5, 3.0)]
    still = [np.random.default_rng(seed).uniform((-100, -100), (300, 100), (2, 2)) for seed in range(30)]
    for at in (near(0.0), near(5.0), late, near(60.0) + 40, wild, *ranges, *(np.tile(pair, (60, 1)) for pair in still)):
        assert len(read_csv(changed(w1_m=at[:, 0], w2_m=at[:, 1]))) == 120


def test_marks_and_line_ends_change_nothing_and_cells_without_commas_are_named(run, tmp_path):
    path = write_csv(tmp_path / "t.csv", changed(track=["b\u00e5t", "b"] * 60))
    expected, text = read_world_tracks(path, run), path.read_bytes()
    for mark, end in product((b"", b"\xef\xbb\xbf"), (b"\n", b"\r\n", b"\r")):
        path.write_bytes(mark + text.replace("\u00e5".encode(), "a\u030a".encode()).replace(b"\n", end))
        assert is_world(path), (mark, end)
        equal(read_world_tracks(path, run), expected)
    path = write_csv(tmp_path / "t.csv", changed())
    text = path.read_text()
    for mark, name in ((";", "semicolons"), ("\t", "tabs"), ("|", "bars")):
        path.write_text(text.replace(",", mark))
        assert is_world(path)
        with pytest.raises(InputError, match=f"line 1 must name the columns.*its cells have {name} between them"):
            read_world_tracks(path, run)


def test_latitude_and_longitude_need_an_origin_and_a_bag_without_rosbags_names_the_extra(tmp_path, run, monkeypatch):
    nowhere = sea_run(tmp_path / "run", origin=None, steps=3)
    with pytest.raises(InputError, match="no such file"):
        read_world_tracks("nowhere.csv", nowhere)
    with pytest.raises(InputError, match="scene has no origin: give the scene the key origin"):
        read_world_tracks(write_csv(tmp_path / "t.csv", all_at(*ORIGIN)), nowhere)
    bag = write_bag(tmp_path / "bag", {"/t": (ODOMETRY, odometries()[:2])})
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(ModsimError, match=r'pip install "modsim3d\[ros\]"'):
        read_world_tracks(bag, run)


def store(messages: dict[str, str]) -> Any:
    types = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in messages.items():
        types.register(get_types_from_msg(text, name))
    return types


STORE = store(VISION_MSGS)


def make(name: str, *values: Any) -> Any:
    return STORE.types[name.replace("/", "/msg/")](*values)


def header(time_s: float, frame: str = "map") -> Any:
    ns = round(time_s * 1e9)
    return make("std_msgs/Header", make("builtin_interfaces/Time", ns // 10**9, ns % 10**9), frame)


def pose(place: np.ndarray, heading: float, covariance: np.ndarray) -> Any:
    whole = np.zeros((6, 6))
    whole[:2, :2] = covariance
    turn = Rotation.from_euler("z", heading).as_quat()
    at = make("geometry_msgs/Pose", make("geometry_msgs/Point", *place, 0.0), make("geometry_msgs/Quaternion", *turn))
    return make("geometry_msgs/PoseWithCovariance", at, whole.ravel())


def odometry(time_s: float, track: str, place: np.ndarray, velocity: np.ndarray, frame: str = "map") -> Any:
    """A track whose bow points to 0.7 rad, with its velocity along its own axes."""
    heading, whole = 0.7, np.zeros((6, 6))
    child_R_map = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    whole[:2, :2] = child_R_map @ STATE_COVARIANCE[2:, 2:] @ child_R_map.T
    vector = make("geometry_msgs/Vector3", *(child_R_map @ velocity), 0.0)
    twist = make("geometry_msgs/Twist", vector, make("geometry_msgs/Vector3", 0.0, 0.0, 0.0))
    covered = make("geometry_msgs/TwistWithCovariance", twist, whole.ravel())
    known = pose(place, heading, STATE_COVARIANCE[:2, :2])
    return make("nav_msgs/Odometry", header(time_s, frame), track, known, covered)


def arrays(*, foxy: bool = False) -> list[Any]:
    """The places of all steps without velocities; as vision_msgs of Foxy has them, whose results have id and score."""
    messages = []
    for time_s, both in zip(TIMES_S.tolist(), PLACES_M[:, TWO], strict=True):
        detections = []
        for name, place in zip("ab", both, strict=True):
            known = pose(place, 0.0, STATE_COVARIANCE[:2, :2])
            kind = ("boat", 1.0) if foxy else (make("vision_msgs/ObjectHypothesis", "boat", 1.0),)
            results = [make("vision_msgs/ObjectHypothesisWithPose", *kind, known)]
            box = make("vision_msgs/BoundingBox3D", known.pose, make("geometry_msgs/Vector3", 0.0, 0.0, 0.0))
            identity = (True, name) if foxy else (name,)
            detections.append(make("vision_msgs/Detection3D", header(time_s), results, box, *identity))
        messages.append(make("vision_msgs/Detection3DArray", header(time_s), detections))
    return messages


def write_bag(folder: Path, topics: dict[str, tuple[str, list[Any]]], storage: str = "mcap") -> Path:
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(folder, version=8, storage_plugin=plugin) as writer:
        for topic, (kind, messages) in topics.items():
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for number, message in enumerate(messages):
                writer.write(connection, number, STORE.serialize_cdr(message, kind))
    return folder


def odometries(frame: str = "map") -> list[Any]:
    return [
        odometry(time_s, name, PLACES_M[step, vessel], VELOCITIES_M_S[vessel], frame)
        for step, time_s in enumerate(TIMES_S.tolist())
        for name, vessel in zip("ab", TWO, strict=True)
    ]


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_bag_of_odometry_equals_csv(storage: str, run: StoredRun, tmp_path: Path) -> None:
    columns = {name: values for name, values in with_covariances(4).items() if not name.endswith("_m2_s")}
    bag = write_bag(tmp_path / "bag", {"/tracks": (ODOMETRY, odometries())}, storage)
    (file,) = set(bag.iterdir()) - {bag / "metadata.yaml"}
    alone = shutil.copy(file, tmp_path / file.name)
    expected = read_world_tracks(write_csv(tmp_path / "t.csv", columns), run)
    for path in (bag, file, *([alone] if storage == "mcap" else [])):
        assert is_world(path)
        equal(read_world_tracks(path, run), expected)


def without_velocity() -> dict[str, Any]:
    return {name: values for name, values in with_covariances(2).items() if name[:2] not in ("v1", "v2")}


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_bag_of_arrays_equals_csv_without_velocity(storage: str, read_csv, run: StoredRun, tmp_path: Path) -> None:
    topics = {"/tracks": (DETECTIONS_3D, arrays()), "/odom": (ODOMETRY, odometries()[:2])}
    equal(read_world_tracks(write_bag(tmp_path / "bag", topics, storage), run), read_csv(without_velocity()))


def test_a_bag_of_old_vision_msgs_is_read(read_csv, run: StoredRun, tmp_path: Path, monkeypatch) -> None:
    """Those of Foxy, whose detections have tracking_id and whose results have id and score themselves."""
    old = {name: text for name, text in VISION_MSGS.items() if not name.endswith("ObjectHypothesis")}
    result, detection = "vision_msgs/msg/ObjectHypothesisWithPose", "vision_msgs/msg/Detection3D"
    old[result] = "string id\nfloat64 score\ngeometry_msgs/PoseWithCovariance pose\n"
    old[detection] = old[detection].replace("string id", "bool is_tracking\nstring tracking_id")
    monkeypatch.setattr("tests.tracks.test_world_tracks.STORE", store(old))
    bag = write_bag(tmp_path / "bag", {"/tracks": (DETECTIONS_3D, arrays(foxy=True))})
    equal(read_world_tracks(bag, run), read_csv(without_velocity()))


def test_what_is_wrong_with_a_bag_is_said(run: StoredRun, tmp_path: Path) -> None:
    def refused(name: str, said: str, topic: str | None = None, **topics: tuple[str, list[Any]]) -> None:
        bag = write_bag(tmp_path / name, {f"/{key}": value for key, value in topics.items()})
        with pytest.raises(InputError, match=said):
            read_world_tracks(bag, run, topic)

    good = ODOMETRY, odometries()[:4]
    off = r"/t message 1: frame_id must be 'map', the scene's axes \(got 'odom'\)"
    refused("frame", off, t=(ODOMETRY, odometries("odom")))
    refused("two", r"must have one topic of nav_msgs/msg/Odometry \(got 2: /s, /t\)", s=good, t=good)
    other = ("std_msgs/msg/Header", [header(0)])
    refused("none", r"must have a topic of .* \(got /h \(std_msgs/msg/Header\)\)", h=other)
    refused("which", r"has no topic /u of .*\(known: /t\)", "/u", t=good)
    late = [odometry(31.0, "a", PLACES_M[0, 1], VELOCITIES_M_S[1])]
    refused("late", r"/t message 1: time 31 s is outside of the run", t=(ODOMETRY, late))
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "metadata.yaml").write_text("a: [", encoding="utf-8")
    with pytest.raises(InputError, match="cannot be read as a ROS 2 bag"):
        read_world_tracks(tmp_path / "broken", run)
    damaged = write_bag(tmp_path / "damaged", {"/t": good}) / "damaged.mcap"
    content = damaged.read_bytes()
    third = len(content) // 3
    damaged.write_bytes(content[:third] + b"\xff" * 400 + content[third + 400 :])
    with pytest.raises(InputError, match="cannot be read as a ROS 2 bag"):
        read_world_tracks(damaged.parent, run)
    (tmp_path / "alone.db3").write_bytes(b"")
    with pytest.raises(InputError, match=r"metadata\.yaml is missing beside it: give the whole folder"):
        read_world_tracks(tmp_path / "alone.db3", run)
