"""The folder of tracks that modsim3d writes."""

import json
import tempfile
from pathlib import Path

import hypothesis.strategies as st
import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings

from modsim3d.core.errors import ModsimError, OutputError
from modsim3d.runs.files.overwrite import file_list
from modsim3d.runs.run_rows import RunRows
from modsim3d.tracks.reading import read_tracks, write_tracks
from modsim3d.tracks.tracks import Origin, Tracks, TrackSet
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
