"""AIS logs that are broken or made to fill the memory get one clear error, or lose only what is broken in them."""

import gzip
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from modsim3d.scene.ais.messages import reachable
from modsim3d.scene.ais.options import time_text
from modsim3d.scene.ais.read_csv import read_csv, recognise
from modsim3d.scene.ais.read_nmea import MAX_PENDING, read_nmea
from modsim3d.scene.ais.vessel_track import ReportedTrack, resample, steps_near
from tests.cli.bad_input.builders import Call, refusal
from tests.scene.ais.ais_builders import OLD_HEADER, SAMPLES, old_file, only, row, traffic_of

TYPE_1 = "!AIVDM,1,1,,A,15RTgt0PAso;90TKcjM8h6g208CQ,0*4A"
DANISH = (SAMPLES / "danish.csv").read_bytes()
Refuse = Callable[..., str]


def sentence(body: str) -> str:
    total = 0
    for character in body.encode():
        total ^= character
    return f"!{body}*{total:02X}"


def tagged(content: str, after: str = TYPE_1) -> str:
    return f"\\{sentence(content)[1:]}\\{after}\n"


@pytest.fixture
def refuse(call: Call, tmp_path: Path) -> Refuse:
    """A function that asserts that `ais` refuses a log with some parts in a short message."""

    def look(content: bytes | Path, *parts: str, options: tuple[str, ...] = ()) -> str:
        path = content if isinstance(content, Path) else tmp_path / "log"
        if isinstance(content, bytes):
            path.write_bytes(content)
        said = refusal(call, ("ais", path, "--out", tmp_path / "scene", *options), *parts)
        assert len(said) < 5_000 and said.replace("\n", "").isprintable()
        assert not (tmp_path / "scene").exists()
        return said

    return look


def chunk_of(path):
    layout = recognise(path)
    assert layout is not None
    (chunk,) = read_csv(path, layout)
    return chunk


def test_a_byte_that_is_no_text_costs_its_row_only_and_rows_are_numbered_as_in_the_file(tmp_path):
    for change in (
        lambda cells: [cells[0], b"\xff", cells[2], b"\xff", *cells[4:]],
        lambda cells: [*cells, b"\xff", b"\xff"],
        lambda cells: [b"\0\xff" * 40, *cells[1:]],
    ):
        lines = DANISH.split(b"\n")
        lines[5] = b",".join(change(lines[5].split(b",")))
        (tmp_path / "log.csv").write_bytes(b"\n".join(lines))
        chunk, whole = chunk_of(tmp_path / "log.csv"), chunk_of(SAMPLES / "danish.csv")
        assert chunk.dropped["unreadable"] == 1
        assert set(whole.positions.row.tolist()) - set(chunk.positions.row.tolist()) == {6}
    for rows, header, left in (
        ((row(0), row(10).replace(",X,", ",X\rY,"), row(20), row(30, speed="fast")), OLD_HEADER, [2, 3, 4]),
        ((row(0), row(10, speed="fast")), "\n \n" + OLD_HEADER, [4]),
    ):
        chunk = chunk_of(old_file(tmp_path, *rows, header=header))
        assert chunk.positions.row.tolist() == left
        assert chunk.problems[0].startswith("row 5: SOG is not a number")


def test_a_year_without_ais_costs_its_row_only_a_name_is_cut_and_far_reports_cost_two_steps(tmp_path):
    for time in ("0001-01-04T10:00:00", "9999-12-31T23:59:59", "1969-12-31T23:59:59"):
        rows = [row(second) for second in range(0, 300, 10)]
        traffic = traffic_of(old_file(tmp_path, *rows, row(30).replace("2024-01-04T10:00:30", time)))
        assert (traffic.dropped["unreadable"], len(only(traffic).steps)) == (1, 291)
        named = row(30).replace(",X,", "," + "N" * 100_000 + ",")
        assert len(only(traffic_of(old_file(tmp_path, *rows, named))).hull.name) <= 120
    assert time_text(1704362400.0) == "2024-01-04T10:00:00Z"
    assert [time_text(sign * 1e300) for sign in (1, -1)] == ["1e+300 s after 1970", "-1e+300 s after 1970"]
    rows = [row(0, mmsi=219000000 + k) for k in range(50)]
    traffic = traffic_of(old_file(tmp_path, *rows, *(text.replace("2024-01-04", "2024-01-15") for text in rows)))
    assert len(traffic.grid.times_s) == 950_401
    assert sum(vessel.places_m.nbytes for vessel in traffic.vessels) == 50 * 2 * 16


HEADER, REPORT = DANISH.split(b"\n")[0], tagged("c:1423133048")
NO_FORMAT, BOMB = "is none of the formats that are read", "unpacks to more than 100 times its own size"
NO_LOGS: dict[str, tuple[Callable[[], bytes], str]] = {
    "passwd": (lambda: b"root:x:0:0:secret:/root:/bin/bash\n" * 40, NO_FORMAT),
    "escape": (lambda: b"\x1b[31msecret\n", NO_FORMAT),
    "png": (lambda: b"\x89PNG\r\n\x1a\nsecret" + bytes(range(256)) * 40, NO_FORMAT),
    "zeros": (lambda: b"\0" * 5_000_000, NO_FORMAT),
    "no lines": (lambda: b"secret" * 1_000_000, NO_FORMAT),
    "blank rows": (lambda: gzip.compress(HEADER + b"\n" * 30_000_000, 1), BOMB),
    "blank lines": (lambda: gzip.compress(REPORT.encode() + b"\n" * 30_000_000, 1), BOMB),
    "cut off": (lambda: gzip.compress(DANISH)[:-100], "is not a complete gzip file"),
    "short rows": (lambda: HEADER + b"\n" + b"a,b\n" * 60_000, "too much of it cannot be read: more than 50,000 rows"),
    "empty rows": (lambda: HEADER + b"\n" + (b"x" + b"," * 25 + b"\n") * 20_000, "too much of it cannot be read"),
    "many columns": (lambda: HEADER.strip() + b"," * 600 + b"\n", "has 626 columns, more than 500"),
    "no column": (lambda: b"MMSI,LAT,LON,\x1b[31m" + b"x" * 10_000 + b"\n1,2,3,4\n", "has no column BaseDateTime"),
    "thirty years": (lambda: (tagged("c:633133048") + REPORT).encode(), "790,000,001 steps, more than 1,000,000"),
}


@pytest.mark.parametrize(("content", "part"), NO_LOGS.values(), ids=NO_LOGS)
def test_what_is_no_log_is_refused_early_and_without_its_content(refuse: Refuse, content, part: str) -> None:
    assert "secret" not in refuse(content(), part)


def test_pipes_folders_and_absurd_options_are_refused_and_a_time_tag_of_too_many_digits_is_no_time(tmp_path, refuse):
    os.mkfifo(tmp_path / "pipe")
    refuse(tmp_path / "pipe", "this is a pipe, a file was expected")
    (tmp_path / "folder").mkdir()
    refuse(tmp_path / "folder", "this is a folder, a file was expected")
    for options, part in (
        ("--time-step 1e-300", "--time-step: must be above 0, from 1e-06 to 1e+09 (got 1e-300)"),
        ("--end +1e300", "--end +SECONDS: must be above 0, from 1e-06 to 1e+09"),
        ("--max-speed 1e308", "--max-speed: must be above 0"),
        ("--report-gap 1e308", "--report-gap: must be above 0"),
        ("--start 0001-01-01T00:00:00+14:00", "more than 1,000,000: choose --start"),
        ("--start 9999-12-31T23:59:59-14:00 --end +1e9", "no positions of ships"),
        ("--origin 1e300,1e300", "--origin: latitude 1e+300 is beyond ±90"),
        (f"--origin {'x' * 100_000}", "--origin: LAT,LON in degrees is needed (got 'xxx"),
        (f"--label {'x' * 100_000}", "--label: GROUP=LABEL is needed"),
        (f"--start {'x' * 100_000}", "--start: a time such as"),
    ):
        refuse(SAMPLES / "receiver.nmea", part, options=tuple(options.split()))
    for digits in (11, 17, 400):
        wrong = tagged("c:" + "9" * digits)
        refuse((wrong * 3).encode(), "has no times", "in seconds or milliseconds")
        path = tmp_path / "log"
        path.write_text(REPORT + wrong)
        (chunk,) = read_nmea(path)
        assert (len(chunk.positions), dict(chunk.dropped)) == (1, {"no_time": 1})


@pytest.mark.parametrize("seed", range(20))
def test_steps_near_reports_are_all_at_which_a_vessel_can_be_there(seed: int) -> None:
    rng = np.random.default_rng(seed)
    known = np.unique(rng.integers(0, 300, int(rng.integers(1, 30)))) * rng.choice([1.0, 0.5])
    times, gap = np.arange(0, 200, rng.choice([0.5, 1.0, 7.0])), float(rng.integers(1, 30))
    count = len(known)
    track = ReportedTrack(known, rng.normal(size=(count, 2)), rng.normal(size=(count, 2)), rng.normal(size=count))
    there, places, headings = resample(track, times, gap)
    steps = steps_near(known, times, gap)
    near, near_places, near_headings = resample(track, times[steps], gap)
    assert steps[near].tolist() == np.flatnonzero(there).tolist()
    np.testing.assert_array_equal(near_places[near], places[there])
    np.testing.assert_array_equal(near_headings[near], headings[there])


def test_two_vessels_of_one_identity_are_told_apart_and_lines_that_are_no_sentence_searched_fast(tmp_path, monkeypatch):
    number = 30_000
    times, places = np.arange(number, dtype=float), np.zeros((number, 2))
    places[1::3] = 1e6  # every third report is of the other vessel
    assert np.flatnonzero(~reachable(times, places, 10.0)).tolist() == list(range(1, number, 3))
    for filling in ("a", "1", "\\", "!", "VD", "!AIVDM,", "*4", "a\\", "$a"):
        line = (filling * 1000)[:900] + "!" + TYPE_1
        (tmp_path / "log").write_text(REPORT + f"{line}\n" * 2000)
        (chunk,) = read_nmea(tmp_path / "log")  # each such line took five seconds once
        assert len(chunk.positions) >= 1
    payload, path = "55?MbV02;H;s<HtKR20EHE:0@T4@Dn2222222216L961O5Gf0NSQEp6ClRp8,0", tmp_path / "log"
    wrong = [sentence(f"AIVDM,{count},{number},1,A,55?MbV02,0") for count, number in ((2, 3), (99, 1), (0, 0))]
    path.write_text("".join(f"1423133048 {line}\n" for line in wrong) + REPORT)
    (chunk,) = read_nmea(path)
    assert (sum(chunk.dropped.values()), len(chunk.positions)) == (3, 1)
    lines = [f"1423133048 {sentence(f'AIVDM,2,1,{k % 10},{k},{payload}')}\n" for k in range(3000)]
    path.write_text("".join([*lines, REPORT]))
    monkeypatch.setattr("modsim3d.scene.ais.read_nmea.CHUNK_MESSAGES", 1)
    first, last = read_nmea(path)
    assert first.dropped["incomplete"] == 3000 - MAX_PENDING
    assert (last.dropped["incomplete"], len(first.positions)) == (MAX_PENDING, 1)
