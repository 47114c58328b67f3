"""Lines of a stream are those of a run's files; the time of a live step; where a stream may go."""

import cProfile
import gc
import json
import pstats
import re
import socket
import subprocess
import sys
from collections import defaultdict
from contextlib import closing
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml

import modsim3d
from benchmarks.voyages.cases import SHOEBOXES
from modsim3d import Scene, load_scene, run_scene
from modsim3d.core.errors import ModsimError
from modsim3d.detector.records import KINDS
from modsim3d.render.id_pass import Region
from modsim3d.runs.pipeline import open_renderer, simulate_blocks, truth_block
from modsim3d.runs.stream_lines import Address, Pace, StepLines, header_line, short_collections, step_lines
from tests.cli.test_json import documented

STEPS, ANGLES = 12, ("roll", "pitch", "heading")
ROOT = Path(__file__).resolve().parents[2]
PREFIX = re.compile(rb'\{"camera":("[^"]*"),"frames_in_step":([0-9]+),(?:"attitude_rad":[^]]*],)?')


@pytest.fixture(scope="module")
def scene() -> Scene:
    unit = {"imu": {"attitude_noise_rad": 0.01, "heading_bias_rad": 0.1}}
    return load_scene("strait", steps=STEPS, source="analytic", settings={**SHOEBOXES, **unit})


@pytest.fixture(scope="module")
def streamed(scene: Scene) -> list[StepLines]:
    return list(step_lines(scene, one_by_one=False))


def by_camera(streamed: list[StepLines]) -> dict[str, bytes]:
    """The streamed lines of each camera without what a run's file does not have."""
    files: dict[str, bytes] = defaultdict(bytes)
    for line in (line for step in streamed for line in step.lines):
        found = PREFIX.match(line)
        assert found is not None
        files[json.loads(found[1])] += b"{" + line[found.end() :]
    return files


@pytest.fixture(scope="module")
def run(scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_scene(scene, tmp_path_factory.mktemp("lines") / "run").folder


def test_they_are_the_lines_of_a_runs_files_byte_for_byte_in_the_order_of_steps(scene, streamed, run):
    files = {camera.name: (run / f"tracker_input_{camera.name}.jsonl") for camera in scene.cameras}
    assert by_camera(streamed) == {name: file.read_bytes() for name, file in files.items()}
    assert list(step_lines(scene, one_by_one=True)) == streamed
    columns = pq.read_table(run / "ownship.parquet", columns=[f"measured_{angle}_rad" for angle in ANGLES])
    measured = [list(row.values()) for row in columns.to_pylist()]
    entries = [json.loads(line) for step in streamed for line in step.lines]
    assert [entry["attitude_rad"] for entry in entries if entry["camera"] == "bow"] == measured
    assert all("attitude_rad" not in entry for entry in entries if entry["camera"] == "quay")
    assert [step.step for step in streamed] == list(range(STEPS))
    for step in streamed:
        entries = [json.loads(line) for line in step.lines]
        assert {(entry["step"], entry["time_s"]) for entry in entries} == {(step.step, step.time_s)}
        assert {entry["frames_in_step"] for entry in entries} == {len(entries)}
    assert {len(step.lines) for step in streamed} == {1, 2}, "the quay's camera is slower"


def test_a_step_without_a_frame_has_a_line_and_a_detector_that_needs_all_targets_those_of_its_run(tmp_path):
    scene = load_scene("strait", steps=3, source="analytic", settings={"cameras.bow.start_offset_s": 0.4})
    (first, *_) = step_lines(scene, one_by_one=False)
    assert [json.loads(line) for line in first.lines] == [{"frames_in_step": 0, "time_s": 0.0, "step": 0}]
    scene = load_scene("strait", steps=4, source="analytic", settings={"detector.dropout.anchor": "state_rate"})
    assert scene.detector.needs_target_statistics
    run_scene(scene, tmp_path / "run")
    lines = by_camera(list(step_lines(scene, one_by_one=True)))
    assert lines["bow"] == (tmp_path / "run" / "tracker_input_bow.jsonl").read_bytes()


def test_the_header_has_the_scene_files_numbers_keys_are_documented_and_nothing_is_of_the_truth(scene, streamed):
    text = b"".join(line for step in streamed for line in step.lines).decode()
    own = {scene.vessel_names[index] for index in scene.own_ships}
    targets = set(scene.vessel_names) - set(scene.detector.labels)
    assert not [word for word in (*targets, *KINDS[1:], "vessel", "kind") if f'"{word}' in text]
    assert not [word for word in targets - own if f'"{word}"' in header_line(scene).decode()]
    header = json.loads(header_line(scene))
    assert (header["scene"], header["steps"], header["labels"]) == ("strait", STEPS, list(scene.detector.labels))
    file = yaml.safe_load((ROOT / "scenes" / "strait.yaml").read_text())["cameras"]
    assert list(header["cameras"]) == list(file)
    for name, given in file.items():
        told, place = header["cameras"][name], "mount" if "mount" in given else "pose"
        assert told[place].items() >= given[place].items()
        assert (told["image_size_px"], told["frame_rate_hz"]) == (given["image_size_px"], given.get("frame_rate_hz"))
        assert told["focal_px"] == pytest.approx([given["focal_length_m"] / size for size in given["pixel_size_m"]])
    keys = {*header, *(key for camera in header["cameras"].values() for key in camera)}
    assert documented("stream") == keys | {key for step in streamed for line in step.lines for key in json.loads(line)}


def test_no_step_leaves_before_its_time_and_collections_leave_out_what_was_there_before():
    slept = [1000.0]  # the time, in parts
    pace = Pace(lambda: sum(slept), lambda seconds: slept.append(seconds * 0.75))  # a sleep may end early
    left = []
    for step in range(5):
        slept.append(7.0 if step == 2 else 0.01)
        pace.wait(step, 3.0 + step)
        left.append(sum(slept) - 1000.01)
    assert left == pytest.approx([0, 1, 8.0, 8.01, 8.02], abs=1e-6)
    assert (pace.latest, pace.late_s) == (2, pytest.approx(6.0))
    before = gc.get_threshold()
    with pytest.raises(ZeroDivisionError), short_collections():
        assert len(gc.get_objects()) < 100 < gc.get_freeze_count() and gc.get_threshold()[0] == 700
        raise ZeroDivisionError
    assert (gc.get_threshold(), gc.get_freeze_count()) == (before, 0)


INCOMPLETE = ("", "127.0.0.1", ":5000", "127.0.0.1:", "127.0.0.1:-1", "127.0.0.1:5000/", "::1:5000", "127.0.0.1:٥٠٠٠")


def test_an_address_is_read_and_written_and_told_where_it_is_taken_or_of_another_computer():
    for text, address, loopback in (
        ("tcp://127.0.0.1:5000", Address("127.0.0.1", 5000), True),
        ("tcp://localhost:0", Address("127.0.0.1", 0), True),
        ("tcp://[::1]:5000", Address("::1", 5000), True),
        ("tcp://0.0.0.0:65535", Address("0.0.0.0", 65535), False),
        ("tcp://[::]:1", Address("::", 1), False),
    ):
        assert Address.parse(text) == address and address.loopback is loopback, text
        assert str(address) == text.replace("localhost", "127.0.0.1")
    said = "cannot listen there: Address already in use; port 0 takes any free port"
    with closing(Address("127.0.0.1", 0).listen(4096)) as taken, pytest.raises(ModsimError, match=said):
        Address("127.0.0.1", taken.getsockname()[1]).listen(4096)
    with pytest.raises(ModsimError, match=r"to tcp://192\.0\.2\.1:5000: cannot listen there"):
        Address("192.0.2.1", 5000).listen(4096)


@pytest.mark.parametrize(("text", "part"), [
    ("lines.jsonl", "is neither - (standard output) nor tcp://ADDRESS:PORT"),
    *((text, "is neither -") for text in ("udp://127.0.0.1:5000", "")),
    *((f"tcp://{text}", "an address and a port are needed") for text in INCOMPLETE),
    ("tcp://127.0.0.1:65536", "a port is a number from 0 to 65535 (got 65536)"),
    ("tcp://example.org:5000", "'example.org' is no IP address"),
    ("tcp://[127.0.0.1]:5000", "'127.0.0.1' is no IP address"),
    *((f"tcp://{text}:5000", "is no IP address") for text in ("me@127.0.0.1", "127.0.0.256")),
])  # fmt: skip
def test_what_is_no_address_is_told(text: str, part: str) -> None:
    with pytest.raises(ModsimError) as caught:
        Address.parse(text)
    assert str(caught.value).startswith(f"to '{text}': ") and part in str(caught.value)


def test_ipv6_listens_where_there_is_some() -> None:
    address = Address.parse("tcp://[::1]:0")
    try:
        with socket.socket(socket.AF_INET6) as probe:
            probe.bind(("::1", 0))
    except OSError:
        with pytest.raises(ModsimError, match="cannot listen there"):
            address.listen(4096)
        return
    with closing(address.listen(4096)) as listener:
        assert listener.getsockname()[0] == "::1"


BUSY, EMPTY = 110, 20  # steps of Simulation 2 with four vessels in the image, as in those after it, and with none
COUNTED = 5
PACKAGE = Path(modsim3d.__file__).parent


@pytest.fixture(scope="module")
def busy_scene() -> Scene:
    return load_scene("simulation_2", steps=BUSY + COUNTED)


def our_calls(profile: cProfile.Profile) -> int:
    """Calls by the package's modules; what libraries call in turn differs by their versions."""
    entries = pstats.Stats(profile).stats.values()  # type: ignore[attr-defined]
    by_caller = [(caller[0], numbers[0]) for entry in entries for caller, numbers in entry[-1].items()]
    return sum(count for file, count in by_caller if Path(file).is_relative_to(PACKAGE))


def test_a_live_step_takes_few_calls_and_a_prepared_renderer_draws_as_fast_as_later(busy_scene):
    assert not len(truth_block(busy_scene, EMPTY, EMPTY + COUNTED, renderer=None))
    blocks, done = simulate_blocks(busy_scene, 1), 0
    for first, vessels, most_calls in ((EMPTY, 0, 470), (BUSY, 4, 1130)):
        for _ in range(done, first):
            next(blocks)
        profile = cProfile.Profile()
        counted = [profile.runcall(next, blocks) for _ in range(COUNTED)]
        assert [len(block.cameras[0].truth) for block in counted] == [vessels] * COUNTED
        assert our_calls(profile) / COUNTED < most_calls
        done = first + COUNTED
    corners, region = np.array([[[0.0, 0.0], [30.0, 5.0], [10.0, 40.0]]]), Region(0, 0, 30, 40)
    with open_renderer(busy_scene) as renderer:
        assert renderer is not None
        renderer.prepare()
        calls = []
        for _ in range(2):
            profile = cProfile.Profile()
            profile.runcall(renderer.draw, corners, np.ones((1, 3)), np.ones(1, dtype=np.int64), region)
            calls.append(pstats.Stats(profile).total_calls)
    assert calls[0] == calls[1]


LOADED_LATE = """
import sys
from modsim3d.runs.pipeline import simulate_blocks
from modsim3d.scene.reading import load_scene
blocks = simulate_blocks(load_scene("simulation_2", steps=115), 1)
next(blocks)
loaded = set(sys.modules)
list(blocks)
print(sorted(set(sys.modules) - loaded))
"""


def test_no_step_waits_for_a_library() -> None:
    assert subprocess.check_output([sys.executable, "-c", LOADED_LATE], text=True, timeout=240).split() == ["[]"]
