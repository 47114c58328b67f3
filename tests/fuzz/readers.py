"""Every reader: good files to spoil, what reads them, and what is then done with what was read."""

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d.detector.chain import Detector, target_statistics
from modsim3d.detector.file.reading import load_detector
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.labelled_run import labelled_run
from modsim3d.formats.matching import Rule, match
from modsim3d.formats.reading.builder import ReadOptions
from modsim3d.formats.reading.pair import read_pair
from modsim3d.io.input_files import data_folder
from modsim3d.runs.pipeline import DetectorInput, Simulation, detector_inputs, scene_statistics, truth_block
from modsim3d.runs.stored_run import open_run
from modsim3d.scene.ais.options import Options
from modsim3d.scene.ais.scene_folder import write_scene
from modsim3d.scene.ais.traffic import read_traffic
from modsim3d.scene.reading import load_scene
from modsim3d.scene.scene import Scene
from modsim3d.world.mesh_reading import load_mesh
from modsim3d.world.poses.base import PoseRequest
from modsim3d.world.poses.replay import LivePoses, StreamKeys, load_poses
from modsim3d.world.vessels import Vessel, load_mapping, parse_vessels
from tests.cli.bad_input.builders import GOOD
from tests.fuzz import corpora
from tests.fuzz.corpora import Files, reseal, stored_runs, write_files
from tests.scene.test_lens import scene_with
from tests.scenes import outlines_of

STEPS = 2
CONDITION = "day"
NAMES = tuple(GOOD["vessels"])


@dataclass(frozen=True)
class Reader:
    """A reader under the name that the campaign calls it by."""

    name: str
    cases: int  # of the recorded campaign
    bases: Callable[[], tuple[Files, ...]]  # good inputs
    read: Callable[[Path], None]  # what lies in a folder, to use it a little
    also_names: tuple[str, ...] = ()  # which errors may name in place of a file of the folder
    finish: Callable[[Files], None] = lambda files: None  # makes checksums in other files right, in most cases


def _only_file(folder: Path, pattern: str) -> Path:
    """The file that the case has under one of several names; a name that no file has if it has none."""
    return next(iter(sorted(folder.glob(pattern))), folder / pattern.replace("*", ""))


def _read_scene(folder: Path) -> None:
    scene = load_scene(_only_file(folder, "scene.*"))
    if isinstance(scene.poses, LivePoses):
        scene.poses.wait(STEPS - 1)
        steps = min(STEPS, len(scene.poses.timestamps))
    else:
        steps = min(STEPS, scene.steps)
    if steps:
        scene.at(0)
        scene = replace(scene, annotation=replace(scene.annotation, source="analytic"))
        truth = truth_block(scene, 0, steps, None)
        Simulation(scene, scene_statistics(scene, [(truth, 0, steps)])).detect(truth, 0, steps)


@cache
def _seen_by_a_detector() -> tuple[Scene, tuple[DetectorInput, ...]]:
    """A scene, and the boxes of its first steps."""
    with tempfile.TemporaryDirectory(prefix="modsim3d_fuzz_") as folder:
        write_files(corpora.scenes()[0], Path(folder))
        scene = load_scene(Path(folder) / "scene.yaml", source="analytic")
        return scene, tuple(detector_inputs(scene, truth_block(scene, 0, STEPS, None), 0, STEPS))


def _read_detector(folder: Path) -> None:
    model = load_detector(folder / "detector.yaml")
    scene, inputs = _seen_by_a_detector()
    statistics = target_statistics(model, ((part.frames, part.targets) for part in inputs))
    detector = Detector(model, 0, statistics, scene.times_s)
    for part in inputs:
        detector.detect(part.frames, part.targets)


def _read_calibration(folder: Path) -> None:
    truth_block(scene_with(folder, {"calibration": _only_file(folder, "solved.*").name}), 0, 1, None)


def _read_vessels(folder: Path) -> None:
    path = folder / "vessels.json"
    for vessel in parse_vessels(load_mapping(path), f"vessels file {path}"):
        outlines_of([(vessel, (100.0, 0.0), 0.25)])


def _read_poses(folder: Path) -> None:
    found = load_poses(_only_file(folder, "poses.*"), NAMES)
    found.poses(0, STEPS)
    load_poses(_only_file(folder, "poses.*"), None)


def _read_stream(folder: Path) -> None:
    live = StreamKeys(file="live.jsonl", timeout_s=0).build(PoseRequest(folder, NAMES))
    while live.wait(len(live.timestamps)):
        pass
    live.poses(0, len(live.timestamps))


def _read_mesh(ending: str, folder: Path) -> None:
    source = f"scene {folder / 'scene.yaml'}"
    solid = load_mesh({"file": f"hull.{ending}"}, folder, source, "vessels", "boat", "mesh")
    outlines_of([(Vessel("boat", "Vessel", 8.0, 3.0, 2.0, solid), (50.0, 0.0), 0.3)])


def _match(labelled: LabelledSet) -> None:
    for method in ("confidence", "optimal"):
        match(labelled, Rule(method))


def _pair_reader(truth: str, detections: str, **options: Any) -> Callable[[Path], None]:
    return lambda folder: _match(read_pair(CONDITION, folder / truth, folder / detections, ReadOptions(**options)))


def _read_ais(folder: Path) -> None:
    traffic = read_traffic(sorted(folder.iterdir()) or [folder / "ais.csv"], Options(duration_s=20.0))
    out = folder.with_name(folder.name + "_out")
    try:
        write_scene(traffic, out, data_folder("scenes") / "detectors" / "experiment_1.yaml")
        written = parse_vessels(load_mapping(out / "vessels.json"), "vessels")
        load_poses(out / "poses.json.gz", [vessel.name for vessel in written]).poses(0, STEPS)
    finally:
        shutil.rmtree(out, ignore_errors=True)


def _read_run(folder: Path) -> None:
    run = open_run(folder / "run")
    for frame in run.frames(0, STEPS):
        np.isfinite(frame.detections.boxes_px)
    run.tables()
    _match(labelled_run(folder / "run")[0])


def _ais_reader(name: str, sample: str) -> Reader:
    return Reader(name, 5000, partial(corpora.ais, sample), _read_ais, ("AIS files",))


_MESHES = ("glb", "obj", "stl", "ply")
_KEYS = ("of the box error of state", "transition_interval_s")
_LABELS = ("labels of ", f"labels and conditions of {CONDITION}")
READERS = {
    reader.name: reader
    for reader in (
        Reader("scene", 6_000, corpora.scenes, _read_scene),
        Reader("detector", 10_000, corpora.detectors, _read_detector, _KEYS),
        Reader("calibration", 10_000, corpora.calibrations, _read_calibration),
        Reader("vessels", 25_000, corpora.vessels, _read_vessels),
        Reader("poses", 20_000, corpora.poses, _read_poses),
        Reader("stream", 30_000, corpora.stream, _read_stream),
        *(Reader(kind, 8000, partial(corpora.meshes, kind), partial(_read_mesh, kind)) for kind in _MESHES),
        Reader("coco", 22_000, corpora.coco, _pair_reader("gt.json", "dt.json", frame_rate_hz=10.0), _LABELS),
        Reader("coco_skip_bad", 13_000, corpora.coco, _pair_reader("gt.json", "dt.json", skip_bad=True), _LABELS),
        Reader("mot", 16_000, corpora.mot, _pair_reader("gt/gt.txt", "det/det.txt"), _LABELS),
        Reader("yolo", 12_000, corpora.yolo, _pair_reader("set", "found"), _LABELS),
        _ais_reader("ais_danish", "danish.csv"),
        _ais_reader("ais_marinecadastre", "marinecadastre.csv"),
        _ais_reader("ais_marinecadastre_2025", "marinecadastre_2025.csv"),
        _ais_reader("ais_nmea", "receiver.nmea"),
        Reader("run", 3500, partial(stored_runs, False), _read_run, finish=reseal),
        Reader("interrupted_run", 3000, partial(stored_runs, True), _read_run, finish=reseal),
    )
}
