"""Where two runs of the same truth differ."""

import pytest

from modsim3d import Frame, RunDirectoryError, load_scene, open_run, run_scene
from modsim3d.runs.counts import Outcome, detected_rows, frame_outcomes
from modsim3d.view.report.overview import VesselOutcome
from modsim3d.view.report.recorder import recording
from modsim3d.view.report.side_by_side import check_same_truth, differences
from tests.scenes import write_scene


def outcome_in(frame: Frame, row: int) -> VesselOutcome:
    """Of a row of the truth, looked up one by one."""
    if not frame.truth.annotated[row]:
        return VesselOutcome.NOT_ANNOTATED
    if not frame.truth.detected[row]:
        return VesselOutcome.MISSED
    found = [flag for at, flag in zip(detected_rows(frame), frame_outcomes(frame), strict=True) if at == row]
    if not found or not found[0]:
        return VesselOutcome.DETECTED
    if found[0] & Outcome.OFF_VESSEL:
        return VesselOutcome.OFF_VESSEL
    return VesselOutcome.BELOW_HALF_IOU if found[0] & Outcome.BELOW_HALF_IOU else VesselOutcome.WRONG_CLASS


@pytest.mark.parametrize("every", [1, 7])
def test_stretches_are_the_steps_at_which_the_runs_differ(mistaken_folder, other_folder, every):
    first, second = open_run(mistaken_folder), open_run(other_folder)
    frames = {(one.camera, one.step): (one, other) for one, other in zip(first.frames(), second.frames(), strict=True)}
    expected = set()
    for camera in (each.name for each in first.scene.cameras):
        taken = sorted(step for name, step in frames if name == camera)
        for index, step in enumerate(range(0, first.steps, every)):
            if (last := max((each for each in taken if each <= step), default=None)) is None:
                continue
            one, other = frames[camera, last]
            for row, vessel in enumerate(one.truth.vessels):
                pair = outcome_in(one, row), outcome_in(other, row)
                if pair[0] != pair[1]:
                    expected.add((camera, vessel, index, *pair))
    found = differences(recording(first, every).outcomes, recording(second, every).outcomes)
    cameras, vessels = [camera.name for camera in first.scene.cameras], first.scene.vessel_names
    stretches = zip(found.camera, found.vessel, found.index, found.until, found.outcomes.tolist(), strict=True)
    covered = [
        (cameras[camera], vessels[vessel], index, *pair)
        for camera, vessel, begin, until, pair in stretches
        for index in range(begin, until + 1)
    ]
    assert len(covered) == len(set(covered)) and set(covered) == expected
    assert len(expected) > len(found.camera)  # some stretches last


def test_a_run_does_not_differ_from_itself_and_has_the_truth_of_another_seed(mistaken_folder, other_folder):
    run = open_run(mistaken_folder)
    outcomes = recording(run).outcomes
    assert len(differences(outcomes, outcomes).camera) == 0
    check_same_truth(run, open_run(other_folder))


def test_runs_of_other_truth_are_refused_with_what_differs(run_folder, mistaken_folder, tmp_path):
    first = open_run(mistaken_folder)
    with pytest.raises(RunDirectoryError, match=r"show different truth, in the cameras: .*modsim3d detect"):
        check_same_truth(first, open_run(run_folder))
    runs = []
    for name, far in (("near", 150), ("far", 151)):
        (tmp_path / name).mkdir()
        boats = {"ferry": ([30.0, 8.0, 9.0], [[0, far, 10], [100, far, 12]])}
        scene = load_scene(str(write_scene(tmp_path / name, boats, steps=4)), source="analytic")
        run_scene(scene, tmp_path / name / "run")
        runs.append(open_run(tmp_path / name / "run"))
    with pytest.raises(RunDirectoryError, match=r"in \w+ of ferry at step 0 of camera \w+: [\d.]+ against [\d.]+\."):
        check_same_truth(*runs)
