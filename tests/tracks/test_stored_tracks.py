"""The folder of tracks that modsim3d writes; identities of a run's truth, and which track follows which vessel."""

import json
import tempfile
from pathlib import Path
from typing import Any

import hypothesis.strategies as st
import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings

from modsim3d.core.errors import ModsimError, OutputError
from modsim3d.runs.files.overwrite import file_list
from modsim3d.runs.run_rows import RunRows
from modsim3d.scene.scene import Scene
from modsim3d.tracks.reading import read_tracks, write_tracks
from modsim3d.tracks.tracks import Origin, Similarity, Tracks, TrackSet
from modsim3d.tracks.true_tracks import TrueTracks, best_pairs, follow
from tests.run_folders import finished
from tests.scenes import camera_keys
from tests.tracking.hand_made import box
from tests.tracking.hand_made import rows_of as rows_by_hand
from tests.tracks.track_files import scene_run

ORIGIN = Origin("toy", {"gate": 3.5, "names": ["a"]}, "By hand.", "toys 1.2", {"numpy": "2.0"})
COLUMNS = ("frame", "track", "boxes_px", "label", "confidence", "covariance_px2")


def assert_equal(one, other):
    assert one.cameras == other.cameras
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.fixture
def written(small_run, small_tracks, tmp_path):
    write_tracks(tmp_path / "toy", small_run, TrackSet("toy", small_tracks, ORIGIN), overwrite=False)
    return tmp_path / "toy"


def change_facts(folder, change):
    facts = json.loads((folder / "tracks.json").read_text())
    change(facts)
    (folder / "tracks.json").write_text(json.dumps(facts))


@settings(max_examples=10, deadline=None)
@given(st.data())
def test_tracks_are_read_back_as_they_were_written(small_run, small_rows, data):
    row = st.tuples(st.sampled_from(small_rows.frames.tolist()), st.integers(0, 2**62))
    keys = data.draw(st.lists(row, unique=True, max_size=12))
    frame, track = np.array(keys, dtype=np.int64).reshape(-1, 2).T
    count, rng = len(keys), np.random.default_rng(data.draw(st.integers(0, 99)))
    corner = rng.uniform(-50, 900, (count, 2))
    unknown = rng.random(count) < 0.5
    spread = np.linalg.inv(np.eye(2) + 0.1 * np.ones((count, 2, 2)))
    boxes_px = np.column_stack([corner, corner + rng.uniform(1, 80, (count, 2))])
    label = rng.integers(-1, len(small_rows.scene.detector.labels), count)
    confidence = np.where(unknown, np.nan, rng.random(count))
    covariance = np.where(unknown[:, None, None], np.nan, spread)
    tracks = Tracks.of(len(small_rows.scene.cameras), frame, track, boxes_px, label, confidence, covariance)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "tracks"
        write_tracks(folder, small_run, TrackSet("a name", tracks, ORIGIN), overwrite=False)
        found = read_tracks(folder, small_run, small_rows)
    assert (found.name, found.origin) == ("a name", ORIGIN)
    assert_equal(found.tracks, tracks)


def test_the_same_tracks_give_the_same_bytes_and_columns_say_what_they_are(written, small_run, small_rows, tmp_path):
    write_tracks(tmp_path / "again", small_run, read_tracks(written, small_run, small_rows), overwrite=False)
    for path in sorted(written.iterdir()):
        assert (tmp_path / "again" / path.name).read_bytes() == path.read_bytes()
    for field in pq.read_schema(written / "tracks.parquet"):
        assert set(field.metadata) == {b"unit", b"description"} and field.metadata[b"description"]
        assert field.metadata[b"unit"].decode() == {"px": "px", "px2": "px²"}.get(field.name.split("_")[-1], "")


def test_tracks_are_not_written_over_and_those_of_another_seed_are_refused(written, small_run, small_tracks, tmp_path):
    with pytest.raises(OutputError, match="overwrite=True"):
        write_tracks(written, small_run, TrackSet("toy", small_tracks, ORIGIN), overwrite=False)
    write_tracks(written, small_run, TrackSet("toy", small_tracks.take(np.arange(3)), ORIGIN), overwrite=True)
    assert pq.read_metadata(written / "tracks.parquet").num_rows == 3
    with pytest.raises(ModsimError, match="no origin"):
        write_tracks(tmp_path / "x", small_run, TrackSet("mine", small_tracks, None), overwrite=False)
    other = scene_run(tmp_path / "run", "strait", seed=4)
    with pytest.raises(ModsimError, match=r"another run: seed was 3, and is 4"):
        read_tracks(written, other, RunRows.of(other))


FILES = ("tracks.json", "tracks.parquet")


def changing(change):
    return lambda folder: change_facts(folder, change)


DAMAGES = [
    (changing(lambda facts: facts.pop("chosen")), "chosen: missing"),
    (changing(lambda facts: facts.update(format=2)), "format"),
    (changing(lambda facts: facts.update(more=1)), "more: unknown key"),
    (changing(lambda facts: facts["run"].update(detections_sha256="0" * 64)), "are of other detections"),
    (lambda folder, f=FILES[1]: (folder / f).write_bytes((folder / f).read_bytes()[:-9]), "was changed or damaged"),
    *((lambda folder, name=name: (folder / name).unlink(), rf"{name}:\s+no such file") for name in FILES),
]


@pytest.mark.parametrize(("damage", "said"), DAMAGES)
def test_a_folder_that_is_no_longer_what_was_written_is_refused(written, small_run, small_rows, damage, said):
    damage(written)
    with pytest.raises(ModsimError, match=said):
        read_tracks(written, small_run, small_rows)


@pytest.mark.parametrize(("change", "said"), [
    (lambda table: table.drop_columns("label"), "column 'label' is missing"),
    (lambda table: table.append_column("more", table["step"]), "column 'more' is unknown"),
    (lambda table: table.set_column(3, "track", table["step"].cast("int32")), "type int32, must have int64"),
    (lambda table: table.set_column(1, "step", table["track"]), "takes no frame|there is no step"),
    (lambda table: table.set_column(7, "x_max_px", table["x_min_px"]), "row 0: the box has width 0"),
    (lambda table: table.take([0, 1, 1]), r"row 2: track \d+ is at step 0 of camera 'bow' already \(row 1\)"),
])  # fmt: skip
def test_a_wrong_table_is_refused(written, small_run, small_rows, change, said):
    table = pq.read_table(written / "tracks.parquet")
    pq.write_table(change(table), written / "tracks.parquet")
    listed = file_list(written, ["tracks.parquet"])
    change_facts(written, lambda facts: facts.update(files=listed))
    with pytest.raises(ModsimError, match=said):
        read_tracks(written, small_run, small_rows)


BOAT = {"length_m": 10, "beam_m": 4, "air_draft_m": 5, "label": "Vessel"}
CAMERA = camera_keys(400, 200, pose={"position_m": [0, 0, 3]})  # along w1: at 100 m it sees 20 m to either side
FRONT, BEHIND, ASIDE, AWAY = (100.0, 0.0), (200.0, 0.0), (100.0, 10.0), None
Place = tuple[float, float] | None


def rows_of(folder: Path, ways: dict[str, list[Place]], **annotation: object) -> RunRows:
    """A run of boats that show the camera their side, with their places a second apart, None for absent."""
    positions = np.array([[place or (np.nan, np.nan) for place in way] for way in ways.values()]).swapaxes(0, 1)
    headings = np.where(np.isnan(positions[:, :, 0]), np.nan, np.pi / 2)
    scene = {
        **{"vessels": dict.fromkeys(ways, BOAT), "cameras": {"c": CAMERA}, "detector": "thesis"},
        "poses": {"positions_m": positions, "headings_rad": headings, "time_step_s": 1.0},
        "annotation": {"mode": 1, "source": "analytic", **annotation},
    }
    return RunRows.of(finished(Scene.from_dict(scene), folder))


@pytest.mark.parametrize(("away_s", "identities"), [(1, 1), (2, 1), (3, 2)])
def test_a_vessel_that_was_away_for_longer_than_the_gap_is_a_new_identity(tmp_path, away_s, identities) -> None:
    rows = rows_of(tmp_path / "run", {"a": [FRONT, FRONT, *[AWAY] * (away_s - 1), FRONT]})
    assert len(np.unique(TrueTracks.of(rows, gap_s=2).identity)) == identities
    assert len(np.unique(TrueTracks.of(rows, gap_s=0).identity)) == (1 if away_s == 1 else 2)


def test_an_absence_as_long_as_the_gap_is_none_and_a_hidden_vessel_keeps_its_identity(tmp_path):
    for frame in range(20):
        rows = rows_by_hand([(frame, 0, box()), (frame + 10, 0, box())], 31, step_s=0.2)
        assert TrueTracks.of(rows, gap_s=2).identity.tolist() == [0, 0]
        assert TrueTracks.of(rows, gap_s=1.999).identity.tolist() == [0, 1]
    rows = rows_of(tmp_path / "run", {"a": [FRONT] * 6, "b": [(200.0, 30.0), *[BEHIND] * 4, (200.0, 30.0)]})
    truth = TrueTracks.of(rows, gap_s=0)
    b = truth.vessel == 1
    assert len(np.unique(truth.identity[b])) == 1
    assert truth.hidden[b].tolist() == [False, True, True, True, True, False]
    assert (truth.scored == ~truth.hidden).all()
    assert np.isfinite(truth.boxes_px).all()  # the box of the whole vessel where nothing is visible
    rows = rows_of(tmp_path / "thesis", {"a": [FRONT], "b": [BEHIND]}, mode=0)
    assert rows.annotated.all() and TrueTracks.of(rows).scored.tolist() == [True, False]


def test_full_truth_has_all_whole_vessels_and_annotated_truth_what_mode_and_filter_take(tmp_path) -> None:
    """Half of b's 50 px stand behind a: its whole box is 50 px wide, its visible one 25 px and a little more."""
    rows = rows_of(tmp_path / "run", {"a": [FRONT], "b": [(200.0, 10.0)]}, mode=2)
    annotated, full = (TrueTracks.of(rows, name).boxes_px[1] for name in ("annotated", "full"))
    assert full[2] - full[0] > 49 and 24 < annotated[2] - annotated[0] < 30
    rows = rows_of(tmp_path / "far", {"a": [FRONT], "b": [(2000.0, 300.0)]}, min_visible_px=100)
    annotated, full = (TrueTracks.of(rows, name).scored.tolist() for name in ("annotated", "full"))
    assert (annotated, full) == ([True, False], [True, True]) and not TrueTracks.of(rows).hidden.any()


Row = tuple[int, int, float]  # frame, identity or track, and the left edge of a box of 10 × 10 px


def box_at(x_px: float) -> list[float]:
    return [x_px, 0, x_px + 10, 10]


def true_tracks(rows: list[Row], hidden: tuple[int, ...] = ()) -> TrueTracks:
    frame, identity, boxes = (np.array(column) for column in zip(*((f, i, box_at(x)) for f, i, x in rows), strict=True))
    unseen = np.isin(np.arange(len(rows)), hidden)
    return TrueTracks(1, np.arange(len(rows)), frame, identity, identity, 0 * identity, boxes, ~unseen, unseen)


def tracks(rows: list[Row]) -> Tracks:
    return Tracks.of(1, *(np.array(column) for column in zip(*((f, t, box_at(x)) for f, t, x in rows), strict=True)))


def test_a_track_keeps_its_vessel_while_alike_enough_and_on_a_hidden_one_is_neither_right_nor_wrong():
    """The vessels, the tracks, and the row of the track that follows each vessel."""
    start, later = [(0, 7, 0.0)], [(2, 7, 3.0), (2, 8, 1.0)]
    for why, vessels, others, expected in (
        ("another is more alike, by 9/11", [(0, 1, 0), (1, 1, 0)], [*start, (1, 7, 3), (1, 8, 1)], [0, 1]),
        ("no track in a frame", [(0, 1, 0), (1, 1, 0), (2, 1, 0)], [*start, *later], [0, -1, 1]),
        ("no vessel in a frame", [(0, 1, 0), (2, 1, 0)], [*start, (1, 7, 0.0), *later], [0, 2]),
        ("alike no longer, by 6/14", [(0, 1, 0), (1, 1, 0)], [*start, (1, 7, 4), (1, 8, 1)], [0, 2]),
        # Of new pairs the sum of similarities decides: track 7 is nearest to 2, but then 1 would have nothing.
        ("new pairs", [(0, 1, 0), (0, 2, 4)], [(0, 7, 3), (0, 8, 6)], [0, 1]),
    ):
        found = follow(true_tracks(vessels), tracks(others), Similarity())
        assert found.track_row.tolist() == expected, why
        assert found.truth_row[found.track_row[found.found]].tolist() == np.flatnonzero(found.found).tolist(), why
    truth = true_tracks([(0, 1, 0), (0, 2, 100)], hidden=(1,))
    found = follow(truth, tracks([(0, 7, 0), (0, 8, 100), (0, 9, 500)]), Similarity())
    assert (found.counted.tolist(), found.false.tolist()) == ([True, False, True], [False, False, True])
    found = follow(truth.take(np.array([], dtype=int)), tracks([(0, 7, 0)]), Similarity())
    assert (found.counted.tolist(), found.false.tolist()) == ([True], [True])


def test_centre_similarity_falls_linearly_to_the_scale_and_one_that_cannot_be_is_refused() -> None:
    others = np.array([box_at(0), box_at(5), box_at(20), box_at(90)])
    alike = Similarity("centre", scale_px=20)(np.array([box_at(0)]), others)
    np.testing.assert_allclose(alike, [1, 0.75, 0, 0])
    wrong: tuple[tuple[dict[str, Any], str], ...] = (
        ({"name": "centre"}, "similarity centre needs scale_px"),
        ({"scale_px": 5.0}, "a scale is for similarity centre"),
        ({"name": "centre", "scale_px": 0.0}, "the scale of similarity centre must be above 0"),
        ({"least": 0.0}, "^threshold must be above 0"),
        ({"least": 1.5}, "^threshold must be above 0 and at most 1"),
    )
    for given_keys, message in wrong:
        with pytest.raises(ModsimError, match=message):
            Similarity(**given_keys)


@given(st.integers(0, 5), st.integers(0, 5), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_pairs_are_the_best_of_all_assignments(a: int, b: int, seed: int) -> None:
    """Against all assignments one by one."""
    alike = np.random.default_rng(seed).uniform(size=(a, b))
    i, j = best_pairs(alike, 0.5, np.zeros((a, b), dtype=bool))
    assert (alike[i, j] >= 0.5).all() and len(set(i.tolist())) == len(i) and len(set(j.tolist())) == len(j)
    assert alike[i, j].sum() == pytest.approx(best_sum(alike, 0))


def best_sum(alike: np.ndarray, row: int, taken: frozenset[int] = frozenset()) -> float:
    if row == len(alike):
        return 0.0
    free = (column for column in range(alike.shape[1]) if column not in taken and alike[row, column] >= 0.5)
    worth = (alike[row, column] + best_sum(alike, row + 1, taken | {column}) for column in free)
    return max(best_sum(alike, row + 1, taken), *worth, 0.0)


def test_cameras_remember_on_their_own_and_numbers_of_tracks_are_their_own() -> None:
    """Two cameras: frames 0 and 2 are of the first, 1 of the second."""
    rows, boxes = np.arange(3), np.array([box_at(0)] * 3)
    truth = TrueTracks(2, rows, rows, rows * 0, np.array([0, 1, 0]), rows * 0, boxes, rows >= 0, rows < 0)
    boxes = np.array([box_at(0), box_at(0), box_at(3), box_at(1)])
    given = Tracks.of(2, np.array([0, 1, 2, 2]), np.array([7, 9, 7, 8]), boxes)
    assert follow(truth, given, Similarity()).track_row.tolist() == [0, 1, 2]
    numbers = Tracks.of(2, np.array([3, 0, 1, 2]), np.array([5, 5, 5, 4]), np.zeros((4, 4)))
    assert (numbers.frame.tolist(), numbers.identity.tolist()) == ([0, 1, 2, 3], [1, 2, 0, 2])
