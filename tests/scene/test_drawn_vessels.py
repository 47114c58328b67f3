"""Vessels that a pose source draws from the seed join those of the scene file, wherever the scene is read."""

import copy
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from pydantic import Field

from modsim3d import InputError, RunDirectoryError, Scene, load_scene, open_run, run_scene
from modsim3d.io.plugins import POSE_SOURCES, Plugin
from modsim3d.io.validation import Strict
from modsim3d.world.mesh_reading import shipped_meshes
from modsim3d.world.poses import registry
from modsim3d.world.poses.base import PoseRequest, PosesByTime, SourceKeys
from tests.cli.bad_input.builders import ASHORE, GOOD, lens

seen: list[PoseRequest] = []
OWN = dict(GOOD["vessels"]["vehicle1"])


class Convoy(PosesByTime):
    """As many vessels as the seed says; `entries` are added as they are."""

    most: int = 3
    label: str = "Vessel"
    entries: dict[str, Any] = Field(default_factory=dict)
    files_named: tuple[str, ...] = ()

    @property
    def files(self) -> tuple[str, ...]:
        return self.files_named

    def vessels(self, request: PoseRequest) -> Mapping[str, Mapping[str, object]]:
        seen.append(request)
        size = {"length_m": 8.0, "beam_m": 3.0, "air_draft_m": 2.0, "label": self.label}
        drawn = {f"drawn_{i}": {**size, "mesh": "motorboat"} for i in range(request.seed % (self.most + 1))}
        return {**drawn, **self.entries}

    def at(self, time_s: float, request: PoseRequest) -> dict[str, tuple[tuple[float, float, float], float]]:
        return {name: ((20.0 + time_s, 12.0 * i, 0.0), 0.0) for i, name in enumerate(request.names or ())}


@pytest.fixture(autouse=True)
def _convoy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(registry.SOURCES, "convoy", Convoy)
    seen.clear()


Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """A function that writes the good scene with a convoy, with some keys of its section and some of the scene."""

    def scene(convoy: Mapping[str, Any] | None = None, **keys: Any) -> Path:
        data = {**copy.deepcopy(GOOD["scene"]), "steps": 3, "time_step_s": 0.5, "vessels": {"own": OWN}}
        data["poses"], data["cameras"] = {"convoy": dict(convoy or {})}, {"shore": lens(pose=ASHORE)}
        (tmp_path / "scene.json").write_text(json.dumps(data | keys), encoding="utf-8")
        (tmp_path / "detector.yaml").write_text(json.dumps(GOOD["detector"]), encoding="utf-8")
        return tmp_path / "scene.json"

    return scene


def test_drawn_vessels_come_after_those_of_the_file_by_the_seed_and_settings_reach_the_source(write):
    path = write(obstacles={"quay": {"polygon_m": [[0, 90], [9, 90], [9, 99]], "height_m": 3}})
    assert load_scene(path).vessel_names == ("own", "drawn_0")
    scene, strait = load_scene(path, seed=3), load_scene("strait")
    assert scene.vessel_names == ("own", "drawn_0", "drawn_1", "drawn_2")
    assert [vessel.has_mesh for vessel in scene.vessels] == [False, True, True, True]
    assert scene.poses.poses(0, 3).present.shape == (3, 4)
    assert (seen[-1].names, [vessel.name for vessel in seen[-1].vessels]) == (("own",), ["own"])
    assert [obstacle.name for obstacle in seen[-1].obstacles] == ["quay"]
    assert (scene.traffic_seed, scene.traffic) == (3, "drawn from seed 3")
    assert (strait.traffic_seed, strait.traffic) == (None, "this traffic only")
    path = write(vessels={})
    assert load_scene(path, seed=2).vessel_names == ("drawn_0", "drawn_1")
    with pytest.raises(InputError, match=r"poses\.convoy: draws no vessel from seed 4, and vessels has none"):
        load_scene(path, seed=4)
    path = write(vessels={}, cameras={"bow": lens(mount={"vessel": "own", "position_m": [4.0, 0.0, 1.0]})})
    with pytest.raises(InputError, match=r"cameras\.bow\.mount\.vessel: no vessel 'own'"):
        load_scene(path, seed=2)
    path = write(vessels={}, poses={"tracks": {"a": [[0, 0, 0], [9, 9, 0]]}})
    with pytest.raises(InputError, match="vessels: no vessels; a scene needs at least one"):
        load_scene(path)
    path = write({"most": 3})
    assert len(load_scene(path, seed=3, settings={"poses.convoy.most": 2}).vessels) == 1
    said = r"--set poses\.convoy\.label: |poses\.convoy: draws vessels with the label 'x'"
    with pytest.raises(InputError, match=said):
        load_scene(path, seed=3, settings={"poses.convoy.label": "x"})
    data = json.loads(path.read_text()) | {"poses": {"convoy": {"most": np.int64(3)}}, "detector": GOOD["detector"]}
    assert Scene.from_dict(data, seed=2).vessel_names == ("own", "drawn_0", "drawn_1")


WRONG = {
    "label": ({"label": "tug"}, "draws vessels with the label 'tug' (drawn_0, drawn_1, drawn_2), which"),
    "name": ({"entries": {"own": OWN}}, "draws a vessel 'own', and the scene's vessels have one of this name"),
    "marked name": ({"entries": {"obstacle:x": OWN}}, "obstacle:x: a vessel's ID must not begin with 'obstacle:'"),
    "size": ({"entries": {"x": OWN | {"length_m": -1}}}, "x.length_m: "),
    "no shape": ({"entries": {"x": OWN | {"mesh": "fery"}}}, "x.mesh: nothing is called 'fery' here"),
    "file": ({"entries": {"x": OWN | {"mesh": "x.glb"}}}, "draws 'x' with the mesh x.glb, which is none of the files"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_drawn_vessels_are_told_with_the_section_that_draws_them(write: Write, case: str) -> None:
    convoy, message = WRONG[case]
    with pytest.raises(InputError) as refused:
        load_scene(write(convoy), seed=3)
    problems = refused.value.problems
    assert any(problem.startswith(f"poses.convoy: {message}") for problem in problems), problems


def test_a_plugin_that_draws_nonsense_is_named(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    nonsense = Mock(side_effect=[["a"], {"a": 1}, ZeroDivisionError("by zero")])

    class Wrong(SourceKeys, Strict):
        def vessels(self, request: PoseRequest) -> Any:
            return nonsense()

    monkeypatch.setattr(registry, "_model", lambda name: (Wrong, Plugin(POSE_SOURCES, "wrong", "yard 1")))
    for message in ("must return a mapping", "must return a mapping", "failed: ZeroDivisionError: by zero"):
        with pytest.raises(InputError, match=f"poses.wrong: the plug-in 'wrong' of yard 1:? .*{message}"):
            load_scene(write(poses={"wrong": {}}))


def test_a_run_is_repeated_from_its_copy_and_not_opened_where_its_seed_draws_others(write, tmp_path, monkeypatch):
    (tmp_path / "own.glb").write_bytes(shipped_meshes()["ferry"].read_bytes())
    convoy = {"entries": {"ferry": OWN | {"mesh": "own.glb"}}, "files_named": ["own.glb"]}
    path = write(convoy, annotation={"mode": 2, "source": "analytic"})
    first = run_scene(load_scene(path, seed=2), tmp_path / "first")
    stored = open_run(first.folder).scene
    assert stored.vessel_names == ("own", "drawn_0", "drawn_1", "ferry") and stored.vessels[-1].has_mesh
    assert json.loads((first.folder / "run.json").read_bytes())["traffic_seed"] == 2
    (tmp_path / "own.glb").unlink()  # the copy has one
    second = run_scene(load_scene(stored.path), tmp_path / "second")
    assert (second.folder / "truth.parquet").read_bytes() == (first.folder / "truth.parquet").read_bytes()
    assert load_scene(stored.path, seed=3).vessel_names == ("own", "drawn_0", "drawn_1", "drawn_2", "ferry")
    # As with a later version of the source: the run's tables are not of these vessels
    scene = load_scene(write(annotation={"mode": 2, "source": "analytic"}), seed=2)
    folder = run_scene(scene, tmp_path / "run").folder
    assert open_run(folder).scene.drawn_vessels == 2
    at = Convoy.at
    monkeypatch.setattr(Convoy, "at", lambda *given: dict([*at(*given).items()][::-1][1:]))
    with pytest.raises(RunDirectoryError, match="seed 2 draws another traffic here than when the run was made, with"):
        open_run(folder)


@pytest.mark.parametrize(("shift_m", "same"), [(1e-12, True), (1e-3, False)])
def test_the_checksum_of_a_traffic_is_that_of_every_processor(write, monkeypatch, shift_m: float, same: bool) -> None:
    """Last bits of sines differ between processors: a run is opened where they do."""
    path, at = write(), Convoy.at
    before = load_scene(path, seed=2).traffic_sha256()

    def shifted(*given: Any) -> Any:
        poses = at(*given).items()
        return {name: ((place[0] + shift_m, *place[1:]), turn + shift_m) for name, (place, turn) in poses}

    monkeypatch.setattr(Convoy, "at", shifted)
    assert (load_scene(path, seed=2).traffic_sha256() == before) is same
