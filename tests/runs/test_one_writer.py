"""One process at a time writes a run directory, and the others are told which."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from modsim3d import OutputError, load_scene, open_run, run_scene
from modsim3d.io.overwrite_guard import LOCK_FILE, locked_file, locked_folder
from tests.run_folders import run_files

RUN = ("run", "harbour", "--source", "rectangles", "--steps", "800", "--no-sheet")  # several blocks
LONG_S = 120


def done(program: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, timeout=LONG_S, check=False)


def stopped_after_a_block(out: Path, *options: object, by: signal.Signals = signal.SIGSTOP) -> subprocess.Popen[bytes]:
    """A run that a signal has stopped after it has kept its first block."""
    command = [sys.executable, "-m", "modsim3d.cli.main", *RUN, "--out", str(out), *map(str, options)]
    running = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + LONG_S
    while not list((out / "unfinished").glob("truth_*.npz")):
        assert running.poll() is None and time.monotonic() < deadline
        time.sleep(0.005)
    running.send_signal(by)
    return running


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What an undisturbed run writes."""
    scene = load_scene("harbour", source="rectangles", steps=800)
    return run_files(run_scene(scene, tmp_path_factory.mktemp("whole") / "run").folder, LOCK_FILE)


@pytest.mark.parametrize("option", ["--resume", "--overwrite"])
def test_a_second_process_is_refused_by_name_and_the_first_run_is_whole(prepared, tmp_path, whole, option):
    first = stopped_after_a_block(tmp_path / "run")
    try:
        second = done(prepared, *RUN, "--out", tmp_path / "run", option)
    finally:
        first.send_signal(signal.SIGCONT)
    assert second.returncode == 2 and "Traceback" not in second.stderr
    assert f"is being written by modsim3d run, process {first.pid} on {os.uname().nodename}" in second.stderr
    assert first.wait(LONG_S) == 0 and run_files(tmp_path / "run", LOCK_FILE) == whole


def test_a_folder_is_free_at_once_when_its_writer_and_workers_were_killed(prepared, tmp_path, whole):
    stopped_after_a_block(tmp_path / "run", "--workers", 2, by=signal.SIGKILL).wait(LONG_S)
    second = done(prepared, *RUN, "--out", tmp_path / "run", "--resume", "--workers", 2)
    assert second.returncode == 0, second.stderr
    assert run_files(tmp_path / "run", LOCK_FILE) == whole and not (tmp_path / "run" / LOCK_FILE).exists()


def test_detect_is_refused_while_another_process_writes(prepared, tmp_path):
    run_scene(load_scene("simulation_1", source="analytic", steps=5), tmp_path / "first")
    with locked_folder(tmp_path / "second"):
        refused = done(prepared, "detect", tmp_path / "first", "--out", tmp_path / "second")
    assert refused.returncode == 2 and f"process {os.getpid()} on " in refused.stderr
    assert not (tmp_path / "second").exists() and open_run(tmp_path / "first").finished


def test_a_lock_is_kept_out_of_forked_processes_and_of_other_programs(tmp_path):
    with locked_file(tmp_path / "out.json"):
        child = os.fork()
        if child == 0:
            time.sleep(LONG_S)
            os._exit(0)
        program = subprocess.Popen(["sleep", str(LONG_S)], close_fds=False)
    try:
        with locked_file(tmp_path / "out.json"):
            assert [path.name for path in tmp_path.iterdir()] == [".out.json.lock"]
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        program.kill()
        program.wait()
    assert list(tmp_path.iterdir()) == []


def test_one_of_two_writers_is_refused_within_a_process_and_by_another_name(tmp_path):
    out, link = tmp_path / "out.json", tmp_path / "link"
    link.symlink_to(out)
    with locked_file(out), pytest.raises(OutputError, match="wait for it to end"), locked_file(link):
        raise AssertionError
