"""What stands beside an AIS sentence is a time only where it can be one."""

import json
import re
from datetime import UTC, datetime
from itertools import product
from pathlib import Path

import pytest
from pytest import CaptureFixture, MonkeyPatch

from modsim3d.core.errors import InputError
from modsim3d.scene.ais.read_nmea import read_nmea, time_beside
from tests.command_line import call as command
from tests.scene.ais.ais_builders import old_file, read_json, row, traffic_of
from tests.scene.ais.test_ais_readers import TYPE_1, TYPE_5, log, tagged

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


def test_a_tag_block_before_1990_gives_way_to_a_time_beside_it_and_is_quoted(tmp_path: Path) -> None:
    tag = tagged("s:r1,c:315964800", TYPE_1)
    (chunk,) = read_nmea(log(tmp_path, f"2024-02-05T10:44:08Z {tag}", f"{tag},{MOMENT_S:.0f}"))
    assert chunk.positions.time_s.tolist() == [MOMENT_S] * 2
    with pytest.raises(InputError, match=r"has no times.*beside the first stands 's:r1,c:315964800'"):
        list(read_nmea(log(tmp_path, tag)))


def test_unix_times_that_are_days_apart_are_none() -> None:
    for before, after in (("1234567890,1767265200", ""), ("1234567890", "1767265200"), ("", "1767265200,1234567890")):
        assert time_beside(None, before, after) is None
        assert time_beside(None, f"{before} toa: 1767265201", after) == 1767265201
    assert time_beside(None, "1767265200,1767265203", "") == 1767265200
    assert time_beside(None, "", "1767265200,1767265203") == 1767265203


def test_a_date_with_the_name_of_a_time_comes_before_others(tmp_path: Path) -> None:
    for name, order in product(("timestamp", "rxtime", "time", "Timestamp"), (1, -1)):
        around = {"eta": "2024-03-01 10:00:00", "seen": "01.03.2024 10:00:00", name: "2024-02-05T10:44:08Z"}
        (chunk,) = read_nmea(log(tmp_path, json.dumps({**dict([*around.items()][::order]), "nmea": [TYPE_1]})))
        assert chunk.positions.time_s.tolist() == [MOMENT_S], (name, order)


def test_tag_blocks_have_fractions_and_microseconds_and_one_without_a_checksum_is_named(tmp_path: Path) -> None:
    for text, part_s in (("", 0.0), (".576705", 0.576705), ("250", 0.25), ("576705", 0.576705)):
        (chunk,) = read_nmea(log(tmp_path, tagged(f"s:x,c:{MOMENT_S:.0f}{text}", TYPE_1)))
        assert chunk.positions.time_s.tolist() == pytest.approx([MOMENT_S + part_s], abs=1e-6), text
    (chunk,) = read_nmea(log(tmp_path, tagged("c:1423133048", TYPE_1), f"\\c:1423133048\\{TYPE_1}"))
    assert chunk.problems == ("line 2: does not match its checksum: its tag block has none",)


def test_dates_with_minutes_that_could_be_unix_times_are_refused(tmp_path: Path) -> None:
    lines = [f"15010111{minute:02d} {TYPE_1}" for minute in range(60)] + [f"1501011200 {TYPE_1}"]
    with pytest.raises(InputError, match=r"yymmddHHMM, must be Unix times.*\(got 1501011100 to 1501011200\)"):
        list(read_nmea(log(tmp_path, *lines)))


def test_json_of_a_receiver_has_all_parts_of_a_message_and_a_vdr_file_its_quotes(tmp_path: Path) -> None:
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


def test_identities_that_lost_digits_are_refused_and_others_are_repaired(tmp_path: Path) -> None:
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


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.encode("utf-16"), "is UTF-16 text, must be UTF-8"),
        (lambda text: b"sep=,\n" + text.encode(), "none of the formats.*line 1 is for spreadsheets alone, leave it"),
        (lambda text: text.replace(",", ";").encode(), "none of the formats.*cells have semicolons"),
        (lambda text: text.replace("\n", "\r").encode(), "lines end with carriage returns alone"),
    ],
)
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
