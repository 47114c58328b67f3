"""Wrong arguments and settings, hostile text, odd terminals, no renderer or memory: one error, and nothing is lost."""

import io
import json
import os
import re
import resource
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from modsim3d.cli import terminal
from modsim3d.cli.shared import print_line, progress
from modsim3d.cli.terminal_tables import print_table
from modsim3d.render import context
from modsim3d.runs.run import run_scene
from modsim3d.scene.reading import load_scene
from tests.campaign.campaigns import interrupt
from tests.cli.bad_input.builders import CIRCULAR, DELETED, GOOD, Call, Inputs, answer, content, refusal


def test_wrong_arguments_exit_with_two(call, tmp_path, monkeypatch):
    for arguments, part in (
        ("run simulation_1 --mode 3", "'--mode': must be at most 2 (got '3')"),
        ("run simulation_1 --steps 2.5", "'--steps': a whole number is needed (got '2.5')"),
        ("run simulation_1 --seed -1", "--seed"),
        ("run simulation_1 --source guessed", "--source"),
        ("run simulation_1 --frobnicate", "--frobnicate"),
        ("run", "SCENE"),
        ("fly", "fly"),
        (f"run simulation_1 --seed {2**70}", "seed: must be "),
        ("check scene simulaton_1", "no shipped scene has this name (did you mean 'simulation_1'?)"),
        ("check scene .", "this is a folder"),
        (f"check scene {'x' * 5000}", "File name too long"),
        ("check scene /dev/null", "this is a device, a file was expected"),
    ):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setenv("COLUMNS", "200")
        assert part in re.sub(r"\x1b\[[0-9;]*m", "", refusal(call, arguments.split()))
        assert not list(tmp_path.iterdir())
    (tmp_path / "simulation_1").mkdir()  # which does not hide the shipped scene of this name
    assert call("check", "scene", "simulation_1")[0] == 0


@pytest.fixture
def finished(inputs: Inputs, call: Call, tmp_path: Path) -> Path:
    """A run directory that must not be lost."""
    answer(call, ("run", inputs.write(), "--out", tmp_path / "kept", "--no-sheet"))
    return tmp_path / "kept"


def test_folder_that_cannot_be_written_to_is_told(inputs: Inputs, call: Call, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    for place in ("file/run", "file", "/proc/modsim3d/run", "x" * 300):
        said = refusal(call, ("run", inputs.write(), "--out", tmp_path / place))
        assert "cannot be written to" in said or "is not a run directory" in said
    assert (tmp_path / "file").read_text() == "mine"


PRECIOUS = ("notes.txt", "run.json", "unfinished/settings.json", "unfinished/chapter.txt", "truth.parquet")


@pytest.mark.parametrize("options", [(), ("--overwrite",), ("--resume",), ("--overwrite", "--resume")])
@pytest.mark.parametrize("name", PRECIOUS)
def test_a_folder_that_is_no_run_directory_keeps_all_it_holds(inputs, call, tmp_path, options, name):
    precious = tmp_path / "precious"
    (precious / name).parent.mkdir(parents=True)
    (precious / name).write_text('{"mine": true}')
    (precious / "photo.jpg").write_text("mine too")
    said = f"{precious} exists and is not a run directory: choose another folder"
    refusal(call, ("run", inputs.write(), "--out", precious, *options), said, kept=precious)


def test_a_run_is_replaced_neither_unasked_nor_by_bad_input(inputs: Inputs, finished: Path, call: Call) -> None:
    line = ("run", inputs.path("scene"), "--out", finished)
    for options in ((), ("--resume",)):
        refusal(call, (*line, *options), "holds a run: use --overwrite", kept=finished)
    inputs.set("poses", "2.0/vehicle1", DELETED)
    inputs.write()
    refusal(call, (*line, "--overwrite"), kept=finished)


def test_a_run_that_is_replaced_stays_until_the_new_one_is_finished(inputs, finished, call, monkeypatch):
    before = content(finished)
    inputs.data["scene"]["cameras"].pop("shore")
    with monkeypatch.context() as patched:
        patched.setattr("modsim3d.runs.files.run_directory.RunDirectory.write", interrupt)
        assert call("run", inputs.write(), "--out", finished, "--overwrite")[0] == 130
    assert content(finished).items() >= before.items()
    assert call("run", inputs.write(), "--out", finished, "--resume", "--no-sheet")[0] == 0
    after = content(finished)
    assert not any("shore" in name or "unfinished" in name for name in after)
    assert json.loads(after["run.json"])["cameras"] == ["C0"]


@pytest.mark.parametrize("leftover", ["settings.json.partial", ""])
def test_a_run_killed_at_its_very_start_can_be_begun_again(inputs, call, tmp_path, leftover):
    work = tmp_path / "killed" / "unfinished"
    work.mkdir(parents=True)
    if leftover:
        (work / leftover).write_text('{"form')
    answer(call, ("run", inputs.write(), "--out", work.parent, "--resume", "--no-sheet"))


def test_without_an_opengl_library_the_package_to_install_is_named(inputs, call, tmp_path, monkeypatch):
    monkeypatch.delenv("MODSIM3D_GL", raising=False)
    monkeypatch.setattr(context, "_open_here", None)  # another test's context must not serve here
    monkeypatch.setattr(context, "library_found", lambda backend: False)
    parts = ("no OpenGL software renderer was found", "libosmesa6", "mesa-libEGL", "--source analytic")
    refusal(call, ("run", inputs.write(), "--out", tmp_path / "out"), *parts)
    assert not (tmp_path / "out").exists()


def process(*arguments: object, program: Path | None = None, **options: Any) -> subprocess.CompletedProcess[str]:
    command = [*([program] if program else [sys.executable, "-m", "modsim3d.cli.main"]), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=240, **options)


DRIVERS = {"__EGL_VENDOR_LIBRARY_DIRS": "/nonexistent"}
RENDERERS = {
    "backend": ({"MODSIM3D_GL": "nonsense"}, "MODSIM3D_GL='nonsense': use one of osmesa, egl, auto"),
    "device": ({"MODSIM3D_GL": "egl", "MODSIM3D_EGL_DEVICE": "77"}, "DEVICE='77': use a number from 0 to "),
    "no driver": ({"MODSIM3D_GL": "egl", **DRIVERS}, "__EGL_VENDOR_LIBRARY_DIRS='/nonexistent': try without)"),
}


@pytest.mark.parametrize(("asked", "told"), RENDERERS.values(), ids=RENDERERS)
def test_unknown_renderers_are_told_by_a_real_process(inputs, tmp_path, asked, told):
    done = process("run", inputs.write(), "--out", tmp_path / "out", env={**os.environ, **asked})
    assert done.returncode == 2 and told in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


def test_a_real_process_goes_on_after_a_full_disk_and_says_errors_on_standard_error_only(inputs, prepared, tmp_path):
    # Poses that need no file, so that the disk is full only after the scene has been copied.
    inputs.data["scene"] |= {"poses": CIRCULAR, "steps": 120, "time_step_s": 0.5}
    scene, out = inputs.write(), tmp_path / "out"
    small_files = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (20_000, 20_000))
    done = process("run", scene, "--out", out, "--no-sheet", program=prepared, preexec_fn=small_files)
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert f"{out} cannot be written to" in done.stderr
    assert "what was finished is kept: go on with --resume" in done.stderr
    assert not (out / "run.json").exists()
    run_scene(load_scene(scene), out, resume=True)
    assert (out / "run.json").exists()
    inputs.set("vessels", "\ud800", GOOD["vessels"]["vehicle2"])
    inputs.set("scene", "sed", 1)
    done = process("check", "scene", inputs.write(), program=prepared)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("modsim3d: scene ") and "sed: unknown key" in done.stderr
    assert "printable" in done.stderr and "Traceback" not in done.stderr


def test_a_wrong_setting_is_one_error(inputs, call, tmp_path):
    for options, part in (
        (["--set", "foo"], "--set foo: a key and a value are needed, as in waves.level=large"),
        (["--set", "=3"], "--set =3: a key and a value are needed"),
        (["--set", "seed=[1"], "--set seed: line 1, column 3: while parsing a flow sequence"),
        (["--set", "seed={a: 1, a: 2}"], "--set seed: line 1, column 8: key 'a' appears twice"),
        (["--set", "seed=!!python/name:os.system ''"], "the tag !!python/name:os.system is not read"),
        (["--set", "seed.a=1"], "--set seed.a: seed is a number, which has no keys"),
        (["--set", "detector=other.yaml"], "other.yaml: no such file"),
        (["--set", ".=1"], "--set .: unknown key"),
        (["--set", "cameras..skew=1"], "--set cameras..skew: cameras has no ''"),
        (["--set", "cameras.C0.image_size_px.-1=5"], "its items are 0 to 1 (got '-1')"),
        (["--set", "cameras.C0.image_size_px=[640]"], "--set cameras.C0.image_size_px[1]: missing"),
        (["--from", "conditions"], "--from conditions: is a detector in place of the scene's: --state says which one"),
        (["--state", "fog", "--from", "conditions"], "there is no 'fog' (known: foggy_clear, foggy_cloudy)"),
    ):
        scene, out = inputs.write(), tmp_path / "out"
        for command in (["check", "scene", str(scene)], ["run", str(scene), "--out", str(out)]):
            said = refusal(call, (*command, *options))
            assert part in " ".join(said.split())
            assert not out.exists()
    options = ("--state", "noon_clear", "--from", "conditions", "--detector", inputs.path("detector"))
    said = refusal(call, ("run", scene, "--out", out, *options))
    assert "is a detector in place of the scene's: so is --detector" in " ".join(said.split())


def test_the_last_value_of_a_repeated_key_counts_and_a_truth_that_is_kept_cannot_be_set(inputs, call, tmp_path):
    scene, run, other = inputs.write(), tmp_path / "run", tmp_path / "other"
    check = ("check", "scene", scene, "--set")
    answer(call, (*check, "annotation.mode=7", "--set", "annotation.mode=0"))
    refusal(call, (*check, "annotation.mode=0", "--set", "annotation.mode=7"))
    answer(call, ("run", scene, "--source", "analytic", "--no-sheet", "--out", run))
    said = refusal(call, ("detect", run, "--out", other, "--set", "waves.level=small"))
    assert "a finished run keeps its truth: set keys of the detector only" in " ".join(said.split())
    assert not other.exists()
    answer(call, ("detect", run, "--out", other, "--set", "detector.states.fog.false_discovery_rate=0.3"))


HOSTILE = "a\x1b[2J\r\x07\x9b1m\u202eb[/bold] :smile: [red]c"
SHOWN = r"a\x1b[2J\r\x07\x9b1m\u202eb[/bold] :smile: [red]c"
CONTROL = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\u202a-\u202e]")


def test_control_characters_of_names_values_and_arguments_are_shown_and_not_obeyed(inputs: Inputs, call: Call) -> None:
    for file, path, value in [
        ("scene", "vessels", f"{HOSTILE}.json"),
        ("poses", "2.0/vehicle2/heading_rad", HOSTILE),
        ("scene", "poses/file", f"{HOSTILE}\nx.json"),
        ("scene", "detector", f"{HOSTILE}.yaml"),
    ]:
        inputs.set(file, path, value)
    inputs.data["scene"][HOSTILE] = 1
    said = refusal(call, ("check", "scene", inputs.write()))
    for part in (f"{SHOWN}: unknown key", f"{SHOWN}.json: no such file", f"{SHOWN}.yaml: no such", rf"{SHOWN}\nx.json"):
        assert part in said
    for arguments in (("check", "scene", HOSTILE), ("check", "scene", "x", HOSTILE), ("run", "x", f"--{HOSTILE}")):
        said += refusal(call, arguments)
    assert not CONTROL.search(said)


def test_an_argument_that_is_not_utf_8_is_refused(call: Call, tmp_path: Path) -> None:
    name = os.fsdecode(b"x\xff")
    for line in (("check", "scene", tmp_path / f"{name}.yaml"), ("run", "harbour", "--out", tmp_path / name)):
        refusal(call, line, r"x\udcff", "is not UTF-8")
    assert not list(tmp_path.iterdir())


def test_lines_tables_and_bars_show_text_as_it_is_in_the_colours_of_the_commands(monkeypatch) -> None:
    file, err, colours = io.StringIO(), io.StringIO(), io.StringIO()
    console = terminal.open_console(file=file, width=200, force_terminal=False)
    print_line(console, HOSTILE)
    print_table(console, HOSTILE, [(HOSTILE, "1")])
    said = file.getvalue()
    assert not CONTROL.search(said) and said.count(SHOWN) == 3
    monkeypatch.setattr(sys, "stderr", err)
    with progress(HOSTILE, 1) as advance:
        advance(1)
    assert not CONTROL.search(err.getvalue()) and "[/bold]" in err.getvalue()
    console = terminal.open_console(file=colours, width=80, force_terminal=True, color_system="standard")
    print_line(console, "a\x1b[2Jb", "bold red")
    assert colours.getvalue().startswith("\x1b[1;31ma\\x1b[2Jb\x1b[0m")


def process_in_shell(*arguments: object, prefix: str = "", program: object = None, **environment: str) -> Any:
    command = [program] if program else [sys.executable, "-m", "modsim3d.cli.main"]
    shell = ["sh", "-c", f'{prefix} exec "$@"', "sh", *command, *map(str, arguments)]
    return subprocess.run(shell, capture_output=True, timeout=240, env={**os.environ, **environment}, check=False)


def test_any_encoding_of_the_output_will_do(inputs, call, prepared, tmp_path):
    run = tmp_path / "rün"
    assert call("run", inputs.write(), "--out", run, "--no-sheet")[0] == 0
    for encoding in ("latin-1", "ascii", "cp437"):
        line = ("check", "run", run, "--overwrite")
        done = process_in_shell(*line, program=prepared, PYTHONIOENCODING=encoding)
        assert done.returncode in (0, 1) and b"Traceback" not in done.stderr
        assert b"Performance state" in done.stdout
    assert process_in_shell("scenes", PYTHONIOENCODING="ascii").returncode == 0


def test_lack_of_address_space_of_memory_and_of_libraries_is_one_line(call, monkeypatch):
    for megabytes in (50, 400):
        done = process_in_shell("check", "scene", "simulation_1", prefix=f"ulimit -v {megabytes * 1024};")
        limited = f"modsim3d: the address space is limited to {megabytes} MB (ulimit -v): "
        told = f"{limited}at least 1024 MB are needed to load the libraries\n"
        assert (done.returncode, done.stderr.decode()) == (2, told)
    for error, part in (
        (MemoryError(), "modsim3d: there is not enough memory"),
        (ImportError("libx.so: failed to map segment"), "modsim3d: a library cannot be loaded: libx.so: failed to map"),
    ):

        def fail(*_: object, error: Exception = error, **__: object) -> None:
            raise error

        monkeypatch.setattr("modsim3d.scene.reading.load_scene", fail)
        said = refusal(call, ("check", "scene", "simulation_1"))
        assert said.startswith(part) and said.count("\n") == 1
