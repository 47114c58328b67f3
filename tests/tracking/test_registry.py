"""Trackers by their names, and their settings: defaults, those of a file, those of its scene, those that are given."""

from collections.abc import Iterable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from modsim3d.core.errors import InputError, ModsimError
from modsim3d.io.plugins import TRACKERS, Plugin
from modsim3d.tracking.trackers import registry
from modsim3d.tracking.trackers.interface import CameraFacts, SensedFrame, TrackedFrame, Tracker
from modsim3d.tracking.trackers.names import BUILT_IN, BuiltIn, tracker_names
from modsim3d.tracking.trackers.registry import command_tracker, named_tracker


class Toy(Tracker):
    gate: float = 1.0
    hits: int = 2
    name: str = "toy"

    def follow(self, frames: Iterable[SensedFrame], camera: CameraFacts) -> Iterator[TrackedFrame]:
        return (TrackedFrame.empty() for _ in frames)


@pytest.fixture(autouse=True)
def toy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A built-in tracker `sort` of these tests, and a folder of settings of their own."""
    monkeypatch.setitem(BUILT_IN, "sort", BuiltIn(__name__, "Toy", ("pydantic",)))
    monkeypatch.setattr(registry, "data_folder", lambda kind: tmp_path / kind)


FILE = "chosen: On seeds 900 to 909.\nsettings: {gate: 2.0, hits: 3}\nscenes: {strait: {gate: 4.0}}\n"


def settings_file(folder: Path, text: str) -> None:
    (folder / "scenes" / "trackers").mkdir(parents=True)
    (folder / "scenes" / "trackers" / "sort.yaml").write_text(text)


def test_names_are_the_built_in_ones_first_and_wrong_names_and_settings_are_told_with_the_nearest():
    built_in = ("reference", "sort", "bytetrack", "ocsort", "stonesoup_gnn", "stonesoup_jpda")
    built_in += ("world_gnn", "world_jpda")
    assert tracker_names()[:8] == built_in
    with pytest.raises(InputError, match=r"(?s)^tracker.*'refrence'.*modsim3d\.trackers.*did you mean 'reference'"):
        named_tracker("refrence", {}, "strait")
    with pytest.raises(InputError, match=f"known: {', '.join(built_in)}"):
        named_tracker("../../x", {}, "strait")
    with pytest.raises(InputError) as caught:
        named_tracker("sort", {"gat": 3, "hits": "many"}, "strait")
    assert caught.value.source == "settings of the tracker 'sort'"
    gate, hits = sorted(caught.value.problems)
    assert gate == "gat: unknown key (did you mean 'gate'?)" and "hits: " in hits and "(got 'many')" in hits
    with pytest.raises(TypeError, match="command: a list of a program and its arguments is needed"):
        command_tracker("./my_tracker --fast", {})
    with pytest.raises(TypeError, match="a mapping of names to values"):
        named_tracker("sort", ["gate"], "strait")  # type: ignore[arg-type]


def test_a_file_replaces_the_defaults_its_scene_the_file_and_the_caller_all(tmp_path):
    named = named_tracker("sort", {}, "strait")
    assert (named.tracker, named.plugin, named.chosen) == (Toy(), None, "the tracker's defaults")
    assert named_tracker("sort", {"hits": np.int64(5)}, "strait").tracker == Toy(hits=5)
    assert named_tracker("sort", {"hits": 5}, "strait").chosen == "the tracker's defaults, but for hits"
    settings_file(tmp_path, FILE)
    assert named_tracker("sort", {}, "fairway").tracker == Toy(gate=2.0, hits=3)
    given, named = named_tracker("sort", {"gate": 5}, "strait"), named_tracker("sort", {}, "strait")
    assert (given.tracker, named.tracker) == (Toy(gate=5.0, hits=3), Toy(gate=4.0, hits=3))
    assert given.chosen == "On seeds 900 to 909; but gate given by the caller"
    origin = named.origin
    assert origin.settings == {"gate": 4.0, "hits": 3, "name": "toy"}
    assert (origin.tracker, origin.package) == ("sort", f"modsim3d {version('modsim3d')}")
    assert origin.versions == {name: version(name) for name in ("numpy", "scipy", "pydantic")}


@pytest.mark.parametrize(("text", "problem"), [
    ("chosen: x\nsetings: {}\n", "setings: unknown key (did you mean 'settings'?)"),
    ("settings: {}\n", "chosen: missing"),
    ("chosen: x\nsettings: {gat: 1}\n", "settings.gat: unknown key (did you mean 'gate'?)"),
    ("chosen: x\nscenes: {harbour: {hits: many}}\n", "scenes.harbour.hits: "),
    ("chosen: x\nsettings: [1]\n", "settings: a mapping of keys is needed"),
])  # fmt: skip
def test_a_wrong_file_is_told_with_its_path_and_key(tmp_path: Path, text: str, problem: str) -> None:
    settings_file(tmp_path, text)
    with pytest.raises(InputError) as caught:
        named_tracker("sort", {}, "strait")
    assert str(tmp_path / "scenes" / "trackers" / "sort.yaml") in caught.value.source
    assert caught.value.problems[0].startswith(problem)


def test_shipped_files_of_settings_are_right(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever files there are: each belongs to a tracker, and every value of it is one that the tracker takes."""
    monkeypatch.undo()
    folder = registry.data_folder("scenes") / "trackers"
    for name in sorted({path.stem for path in folder.glob("*.yaml")} - {"oracle"}):  # its noises are no settings
        assert name in BUILT_IN
        assert named_tracker(name, {}, "strait").chosen != registry.DEFAULTS
        assert named_tracker(name, {}, "a scene of my own").chosen == registry.DEFAULTS


class Strange(Toy):
    thing: Any = object()


@pytest.mark.parametrize("found", [3, Tracker, type("Other", (), {}), Toy(), type("Empty", (Tracker,), {}), Strange])
def test_a_plugin_that_is_no_tracker_or_has_settings_that_no_file_holds_is_refused(monkeypatch, found: object) -> None:
    monkeypatch.setattr(registry, "load_plugin", lambda *_: (found, Plugin(TRACKERS, "mine", "mine 1.0")))
    said = "its settings cannot be written as JSON" if found is Strange else r"must be a class made from modsim3d\.Trac"
    with pytest.raises(ModsimError, match=rf"'mine' of mine 1\.0:? {said}"):
        _ = named_tracker("mine", {}, "strait").origin


def test_a_library_that_is_not_installed_is_named_with_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(BUILT_IN, "sort", BuiltIn(__name__, "Toy", ("no-such-library",)))
    said = r"'sort' needs the library no-such-library: pip install \"modsim3d\[trackers\]\""
    with pytest.raises(ModsimError, match=said):
        _ = named_tracker("sort", {}, "strait").origin
