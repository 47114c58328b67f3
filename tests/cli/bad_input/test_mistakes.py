"""Mistakes with files and options of one's own, as users make them: one error each that names key and remedy."""

import importlib
import itertools
import json
import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

import modsim3d
from modsim3d.io.validation import describe
from tests.cli.bad_input.builders import foreign, refusal
from tests.command_line import call as called

SIZE = "image_size_px: [1920, 1080]"
SCENE = f"""\
steps: 5
time_step_s: 0.5
vessels:
  own: {{length_m: 10, beam_m: 4, air_draft_m: 3, label: boat}}
  ferry: {{length_m: 80, beam_m: 14, air_draft_m: 20, label: ship}}
poses: {{tracks: {{own: [[0, 0, 0], [10, 50, 0]], ferry: [[0, 400, 60], [10, 400, -20]]}}}}
cameras:
  bow:
    hfov_deg: 60
    {SIZE}
    mount: {{vessel: own, position_m: [3, 0, 2.2], pitch_deg: 2}}
annotation: {{source: analytic}}
detector: coastal
"""
K = "K: [[1662.8, 0, 959.5], [0, 1662.8, 539.5], [0, 0, 1]]"
MATRIX = "labels: [boat, ship]\nmatrix_rows: predicted\nimages: 9\nconfusion_matrix: "
IMAGES = [{"id": number, "width": 640, "height": 480, "file_name": f"{number}.png"} for number in (1, 2)]
BOX = {"image_id": 1, "category_id": 1, "bbox": [10, 10, 50, 40]}
TRUTH: dict[str, Any] = {"images": IMAGES, "annotations": [{"id": 1, **BOX}], "categories": [{"id": 1, "name": "boat"}]}
FOUND = [{**BOX, "score": 0.9}]
CSV = "camera,step,track,x_min_px,y_min_px,x_max_px,y_max_px\n"
CAMPAIGN = "scene: scene.yaml\nsteps: 5\nseeds: {traffic: 2}\ntrackers: [reference]\n"
ANSWERS = """\
import json, sys
sys.stdin.readline()
print(json.dumps({"answers": "frames", "tracks": "image"}), flush=True)
for line in sys.stdin:
    frame = json.loads(line)
    track = {"track": 1, "box": [0, 0, 9, 9]}
    print(json.dumps({"step": frame["step"], "camera": frame["camera"], "tracks": [track]}), flush=True)
"""
CHECK, LEARN = "check scene scene.yaml", "learn --truth gt.json --detections dt.json"
CAMPAIGN_RUN, SCORE, SET_CLEAR = "campaign run c.yaml", "score run t.csv", "run scene.yaml --set detector.states.clear"
FIGURES, MINE = "learn --from-figures r.yaml", f"track run --command '{sys.executable} mine.py'"
YOLO, AIS = "learn --truth set --detections found --image-size 640,480", "ais a.csv --out a"

Files = dict[str, object]


def scene(old: str, new: str) -> Files:
    assert old in SCENE
    return {"scene.yaml": SCENE.replace(old, new)}


def lens(text: str) -> Files:
    return scene(f"hfov_deg: 60\n    {SIZE}", text)


def coco(truth: dict[str, Any] | list[Any] = TRUTH, found: object = FOUND) -> Files:
    return {"gt.json": truth, "dt.json": found}


def yolo(truth: str, found: str, names: str = "boat\n") -> Files:
    return {"set/labels/a.txt": truth, "set/classes.txt": names, "found/a.txt": found}


MISTAKES: list[tuple[str, Files, str | tuple[str, ...]]] = [  # what is typed, what is in files, and what the error says
    # a camera
    (CHECK, lens("K: [[1662, 0, 960], [0, 1662, 540]]\n    " + SIZE), "bow.K: 3 × 3 numbers are needed: the rows are"),
    (CHECK, lens("focal_px: 1662\n    " + SIZE), "bow.focal_px: a list, as [a, b], is needed (got 1662)"),
    (CHECK, lens(f"{K}\n    {SIZE}\n    distortion: [-0.1, 0]"), "distortion: a mapping of keys is needed: k1, k2, p1"),
    (CHECK, lens("calibration: scene.yaml"), ("calibration: scene.yaml: has neither camera_matrix", "cam0")),
    (CHECK, scene("hfov_deg: 60", "hfov_deg: 60°"), "cameras.bow.hfov_deg: a number is needed (got '60°')"),
    (CHECK, scene("hfov_deg", "hfov_rad"), "cameras.bow.hfov_rad: unknown key (did you mean 'hfov_deg'?)"),
    (CHECK, scene("vessel: own", "vessel: ownship"), "mount.vessel: no vessel 'ownship' (did you mean 'own'?)"),
    (CHECK, scene("[3, 0, 2.2]", "[3, 0]"), "bow.mount.position_m[2]: missing (got [3, 0])"),
    (CHECK, scene("label: boat", "label: bout"), "'bout' is not one of the detector's labels (did you mean 'boat'"),
    # a detector
    (CHECK, scene("coastal", "costal"), "no shipped detector has this name (did you mean 'coastal'?)"),
    (f"{CHECK} --detector costal", {}, "no shipped detector has this name (did you mean 'coastal'?)"),
    ("run scene.yaml --set detector.mis_rate=0.3", {}, "unknown key detector.mis_rate (did you mean 'miss_rate'?)"),
    ("run scene.yaml --set detector.miss_rate=30", {}, "detector.miss_rate: a miss rate is a number from 0 to below 1"),
    (f"{SET_CLEAR}.confusion=[[90,5],[4,90],[6,5]]", {}, ("has counts (90)", "learn --from-figures makes a detector")),
    (f"{SET_CLEAR}.box_error.covariance=[[4,0],[0,4]]", {}, "is 2 × 2, must be 4 × 4"),
    ("run scene.yaml --state hase", {}, "--state: unknown state 'hase' (did you mean 'haze'?)"),
    (FIGURES, {"r.yaml": MATRIX + "[[0.7, 3, 9], [4, 9, 5], [1, 6, 0]]"}, ("counts, or shares", "(0.7 is no count")),
    (FIGURES, {"r.yaml": "labels: [boat]\nrecall: 0.8\nmAP50: 0.7\n"}, "mAP50: unknown key (did you mean 'map50'?)"),
    # labels
    (LEARN, coco({**TRUTH, "categories": []}), "categories: is empty, must name at least one"),
    (LEARN, coco({key: TRUTH[key] for key in ("images", "annotations")}), "categories: missing: give the names of the"),
    (LEARN, coco(found=[{**FOUND[0], "category_id": 0}]), ("unknown category_id 0", "by --category-offset 1")),
    (YOLO, yolo("0 0.5 0.5 0.1 0.1\n", "0 0.5 0.5 0.1 0.1\n"), "must come with their confidence (ultralytics: save_tx"),
    (YOLO, yolo("0 320 240 64 48\n", "0 0.5 0.5 0.1 0.1 0.9\n"), "a.txt line 1: x, y, width, height must be shares of"),
    (YOLO, yolo("0 0.5 0.5 0.1 0.1\n", "0 0.5 0.5 0.1 0.1 0.9\n", "0: boat\n"), "classes.txt"),
    (YOLO.partition(" --image")[0], yolo("0 0.5 0.5 0.1 0.1\n", ""), "are not beside them: give --image-size"),
    # a tracker
    ("track run --tracker bytetrak", {}, "--tracker:\n  nothing is called 'bytetrak' here"),
    ("track run --set lost=3", {}, "settings of the tracker 'reference':\n  lost: unknown key (did you mean 'lost_s'?"),
    ("track run --command ./my_tracker", {}, "--command:\n  command: './my_tracker': there is no such program"),
    ("track run --command ./mine.py", {"mine.py": ANSWERS}, "'./mine.py': is not a program that may be run: chmod +x"),
    ("track scene.yaml", {}, "scene.yaml is a file, not a run directory, as modsim3d run makes one"),
    (MINE, {"mine.py": ANSWERS.replace("frames", "frame")}, "answers: must be 'frames' or 'steps' (got 'frame')"),
    (MINE, {"mine.py": ANSWERS}, ("camera 'bow' at 0 s", "tracks[0].box: unknown key (did you mean 'box_px'?)")),
    (MINE, {"mine.py": "raise SystemExit('no weights.pt')\n"}, ("it ended with status 1", "error: no weights")),
    (SCORE, {"t.csv": CSV + "front,0,1,0,0,9,9\n" * 914}, "no camera 'front' (known: bow), and in 913 more lines"),
    (SCORE, {"t.csv": CSV.replace("step", "frame") + "bow,0,1,0,0,9,9\n"}, "unknown column 'frame' (known: c"),
    ("score run gone.csv", {}, ("tracks gone.csv:\n  no such file or folder", "tracks are a folder of `modsim3d trac")),
    # a campaign
    (CAMPAIGN_RUN, {"c.yaml": CAMPAIGN.replace("reference", "referenc")}, "trackers[0]: nothing is called 'ref"),
    (CAMPAIGN_RUN, {"c.yaml": CAMPAIGN.replace("[reference]", "sort")}, "trackers: a list, as [a, b], is needed"),
    (CAMPAIGN_RUN, {"c.yaml": CAMPAIGN + "require: [{score: HOTA, at_least: 1}]\n"}, "score 'HOTA' (did you mean 'h"),
    ("campaign run scene.yaml", {}, "this is a scene: a campaign names it under scenes, and trackers beside"),
    ("run c.yaml", {"c.yaml": CAMPAIGN}, "this is a campaign: modsim3d campaign run takes it"),
    # AIS
    ("ais gone.csv --out a", {}, "AIS file gone.csv:\n  no such file"),
    (AIS, {"a.csv": "time,ship,lat,lon\n2024-01-01T00:00:00Z,219000001,56,12\n"}, ("none of the formats", "BaseDate")),
    (f"{AIS} --start 2030-01-01T00:00:00Z", {"a.csv": Path("tests/data/ais/danish.csv")}, "the files reach from 20"),
]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of the scene, in a folder that has the scene too."""
    folder = tmp_path_factory.mktemp("mistakes")
    (folder / "scene.yaml").write_text(SCENE)
    with pytest.MonkeyPatch.context() as monkeypatch:
        assert called(monkeypatch, "run", folder / "scene.yaml", "--out", folder / "run", "--no-sheet") == 0
    return folder / "run"


NUMBERED = [f"{i}-{typed[:18]}" for i, (typed, _, _) in enumerate(MISTAKES)]


@pytest.mark.parametrize(("typed", "files", "parts"), MISTAKES, ids=NUMBERED)
def test_a_mistake_has_one_error_that_names_key_and_remedy(tmp_path, monkeypatch, call, run, typed, files, parts):
    for name, text in ({"scene.yaml": SCENE} | files).items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        text = text.read_text() if isinstance(text, Path) else text
        (tmp_path / name).write_text(text if isinstance(text, str) else json.dumps(text))
    (tmp_path / "run").symlink_to(run)
    monkeypatch.chdir(tmp_path)
    out = [] if "--out" in typed or typed.startswith(("check", "score")) else ["--out", "out"]
    said = refusal(call, [*shlex.split(typed), *out], *([parts] if isinstance(parts, str) else parts))
    assert said.count("modsim3d: ") == 1 and said.count("\n") < 8, said
    assert not (tmp_path / "out").exists()


def test_a_run_says_what_to_type_next_and_no_error_has_words_of_the_library_that_checks_it(run, call):
    status, said = call("run", run.parent / "scene.yaml", "--out", run, "--overwrite", "--no-sheet")
    assert status == 0 and "mode 0: boxes of whole vessels, hidden ones too" in said
    assert "with every seed the same vessels on the same paths" in said
    assert f"next\n  modsim3d report {run}\n  modsim3d track {run} --out {run}_tracks\n" in said
    folder = Path(modsim3d.__file__).parent
    for path in folder.rglob("*.py"):
        if re.search(r"\((Strict|BaseModel)\b", path.read_text()):
            importlib.import_module(".".join(path.relative_to(folder.parent).with_suffix("").parts))
    own = [model for model in models() if model.__module__.startswith("modsim3d.") and model.model_fields]
    assert len(own) > 80
    for model in own:
        for name, value in itertools.product(model.model_fields, VALUES):
            for shape in (value, [value], {"a": value}, [[value]], {"a": [value]}, [{"where": {"a": value}}]):
                try:
                    model.model_validate({name: shape})
                except ValidationError as error:
                    assert not [line for line in describe(error, model) if foreign(line)]


VALUES: list[Any] = [None, True, -1, 2.5, 1e300, 10**400, float("nan"), "x", "", [], {}]
VALUES += [[1] * 20, [[]], {"x": 1}, {7: 1}]


def models(base: type[BaseModel] = BaseModel) -> Iterator[type[BaseModel]]:
    for model in base.__subclasses__():
        yield model
        yield from models(model)
