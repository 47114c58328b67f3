"""The page of a scene made from AIS: it begins with the result, and says what was dropped, moved and guessed."""

import hashlib
import html
import re
from pathlib import Path

import numpy as np
import pytest

from modsim3d.scene.ais.messages import SeaRegion
from modsim3d.view.pages.ais_page import MAX_ROWS, ais_page
from tests.scene.ais.ais_builders import SAMPLES, old_file, row, traffic_of


def text_of(written: str) -> str:
    """What a reader sees: a line for each paragraph, caption and row of a table, its cells apart by bars."""
    body = re.sub(r"</(p|h1|h2|tr|figcaption)>", "\n", written.partition("<body>")[2])
    body = re.sub(r"</t[dh]>", "|", body)
    return html.unescape(re.sub(r"<[^>]+>", "", body))


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


def test_the_page_begins_with_the_result(said):
    title, rests_on, vessels, messages, *_ = (line for line in said.splitlines() if line)
    assert title == "Traffic from AIS" and rests_on.endswith("what this page rests on")
    times = "from 2024-01-04 10:00:00 UTC to 2024-01-04 10:09:40 UTC"
    assert vessels == f"3 of 5 vessels in the scene, {times}: 581 steps, one every 1 s."
    guessed = "2 positions removed as jumps; length or beam guessed for 1 "
    assert f"74 of 83 messages used as positions; {guessed}" in messages


def test_the_page_says_what_became_of_vessels_and_reports_which_options_were_given_and_of_which_log(said, traffic):
    lines = {
        "219000002|X|sailing|Sailing|12|3.7|16|the same|length, beam, place of the antenna, air draft|",
        "219000004|latitude 91, longitude 181, both 0, or empty (1)|",
        "219000005|outside the region (3)|",
        "1 other sender is no ship: base stations, aids to navigation, aircraft, beacons.",
        "dropped: faster than 60 kn from the position before|2|2.4 %|",
        "row 83: LAT is not a number (got 'x56')",
        "219000002|X|16|20|20|1|300|282|48.5 %|",
        "Length missing: typical of the ship type|1|",
        *("--gap 120|given|", "--region 55.9,11.9,56.2,12.3|given|", "--label type|given|"),
        "--time-step 1|by default|",
    }
    assert lines - set(said.splitlines()) == set()
    (log,) = traffic.files
    assert hashlib.sha256(log.path.read_bytes()).hexdigest() in said and "MarineCadastre, 83 messages" in said


def test_jumps_are_listed_where_they_were_and_how_far_off(said, traffic):
    rows = [line.split("|") for line in said.splitlines() if line.startswith("219000003|X|2")]
    jumps, vessel = [cells for cells in rows if cells[2] in ("220", "240")], traffic.vessels[2]
    assert len(jumps) == 2
    way = np.linalg.norm(vessel.jumps_m[0] - vessel.reported_m[0])
    assert float(jumps[0][5]) == pytest.approx(way, abs=1)
    assert way == pytest.approx(0.02 * 111_300, rel=0.01)


def test_what_a_ship_calls_itself_is_no_markup(tmp_path):
    rows = [row(10 * k).replace(",X,", ",<b>OLE & CO</b>,") for k in range(5)]
    written = ais_page(traffic_of(old_file(tmp_path, *rows)))
    assert "<b>" not in written
    assert written.count("&lt;b&gt;OLE &amp; CO&lt;/b&gt;") >= 4  # table, map, chart


def drawn(written: str, index: int) -> str:
    return re.findall(r"<svg.*?</svg>", written, re.DOTALL)[index]


def test_map_has_tracks_gaps_jumps_and_the_region_and_a_caption_that_explains_them(traffic, tmp_path):
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


def test_lanes_show_when_a_vessel_is_there(traffic):
    widths = [float(width) for width in re.findall(r'<rect x="[\d.]+" width="([\d.]+)"', drawn(ais_page(traffic), 1))]
    assert len(widths) == 4 and widths[1:3] == pytest.approx([widths[0] * 140 / 580] * 2, abs=0.2)


def test_a_long_list_is_cut_and_vessels_left_out_are_counted_by_reason(tmp_path):
    many = MAX_ROWS + 5
    rows = [row(10 * k, 56.0 + 0.001 * v, mmsi=219000000 + v) for v in range(many) for k in (0, 1)]
    rows += [row(0, 57.0, mmsi=220000000 + v) for v in range(many)]
    written = ais_page(traffic_of(old_file(tmp_path, *rows), region=SeaRegion.between(55, 11, 56.5, 13)))
    said = text_of(written)
    assert f"{many} of {2 * many} vessels in the scene" in said and len(written) < 400_000
    lines = {f"The first {MAX_ROWS} of {many}; report.json has all vessels.", f"outside the region|{many}|"}
    assert lines <= set(said.splitlines())


def test_the_command_writes_the_page_and_names_it(call, tmp_path):
    out = tmp_path / "scene"
    status, said = call("ais", SAMPLES / "danish.csv", "--out", out, "--end", "+20")
    assert status == 0 and f"{out / 'ais.html'}" in said.replace("\n", "")
    written = (out / "ais.html").read_text(encoding="utf-8")
    assert "--end +20" in text_of(written)
    assert not re.search(r'(src|href)="(?!#)|url\((?!#)|<script', written)  # nothing is fetched
