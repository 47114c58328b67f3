"""What a user gets wrong when looking at a run, or stops: one message, exit status 2, and nothing half written."""

import gc
import os
import re
import shutil
import signal
import subprocess
import sys
import warnings
from pathlib import Path

import imageio_ffmpeg
import pytest

from modsim3d import load_scene, run_scene
from modsim3d.runs import pipeline
from tests.cli.bad_input.builders import answer, refusal
from tests.run_folders import interrupt, wait_for
from tests.scenes import write_scene


def refused(call, *arguments) -> str:
    return refusal(call, ("view", *arguments))


WRONG = [
    ("film --kind ids --camera C9", ["no camera 'C9'", "C0"]),
    ("frame 99", ["no step 99", "0 to 11"]),
    ("frame 3.5", ["no frame at 3.5", "step", "0 to 11"]),
    ("frame noon", ["'noon'", "51.0 or 51s"]),
    ("frame nan", ["no frame at nan"]),
    ("film --kind ids --start 100 --end 200", ["100", "200", "0.0 s to 11.0 s"]),
    ("film --kind ids --start 5 --end 4", ["no frames between 5 s and 4 s"]),
    ("film --kind ids --layers truth,ghosts", ["ghosts", "silhouettes"]),
    ("film --kind ids --crop 1,2,3", ["four", "vessels"]),
    ("film --kind ids --crop 0,0,9000,10", ["C0", "800 × 600"]),
    ("film --kind ids --width 641", ["640 or 642"]),
    ("film --kind ids --speed 0", ["--speed 0"]),
    ("film --kind ids --speed nan", ["--speed nan"]),
    ("film --kind ids --out film.avi", [".avi", "mp4"]),
    ("film --kind ids --out film.gif --format mp4", ["film.gif contradicts --format mp4"]),
    ("film --kind ids --out nowhere/film.mp4", ["nowhere", "does not exist"]),
    ("frame 3 --out a.jpg", [".png"]),
    ("map 99", ["no step 99", "0 to 11"]),
    ("map --out map.jpg", [".png, .svg, .pdf"]),
    ("map --camera C9", ["no camera 'C9'"]),
    ("film --kind ids --look night", ["--look", "not with ids"]),
    ("film --kind map --look shaded", ["--look", "not with map"]),
    ("film --kind scene --look fog:0", ["--look fog:0", "metres"]),
    ("film --kind scene --look fog:nan", ["--look fog:nan"]),
    ("film --kind scene --look fog", ["--look fog: needs shaded or plain", "fog:M with"]),
    ("film --kind scene --look clear,rain", ["--look clear,rain: needs", "clear or overcast"]),
    ("film --kind scene --look nigth", ["did you mean 'night'?"]),
    ("film --kind scene --look plain,night", ["leave out plain"]),
]


@pytest.mark.parametrize(("line", "words"), WRONG)
def test_what_is_wrong_is_said(monkeypatch, call, run, tmp_path, line, words):
    monkeypatch.chdir(tmp_path)
    task, *options = line.split()
    said = refused(call, task, run, *options)
    assert all(word in said for word in words), said
    assert not list(tmp_path.iterdir())


def test_a_film_is_not_overwritten_unasked(call, run, tmp_path):
    for name, kind in (("film.mp4", "mp4"), ("film.gif", "gif"), ("film", "png")):
        arguments = ("film", run, "--kind", "scene", "--width", 160, "--end", 1, "--format", kind)
        arguments += ("--out", tmp_path / name)
        assert call("view", *arguments)[0] == 0
        assert "--overwrite" in refused(call, *arguments)
        assert call("view", *arguments, "--overwrite")[0] == 0


def test_a_folder_that_is_no_run_or_has_other_things_and_a_missing_ffmpeg_are_said(monkeypatch, call, run, tmp_path):
    assert "no run" in refused(call, "film", tmp_path, "--kind", "ids")
    assert "does not exist" in refused(call, "film", tmp_path / "x", "--kind", "ids")
    (tmp_path / "thesis.pdf").write_text("precious")
    arguments = ("film", run, "--kind", "scene", "--format", "png", "--out", tmp_path, "--overwrite")
    assert "thesis.pdf" in refused(call, *arguments)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    said = refused(call, "film", run, "--kind", "scene", "--out", tmp_path / "film.mp4")
    assert "pip install 'modsim3d[video]'" in said and "--format gif" in said
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.pdf"]  # before anything is drawn


def broken_encoder(monkeypatch, folder, script):
    """An encoder that runs a script, and the empty folder for a film."""
    encoder, out = folder / "ffmpeg", folder / "out"
    encoder.write_text(f"#!/bin/sh\n{script}\n")
    encoder.chmod(0o755)
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(encoder))
    out.mkdir(exist_ok=True)
    return out


def test_an_encoder_that_fails_or_loses_pictures_leaves_nothing(monkeypatch, call, run, tmp_path):
    encoder = imageio_ffmpeg.get_ffmpeg_exe()  # before another is set
    out = broken_encoder(monkeypatch, tmp_path, "echo 'no such encoder' >&2\nexit 1")
    # Of an ffmpeg that has ended by itself, imageio-ffmpeg leaves the pipe to the garbage collector.
    with warnings.catch_warnings(action="ignore", category=ResourceWarning):
        said = refused(call, "film", run, "--kind", "scene", "--out", out / "film.mp4")
        gc.collect()
    assert "film.mp4 could not be encoded: no such encoder\n" in said and not list(out.iterdir())
    # An encoder that takes every picture, encodes those of the first second, and says that all is well.
    script = f'[ "$1" = -y ] && {{ {encoder} -t 1 "$@"; exec cat >/dev/null; }}\nexec {encoder} "$@"'
    out = broken_encoder(monkeypatch, tmp_path, script)
    said = refused(call, "film", run, "--kind", "scene", "--width", 160, "--out", out / "film.mp4")
    assert re.search(r"film\.mp4 could not be encoded: it has 5 of \d+ pictures", said) and not list(out.iterdir())


def test_an_interrupted_run_is_drawn_as_far_as_it_goes_and_says_so(monkeypatch, call, tmp_path):
    monkeypatch.setattr(pipeline, "MAX_BLOCK_STEPS", 250)
    scene = load_scene(write_scene(tmp_path, {"boat": ([10, 4, 3], [[0, 250, 10], [999, 250, 12]])}, 400))
    cut = interrupt(scene, tmp_path / "cut")
    options = ("--kind", "scene", "--every", 50, "--format", "png", "--width", 160)
    answer(call, ("view", "film", cut, *options), "interrupted; of 400 steps there are steps 0 to 249")
    assert len(list((cut / "scene").iterdir())) == 5
    assert "249" in refused(call, "frame", cut, 300) and "--resume" in refused(call, "sheet", cut)
    shutil.rmtree(cut / "scene")
    for path in (cut / "unfinished").glob("truth_*.npz"):
        path.unlink()
    assert "not finished a single block" in refused(call, "film", cut, "--kind", "ids")
    run_scene(scene, cut, resume=True)
    assert (cut / "run.json").exists()


STALLING = """
import os
import time
from modsim3d.view.films.renderer import FilmRenderer

draw, asked = FilmRenderer.draw, []

def stalling(self, step_frames):
    asked.append(step_frames.step)
    if len(asked) == {frame}:
        open({reached!r}, "w").close()
        {then}
    return draw(self, step_frames)

FilmRenderer.draw = stalling
"""
MIDDLE = 11  # of 12 frames, drawn and written four at a time; a GIF draws four for its palette first
FOR_LONG = "time.sleep(600)"
STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
FILMS = [*(("film.mp4", number) for number in STOPS), ("film.gif", signal.SIGTERM), ("film", signal.SIGINT)]


@pytest.fixture
def stalled(run, prepared, tmp_path_factory):
    """A function that starts a command, which then has drawn some frames of a film."""

    def begin(out, *options, frame=MIDDLE, then=FOR_LONG, alone=False):
        """`alone`: an interpreter and session of its own, for workers and what cannot be passed on."""
        folder = tmp_path_factory.mktemp("stalling")
        reached, first = folder / "reached", folder / "sitecustomize.py"  # which every interpreter runs, workers' too
        first.write_text(STALLING.format(frame=frame, then=then, reached=str(reached)))
        path = os.pathsep.join([str(folder), *sys.path])
        # As `cli.main` does it, before numpy starts threads.
        threads = {"OPENBLAS_NUM_THREADS": "1", "JE_ARROW_MALLOC_CONF": "background_thread:false"}
        program = [sys.executable, "-m", "modsim3d.cli.main"] if alone else [prepared]
        arguments = ("view", "film", run, "--kind", "detections", "--width", "320", "--out", out, *options)
        command, where = [*program, *arguments], {"PYTHONPATH": path, **threads} if alone else {"FIRST": str(first)}
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "start_new_session": True}
        drawing = subprocess.Popen([*map(str, command)], env={**os.environ, **where}, **pipes)
        wait_for(lambda: reached.exists() or drawing.poll() is not None)
        assert reached.exists(), drawing.communicate()[1]
        return drawing

    return begin


def entries(folder):
    return sorted(path.name for path in folder.iterdir())


def wait_for_encoders(folder):
    """All that write to a folder end soon: they are asked to when the command does."""
    wait_for(lambda: not any(encodes(path, folder) for path in Path("/proc").glob("[0-9]*/cmdline")))


def encodes(path, folder):
    try:
        command = path.read_bytes()
    except OSError:
        return False
    return str(folder).encode() in command and b"ffmpeg" in command


@pytest.mark.parametrize(("name", "number"), FILMS)
def test_a_stopped_film_leaves_nothing(stalled, tmp_path, name, number):
    options = () if "." in name else ("--format", "png")
    drawing = stalled(tmp_path / name, *options)
    assert any(".partial" in entry for entry in entries(tmp_path))
    drawing.send_signal(number)
    _, said = drawing.communicate(timeout=240)
    assert drawing.returncode == 128 + number and "no film was written" in said and "Traceback" not in said
    wait_for_encoders(tmp_path)
    assert entries(tmp_path) == []


def test_a_failing_film_leaves_nothing_and_a_stopped_one_replaces_nothing_and_said_what_comes(stalled, tmp_path):
    drawing = stalled(tmp_path / "film.mp4", then="raise ZeroDivisionError")
    drawing.communicate(timeout=240)
    wait_for_encoders(tmp_path)
    assert drawing.returncode != 0 and entries(tmp_path) == []
    (tmp_path / "film.mp4").write_bytes(b"the film before")
    drawing = stalled(tmp_path / "film.mp4", "--overwrite", frame=1)
    assert drawing.stderr is not None
    assert drawing.stderr.readline() == "film.mp4: 12 frames, 12.0 s at 5 pictures/s\n"
    drawing.send_signal(signal.SIGTERM)
    drawing.communicate(timeout=240)
    assert entries(tmp_path) == ["film.mp4"] and (tmp_path / "film.mp4").read_bytes() == b"the film before"


@pytest.mark.parametrize("number", STOPS)
def test_a_film_of_several_workers_can_be_stopped(stalled, tmp_path_factory, tmp_path, number):
    """Frame 3, as each worker counts its own; a worker ends what it does, without a word.
    A terminal that is closed sends its signal to the whole group."""
    go_on = tmp_path_factory.mktemp("go") / "on"  # which workers wait for in the middle of a film
    waiting = f"while not os.path.exists({str(go_on)!r}): time.sleep(0.01)"
    drawing = stalled(tmp_path / "film.mp4", "--workers", "2", frame=3, then=waiting, alone=True)
    (os.killpg if number == signal.SIGHUP else os.kill)(drawing.pid, number)
    go_on.touch()
    _, said = drawing.communicate(timeout=240)
    assert drawing.returncode == 128 + number and entries(tmp_path) == []
    assert "no film was written" in said and "Traceback" not in said


def test_a_killed_film_leaves_what_the_next_one_removes(stalled, run, prepared, tmp_path):
    drawing = stalled(tmp_path / "film.mp4", alone=True)
    drawing.kill()
    drawing.communicate(timeout=240)
    left = entries(tmp_path)
    assert left and all(each.startswith(".film.") and each.endswith((".partial.mp4", ".lock")) for each in left), left
    command = [prepared, "view", "film", run, "--kind", "detections", "--width", "320", "--out", tmp_path / "film.mp4"]
    subprocess.run(command, check=True, capture_output=True, timeout=240)
    assert entries(tmp_path) == ["film.mp4"]
