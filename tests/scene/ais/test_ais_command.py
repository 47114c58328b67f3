"""`modsim3d ais` as a user types it, every mistake as one message, and the page of the scene."""

import hashlib
import html
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import modsim3d
from modsim3d.io.input_files import data_folder
from modsim3d.scene.ais.messages import SeaRegion
from modsim3d.view.pages.ais_page import MAX_ROWS, ais_page
from tests.run_folders import run_files
from tests.scene.ais.ais_builders import SAMPLE_NAMES, SAMPLES, TABLES, old_file, read_json, row, traffic_of

DANISH = SAMPLES / "danish.csv"
HEAD = DANISH.read_bytes().partition(b"\n")[0]


def test_the_usual_detector_fits_vessels_far_away_and_groups_have_labels_of_the_detector(call, tmp_path):
    below = {}
    for name in ("vessel", "thesis"):
        chosen = ("--detector", name) if name == "thesis" else ()
        assert call("ais", DANISH, "--out", tmp_path / name, "--end", "+20", *chosen)[0] == 0
        scene = modsim3d.load_scene(tmp_path / name, source="analytic")
        below[name] = modsim3d.run_scene(scene, tmp_path / f"run_{name}", thesis_json=False).iou.below_half
    assert below["vessel"] < 0.02 and below["thesis"] > 0.9
    status, said = call("ais", DANISH, "--out", tmp_path / "coastal", "--end", "+5", "--detector", "coastal")
    printed = {" ".join(line.split()) for line in said.splitlines()}
    assert status == 0 and {"cargo 1 label ship", "sailing 1 label sailboat", "pilot 1 label boat"} <= printed
    vessels = read_json(tmp_path / "coastal" / "vessels.json").values()
    assert {vessel["label"] for vessel in vessels} == {"boat", "sailboat", "ship"}
    shipped = data_folder("scenes") / "detectors" / "coastal.yaml"
    assert (tmp_path / "coastal" / "detector.yaml").read_bytes() == shipped.read_bytes()
    asked = ("ais", DANISH, "--out", tmp_path / "three", "--end", "+5", "--detector", "three_labels")
    status, said = call(*asked, "--label", "cargo=lighthouse")
    assert status == 2 and "the detector has no label for cargo (not 'lighthouse'), tug: give --label" in said
    assert "with sailboat or motorboat or ferry" in said and not (tmp_path / "three").exists()
    assert call(*asked, *(word for group in ("cargo", "tug") for word in ("--label", f"{group}=Ferry")))[0] == 0
    assert call("run", tmp_path / "three", "--no-sheet", "--out", tmp_path / "run")[0] == 0


def test_a_scene_folder_is_made_and_runs_as_typed_and_one_with_something_in_it_is_left_alone(call, tmp_path):
    out = tmp_path / "scene"
    status, said = call("ais", DANISH, "--out", out, "--report-gap", 120, "--time-step", 2)
    words = ("254", "messages used", "249", "no_position", "jump", "heading_from_course", "air_draft", "10:00:00Z")
    assert status == 0 and [word for word in (*words, f"modsim3d run {out}") if word not in said] == []
    assert {path.name for path in out.iterdir()} == {
        *("scene.yaml", "vessels.json", "poses.json.gz", "detector.yaml"),
        *("report.json", "report_times.json.gz", "ais.html"),
    }
    assert read_json(out / "report.json")["vessels"]["245999910"]["steps_present"] < 100
    moved = out.rename(tmp_path / "moved")  # it has all that it needs
    assert call("check", "scene", moved / "scene.yaml")[0] == 0
    assert call("run", moved, "--steps", 3, "--no-sheet", "--out", tmp_path / "run")[0] == 0
    counts = read_json(tmp_path / "run" / "run.json")["counts"]
    assert counts["frames"] == 3 and counts["seen"] > 3
    out, other = tmp_path / "scene", tmp_path / "other"
    assert call("ais", DANISH, "--out", out, "--end", "+5")[0] == 0
    before = (out / "poses.json.gz").read_bytes()
    status, said = call("ais", DANISH, "--out", out, "--end", "+9")
    assert status == 2 and "--overwrite" in said and (out / "poses.json.gz").read_bytes() == before
    assert call("ais", DANISH, "--out", out, "--end", "+9", "--overwrite")[0] == 0
    assert (out / "poses.json.gz").read_bytes() != before
    other.mkdir()
    (other / "precious").write_text("x")
    for place, words in ((other, "left alone"), (other / "precious", "is not a folder")):
        status, said = call("ais", DANISH, "--out", place, "--overwrite")
        assert status == 2 and words in said


@pytest.fixture
def problem(call, tmp_path):
    """The one message of a command that must fail, and leave nothing behind."""

    def fail(*arguments: object) -> str:
        status, said = call("ais", *arguments, "--out", tmp_path / "scene")
        assert status == 2 and not (tmp_path / "scene").exists()
        assert said.startswith("modsim3d: ") and "Traceback" not in said
        return said

    return fail


COORDINATES = {"latitude", "longitude", "lat", "lon"}


def swapped_copy(path, folder):
    """A copy of a table with latitude and longitude in each other's columns."""
    rows = [line.split(",") for line in path.read_text().splitlines()]
    one, other = (place for place, name in enumerate(rows[0]) if name.lower() in COORDINATES)
    for cells in rows[1:]:
        cells[one], cells[other] = cells[other], cells[one]
    copy = folder / path.name
    copy.write_text("\n".join(",".join(cells) for cells in rows) + "\n")
    return copy


SWAPPED = "latitude and longitude look swapped"
FAULTS = [
    ([row(0, 35.0, 110.0), *(row(10 * k, 110.2, 35.0) for k in range(1, 8))], (), "row 3, 4, 5, 6, 7 and more: "
     f"{SWAPPED}: latitude 110.2, longitude 35|--swap-coordinates|old.csv"),
    # Each value that can only be a longitude is noticed.
    *(([row(0, 35.0, 80.0), row(10, *place)], (), f"row 3: {SWAPPED}") for place in ((181, 91), (-120, 35), (120, 91))),
    ([row(0, 35.0, 110.0), row(10, 35.0, 110.0)], ("--swap-coordinates",), "--swap-coordinates makes these positions "
     "impossible (latitude 110, longitude 35); leave the option"),
    ([row(k, latitude="x56" if k % 50 == 0 else 56.0) for k in range(0, 300, 10)], (), "row 2: LAT is not a number "
     "(got 'x56')|too much of it cannot be read: 6 of 30 messages"),
]  # fmt: skip
"""Rows of a table, options, and what is said of them."""


@pytest.mark.parametrize(("rows", "options", "words"), FAULTS)
def test_a_table_that_cannot_be_right_is_refused_by_row_with_the_option(problem, tmp_path, rows, options, words):
    said = problem(old_file(tmp_path, *rows), *options)
    assert [part for part in words.split("|") if part not in said] == []


@pytest.mark.parametrize("place", [(91, 181), (91, 35), (95, 200), ("", 12), (12.6, 56.0)])
def test_a_position_that_is_no_better_the_other_way_round_refuses_no_table(call, tmp_path, place):
    path = old_file(tmp_path, row(0, 35.0, 80.0), row(10, *place), row(20, 35.0, 80.0))
    assert call("ais", path, "--out", tmp_path / "scene")[0] == 0


@pytest.mark.parametrize("name", TABLES)
def test_swapped_columns_are_exchanged_where_the_user_says_so(call, tmp_path, name):
    swapped = swapped_copy(SAMPLES / name, tmp_path)
    for out, line in (("right", [SAMPLES / name]), ("exchanged", [swapped, "--swap-coordinates"])):
        assert call("ais", *line, "--out", tmp_path / out)[0] == 0
    right, exchanged = (run_files(tmp_path / name, "report.json", "ais.html") for name in ("right", "exchanged"))
    assert right == exchanged and read_json(tmp_path / "exchanged" / "report.json")["swap_coordinates"]


def test_tables_beside_sentences_are_exchanged_and_sentences_are_not(call, problem, tmp_path):
    sentences, poses = SAMPLES / "receiver.nmea", []
    for name, table in (("both", (swapped_copy(DANISH, tmp_path), "--swap-coordinates")), ("apart", (DANISH,))):
        assert call("ais", sentences, *table, "--out", tmp_path / name)[0] == 0
        poses.append((tmp_path / name / "poses.json.gz").read_bytes())
    assert poses[0] == poses[1]
    assert "--swap-coordinates is for tables" in problem(sentences, "--swap-coordinates")


def test_a_region_leaves_single_swapped_rows_out_and_negative_degrees_can_be_given(call, tmp_path):
    path = old_file(tmp_path, row(0, 35.0, 110.0), row(10, 110.0, 35.0), row(20, 35.0, 110.0))
    out = tmp_path / "scene"
    assert call("ais", path, "--out", out, "--region", "34,109,36,111")[0] == 0
    assert read_json(out / "report.json")["messages"]["dropped"] == {"impossible_position": 1}
    path = old_file(tmp_path, *(row(10 * k, -33.8, -151.2, speed=0) for k in range(4)))
    options = ("--origin", "-33.8,-151.2", "--region", "-33,-151,-34,-152")
    assert call("ais", path, "--out", tmp_path / "south", *options)[0] == 0


def test_a_region_with_nothing_in_it_says_what_the_files_cover_and_how_to_exchange(problem, tmp_path):
    said = problem(swapped_copy(DANISH, tmp_path), "--region", "55.9,12.5,56.2,12.8")
    assert "no positions of ships in the region 55.9,12.5,56.2,12.8: the files reach from" in said
    assert "latitude 12.6" in said and "--swap-coordinates exchanges them" in said


@pytest.mark.parametrize(("content", "says"), [
    (b"", "the file is empty"),
    (b"\n \n", "the file is empty"),
    (
        HEAD.replace(b"Latitude,Longitude", b"Breite,Laenge"),
        "Danish Maritime Authority CSV, but has no column Latitude, Longitude (it has: # Timestamp",
    ),
    (b"PK\x03\x04xxxx", "unpack it first (unzip data)"),
    (b"\x28\xb5\x2f\xfdxxxx", "unpack it first (zstd -d data)"),
    (HEAD + b"\n", "the files hold no positions at all"),
    (HEAD, "the files hold no positions at all"),
    (b"!AIVDM,1,1,,A,15RTgt0PAso;90TKcjM8h6g208CQ,0*4A\n", "has no times"),
    (b"1423133048 !AIVDM,1,1,,A,15RTgt0PAso;90TKcjM8h6g208CQ,0*4B\n", "too much of it cannot be read: 1 of 1"),
])  # fmt: skip
def test_a_file_that_is_of_no_use_says_why(problem, tmp_path, content, says):
    (tmp_path / "data").write_bytes(content)
    assert says in problem(tmp_path / "data")


def test_every_file_of_no_use_is_named_at_once(problem, tmp_path):
    (tmp_path / "empty").write_text("")
    said = problem(tmp_path / "none.csv", DANISH, tmp_path / "empty", tmp_path)
    parts = ("none.csv: no such file", "empty: the file is empty", "this is a folder")
    assert [part for part in parts if part not in said] == []


@pytest.mark.parametrize(("arguments", "says"), [
    (("--start", "2024-01-05T10:00:00"), "no positions of ships from 2024-01-05T10:00:00Z to …: the files reach"),
    (("--end", "2024-01-03T10:00:00Z"), "from … to 2024-01-03T10:00:00Z"),
    (("--region", "10,10,11,11"), "in the region 10,10,11,11: the files reach"),
    (("--origin", "112,56"), "latitude 112 is beyond ±90: latitude comes first"),
    (("--region", "1,2,3"), "--region: LAT1,LON1,LAT2,LON2 in degrees"), (("--time-step", 1e-5), "more than 1,000,000"),
    (("--end", "+soon"), "--end: needs seconds after the first step, as in +600"),
    (("--label", "ferry=Ferry"), "no group 'ferry'"), (("--time-step", 0), "--time-step: must be above 0"),
])  # fmt: skip
def test_options_that_cannot_be_met_say_why(problem, arguments, says):
    assert says in problem(DANISH, *arguments)


@pytest.mark.parametrize("name", SAMPLE_NAMES)
def test_same_files_give_the_same_bytes(call, tmp_path, name):
    for out in ("a", "b"):
        assert call("ais", SAMPLES / name, "--out", tmp_path / out, "--label", "type")[0] == 0
    assert run_files(tmp_path / "a") == run_files(tmp_path / "b")


def test_readers_are_imported_only_where_they_are_used():
    script = (
        "import sys, modsim3d\nbefore = list(sys.modules)\nimport modsim3d.cli.main\n"
        "assert not {'pyais', 'pymap3d', 'modsim3d.scene.ais.traffic'} & set(sys.modules)\n"
        "sys.argv = ['modsim3d', 'ais', '--help']\n"
        "try:\n    modsim3d.cli.main.main()\n"
        "except SystemExit:\n    pass\n"
        "assert not {'pyais', 'pymap3d', 'pyarrow', 'numpy'} & set(sys.modules) - set(before)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "Example: modsim3d ais" in done.stdout


def text_of(written: str) -> str:
    """What a reader sees: a line for each paragraph, caption and row of a table, its cells apart by bars."""
    body = re.sub(r"</(p|h1|h2|tr|figcaption)>", "\n", written.partition("<body>")[2])
    body = re.sub(r"</t[dh]>", "|", body)
    return html.unescape(re.sub(r"<[^>]+>", "", body)).replace("\xa0", " ")


def mixed_log(folder: Path) -> Path:
    """A vessel of 30 reports, one with a gap and no size, one with two jumps, and some of which nothing is left."""
    rows = [row(20 * k, 56.0, 12.0 + 0.0015 * k) for k in range(30)]
    gap = [k for k in range(30) if not 8 <= k < 22]
    rows += [row(20 * k, 56.01, 12.02, speed=0, mmsi=219000002, ship_type=36, length=0, beam=0) for k in gap]
    rows += [row(20 * k, 56.025 if k in (11, 12) else 56.005, 12.04, speed=0, mmsi=219000003) for k in range(30)]
    rows.append(row(50, 91, 181, mmsi=219000004))
    rows += [row(100 + 100 * k, 57.5, 14, mmsi=219000005) for k in range(3)]
    rows.append(row(60, mmsi=2190007))
    rows += [row(70, "x56", 12.01), row(75, 91, 181)]
    return old_file(folder, *rows, name="mixed & more.csv")


@pytest.fixture(scope="module")
def traffic(tmp_path_factory):
    log = mixed_log(tmp_path_factory.mktemp("log"))
    return traffic_of(log, max_gap_s=120, region=SeaRegion.between(55.9, 11.9, 56.2, 12.3), labels_by_type=True)


@pytest.fixture(scope="module")
def said(traffic):
    return text_of(ais_page(traffic))


def test_the_page_begins_with_the_result_and_says_what_became_of_vessels_and_reports(said, traffic):
    title, rests_on, vessels, messages, *_ = (line for line in said.splitlines() if line)
    assert title == "Traffic from AIS" and rests_on.endswith("what this page rests on")
    times = "from 2024-01-04 10:00:00 UTC to 2024-01-04 10:09:40 UTC"
    assert vessels == f"3 of 5 vessels in the scene, {times}: 581 steps, one every 1 s."
    guessed = "2 positions removed as jumps; length or beam guessed for 1 "
    assert f"74 of 83 messages used as positions; {guessed}" in messages
    rows = [line.split("|") for line in said.splitlines() if line.startswith("219000003|X|2")]
    jumps, vessel = [cells for cells in rows if cells[2] in ("220", "240")], traffic.vessels[2]
    assert len(jumps) == 2
    way = np.linalg.norm(vessel.jumps_m[0] - vessel.reported_m[0])
    assert float(jumps[0][5]) == pytest.approx(way, abs=1)
    assert way == pytest.approx(0.02 * 111_300, rel=0.01)
    lines = {
        "219000002|X|sailing|Sailing|12|3.7|16|the same|length, beam, place of the antenna, air draft|",
        "219000004|latitude 91, longitude 181, both 0, or empty (1)|",
        "219000005|outside the region (3)|",
        "1 other sender is no ship: base stations, aids to navigation, aircraft, beacons.",
        "dropped: faster than 60 kn from the position before|2|2.4 %|",
        "row 83: LAT is not a number (got 'x56')",
        "219000002|X|16|20|20|1|300|282|48.5 %|",
        "Length missing: typical of the ship type|1|",
        *("--report-gap 120|given|", "--region 55.9,11.9,56.2,12.3|given|", "--label type|given|"),
        "--time-step 1|by default|",
    }
    assert lines - set(said.splitlines()) == set()
    (log,) = traffic.files
    assert hashlib.sha256(log.path.read_bytes()).hexdigest() in said and "MarineCadastre, 83 messages" in said


def drawn(written: str, index: int) -> str:
    return re.findall(r"<svg.*?</svg>", written, re.DOTALL)[index]


def test_lanes_show_when_a_vessel_is_there_and_a_long_list_is_cut_and_names_are_no_markup(traffic, tmp_path):
    widths = [float(width) for width in re.findall(r'<rect x="[\d.]+" width="([\d.]+)"', drawn(ais_page(traffic), 1))]
    assert len(widths) == 4 and widths[1:3] == pytest.approx([widths[0] * 140 / 580] * 2, abs=0.2)
    drawing = drawn(ais_page(traffic), 0)
    assert len(re.findall(r"<g fill=\"none\" stroke=\"color-mix", drawing)) == 3
    # The vessel with a gap; vessels, region and camera.
    marks = {'stroke-dasharray="2 4"': 1, "<title>region</title>": 1, "<polygon": 5}
    assert {mark: drawing.count(mark) for mark in marks} == marks
    (crosses,) = re.findall(r'<path d="([^"]*)" stroke="var\(--bad\)"', drawing)
    assert crosses.count("M") == 2
    plain = ais_page(traffic_of(old_file(tmp_path, *(row(10 * k) for k in range(5)))))
    for words in ("Dashes join reports", "Crosses are positions"):
        assert words in ais_page(traffic) and words not in plain
    # A track is drawn where it is, by the ticks of the axes, which are 500 m apart, and stops at a gap.
    labels = re.findall(r'<text x="([\d.]+)" y="[\d.]+" text-anchor="middle" [^>]*>([-\d.]+)<', drawing)
    ticks = {float(metres): float(column) for column, metres in labels}
    tracks = re.findall(r'<path d="([^"]*)" stroke-width="1.6"', drawing)
    assert [track.count("M") for track in tracks] == [1, 2, 1]
    first = (float(tracks[0][1:].split(",")[0]) - ticks[0]) / (ticks[500] - ticks[0]) * 500
    assert first == pytest.approx(traffic.vessels[0].places_m[0, 0], abs=2)
    many = MAX_ROWS + 5
    rows = [row(10 * k, 56.0 + 0.001 * v, mmsi=219000000 + v) for v in range(many) for k in (0, 1)]
    rows += [row(0, 57.0, mmsi=220000000 + v) for v in range(many)]
    written = ais_page(traffic_of(old_file(tmp_path, *rows), region=SeaRegion.between(55, 11, 56.5, 13)))
    said = text_of(written)
    assert f"{many} of {2 * many} vessels in the scene" in said and len(written) < 400_000
    lines = {f"The first {MAX_ROWS} of {many}; report.json has all vessels.", f"outside the region|{many}|"}
    assert lines <= set(said.splitlines())
    rows = [row(10 * k).replace(",X,", ",<b>OLE & CO</b>,") for k in range(5)]
    written = ais_page(traffic_of(old_file(tmp_path, *rows)))
    assert "<b>" not in written
    assert written.count("&lt;b&gt;OLE &amp; CO&lt;/b&gt;") >= 4  # table, map, chart


def test_the_command_writes_the_page_and_names_it(call, tmp_path):
    out = tmp_path / "scene"
    status, said = call("ais", SAMPLES / "danish.csv", "--out", out, "--end", "+20")
    assert status == 0 and f"{out / 'ais.html'}" in said.replace("\n", "")
    written = (out / "ais.html").read_text(encoding="utf-8")
    assert "--end +20" in text_of(written)
    assert not re.search(r'(src|href)="(?!#)|url\((?!#)|<script', written)  # nothing is fetched
