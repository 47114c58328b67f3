"""One rule for all commands: none loses a file that it reads, none that it was not told to replace, none halfway."""

import hashlib
import inspect
import json
import os
import resource
import shutil
import subprocess
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

import modsim3d
from modsim3d.cli import main
from modsim3d.core.errors import OutputError
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.writing.coco import write_coco
from modsim3d.io.overwrite_guard import check_free, locked_file, locked_folder
from modsim3d.runs.run import run_scene
from modsim3d.scene.reading import load_scene
from tests.campaign.small_campaign import small_campaign
from tests.cli.bad_input import writers
from tests.cli.bad_input.builders import Call, Inputs, answer, content, refusal
from tests.run_folders import interrupt, run_files
from tests.scene.ais.ais_builders import SAMPLES
from tests.scenes import crossing

COMMANDS = {name: [*inspect.signature(each, eval_str=True).parameters.values()] for _, name, each, _ in main.COMMANDS}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene, a run of it, its labels and tracks; no test writes here."""
    folder = tmp_path_factory.mktemp("finished")
    run_scene(load_scene(crossing(folder, 40), source="analytic"), folder / "run")
    write_coco(labelled_run(folder / "run")[0], folder / "coco")
    (folder / "tracks.csv").write_text(writers.TRACKS)
    return folder


@pytest.fixture(scope="module")
def stored(finished: Path) -> Path:
    """The run itself, for tests that leave it as it is."""
    return finished / "run"


@pytest.fixture
def run(finished: Path, tmp_path: Path) -> Path:
    """A copy of the run in the test's own folder, with all that lies beside it."""
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    return tmp_path / "run"


def test_the_tables_of_these_tests_have_every_command_and_every_path_that_one_is_given() -> None:
    named = {name.partition(":")[0] for name in writers.WRITERS}
    others = {*writers.FOLDER_WRITERS, *writers.CONTINUING, *writers.INTO_RUNS, *writers.NO_WRITERS}
    assert named | others == COMMANDS.keys()
    defaults = set()
    for name, parameters in COMMANDS.items():
        paths = {each.name for each in parameters if "Path" in str(each.annotation)}
        assert paths <= writers.READ | writers.WRITTEN, f"{name}: is it read or written?"
        writes = name not in writers.NO_WRITERS
        replaces = "overwrite" in {each.name for each in parameters}
        assert writes == (bool(paths & writers.WRITTEN) or name in writers.INTO_RUNS), name
        assert writes == (replaces or name in writers.CONTINUING), name
        optional = {each.name for each in parameters if each.default is None}
        # The first three write nothing without it, and the page of a campaign does not lie in a run.
        if name in named and "out" in optional and name not in writers.NO_DEFAULT:
            defaults.add(name)
    assert {name.partition(":")[0] for name in writers.DEFAULTS} == defaults | {*writers.INTO_RUNS}


@pytest.mark.parametrize(("names", "line"), writers.DEFAULTS.values(), ids=writers.DEFAULTS)
def test_what_a_command_writes_into_a_run_it_writes_again_only_with_overwrite(run, call, names, line):
    assert call(*line(run))[0] in (0, 1)
    for name in names:
        (run / name).write_bytes(b"mine")
    said = refusal(call, line(run), " exists: use --overwrite", kept=run)
    assert len(said.splitlines()) == 1
    assert call(*line(run), "--overwrite")[0] in (0, 1)
    assert all((run / name).read_bytes() != b"mine" for name in names)


HOW: dict[str, Callable[[Path, Path], None]] = {
    "link": lambda out, read: out.symlink_to(read),
    "link to a link": lambda out, read: (out.with_name("between").symlink_to(read), out.symlink_to("between")),
    "hard link": lambda out, read: os.link(read, out),
}


@pytest.mark.parametrize("how", HOW.values(), ids=HOW)
@pytest.mark.parametrize("name", writers.WRITERS)
def test_what_a_command_reads_stays_whatever_leads_to_it(run: Path, call: Call, tmp_path, name: str, how) -> None:
    file, line = writers.WRITERS[name]
    read = writers.INPUTS[name](run) if name in writers.INPUTS else run / "truth.parquet"
    out = tmp_path / "out" / file
    out.parent.mkdir()
    how(out, read)
    refusal(call, (*line(run, out), "--overwrite"), f"{out} is read by this command", kept=tmp_path)


def test_what_a_command_reads_stays_however_it_is_spelled_or_named(run, call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("folder").symlink_to(run)
    for spelled in ("run/../run/truth.parquet", "./run//truth.parquet", "folder/truth.parquet"):
        refusal(call, ("report", "run", "--out", spelled, "--overwrite"), "is read by this command", kept=tmp_path)
    # as where the case of a name means nothing: `realpath` gives two names, `stat` one file
    (tmp_path / "gt.json").write_text("mine")
    os.link(tmp_path / "gt.json", tmp_path / "GT.JSON")
    with pytest.raises(OutputError, match="is read by this command"):
        check_free(tmp_path / "GT.JSON", True, [tmp_path / "gt.json"])


@pytest.mark.parametrize("name", [".d.yaml.lock", ".d.partial.yaml"])
def test_what_lies_beside_an_output_while_it_is_written_is_no_input(run: Path, call: Call, tmp_path, name) -> None:
    (tmp_path / name).write_text("usual\n")
    line = ("learn", run, "--sequence", tmp_path / name, "--time-step", 1, "--out", tmp_path / "d.yaml")
    refusal(call, (*line, "--overwrite"), str(tmp_path / name))
    assert (tmp_path / name).read_text() == "usual\n"


def yolo(folder: Path) -> tuple[object, ...]:
    """A YOLO data set whose classes stand in a file above it."""
    for kind, line in (("labels", "0 .5 .5 .2 .2\n"), ("found", "0 .5 .5 .2 .2 .9\n")):
        (folder / kind).mkdir(parents=True)
        (folder / kind / "a.txt").write_text(line)
    (folder / "data.yaml").write_text("names: [boat]\n")
    options = ("--image-size", "640,480", "--replicates", 20, "--no-check")
    return ("learn", "--truth", folder / "labels", "--detections", folder / "found", *options)


def mot(folder: Path) -> tuple[object, ...]:
    """A MOT sequence with its size in a file above it."""
    (folder / "gt").mkdir()
    (folder / "gt" / "gt.txt").write_text("1,3,10,20,30,40,1,1,0.5\n")
    (folder / "det.txt").write_text("1,-1,12,20,30,40,0.9\n")
    text = "[Sequence]\nimWidth=640\nimHeight=480\nseqLength=1\nframeRate=10\n"
    (folder / "seqinfo.ini").write_text(text)
    files = ("--truth", folder / "gt" / "gt.txt", "--detections", folder / "det.txt")
    return ("learn", *files, "--replicates", 20, "--no-check")


@pytest.mark.parametrize(("make", "name"), [(yolo, "data.yaml"), (mot, "seqinfo.ini")])
def test_files_that_learn_reads_without_being_told_stay_too(call: Call, tmp_path, make, name) -> None:
    line, out = make(tmp_path), tmp_path / name
    refusal(call, (*line, "--out", out, "--overwrite"), f"{out} is read by this command", kept=tmp_path)
    assert call(*line, "--out", tmp_path / "labels.yaml")[0] == 0


def test_neither_do_results_in_python_replace_what_they_are_made_of_or_what_is_there(run: Path, tmp_path) -> None:
    yolo(tmp_path / "set")
    paths = {"truth": tmp_path / "set" / "labels", "detections": tmp_path / "set" / "found"}
    result = modsim3d.learn_detector(**paths, image_size_px=(640, 480), replicates=20, check=False)
    verified = modsim3d.verify_run(run)
    result.write(tmp_path / "learned.yaml")
    verified.write()
    before = content(tmp_path)
    for name in ("set/data.yaml", "set/labels/a.txt"):
        with pytest.raises(OutputError, match="is read by this command"):
            result.write(tmp_path / name, overwrite=True)
    for write in (partial(result.write, tmp_path / "learned.yaml"), verified.write):
        with pytest.raises(OutputError, match="exists: use overwrite=True"):
            write()
    assert content(tmp_path) == before
    verified.write(overwrite=True)


@pytest.mark.parametrize("name", sorted({"film: frames", *writers.WRITERS} - writers.INPUTS.keys()))
def test_nothing_is_written_among_the_unfinished_files_of_the_run_that_is_read(run, call: Call, name: str) -> None:
    frames = lambda run, out: ("view", "film", run, "--kind", "ids", "--format", "png", "--out", out)  # noqa: E731
    file, line = writers.WRITERS.get(name, ("ids", frames))
    out = run / "unfinished" / "new" / file
    if name.startswith(("view", "film")):
        out.parent.mkdir(parents=True)
    said = f" is inside {run / 'unfinished'}, which this command reads"
    refusal(call, (*line(run, out), "--overwrite"), said, kept=run)
    assert not out.exists()


@pytest.mark.parametrize("how", ["there", "link", "hard link"])
def test_a_vessels_file_among_the_files_that_a_run_replaces_stays(inputs: Inputs, call: Call, tmp_path, how) -> None:
    out = tmp_path / "run"
    interrupt(load_scene(inputs.write()), out)
    inside, given = out / "unfinished" / "vessels.json", inputs.path("vessels")
    shutil.move(given, inside)
    if how == "there":
        inputs.data["scene"]["vessels"] = str(inside)
    elif how == "link":
        given.symlink_to(inside)
    else:
        inside.rename(out / "unfinished" / "detections_C0.jsonl")
        os.link(out / "unfinished" / "detections_C0.jsonl", given)
    assert inputs.data.pop("vessels")
    refusal(call, ("run", inputs.write(), "--out", out, "--overwrite", "--no-sheet"), "this run reads it", kept=out)


@pytest.mark.parametrize("name", ["poses.jsonl", "unfinished/poses.jsonl"])
def test_the_poses_of_a_live_run_are_not_lost_by_running_them_again(inputs: Inputs, call: Call, tmp_path, name) -> None:
    out = tmp_path / "run"
    line = json.dumps({"0.0": inputs.data["poses"]["0.0"]})
    (tmp_path / "live.jsonl").write_text(line + "\n")
    inputs.data["scene"]["poses"] = {"stream": {"file": str(tmp_path / "live.jsonl"), "timeout_s": 0}}
    assert call("run", inputs.write(), "--out", out, "--no-sheet")[0] == 0
    (out / name).parent.mkdir(exist_ok=True)
    (out / name).write_text(line + "\n")
    inputs.data["scene"]["poses"] = {"stream": {"file": str(out / name), "timeout_s": 0}}
    refusal(call, ("run", inputs.write(), "--out", out, "--overwrite", "--no-sheet"), "this run reads it", kept=out)


def test_a_run_does_not_replace_a_file_that_a_hard_link_leads_to(inputs: Inputs, call: Call, tmp_path) -> None:
    run_scene(load_scene(inputs.write()), tmp_path / "run")
    shutil.copy(inputs.path("poses"), tmp_path / "poses.json")
    inputs.path("poses").unlink()
    inputs.data.pop("poses")
    os.link(tmp_path / "run" / "scene" / "poses.json", inputs.path("poses"))
    line = ("run", inputs.path("scene"), "--out", tmp_path / "run", "--overwrite", "--no-sheet")
    refusal(call, line, "this run reads it", kept=tmp_path)


@pytest.mark.parametrize("name", ["run", "detect", "detect: truth", "ais"])  # `campaign reproduce` reuses its own
def test_a_folder_that_holds_something_is_refused_without_overwrite(run: Path, call: Call, tmp_path, name) -> None:
    lines = {
        "run": ("run", tmp_path / "scene.yaml", "--steps", 3, "--source", "analytic", "--no-sheet"),
        "detect": ("detect", run, "--detector-seed", 3),
        "detect: truth": writers.labelled(run),
        "ais": ("ais", SAMPLES / "danish.csv"),
    }
    out = tmp_path / "new"
    assert call(*lines[name], "--out", out)[0] == 0
    said = refusal(call, (*lines[name], "--out", out), "--overwrite", kept=out)
    assert len(said.splitlines()) == 1
    assert call(*lines[name], "--out", out, "--overwrite")[0] == 0
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    assert call(*lines[name], "--out", tmp_path / "mine", "--overwrite")[0] == 2
    assert content(tmp_path / "mine") == {"notes.txt": b"mine"}


def test_an_ais_log_stays_whatever_leads_to_it(call: Call, tmp_path) -> None:
    out, log = tmp_path / "scene", tmp_path / "log.csv"
    shutil.copy(SAMPLES / "danish.csv", log)
    assert call("ais", log, "--out", out)[0] == 0
    for how in HOW.values():
        (out / "vessels.json").unlink()
        how(out / "vessels.json", log)
        refusal(call, ("ais", log, "--out", out, "--overwrite"), "is read by this command", kept=tmp_path)
    shutil.copy(log, out / "report.json")
    refusal(call, ("ais", out / "report.json", "--out", out, "--overwrite"), "is read by this command", kept=out)
    with locked_folder(out):
        refusal(call, ("ais", SAMPLES / "danish.csv", "--out", out, "--overwrite"), "is being written by", kept=out)


@pytest.mark.parametrize("name", writers.NO_WRITERS)
def test_commands_that_write_nothing_write_nothing(run: Path, call: Call, tmp_path, monkeypatch, name) -> None:
    monkeypatch.chdir(tmp_path)
    small_campaign(tmp_path)
    before = content(tmp_path)
    lines = {"scenes": (), "check repeat": ("run",)}
    lines |= {"stream": ("scene.yaml", "--steps", 3), "campaign status": ("campaign",), "campaign plan": ("example",)}
    assert call(*name.split(), *lines[name])[0] == 0
    assert content(tmp_path) == before


def test_a_folder_that_is_written_and_a_detector_from_a_pipe_are_told(inputs: Inputs, call: Call, tmp_path) -> None:
    """A pipe as the shell gives for `--detector <(cat file)`."""
    reading, writing = os.pipe()
    line = ("run", inputs.write(), "--out", tmp_path / "run")
    with os.fdopen(reading), os.fdopen(writing, "w"):
        pipe = f"/dev/fd/{reading}"
        refusal(call, (*line, "--detector", pipe), f"detector {pipe}: this is a pipe, a file was expected")
    with locked_folder(tmp_path / "run"):
        refusal(call, line, "is being written by")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(("name", "line"), writers.WRITERS.values(), ids=writers.WRITERS)
def test_a_file_is_replaced_only_with_overwrite_and_while_nobody_writes_it(stored, call: Call, tmp_path, name, line):
    out = tmp_path / "out" / name
    with locked_file(out):
        refusal(call, (*line(stored, out), "--overwrite"), f"{out} is being written by ")
    assert run_files(out.parent) == {}
    out.parent.mkdir(exist_ok=True)
    out.write_text("mine")
    refusal(call, line(stored, out), f"{out} exists: use --overwrite")
    assert run_files(out.parent) == {name: b"mine"}
    assert call(*line(stored, out), "--overwrite")[0] in (0, 1)
    assert out.read_bytes() != b"mine"
    assert not [path.name for path in out.parent.iterdir() if path.name.startswith(".")]
    (tmp_path / "file").write_text("mine")  # a folder of this name cannot be made
    said = refusal(call, line(stored, tmp_path / "file" / name), str(tmp_path / "file"))
    assert ".partial" not in said and ".lock" not in said
    assert (tmp_path / "file").read_bytes() == b"mine"


def test_what_a_command_reads_is_not_written_over_even_if_it_is_told_to(run, call: Call, tmp_path) -> None:
    for path in (run / "listed.png", run / "listed.gif", tmp_path / "coco" / "verify.json"):
        path.write_bytes(b"mine")
    (tmp_path / "link").symlink_to(tmp_path / "coco")
    settings = json.loads((run / "run.json").read_text())
    entry = {"bytes": 4, "sha256": hashlib.sha256(b"mine").hexdigest()}
    files = {"listed.png": entry, "listed.gif": entry, **settings["files"]}
    (run / "run.json").write_text(json.dumps({**settings, "files": files}))
    for line in (
        ("report", run, "--out", run / "truth.parquet"),
        ("view", "frame", run, 3, "--out", run / "listed.png"),
        ("view", "film", run, "--kind", "ids", "--out", run / "listed.gif"),
        ("learn", run, "--out", run / "run.json"),
        ("learn", *pair(run), "--out", run.parent / "coco" / "gt.json"),
        ("learn", *pair(run), "--out", run.parent / "link" / "dt.json"),
        ("check", "run", run, "--detector", run.parent / "coco/verify.json", "--out", run.parent / "coco"),
    ):
        said = "is read by this command, so it is not written over"
        refusal(call, (*line, "--overwrite"), said, kept=tmp_path)


def pair(run: Path) -> tuple[object, ...]:
    return ("--truth", run.parent / "coco" / "gt.json", "--detections", run.parent / "coco" / "dt.json")


def test_only_regular_files_are_written_links_through_and_no_page_into_the_detector_file(stored, call, tmp_path):
    (tmp_path / "device").symlink_to("/dev/null")
    (tmp_path / "folder" / "report.html").mkdir(parents=True)
    (tmp_path / "circle").symlink_to("circle")
    for name in ("device", "folder"):
        refusal(call, ("report", stored, "--out", tmp_path / name, "--overwrite"), "choose another name")
    assert Path("/dev/null").is_char_device()
    for line in (("report", stored), ("export", stored, "--format", "coco")):
        refusal(call, (*line, "--out", tmp_path / "circle"), str(tmp_path / "circle"))
    (tmp_path / "d.html").symlink_to("d.yaml")
    refusal(call, ("learn", stored, "--out", tmp_path / "d.yaml"), "the page would be written over the detector file")
    assert run_files(tmp_path) == {}
    (tmp_path / "link.html").symlink_to(tmp_path / "page.html")
    assert call("report", stored, "--out", tmp_path / "link.html")[0] == 0
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
def test_on_a_full_disk_the_file_that_was_there_stays_and_the_new_one_is_named(stored, prepared, tmp_path, name, words):
    out = tmp_path / name
    if name == "film":
        out.mkdir()
    (out / "frame_000000.png" if name == "film" else out).write_bytes(b"before")
    before = run_files(tmp_path)
    command, *options = words
    line = [prepared, *command.split(), str(stored), *options, "--out", str(out), "--overwrite"]
    small_files = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (1000, 1000))
    done = subprocess.run(line, capture_output=True, text=True, timeout=240, check=False, preexec_fn=small_files)
    assert done.returncode == 2, done.stderr
    assert f"modsim3d: {out} c" in done.stderr  # cannot be written to, could not be encoded
    assert "Traceback" not in done.stderr and ".partial" not in done.stderr
    assert run_files(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("kind", ["gif", "mp4", "png"])
def test_an_interrupted_film_leaves_what_was_there(stored, call: Call, tmp_path, monkeypatch, kind):
    out = tmp_path / ("film" if kind == "png" else f"film.{kind}")
    line = ("view", "film", stored, "--kind", "ids", "--width", 160, "--every", 5, "--format", kind, "--out", out)
    assert call(*line)[0] == 0
    before = run_files(tmp_path)
    drawn = []

    def interrupt(*_: object, **__: object) -> None:
        drawn.append(1)
        if len(drawn) == 3:
            raise KeyboardInterrupt

    monkeypatch.setattr("rich.progress.Progress.update", interrupt)
    answer(call, (*line, "--overwrite"), "no film was written", status=130)
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
