"""ROS 2 bags, read back with rosbags and with mcap_ros2."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import modsim3d
from modsim3d.core.errors import InputError
from modsim3d.formats.writing.export_formats import ExportRequest
from modsim3d.formats.writing.mcap import FILES, write
from modsim3d.formats.writing.mcap_messages import stamps_ns
from modsim3d.runs import pipeline
from tests.cli.bad_input.builders import content
from tests.formats import bags

BOW, BEAM, QUAY = "bow_cam", "camera_2_beam", "quay"
FRAMES = {BOW: "bow.cam", BEAM: "2-beam", QUAY: "quay"}
EDGES = [(a, b) for a in range(8) for b in range(a) if (a ^ b).bit_count() == 1]


def export(run: modsim3d.StoredRun, folder: Path, cameras: tuple[int, ...] | None = None) -> Path:
    write(ExportRequest(run, cameras or tuple(range(len(run.scene.cameras)))), folder)
    return folder


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> modsim3d.StoredRun:
    folder = tmp_path_factory.mktemp("mcap") / "run"
    modsim3d.run_scene(bags.voyage(), folder)
    return modsim3d.open_run(folder)


@pytest.fixture(scope="module")
def out(run, tmp_path_factory) -> Path:
    return export(run, tmp_path_factory.mktemp("mcap") / "bags")


@pytest.fixture(scope="module")
def tracker(out) -> bags.Topics:
    return bags.read_with_rosbags(out / "detections")


@pytest.fixture(scope="module")
def truth(out) -> bags.Topics:
    return bags.read_with_rosbags(out / "truth")


def test_both_readers_read_the_same_in_every_field_and_metadata_is_what_humble_reads(out):
    for bag in ("detections", "truth"):
        by_rosbags, by_mcap = bags.read_with_rosbags(out / bag), bags.read_with_mcap_ros2(out / bag)
        assert by_rosbags.keys() == by_mcap.keys()
        assert all(bags.plain(by_rosbags[topic]) == bags.plain(by_mcap[topic]) for topic in by_mcap)
    played = bags.all_bytes(out / "detections")
    assert b"base_link" in played and b"coastal" not in played
    for name in (bags.FERRY, bags.KAYAK):
        assert name.encode() not in played and name[5:].encode() not in played
        assert name.encode() in bags.all_bytes(out / "truth")  # so that it would be found
    # Humble takes profiles as one text, up to version 8; its play needs /tf_static latched
    for bag, topics in (("detections", 10), ("truth", 4)):
        about = yaml.safe_load((out / bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
        assert about["version"] == 8 and about["storage_identifier"] == "mcap"
        assert about["relative_file_paths"] == [f"{bag}.mcap"]
        assert (about["compression_format"], about["compression_mode"]) == ("", "")
        assert about["starting_time"]["nanoseconds_since_epoch"] == 0
        assert about["duration"]["nanoseconds"] == 1_300_000_000
        entries = [each["topic_metadata"] for each in about["topics_with_message_count"]]
        assert len(entries) == topics
        profiles = {each["name"]: each["offered_qos_profiles"] for each in entries}
        assert all(isinstance(text, str) for text in profiles.values())
        latched = yaml.safe_load(profiles.pop("/tf_static", "")) or []
        found = [(each["durability"], each["reliability"], each["history"]) for each in latched]
        assert found == ([(1, 1, 1)] if bag == "detections" else [])
        assert set(profiles.values()) == {""}


def check_projection(tracker: bags.Topics, truth: bags.Topics) -> int:
    """Project every vessel's hull with what the bags have, and compare with the true boxes that no edge cuts."""
    frames, checked = bags.Frames(tracker, truth), 0
    along = np.linspace(0, 1, 40)[:, None]
    for name in (topic.split("/")[2] for topic in truth if topic.startswith("/truth/")):
        info = tracker[f"/{name}/camera_info"][0].content
        for stamp_ns, message in truth[f"/truth/{name}/boxes"]:
            camera_T_map = np.linalg.inv(frames.map_T(f"{name}_optical_frame", stamp_ns))
            for each, box in zip(message.detections, bags.boxes_of(message), strict=True):
                if min(box) <= 0 or box[2] >= info.width or box[3] >= info.height:
                    continue
                size = bags.VESSELS[each.id]
                signs = np.array([[(k >> axis) & 1 for axis in range(3)] for k in range(8)]) - [0.5, 0.5, 0]
                corners = signs * [size["length_m"], size["beam_m"], size["air_draft_m"]]
                hull = np.concatenate([corners[a] + along * (corners[b] - corners[a]) for a, b in EDGES])
                camera_T_vessel = camera_T_map @ frames.map_T(f"truth/{each.id}", stamp_ns)
                pixels = bags.projected(hull @ camera_T_vessel[:3, :3].T + camera_T_vessel[:3, 3], info)
                found = np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])
                np.testing.assert_allclose(found, box, rtol=0, atol=0.01 if any(info.d) else 1e-6)
                checked += 1
    return checked


@pytest.mark.parametrize("composition", ["rigid", "additive"])
def test_hulls_through_frames_and_lens_are_the_true_boxes_in_any_waves(tracker, truth, tmp_path, composition) -> None:
    assert check_projection(tracker, truth) > 30
    scene = bags.voyage(waves={"level": "huge", "composition": composition})
    modsim3d.run_scene(scene, tmp_path / "run")
    out = export(modsim3d.open_run(tmp_path / "run"), tmp_path / "bags")
    high, truth = (bags.read_with_rosbags(out / bag) for bag in ("detections", "truth"))
    assert check_projection(high, truth) > 20
    moving, fixed = ({f.child_frame_id for m in high[t] for f in m.content.transforms} for t in ("/tf", "/tf_static"))
    on_board = {f"{BOW}_optical_frame", f"{BEAM}_optical_frame"} if composition == "additive" else set()
    assert moving == {"base_link"} | on_board and not moving & fixed


def vectors(messages: list[Any]) -> np.ndarray:
    """The x, y and z of each, shape (n, 3)."""
    return np.array([[each.x, each.y, each.z] for each in messages])


def turns(quaternions: list[Any]) -> Any:
    return bags.Rotation.from_quat([[q.x, q.y, q.z, q.w] for q in quaternions])


def test_topics_are_those_of_the_run_and_own_ship_is_that_of_the_table_in_axes_of_rep_103(out, tracker, truth, run):
    steps, slow = bags.STEPS, 5  # at 0.1, 0.4, 0.6, 0.9 and 1.1 s
    moving = {"/tf": steps, "/odom": steps, "/imu": steps, "/tf_static": 1}
    seen = {f"/{name}/{kind}": steps for name in (BOW, QUAY) for kind in ("camera_info", "detections")}
    slowly = {f"/{BEAM}/camera_info": slow, f"/{BEAM}/detections": slow}
    assert {topic: len(messages) for topic, messages in tracker.items()} == moving | seen | slowly
    boxes = {f"/truth/{name}/boxes": slow if name == BEAM else steps for name in FRAMES}
    assert {topic: len(messages) for topic, messages in truth.items()} == {"/tf": steps} | boxes
    kinds = {topic: messages[0].content.__msgtype__ for topic, messages in (tracker | truth).items()}
    assert kinds["/odom"] == "nav_msgs/msg/Odometry" and kinds["/imu"] == "sensor_msgs/msg/Imu"
    assert kinds["/tf"] == kinds["/tf_static"] == "tf2_msgs/msg/TFMessage"
    assert {kinds[f"/{name}/camera_info"] for name in FRAMES} == {"sensor_msgs/msg/CameraInfo"}
    found = {kinds[topic] for topic in kinds if topic.endswith(("/detections", "/boxes"))}
    assert found == {"vision_msgs/msg/Detection2DArray"}
    for (name, _), camera in zip(FRAMES.items(), run.scene.cameras, strict=True):
        (info,) = {json.dumps(bags.plain(m.content) | {"header": None}) for m in tracker[f"/{name}/camera_info"]}
        found, lens = json.loads(info), camera.intrinsics
        assert (found["width"], found["height"], found["distortion_model"]) == (1280, 720, "plumb_bob")
        bent = [-0.08, 0.02, 0.001, -0.002, 0.003] if name == BOW else [0.0] * 5
        assert found["d"] == bent
        assert found["k"] == lens.matrix.ravel().tolist() and found["k"][1] == lens.skew
        assert found["r"] == np.eye(3).ravel().tolist()
        assert np.array(found["p"]).reshape(3, 4).tolist() == [[*row, 0.0] for row in lens.matrix.tolist()]
        for info_message, boxes in zip(tracker[f"/{name}/camera_info"], tracker[f"/{name}/detections"], strict=True):
            assert info_message.content.header == boxes.content.header
    count = 0
    for name, camera in FRAMES.items():
        lines = (run.folder / f"tracker_input_{camera}.jsonl").read_text().splitlines()
        frames = [json.loads(line) for line in lines]
        messages = tracker[f"/{name}/detections"]
        assert len(messages) == len(frames)
        for frame, (stamp_ns, message) in zip(frames, messages, strict=True):
            assert stamp_ns == bags.stamp_of(message.header) == frame["step"] * 100_000_000
            assert message.header.frame_id == f"{name}_optical_frame"
            hypotheses = [each.results[0].hypothesis for each in message.detections]
            found = [(each.class_id, each.score) for each in hypotheses]
            assert found == [(each["label"], each["confidence"]) for each in frame["detections"]]
            boxes = np.array([each["box_px"] for each in frame["detections"]]).reshape(-1, 4)
            np.testing.assert_allclose(bags.boxes_of(message), boxes, rtol=0, atol=1e-9)
            for each in message.detections:
                assert len(each.results) == 1 and each.id == "" and each.bbox.center.theta == 0
                assert each.header == message.header
            count += len(message.detections)
    assert count > 20 and len({each.results[0].hypothesis.class_id for _, m in messages for each in m.detections}) > 1
    rows = run.table("truth").to_pylist()
    for name, camera in FRAMES.items():
        for stamp_ns, message in truth[f"/truth/{name}/boxes"]:
            here = [r for r in rows if r["camera"] == camera and r["step"] * 100_000_000 == stamp_ns and r["annotated"]]
            assert [each.id for each in message.detections] == [r["vessel"] for r in here]
            assert [each.results[0].hypothesis.class_id for each in message.detections] == [r["label"] for r in here]
            sides = [[r[f"full_{side}_px"] for side in ("x_min", "y_min", "x_max", "y_max")] for r in here]
            np.testing.assert_allclose(bags.boxes_of(message), np.array(sides).reshape(-1, 4), rtol=0, atol=1e-9)
        empty = [m.content for m in truth[f"/truth/{name}/boxes"] if 500_000_000 <= m.stamp_ns < 900_000_000]
        assert len(empty) >= 1 and all(each.detections == [] for each in empty if name != QUAY)
    assert 0 in [len(m.content.detections) for name in FRAMES for m in tracker[f"/{name}/detections"]]
    table = run.table("ownship").to_pydict()
    column = {name: np.array(table[name]) for name in table if name not in ("vessel", "timestamp")}
    odom, imu = ([m.content for m in tracker[topic]] for topic in ("/odom", "/imu"))
    assert {(m.header.frame_id, m.child_frame_id) for m in odom} == {("map", "base_link")}
    assert {m.header.frame_id for m in imu} == {"imu_link"}
    places = vectors([m.pose.pose.position for m in odom])
    assert np.array_equal(places, np.stack([column["w1_m"], column["w2_m"], column["w3_m"]], axis=1))
    rates = {"": [m.twist.twist.angular for m in odom], "measured_": [m.angular_velocity for m in imu]}
    for prefix, found in rates.items():
        wanted = np.stack([column[f"{prefix}{axis}_rad_s"] for axis in "pqr"], axis=1)
        assert np.array_equal(vectors(found), wanted)
    forces = np.stack([column[f"measured_f{k}_m_s2"] for k in (1, 2, 3)], axis=1)
    assert np.array_equal(vectors([m.linear_acceleration for m in imu]), forces)
    wanted = np.stack([column[f"measured_{name}_rad"] for name in ("roll", "pitch", "heading")], axis=1)
    found = turns([m.orientation for m in imu]).as_euler("xyz")  # about fixed axes, as ROS means roll, pitch and yaw
    np.testing.assert_allclose(found * [-1, 1, 1], wanted, atol=1e-12)  # ROS's roll is positive to starboard
    for message in imu:
        np.testing.assert_allclose(message.orientation_covariance.reshape(3, 3), np.diag([0.0025, 0.0025, 0.0169]))
        np.testing.assert_allclose(message.angular_velocity_covariance.reshape(3, 3), np.eye(3) * 5e-4)
        np.testing.assert_allclose(message.linear_acceleration_covariance.reshape(3, 3), np.eye(3) * 0.05)
    frames = bags.Frames(tracker)
    turned = np.array([frames.map_T("base_link", m.stamp_ns) for m in tracker["/odom"]])
    moved = (turned[:, :3, :3] @ vectors([m.twist.twist.linear for m in odom])[..., None])[1:-1, :, 0]
    np.testing.assert_allclose(moved, (places[2:] - places[:-2]) / 0.2, atol=1e-9)
    fixed = turns([m.pose.pose.orientation for m in odom]).as_matrix()
    np.testing.assert_allclose(fixed, turned[:, :3, :3], atol=1e-12)
    assert not any(m.pose.covariance.any() or m.twist.covariance.any() for m in odom)
    # x forward, y to port, z up; in an optical frame z forward, x right, y down; at rest +g is along z
    frames = bags.Frames(tracker)
    map_T_base = frames.map_T("base_link", 1_000_000_000)
    heading = run.table("ownship")["heading_rad"].to_pylist()[10]
    np.testing.assert_allclose(map_T_base[:2, 0], [np.cos(heading), np.sin(heading)], atol=0.05)
    assert map_T_base[2, 2] > 0.99
    ahead, to_port = map_T_base[:3, 0], map_T_base[:3, 1]
    map_T_camera = frames.map_T(f"{BOW}_optical_frame", 1_000_000_000)
    assert map_T_camera[:3, 2] @ ahead > 0.9 and map_T_camera[:3, 0] @ to_port < -0.9 and map_T_camera[2, 1] < -0.9
    np.testing.assert_allclose((np.linalg.inv(map_T_base) @ map_T_camera)[:3, 3], [6, 0.5, 6], atol=1e-9)
    base_T_imu = np.linalg.inv(map_T_base) @ frames.map_T("imu_link", 1_000_000_000)
    np.testing.assert_allclose(base_T_imu, [[1, 0, 0, 1], [0, 1, 0, 0.2], [0, 0, 1, 2], [0, 0, 0, 1]], atol=1e-12)
    assert np.mean([m.content.linear_acceleration.z for m in tracker["/imu"]]) > 9


def test_the_same_run_gives_the_same_bytes_whatever_the_blocks(run, out, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(pipeline, "MAX_BLOCK_STEPS", 3)
    again = export(run, tmp_path / "again")
    assert content(again).keys() == set(FILES)
    assert content(again) == content(out)


def test_one_camera_ashore_needs_no_own_ship_and_two_vessels_with_cameras_have_own_names(tmp_path, run):
    texts = ["0", "0.1", "+.3", "1e0", "1.000000001", "1.0000000025", "1.0000000035", "1700000000.123456789"]
    expected = [0, 10**8, 3 * 10**8, 10**9, 10**9 + 1, 10**9 + 2, 10**9 + 4, 1_700_000_000_123_456_789]
    assert stamps_ns(texts, "scene").tolist() == expected
    for text in ("-0.1", "2147483648", "1e300", "1e999999999999"):
        with pytest.raises(InputError, match="ROS knows times from 0 to 2147483647 s"):
            stamps_ns([text], "scene")
    assert stamps_ns(["1e-999999999999"], "scene").tolist() == [0]
    # Own ship's odometry is truth of a vessel that this camera looks for.
    out = export(run, tmp_path, (2,))
    tracker = bags.read_with_rosbags(out / "detections")
    assert tracker.keys() == {"/quay/camera_info", "/quay/detections", "/tf_static"}
    (static,) = tracker["/tf_static"]
    (fixed,) = static.content.transforms
    assert (fixed.header.frame_id, fixed.child_frame_id) == ("map", "quay_optical_frame")
    assert check_projection(tracker, bags.read_with_rosbags(out / "truth")) > 5
    mounts = {"a": {"vessel": bags.OWN, "position_m": [6, 0, 6]}, "b": {"vessel": "pilot", "position_m": [3, 0, 4]}}
    cameras = {name: {**bags.LENS, "mount": mount} for name, mount in mounts.items()}
    poses = {"tracks": {bags.OWN: [[0, 0, 0], [9, 9, 0]], "pilot": [[0, 0, 50], [9, 9, 60]]}}
    vessels = dict.fromkeys((bags.OWN, "pilot"), bags.VESSELS[bags.OWN])
    scene = bags.voyage(vessels=vessels, poses=poses, cameras=cameras, steps=3, time_step_s=1.0)
    modsim3d.run_scene(scene, tmp_path / "run")
    run = modsim3d.open_run(tmp_path / "run")
    tracker = bags.read_with_rosbags(export(run, tmp_path / "both") / "detections")
    assert {"/own_ship/odom", "/own_ship/imu", "/pilot/odom", "/pilot/imu"} < tracker.keys()
    frames = bags.Frames(tracker)
    for step in range(3):
        for base, camera, place in (("own_ship/base_link", "a", [6, 0, 6]), ("pilot/base_link", "b", [3, 0, 4])):
            base_T_map = np.linalg.inv(frames.map_T(base, step * 10**9))
            found = base_T_map @ frames.map_T(f"{camera}_optical_frame", step * 10**9)
            np.testing.assert_allclose(found[:3, 3], place, atol=1e-9)
    alone = bags.read_with_rosbags(export(run, tmp_path / "one", (1,)) / "detections")
    assert {"/pilot/odom", "/pilot/imu"} < alone.keys() and "/own_ship/odom" not in alone
