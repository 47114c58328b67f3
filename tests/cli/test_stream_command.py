"""`modsim3d stream` as a process: poses in, lines out, whatever readers do; and readers of any command that go away."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import pytest

from modsim3d.cli import terminal
from modsim3d.core.errors import ModsimError
from modsim3d.runs.stream_lines import header_line, step_lines
from modsim3d.scene.reading import load_scene
from tests.cli.conftest import Modsim3d
from tests.runs.test_stream import line, lines, scene_of

LONG_S = 120.0
Start = Callable[..., subprocess.Popen[bytes]]


@pytest.fixture
def start(prepared: Path) -> Iterator[Start]:
    """A function that starts the command; what still runs at the end of a test is killed."""
    started: list[subprocess.Popen[bytes]] = []

    def begin(*arguments: object) -> subprocess.Popen[bytes]:
        command = [prepared, "stream", *map(str, arguments)]
        pipe = subprocess.PIPE
        started.append(subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, start_new_session=True))
        return started[-1]

    yield begin
    for process in started:
        process.kill()
        process.communicate()


def give(process: subprocess.Popen[bytes], text: str) -> None:
    assert process.stdin is not None
    process.stdin.write(text.encode())
    process.stdin.flush()


def end_of(process: subprocess.Popen[bytes]) -> tuple[int, bytes, str]:
    """Close standard input; exit status, what was left on standard output, and standard error."""
    out, err = process.communicate(timeout=LONG_S)
    return process.returncode, out, err.decode()


def listening(process: subprocess.Popen[bytes]) -> tuple[str, int]:
    """The address that a process listens on."""
    said = process.stdout.readline().decode()
    assert said.startswith("listening on tcp://127.0.0.1:"), said
    return "127.0.0.1", int(said.rpartition(":")[2])


def connected(address: tuple[str, int]) -> socket.socket:
    reader = socket.socket()
    reader.settimeout(LONG_S)
    reader.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    reader.connect(address)
    return reader


def expected(scene: Path, **options: Any) -> bytes:
    """What a scene without live poses streams."""
    loaded = load_scene(scene, **options)
    return header_line(loaded) + b"".join(each for step in step_lines(loaded, one_by_one=False) for each in step.lines)


@pytest.fixture
def live(tmp_path: Path) -> Path:
    """A scene whose poses come in on standard input, with two cameras."""
    return scene_of(tmp_path, {"stream": "-"})


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    """The same vessels for 9 steps in a file."""
    (tmp_path / "poses.jsonl").write_text("".join(lines(9)))
    return scene_of(tmp_path, {"file": "poses.jsonl"})


def test_one_step_in_one_step_out_and_a_garbled_line_ends_it_after_the_lines_before(live, tmp_path, start):
    process = start(live, "-q")
    stdout = process.stdout
    assert json.loads(stdout.readline())["steps"] is None
    answers = b""
    for text in lines(3):
        give(process, text)
        answers += stdout.readline() + stdout.readline()
    give(process, '{"0.3": {"own": garbled\n' + line(4, "own"))
    status, rest, said = end_of(process)
    assert (status, rest) == (2, b"")
    assert "poses from standard input:\n  line 4, column 17:" in said and "Traceback" not in said
    (tmp_path / "poses.jsonl").write_text("".join(lines(3)))
    assert answers == expected(scene_of(tmp_path, {"file": "poses.jsonl"})).partition(b"\n")[2]


def test_a_stream_ends_with_a_word_when_its_readers_are_gone(stored: Path, start: Start) -> None:
    process = start(stored, "--to", "tcp://127.0.0.1:0", "--timeout", "3")
    with closing(connected(listening(process))) as crashing:
        assert crashing.recv(1)
    status, _, said = end_of(process)
    gone = "warning: the stream ends: its readers went away before they had all lines, and none has come back\n"
    assert (status, said) == (0, gone)


def test_ctrl_c_ends_it_while_it_waits_for_poses_and_sigterm_while_its_pipe_is_full(live, start):
    process = start(live, "--to", "tcp://127.0.0.1:0")
    with closing(connected(listening(process))) as reader, reader.makefile("rb") as received:
        give(process, line(0, "own"))
        assert [json.loads(received.readline()).get("step") for _ in range(3)] == [None, 0, 0]
        process.send_signal(signal.SIGINT)
        assert received.read() == b""
    assert end_of(process)[::2] == (130, "\nmodsim3d: interrupted\n")
    process = start("strait", "--set", "annotation.source=analytic")
    assert process.stdout.read(1) == b"{"
    process.send_signal(signal.SIGTERM)
    assert process.wait(LONG_S) == 143, "standard output is still open, and full"
    assert end_of(process)[2] == "\nmodsim3d: interrupted\n"


def test_in_real_time_the_same_lines_take_the_scenes_time(modsim3d: Modsim3d, stored: Path) -> None:
    before = time.monotonic()
    said = modsim3d("stream", stored, "--realtime", "--steps", 4)
    assert time.monotonic() - before >= 0.3
    assert (said.status, said.out.encode()) == (0, expected(stored, steps=4))
    assert re.fullmatch(r"latest: step \d left \d+\.\d{3} s after its time\n", said.err)
    assert modsim3d("stream", stored, "--realtime", "--steps", 2, "-q").err == ""


def test_live_poses_go_to_readers_step_by_step_who_may_leave_come_back_and_send(live: Path, start: Start) -> None:
    process = start(live, "--to", "tcp://127.0.0.1:0")
    address = listening(process)
    give(process, line(0, "own", "a"))
    stays, leaves = connected(address), connected(address)
    with stays.makefile("rb") as first:
        with closing(leaves), leaves.makefile("rb") as second:
            assert [second.readline() for _ in range(3)] == [first.readline() for _ in range(3)]
        stays.sendall(b"GET / HTTP/1.1\r\n\r\n" + bytes(1000))
        give(process, line(1, "own", "a"))
        assert json.loads(first.readline())["step"] == 1
        with closing(connected(address)) as back, back.makefile("rb") as again:
            give(process, line(2, "own", "a") + "[]\n")
            known = [json.loads(each) for each in again]
            rest = [json.loads(each) for each in first]
    stays.close()
    assert [entry["step"] for entry in known[1:]] == [0, 0, 1, 1, 2, 2]
    assert rest == known[4:]
    status, _, said = end_of(process)
    assert status == 2 and "line 4: one time step is needed" in said


def test_a_reader_of_standard_output_that_goes_away_ends_it_quietly(live: Path, start: Start) -> None:
    process = start(live)
    give(process, line(0, "own"))
    stdout = process.stdout
    assert json.loads(stdout.readline())["steps"] is None
    stdout.close()
    process.stdout = None
    with suppress(BrokenPipeError):  # it may have noticed at the first step
        give(process, line(1, "own"))
        give(process, line(2, "own"))
    assert process.wait(LONG_S) == 0, "standard input is still open"
    assert end_of(process)[2] == ""


WRONG = (
    ("--to lines.jsonl", "--to 'lines.jsonl': is neither - (standard output) nor tcp://ADDRESS:PORT"),
    ("--to tcp://192.0.2.1:5000", "--to tcp://192.0.2.1:5000: cannot listen there"),
    ("--to tcp://127.0.0.1:0 --timeout 0", "--timeout 0: give a number of seconds above 0"),
    ("--to tcp://127.0.0.1:0 --timeout nan", "--timeout nan: give a number of seconds above 0"),
    ("--timeout 5", "--timeout is for readers that connect"),
    ("--to tcp://127.0.0.1:0 --timeout 0.01", "nobody has connected for 0.01 s"),
    ("--state nowhere", "nowhere"),
)


def test_wrong_options_are_refused_and_a_port_that_is_open_to_others_is_warned_of(modsim3d, stored: Path) -> None:
    for options, part in WRONG:
        said = modsim3d("stream", stored, *options.split())
        assert said.status == 2
        assert part in said.err and said.err.startswith("modsim3d: ") and said.err.count("modsim3d: ") == 1
    said = modsim3d("stream", stored, "--to", "tcp://0.0.0.0:0", "--timeout", "0.01")
    assert said.err.startswith("warning: whoever reaches this computer at tcp://0.0.0.0:")


def test_a_pipe_that_does_not_block_gets_every_byte_and_no_output_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a shell or a parent in Node.js may leave it."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    given, received = bytes(range(256)) * 4096, b""
    with os.fdopen(reading, "rb") as reader, os.fdopen(writing, "w", encoding="utf-8") as stdout:
        monkeypatch.setattr(sys, "stdout", stdout)
        sending = threading.Thread(target=terminal.write_at_once, args=(given,))
        sending.start()
        received = reader.read(len(given))
        sending.join(LONG_S)
        monkeypatch.undo()
    assert received == given
    monkeypatch.setattr(sys, "stdout", None)
    with pytest.raises(ModsimError, match="there is no standard output"):
        terminal.write_at_once(b"x")


PROGRAM = f"{sys.executable} -m modsim3d"


def bash(line: str, *arguments: object, program: object = PROGRAM) -> subprocess.CompletedProcess[str]:
    """Run a line of bash, in which MODSIM3D is the program and $1, $2 … are the arguments."""
    command = ["bash", "-c", line.replace("MODSIM3D", str(program)), "bash", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=240, check=False)


@pytest.mark.parametrize("options", ["", "--json"])
@pytest.mark.parametrize("obeys", [True, False])
@pytest.mark.parametrize("reader", ["head -1", "true"])
def test_the_status_of_verify_is_its_verdict_whoever_reads(run, prepared, tmp_path, reader, obeys, options):
    detector = next((run / "scene").glob("detector.*"))
    if not obeys:
        text, detector = detector.read_text(), tmp_path / "other.yaml"
        detector.write_text(text.replace("mean: 0.67", "mean: 0.2"))
        assert detector.read_text() != text
    line = f'MODSIM3D check run "$1" --detector "$2" --out "$3" {options} | {reader} >/dev/null'
    done = bash(f"{line}; echo ${{PIPESTATUS[0]}}", run, detector, tmp_path / "out", program=prepared)
    assert done.stdout == f"{0 if obeys else 1}\n" and done.stderr == ""
    assert json.loads((tmp_path / "out" / "verify.json").read_text())["obeys"] is obeys


def test_no_command_minds_a_reader_that_goes_away_does_its_work_and_keeps_its_status(prepared, scene, run, tmp_path):
    """Nor in a Python of its own: help, which is printed before all else, a text and an object."""
    harbour = "check scene harbour"
    commands = ("scenes", "-h", "run -h", harbour, "scenes --json", f"{harbour} --json", "--version")
    asked = [(f"MODSIM3D {command}", prepared) for command in commands]
    asked += [(f"MODSIM3D {command}", PROGRAM) for command in ("-h", harbour)]
    asked += [(f"PYTHONUNBUFFERED=1 MODSIM3D {command}", PROGRAM) for command in (harbour, "scenes --json")]
    for command, program in asked:
        done = bash(f"{command} | true; echo ${{PIPESTATUS[0]}}", program=program)
        assert (done.stdout, done.stderr) == ("0\n", ""), command
    line = 'MODSIM3D run "$1" --source analytic --no-sheet --out "$2" 2>&1 | true; echo ${PIPESTATUS[0]}'
    assert bash(line, scene, tmp_path / "run", program=prepared).stdout == "0\n"
    assert (tmp_path / "run" / "run.json").exists()
    done = bash('MODSIM3D check run "$1" --out "$2" --json | head -1', run, tmp_path / "json", program=prepared)
    assert json.loads(done.stdout)["command"] == "check run"
    done = bash('MODSIM3D check run "$1" --out "$2" >&-', run, tmp_path / "closed")
    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "closed" / "verify.json").exists()
    done = bash("MODSIM3D check scene nowhere.yaml 2>&1 | true; echo ${PIPESTATUS[0]}")
    assert done.stdout == "2\n"
    done = bash("MODSIM3D scenes > /dev/full")
    full = "modsim3d: standard output cannot be written to: No space left on device\n"
    assert (done.returncode, done.stderr) == (2, full)
