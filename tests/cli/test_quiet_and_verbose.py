"""`-q` leaves warnings and errors, `-v` tells more on standard error, and standard output stays the same."""

from pathlib import Path

import pytest

from tests.cli.conftest import WITHOUT_OVERWRITE, Modsim3d
from tests.cli.test_help import LEAVES, OPTIONS

TRIED = ("run", "detect", "check scene", "check run", "check repeat", "check truth", "learn", "export", "report")
TRIED += ("view frame", "track")


def test_every_command_with_something_to_tell_has_both_options() -> None:
    have = {name for name, parameter in OPTIONS if parameter.name in ("quiet", "verbose")}
    assert have == LEAVES.keys() - {"scenes"}
    for name in have:
        opts = [opt for parameter in LEAVES[name].params for opt in parameter.opts]
        assert {"-q", "--quiet", "-v", "--verbose"} <= set(opts)


@pytest.mark.parametrize("command", TRIED)
def test_verbose_tells_versions_files_and_times_and_quiet_prints_nothing_and_does_the_same(modsim3d, lines, command):
    line = (*lines[command], *(() if command in WITHOUT_OVERWRITE else ("--overwrite",)))
    verbose = modsim3d(*line, "--verbose")
    first, *rest = verbose.err.splitlines()
    assert first.startswith("versions  modsim3d ")
    read = [line.removeprefix("read      ") for line in rest if line.startswith("read ")]
    assert read and all(Path(path).exists() for path in read)
    assert any(line.startswith("time ") for line in rest)
    assert not any(line.startswith(("versions ", "read ", "time  ")) for line in verbose.out.splitlines())
    said = modsim3d(*line)
    assert said.out
    assert "versions  modsim3d" not in said.err, "an earlier command's -v"
    warnings = [line for line in said.err.splitlines() if line.startswith("warning: ")]
    quiet = modsim3d(*line, "-q")
    assert (quiet.status, quiet.out, quiet.err.splitlines()) == (said.status, "", warnings)


@pytest.mark.parametrize("command", ["run", "check truth"])
def test_verbose_names_the_opengl_that_draws(modsim3d, lines, command):
    arguments = [argument for argument in lines[command] if argument not in ("--source", "analytic")]
    assert "\nOpenGL    " in modsim3d(*arguments, "-v").err


def test_both_are_refused_and_errors_not_silenced(modsim3d: Modsim3d, run: Path) -> None:
    for flags in (("-q", "-v"), ("-v", "-q"), ("-qv",)):
        said = modsim3d("check", "run", run, *flags)
        assert said.status == 2
        assert said.err.endswith("modsim3d: --quiet and --verbose contradict each other: leave one out\n")
    said = modsim3d("check", "scene", "nowhere.yaml", "-q")
    assert (said.status, said.out) == (2, "") and "no such file" in said.err
