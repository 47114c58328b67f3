"""What the page of a run says is what the run directory holds."""

import hashlib
import json
import re
import shutil
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from modsim3d import RunDirectoryError, load_scene, open_run, run_scene
from modsim3d.runs.counts import Outcome, frame_outcomes
from modsim3d.view.pages.provenance import run_inputs
from modsim3d.view.report.overview import UNKNOWN_FRACTION, WHOLE
from modsim3d.view.report.packing import NONE, in_quanta
from modsim3d.view.report.part_columns import in_250ths
from modsim3d.view.report.recorder import quantum_px
from modsim3d.view.report.report import write_report
from tests.run_folders import interrupt
from tests.scenes import mistaken_strait, write_scene
from tests.view.report.conftest import STEPS
from tests.view.report.unpacking import read


def unpack(page):
    unpacked = read(page)
    return unpacked.facts, unpacked.columns


def table_after(page, title):
    section = re.search(rf"<h2[^>]*>{title}</h2>(.*?)</section>", page.read_text(encoding="utf-8"), re.DOTALL)[1]
    rows = re.findall(r"<tr>(.*?)</tr>", section, re.DOTALL)
    return [re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row) for row in rows]


def whole(number):
    return int(number.replace(",", ""))


def test_page_holds_every_frame_silhouettes_and_counts_of_the_run(page, run_folder):
    facts, columns = unpack(page)
    quantum, names_of = facts["quantum"], [vessel["name"] for vessel in facts["vessels"]]
    for index, frame in enumerate(open_run(run_folder).frames()):
        truth, found = frame.truth, frame.detections
        assert facts["states"][columns["state"][index]] == frame.state
        rows = slice(*columns["truthStart"][index : index + 2])
        names = [names_of[vessel] for vessel in columns["vessel"][rows]]
        order = [truth.vessels.index(name) for name in names]
        assert sorted(names) == sorted(truth.vessels)
        visible = columns["visible"].reshape(-1, 4)[rows]
        seen = ~np.isnan(truth.visible_boxes_px[order, 0])
        np.testing.assert_array_equal(visible[:, 0] != NONE, seen)
        np.testing.assert_array_equal(columns["flags"][rows], (truth.annotated + 2 * truth.detected)[order])
        drawn = slice(*columns["drawnStart"][index : index + 2])
        assert [None if v == NONE else names_of[v] for v in columns["drawnVessel"][drawn]] == list(found.vessels)
        assert all(((over := found.confidence - columns["confidence"][drawn] / 1000) >= 0) & (over < 1e-3))
        for boxes, boxes_px in (
            (columns["full"].reshape(-1, 4)[rows], truth.full_boxes_px[order]),
            (visible[seen], truth.visible_boxes_px[order][seen]),
            (columns["box"].reshape(-1, 4)[drawn], found.boxes_px),
        ):
            np.testing.assert_allclose(boxes * quantum, boxes_px, atol=quantum / 2 + 1e-9)
    unpacked = read(page)
    facts, columns, boxes = unpacked.facts, unpacked.columns, {}
    for frame, (first, stop) in enumerate(pairwise(columns["shapeStart"])):
        for shape in range(first, stop):
            corners = np.concatenate(unpacked.outlines[shape])
            boxes[frame, columns["owner"][shape]] = np.concatenate([corners.min(axis=0), corners.max(axis=0)])
    frames = np.repeat(np.arange(len(columns["truthStart"]) - 1), np.diff(columns["truthStart"]))
    assert len(boxes) == len(frames) > 100
    drawn = np.array([boxes[key] for key in zip(frames, columns["vessel"], strict=True)]) * facts["quantum"]
    np.testing.assert_allclose(drawn, columns["full"].reshape(-1, 4) * facts["quantum"], atol=1.01 * facts["quantum"])
    run = json.loads((run_folder / "run.json").read_text())
    counts, by_camera = run["counts"], run["camera_counts"]
    titles = {"vessel_frames": "Vessels in frames", "fully_hidden": "Wholly hidden", "mislabelled": "Wrong class"}
    titles |= {"false_positives": "False positives", "below_half_iou": "IoU below 0.5"}
    titles["off_vessel"] = "Off their vessel"
    alike = ("frames", "partly_hidden", "annotated", "detected", "missed")
    titles |= {name: name.replace("_", " ").capitalize() for name in alike}
    said = {title: whole(number) for title, number, *_ in table_after(page, "What happened")}
    assert said == {title: counts[name] for name, title in titles.items()}
    names = ("annotated", "detected", "missed", "mislabelled", "below_half_iou", "off_vessel", "false_positives")
    state, vessel = (2, 3, 4, 6, 7, 8, 9), (4, 5, 6, 8, 9, 10)
    tables = {"By vessel": vessel, "By performance state of the detector": state, "By camera": state}
    for title, columns in tables.items():
        rows = table_after(page, title)[1:]
        sums = [sum(whole(row[column]) for row in rows) for column in columns]
        assert sums == [counts[name] for name in names][: len(columns)], title
    for row in table_after(page, "By camera")[1:]:
        assert [whole(row[i]) for i in (1, *state)] == [by_camera[row[0]][name] for name in ("frames", *names)]


def first_said(page):
    """Name, number and meaning of what the page says first, and the numbers of its warning of bad boxes, if any."""
    text = page.read_text(encoding="utf-8").replace("\u00a0%", " %")
    assert text.index('<dl class="result">') < text.index('id="stage"')
    tiles = re.findall(r"<div><dt>(.*?)</dt><dd>([\d,]+)</dd><dd>(.*?)</dd></div>", text)
    pattern = r"<strong>([\d.]+ %) of the boxes do not fit .*?</strong>"
    pattern += r" ([\d,]+) of ([\d,]+) true .*?; ([\d,]+) of them do not touch"
    warning = re.search(pattern, text, re.DOTALL)
    return {name: (whole(number), meaning) for name, number, meaning in tiles}, warning and list(warning.groups())


def test_player_has_each_outcome_and_the_result_first_with_any_warning(mistaken_page, mistaken_folder, tmp_path):
    (facts, columns), frames = unpack(mistaken_page), list(open_run(mistaken_folder).frames())
    assert facts["outcomes"] == {flag.name: flag.value for flag in Outcome}
    assert columns["outcome"].tolist() == [outcome for frame in frames for outcome in frame_outcomes(frame)]
    kinds = [facts["kinds"][kind] for kind in columns["kind"]]
    assert kinds == [kind for frame in frames for kind in frame.detections.kinds]
    counts = json.loads((mistaken_folder / "run.json").read_text())["counts"]
    of_vessels = counts["detected"] - counts["merged"]
    every, annotated = of_vessels + counts["false_positives"], counts["annotated"]

    def share(name: str, of_all: int, of: str) -> tuple[int, str]:
        return counts[name], f"{100 * counts[name] / of_all:.1f} % of {of}"

    assert counts["merged"] > 0  # so that detections of vessels are not the detected vessels
    tiles, warning = first_said(mistaken_page)
    bad, off = counts["below_half_iou"], counts["off_vessel"]
    assert warning == [f"{100 * bad / of_vessels:.1f} %", *(f"{count:,}" for count in (bad, of_vessels, off))]
    assert tiles == {
        "Annotated": (annotated, "vessels in frames, given to the detector"),
        "Detected": share("detected", annotated, "annotated"),
        "Missed": share("missed", annotated, "annotated"),
        "False positives": share("false_positives", every, f"{every:,} detections"),
        "Wrong class": share("mislabelled", of_vessels, f"{of_vessels:,} true detections"),
        "IoU below 0.5": share("below_half_iou", of_vessels, f"{of_vessels:,} true detections"),
        "Off their vessel": share("off_vessel", of_vessels, f"{of_vessels:,} true detections"),
    }
    path = mistaken_strait(tmp_path, steps=10)
    detector = yaml.safe_load((tmp_path / "detector.yaml").read_text(encoding="utf-8"))
    for state in detector["states"].values():
        state["box_error"]["covariance"] = (1e-6 * np.eye(4)).tolist()
    (tmp_path / "detector.yaml").write_text(yaml.safe_dump(detector), encoding="utf-8")
    run_scene(load_scene(path), tmp_path / "run")
    tiles, warning = first_said(write_report(open_run(tmp_path / "run")))
    assert tiles["Detected"][0] > 0 and warning is None


def test_same_run_gives_the_same_page_and_every_kth_step_is_shown_and_all_are_counted(page, run_folder, tmp_path):
    text = page.read_text(encoding="utf-8").replace("<wbr>", "")
    settings = text.partition("All settings of the run</summary>")[2].partition("</table>")[0]
    said = dict(re.findall(r"<tr><th>(.*?)</th><td>(.*?)</td></tr>", settings))
    run = json.loads((run_folder / "run.json").read_text())
    shown = [said[name] for name in ("scene_sha256", "seed", "versions.numpy")]
    assert shown == [run["scene_sha256"], str(run["seed"]), run["versions"]["numpy"]]
    assert write_report(open_run(run_folder), tmp_path / "again.html").read_bytes() == page.read_bytes()
    copy = shutil.copytree(run_folder, tmp_path / "run")
    (copy / "verify.html").write_text("")
    text = write_report(open_run(copy), copy / "sub" / "page.html").read_text(encoding="utf-8")
    assert 'href="../verify.html"' in text and "compare.html" not in text
    thinned = write_report(open_run(run_folder), tmp_path / "some.html", every=7)
    facts, columns = unpack(thinned)
    all_facts, everything = unpack(page)
    assert "One of 7 steps is shown" in thinned.read_text(encoding="utf-8")
    assert facts["steps"] == list(range(0, STEPS, 7)) and facts["timestamps"] == all_facts["timestamps"][::7]
    cameras = len(facts["cameras"])
    for starts in ("truthStart", "drawnStart"):
        counts = np.diff(everything[starts]).reshape(-1, cameras)[::7].ravel()
        np.testing.assert_array_equal(np.diff(columns[starts]), counts)
        assert columns[starts][-1] == counts.sum() > 0
    assert len(columns["vessel"]) == columns["truthStart"][-1]
    horizons = everything["horizon"].reshape(-1, cameras, 3)[::7].ravel()
    np.testing.assert_array_equal(columns["horizon"], horizons)
    assert table_after(thinned, "What happened") == table_after(page, "What happened")


def test_a_long_page_stays_small_one_may_be_without_vessels_and_is_not_without_a_step(tmp_path):
    run_scene(load_scene("simulation_1", mode=2, source="analytic"), tmp_path / "long")
    page = write_report(open_run(tmp_path / "long"))
    assert '"length":1500' in page.read_text(encoding="utf-8") and page.stat().st_size < 500_000
    boats = {"astern": ([30.0, 8.0, 9.0], [[0, -300, 60], [2, -300, 50]])}
    run_scene(load_scene(str(write_scene(tmp_path, boats, steps=3)), source="analytic"), tmp_path / "run")
    assert len(read(write_report(open_run(tmp_path / "run"))).shown) == 3
    with pytest.raises(RunDirectoryError, match="nothing to show"):
        write_report(replace(open_run(tmp_path / "run"), steps=0))


def test_interrupted_run_shows_what_is_there_and_says_so(tmp_path, page):
    scene = load_scene("simulation_3", mode=2, seed=5, steps=STEPS + 300, source="analytic")
    cut = open_run(interrupt(scene, tmp_path / "cut"))
    text = (written := write_report(cut)).read_text(encoding="utf-8")
    assert f"This run was interrupted.</strong> {cut.steps} of {STEPS + 300} steps" in text
    assert f"<td>{cut.steps} of {STEPS + 300}: the run was interrupted</td>" in text
    *_, kept = run_inputs(cut)
    (file,) = (cut.folder / "unfinished").glob("truth_*.npz")
    line = f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n"
    assert kept.sha256 == hashlib.sha256(line.encode()).hexdigest()
    (facts, columns), (_, whole) = unpack(written), unpack(page)
    assert len(facts["steps"]) == cut.steps
    shared = min(cut.steps, STEPS) * len(facts["cameras"])
    np.testing.assert_array_equal(columns["truthStart"][:shared], whole["truthStart"][:shared])
    np.testing.assert_array_equal(columns["confidence"][: whole["drawnStart"][shared]][:100], whole["confidence"][:100])


def test_command_says_where_it_writes_and_bad_input_is_one_message(call, run_folder, tmp_path):
    page, folder = tmp_path / "new" / "long.html", tmp_path / "new" / "long_parts"
    arguments = "report", run_folder, "--out", page, "--every", 10, "--parts"
    status, said = call(*arguments)
    assert status == 0 and {str(page), str(folder)} <= set(re.split(r"[\s,:]+", said.replace("\n", "")))
    text = page.read_text(encoding="utf-8")
    assert [path.name for path in folder.iterdir()] == ["A-0.js"]
    assert 'id="part-' not in text and "script-src 'sha256-" in text
    assert [call(*arguments, *more)[0] for more in ((), ("--overwrite",))] == [2, 0]
    (folder / "notes.txt").touch()
    status, said = call(*arguments, "--overwrite")
    assert status == 2 and str(folder) in said
    missing, empty, file = (tmp_path / name for name in ("nowhere", "empty", "file"))
    empty.mkdir()
    file.touch()
    for arguments, named in (([missing], missing), ([empty], empty), ([run_folder, "--out", file / "page.html"], file)):
        status, said = call("report", *arguments)
        assert status == 2 and str(named) in said


@given(st.lists(st.floats(0, 1), min_size=1, max_size=50))
def test_what_is_seen_in_part_is_never_rounded_to_all_or_nothing(fractions):
    counted = in_250ths(np.array([*fractions, np.nan]))
    assert counted[-1] == UNKNOWN_FRACTION
    for fraction, count in zip(fractions, counted, strict=False):
        assert (count == 0) == (fraction == 0) and (count == WHOLE) == (fraction == 1)
        assert abs(count / WHOLE - fraction) <= 1 / WHOLE


@given(st.integers(1, 60_000), st.integers(1, 60_000))
def test_every_place_in_an_image_fits_into_16_bits(width, height):
    quantum = quantum_px([(width, height)])
    counted = in_quanta(np.array([0.0, width, height, np.nan]), quantum)
    np.testing.assert_allclose(counted[:3] * quantum, [0, width, height], atol=quantum / 2 + 1e-9)
    assert counted[3] == NONE > counted[:3].max()
    assert quantum == 0.1 or max(width, height) > 6500
