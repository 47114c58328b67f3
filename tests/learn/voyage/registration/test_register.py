"""A wrong camera and clock come back from the detections, with intervals; what cannot be known is refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.stand_in.places import place_scene
from benchmarks.voyages.cases import AIS, REGISTRATION_SETTINGS
from benchmarks.voyages.reported import AisErrors, as_reported
from benchmarks.voyages.wrong_camera import WRONG, Voyage, really
from modsim3d import ModsimError, Scene, load_scene
from modsim3d.learn.voyage.registration import initial_guesses, registering
from modsim3d.learn.voyage.registration.icp import Aligner, BoxesAtTimes
from modsim3d.learn.voyage.registration.initial_guesses import Guess, Search, rivals_of, starts
from modsim3d.learn.voyage.registration.model import BoxModel, HidingBodies, KnownTraffic
from modsim3d.learn.voyage.registration.parameters import SHARED_NAMES, SHORT, Values
from modsim3d.learn.voyage.registration.registering import Registration, register
from modsim3d.world.vessels import shoebox

AIS_ERRORS = AisErrors(position_m=1.0, delay_s=0.5, along_m=3.0, across_m=1.0)
CLOSE = {"clock_s": 0.2, "pitch_deg": 0.6, "yaw_deg": 0.2, "height_m": 2.0, "focal_share": 0.01, "roll_deg": 0.4}
"""Half-widths of intervals that are still of use with a minute of five vessels."""
A_WAVE_EARLIER = Guess(0.3, 2.0, 0.4, 400)  # the waves' motion looks much the same there: a search may like it better
RIGHT = Guess(3.5, 2.0, 0.4, 380)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("strait", settings=REGISTRATION_SETTINGS)


@pytest.fixture(scope="module")
def found(scene: Scene) -> BoxesAtTimes:
    return Voyage.of(scene, "quay", WRONG).detections(0)


@pytest.fixture(scope="module")
def registered(scene: Scene, found: BoxesAtTimes) -> Registration:
    return register(scene, "quay", found)


def holds(registration: Registration, name: str) -> bool:
    estimate = registration[name]
    return estimate.low <= WRONG.get(name, 0.0) <= estimate.high


def some(found: BoxesAtTimes, kept: np.ndarray) -> BoxesAtTimes:
    return BoxesAtTimes(found.times_s, found.frame[kept], found.boxes_px[kept])


def test_a_wrong_camera_and_clock_come_back_and_what_a_rule_settles_is_said(scene, registered: Registration) -> None:
    for name, close in CLOSE.items():
        assert holds(registered, name), registered
        assert registered[name].high - registered[name].low < 2 * close, registered
    assert len(registered.sightings) > 0.9 * registered.detections
    assert registered.rms_before_px > 8 * registered.rms_after_px
    said = "\n".join(group.words() for group in registered.groups)
    for exchange in ("mean_y_px is held; 1 px of it looks like +0.0", "mean_x_px is held; 1 px of it looks like -0.0",
                     "common_delay_s is held; 1 s of it looks like -1 s of clock_s"):  # fmt: skip
        assert exchange in said
    assert registered["mean_x_px"].held == "mean errors are taken to be zero"
    (real,), (bow, quay) = really(scene, "quay", WRONG).cameras, registered.scene_of(scene).cameras
    assert quay.mount.yaw_rad == pytest.approx(real.mount.yaw_rad, abs=np.radians(0.1))
    assert quay.mount.position_m[2] == pytest.approx(real.mount.position_m[2], abs=1.5)
    assert quay.intrinsics.focal_px[0] == pytest.approx(real.intrinsics.focal_px[0], rel=0.005)
    assert bow is scene.cameras[0]


def test_antennas_noise_and_silent_vessels_widen_the_intervals_and_do_not_pull(scene, found, registered) -> None:
    reported, _ = as_reported(scene, 1, AIS_ERRORS, ["motorboat"])
    registration = register(reported, "quay", found, offsets_m=3.0, noise_m=1.0)
    assert all(holds(registration, name) for name in CLOSE), registration
    width, exact = (each["yaw_deg"].high - each["yaw_deg"].low for each in (registration, registered))
    assert width > 2 * exact


def test_fixed_parameters_keep_the_scenes_values(scene: Scene) -> None:
    known = {name: value for name, value in WRONG.items() if name not in ("height_m", "focal_share")}
    found = Voyage.of(replace(scene, steps=200), "quay", known).detections(0)
    registration = register(scene, "quay", found, fixed=["height", "focal_share", "k1"])
    assert (registration["height_m"].held, registration["height_m"].value) == ("fixed by the user", 0)
    assert holds(registration, "pitch_deg")
    assert registration["pitch_deg"].standard_error < 0.03  # against the height it is known less well


def test_given_mean_errors_are_taken_off(scene: Scene, found: BoxesAtTimes) -> None:
    with pytest.raises(ModsimError, match="mean_errors: four numbers"):
        register(scene, "quay", found, mean_errors=(1.0, 2.0))
    moved = BoxesAtTimes(found.times_s, found.frame, found.boxes_px + np.array([3.0, -2.0, 3.0, -2.0]))
    registration = register(scene, "quay", moved, mean_errors=(3.0, -2.0, 0.0, 0.0))
    assert holds(registration, "yaw_deg") and holds(registration, "pitch_deg")


def test_clocks_hours_apart_other_cameras_another_way_and_mirrored_images_are_refused(scene, found) -> None:
    boxes = found.boxes_px[:, [2, 1, 0, 3]] * (-1, 1, -1, 1) + np.array([1920, 0] * 2)
    late, mirrored = replace(found, times_s=found.times_s + 7200), replace(found, boxes_px=boxes)
    turned = Voyage.of(scene, "quay", {"yaw_deg": 40.0}).detections(0)
    wrong = r"do not fit the vessels of .*mirrored detections.*another place, camera or time; .*pixels of another size"
    for camera, shown, message in (
        ("quay", late, r"the clocks are 118\.9 minutes apart.*Check the time zone"),
        ("bow", found, wrong),
        ("quay", turned, r"another way .*turned by \+(39|40|41)° of yaw.*yaw_rad is about 1\.[89]\d$"),
        ("quay", mirrored, r"Mirrored ones fit better: the images may be mirrored, or upside down$"),
    ):
        with pytest.raises(ModsimError, match=message):
            register(scene, camera, shown, searched_s=10)


@pytest.mark.parametrize("noise_m", [0.0, 1.0])
def test_rivals_that_match_nothing_in_the_end_do_not_end_a_registration(scene, found, monkeypatch, noise_m) -> None:
    some = found.some(60)
    alone = register(scene, "quay", some, searched_s=10, noise_m=noise_m)

    def with_rivals(*arguments: Any) -> tuple[Values, list[Values]]:
        best, _ = starts(*arguments)
        return best, [best.changed(clock_s=1e4), best.changed(yaw_deg=90.0)]

    monkeypatch.setattr(registering, "starts", with_rivals)
    beside = register(scene, "quay", some, searched_s=10, noise_m=noise_m)
    ends = [[(each.value, each.high) for each in done.estimates] for done in (beside, alone)]
    np.testing.assert_array_equal(*ends)


def test_too_little_is_refused(scene: Scene, found: BoxesAtTimes) -> None:
    middle = np.flatnonzero(np.abs(found.boxes_px[:, [0, 2]].mean(axis=1) - 960) < 25)
    for rows, message in (
        (np.zeros(0, dtype=int), "there are no detections"),
        (np.zeros(1, dtype=int), "too little to go by: 1 detection, and at least 30 matches of 3"),
        (np.repeat(middle, 10), r"all detections lie within \d\.\d° of one bearing"),
    ):
        with pytest.raises(ModsimError, match=message):
            register(scene, "quay", some(found, rows))
    few = some(found, np.arange(0, len(found.frame), 17))
    off = np.where(np.arange(len(few.frame)) < 5, 300.0, 0.0)[:, None] * (0, 1, 0, 1)
    with pytest.raises(ModsimError, match=r"too little to go by: 2\d matches of \d vessels \("):
        register(scene, "quay", BoxesAtTimes(few.times_s, few.frame, few.boxes_px + off), searched_s=10)
    two, _ = as_reported(scene, 0, AisErrors(), scene.vessel_names[2:-1])
    with pytest.raises(ModsimError, match="the scene has 2 vessels for the camera to see"):
        register(replace(two, cameras=scene.cameras[:1]), "bow", found)
    with pytest.raises(ModsimError, match="no match is left where positions are off by 30000 m"):
        register(scene, "quay", found, searched_s=10, noise_m=3e4)


def test_names_that_do_not_exist_and_wrong_detections_are_refused(scene: Scene, found: BoxesAtTimes) -> None:
    misspelt = "quay", ["ptch"], "no parameter 'ptch' .did you mean 'pitch'"
    all_fixed, nowhere = ("quay", [*SHORT, "k1"], "all parameters are fixed"), ("quai", [], "no camera 'quai'")
    for camera, fixed, message in (all_fixed, misspelt, nowhere):
        with pytest.raises(ModsimError, match=message):
            register(scene, camera, found, fixed=fixed)
    for times_s, frame, message in (
        ([0.0, 0.0], [0], "must ascend, but 0 s follows 0 s"),
        ([0.0, 1.0], [2], "not among the 2 frames"),
        ([0.0, 1.0], [0, 1], "shapes"),
        ([0.0, np.nan], [0], "not a finite number"),
    ):
        with pytest.raises(ModsimError, match=message):
            BoxesAtTimes(np.array(times_s), np.array(frame), np.array([[0.0, 0, 1, 1]]))


def test_the_clock_that_explains_the_detections_is_chosen_whatever_the_votes(scene, monkeypatch) -> None:
    """Of a voyage on board, by AIS; a close rival, which has another clock and is not clearly worse, is said."""
    best, other = (Values.none(1).changed(clock_s=clock) for clock in (3.7, 0.2))
    for scores, ends, rivals in (([5.0, 6.0, 4.0], other, []), ([5.0, -4.0, 1.0], other, [other]),
                                 ([5.0, -4.0, 1.0], best, [])):  # fmt: skip
        assert rivals_of(np.array(scores), best, [(np.zeros(3), ends)]) == rivals
    reported, _ = as_reported(scene, 10, AIS)
    model = BoxModel.of(reported, KnownTraffic.of(reported, reported.cameras[0]))
    found = Voyage.of(scene, "bow", WRONG).detections(10).some(60)
    free = tuple(name for name in SHARED_NAMES if not name.endswith("_px"))
    aligner = Aligner(model, HidingBodies.of(reported, model), found, free, True)
    monkeypatch.setattr(initial_guesses, "search", lambda *_: Search((A_WAVE_EARLIER, RIGHT), 100, 1000))
    monkeypatch.setattr(initial_guesses, "SURE", np.inf)  # then any other clock is a rival
    best, (rival,) = starts(aligner, 10.0, 5.0, scene)
    assert best["clock_s"] == pytest.approx(3.7, abs=0.1) and rival["clock_s"] == pytest.approx(0.2, abs=0.5)


def test_boats_that_turn_all_the_time_tell_the_clock_by_ais() -> None:
    """They turn by up to 360° in the half minute: along a straight line they hardly come forward."""
    basin = place_scene("basin", "shore", "clear", 127)
    boxes = tuple(replace(vessel, solid=shoebox()) for vessel in basin.vessels)  # of which exact geometry is quick
    basin = replace(basin, vessels=boxes, annotation=replace(basin.annotation, source="analytic"))
    known, _ = as_reported(basin, 1, AisErrors(position_m=1.0, position_s=300.0, delay_s=0.2))
    registration = register(known, "shore", Voyage.of(basin, "shore", WRONG).detections(1), noise_m=1.0)
    assert holds(registration, "clock_s"), registration
    assert registration["clock_s"].value == pytest.approx(WRONG["clock_s"], abs=0.3)
