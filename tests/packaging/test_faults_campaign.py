"""The campaign of faults: its model of a disk that loses power, its reading of strace, and its stored result."""

import random
from itertools import product
from pathlib import Path

import pytest

from benchmarks.faults.disk import Disk, Lost
from benchmarks.faults.results import read_rows, table
from benchmarks.faults.tracing import parse
from benchmarks.faults.trees import differences, tree

REPOSITORY = Path(__file__).resolve().parents[2]


def escaped(text: object) -> str:
    return "".join(f"\\x{byte:02x}" for byte in str(text).encode())


def trace(folder: Path, *, fsync_file: bool, fsync_folder: bool) -> str:
    """A file is written beside its place, and renamed."""
    root, partial, final = (escaped(path) for path in ("/", folder / "partial", folder / "final"))
    fd, folder_fd = f"3<{partial}>", f"4<{escaped(folder)}>"
    lines = [
        f'7 openat(AT_FDCWD<{root}>, "{partial}", O_WRONLY|O_CREAT|O_TRUNC, 0666) = {fd}',
        f'7 write({fd}, "{escaped("whole")}", 5) = 5',
        f"7 fsync({fd}) = 0" if fsync_file else "",
        f"7 close({fd}) = 0",
        f'7 rename("{partial}", "{final}" <unfinished ...>',
        "8 close(9) = 0",
        "7 <... rename resumed>) = 0",
        f'7 openat(AT_FDCWD<{root}>, "{escaped(folder)}", O_RDONLY|O_DIRECTORY) = {folder_fd}',
        f"7 fsync({folder_fd}) = 0" if fsync_folder else "",
    ]
    return "\n".join(filter(None, lines))


@pytest.mark.parametrize("fsync_file", [False, True])
@pytest.mark.parametrize("fsync_folder", [False, True])
def test_after_a_power_cut_only_what_was_fsynced_is_sure_to_be_there(tmp_path, fsync_file, fsync_folder):
    folder = tmp_path / "disk"
    folder.mkdir()
    (folder / "final").write_bytes(b"old")
    left, disk = set(), Disk(folder)
    for call in parse(trace(folder, fsync_file=fsync_file, fsync_folder=fsync_folder)):
        disk.replay(call)
    for seed, lost in product(range(40), Lost):
        target = tmp_path / f"{seed} {lost.name}"
        disk.crash(random.Random(seed), lost, target)
        left.add((target / "final").read_bytes())
    assert b"whole" in left and (b"old" in left) == (not fsync_folder)
    assert (b"" in left and bytes(5) in left) == (not fsync_file)
    assert left <= {b"whole", b"old"} or not fsync_file


def test_missing_surplus_and_different_files_are_named(tmp_path):
    for name in ("one", "two"):
        (tmp_path / name / "inner").mkdir(parents=True)
        (tmp_path / name / "inner" / "other").write_text(name)
        (tmp_path / name / name).write_text("same")
        (tmp_path / name / "run.log").write_text(name)
    found = differences(tree(tmp_path / "one"), tree(tmp_path / "two"))
    assert found == "two is missing, one should not be there, inner/other differs"


def test_page_has_the_table_of_the_stored_result_and_no_fault_did_harm():
    rows = read_rows(REPOSITORY / "docs" / "campaigns" / "faults.json")
    assert sum(row["tried"] for of_class in rows.values() for row in of_class) > 1000
    assert not [failure for of_class in rows.values() for row in of_class for failure in row["failures"]]
    assert table(rows) in (REPOSITORY / "docs" / "reliability.md").read_text("utf-8")
