"""Films that are stopped while they are drawn, as real processes: nothing of them is left, and nothing is replaced."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

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
        while not reached.exists():
            if drawing.poll() is not None:
                raise AssertionError(drawing.communicate()[1])
            time.sleep(0.02)
        return drawing

    return begin


def entries(folder):
    return sorted(path.name for path in folder.iterdir())


def all_end(folder, within_s=20):
    """Whether all encoders that write to a folder end soon: they are asked to when the command does."""
    last_s = time.monotonic() + within_s
    while any(encodes(path, folder) for path in Path("/proc").glob("[0-9]*/cmdline")):
        if time.monotonic() > last_s:
            return False
        time.sleep(0.05)
    return True


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
    _, said = drawing.communicate(timeout=60)
    assert drawing.returncode == 128 + number and "no film was written" in said and "Traceback" not in said
    assert entries(tmp_path) == [] and all_end(tmp_path)


def test_what_is_coming_is_said_before_it_is_drawn_and_a_stopped_film_replaces_nothing(stalled, tmp_path):
    (tmp_path / "film.mp4").write_bytes(b"the film before")
    drawing = stalled(tmp_path / "film.mp4", "--overwrite", frame=1)
    assert drawing.stderr is not None
    assert drawing.stderr.readline() == "film.mp4: 12 frames, 12.0 s at 5 pictures/s\n"
    drawing.send_signal(signal.SIGTERM)
    drawing.communicate(timeout=60)
    assert entries(tmp_path) == ["film.mp4"] and (tmp_path / "film.mp4").read_bytes() == b"the film before"


def test_a_film_that_fails_in_the_middle_leaves_nothing(stalled, tmp_path):
    drawing = stalled(tmp_path / "film.mp4", then="raise ZeroDivisionError")
    drawing.communicate(timeout=60)
    assert drawing.returncode != 0 and entries(tmp_path) == [] and all_end(tmp_path)


@pytest.mark.parametrize("number", STOPS)
def test_a_film_of_several_workers_can_be_stopped(stalled, tmp_path_factory, tmp_path, number):
    """Frame 3, as each worker counts its own; a worker ends what it does, without a word.
    A terminal that is closed sends its signal to the whole group."""
    go_on = tmp_path_factory.mktemp("go") / "on"  # which workers wait for in the middle of a film
    waiting = f"while not os.path.exists({str(go_on)!r}): time.sleep(0.01)"
    drawing = stalled(tmp_path / "film.mp4", "--workers", "2", frame=3, then=waiting, alone=True)
    (os.killpg if number == signal.SIGHUP else os.kill)(drawing.pid, number)
    go_on.touch()
    _, said = drawing.communicate(timeout=60)
    assert drawing.returncode == 128 + number and entries(tmp_path) == []
    assert "no film was written" in said and "Traceback" not in said


def test_a_killed_film_leaves_what_the_next_one_removes(stalled, run, prepared, tmp_path):
    drawing = stalled(tmp_path / "film.mp4", alone=True)
    drawing.kill()
    drawing.communicate(timeout=60)
    left = entries(tmp_path)
    assert left and all(each.startswith(".film.") and each.endswith((".partial.mp4", ".lock")) for each in left), left
    command = [prepared, "view", "film", run, "--kind", "detections", "--width", "320", "--out", tmp_path / "film.mp4"]
    subprocess.run(command, check=True, capture_output=True, timeout=60)
    assert entries(tmp_path) == ["film.mp4"]
