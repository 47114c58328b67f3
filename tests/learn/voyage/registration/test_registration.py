"""A wrong camera and clock come back from the detections; the model of boxes, intervals, and what cannot be known."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import binom

from benchmarks.stand_in.places import place_scene
from benchmarks.voyages.cases import AIS, REGISTRATION_SETTINGS
from benchmarks.voyages.reported import AisErrors, as_reported
from benchmarks.voyages.wrong_camera import WRONG, Voyage, really
from modsim3d import ModsimError, Scene, load_scene
from modsim3d.learn.voyage.registration import initial_guesses, parameters, registering
from modsim3d.learn.voyage.registration.estimating import KNOT_S, LASTS_S, drift_axes, fit_drift
from modsim3d.learn.voyage.registration.icp import Aligner, BoxesAtTimes, SightingResiduals, Sightings, match, predict
from modsim3d.learn.voyage.registration.initial_guesses import Guess, Search, rivals_of, starts
from modsim3d.learn.voyage.registration.model import BoxModel, HidingBodies, KnownTraffic, crosses, planes_of
from modsim3d.learn.voyage.registration.parameters import SHARED_NAMES, SHORT, Values
from modsim3d.learn.voyage.registration.registering import Registration, register
from modsim3d.truth.record import Truth
from modsim3d.world.poses.replay import RecordedPoses
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


QUAY, FERRY, FIRST, LAST = 1, 1, 60, 240


@pytest.fixture(scope="module")
def quay() -> Voyage:
    return Voyage.of(load_scene("strait", settings={"annotation.source": "analytic"}), "quay", {})


@pytest.fixture(scope="module")
def model(quay: Voyage) -> BoxModel:
    return BoxModel.of(quay.scene, KnownTraffic.of(quay.scene, quay.scene.cameras[0]))


@pytest.fixture(scope="module")
def none(model: BoxModel) -> Values:
    return Values.none(len(model.hulls_m))


def times_of(quay: Voyage, truth: Truth) -> np.ndarray:
    return quay.scene.times_s(0, quay.scene.steps)[truth.step]


def test_boxes_and_hidden_edges_are_those_of_the_truth_where_the_image_does_not_cut_them(quay, model, none) -> None:
    whole = quay.truth.take(quay.truth.in_frame_fraction == 1)
    boxes, corners = model.boxes(none, times_of(quay, whole), whole.vessel)
    assert len(whole) > 200
    np.testing.assert_allclose(boxes, whole.full_boxes_px, atol=1e-6)
    np.testing.assert_allclose(model.edges(none, times_of(quay, whole), whole.vessel, corners), boxes)
    known = quay.truth.take(np.isfinite(quay.truth.visible_boxes_px).all(axis=1))
    gone = np.abs(known.full_boxes_px - known.visible_boxes_px) > 1
    predicted = predict(model, HidingBodies.of(quay.scene, model), none, np.unique(times_of(quay, known)))
    frame = np.searchsorted(np.unique(known.step), known.step)
    rows = {pair: row for row, pair in enumerate(zip(predicted.frame.tolist(), predicted.vessel.tolist(), strict=True))}
    pairs = list(zip(frame.tolist(), known.vessel.tolist(), strict=True))
    # A vessel is not predicted if all its edges are behind the box around another, whose mesh may show some of it.
    usable = np.array([predicted.usable[rows[pair]] if pair in rows else np.zeros(4, bool) for pair in pairs])
    assert np.mean([pair in rows for pair in pairs]) > 0.99 and gone.sum() > 30
    assert not np.any(usable & gone) and usable.mean() > 0.6


def test_parameters_do_what_changing_the_camera_or_a_vessel_does(quay, model, none) -> None:
    changes = {"roll_deg": 2.0, "pitch_deg": -1.0, "yaw_deg": 3.0, "height_m": 2.0, "focal_share": 0.05}
    real = really(quay.scene, "quay", changes)
    times_s, vessel = np.repeat([5.0, 20.0], 9), np.tile(np.arange(9), 2)
    expected, _ = BoxModel.of(real, KnownTraffic.of(real, real.cameras[0])).boxes(none, times_s, vessel)
    found, _ = model.boxes(none.changed(clock_s=1.5, **changes), times_s - 1.5, vessel)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    # A delayed vessel is where it reports to be later, and an antenna is off its centre.
    times_s, vessel, values = np.array([10.0]), np.array([3]), Values.none(len(model.hulls_m))
    values.vessels[3] = 4.0, 1.0, 2.0
    (point,) = model.points_world(values, times_s, vessel, np.zeros((1, 1, 3)))[0]
    (late, rotation) = (part[0] for part in model.traffic.at(times_s + 2.0, vessel))
    np.testing.assert_allclose(point, late - rotation @ (4.0, 1.0, 0.0))


def test_two_vessels_that_a_detection_may_be_are_not_matched(model, quay, none) -> None:
    time_s = np.array([10.0])
    predicted = predict(model, HidingBodies.of(quay.scene, model), none, time_s)
    box, gates = predicted.boxes_px[:1], np.full((len(predicted.frame), 2), 50.0)
    found = BoxesAtTimes(time_s, np.array([0]), box)
    assert match(found, predicted, (1920, 1080), gates).vessel.tolist() == predicted.vessel[:1].tolist()
    twice = BoxesAtTimes(time_s, np.array([0, 0]), np.concatenate([box - 5, box + 5]))
    assert not len(match(twice, predicted, (1920, 1080), gates))


def test_a_ray_is_hidden_by_a_solid_on_its_way_and_by_none_before_or_behind_it() -> None:
    block = planes_of(np.array([(x, y, z) for x in (4.0, 6.0) for y in (-1.0, 1.0) for z in (0.0, 3.0)]))
    assert block is not None
    ends = np.array([[10.0, 0.0, 1.0], [3.0, 0.0, 1.0], [10.0, 5.0, 1.0], [10.0, 0.0, 9.0], [-10.0, 0.0, 1.0]])
    assert crosses(np.zeros((5, 3)), ends, block).tolist() == [True, False, False, False, False]


@pytest.fixture(scope="module")
def strait() -> Scene:
    return load_scene("strait", settings={"annotation.source": "analytic", "waves.apply_to": "ownship"})


def with_places(strait: Scene, **changes: np.ndarray) -> KnownTraffic:
    poses = replace(strait.poses.poses(0, strait.steps), **changes)
    changed = replace(strait, poses=RecordedPoses(strait.poses.timestamps, poses))
    return KnownTraffic.of(changed, changed.cameras[QUAY])


def test_a_vessel_goes_on_beyond_the_ends_of_its_track_but_is_not_there(strait: Scene) -> None:
    """The ferry is there from step 60 to 240 of 300 alone; where it is absent, its place is written as 0."""
    known = strait.poses.poses(0, strait.steps)
    present, positions = known.present.copy(), known.positions_m.copy()
    present[:FIRST, FERRY] = present[LAST + 1 :, FERRY] = False
    positions[~present] = 0
    cut = with_places(strait, present=present, positions_m=positions)
    steps_s = strait.times_s(0, strait.steps)
    whole = KnownTraffic.of(strait, strait.cameras[QUAY])
    times = np.array([steps_s[FIRST] - 2.0, steps_s[FIRST], steps_s[LAST], steps_s[LAST] + 2.0])
    ferry = np.full(4, FERRY)
    np.testing.assert_allclose(cut.at(times, ferry)[0], whole.at(times, ferry)[0], atol=0.05)
    assert cut.presence(times, ferry).tolist() == [False, True, True, False]
    ends = np.array([-1.0, 0.0, steps_s[-1], steps_s[-1] + 1.0])
    assert whole.presence(ends, ferry).tolist() == [False, True, True, False]
    moved = np.diff(whole.at(ends, ferry)[0], axis=0)
    assert np.linalg.norm(moved[[0, 2]], axis=1) == pytest.approx([4.5, 4.5], abs=0.3)


def test_mean_speeds_do_not_follow_the_errors_of_reports_and_are_ahead_in_a_turn(strait: Scene) -> None:
    known, times_s = strait.poses.poses(0, strait.steps), strait.times_s(0, strait.steps)
    noise = np.random.default_rng(0).normal(0, 0.5, known.positions_m.shape)
    noisy, exact = (with_places(strait, positions_m=known.positions_m + each) for each in (noise, 0 * noise))
    times, ferry = np.linspace(5, 55, 20), np.full(20, FERRY)
    found = noisy.velocities(times, ferry)
    np.testing.assert_allclose(found, exact.velocities(times, ferry), atol=0.08)
    np.testing.assert_allclose(found[:, 0], 4.5, atol=0.2)
    assert np.abs(found[:, 1]).max() < 0.2
    positions, headings, radius_m, speed_m_s = known.positions_m.copy(), known.headings_rad.copy(), 15.0, 3.0
    turned_rad = speed_m_s / radius_m * times_s  # within the time of a mean
    positions[:, FERRY, :2] = radius_m * np.column_stack([np.sin(turned_rad), -np.cos(turned_rad)])
    headings[:, FERRY] = turned_rad
    turning = with_places(strait, positions_m=positions, headings_rad=headings)
    found = turning.velocities(np.linspace(0, times_s[-1], 20), ferry)
    np.testing.assert_allclose(found, np.tile([speed_m_s, 0.0], (20, 1)), atol=0.01)


def test_a_vessel_that_heads_west_and_is_away_for_a_while_does_not_turn_meanwhile(strait: Scene) -> None:
    """Where it is absent its heading is written as 0, between others to either side of ±π."""
    known, times_s = strait.poses.poses(0, strait.steps), strait.times_s(0, strait.steps)
    present, positions, headings = known.present.copy(), known.positions_m.copy(), known.headings_rad.copy()
    positions[:, FERRY, :2] = np.column_stack([-5.0 * times_s, 0 * times_s])
    headings[:, FERRY] = np.where(times_s < 30, np.pi - 0.02, 0.02 - np.pi)
    away = (times_s > 28) & (times_s < 34)
    present[away, FERRY] = False
    headings[away, FERRY] = 0
    traffic = with_places(strait, present=present, positions_m=positions, headings_rad=headings)
    times, ferry = np.linspace(0, times_s[-1], 20), np.full(20, FERRY)
    np.testing.assert_allclose(traffic.velocities(times, ferry), np.tile([5.0, 0.0], (20, 1)), atol=0.15)
    np.testing.assert_allclose(np.cos(traffic.at(np.array([31.0]), ferry[:1])[1][0, 0, 0]), np.cos(-1.0), atol=0.01)


def test_a_point_that_k1_folds_into_the_image_is_no_edge_to_go_by(strait: Scene) -> None:
    model = BoxModel.of(strait, KnownTraffic.of(strait, strait.cameras[QUAY]))
    none, times = Values.none(len(model.hulls_m)), np.linspace(0, 59, 60)
    folded = predict(model, HidingBodies.of(strait, model), none.changed(k1=-0.25), times)
    by_lens = model.pixels(none, times[folded.frame], folded.vessel, folded.corners_m)
    far = np.any(np.abs(by_lens / strait.cameras[QUAY].intrinsics.image_size_px - 0.5) > 1, axis=-1)
    assert far.sum() > 10 and folded.usable.sum() > 100
    assert not np.any(folded.usable & far)


DRAWS, VESSELS, FRAMES = 400, 8, 60
SEEN, NOISE_M, OFFSET_M, DELAY_S = 20, 3.0, 2.0, 0.5
TRUE = np.array([2.0, -1.0])


@pytest.mark.parametrize("together", [0.0, 1.0])
def test_intervals_hold_95_percent_with_few_vessels_whose_errors_go_together(together: float) -> None:
    rng, held, vessel = np.random.default_rng(0), np.zeros(2), np.repeat(np.arange(VESSELS), FRAMES)
    for _ in range(DRAWS):
        slope = rng.normal(size=VESSELS)[vessel] + 0.3 * rng.normal(size=len(vessel))
        slopes = np.column_stack([np.ones(len(vessel)), slope])
        errors = rng.normal(size=len(vessel)) + together * rng.normal(size=VESSELS)[vessel]  # a part is the vessel's
        estimate, *_ = np.linalg.lstsq(slopes, errors, rcond=None)
        held += np.abs(estimate) <= parameters.Linear(slopes, errors - slopes @ estimate).known_by(vessel).half_widths
    low, high = binom.ppf([0.001, 0.999], DRAWS, 0.95)
    assert np.all(held >= low)
    assert np.all(held <= min(high + 0.03 * DRAWS, DRAWS))  # a wider interval is no error, a useless one is


def test_whitening_takes_off_what_rows_of_a_vessel_share() -> None:
    rng = np.random.default_rng(1)
    vessel = np.repeat(np.arange(2), 3)
    slopes, residuals, shared = rng.normal(size=(6, 2)), rng.normal(size=6), rng.normal(size=(6, 1))
    white = parameters.Linear(slopes, residuals).whitened(shared, vessel)
    covariance = np.eye(6) + np.where(vessel[:, None] == vessel, shared @ shared.T, 0.0)
    np.testing.assert_allclose(white.information, slopes.T @ np.linalg.inv(covariance) @ slopes)
    np.testing.assert_allclose(white.residuals @ white.residuals, residuals @ np.linalg.inv(covariance) @ residuals)


def test_of_two_values_that_look_the_same_one_is_held_and_the_exchange_is_said() -> None:
    rng = np.random.default_rng(2)
    base = 30 * rng.normal(size=(500, 2))
    names = ("pitch_deg", "focal_share", "height_m")
    slopes = np.stack([base[:, 0], base[:, 1], 2 * base[:, 0]], axis=1)  # in plausible distances
    (group,) = parameters.undetermined(parameters.Linear(slopes, rng.normal(size=500)), names, np.arange(500))
    assert group.held == "height_m"
    pitch, height = parameters.plausible(["pitch_deg", "height_m"])
    assert dict(group.exchange) == pytest.approx({"pitch_deg": -2 * pitch / height})
    assert group.words() == "height_m is held; 1 m of it looks like -2° of pitch_deg"


def offsets(spread: float) -> tuple[parameters.VesselEffects, np.ndarray]:
    """Effects of slopes by along, across and delay at 3 m/s with random offsets along, and the offsets."""
    rng = np.random.default_rng(3)
    vessel, along = np.repeat(np.arange(12), 50), rng.normal(0, spread, 12)
    slopes = rng.normal(0, 1, (600, 2))
    slopes = np.column_stack([slopes, -3 * slopes[:, 0]])
    residuals = rng.normal(size=600) - slopes[:, 0] * along[vessel]
    return parameters.vessel_effects(slopes, residuals, np.zeros((600, 1)), vessel, 1.0), along


def test_offsets_of_vessels_at_constant_speed_are_known_as_one_shift_along_or_across() -> None:
    def known_at_3_m_s(effects: parameters.VesselEffects) -> list[tuple[str, str, str, float, float]]:
        return parameters.vessel_values(effects, np.zeros((1, 1)), np.full(12, 3.0), [f"v{i}" for i in range(12)])

    effects, along = offsets(4.0)
    assert 2.5 < effects.spreads[0] < 6
    known = known_at_3_m_s(effects)
    assert {name.split(".")[1] for name, *_ in known} == {"ahead_m"}  # an offset and a delay look alike
    for place, (_, _, _, value, error) in enumerate(known):
        assert abs(value + along[place]) < 4 * error < 1
    known = known_at_3_m_s(replace(effects, spreads=np.array([0.0, 2.0, 0.0])))
    assert {name.split(".")[1] for name, *_ in known} == {"across_m"} and all(0.1 < error < 0.2 for *_, error in known)
    assert np.all(offsets(0.0)[0].spreads < 0.2)  # of exact reports; an offset is known to 0.14 m


def residuals_of(time_s: np.ndarray, vessel: np.ndarray) -> SightingResiduals:
    """A bearing of each of some sightings, of boxes of one size."""
    count = len(time_s)
    rows, four = np.arange(count), np.zeros((count, 4))
    sightings = Sightings(rows, rows, time_s, vessel, four, four > -1, four, np.zeros((count, 4, 3)))
    return SightingResiduals(sightings, rows, np.zeros(count, dtype=int), np.zeros(count), np.full(count, 50.0))


def test_the_drift_has_the_covariance_of_a_gauss_markov_process_and_each_vessel_its_own() -> None:
    one_s = np.arange(0, 61, KNOT_S)
    count = len(one_s)
    vessel = np.repeat([4, 7], count)
    axes = drift_axes(np.tile(one_s, 2), vessel, np.array([OFFSET_M, 0.0, DELAY_S]), NOISE_M)[:count]
    process = np.exp(-np.abs(one_s[:, None] - one_s) / LASTS_S)
    for axis, constant, noise in ((0, OFFSET_M, NOISE_M), (1, 0.0, NOISE_M), (2, DELAY_S, 0.0)):
        # knots lie a little closer than `KNOT_S`, and between them the process is linear
        np.testing.assert_allclose(axes[:, axis] @ axes[:, axis].T, noise**2 * process + constant**2, rtol=0.005)
    np.testing.assert_allclose(axes[:, 0] @ axes[:, 1].T, 0, atol=1e-12)


def test_draws_spread_as_the_fit_says_and_less_than_without_drifts() -> None:
    rng = np.random.default_rng(1)
    time_s, vessel = np.tile(np.linspace(0, 60, SEEN), VESSELS), np.repeat(np.arange(VESSELS), SEEN)
    residuals, count = residuals_of(time_s, vessel), VESSELS * SEEN
    slopes = np.stack([np.ones(count), rng.normal(size=VESSELS)[vessel] + 0.02 * time_s], axis=1)
    own = np.column_stack([np.ones(count), np.zeros((count, 2))])
    axes = drift_axes(time_s, vessel, np.array([OFFSET_M, 0, 0]), NOISE_M)
    found, plain = [], []
    for _ in range(40):
        normals = rng.normal(size=(VESSELS, axes.shape[2]))
        px = rng.normal(size=count) + (axes[:, 0] * normals[vessel]).sum(axis=1) - slopes @ TRUE
        drift = fit_drift(residuals, px, px, slopes, own, axes, 1.0)
        found.append(drift.change)
        plain.append(-np.linalg.lstsq(slopes, px, rcond=None)[0])
    white = parameters.Linear(slopes, np.zeros(count)).whitened(axes[:, 0], vessel)
    expected = np.sqrt(np.diagonal(white.known_by_model(1.0, 10.0).covariance))
    np.testing.assert_allclose(np.std(found, axis=0), expected, rtol=0.25)
    np.testing.assert_allclose(np.mean(found, axis=0), TRUE, atol=3.5 * expected.max() / np.sqrt(40))
    assert np.all(np.std(found, axis=0) < np.std(plain, axis=0))
    assert np.std(drift.errors_px) == pytest.approx(1, abs=0.15)


def test_intervals_cover_what_explains_the_data_nearly_as_well() -> None:
    known = parameters.Knowledge(np.eye(2), np.array([1.0, 2.0]), np.ones(2))
    np.testing.assert_array_equal(parameters.covering(known, []).half_widths, [1.0, 2.0])
    other = [np.array([0.5, -3.0]), np.array([-4.0, 0.0])]
    np.testing.assert_array_equal(parameters.covering(known, other).half_widths, [5.0, 5.0])
