"""A detector that is learned from a voyage."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer

import modsim3d
from modsim3d import ModsimError, Scene, learn_voyage, load_scene
from modsim3d.cli.main import app
from modsim3d.learn.learn_detector import LearnRequest
from modsim3d.learn.voyage.camera_registration import FIXED_NAMES
from modsim3d.learn.voyage.learn_voyage import Method, VoyageRequest
from modsim3d.learn.voyage.log_to_scene import NO_CORRECTION, CameraLog, Correction
from tests.cli.bad_input.builders import Call, answer, refusal

WITHOUT = ("relative", "mixed", "student_t", "effects", "persistence", "vessels", "lasting", "slopes")
"""Whose estimates take long."""
QUICK = {"replicates": 20, "without": WITHOUT}
BOW = {"camera": "bow", "registration": NO_CORRECTION, **QUICK}


def learned(scene: Scene, voyage: Path, **others: object) -> dict[str, object]:
    """The keys of the detector that is learned from the run as a log of the bow camera."""
    return learn_voyage(scene, voyage / "run", **{**BOW, **others}).content


def numbers(content: object) -> list[float]:
    if isinstance(content, dict):
        return [number for value in content.values() for number in numbers(value)]
    if isinstance(content, list | tuple):
        return [number for value in content for number in numbers(value)]
    return [float(content)] if isinstance(content, int | float) else []


def test_it_is_near_the_detector_that_is_learned_from_the_run(voyage: Path) -> None:
    """They differ only in the rounding of boxes, and in what the other camera adds, which is left out of both."""
    run = modsim3d.open_run(voyage / "run")
    theirs = modsim3d.learn_detector(run=run, match="confidence", states={"voyage": ["clear", "haze"]}, **QUICK)
    mine = learn_voyage(run.scene, voyage / "run", fixed="all", **QUICK)
    np.testing.assert_allclose(numbers(mine.content), numbers(theirs.content), rtol=2e-3, atol=1e-5)


def test_the_command_learns_from_a_log_and_its_help_names_what_may_be_fixed(call: Call, voyage, tmp_path) -> None:
    out, scene = tmp_path / "detector.yaml", voyage / "run" / "scene" / "strait.json"
    line = ("learn-voyage", scene, "--fixed", "all", "--replicates", 20, "--out", out)
    given = ("--detections", voyage / "coco" / "dt.json", "--images", voyage / "coco" / "gt.json", "--camera", "bow")
    said = answer(call, (*line, *given))
    for part in ("nothing was registered", "24 images", "its frames are known from the images of gt.json"):
        assert part in " ".join(said.split())
    assert "# States: voyage = voyage" in out.read_text()
    assert "strait.json" in out.with_suffix(".html").read_text()
    modsim3d.load_detector(out)
    parameters = typer.main.get_command(app).commands["learn-voyage"].params
    (said,) = (each.help for each in parameters if each.name == "fixed")
    assert said.partition(": ")[2] == f"{', '.join(FIXED_NAMES)}; or all."


WRONG = {
    "": "--detections is needed, the log of a camera's detector",
    "--camera mast": "has no camera 'mast'",
    "--camera bow --camera quay": "--camera is given 2 times, with 1 log:",
    "--log-start noon": "--log-start",
    "--log-start 9000": "is from 0 s to 4.6 s",
    "--condition a --condition b": "2 conditions are named for 1 log: name each",
    "--fixed pitsch": "no parameter 'pitsch'",
    "--fixed all,pitch": "all stands alone (got 'all,pitch')",
    "--fixed ": "no parameter '' (known: clock, roll, pitch, yaw, height, focal, k1, mean_width",
    "--known mean_x=1": "--fixed all leaves out",
    "--known mean_width=2": "mean_width: must be a share above -1 and below 1, such as 0.02 (got '2')",
    "--stale 90": "was not made by modsim3d ais",
    "--empty soon": "must be FROM-TO in seconds",
    "--empty 900-1000": "no frame lies in it",
    "--empty 2024-01-04T10:02Z/2024-01-04T10:03Z": "does not say when it starts",
    "--position-noise -1": "must be metres from 0 to 100 (got -1)",
    "--position-noise 101": "must be metres from 0 to 100 (got 101)",
}


@pytest.mark.parametrize(("given", "said"), WRONG.items())
def test_what_does_not_go_together_is_refused(call: Call, voyage: Path, tmp_path: Path, given: str, said: str) -> None:
    log, fixed = ("--detections", voyage / "run") * bool(given), ("--fixed", "all") * ("--fixed" not in given)
    line = ("learn-voyage", voyage / "run" / "scene" / "strait.json", *log, *fixed, "--out", tmp_path / "d.yaml")
    assert said in " ".join(refusal(call, (*line, *(given.split(" ") if given else ())), kept=tmp_path).split())


def test_logs_that_name_no_camera_are_of_those_that_are_given(voyage: Path) -> None:
    folder, loaded = voyage / "csv", load_scene(voyage / "run" / "scene" / "strait.json")
    logs = [folder / "detections_bow.csv", folder / "detections_quay.csv"]

    def views(*cameras: str) -> list[str]:
        asked = VoyageRequest(LearnRequest.of("test"), loaded, tuple(logs), cameras, fixed="all")
        return [view.camera.name for view in asked.labelled().views]

    assert views("bow", "quay") == ["bow", "quay"]
    logs[1] = logs[0]
    with pytest.raises(ModsimError, match=r"detections .*detections_bow.csv is given twice: its frames would count"):
        views("bow")
    with pytest.raises(ModsimError, match=r"cameras is given 3 times, with 2 logs: .* for each in their order"):
        views("bow", "quay", "bow")


@pytest.mark.parametrize(("position_m", "mode"), [(0.0, 2), (3.0, 2), (3.0, 1)])
def test_hidden_parts_leave_box_errors_out_where_positions_are_not_surely_known(strait, voyage, position_m, mode):
    scene = replace(strait, annotation=replace(strait.annotation, mode=mode))
    found = learn_voyage(scene, voyage / "run", match="confidence", position_noise=position_m, **BOW)
    pairs = found.report.learned.observed.pairs
    hidden = found.voyage_report.voyage.labelled.annotations.visible_fraction[pairs.rows] < 0.99
    assert hidden.any() and not hidden.all() and pairs.edges.whole[hidden].any() == (position_m == 0 or mode == 1)
    assert pairs.edges.whole[~hidden].any()


def test_registration_is_applied_to_camera_and_clock_and_boxes_match_by_centres_where_unsure(strait, voyage):
    """With a wrong pitch most boxes are missed; what finds it is asked once for each camera."""
    asked: list[tuple[str, int, int]] = []

    def registrar(scene: Scene, log: CameraLog) -> Correction:
        asked.append((scene.name, log.camera, len(log.time_s)))
        return Correction(pitch_deg=2)

    wrong = learned(strait, voyage, registration=registrar)
    assert asked == [("strait", 0, 24)]
    missed = [content["states"]["voyage"]["confusion"][-1][0] for content in (learned(strait, voyage), wrong)]  # type: ignore[index]
    assert missed[0] < 0.3 < 0.5 < missed[1]
    for given, said in (
        ({"registration": Correction(yaw_deg=180)}, "nothing can be learned"),  # no vessel is seen
        ({"registration": NO_CORRECTION, "known": "delay=2"}, "fixed and known are for a registration that is estim"),
    ):
        with pytest.raises(ModsimError, match=said):
            learned(strait, voyage, **given)

    def matched_by(position_m: float, match: Method | None = None) -> str:
        found = learn_voyage(strait, voyage / "run", position_noise=position_m, match=match, **BOW)
        return found.report.matched_by.partition(" at")[0]

    assert [matched_by(0.0), matched_by(3.0), matched_by(3.0, "confidence")] == ["IoU", "centres", "IoU"]
