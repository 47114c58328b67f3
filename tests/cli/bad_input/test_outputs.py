"""No command loses a file: none that it reads, none that it has not been told to replace, none by failing halfway."""

import hashlib
import resource
import subprocess
from functools import partial
from pathlib import Path

import pytest

from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.writing.coco import write_coco
from modsim3d.io.overwrite_guard import locked_file, locked_folder
from modsim3d.runs.run import run_scene
from modsim3d.scene.reading import load_scene
from tests.cli.bad_input.builders import CIRCULAR, Call, Inputs, refusal
from tests.cli.bad_input.writers import TRACKS, WRITERS
from tests.run_folders import run_files
from tests.scenes import crossing


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("outputs")
    run_scene(load_scene(crossing(folder, 20), source="analytic"), folder / "run")
    write_coco(labelled_run(folder / "run")[0], folder / "coco")
    (folder / "tracks.csv").write_text(TRACKS)
    return folder / "run"


@pytest.mark.parametrize(("name", "line"), WRITERS.values(), ids=WRITERS)
def test_a_file_is_replaced_only_with_overwrite_and_while_nobody_writes_it(run, call: Call, tmp_path, name, line):
    out = tmp_path / "out" / name
    with locked_file(out):
        refusal(call, (*line(run, out), "--overwrite"), f"{out} is being written by ")
    assert run_files(out.parent) == {}
    out.parent.mkdir(exist_ok=True)
    out.write_text("mine")
    refusal(call, line(run, out), f"{out} exists: use --overwrite")
    assert run_files(out.parent) == {name: b"mine"}
    status, said = call(*line(run, out), "--overwrite")
    assert status in (0, 1), said
    assert out.read_bytes() != b"mine"
    assert not [path.name for path in out.parent.iterdir() if path.name.startswith(".")]
    (tmp_path / "file").write_text("mine")  # a folder of this name cannot be made
    said = refusal(call, line(run, tmp_path / "file" / name), str(tmp_path / "file"))
    assert ".partial" not in said and ".lock" not in said
    assert (tmp_path / "file").read_bytes() == b"mine"


@pytest.mark.parametrize(
    "line",
    [
        lambda run: ("report", run, "--out", run / "truth.parquet"),
        lambda run: ("view", "frame", run, 3, "--out", run / "listed.png"),
        lambda run: ("view", "film", run, "--kind", "ids", "--out", run / "listed.gif"),
        lambda run: ("learn", run, "--out", run / "run.json"),
        lambda run: ("learn", *pair(run), "--out", run.parent / "coco" / "gt.json"),
        lambda run: ("learn", *pair(run), "--out", run.parent / "link" / "dt.json"),
        lambda run: ("check", "run", run, "--detector", run.parent / "coco/verify.json", "--out", run.parent / "coco"),
    ],
)
def test_what_a_command_reads_is_not_written_over_even_if_it_is_told_to(run, call: Call, line) -> None:
    for path in (run / "listed.png", run / "listed.gif", run.parent / "coco" / "verify.json"):
        path.write_bytes(b"mine")
    listed = (run / "run.json").read_text()
    entry = f'{{"bytes": 4, "sha256": "{hashlib.sha256(b"mine").hexdigest()}"}}'
    files = f'"files": {{"listed.png": {entry}, "listed.gif": {entry},'
    (run / "run.json").write_text(listed.replace('"files": {', files))
    if not (run.parent / "link").exists():
        (run.parent / "link").symlink_to(run.parent / "coco")
    before = run_files(run.parent)
    status, said = call(*line(run), "--overwrite")
    (run / "run.json").write_text(listed)
    assert status == 2
    assert "is read by this command, so it is not written over" in said
    assert run_files(run.parent) == {**before, "run/run.json": listed.encode()}


def pair(run: Path) -> tuple[object, ...]:
    return ("--truth", run.parent / "coco" / "gt.json", "--detections", run.parent / "coco" / "dt.json")


def test_only_regular_files_are_written(run, call: Call, tmp_path) -> None:
    (tmp_path / "device").symlink_to("/dev/null")
    (tmp_path / "folder" / "report.html").mkdir(parents=True)
    (tmp_path / "circle").symlink_to("circle")
    for name in ("device", "folder"):
        refusal(call, ("report", run, "--out", tmp_path / name, "--overwrite"), "choose another name")
    assert Path("/dev/null").is_char_device()
    for line in (("report", run), ("export", run, "--format", "coco")):
        refusal(call, (*line, "--out", tmp_path / "circle"), str(tmp_path / "circle"))


def test_a_link_is_written_through_and_a_page_is_not_written_into_the_detector_file(run, call: Call, tmp_path) -> None:
    (tmp_path / "d.html").symlink_to("d.yaml")
    refusal(call, ("learn", run, "--out", tmp_path / "d.yaml"), "the page would be written over the detector file")
    assert run_files(tmp_path) == {}
    (tmp_path / "link.html").symlink_to(tmp_path / "page.html")
    assert call("report", run, "--out", tmp_path / "link.html")[0] == 0
    assert (tmp_path / "link.html").is_symlink()
    assert (tmp_path / "page.html").stat().st_size > 1000


FULL = [
    ("page.html", ("report",)),
    ("picture.png", ("view frame", "3")),
    ("map.png", ("view map",)),
    ("film.gif", ("view film", "--kind", "ids", "--width", "320")),
    ("film.mp4", ("view film", "--kind", "ids", "--width", "320")),
    ("film", ("view film", "--kind", "detections", "--format", "png", "--width", "1600")),
]


@pytest.mark.parametrize(("name", "words"), FULL, ids=[name for name, _ in FULL])
def test_on_a_full_disk_the_file_that_was_there_stays_and_the_new_one_is_named(run, prepared, tmp_path, name, words):
    out = tmp_path / name
    if name == "film":
        out.mkdir()
    (out / "frame_000000.png" if name == "film" else out).write_bytes(b"before")
    before = run_files(tmp_path)
    command, *options = words
    line = [prepared, *command.split(), str(run), *options, "--out", str(out), "--overwrite"]
    small_files = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (1000, 1000))
    done = subprocess.run(line, capture_output=True, text=True, timeout=120, check=False, preexec_fn=small_files)
    assert done.returncode == 2, done.stderr
    assert f"modsim3d: {out} c" in done.stderr  # cannot be written to, could not be encoded
    assert "Traceback" not in done.stderr and ".partial" not in done.stderr
    assert run_files(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("kind", ["gif", "mp4", "png"])
def test_an_interrupted_film_leaves_what_was_there(run, call: Call, tmp_path, monkeypatch, kind):
    out = tmp_path / ("film" if kind == "png" else f"film.{kind}")
    line = ("view", "film", run, "--kind", "ids", "--width", 160, "--every", 5, "--format", kind, "--out", out)
    assert call(*line)[0] == 0
    before = run_files(tmp_path)
    drawn = []

    def interrupt(*_: object, **__: object) -> None:
        drawn.append(1)
        if len(drawn) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr("rich.progress.Progress.update", interrupt)
    status, said = call(*line, "--overwrite")
    assert status == 130
    assert "no film was written" in said
    assert run_files(tmp_path) == before


def test_a_film_killed_between_its_last_two_renames_is_found_again(tmp_path):
    from modsim3d.io.atomic_write import put_folder_in_place

    (tmp_path / ".film.replaced").mkdir()
    (tmp_path / ".film.replaced" / "frame_000001.png").write_text("old")
    with pytest.raises(KeyboardInterrupt), put_folder_in_place(tmp_path / "film", "frame_*.png"):
        raise KeyboardInterrupt
    assert run_files(tmp_path) == {"film/frame_000001.png": b"old"}
    with put_folder_in_place(tmp_path / "film", "frame_*.png") as partial:
        (partial / "frame_000002.png").write_text("new")
    assert run_files(tmp_path) == {"film/frame_000002.png": b"new"}


def test_a_run_is_refused_with_exit_status_two_while_its_folder_is_written(inputs: Inputs, call: Call, tmp_path):
    inputs.data["scene"] |= {"poses": CIRCULAR, "steps": 3, "time_step_s": 0.5}
    with locked_folder(tmp_path / "run"):
        refusal(call, ("run", inputs.write(), "--out", tmp_path / "run"), "is being written by")
    assert not (tmp_path / "run").exists()
