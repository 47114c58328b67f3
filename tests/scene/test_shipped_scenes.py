"""Scenes as shipped, beside the source's tables, the authors' own program and campaigns; names of scenes."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import yaml
from numpy.typing import ArrayLike

from benchmarks.campaigns.traffic import RateTest, rates_of, verdict
from benchmarks.traffic_measures import Drawn, measure
from modsim3d import InputError, Scene, camera_placement, run_scene
from modsim3d.cli.run_summary import traffic_in_words
from modsim3d.core.arrays import Array
from modsim3d.io.input_files import data_folder
from modsim3d.runs.pipeline import open_renderer, truth_block
from modsim3d.scene.reading import draws_traffic, load_scene, shipped_scenes
from modsim3d.truth.rendered import rendered_occlusion
from modsim3d.verify.sources.compare import compare_sources
from modsim3d.world.encounters import hull_tracks
from modsim3d.world.poses.circular import swept_ring
from tests.scenes import camera_keys, footprints

SCENES = data_folder("scenes")
scene_named = cache(load_scene)


def keys_of(name):
    return yaml.safe_load((SCENES / f"{name}.yaml").read_text(encoding="utf-8"))


def test_simulation_1_follows_tables_9_4_and_9_5_and_the_script_writes_the_very_harbour(tmp_path):
    """Jessen & Mohr (2023)."""
    simulation = scene_named("simulation_1")
    assert (simulation.steps, simulation.annotation.mode, simulation.detector.confidence_threshold) == (1500, 0, 0.2)
    assert simulation.timestamps(0, 4) == ("0.0", "0.2", "0.4", "0.6")
    sizes = [(v.air_draft_m, v.beam_m, v.length_m) for v in simulation.vessels]
    assert sizes == [(20, 4, 14)] * 2 + [(4, 3, 7)] * 3 and {v.label for v in simulation.vessels} == {"Vessel"}
    (camera,) = simulation.cameras
    lens, mount = camera.intrinsics, camera.mount
    assert (lens.image_size_px, lens.principal_point_px) == ((3600, 2400), (1800, 1200))
    np.testing.assert_allclose(lens.focal_px, (5000, 5000))
    angles_rad = mount.roll_rad, mount.pitch_rad, mount.yaw_rad
    assert (mount.position_m, angles_rad) == ((2444, 1000, 20), (0, 0.008, np.pi))
    assert [state.name for state in simulation.detector.states] == ["excellent", "good", "bad", "terrible"]
    ships = zip(simulation.poses.radii_m, simulation.vessels, strict=True)
    rings = sorted(swept_ring(radius, v.length_m, v.beam_m) for radius, v in ships)
    assert all(outer < inner for (_, outer), (inner, _) in pairwise(rings))  # hulls can never touch
    script, written = Path(__file__).resolve().parents[2] / "script" / "make_harbour", tmp_path / "harbour.yaml"
    subprocess.run([sys.executable, script, written], check=True)
    assert written.read_bytes() == (SCENES / "harbour.yaml").read_bytes()


@pytest.mark.parametrize(("name", "apart_m"), [("harbour", 1), ("strait", 5)])
def test_vessels_are_there_throughout_and_no_two_ever_touch(name, apart_m):
    scene = scene_named(name)
    hulls = footprints(scene, np.arange(0, scene.steps, 5))
    assert scene.poses.poses(0, scene.steps).present.all()
    areas = [v.length_m * v.beam_m for v in scene.vessels]
    np.testing.assert_allclose(shapely.area(hulls), np.tile(areas, (len(hulls), 1)))
    first, second = np.array(list(combinations(range(hulls.shape[1]), 2))).T
    assert shapely.distance(hulls[:, first], hulls[:, second]).min() > apart_m


def test_full_boxes_agree_over_simulation_1_and_the_harbour_and_the_strait_hide_vessels(renderer):
    simulation = scene_named("simulation_1")
    (camera,) = simulation.cameras
    worst, compared = 0.0, 0
    for first in range(0, simulation.steps, 250):
        outlines = simulation.sight(camera, np.arange(first, first + 250)).outlines()
        seen = rendered_occlusion(outlines, camera.intrinsics, renderer)
        difference = np.abs(seen.full_boxes_px - outlines.boxes_px)
        worst, compared = max(worst, float(difference.max())), compared + len(outlines)
    assert compared > 7000 and worst <= 1.0
    harbour = scene_named("harbour")
    lengths = [vessel.length_m for vessel in harbour.vessels]
    assert len(lengths) == 30 and min(lengths) < 5 and 200 < max(lengths) <= 300
    assert {vessel.name.rstrip("0123456789") for vessel in harbour.vessels} >= {"kayak", "yacht", "ferry", "ship"}
    meshes = yaml.safe_load((data_folder("meshes") / "meshes.yaml").read_text(encoding="utf-8"))
    assert {vessel.shape for vessel in harbour.vessels} == set(meshes)
    for vessel in harbour.vessels:  # about as the mesh was designed, by length
        designed = meshes[vessel.shape]
        for name in ("beam_m", "air_draft_m"):
            stretched = getattr(vessel, name) / vessel.length_m / (designed[name] / designed["length_m"])
            assert 0.7 < stretched < 1.45, (vessel.name, name, stretched)
    truths = (truth_block(harbour, step, step + 1, renderer) for step in range(0, harbour.steps, 10))
    fractions = np.concatenate([truth.visible_fraction for truth in truths])
    assert len(fractions) > 500 and (fractions == 0).any()
    assert ((fractions > 0) & (fractions < 1)).mean() >= 1 / 3
    strait = scene_named("strait")
    hulls, highest = footprints(strait, np.arange(0, strait.steps, 5)), max(v.air_draft_m for v in strait.vessels)
    for name, obstacle in keys_of("strait")["obstacles"].items():
        shape = shapely.Polygon(obstacle["polygon_m"])
        if obstacle.get("base_m", 0) > highest + 3:  # they pass below it
            assert name == "bridge_deck" and shapely.intersects(hulls, shape).any()
        else:
            assert shapely.distance(hulls, shape).min() > 5, name
    shapes = {"ferry", "sailboat", "motorboat", "fishing_vessel", "container_ship", "kayak"}
    assert {entry.get("mesh") for entry in keys_of("strait")["vessels"].values()} == {*shapes, None}
    hiders = set()
    for first in range(0, strait.steps, 20):
        hiders |= {strait.occluder_names[index] for index in truth_block(strait, first, first + 2, renderer).occluder}
    assert hiders >= {"ferry", "container_ship", "obstacle:breakwater", "obstacle:north_island"}
    outlines = strait.sight(strait.cameras[0], np.arange(3)).outlines()
    own = outlines.occluder == strait.vessel_names.index("own")
    assert own.sum() == 3 and not outlines.boxed[own].any()  # its own foredeck, in each frame
    bow, quay = (strait.frame_steps(camera, 0, strait.steps).tolist() for camera in strait.cameras)
    assert len(bow) == 300 and quay == list(range(1, 300, 2))
    figures = compare_sources(strait, renderer, every=20).figures
    assert (figures.frames, figures.unexplained) == (15 + 8, 0) and figures.vessel_frames > 80


FITTED = {"position_m": [2472.2256, 1000, 20], "pitch_rad": 0.00809004, "yaw_rad": np.pi}
FILE = Path(__file__).parents[1] / "data" / "modsim" / "simulation_1.csv"
ROWS = np.genfromtxt(FILE, delimiter=",", names=True, skip_header=3, dtype=None, encoding="utf-8")
ROWS = ROWS.reshape(2, 5)  # steps, vessels
CENTRES = np.stack([ROWS["x"], ROWS["y"]], axis=-1)
SIZES = np.stack([ROWS["width"], ROWS["height"]], axis=-1)
PUBLISHED_PX = np.concatenate([CENTRES - SIZES / 2, CENTRES + SIZES / 2], axis=-1)


def annotated(source):
    """Corners of the annotated boxes of both steps in mode 0, shape (2, 5, 4)."""
    camera = camera_keys(3600, 2400, focal_length_m=0.05, pose=FITTED)
    sizes = ("length_m", "beam_m", "air_draft_m")
    vessels = {str(row["vessel"]): {"label": "Vessel", **{size: float(row[size]) for size in sizes}} for row in ROWS[0]}
    positions = np.stack([ROWS["w1_m"], ROWS["w2_m"]], axis=-1)
    poses = {"positions_m": positions, "headings_rad": ROWS["heading_rad"], "time_step_s": 1.4}
    data = {"vessels": vessels, "poses": poses, "cameras": {"C0": camera}, "detector": "thesis"}
    scene = Scene.from_dict(data | {"annotation": {"mode": 0, "source": source}})
    with open_renderer(scene) as renderer:
        truth = truth_block(scene, 0, 2, renderer)
    assert truth.annotated.all()
    assert (truth.step * 5 + truth.vessel).tolist() == list(range(10))
    return truth.full_boxes_px.reshape(2, 5, 4)


CAMPAIGN = Path(__file__).parents[2] / "docs" / "campaigns" / "traffic.json"
Change = Callable[[Array, Array], ArrayLike]


@pytest.fixture(scope="module")
def drawn() -> Drawn:
    return Drawn.of_seed("fairway", 1)


def test_traffic_of_two_seeds_is_as_asked_differs_and_a_shorter_run_shows_its_beginning(drawn):
    rows = [measure(drawn, 1), measure(Drawn.of_seed("fairway", 2), 2)]
    assert verdict(rows, rates_of(rows, drawn.scene, drawn.keys)) == []
    assert len(drawn.craft) > 10
    assert {craft.asked.kind for craft in drawn.craft if craft.asked} > {"head_on", "overtaking", "overtaken"}
    assert {vessel.label for vessel in drawn.scene.vessels} == {"boat", "sailboat", "ship"}
    short = load_scene("fairway", seed=1, steps=40)
    one, other = ([(v.name, v.label, v.length_m) for v in scene.vessels] for scene in (short, drawn.scene))
    assert one == other
    np.testing.assert_array_equal(hull_tracks(short.vessels, short.poses, 40).centres_m, drawn.tracks.centres_m[:40])


def to_port(own: Array, _: Array) -> Array:
    ahead = own[1] - own[0]
    return own + 250 * np.array([-ahead[1], ahead[0]]) / np.hypot(*ahead)


@pytest.mark.parametrize(("section", "change", "said"), [
    ("leisure", lambda own, first: np.add(first, (0.0, 5.0)), "hulls come to 0.00 m"),
    ("leisure", lambda own, first: [602.0, -408.0], "a hull comes to 0.00 m of land"),
    ("leisure", lambda own, first: np.add(own, (0.0, 1500.0)), "is outside her area at"),
    ("lanes", lambda own, first: own[0] + 3 * (own - own[0]), "m/s, asked for"),
    ("lanes.fairway", to_port, "to starboard of the middle of her lane"),
    ("encounters.head_on", lambda own, first: np.add(own, (0.0, 2.0)), "head_on: "),
])  # fmt: skip
def test_a_vessel_that_is_not_as_asked_is_found(drawn: Drawn, section: str, change: Change, said: str) -> None:
    """A vessel of a section that is there at the first step, from its own track and that of the first vessel."""
    there = np.isfinite(drawn.tracks.headings_rad[0])
    columns = (drawn.column(craft) for craft in drawn.craft if section in craft.section)
    column, centres = next(filter(there.__getitem__, columns)), drawn.tracks.centres_m.copy()
    centres[:, column] = change(centres[:, column], centres[:, 0])
    faults = measure(replace(drawn, tracks=replace(drawn.tracks, centres_m=centres)), 1)["faults"]
    assert any(said in fault for fault in faults), faults


def test_projected_boxes_equal_the_published_ones_and_rates_not_as_asked_are_found():
    """`tests/data/modsim/simulation_1.csv` names source and licence. The camera was not published with them. Two
    unknowns, its distance and its pitch, were fitted to the forty numbers. The program places its camera by Appendix B
    with a radius of 530 m, 2472.2222 m from the world's origin, and rounds its rotation matrix to five decimals:
    computed in this way, the forty numbers agree to 1e-11 px, so that rounding is all that the fitted camera does not
    repeat."""
    low, high = np.split(annotated("analytic"), 2, axis=-1)
    np.testing.assert_allclose((low + high) / 2, CENTRES, rtol=0, atol=6e-4)
    np.testing.assert_allclose(high - low, SIZES, rtol=0, atol=6e-4)
    np.testing.assert_allclose(annotated("rendered"), PUBLISHED_PX, rtol=0, atol=1)
    pose = camera_placement((1000, 1000), 530, height_m=20, focal_length_m=0.05, sensor_width_m=0.036, whole=False)
    assert pose["position_m"] == pytest.approx(FITTED["position_m"], abs=4e-3)
    assert np.arctan(20 / pose["position_m"][0]) == pytest.approx(FITTED["pitch_rad"], abs=4e-7)
    assert pose["pitch_rad"] == pytest.approx(np.arctan(20 / 1472.2222), abs=1e-9)  # at the centre of the circle
    # The committed rows as they are, and without half of what enters the fairway
    scene = Drawn.of_seed("fairway", 0)
    rows: list[dict[str, Any]] = json.loads(CAMPAIGN.read_bytes())["seeds"]
    assert verdict(rows, rates_of(rows, scene.scene, scene.keys)) == [] and len(rows) == 200
    assert rows[0]["vessels"] == len(scene.scene.vessels), "run script/campaign traffic again: the traffic has changed"
    for row in rows:
        row["lanes"]["fairway"]["entering"] //= 2
    assert any("lanes.fairway: enter" in said for said in verdict(rows, rates_of(rows, scene.scene, scene.keys)))
    assert verdict([rows[0], rows[0]], []) == ["two seeds have the same traffic"]
    binomial = [RateTest.binomial("x", count, 10, 0.5).p_value for count in (0, 10)]
    assert [*binomial, RateTest.poisson("x", 0, 3.0).p_value] == pytest.approx([2 / 1024] * 2 + [2 * np.exp(-3)])
    assert RateTest.poisson("x", 3, 3.0).p_value == pytest.approx(1.0, abs=0.2)
    drawn = {name for name, path in shipped_scenes().items() if draws_traffic(path)}
    assert drawn == {"simulation_1", "fairway", "small_target"}
    assert traffic_in_words(load_scene("fairway", seed=7, steps=2)).startswith("drawn from seed 7;")
    assert traffic_in_words(load_scene("strait")).startswith("this traffic only;")


SIMULATION = data_folder("scenes") / "simulation_1.yaml"


def in_folder(folder: Path, name: str, detector: str = "thesis") -> Path:
    """Simulation 1 in a folder of its own, with a shipped detector."""
    folder.mkdir(parents=True)
    text = SIMULATION.read_text(encoding="utf-8").replace("detector: detectors/thesis.yaml", f"detector: {detector}")
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def test_a_scene_in_scene_yaml_is_called_as_its_folder_which_stands_for_it(tmp_path, monkeypatch):
    path, other = in_folder(tmp_path / "sound", "scene.yaml"), in_folder(tmp_path / "bay", "traffic.yaml")
    assert (load_scene(path).name, load_scene(other).name, load_scene(path.parent).path) == ("sound", "traffic", path)
    with pytest.raises(InputError, match="bay"):
        load_scene(other.parent)
    monkeypatch.chdir(path.parent)
    assert load_scene("scene.yaml").name == "sound"


def test_a_copy_in_a_run_is_called_as_the_scene_and_a_scene_names_a_shipped_detector(tmp_path):
    scene = load_scene(in_folder(tmp_path / "sound", "scene.yaml"), steps=2, source="analytic")
    run_scene(scene, tmp_path / "run")
    again = load_scene(tmp_path / "run" / "scene" / "sound.json")
    assert (again.name, again.sha256) == ("sound", scene.sha256)
    path = in_folder(tmp_path / "strait", "scene.yaml", "three_labels")
    with pytest.raises(InputError, match="known: sailboat, motorboat, ferry"):
        load_scene(path)
    shutil.copy(data_folder("scenes") / "detectors" / "thesis.yaml", path.parent / "three_labels")
    assert load_scene(path).detector.labels == ("Vessel",)
    with pytest.raises(InputError, match="no_such"):
        load_scene(in_folder(tmp_path / "bay", "scene.yaml", "no_such"))
