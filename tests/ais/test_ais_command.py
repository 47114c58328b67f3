"""`modsim3d ais` as a user types it, and every mistake as one message."""

from __future__ import annotations

import gzip
import math
import subprocess
import sys

import pytest

from tests.ais.ais_builders import SAMPLE_NAMES, SAMPLES, command, old_file, read_json, row

DANISH = SAMPLES / "danish.csv"


def test_scene_folder_is_made_and_said_and_runs_as_typed(monkeypatch, tmp_path, capsys):
    out = tmp_path / "scene"
    arguments = ("ais", DANISH, "--out", out, "--max-gap", 120, "--time-step", 2)
    assert command(monkeypatch, *arguments) == 0
    said = capsys.readouterr().out
    for word in ("254", "messages used", "249", "no_position", "jump", "heading_from_course", "air_draft", "10:00:00Z"):
        assert word in said
    assert f"modsim3d run {out / 'scene.yaml'}" in said
    assert {path.name for path in out.iterdir()} == {
        "scene.yaml",
        "vessels.json",
        "poses.json.gz",
        "detector.yaml",
        "report.json",
    }
    assert read_json(out / "report.json")["vessels"]["245999910"]["steps_present"] < 100
    assert command(monkeypatch, "check", out / "scene.yaml") == 0
    run = ("run", out / "scene.yaml", "--steps", 3, "--no-sheet", "--out", tmp_path / "run")
    assert command(monkeypatch, *run) == 0


def test_folder_with_something_in_it_is_left_alone(monkeypatch, tmp_path, capsys):
    out = tmp_path / "scene"
    assert command(monkeypatch, "ais", DANISH, "--out", out, "--duration", 5) == 0
    before = (out / "poses.json.gz").read_bytes()
    assert command(monkeypatch, "ais", DANISH, "--out", out, "--duration", 9) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert (out / "poses.json.gz").read_bytes() == before
    assert command(monkeypatch, "ais", DANISH, "--out", out, "--duration", 9, "--overwrite") == 0
    assert (out / "poses.json.gz").read_bytes() != before
    other = tmp_path / "other"
    other.mkdir()
    (other / "precious").write_text("x")
    assert command(monkeypatch, "ais", DANISH, "--out", other, "--overwrite") == 2
    assert "left alone" in capsys.readouterr().err
    assert command(monkeypatch, "ais", DANISH, "--out", other / "precious", "--overwrite") == 2
    assert "is no folder" in capsys.readouterr().err


def problem(monkeypatch, tmp_path, capsys, *arguments: object) -> str:
    """The one message of a command that must fail, and leave nothing behind."""
    out = tmp_path / "scene"
    assert command(monkeypatch, "ais", *arguments, "--out", out) == 2
    assert not out.exists()
    said = capsys.readouterr()
    assert said.err.startswith("modsim3d: ")
    assert "Traceback" not in said.err
    return said.err


COORDINATES = {"latitude", "longitude", "lat", "lon"}
TABLES = [name for name in SAMPLE_NAMES if name.endswith(".csv")]


def swap(path, folder, lines=None):
    """A copy of a table with latitude and longitude in each other's columns, in some lines or all."""
    rows = [line.split(",") for line in path.read_text().splitlines()]
    one, other = (place for place, name in enumerate(rows[0]) if name.lower() in COORDINATES)
    for place, cells in enumerate(rows):
        if place and (lines is None or place in lines):
            cells[one], cells[other] = cells[other], cells[one]
    copy = folder / "swapped.csv"
    copy.write_text("\n".join(",".join(cells) for cells in rows) + "\n")
    return copy


def drive(latitude, longitude, reports=8, speed=10.0, **values):
    """Rows of a vessel that goes east, one every ten seconds."""
    way = speed * 1852 / 3600 * 10 / 111_000 / math.cos(math.radians(latitude))
    return [(10 * k, latitude, round(longitude + k * way, 6), {"speed": speed, **values}) for k in range(reports)]


def written(folder, rows, swapped=()):
    """A file of such rows, some of them with latitude and longitude exchanged."""
    turned = [(s, lon, lat, v) if k in swapped else (s, lat, lon, v) for k, (s, lat, lon, v) in enumerate(rows)]
    return old_file(folder, *(row(s, lat, lon, **values) for s, lat, lon, values in turned))


def test_latitude_beyond_the_pole_is_a_swap(monkeypatch, tmp_path, capsys):
    path = old_file(tmp_path, row(0, 35.0, 110.0), row(10, 110.2, 35.0))
    said = problem(monkeypatch, tmp_path, capsys, path)
    assert "latitude and longitude look swapped (row 3: latitude 110.2, longitude 35)" in said
    assert str(path) in said


@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize(("lines", "first"), [(None, 2), ({5}, 6), ({5, 9}, 6), (set(range(1, 300, 2)), 2)])
def test_swapped_rows_of_a_publisher_are_found_by_its_waters(monkeypatch, tmp_path, capsys, name, lines, first):
    path = swap(SAMPLES / name, tmp_path, lines)
    said = problem(monkeypatch, tmp_path, capsys, path)
    assert f"look swapped (row {first}: latitude 12.6" in said
    assert "in the waters that such files cover" in said


@pytest.mark.parametrize(
    ("latitude", "longitude"),
    [(42.3, -70.9), (29.2, -88.5), (46.8, -87.0), (18.4, -66.2), (55.1, 15.0), (57.2, 4.0), (53.9, 13.9)],
)
def test_a_file_from_the_publishers_waters_is_taken_and_refused_when_swapped(
    monkeypatch, tmp_path, capsys, latitude, longitude
):
    rows = drive(latitude, longitude, speed=0.0)
    assert command(monkeypatch, "ais", written(tmp_path, rows), "--out", tmp_path / "right") == 0
    capsys.readouterr()
    path = written(tmp_path, rows, range(8))
    assert "look swapped (row 2" in problem(monkeypatch, tmp_path, capsys, path)


def test_traffic_where_swapped_danish_traffic_would_be_is_taken_with_its_region(monkeypatch, tmp_path, capsys):
    path = written(tmp_path, drive(12.6, 56.0))  # the Arabian Sea
    assert "if it is right, say so with --region" in problem(monkeypatch, tmp_path, capsys, path)
    assert command(monkeypatch, "ais", path, "--out", tmp_path / "there", "--region", "12,55,13,57") == 0


CAPE_TOWN = (-33.9, 18.2)


def test_a_row_that_is_swapped_is_found_by_its_vessels_other_positions(monkeypatch, tmp_path, capsys):
    path = written(tmp_path, drive(*CAPE_TOWN), {4})
    said = problem(monkeypatch, tmp_path, capsys, path)
    assert "swapped (row 6: latitude 18.2" in said
    assert "where this vessel is at other times" in said


def test_a_file_that_is_swapped_is_found_by_the_courses_in_it(monkeypatch, tmp_path, capsys):
    assert command(monkeypatch, "ais", written(tmp_path, drive(*CAPE_TOWN)), "--out", tmp_path / "right") == 0
    capsys.readouterr()
    path = written(tmp_path, drive(*CAPE_TOWN), range(8))
    said = problem(monkeypatch, tmp_path, capsys, path)
    assert "look swapped (row 2: latitude 18.2, longitude -33.9)" in said
    assert "the way their courses say" in said


def test_a_course_off_by_a_right_angle_among_others_that_are_right_refuses_no_file(monkeypatch, tmp_path):
    others = [(s, lat + 0.1, lon, {**v, "mmsi": 219000002}) for s, lat, lon, v in drive(*CAPE_TOWN)]
    path = written(tmp_path, drive(*CAPE_TOWN, course=0) + others)
    assert command(monkeypatch, "ais", path, "--out", tmp_path / "scene") == 0


@pytest.mark.parametrize(
    "changes",
    [
        {"reports": 5},  # four ways
        {"speed": 1.0},
        {"course": 360},
        {"course": ""},
        {"course": 45},  # fits neither
    ],
)
def test_courses_that_say_too_little_refuse_no_file(monkeypatch, tmp_path, changes):
    path = written(tmp_path, drive(*CAPE_TOWN, **changes), range(8))
    assert command(monkeypatch, "ais", path, "--out", tmp_path / "scene") == 0


def test_a_file_that_is_swapped_is_found_by_the_other_files(monkeypatch, tmp_path, capsys):
    still = [row(10 * k, *CAPE_TOWN, speed=0) for k in range(9)]
    turned = [row(10 * k, *CAPE_TOWN[::-1], speed=0, mmsi=219000002) for k in range(8)]
    right, wrong = old_file(tmp_path, *still), old_file(tmp_path, *turned, name="swapped.csv")
    said = problem(monkeypatch, tmp_path, capsys, right, wrong)
    assert "swapped.csv" in said
    assert "where that of the other files is" in said


REGION = ("--region", "55.9,12.5,56.2,12.8")


@pytest.mark.parametrize(("lines", "first"), [(None, 2), (set(range(2, 300, 2)), 3)])
def test_a_file_that_is_swapped_is_found_by_the_region(monkeypatch, tmp_path, capsys, lines, first):
    path = swap(SAMPLES / "marinecadastre.csv", tmp_path, lines)
    said = problem(monkeypatch, tmp_path, capsys, path, *REGION)
    assert f"look swapped (row {first}: latitude 12.6" in said
    assert "in the region 55.9,12.5,56.2,12.8" in said


def test_one_swapped_row_is_left_out_with_what_else_is_outside_the_region(monkeypatch, tmp_path):
    path = swap(SAMPLES / "marinecadastre.csv", tmp_path, {5})
    assert command(monkeypatch, "ais", path, "--out", tmp_path / "scene", *REGION) == 0
    dropped = read_json(tmp_path / "scene" / "report.json")["messages"]["dropped"]
    assert dropped["outside_region"] == 1


def test_a_region_on_the_diagonal_takes_no_neighbour_for_a_swap(monkeypatch, tmp_path):
    rows = drive(10.5, 10.2) + [(s, 10.2, 11.5, {**v, "mmsi": 219000002}) for s, _, _, v in drive(0, 0)]
    path = written(tmp_path, rows)
    assert command(monkeypatch, "ais", path, "--out", tmp_path / "scene", "--region", "10,10,12,11") == 0


def test_an_origin_that_is_swapped_is_told(monkeypatch, tmp_path, capsys):
    said = problem(monkeypatch, tmp_path, capsys, DANISH, "--origin", "12.65,56.03")
    assert "--origin: latitude comes first (got 12.65,56.03, but the middle of the traffic is 56.0" in said


def test_a_region_that_is_swapped_is_told(monkeypatch, tmp_path, capsys):
    said = problem(monkeypatch, tmp_path, capsys, DANISH, "--region", "12.5,55.9,12.8,56.2")
    assert "or are the region's corners swapped?" in said


def test_missing_columns_are_named(monkeypatch, tmp_path, capsys):
    text = DANISH.read_text()
    path = tmp_path / "danish.csv"
    path.write_text(text.replace("Latitude,Longitude", "Breite,Laenge", 1))
    said = problem(monkeypatch, tmp_path, capsys, path)
    assert "Danish Maritime Authority CSV, but has no column Latitude, Longitude (it has: # Timestamp" in said


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "the file is empty"),
        (b"\n \n", "the file is empty"),
        (b"a,b,c\n1,2,3\n", "none of the formats"),
        (b"PK\x03\x04xxxx", "unpack it first (unzip data)"),
        (b"\x28\xb5\x2f\xfdxxxx", "unpack it first (zstd -d data)"),
        (gzip.compress(DANISH.read_bytes())[:3000], "is not a complete gzip file"),
        (DANISH.read_bytes().partition(b"\n")[0] + b"\n", "the files hold no positions at all"),
        (DANISH.read_bytes().partition(b"\n")[0], "the files hold no positions at all"),
        (b"!AIVDM,1,1,,A,15RTgt0PAso;90TKcjM8h6g208CQ,0*4A\n", "has no times"),
        (b"1423133048 !AIVDM,1,1,,A,15RTgt0PAso;90TKcjM8h6g208CQ,0*4B\n", "too much of it cannot be read: 1 of 1"),
    ],
)
def test_a_file_that_is_of_no_use_says_why(monkeypatch, tmp_path, capsys, content, says):
    path = tmp_path / "data"
    path.write_bytes(content)
    assert says in problem(monkeypatch, tmp_path, capsys, path)


def test_every_file_of_no_use_is_named_at_once(monkeypatch, tmp_path, capsys):
    (tmp_path / "empty").write_text("")
    said = problem(monkeypatch, tmp_path, capsys, tmp_path / "none.csv", DANISH, tmp_path / "empty", tmp_path)
    assert "none.csv: no such file" in said
    assert "empty: the file is empty" in said
    assert "this is a folder" in said


def test_too_many_cells_that_are_no_numbers_are_an_error(monkeypatch, tmp_path, capsys):
    rows = [row(second, latitude="56,x" if second % 50 == 0 else 56.0) for second in range(0, 300, 10)]
    said = problem(monkeypatch, tmp_path, capsys, old_file(tmp_path, *(text.replace("56,x", "x56") for text in rows)))
    assert "row 2: LAT is not a number (got 'x56')" in said
    assert "too much of it cannot be read: 6 of 30 messages" in said


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--start", "2024-01-05T10:00:00"), "no positions of ships from 2024-01-05T10:00:00Z to …: the files reach"),
        (("--end", "2024-01-03T10:00:00Z"), "from … to 2024-01-03T10:00:00Z"),
        (("--region", "10,10,11,11"), "in the region 10,10,11,11: the files reach"),
        (("--start", "yesterday"), "--start: a time such as"),
        (("--origin", "56"), "--origin: LAT,LON in degrees is needed (got '56')"),
        (("--origin", "112,56"), "latitude 112 is beyond ±90: latitude comes first"),
        (("--region", "1,2,3"), "--region: LAT1,LON1,LAT2,LON2 in degrees"),
        (("--time-step", 0), "--time-step: must be above 0"),
        (("--max-gap", -1), "--max-gap: must be above 0"),
        (("--time-step", 1e-5), "more than 1,000,000"),
        (("--duration", 5, "--end", "2024-01-05"), "only one of them"),
        (("--label", "ferry=Ferry"), "no group 'ferry'"),
        (("--label", "passenger"), "GROUP=LABEL is needed"),
    ],
)
def test_options_that_cannot_be_met_say_why(monkeypatch, tmp_path, capsys, arguments, says):
    assert says in problem(monkeypatch, tmp_path, capsys, DANISH, *arguments)


def test_negative_degrees_can_be_given(monkeypatch, tmp_path):
    path = old_file(tmp_path, *(row(10 * k, -33.8, -151.2, speed=0) for k in range(4)))
    options = ("--origin", "-33.8,-151.2", "--region", "-33,-151,-34,-152")
    assert command(monkeypatch, "ais", path, "--out", tmp_path / "scene", *options) == 0


@pytest.mark.parametrize("name", SAMPLE_NAMES)
def test_same_files_give_the_same_bytes(monkeypatch, tmp_path, name):
    for out in ("a", "b"):
        assert command(monkeypatch, "ais", SAMPLES / name, "--out", tmp_path / out, "--labels", "type") == 0
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()


def test_readers_are_imported_only_where_they_are_used():
    script = (
        "import sys, modsim3d, modsim3d.cli\n"
        "assert not {'pyais', 'pymap3d', 'modsim3d.ais.conversion'} & set(sys.modules)\n"
        "sys.argv = ['modsim3d', 'ais', '--help']\n"
        "try:\n    modsim3d.cli.main()\n"
        "except SystemExit:\n    pass\n"
        "assert not {'pyais', 'pymap3d', 'pyarrow', 'numpy'} & set(sys.modules) - set(before)\n"
    )
    script = "import sys, modsim3d\nbefore = list(sys.modules)\n" + script
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Example: modsim3d ais" in done.stdout
