"""A recording in parts: the same frames, moments and counts wherever it is cut, and what the browser makes of them."""

import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from modsim3d.runs.stored_run import StoredRun, open_run
from modsim3d.view.report import overview, part_columns
from modsim3d.view.report.overview import BEGINS, ENDS, Overview, ShownRows, VesselOutcome, steps_in_a_bin
from modsim3d.view.report.packing import StretchesBuilder
from modsim3d.view.report.recorder import clock, recording, said
from modsim3d.view.report.report import parts_folder, write_report
from modsim3d.world.poses.base import generated_timestamps
from tests.view.report.test_side_by_side import outcome_in
from tests.view.report.unpacking import Unpacked, read

PART = 7


@pytest.fixture(scope="module")
def run(mistaken_folder: Path) -> StoredRun:
    """A camera on board and one ashore with a frame rate of its own, obstacles, every kind of mistake."""
    return open_run(mistaken_folder)


@pytest.fixture(scope="module")
def whole(mistaken_page: Path) -> Unpacked:
    return read(mistaken_page)


@pytest.fixture(scope="module")
def cut_pages(run: StoredRun, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """With the parts in the page, and in files."""
    folder = tmp_path_factory.mktemp("cut into parts")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(part_columns, "MAX_SHOWN", PART)
        return write_report(run, folder / "cut.html"), write_report(run, folder / "run page.html", in_files=True)


def test_frames_and_moments_are_the_same_wherever_a_run_is_cut(cut_pages, whole):
    cut = read(cut_pages[0])
    assert cut.facts["parts"] == -(-whole.facts["length"] // PART) > whole.facts["parts"] == 1
    assert cut.stored > whole.stored  # a frame that is still shown is in the next part again
    for name in ("shown", "taken"):
        np.testing.assert_array_equal(getattr(cut, name), getattr(whole, name))
    for both in ("columns", "overview"):
        one, other = getattr(cut, both), getattr(whole, both)
        assert set(one) == set(other)
        for name, column in one.items():
            np.testing.assert_array_equal(column, other[name], err_msg=name)
    for mine, others in zip(cut.outlines, whole.outlines, strict=True):
        assert [line.tolist() for line in mine] == [line.tolist() for line in others]


def test_moments_and_counts_are_those_of_the_frames(whole):
    facts, columns = whole.facts, whole.columns
    for camera in range(len(facts["cameras"])):
        missed = []
        for index, frame in enumerate(whole.shown[:, camera].tolist()):
            rows = slice(*columns["truthStart"][frame : frame + 2]) if frame >= 0 else slice(0)
            lost = columns["vessel"][rows][columns["flags"][rows] == 1]
            assert whole.overview[f"{camera}.missed"][index] == len(lost)
            missed += [(vessel, index) for vessel in lost.tolist()]
        kept = [whole.overview[f"{camera}.moments.missed.{name}"].tolist() for name in ("index", "long", "key")]
        moments = zip(*kept, strict=True)
        covered = [(vessel, index) for first, long, vessel in moments for index in range(first, first + long + 1)]
        assert sorted(covered) == sorted(missed) and kept[0] == sorted(kept[0])


def test_stretches_of_outcomes_are_what_became_of_each_vessel(run):
    names, expected = run.scene.vessel_names, {}
    for frame in (each for each in run.frames() if each.camera == run.scene.cameras[0].name):
        for row, name in enumerate(frame.truth.vessels):
            expected[name, frame.step] = outcome_in(frame, row)
    found = recording(run).outcomes[0]
    covered = {
        (names[vessel], step): VesselOutcome(outcome)
        for vessel, outcome, first, until in zip(found.vessel, found.outcome, found.first, found.until, strict=True)
        for step in range(first, until + 1)
    }
    assert covered == expected and set(expected.values()) == set(VesselOutcome)
    follows = (np.diff(found.vessel) == 0) & (found.until[:-1] + 1 == found.first[1:])
    assert np.all(np.diff(found.outcome)[follows])  # one stretch ends where the outcome changes


def test_bins_hold_the_sums_of_their_steps(monkeypatch):
    steps, vessels, rng = 47, 3, np.random.default_rng(0)

    def columns() -> dict[str, np.ndarray]:
        made = Overview(steps, vessels, 2)
        made.add(shown)
        return {name: getattr(each, "values", each) for name, each in made.columns("", half=False).items()}

    rows, drawn = rng.permutation(steps * vessels)[:100], np.arange(40)
    masks = rng.random(100) < 0.8, rng.random(100) < 0.3  # annotated, missed
    of_truth = (rows // vessels, rows % vessels, *masks, rng.integers(0, 251, 100), np.ones((100, 2)))
    of_detections = (rows[drawn] // vessels, rows[drawn] % vessels, rng.choice([0, 1, 2, 4, 12], 40))
    shown = ShownRows(np.arange(steps), np.repeat([0, 1], [30, 17]), *of_truth, *of_detections)
    whole = columns()
    assert whole["vessels.fraction"].sum() == shown.fraction.sum()
    assert whole["false"].sum() == (shown.outcome == 1).sum()
    for name in ("MAX_BINS", "MIN_BINS"):
        monkeypatch.setattr(overview, name, 10)
    binned = columns()
    assert steps_in_a_bin(steps, vessels) == 5
    for name in (*overview.COUNTS, *(f"vessels.{each}" for each in overview.VESSEL_COUNTS)):
        sums = np.add.reduceat(whole[name].reshape(-1, steps), np.arange(0, steps, 5), axis=1).ravel()
        np.testing.assert_array_equal(binned[name], sums)
        assert sums.sum() > 0
    assert binned["state"].tolist() == [0] * 6 + [1] * 4
    for name in (each for each in whole if each.startswith("moments")):
        np.testing.assert_array_equal(binned[name], whole[name])


def test_places_are_those_of_the_scene(whole, run):
    scene, columns = run.scene, whole.columns
    poses = scene.poses.poses(0, run.steps)
    there = columns["placed"].reshape(-1, len(scene.vessels)) > 0
    np.testing.assert_array_equal(there, poses.present)
    places = columns["place"].reshape(*there.shape, 2) / 100
    np.testing.assert_allclose(places[there], poses.positions_m[there][:, :2], atol=0.0051)
    turned = columns["heading"].reshape(there.shape) * (2 * np.pi / 65536) - poses.headings_rad
    assert np.abs(np.angle(np.exp(1j * turned)))[there].max() < 1e-4
    low, high = whole.facts["extent"]
    assert ((low < poses.positions_m[..., :2]) & (poses.positions_m[..., :2] < high)).all()
    assert len(whole.facts["obstacles"]) == len(scene.obstacles) > 0


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 20)), unique=True), st.integers(1, 20))
def test_stretches_cover_what_was_added_and_do_not_touch(pairs, part):
    builder = StretchesBuilder()
    for first in range(0, 21, part):
        some = [pair for pair in pairs if first <= pair[1] < first + part]
        builder.add(*np.array(some, dtype=np.int64).reshape(-1, 2).T)
    found = builder.stretches()
    stretches = list(zip(found.key.tolist(), found.first.tolist(), found.until.tolist(), strict=True))
    assert [(key, index) for key, first, until in stretches for index in range(first, until + 1)] == sorted(pairs)
    assert {(key, until + 1) for key, _, until in stretches}.isdisjoint((key, first) for key, first, _ in stretches)


@given(st.integers(-(10**6), 10**6), st.integers(1, 5000), st.integers(1, 4), st.integers(1, 30))
def test_times_come_back_as_they_were_written(first, by, decimals, count):
    texts = [said(first + i * by, decimals) for i in range(count)]
    facts, columns = clock(texts)
    assert float(texts[0]) == pytest.approx(first / 10**decimals)
    units = facts["first"] + np.cumsum(columns["clock"].values)
    assert [said(int(unit), facts["decimals"]) for unit in units] == texts


def test_times_of_a_scene_are_whole_numbers_and_those_that_are_no_plain_decimals_are_kept_as_they_are():
    facts, columns = clock(generated_timestamps(6, 0.25))  # 0.0, 0.25, 0.5
    assert (facts, columns["clock"].values.tolist()) == ({"decimals": 2, "first": 0}, [0, 25, 25, 25, 25, 25])
    for texts in (["1", "2"], ["0.0", "1e3"], ["0.10", "0.2"], ["0.0", "99999999999.0"]):
        facts, columns = clock(texts)
        assert facts == {} and columns["clockTexts"].tobytes().decode().split("\n") == texts


AROUND = 20  # as in recording.js
FRAME = """JSON.stringify((it => [0, 1].map((camera) => [it.shapes({0}, camera).map((shape) => it.lines(shape)),
    it.truths({0}, camera), it.detections({0}, camera), it.state({0}, camera)]))(player.recording))"""


def test_the_browser_reads_the_same_from_parts_in_the_page_and_in_files(browser, run, whole, cut_pages):
    last, seen = run.steps - 1, []
    assert len(list(parts_folder(cut_pages[1]).iterdir())) == -(-run.steps // PART)
    for page in cut_pages:
        browser.open(page)
        said = [browser.run(f"player.recording.load({i}).then(() => {FRAME.format(i)})") for i in (0, 8, last)]
        seen.append([browser.run("player.recording.facts.timestamps"), *said])
        walk = f"for (let i = 0; i <= {last}; i += 3) await player.go(i); await player.go({last});"
        browser.run(f"(async () => {{ {walk} }})()")
        assert browser.run("player.recording.parts.size") < 12
        assert browser.run("[player.recording.ready(player.index), player.recording.ready(0)]") == [True, False]
    assert seen[0] == seen[1]
    boxes = browser.run(f"player.recording.truths({last}, 0).map((each) => [each.vessel, ...each.full])")
    frame = int(whole.shown[-1, 0])
    rows = slice(*whole.columns["truthStart"][frame : frame + 2])
    full = whole.columns["full"].reshape(-1, 4)[rows] * whole.facts["quantum"]
    np.testing.assert_allclose(boxes, np.column_stack([whole.columns["vessel"][rows], full]))


def test_a_part_that_is_cut_off_or_missing_is_said(browser, cut_pages, tmp_path):
    page = Path(shutil.copytree(cut_pages[1].parent, tmp_path / "copy")) / cut_pages[1].name
    part = parts_folder(page) / "A-3.js"
    part.write_text("", encoding="utf-8")
    browser.open(page)
    browser.run(f"Promise.race([player.go({3 * PART}), new Promise(done => setTimeout(done, 1000))])")
    assert "A-3.js cannot be read" in browser.text("#failure") and browser.errors == []
    part.unlink()
    browser.open(page)
    browser.run(f"player.go({3 * PART})")
    assert "A-3.js cannot be read" in browser.text("#failure")
    assert browser.run("Promise.resolve(player.go(0)).then(() => document.querySelector('#failure').hidden)")
    wait = "new Promise(done => setTimeout(done, 100))"
    browser.run(f"Promise.resolve(player.go({3 * PART - AROUND})).then(() => {wait})")  # near it
    assert browser.run("document.querySelector('#failure').hidden")
    assert all("Uncaught" not in error for error in browser.errors)
    browser.errors.clear()  # those of the missing file


STEPS, VESSELS = 12, 3
FRACTIONS = st.sampled_from([None, 0, 250, *(int(limit) + k for limit in (BEGINS, ENDS) for k in (-1, 0, 1))])
RUNS = st.lists(st.lists(FRACTIONS, min_size=STEPS, max_size=STEPS), min_size=VESSELS, max_size=VESSELS)


def slowly(fractions: list[int | None]) -> list[bool]:
    """Whether one vessel is occluded at each step; it is not where it is not in the image."""
    occluded, found = False, []
    for fraction in fractions:
        occluded = fraction is not None and fraction <= (ENDS if occluded else BEGINS)
        found.append(occluded)
    return found


@settings(max_examples=60, deadline=None)
@given(RUNS, st.sets(st.integers(1, STEPS - 1)))
def test_occlusions_are_those_of_a_loop_over_steps_whatever_the_parts(fractions, cuts):
    overview = Overview(STEPS, VESSELS, 1)
    for start, stop in pairwise([0, *sorted(cuts), STEPS]):
        rows = [(i, v, fractions[v][i]) for i in range(start, stop) for v in range(VESSELS)]
        overview.add(shown_rows(np.arange(start, stop), [row for row in rows if row[2] is not None]))
    onsets = overview.stretches("hidden")
    found = np.zeros((VESSELS, STEPS), dtype=bool)
    for vessel, first, until in zip(onsets.key, onsets.first, onsets.until, strict=True):
        found[vessel, first : until + 1] = True
    np.testing.assert_array_equal(found, [slowly(each) for each in fractions])


def shown_rows(index, rows):
    """One camera at some steps: the step, the vessel and the visible fraction in 250ths of each row of the truth."""
    at, vessel, fraction = np.array(rows, dtype=np.int64).reshape(-1, 3).T
    none, every = np.empty(0, dtype=np.int64), np.ones(len(at), dtype=bool)
    of_truth = (at, vessel, every, ~every, fraction, np.zeros((len(at), 2), dtype=np.int64))
    return ShownRows(index, np.zeros_like(index), *of_truth, none, none, none.astype(np.uint8))
