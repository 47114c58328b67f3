"""--set, --state and --from: what cannot be set is one error that names the option, and nothing is written."""

from pathlib import Path

from tests.cli.bad_input.builders import Call, Inputs, refusal


def test_a_wrong_setting_is_one_error(inputs, call, tmp_path):
    for options, part in (
        (["--set", "foo"], "--set foo: a key and a value are needed, as in waves.level=large"),
        (["--set", "=3"], "--set =3: a key and a value are needed"),
        (["--set", "seed=[1"], "--set seed: line 1, column 3: while parsing a flow sequence"),
        (["--set", "seed={a: 1, a: 2}"], "--set seed: line 1, column 8: key 'a' appears twice"),
        (["--set", "seed=!!python/name:os.system ''"], "the tag !!python/name:os.system is not read"),
        (["--set", "detector.sates.clear.x=1"], "--set detector.sates.clear.x: unknown key detector.sates (did you"),
        (["--set", "seed.a=1"], "--set seed.a: seed is a number, which has no keys"),
        (["--set", "detector=other.yaml"], "other.yaml: no such file"),
        (["--set", ".=1"], "--set .: unknown key"),
        (["--set", "cameras..skew=1"], "--set cameras..skew: cameras has no ''"),
        (["--set", "cameras.C0.image_size_px.-1=5"], "its items are 0 to 1 (got '-1')"),
        (["--set", "cameras.C0.image_size_px=[640]"], "--set cameras.C0.image_size_px[1]: missing"),
        (["--state", "haze"], "--state: unknown state 'haze' (known: clear, fog)"),
        (["--from", "conditions"], "--from conditions: is a detector in place of the scene's: --state says which one"),
        (["--state", "fog", "--from", "conditions"], "there is no 'fog' (known: foggy_clear, foggy_cloudy)"),
        (["--state", "clear", "--from", "nowhere"], "detectors in nowhere: there are none"),
    ):
        scene, out = inputs.write(), tmp_path / "out"
        for command in (["check", "scene", str(scene)], ["run", str(scene), "--out", str(out)]):
            said = refusal(call, (*command, *options))
            assert part in " ".join(said.split())
            assert not out.exists()


def test_a_detector_and_a_condition_in_its_place_are_refused(inputs: Inputs, call: Call, tmp_path: Path) -> None:
    scene = inputs.write()
    options = ("--state", "noon_clear", "--from", "conditions", "--detector", str(inputs.path("detector")))
    said = refusal(call, ("run", str(scene), "--out", str(tmp_path / "out"), *options))
    assert "is a detector in place of the scene's: so is --detector" in " ".join(said.split())


def test_the_last_value_of_a_repeated_key_counts(inputs: Inputs, call: Call) -> None:
    scene = str(inputs.write())
    assert call("check", "scene", scene, "--set", "annotation.mode=7", "--set", "annotation.mode=0")[0] == 0
    assert call("check", "scene", scene, "--set", "annotation.mode=0", "--set", "annotation.mode=7")[0] == 2


def test_a_truth_that_is_kept_cannot_be_set(inputs: Inputs, call: Call, tmp_path: Path) -> None:
    run, other = str(tmp_path / "run"), tmp_path / "other"
    scene = str(inputs.write())
    assert call("run", scene, "--source", "analytic", "--no-sheet", "--out", run)[0] == 0
    said = refusal(call, ("detect", run, "--out", str(other), "--set", "waves.level=small"))
    assert "a finished run keeps its truth: set keys of the detector only" in " ".join(said.split())
    assert not other.exists()
    assert call("detect", run, "--out", str(other), "--set", "detector.states.fog.false_discovery_rate=0.3")[0] == 0
