"""A sample of `script/campaign faults`: failed calls, full disks, power cuts, damaged blocks; two writers of a run."""

import errno
import gc
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from modsim3d import ModsimError, OutputError, load_scene, open_run, run_scene
from modsim3d.cli.run_summary import print_summary
from modsim3d.io.atomic_write import write_files
from modsim3d.io.overwrite_guard import LOCK_FILE, locked_file, locked_folder
from modsim3d.runs import pipeline
from modsim3d.runs.files.block_files import finished_truth
from modsim3d.runs.files.tables import ROW_GROUP_ROWS, TableWriter
from tests.run_folders import interrupt, run_files, wait_for

BLOCK, STEPS = 75, 150  # two blocks


@pytest.fixture(scope="module")
def scene():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pipeline, "MAX_BLOCK_STEPS", BLOCK)
        yield load_scene("simulation_1", source="analytic", steps=STEPS)


def watch(monkeypatch: pytest.MonkeyPatch, name: str, before: Callable[[int, Any], None]) -> None:
    """Call something before each call of a function of `os`, with the number of the call and its first argument."""
    function, numbers = getattr(os, name), count(1)

    def watched(*arguments: Any, **named: Any) -> Any:
        before(next(numbers), arguments[0])
        return function(*arguments, **named)

    monkeypatch.setattr(os, name, watched)


@pytest.fixture(scope="module")
def calls() -> dict[str, int]:
    """How often the undisturbed run of `whole` calls each function."""
    return {}


@pytest.fixture(scope="module")
def whole(scene, calls, tmp_path_factory) -> dict[str, bytes]:
    with pytest.MonkeyPatch.context() as watched:
        for name in ("fsync", "replace"):
            watch(watched, name, lambda call, _, name=name: calls.update({name: call}))
        return run_files(run_scene(scene, tmp_path_factory.mktemp("whole") / "run").folder)


@pytest.mark.parametrize("name", ["fsync", "replace"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.95])
def test_a_run_goes_on_after_a_call_that_failed(name, share, calls, scene, whole, tmp_path, monkeypatch):
    def fail(call: int, _: object) -> None:
        if call == 1 + int(share * calls[name]):
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as broken, pytest.raises(ModsimError, match="Input/output error"):
        watch(broken, name, fail)
        run_scene(scene, tmp_path / "run")
    run_scene(scene, tmp_path / "run", resume=True)
    assert run_files(tmp_path / "run") == whole


@contextmanager
def no_file_above(size: int) -> Iterator[None]:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, limits[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)


@pytest.mark.parametrize("rows", [10, ROW_GROUP_ROWS + 10])
def test_a_table_that_could_not_be_written_is_closed_without_another_error(rows, tmp_path):
    table = pa.table({"step": np.arange(rows)})
    writer = TableWriter(tmp_path / "table.parquet", table.schema)
    with pytest.raises(OSError, match="File too large"), no_file_above(20):
        writer.write(table)
        writer.close()
    writer.close()


@pytest.mark.parametrize("size", [2, 5_000, 20_000])
def test_a_run_goes_on_after_files_could_not_grow_and_all_are_closed(size, scene, whole, tmp_path, monkeypatch):
    assert max(map(len, whole.values())) > 20_000
    unraisable = []
    monkeypatch.setattr(sys, "unraisablehook", unraisable.append)
    with no_file_above(size):
        with pytest.raises(ModsimError, match="File too large"):
            run_scene(scene, tmp_path / "run")
        gc.collect()
    assert unraisable == []
    run_scene(scene, tmp_path / "run", resume=True)
    assert run_files(tmp_path / "run") == whole


class PowerCutError(Exception):
    """The machine lost power."""


@pytest.mark.parametrize("share", [0.3, 0.6, 0.8, 0.9, 0.99])
def test_a_run_goes_on_after_a_power_cut_that_emptied_unsynced_files(share, calls, scene, whole, tmp_path, monkeypatch):
    """The worst that a file system may do: every rename has reached the disk, but of files only what was fsynced."""
    on_disk: dict[int, bytes] = {}  # by inode
    seen = []

    def cut(call: int, _: object) -> None:
        seen.append(call)
        if len(seen) == int(share * sum(calls.values())):
            raise PowerCutError

    def keep(call: int, descriptor: int) -> None:
        cut(call, descriptor)
        path = Path(f"/proc/self/fd/{descriptor}")
        if path.is_file():
            on_disk[os.fstat(descriptor).st_ino] = path.read_bytes()

    with monkeypatch.context() as watched, pytest.raises(PowerCutError):
        watch(watched, "fsync", keep)
        watch(watched, "replace", cut)
        run_scene(scene, tmp_path / "run")
    for path in [path for path in (tmp_path / "run").rglob("*") if path.is_file()]:
        path.write_bytes(on_disk.get(path.stat().st_ino, b""))
    if (tmp_path / "run" / "run.json").exists():
        shutil.rmtree(tmp_path / "run" / "unfinished", ignore_errors=True)
    else:
        run_scene(scene, tmp_path / "run", resume=True)
    assert run_files(tmp_path / "run") == whole


def interrupted(scene, folder: Path) -> list[Path]:
    """The blocks that a run keeps which is interrupted after its last."""
    return sorted((interrupt(scene, folder, blocks=2) / "unfinished").glob("truth_*.npz"))


def flipped(data: bytes) -> bytes:
    middle = len(data) // 2
    return data[:middle] + bytes([data[middle] ^ 1]) + data[middle + 1 :]


DAMAGES = {
    **{"empty": lambda data: b"", "cut": lambda data: data[:5000], "without its last byte": lambda data: data[:-1]},
    **{"one bit": flipped, "zeros": lambda data: bytes(len(data)), "none": lambda data: data},
    "another file": lambda data: b"PK\x03\x04" + data[:-4],
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_block_is_made_anew_and_told_and_a_whole_one_is_taken(scene, whole, tmp_path, capsys, name):
    block, _ = interrupted(scene, tmp_path / "run")
    block.write_bytes(DAMAGES[name](block.read_bytes()))
    result, damaged = run_scene(scene, tmp_path / "run", resume=True), name != "none"
    assert (result.damaged_blocks, result.resumed_steps) == ((1, BLOCK) if damaged else (0, 2 * BLOCK))
    assert run_files(tmp_path / "run") == whole
    assert ("1 damaged blocks of it made anew" in (tmp_path / "run/run.log").read_text()) == damaged
    print_summary(scene, result, sheet=False)
    assert ("blocks of the interrupted run, made anew" in capsys.readouterr().out) == damaged


def test_an_interrupted_run_shows_the_steps_before_a_damaged_block_and_others_are_made_anew(scene, tmp_path, whole):
    _, second = interrupted(scene, tmp_path / "cut")
    second.write_bytes(flipped(second.read_bytes()))
    run = open_run(tmp_path / "cut")
    assert finished_truth(tmp_path / "cut" / "unfinished", run.scene, BLOCK, 2 * BLOCK) is None
    assert run.steps == len(list(run.frames())) == BLOCK
    mine = interrupted(scene, tmp_path / "run")
    for block, other in zip(mine, interrupted(replace(scene, seed=1), tmp_path / "other"), strict=True):
        shutil.copy(other, block)
    assert run_scene(scene, tmp_path / "run", resume=True).damaged_blocks == len(mine) == 2
    first, second = interrupted(scene, tmp_path / "steps")
    shutil.copy(first, second)
    assert run_scene(scene, tmp_path / "steps", resume=True).damaged_blocks == 1
    assert run_files(tmp_path / "run") == run_files(tmp_path / "steps") == whole


def test_the_names_of_folders_that_are_made_are_on_the_disk_too(scene, tmp_path, monkeypatch):
    synced = set()
    with monkeypatch.context() as watched:
        watch(watched, "fsync", lambda _, descriptor: synced.add(os.fstat(descriptor).st_ino))
        run_scene(scene, tmp_path / "runs" / "first")
        write_files({tmp_path / "files" / "first" / "file": "text"})
    for folder in ("", "runs", "runs/first", "runs/first/scene", "files", "files/first"):
        assert (tmp_path / folder).stat().st_ino in synced


RUN = ("run", "harbour", "--source", "rectangles", "--steps", "800", "--no-sheet")  # several blocks
LONG_S = 120


def done(program: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([program, *map(str, arguments)], capture_output=True, text=True, timeout=LONG_S, check=False)


def stopped_after_a_block(out: Path, *options: object, by: signal.Signals = signal.SIGSTOP) -> subprocess.Popen[bytes]:
    """A run that a signal has stopped after it has kept its first block."""
    command = [sys.executable, "-m", "modsim3d.cli.main", *RUN, "--out", str(out), *map(str, options)]
    running = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wait_for(lambda: list((out / "unfinished").glob("truth_*.npz")) or running.poll() is not None)
    assert running.poll() is None
    running.send_signal(by)
    return running


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What an undisturbed run writes."""
    scene = load_scene("harbour", source="rectangles", steps=800)
    return run_files(run_scene(scene, tmp_path_factory.mktemp("whole") / "run").folder, LOCK_FILE)


@pytest.mark.parametrize("option", ["--resume", "--overwrite"])
def test_a_second_process_is_refused_by_name_and_the_first_run_is_whole(prepared, tmp_path, undisturbed, option):
    first = stopped_after_a_block(tmp_path / "run")
    try:
        second = done(prepared, *RUN, "--out", tmp_path / "run", option)
    finally:
        first.send_signal(signal.SIGCONT)
    assert second.returncode == 2 and "Traceback" not in second.stderr
    assert f"is being written by modsim3d run, process {first.pid} on {os.uname().nodename}" in second.stderr
    assert first.wait(LONG_S) == 0 and run_files(tmp_path / "run", LOCK_FILE) == undisturbed


def test_a_folder_is_free_at_once_when_its_writer_and_workers_were_killed(prepared, tmp_path, undisturbed):
    stopped_after_a_block(tmp_path / "run", "--workers", 2, by=signal.SIGKILL).wait(LONG_S)
    second = done(prepared, *RUN, "--out", tmp_path / "run", "--resume", "--workers", 2)
    assert second.returncode == 0, second.stderr
    assert run_files(tmp_path / "run", LOCK_FILE) == undisturbed and not (tmp_path / "run" / LOCK_FILE).exists()


def test_detect_is_refused_while_another_process_writes(prepared, tmp_path):
    run_scene(load_scene("simulation_1", source="analytic", steps=5), tmp_path / "first")
    with locked_folder(tmp_path / "second"):
        refused = done(prepared, "detect", tmp_path / "first", "--out", tmp_path / "second")
    assert refused.returncode == 2 and f"process {os.getpid()} on " in refused.stderr
    assert not (tmp_path / "second").exists() and open_run(tmp_path / "first").finished


def test_a_lock_is_kept_out_of_forked_processes_and_one_of_two_writers_is_refused(tmp_path):
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
    out, link = tmp_path / "out.json", tmp_path / "link"
    link.symlink_to(out)
    with locked_file(out), pytest.raises(OutputError, match="wait for it to end"), locked_file(link):
        raise AssertionError
