"""Each format is recognised by its content and read as published; times beside sentences only where they can be."""

import gzip
import json
import random
import re
import subprocess
import sys
from datetime import UTC, datetime
from functools import reduce
from itertools import product
from operator import xor
from pathlib import Path

import numpy as np
import pytest
from pytest import CaptureFixture, MonkeyPatch

from modsim3d.core.errors import InputError
from modsim3d.scene.ais.read_csv import MOTION, NEEDED, PARTICULARS, layouts, read_csv, recognise
from modsim3d.scene.ais.read_nmea import read_nmea, time_beside
from tests.command_line import call as command
from tests.scene.ais.ais_builders import FORMATS, SAMPLES, TABLES, old_file, read_json, row, traffic_of

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


@pytest.mark.parametrize(("name", "expected"), FORMATS.items())
def test_format_is_recognised_by_content(tmp_path, name, expected):
    path = tmp_path / "data"
    for content in ((SAMPLES / name).read_bytes(), gzip.compress((SAMPLES / name).read_bytes())):
        path.write_bytes(content)
        layout = recognise(path)
        assert (layout and layout.name) == expected


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


def test_published_messages_are_decoded_with_their_times_and_names_in_another_encoding(tmp_path):
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
    lines = [tagged("s:station,c:1423133048", TYPE_1), f"{TYPE_1},1423133048"]
    lines += [f"1423133048{end}{TYPE_1}" for end in (" ", ",", ".0\t", "000 ")]
    (chunk,) = read_nmea(log(tmp_path, *lines, f"{TYPE_1},s30327,d-120,T10.2,r003669945,1423133048"))
    assert chunk.positions.time_s.tolist() == [1423133048] * 7
    with pytest.raises(InputError, match=r"no times.*tag block.*Unix time"):
        list(read_nmea(log(tmp_path, TYPE_1, *TYPE_5)))
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


def test_what_unpacks_to_endless_lines_is_one_error(call, tmp_path):
    content = (SAMPLES / "danish.csv").read_bytes() + b"a" * 40_000_000
    for level, says in enumerate(("has a row of more than 1048576 bytes", "unpacks to more than 100 times its own")):
        (tmp_path / "bomb.csv.gz").write_bytes(gzip.compress(content, level))
        status, said = call("ais", tmp_path / "bomb.csv.gz", "--out", tmp_path / "scene")
        assert status == 2 and says in said and len(said.splitlines()) == 2


def test_a_log_is_counted_the_same_in_chunks_of_any_size_and_garbage_is_passed_over_quickly(monkeypatch, tmp_path):
    path = log(tmp_path, *(tagged(f"c:{1423133048 + k}", TYPE_1, 0 if k % 3 else None) for k in range(12)))
    (whole,) = read_nmea(path)
    monkeypatch.setattr("modsim3d.scene.ais.read_nmea.CHUNK_MESSAGES", 2)
    chunks = list(read_nmea(path))
    assert len(chunks) > 2 and sum(chunk.messages for chunk in chunks) == whole.messages == 12
    assert sum(chunk.dropped.get("checksum", 0) for chunk in chunks) == whole.dropped["checksum"] == 8
    monkeypatch.undo()
    sentences = [tagged(f"c:{1423133048 + k}", TYPE_1) for k in range(3)]
    path = log(tmp_path, sentences[0], "x" * 300_000, sentences[1], "VD" * 150_000, sentences[2], "y" * 3_000_000)
    (chunk,) = read_nmea(path)
    assert chunk.positions.row.tolist() == [1, 3, 5]


def test_samples_are_what_their_script_writes_with_one_of_every_layout(tmp_path):
    subprocess.run([sys.executable, SAMPLES.parents[2] / "script" / "make_ais_samples", tmp_path], check=True)
    for written in sorted(tmp_path.iterdir()):
        assert written.read_bytes() == (SAMPLES / written.name).read_bytes(), written.name
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in SAMPLES.iterdir()}
    assert {layout.name for layout in layouts()} == set(FORMATS.values()) - {None}
    for layout in layouts():
        assert set(NEEDED) <= set(layout.columns) <= {*NEEDED, *MOTION, *PARTICULARS, "station"}
        assert ("station" in layout.columns) == bool(layout.ships)


MOMENT_S = datetime(2024, 2, 5, 10, 44, 8, tzinfo=UTC).timestamp()
OWN_MMSI = "371798000"
TIMES = {
    f"{MOMENT_S:.0f}": 0.0,
    f"{MOMENT_S:.0f}.576705": 0.576705,
    f"{MOMENT_S:.0f}250": 0.25,
    f"{MOMENT_S:.0f}250125": 0.250125,
    "2024-02-05T10:44:08Z": 0.0,
    "2024-02-05 10:44:08.053": 0.053,
    "2024-02-05T12:44:08+02:00": 0.0,
    "2024-02-05T11:44:08+01": 0.0,
    "2024-02-05 05:44:08.25-05": 0.25,
    "2024/02/05 10:44:08": 0.0,
    "2024-02-05 10:44:08 GMT": 0.0,
    "2024-02-05 10:44:08 AIS": 0.0,
    "20240205T104408Z": 0.0,
    "05-02-2024 10:44:08.748": 0.748,
    "05.02.2024 10:44:08": 0.0,
    "( MSG: 1, MMSI: 371798000, signalpower: -36.9, timestamp: 20240205104408)": 0.0,
}
"""What receivers and programs write, and the seconds after the moment that it stands for."""
NO_TIMES = f"{OWN_MMSI} 002191000 636000333 219000111 2602051044 9999999999 1000000123 1423133 r003669945".split()
NO_TIMES.append("0371798000")
"""The ship's own identity, stations, other ships, yymmddHHMM, a time to come, a counter, shorter numbers."""


@pytest.mark.parametrize(("before", "text"), [*product((True, False), TIMES)])
def test_times_as_receivers_write_them_are_read(tmp_path: Path, before: bool, text: str) -> None:
    line = f"{text},{OWN_MMSI},{TYPE_1}" if before else f"{TYPE_1},{OWN_MMSI},{text}"
    (chunk,) = read_nmea(log(tmp_path, line))
    assert chunk.positions.time_s.tolist() == pytest.approx([MOMENT_S + TIMES[text]], abs=1e-6)


@pytest.mark.parametrize("text", NO_TIMES)
def test_other_numbers_are_no_times_and_are_quoted(tmp_path: Path, text: str) -> None:
    assert time_beside(None, text, "") is None and time_beside(None, "", f",{text}") is None
    with pytest.raises(InputError, match=f"has no times.*beside the first stands '{text}"):
        list(read_nmea(log(tmp_path, f"{text},{TYPE_1}")))
    (chunk,) = read_nmea(log(tmp_path, f"{text},{MOMENT_S:.0f},{TYPE_1}", f"{MOMENT_S:.0f} {TYPE_1},{text}"))
    assert chunk.positions.time_s.tolist() == [MOMENT_S] * 2


LOCAL = ("PM", "p.m.", "CET", "MSK", "EST5EDT", "[Europe/Oslo]", "(CET)", "Europe/Oslo", "local")
LOCAL += ("+1:00", "+01", "-5", "UTC+1", "GMT+01:00:00")
"""What may be a zone or half of the day, or may not."""


@pytest.mark.parametrize(
    "text",
    ["02/05/2024 10:44:08", "2024-02-05 10:44:61", *(f"2024-02-05 10:44:08 {zone}" for zone in LOCAL)]
    + [f"2024-02-05T10:44:08{zone}" for zone in LOCAL if zone != "+01"],
)
def test_dates_that_can_be_several_times_are_quoted(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=f"has no times.*stands '{re.escape(text)},'"):
        list(read_nmea(log(tmp_path, f"{text},{TYPE_1}")))


def test_a_tag_block_before_1990_and_wrong_unix_times_give_way_and_json_has_all_parts_of_a_message(tmp_path):
    for name, value in (("toa", MOMENT_S + 0.5), ("rxuxtime", MOMENT_S + 0.5), ("rxtime", "20240205104408")):
        head = {"class": "AIS", "device": "AIS-catcher", "mmsi": int(OWN_MMSI), name: value}
        lines = [json.dumps({**head, "nmea": list(nmea)}) for nmea in ((TYPE_1,), TYPE_5)]
        (chunk,) = read_nmea(log(tmp_path, *lines))
        expected = MOMENT_S + (0.0 if name == "rxtime" else 0.5)
        assert chunk.positions.time_s.tolist() == [expected] == chunk.particulars.time_s.tolist()
        assert (chunk.messages, dict(chunk.dropped)) == (2, {})
    vdr = f'2024-02-05T10:44:08.053Z,AIS,"UDP port:6039","{TYPE_1}"'
    (chunk,) = read_nmea(log(tmp_path, "# VDR Log File", "timestamp,type,id,message", vdr))
    assert chunk.positions.time_s.tolist() == pytest.approx([MOMENT_S + 0.053])
    tag = tagged("s:r1,c:315964800", TYPE_1)
    (chunk,) = read_nmea(log(tmp_path, f"2024-02-05T10:44:08Z {tag}", f"{tag},{MOMENT_S:.0f}"))
    assert chunk.positions.time_s.tolist() == [MOMENT_S] * 2
    with pytest.raises(InputError, match=r"has no times.*beside the first stands 's:r1,c:315964800'"):
        list(read_nmea(log(tmp_path, tag)))
    for name, order in product(("timestamp", "rxtime", "time", "Timestamp"), (1, -1)):
        around = {"eta": "2024-03-01 10:00:00", "seen": "01.03.2024 10:00:00", name: "2024-02-05T10:44:08Z"}
        (chunk,) = read_nmea(log(tmp_path, json.dumps({**dict([*around.items()][::order]), "nmea": [TYPE_1]})))
        assert chunk.positions.time_s.tolist() == [MOMENT_S], (name, order)
    for before, after in (("1234567890,1767265200", ""), ("1234567890", "1767265200"), ("", "1767265200,1234567890")):
        assert time_beside(None, before, after) is None
        assert time_beside(None, f"{before} toa: 1767265201", after) == 1767265201
    assert time_beside(None, "1767265200,1767265203", "") == 1767265200
    assert time_beside(None, "", "1767265200,1767265203") == 1767265203
    for text, part_s in (("", 0.0), (".576705", 0.576705), ("250", 0.25), ("576705", 0.576705)):
        (chunk,) = read_nmea(log(tmp_path, tagged(f"s:x,c:{MOMENT_S:.0f}{text}", TYPE_1)))
        assert chunk.positions.time_s.tolist() == pytest.approx([MOMENT_S + part_s], abs=1e-6), text
    (chunk,) = read_nmea(log(tmp_path, tagged("c:1423133048", TYPE_1), f"\\c:1423133048\\{TYPE_1}"))
    assert chunk.problems == ("line 2: does not match its checksum: its tag block has none",)
    lines = [f"15010111{minute:02d} {TYPE_1}" for minute in range(60)] + [f"1501011200 {TYPE_1}"]
    with pytest.raises(InputError, match=r"yymmddHHMM, must be Unix times.*\(got 1501011100 to 1501011200\)"):
        list(read_nmea(log(tmp_path, *lines)))
    for mmsi in ("2.19E+08", "2.19e8", "2.1900E+08"):
        with pytest.raises(InputError, match=rf"row 3: MMSI .*has lost digits.*\(got '{mmsi.replace('+', '.')}'\)"):
            traffic_of(old_file(tmp_path, row(0), row(30, mmsi=mmsi)))
    rows = [row(second, mmsi=mmsi) for second, mmsi in ((0, "219000001.0"), (30, "2.19000001E+08"))]
    assert [vessel.mmsi for vessel in traffic_of(old_file(tmp_path, *rows)).vessels] == [219000001]


@pytest.mark.parametrize(("speeds_kn", "warned"), [((1, 2), False), ((1, 2, 3, 4), True), ((10, 10, 10), False)])
def test_a_warning_comes_first_where_most_positions_are_lost_but_not_of_one_log_of_three_receivers(
    tmp_path: Path, monkeypatch: MonkeyPatch, capsys: CaptureFixture[str], speeds_kn: tuple[int, ...], warned: bool
) -> None:
    path = old_file(tmp_path, *[row(second, speed=speed) for second in (0, 30) for speed in speeds_kn])
    assert command(monkeypatch, "ais", path, "--out", tmp_path / "scene") == 0
    lost = 2 * (len(speeds_kn) - 1)
    said = f"{lost} of {lost + 2} messages were lost (duplicate {lost})"
    printed = capsys.readouterr().err
    assert printed.startswith(f"warning: {said}") == ("warning" in printed) == warned
    report = read_json(tmp_path / "scene" / "report.json")
    assert (report["warning"] or "").startswith(said) == (report["warning"] is not None) == warned
    assert report["messages"]["dropped"] == {"duplicate": lost}
    assert (said in (tmp_path / "scene" / "ais.html").read_text(encoding="utf-8")) == warned


@pytest.mark.parametrize("length", [3000, 2_500_000])
def test_lines_that_are_too_long_are_counted(tmp_path: Path, length: int) -> None:
    for begin in (f"{MOMENT_S:.0f} {TYPE_1}", ""):
        for end in ("", f",{TYPE_1}") if begin else (f",{TYPE_1}",):
            long = begin + "x" * length + end
            (chunk,) = read_nmea(log(tmp_path, f"{MOMENT_S:.0f} {TYPE_1}", long, f"{MOMENT_S:.0f} {TYPE_1}", long))
            assert (len(chunk.positions), dict(chunk.dropped)) == (2, {"too_long": 2 * long.count("AIVDM")})
            assert chunk.problems[0] == "line 2: has sentences, and more than 2048 bytes"
    (chunk,) = read_nmea(log(tmp_path, f"{MOMENT_S:.0f} {TYPE_1}", "x" * length + "VDM", "comment VDO"))
    assert not chunk.dropped


@pytest.mark.parametrize(("change", "says"), [
    (lambda text: text.encode("utf-16"), "is UTF-16 text, must be UTF-8"),
    (lambda text: b"sep=,\n" + text.encode(), "none of the formats.*line 1 is for spreadsheets alone, leave it"),
    (lambda text: text.replace(",", ";").encode(), "none of the formats.*cells have semicolons"),
    (lambda text: text.replace("\n", "\r").encode(), "lines end with carriage returns alone"),
])  # fmt: skip
def test_what_is_wrong_with_the_text_of_a_table_is_said(tmp_path: Path, change, says: str) -> None:
    path = old_file(tmp_path, row(0), row(30))
    assert len(traffic_of(path).vessels) == 1
    text = path.read_text()
    path.write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert len(traffic_of(path).vessels) == 1
    path.write_bytes(change(text))
    with pytest.raises(InputError, match=says):
        traffic_of(path)
    if says.startswith("is UTF-16"):
        path.write_bytes(change(tagged("c:1423133048", TYPE_1)))
        with pytest.raises(InputError, match=says):
            traffic_of(path)
