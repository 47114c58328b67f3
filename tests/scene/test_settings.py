"""Keys that the caller sets: in the scene, in its detector and in its vessels, and what the copy in a run holds."""

import copy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from modsim3d import InputError, detect_run, load_detector, load_scene, run_scene
from modsim3d.detector.confidence import NormalScores
from modsim3d.detector.file.reading import detector_text
from modsim3d.io.input_files import data_folder
from modsim3d.io.strict_text import load_yaml, parse_yaml
from modsim3d.io.validation import conditions_in
from modsim3d.runs.repeat_run import repeat_run
from modsim3d.runs.stored_run import open_run, read_finished
from modsim3d.scene.settings import Setting, changed, choose_detector, read_settings
from tests.cli.bad_input.builders import GOOD, Inputs

RICH = data_folder("scenes") / "detectors" / "rich.yaml"
DETECTOR_RATE = "detector.states.clear.false_discovery_rate"
FOG_RATE = "detector.states.fog.false_discovery_rate"


def inputs_in(folder: Path) -> Inputs:
    return Inputs(folder / "in", copy.deepcopy(GOOD))


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return inputs_in(tmp_path).write()


def problems(scene: Path | str, **options: Any) -> tuple[str, ...]:
    with pytest.raises(InputError) as caught:
        load_scene(scene, **options)
    return caught.value.problems


def test_values_of_options_are_yaml_leave_what_they_are_given_and_are_mappings():
    texts = ["a=large", "b.c=0.1", "d=[1, 2]", "e={f: true}", "g=", "h=x=y", "a=small"]
    assert read_settings(texts) == {"a": "small", "b.c": 0.1, "d": [1, 2], "e": {"f": True}, "g": None, "h": "x=y"}
    for key in ("cameras.C0.skew", "annotation.mode", "seed", "cameras.C0.image_size_px.1"):
        content, setting = copy.deepcopy(GOOD["scene"]), Setting(key, 5)
        result, _ = changed(content, setting.parts, setting)
        assert content == GOOD["scene"] != result
    content = parse_yaml("cameras: {a: &lens {skew: 0}, b: *lens}", "here")
    setting = Setting("cameras.a.skew", 3)
    assert changed(content, setting.parts, setting)[0] == {"cameras": {"a": {"skew": 3}, "b": {"skew": 0}}}
    with pytest.raises(TypeError, match=r"settings: a mapping of keys to values is needed \(got list\)"):
        load_scene("strait", settings=["waves.level=large"])  # type: ignore[arg-type]


def test_keys_of_scene_vessels_and_detector_can_be_set_and_every_wrong_one_is_told(tmp_path):
    inputs = inputs_in(tmp_path)
    cameras = inputs.data["scene"]["cameras"]
    cameras["shore.left"] = cameras.pop("shore")  # names may have dots
    loaded = load_scene(
        inputs.write(),
        settings={
            "seed": np.int64(7),
            "cameras.C0.mount.pitch_rad": 0.1,
            "cameras.C0.principal_point_px": np.array([300, 200]),
            "cameras.C0.image_size_px[0]": 600,
            "cameras.shore.left.skew": 2,
            "vessels.vehicle2.length_m": 9.5,
            DETECTOR_RATE: 0.3,
            "detector.gates.max_range_m": 500,
        },
    )
    (camera, left), detector = loaded.cameras, loaded.detector
    assert (loaded.seed, camera.mount.pitch_rad, left.intrinsics.skew) == (7, 0.1, 2)
    assert (camera.intrinsics.image_size_px, camera.intrinsics.principal_point_px) == ((600, 480), (300, 200))
    assert [vessel.length_m for vessel in loaded.vessels] == [8.0, 9.5]
    assert (detector.states[0].false_discovery_rate, detector.gates.max_range_m) == (0.3, 500)
    assert load_scene("strait").copy.document["waves"]["spectrum"] == "jonswap"
    waves = load_scene("strait", settings={"waves.level": "large"}).copy.document["waves"]
    assert waves == {"level": "large", "apply_to": "all"}
    inputs = inputs_in(tmp_path)
    inputs.data["detector"] = load_yaml(RICH, "detector")
    for entry in inputs.data["vessels"].values():
        entry["label"] = "ferry"
    confidence = {"detector.states.clear.confidence.mean": 0.6, "detector.states.clear.confidence.std": 0.1}
    found = load_scene(inputs.write(), settings=confidence).detector.states[0].confidence
    assert (found.true, found.false) == (NormalScores(0.6, 0.1), NormalScores(0.6, 0.1))
    inputs.data["detector"]["confidence_threshold"] = 3
    said = problems(inputs.write(), settings={"foo": 1, "detector.bar": 2, "seed": -1})
    beginnings = [*(f'settings["{key}"]' for key in ("foo", "detector.bar", "seed")), "detector"]
    assert [line.partition(":")[0].split(" /")[0] for line in said] == beginnings
    inputs.data["detector"] = load_yaml(RICH, "detector")
    for entry, label in zip(inputs.data["vessels"].values(), ("ferry", "sailboat"), strict=True):
        entry["label"] = label
    (problem,) = problems(inputs.write(), state="noon_clear", state_from="conditions")
    assert problem.startswith('state="noon_clear", state_from="conditions": this detector has the labels Vessel')
    assert "ferry, sailboat" in problem and "modsim3d.guess_detector" in problem


@pytest.mark.parametrize(("key", "value", "works"), [
    ("detector.states.clear.false_discovery_rate", 0.6, "set detector.false_positives.rate"),
    ("detector.confidence_threshold", 0.5, "set detector.operating_threshold"),
    ("detector.false_positives.merge_overlap", 0.5, "set detector.false_positives.merges"),
])  # fmt: skip
def test_a_setting_that_nothing_reads_is_refused_with_the_key_that_works(key: str, value: float, works: str) -> None:
    setting = {key: value}
    found = problems("strait", settings=setting)
    assert found[0].startswith(f'settings["{key}"]') and works in found[0]
    with pytest.raises(InputError, match=works):
        choose_detector("coastal", settings=setting)
    assert load_scene("strait", steps=2, settings=setting, may_be_unread=True).steps == 2


def test_a_wrong_setting_is_named_as_it_was_given_and_a_state_is_forced_for_the_whole_scene(scene, tmp_path):
    whole = {"detector": str(RICH), "vessels.vehicle1.label": "ferry", "vessels.vehicle2.label": "ferry"}
    loaded = load_scene(scene, settings={DETECTOR_RATE: 0.3, **whole})
    assert loaded.detector.labels == ("sailboat", "motorboat", "ferry")
    assert loaded.detector.states[0].false_discovery_rate == 0.3
    (problem,) = problems(scene, settings={"detector.transition_matrix.0.1": 0.5})
    assert "transition_matrix: column 'fog' sums to 1.3" in problem
    assert problem.endswith('(after settings["detector.transition_matrix.0.1"])')
    for key, value, said in (
        ("detector.sates.clear.confusion", 1, "unknown key detector.sates (did you mean 'states'?)"),
        ("detector.states.haze.confusion", 1, "detector.states has no 'haze' (known: clear, fog)"),
        ("detector.states.clear.false_discovery_rate", 2, "is 2, must be from 0 to 0.99"),
        ("detector.states.clear.box_error.mean.4", 2, "detector.states.clear.box_error.mean is a list of 4"),
        ("waves.level", "lrge", "(did you mean 'large'?)"),
        ("cameras.shoe.skew", 0, "cameras has no 'shoe' (did you mean 'shore'?)"),
        ("cameras.C0.skw", 0, "unknown key cameras.C0.skw (did you mean 'skew'?)"),
        ("cameras.C0.skew", "x", "(got 'x')"),
        ("vessels.vehicle1.length_m", -1, "must be at least 0.001 (got -1)"),
        ("vessels.vehicle1.lenght_m", 1, "unknown key (did you mean 'length_m'?)"),
        ("vessels.ghost.length_m", 1, "vessels has no 'ghost'"),
        ("poses.file.vehicle1", 1, "poses.file is text, which has no keys that could be set"),
        ("steps", 10**6, "1000000 asked for, but the pose file has 4"),
        ("foo", 1, "unknown key foo (known: steps"),
    ):
        (problem,) = problems(scene, settings={key: value})
        assert problem.startswith(f'settings["{key}"]: ') and said in problem, problem
    loaded = load_scene(scene, state="fog")
    names = [state.name for state in loaded.detector.states]
    forced = loaded.detector.performance.forced(loaded.times_s(0, loaded.steps), [0] * loaded.steps)
    assert [names[index] for index in forced] == ["fog"] * loaded.steps
    assert problems(scene, state="haze") == ("state: unknown state 'haze' (known: clear, fog)",)
    key = "detector.states.clear.confidence.visibility_slope"
    (found,) = problems("strait", settings={key: 0.1}, state="haze")
    assert found.startswith(f'settings["{key}"]: states.clear: the detector is never in state clear, but in haze')
    (tmp_path / "mine").mkdir()
    calm = tmp_path / "mine" / "calm.yaml"
    calm.write_text(detector_text(GOOD["detector"]))
    assert load_scene(scene, state="calm", state_from=tmp_path / "mine").detector.labels == ("Vessel",)
    assert load_scene(scene, state="fog", state_from=calm).detector.performance.schedule == ((0.0, 1),)
    with pytest.raises(InputError, match="there are none"):
        load_scene(scene, state="calm", state_from=tmp_path / "nowhere")
    for name, file in conditions_in().items():
        assert load_scene(scene, state=name, state_from="conditions").copy.files["detector.yaml"] == file.resolve()
    with pytest.raises(InputError, match=r"there is no 'rain' \(known: afternoon_cloudy_rain, evening_cloudy_rain"):
        load_scene(scene, state="rain", state_from="conditions")
    with pytest.raises(InputError, match="state says which one"):
        load_scene(scene, state_from="conditions")


def test_the_copy_in_a_run_has_the_settings_and_its_detector_can_be_changed_but_not_its_truth(scene, tmp_path):
    changes: dict[str, Any] = {"waves.level": "small", "vessels.vehicle1.beam_m": 3.5}
    changes |= {FOG_RATE: 0.25, "detector.persistence.box_s": 1e-06}
    loaded = load_scene(scene, source="analytic", settings=changes, state="fog")
    run_scene(loaded, tmp_path / "run")
    stored = yaml.safe_load((tmp_path / "run" / "scene" / "detector.yaml").read_text())
    assert stored["states"]["fog"]["false_discovery_rate"] == 0.25
    assert stored["performance"] == {"schedule": [[0, "fog"]]}
    assert load_scene(open_run(tmp_path / "run").scene.path).sha256 == loaded.sha256
    assert repeat_run(read_finished(tmp_path / "run"), tmp_path / "again").same
    assert {frame.state for frame in open_run(tmp_path / "run").frames()} == {"fog"}
    load_scene(scene, settings={"waves.level": "small"}).copy.write(tmp_path / "copy")
    assert (tmp_path / "copy" / "detector.yaml").read_bytes() == (scene.parent / "detector.yaml").read_bytes()
    changed_detector = load_scene(scene, settings={DETECTOR_RATE: 0.25})  # an input all the same, which no run replaces
    assert scene.parent / "detector.yaml" in changed_detector.copy.files.values()
    run_scene(load_scene(scene, source="analytic"), tmp_path / "usual")
    stored = open_run(tmp_path / "usual")
    detect_run(stored, tmp_path / "redone", settings={FOG_RATE: 0.25}, state="fog")
    detector = open_run(tmp_path / "redone").scene.detector
    assert (detector.states[1].false_discovery_rate, detector.performance.schedule) == (0.25, ((0.0, 1),))
    with pytest.raises(InputError, match=r"settings\[.waves.level.\]:\n  a finished run keeps its truth"):
        detect_run(stored, tmp_path / "other", settings={"waves.level": "small"})
    assert not (tmp_path / "other").exists()


TEXTS = st.one_of(
    st.text(st.characters(codec="utf-8", categories=["L", "N", "P", "Zs"]), max_size=8),
    st.from_regex(r"[-+]?[0-9.eE_:]{1,6}", fullmatch=True),
)
SCALARS = st.one_of(st.none(), st.booleans(), st.integers(-(10**9), 10**9), st.floats(allow_nan=False), TEXTS)
KEYS = TEXTS.filter(bool)


LISTS, MAPPINGS = st.lists(st.lists(SCALARS, max_size=3)), st.dictionaries(KEYS, st.lists(SCALARS), max_size=3)


@given(st.one_of(SCALARS, LISTS, MAPPINGS))
def test_a_written_detector_reads_as_it_was(value: Any) -> None:
    assert parse_yaml(detector_text({"value": value}), "here") == {"value": value}


@pytest.mark.parametrize("name", ["rich", "thesis", "three_labels"])
def test_shipped_detectors_read_the_same_once_they_are_written_anew(name: str, tmp_path: Path) -> None:
    file, written = RICH.with_name(f"{name}.yaml"), tmp_path / "d.yaml"
    written.write_text(detector_text(load_yaml(file, "detector")))
    assert load_yaml(written, "detector") == load_yaml(file, "detector")
    assert load_detector(written).labels == load_detector(file).labels
