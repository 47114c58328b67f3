"""`modsim3d track`: what it prints, and what it refuses."""

from pathlib import Path

from modsim3d.tracking.trackers.names import BUILT_IN
from tests.cli.conftest import Modsim3d


def test_it_says_the_tracker_its_settings_the_counts_and_what_comes_next(modsim3d, run, tmp_path):
    out = tmp_path / "my tracks"
    said = modsim3d("track", run, "--set", "confirm_hits=1", "--out", out)
    assert said.status == 0
    lines = said.out.splitlines()
    assert lines[0].startswith("reference (confirm_hits=1): modsim3d ") and "confirm_hits" in lines[0].split(";")[1]
    header, row = lines[lines.index("tracks") + 1 :][:2]
    assert header.split() == ["camera", "frames", "detections", "tracks", "boxes", "median", "track"]
    assert row.split()[:2] == ["C0", "40"]
    assert f"  {out / 'tracks.parquet'}" in lines and f"  {out / 'tracks.json'}" in lines
    assert lines[-1] == f"  modsim3d score {run} '{out}'"


def test_wrong_options_are_one_message_and_leave_nothing(modsim3d, run, tmp_path):
    for options, part in (
        (("--tracker", "nosuch"), f"known: {', '.join(BUILT_IN)}"),
        (("--tracker", "refrence"), "did you mean 'reference'?"),
        (("--set", "confirm_hit=2"), "confirm_hit: unknown key (did you mean 'confirm_hits'?)"),
        (("--set", "confirm_hits=many"), "confirm_hits: "),
        (("--set", "confirm_hits"), "--set confirm_hits:\n  a key and a value are needed, as in lost_s=2.5"),
        (("--set", "confirm_hits=[1"), "--set confirm_hits:"),
    ):
        said = modsim3d("track", run, *options, "--out", tmp_path / "out")
        assert (said.status, said.out) == (2, "")
        assert part in said.err and "Traceback" not in said.err
        assert not (tmp_path / "out").exists()


def test_tracks_of_nothing_have_no_median_time(modsim3d: Modsim3d, run: Path, tmp_path: Path) -> None:
    said = modsim3d("track", run, "--set", "start_confidence=1.0", "--set", "confirm_hits=100", "--out", tmp_path / "t")
    assert said.status == 0
    row = next(line for line in said.out.splitlines() if line.startswith("C0 "))
    assert row.split()[3:] == ["0", "0", "-"]
