"""Each format is recognised by its content and read as published."""

import gzip
import random
import subprocess
import sys
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
import pytest

from modsim3d.core.errors import InputError
from modsim3d.scene.ais.read_csv import MOTION, NEEDED, PARTICULARS, layouts, read_csv, recognise
from modsim3d.scene.ais.read_nmea import read_nmea
from tests.scene.ais.ais_builders import FORMATS, SAMPLES, TABLES, old_file, row, traffic_of

# "AIVDM/AIVDO protocol decoding" (E. S. Raymond, gpsd) and gpsd's test/sample.aivdm, where the decoded values stand
# beside the sentences, checked there with two other decoders.
TYPE_1 = "!AIVDM,1,1,,A,15RTgt0PAso;90TKcjM8h6g208CQ,0*4A"
TYPE_5 = (
    "!AIVDM,2,1,1,A,55?MbV02;H;s<HtKR20EHE:0@T4@Dn2222222216L961O5Gf0NSQEp6ClRp8,0*1C",
    "!AIVDM,2,2,1,A,88888888880,2*25",
)


def log(folder: Path, *lines: str) -> Path:
    path = folder / "log.txt"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def tagged(content: str, sentence: str, checksum: int | None = None) -> str:
    return f"\\{content}*{reduce(xor, content.encode()) if checksum is None else checksum:02X}\\{sentence}"


def test_published_position_report_and_message_in_two_parts_are_decoded(tmp_path):
    lines = tagged("c:1423133048", TYPE_1), f"1423133049 {TYPE_5[0]}", TYPE_5[1]
    (chunk,) = read_nmea(log(tmp_path, *lines))
    assert (chunk.messages, dict(chunk.dropped)) == (2, {})
    said = chunk.positions
    assert (said.mmsi.tolist(), said.time_s.tolist()) == ([371798000], [1423133048])
    np.testing.assert_allclose((said.latitude_deg[0], said.longitude_deg[0]), (48.381633333, -123.395383333), atol=1e-6)
    assert (said.speed_kn[0], said.course_deg[0], said.heading_deg[0]) == (12.3, 224.0, 215.0)
    said = chunk.particulars
    assert (said.mmsi[0], said.name[0], said.ship_type[0]) == (351759000, "EVER DIADEM", "70")
    assert (said.to_bow_m[0], said.to_stern_m[0], said.to_port_m[0], said.to_starboard_m[0]) == (225, 70, 1, 31)


def test_time_is_found_wherever_logs_have_it_and_a_log_without_any_says_what_is_needed(tmp_path):
    lines = [tagged("s:station,c:1423133048", TYPE_1), f"{TYPE_1},1423133048"]
    lines += [f"1423133048{end}{TYPE_1}" for end in (" ", ",", ".0\t", "000 ")]
    (chunk,) = read_nmea(log(tmp_path, *lines, f"{TYPE_1},s30327,d-120,T10.2,r003669945,1423133048"))
    assert chunk.positions.time_s.tolist() == [1423133048] * 7
    with pytest.raises(InputError, match=r"no times.*tag block.*Unix time"):
        list(read_nmea(log(tmp_path, TYPE_1, *TYPE_5)))


def test_broken_sentences_are_counted_and_named(tmp_path):
    lines = (
        f"1423133048 {TYPE_1}",
        f"1423133049 {TYPE_1[:-1]}B",  # checksum of the sentence
        tagged("c:1423133050", TYPE_1, checksum=0),  # of the tag block
        TYPE_1,  # no time
        f"1423133051 {TYPE_5[1]}",  # the other part is missing
        "# a comment",
        "$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47",
    )
    (chunk,) = read_nmea(log(tmp_path, *lines))
    assert (len(chunk.positions), chunk.messages) == (1, 5)
    assert dict(chunk.dropped) == {"checksum": 2, "no_time": 1, "incomplete": 1}
    assert "line 2: does not match its checksum" in chunk.problems


@pytest.mark.parametrize(("name", "expected"), FORMATS.items())
def test_format_is_recognised_by_content(tmp_path, name, expected):
    path = tmp_path / "data"
    for content in ((SAMPLES / name).read_bytes(), gzip.compress((SAMPLES / name).read_bytes())):
        path.write_bytes(content)
        layout = recognise(path)
        assert (layout and layout.name) == expected


def test_every_layout_has_a_sample_and_names_only_columns_that_are_read():
    assert {layout.name for layout in layouts()} == set(FORMATS.values()) - {None}
    for layout in layouts():
        assert set(NEEDED) <= set(layout.columns) <= {*NEEDED, *MOTION, *PARTICULARS, "station"}
        assert ("station" in layout.columns) == bool(layout.ships)


@pytest.mark.parametrize("name", TABLES)
def test_columns_are_found_by_name_in_any_order_and_case(tmp_path, name):
    lines = [line.split(",") for line in (SAMPLES / name).read_text().splitlines()]
    order = random.Random(3).sample(range(len(lines[0])), len(lines[0]))
    lines[0] = [cell.upper() if name != "marinecadastre.csv" else cell for cell in lines[0]]
    path = tmp_path / "shuffled.csv"
    path.write_text("\n".join(",".join(line[place] for place in order) for line in lines) + "\n")
    assert recognise(path) is recognise(SAMPLES / name)
    (found,), (expected,) = (read_csv(each, recognise(path)) for each in (path, SAMPLES / name))
    for column in ("mmsi", "time_s", "latitude_deg", "longitude_deg", "speed_kn", "course_deg", "heading_deg"):
        np.testing.assert_array_equal(getattr(found.positions, column), getattr(expected.positions, column))


def test_a_ships_name_in_another_encoding_with_a_comma_or_of_two_lines_is_read_and_nan_is_as_good_as_empty(tmp_path):
    path = tmp_path / "names.csv"
    text = (SAMPLES / "danish.csv").read_bytes()
    path.write_bytes(text.replace(b"OSTFAERGEN", b"\xd8STF\xc6RGEN").replace(b"KUTTER", b'"KUTTER, ""X"""'))
    names = {vessel.mmsi: vessel.hull.name for vessel in traffic_of(path).vessels}
    assert (names[219999906], names[219999901]) == ('KUTTER, "X"', "�STF�RGEN")
    path = old_file(tmp_path, row(0).replace(",X,", ',"X\nY",'), row(10, speed="nan"))
    (chunk,) = read_csv(path, recognise(path))
    assert (len(chunk.positions), sorted(chunk.particulars.name)) == (2, ["X", "X\nY"])
    assert np.isnan(chunk.positions.speed_kn).tolist() == [False, True]


CELLS: dict[str, tuple[list[str], list[int], list[str]]] = {
    "good rows": ([row(second) for second in range(0, 400, 10)], list(range(2, 42)), []),
    "a decimal comma": ([row(0), row(10).replace("56.0,", '"56,0",')], [2, 3], []),
    "blank lines": (
        [row(0), "", "", row(10), "too,few", "", row(20), row(30, speed="fast")],
        [2, 5, 8],
        ["row 6: does not have the 17 cells of the header", "row 9: SOG is not a number (got 'fast')"],
    ),
    "infinite numbers": (
        [row(0), row(10, latitude="inf"), row(20, speed="-Infinity"), row(30, speed="nan")],
        [2, 5],
        ["row 3: LAT is not a number (got 'inf')", "row 4: SOG is not a number (got '-Infinity')"],
    ),
    "other texts": (
        [row(0, latitude="north"), row(10).replace("2024-01-04T", "04.01.2024 "), row(20, mmsi="21900000A"),
         row(30) + ",one too many", row(40)],
        [6],
        ["row 2: LAT is not a number (got 'north')", "row 3: BaseDateTime is not a time like 2024-12-31 23:59:59",
         "row 4: MMSI is not a number (got '21900000A')", "row 5: does not have the 17 cells of the header"],
    ),
}  # fmt: skip
"""Rows of a table, the rows that have a position, and what is said of the others."""


@pytest.mark.parametrize("size", [60, 500, 1 << 24])
@pytest.mark.parametrize("case", CELLS)
def test_cells_are_read_or_named_by_row_and_column_in_blocks_of_any_size(monkeypatch, tmp_path, case, size):
    rows, read, problems = CELLS[case]
    path = old_file(tmp_path, *rows)
    monkeypatch.setattr("modsim3d.scene.ais.read_csv.BLOCK_BYTES", size)
    chunks = list(read_csv(path, recognise(path)))
    assert (len(chunks) > 1) == (size < 500 or (len(rows) > 9 and size < 1000))
    assert [number for chunk in chunks for number in chunk.positions.row.tolist()] == read
    assert {float(latitude) for chunk in chunks for latitude in chunk.positions.latitude_deg} == {56.0}
    said = [problem for chunk in chunks for problem in chunk.problems]
    for problem, beginning in zip(sorted(said), problems, strict=True):
        assert problem.startswith(beginning)
    assert sum(chunk.dropped.get("unreadable", 0) for chunk in chunks) == len(problems)
    assert sum(chunk.messages for chunk in chunks) == len(read) + len(problems)


@pytest.mark.parametrize(
    ("content", "level", "says"),
    [
        (b"a" * 3_000_000, 1, "is none of the formats"),
        ((SAMPLES / "danish.csv").read_bytes() + b"a" * 40_000_000, 0, "has a row of more than 1048576 bytes"),
        ((SAMPLES / "danish.csv").read_bytes() + b"a" * 40_000_000, 1, "unpacks to more than 100 times its own size"),
    ],
    ids=["no line", "endless row", "bomb"],
)
def test_what_unpacks_to_endless_lines_is_one_error(call, tmp_path, content, level, says):
    (tmp_path / "bomb.csv.gz").write_bytes(gzip.compress(content, level))
    status, said = call("ais", tmp_path / "bomb.csv.gz", "--out", tmp_path / "scene")
    assert status == 2 and says in said and len(said.splitlines()) == 2


def test_a_log_is_counted_the_same_in_chunks_of_any_size(monkeypatch, tmp_path):
    path = log(tmp_path, *(tagged(f"c:{1423133048 + k}", TYPE_1, 0 if k % 3 else None) for k in range(12)))
    (whole,) = read_nmea(path)
    monkeypatch.setattr("modsim3d.scene.ais.read_nmea.CHUNK_MESSAGES", 2)
    chunks = list(read_nmea(path))
    assert len(chunks) > 2 and sum(chunk.messages for chunk in chunks) == whole.messages == 12
    assert sum(chunk.dropped.get("checksum", 0) for chunk in chunks) == whole.dropped["checksum"] == 8


def test_garbage_between_sentences_is_passed_over_quickly(tmp_path):
    sentences = [tagged(f"c:{1423133048 + k}", TYPE_1) for k in range(3)]
    path = log(tmp_path, sentences[0], "x" * 300_000, sentences[1], "VD" * 150_000, sentences[2], "y" * 3_000_000)
    (chunk,) = read_nmea(path)
    assert chunk.positions.row.tolist() == [1, 3, 5]


def test_samples_are_what_their_script_writes(tmp_path):
    subprocess.run([sys.executable, SAMPLES.parents[2] / "script" / "make_ais_samples", tmp_path], check=True)
    for written in sorted(tmp_path.iterdir()):
        assert written.read_bytes() == (SAMPLES / written.name).read_bytes(), written.name
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in SAMPLES.iterdir()}
