"""Who is at each pixel of a page is who is there in the ID buffer: obstacles, own bow, holes and lenses too."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.ndimage import maximum_filter, minimum_filter

from modsim3d import Window, load_scene, open_run, run_scene
from modsim3d.io.input_files import data_folder
from modsim3d.view import palette
from modsim3d.view.pictures.plain import Solids, open_id_renderer
from modsim3d.view.report.report import REPORT_FILE, write_report

DATA = Path(__file__).parents[2] / "data"
STEPS = 6
EDGE_PX = 5  # pixels are compared that have one owner around them so far: smooth edges have mixed colours


@pytest.fixture(scope="module")
def crowded_strait(tmp_path_factory):
    """The strait, with a bay around one vessel, a gate before another, and a lens that bends."""
    folder = tmp_path_factory.mktemp("strait")
    scene = yaml.safe_load((DATA / "crowded_strait.yaml").read_text(encoding="utf-8"))
    scene["steps"] = STEPS
    scene["poses"]["tracks"]["kayak"] = [[0, 100, -30], [150, 400, -30]]
    bay = [[60, -60], [140, -60], [140, -20], [125, -20], [125, -45], [75, -45], [75, -25], [60, -25]]
    scene["obstacles"]["bay"] = {"polygon_m": bay, "height_m": 2}
    arch = {"position_m": [230, 20, 0], "size_m": [40, 2, 25], "heading_rad": 0.7, "mesh": {"file": "gate.obj"}}
    torn = {"position_m": [200, -40, 0], "size_m": [30, 2, 18], "heading_rad": 1.9, "mesh": {"file": "torn.obj"}}
    scene["obstacles"] |= {"gate": arch, "torn": torn}
    scene["cameras"]["quay"]["distortion"] = {"k1": -0.12, "k2": 0.03}
    scene["detector"] = str(data_folder("scenes") / "detectors" / "thesis.yaml")
    (folder / "gate.obj").write_text(_gate(), encoding="utf-8")
    (folder / "torn.obj").write_text("\n".join(_gate().splitlines()[:-2]), encoding="utf-8")  # not watertight
    (folder / "scene.yaml").write_text(yaml.safe_dump(scene), encoding="utf-8")
    run_scene(load_scene(str(folder / "scene.yaml")), folder / "run")
    run = open_run(folder / "run")
    write_report(run)
    return run


def _gate() -> str:
    """A frame with a hole in it, one metre of each side wide and deep."""
    outer, inner = [(-0.5, 0), (0.5, 0), (0.5, 1), (-0.5, 1)], [(-0.3, 0.2), (0.3, 0.2), (0.3, 0.7), (-0.3, 0.7)]
    lines = [f"v {x} {y} {z}" for y in (-0.5, 0.5) for x, z in outer + inner]
    for i, j in ((0, 1), (1, 2), (2, 3), (3, 0)):
        front, back = (1 + i, 1 + j, 5 + j, 5 + i), (9 + i, 13 + i, 13 + j, 9 + j)
        outside, inside = (1 + j, 1 + i, 9 + i, 9 + j), (5 + i, 5 + j, 13 + j, 13 + i)
        lines += ["f " + " ".join(map(str, face)) for face in (front, back, outside, inside)]
    return "\n".join(lines) + "\n"


def owners_buffer(scene, camera, step):
    """Owner + 1 at each pixel; zero where nothing is."""
    window = Window(0, 0, 1, scene.cameras[camera].intrinsics.image_size_px)
    with open_id_renderer(scene) as id_renderer:
        return Solids.at(scene, scene.cameras[camera], step).ids(window, id_renderer).astype(np.int64)


def page_picture(browser, camera, index):
    """What the page paints, as large as the camera's image, shape (rows, columns, 3)."""
    browser.run(f"""(() => {{
        const {{ recording }} = player, [width, height] = recording.facts.cameras[{camera}].size;
        const canvas = Object.assign(document.createElement('canvas'), {{ width, height, id: 'painted' }});
        const picture = new player.picture.constructor(canvas);
        Object.assign(picture, {{ ratio: 1, view: {{ x: 0, y: 0, width }} }});
        const frame = {{ shapes: recording.shapes({index}, {camera}), truths: [], detections: [] }};
        picture.draw(recording, {index}, {camera}, {{ silhouettes: true }}, frame);
        document.body.append(canvas);
    }})()""")
    return browser.pixels("painted")[..., :3]


@pytest.mark.parametrize(("camera", "step"), [(0, 1), (0, STEPS - 1), (1, STEPS - 1)])
def test_every_pixel_is_its_owners_as_in_the_id_buffer(browser, crowded_strait, camera, step):
    scene = crowded_strait.scene
    browser.open(crowded_strait.folder / REPORT_FILE)
    picture, ids = page_picture(browser, camera, step), owners_buffer(scene, camera, step)
    assert picture.shape[:2] == ids.shape
    vessels, obstacles = range(len(scene.vessels)), range(len(scene.obstacles))
    colours = [
        *(palette.darker(palette.vessel_colour(i, scene.own_ships)) for i in vessels),
        *map(palette.obstacle_colour, obstacles),
    ]
    inside = (ids > 0) & (minimum_filter(ids, EDGE_PX) == maximum_filter(ids, EDGE_PX))
    off = np.abs(picture[inside].astype(int) - np.array(colours)[ids[inside] - 1]).max(axis=1)
    # A mast that meets no pixel centre is not in the buffer, and dims a pixel of the page a little.
    assert np.mean(off > 8) < 1e-4
    # Where the buffer has nobody there is sea or sky.
    nobody = maximum_filter(ids, EDGE_PX) == 0
    sea_or_sky = np.all(picture == palette.SEA, axis=2) | np.all(picture == palette.SKY, axis=2)
    horizon = minimum_filter(sea_or_sky, EDGE_PX) | ~nobody
    assert np.mean(horizon | sea_or_sky) > 0.995 and len(np.unique(ids[inside])) > 5
    if (camera, step) == (0, 1):  # own bow, a vessel in a bay, and a hole with something behind it are there
        shown = {["", *scene.occluder_names][owner] for owner in np.unique(ids).tolist()}
        assert {"own", "obstacle:bay", "obstacle:gate", "obstacle:torn", "kayak", "ferry"} <= shown
