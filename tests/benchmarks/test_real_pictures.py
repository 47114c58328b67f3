"""The comparison on real pictures, on small files in the form of the data sets; the page says what its numbers say."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks.campaigns.real_pictures import PAGE, RESULTS
from benchmarks.processes import ROOT
from benchmarks.real_pictures.compared import compared
from benchmarks.real_pictures.page import page
from benchmarks.real_pictures.sets import DETECTIONS, DETECTORS, LABELS, checksums, pictures, river, streets
from modsim3d.core.errors import ModsimError
from modsim3d.runs.run_rows import RunRows
from modsim3d.runs.stored_run import open_run
from modsim3d.tracks.true_tracks import TrueTracks

FRAMES, CARS, FILMS = 30, 4, (0, 1, 2, 3)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Cars that pass, a van, a region without labels, and a detector that misses a tenth of them."""
    folder, rng = tmp_path_factory.mktemp("data"), np.random.default_rng(0)
    found = folder / DETECTIONS / DETECTORS["rrc"].folder
    for each in (folder / LABELS, found):
        each.mkdir(parents=True)
    for film in FILMS:
        truth, detected = [], []
        for frame in range(FRAMES):
            truth.append(f"{frame} -1 DontCare -1 -1 -10 1100 20 1200 60 -1 -1 -1 -1000 -1000 -1000 -10")
            detected.append(f"{frame},1110,25,1150,50,0.9")
            for car in range(CARS):
                x, y = 100 + 250 * car + frame * (car - 1.5), 150 + 20 * car
                kind = "Van" if car == 3 else "Car"
                truth.append(
                    f"{frame} {car} {kind} 0 {car % 4} 0 {x} {y} {x + 90} {y + 60} 1.5 1.6 4 0 1 {15 + 10 * car} 0"
                )
                if rng.random() < 0.9:
                    box = np.array([x, y, x + 90, y + 60]) + rng.normal(0, 2, 4)
                    detected.append(f"{frame},{','.join(f'{side:.2f}' for side in box)},{rng.uniform(0.5, 1.2):.3f}")
        (folder / LABELS / f"{film:04d}.txt").write_text("\n".join(truth))
        (found / f"{film:04d}.txt").write_text("\n".join(detected))
    return folder


def test_films_are_compared_by_what_the_other_half_taught(data: Path, tmp_path: Path) -> None:
    films = pictures(data, tmp_path, "rrc", FILMS)
    run = open_run(films[0].run)
    truth, regions = run.table("truth"), run.scene.labels.regions
    seen = {name: set(truth[name].to_pylist()) for name in ("vessel", "visible_fraction")}
    assert seen == {"vessel": {"0", "1", "2"}, "visible_fraction": {0.3, 0.7, 1.0}}
    assert (len(regions), int(regions.crowd.sum())) == (2 * FRAMES, FRAMES)
    results = compared(films, tmp_path, seeds=1, workers=1)
    assert [film["name"] for film in results["films"]] == ["0000", "0001", "0002", "0003"]
    for tracker, each in results["differences"]["i"].items():
        assert each["hota"]["films"] == 4 and each["hota"]["real"] > 0.5, tracker
        assert abs(each["hota"]["mean"]) < 0.15, tracker
    text = page({"rrc": {"judged": results, "halves": results, "sha256": checksums(data, FILMS, "rrc")}})
    gap = results["differences"]["i"]["sort"]["hota"]["mean"]
    assert f"{abs(gap):.3f}" in text and "films that were kept for the end" in text and "box of 32 px to 96 px" in text
    (data / LABELS / "0000.txt").rename(data / LABELS / "gone.txt")
    with pytest.raises(ModsimError, match=r"0000.txt: cannot be read"):
        pictures(data, tmp_path / "other", "rrc", FILMS)


def test_a_river_is_ten_films_with_the_identities_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "fvessel").mkdir()
    lines = [f"{frame},{boat},{100 + frame + 500 * boat},700,200,80,1,1,1,1" for frame in range(100) for boat in (0, 1)]
    for name in ("gt_tracking", "re_detection"):
        (tmp_path / "fvessel" / f"Video-01_{name}.txt").write_text("\n".join(lines))
    films = river(tmp_path, tmp_path / "work")
    runs = [open_run(film.run) for film in films]
    assert [run.steps for run in runs] == [10] * 10
    assert all(len(np.unique(TrueTracks.of(RunRows.of(run)).identity)) == 2 for run in runs)
    assert all(run.settings["counts"]["detected"] == 20 for run in runs)


def test_streets_count_their_frames_from_one(tmp_path: Path) -> None:
    for name in ("TUD-Campus", "TUD-Stadtmitte"):
        (tmp_path / "tud" / name).mkdir(parents=True)
        for file, first, last in (("gt.txt", 7, 1), ("det.txt", -1, 0.5)):
            lines = [f"{frame},{first},{100 + frame},200,50,100,{last},-1,-1,-1" for frame in range(1, 31)]
            (tmp_path / "tud" / name / file).write_text("\n".join(lines))
    runs = [open_run(film.run) for film in streets(tmp_path, tmp_path / "work")]
    assert [(run.steps, run.settings["counts"]["detected"]) for run in runs] == [(30, 30)] * 2


def test_the_committed_page_says_what_its_numbers_say() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(json.loads(RESULTS.read_text(encoding="utf-8")))


def test_the_readme_says_how_far_hota_lies_apart() -> None:
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    films = json.loads((ROOT / "docs" / "campaigns" / "stand_in.json").read_text(encoding="utf-8"))
    cars = json.loads(RESULTS.read_text(encoding="utf-8"))
    for results, rung, sign, said in (
        (films, "i", 1, "was {} too high"),
        (films, "a", -1, "thesis's model made it {} too low"),
        (cars["rrc"]["judged"], "i", -1, "was {} too low behind one"),
        (cars["yolov3"]["judged"], "i", -1, "and {} behind another"),
    ):
        gaps = sorted(sign * each["hota"]["mean"] for each in results["differences"][rung].values())
        assert said.format(f"{gaps[0]:.2f} to {gaps[-1]:.2f}") in readme, (rung, gaps)
