"""Errors of truth, and learned box errors without them, on sets whose truth is wrong by known amounts."""

import json
from dataclasses import replace

import numpy as np
import pytest

from modsim3d.core.boxes import errors_between
from modsim3d.detector.model import ERROR_PAIRS
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import Rule
from modsim3d.geometry.camera_poses import world_R_vehicle
from modsim3d.learn.bootstrap import Column, Entry, Key
from modsim3d.learn.learned_detector import RICHER
from modsim3d.learn.voyage.deconvolution import deconvolve, share_left, subtract_reference_error, time_left
from modsim3d.learn.voyage.reference_error import PARAMETERS, ReferenceErrors, ReferenceNoise, View, box_jacobians
from modsim3d.scene.ais.scene_folder import REPORT
from modsim3d.scene.scene import Scene
from tests.formats import labelled_files
from tests.learn.one_state import detector_file, learned_in, normal_chain, observed_in

EVERY, LASTING_S, SEEDS = 6, 60.0, 20
STD_PX = np.array([6.0, 2.0, 2.0, 2.0])
VESSELS, STEPS, STEP_S = 12, 300, 4.0
BOX_ERROR = {"unit": "px", "mean": [0.0] * 4, "covariance": np.eye(4).tolist()}
CONFIDENCE = {"true": {"mean": 0.7, "std": 0.1}, "false": {"mean": 0.5, "std": 0.1}}
DETECTOR = detector_file("all", false=0.1, box_error=BOX_ERROR, confidence=CONFIDENCE)
DETECTOR |= {"false_positives": {"model": "calibrated"}}


@pytest.fixture(scope="module")
def roads():
    """Twelve vessels 0.5 to 2 km before a camera ashore, for 20 minutes."""
    rng = np.random.default_rng(1)
    vessels = {
        f"v{k}": {"length_m": length, "beam_m": length / 6, "air_draft_m": length / 5, "label": "boat"}
        for k, length in enumerate(np.linspace(30, 150, VESSELS).tolist())
    }
    times = np.arange(STEPS) * STEP_S
    start = np.column_stack([rng.uniform(600, 1900, VESSELS), rng.uniform(-250, 250, VESSELS)])
    course = rng.uniform(0, 2 * np.pi, VESSELS)
    positions = start + times[:, None, None] * (np.stack([np.cos(course), np.sin(course)], axis=-1) * 0.15)
    poses = {"positions_m": positions, "headings_rad": np.tile(course, (STEPS, 1)), "time_step_s": STEP_S}
    lens = {"focal_length_m": 0.008, "pixel_size_m": [5e-6, 5e-6], "principal_point_px": [960, 540]}
    camera = lens | {"image_size_px": [1920, 1080], "pose": {"position_m": [0, 0, 25], "yaw_rad": 0.0}}
    return Scene.from_dict({"vessels": vessels, "poses": poses, "cameras": {"shore": camera}, "detector": DETECTOR})


def view_of(scene, steps):
    return View(scene.cameras[0], scene.motion.at(steps), np.arange(len(steps)))


def boxes_of(scene, view, poses):
    """Boxes of all vessels in each frame by the project's own outlines, NaN where none is whole, shape (S, V, 4)."""
    steps = np.arange(len(view.images))
    outlines = scene.sight(view.camera, steps, poses).outlines(as_shoeboxes=True)
    boxes = np.full((len(steps), len(scene.vessels), 4), np.nan)
    whole = outlines.boxed & (outlines.in_frame_fraction == 1.0)
    boxes[outlines.frame[whole], outlines.occluder[whole]] = outlines.boxes_px[whole]
    return boxes


def moved(poses, offsets_m):
    """Poses with places moved east and north, shape (S, V, 2)."""
    places = poses.poses.positions_m.copy()
    places[..., :2] += offsets_m
    return replace(poses, poses=replace(poses.poses, positions_m=places))


def noisy_set(scene, view, times, seed=0, position_m=10.0, std_px=STD_PX, lasting_s=LASTING_S, box_s=0.0):
    """True boxes with errors (4,) in pixels, which last for `box_s`, are detected; annotations are of wrong places."""
    rng, gap_s = np.random.default_rng(seed), times[1] - times[0]
    true = boxes_of(scene, view, view.poses)
    off_m = position_m * normal_chain(np.exp(-gap_s / lasting_s), rng, *true.shape[:2], 2)
    reported = boxes_of(scene, view, moved(view.poses, off_m))
    frame, vessel = np.nonzero(np.isfinite(true).all(axis=-1) & np.isfinite(reported).all(axis=-1))
    white = rng.normal(size=(len(frame), 4))
    if box_s:
        white = normal_chain(np.exp(-gap_s / box_s), rng, *true.shape)[frame, vessel]
    shift, half = white[:, :2] * std_px[:2], white[:, 2:] * std_px[2:] / 2
    seen = true[frame, vessel] + np.concatenate([shift - half, shift + half], axis=1)
    shots = labelled_files.images(len(times), tuple(map(float, view.camera.intrinsics.image_size_px)), times)
    annotated = labelled_files.truth(frame, 0 * frame, reported[frame, vessel], identity=vessel)
    results = labelled_files.found(frame, 0 * frame, seen, np.full(len(frame), 0.9), origin=np.arange(len(frame)))
    return LabelledSet(("boat",), ("all",), shots, annotated, results)


def learned_from(labelled, replicates=20, without=RICHER):
    return learned_in(observed_in(labelled, Rule("provenance"), without, "all"), replicates=replicates)


@pytest.fixture(scope="module")
def watched(roads):
    """The scene, its view in every sixth step, and the times."""
    steps = np.arange(0, roads.steps, EVERY)
    return roads, view_of(roads, steps), roads.times_s(0, roads.steps)[steps]


@pytest.fixture(scope="module")
def exact(watched):
    """Errors of the one state that are learned from 20 replicates where truth is exact, and boxes of 40 px."""
    return learned_from(noisy_set(*watched, position_m=0.0)).numbers.box_errors.states[0], np.full((50, 4), 40.0)


def less(errors, noise, sides, measured=None):
    """Without what was measured, the law alone counts."""
    wide = every_row(1e6 * np.eye(4)) if measured is None else measured
    return deconvolve(errors, noise, sides, 0.95, wide, np.full(4, np.nan), measured is None)


def every_row(covariance):
    return np.tile(covariance, (21, 1, 1))


def noise_of(scene, position_m, **parameters):
    given = {"east": position_m, "north": position_m} | {k.replace("_", " "): v for k, v in parameters.items()}
    std = np.tile([given.get(name, 0.0) for name in PARAMETERS], (len(scene.vessels), 1))
    return ReferenceNoise(std, LASTING_S, {})


def test_derivatives_are_those_of_the_outlines_and_draws_have_the_covariance_of_independent_errors(watched):
    (scene, view, _), rng = watched, np.random.default_rng(0)
    boxes = boxes_of(scene, view, view.poses)
    rows = np.nonzero(np.isfinite(boxes).all(axis=-1))
    jacobians = box_jacobians(scene, view, *rows)
    offset_m = rng.normal(0, 1, (*boxes.shape[:2], 2))
    turn_rad = rng.normal(0, 0.003, boxes.shape[:2])
    moves = replace(moved(view.poses, offset_m), world_R_vessel=world_R_vehicle(turn_rad) @ view.poses.world_R_vessel)
    found = errors_between(boxes_of(scene, view, moves)[rows], boxes[rows])
    expected = np.einsum("nij,nj->ni", jacobians[..., :3], np.column_stack([offset_m[rows], turn_rad[rows]]))
    inside = np.isfinite(found).all(axis=1)
    assert inside.sum() > 500
    np.testing.assert_allclose(found[inside], expected[inside], atol=0.03)
    larger = tuple(replace(v, length_m=v.length_m + 0.4, air_draft_m=v.air_draft_m + 0.2) for v in scene.vessels)
    again = boxes_of(replace(scene, vessels=larger), view, view.poses)[rows]
    inside = np.isfinite(again).all(axis=1)
    expected = jacobians[inside][..., 3] * 0.4 + jacobians[inside][..., 5] * 0.2
    np.testing.assert_allclose(errors_between(again, boxes[rows])[inside], expected, atol=0.01)
    scene, rng, count = watched[0], np.random.default_rng(1), 3000
    jacobians = rng.normal(size=(count, 4, len(PARAMETERS)))
    fleeting = replace(noise_of(scene, 2.0, heading=0.1), position_s=1e-3)
    vessel, still = rng.integers(0, 12, count), np.full(count, -1)
    errors = ReferenceErrors(jacobians, np.arange(count) * 1.0, vessel, fleeting, np.ones((count, 4)), still)
    drawn = errors.covariances(20, 0).mean(axis=0)
    part = jacobians[..., :3] * fleeting.std[0, :3]
    np.testing.assert_allclose(drawn, (part @ np.swapaxes(part, 1, 2)).mean(axis=0), rtol=0.05, atol=0.1)
    # What all boxes share is in their mean and not in the covariance.
    jacobians, still = np.tile(np.eye(4, len(PARAMETERS)), (50, 1, 1)), np.full(50, -1)
    lasting = replace(noise_of(scene, 10.0), position_s=1e9)
    one = ReferenceErrors(jacobians, np.arange(50.0), 0 * still, lasting, np.ones((50, 4)), still)
    assert np.abs(one.covariances(20, 0)).max() < 1e-3


def test_intervals_hold_the_detectors_errors_and_an_upper_bound_is_the_learned_covariance(watched):
    scene, view, _ = watched
    held, plain, taken = np.zeros(4), np.zeros(4), np.zeros(4)
    for seed in range(SEEDS):
        learned = learned_from(noisy_set(*watched, seed), 40)
        found = subtract_reference_error(learned, scene, [view], noise_of(scene, 10.0), seed=seed)
        sure = found.states[0].taken_off
        low, high = found.learned.numbers.box_errors.states[0].std.column.interval(0.95, 50)
        held += (high >= STD_PX) & (~sure | (low <= STD_PX))
        taken += sure
        low, high = learned.numbers.box_errors.states[0].std.column.interval(0.95, 50)
        plain += (low <= STD_PX) & (high >= STD_PX)
        assert found.states[0].at_least[0] < 1.3 * STD_PX[0]
    assert (held >= 16).all()  # of 20, of which each holds with a chance of 95 %: fewer by chance once in 390 times
    assert taken[1:].tolist() == [SEEDS] * 3 and plain[0] == 0 <= plain[2] < 10
    scene, view, _ = watched
    labelled = noisy_set(*watched, std_px=np.array([0.5, 2.0, 2.0, 2.0]))
    learned = learned_from(labelled, 40)
    found = subtract_reference_error(learned, scene, [view], noise_of(scene, 10.0))
    (state,) = found.states
    assert state.bounds == ("e_x",)
    before, after = (each.detector()["states"]["all"]["box_error"] for each in (learned, found.learned))
    assert after["covariance"][0][0] == pytest.approx(before["covariance"][0][0], rel=1e-6)
    assert after["covariance"][2][2] < before["covariance"][2][2]
    assert any("an upper bound in e_x" in said for said in found.sentences())
    assert [row[-1] for row in found.rows()] == ["upper bound", "", "", ""]
    assert [each.upper_bound for each in found.components()] == [True, False, False, False]
    learned_std, _, _, written_std = zip(*(each.std for each in found.components()), strict=True)
    assert [a == b for a, b in zip(learned_std, written_std, strict=True)] == [True, False, False, False]
    low, high = found.learned.numbers.box_errors.states[0].correlation.column.interval(0.95, 50)
    assert ((low == -1) & (high == 1)).tolist() == [0 in pair for pair in ERROR_PAIRS]
    assert any(said.endswith("correlations with it are unknown") for said in found.sentences())


def test_of_a_vessel_put_in_its_place_only_what_changes_is_left_and_two_logs_move_it_once(watched):
    scene, view, times = watched
    frame, vessel = (each.ravel() for each in np.mgrid[: len(times), : len(scene.vessels)])
    jacobians = box_jacobians(scene, view, frame, vessel)
    told = np.isfinite(jacobians).all(axis=(1, 2))
    columns = jacobians[told], times[frame[told]], vessel[told]
    ones, still = np.ones((int(told.sum()), 4)), np.full(int(told.sum()), -1)
    wide = noise_of(scene, 10.0, antenna_along=20.0, antenna_across=5.0)
    std = [
        [ReferenceErrors(*columns, noise, ones, fit).covariances(20, 0)[:, 0, 0].mean() ** 0.5 for fit in fits]
        for noise, fits in ((replace(wide, position_s=1e9), (still, vessel[told])), (wide, (still, vessel[told])))
    ]
    assert std[0][1] < 0.02 * std[0][0]  # what never changes was found
    assert 0.2 * std[1][0] < std[1][1] < 0.9 * std[1][0]
    scene, view, times = watched
    labelled, off = noisy_set(*watched), noise_of(scene, 10.0)
    learned = learned_from(labelled)
    steps, middle, moves = np.arange(0, scene.steps, EVERY), len(times) // 2, np.arange(len(scene.vessels)) < 3
    parts = slice(middle), slice(middle, None)
    halves = [replace(view_of(scene, steps[part]), images=view.images[part], moved=moves) for part in parts]
    found = subtract_reference_error(learned, scene, halves, off)
    assert "; less what registration found of 3 vessels" in next(found.sentences())
    exact = subtract_reference_error(learned, scene, [view], noise_of(scene, 0.0))
    assert exact.learned is learned and list(exact.sentences()) == ["errors of truth: none are assumed"]
    unknown = np.full(len(labelled.annotations.identity), -1)
    unpaired = learned_from(replace(labelled, annotations=replace(labelled.annotations, identity=unknown)))
    assert subtract_reference_error(unpaired, scene, [view], off).learned.detector() == unpaired.detector()


def test_a_scene_from_ais_knows_what_was_missing(tmp_path, watched):
    scene = replace(watched[0], path=tmp_path / "scene.yaml")
    assert not ReferenceNoise.of(scene).std[:, 2:].any()
    vessels = {}
    for vessel in scene.vessels:
        sizes = {f"{name}_m": getattr(vessel, f"{name}_m") for name in ("length", "beam", "air_draft")}
        vessels[vessel.name] = {"messages": 10, "defaults": ["air_draft"], "replaced": {}, **sizes}
    vessels["v0"] |= {"defaults": ["length", "antenna", "air_draft"], "replaced": {"heading_from_course": 10}}
    vessels["v1"]["air_draft_m"] = 99.0  # the user has put another in the scene
    (tmp_path / REPORT).write_text(json.dumps({"vessels": vessels}))
    noise = ReferenceNoise.of(scene, 7.0)
    assert noise.position_m == 7.0 and noise.std[[0, 2], 2] == pytest.approx(np.radians([6, 1]))
    assert noise.std[[0, 2], 3] == pytest.approx([0.3 * scene.vessels[0].length_m, np.sqrt(2 / 12)])
    assert noise.std[1, 5] == 0 and noise.std[0, 6] > 0 == noise.std[2, 6]
    assert noise.reasons == {"length": 1, "antenna's place": 1, "air draft": len(scene.vessels) - 1}


def test_what_persists_of_truth_is_taken_off_what_persists_of_errors():
    gap_s, part, rest_s, rest_share = 0.5, np.array([0.3, 0.2]), 4.0, np.array([0.25, 0.1])
    seen = part + (1 - part) * np.exp(-gap_s / rest_s)
    time = Entry(Key(("persistence", "box_s")), Column(-gap_s / np.log(seen), "positive", np.array(9.0)))
    np.testing.assert_allclose(time_left(time, part, gap_s).column.values, rest_s, rtol=1e-9)
    share = Entry(Key(("persistence", "box_vessel_share")), Column(part + (1 - part) * rest_share, "capped", seen[0]))
    np.testing.assert_allclose(share_left(share, part).column.values, rest_share, rtol=1e-9)
    np.testing.assert_array_equal(time_left(time, 0 * part, gap_s).column.values, time.column.values)
    gone = time_left(time, np.array([0.95, 0.95]), gap_s).column.values
    assert gone[0] == 0
    assert gone[1] == pytest.approx(-gap_s / np.log(0.01))  # or intervals on a logarithmic scale have no end


def test_errors_that_last_come_back_with_their_time(roads):
    scene = roads
    steps, times = np.arange(scene.steps), scene.times_s(0, scene.steps)
    view, plain = view_of(scene, steps), tuple(set(RICHER) - {"persistence"})
    slow = replace(noise_of(scene, 5.0), position_s=1e5)
    labelled = noisy_set(scene, view, times, 0, 5.0, np.array([8.0, 2, 2, 2]), 1e5, box_s=6.0)
    learned = learned_from(labelled, 40, plain)
    found = subtract_reference_error(learned, scene, [view], slow)
    before, after = (each.numbers.box_errors.box_s for each in (learned, found.learned))
    assert abs(after.estimate - 6) < abs(before.estimate - 6)
    low, high = after.column.interval(0.95, learned.units[None])
    assert low <= 6 <= high
    quick = subtract_reference_error(learned, scene, [view], replace(slow, position_s=5.0))
    assert quick.learned.numbers.box_errors.box_s is before
    assert any("box_s: an upper bound" in said for said in quick.sentences())


def test_wrong_matches_do_not_pull_and_mixed_errors_lose_the_mean_covariance_of_truth(exact):
    errors, sides = exact
    noise = every_row(np.diag([4.0, 0.5, 0.5, 0.5]))
    measured = every_row(np.diag(0.99 * errors.std.estimate) ** 2)
    std = [less(errors, noise, sides, each).errors.std.estimate for each in (None, measured, 30 * measured)]
    assert std[1][0] == pytest.approx(np.sqrt(measured[0, 0, 0] - 4), rel=1e-6)
    np.testing.assert_allclose(std[2], std[0], rtol=1e-9)
    assert (std[2] < errors.std.estimate).all()
    # A vessel that is off its reports widens the tails of the law, which all components share.
    noise = every_row(np.diag(0.1 * errors.std.estimate**2))
    measured = every_row(np.diag(np.array([3, 0.9, 0.9, 0.9]) * errors.std.estimate) ** 2)
    share = np.sqrt(np.array([1, 0.81, 0.81, 0.81]) - 0.1)
    found = less(errors, noise, sides, measured).errors.std.estimate
    np.testing.assert_allclose(found, share * errors.std.estimate, rtol=1e-6)
    # Wide tails of a law are no errors of the detector.
    noise, measured = (every_row(np.diag(share * errors.std.estimate**2)) for share in (0.8, 0.7))
    assert less(errors, noise, sides).taken_off.any() and not less(errors, noise, sides, measured).taken_off.any()
    errors, sides = exact[0], np.random.default_rng(0).uniform(20, 200, (500, 4))
    growth = replace(errors.std, column=replace(errors.std.column, values=0.02 + 0 * errors.std.column.values))
    mixed = replace(errors, unit="mixed", growth=growth)
    noise = every_row(np.diag([4.0, 1.0, 1.0, 1.0]) + 0.3)
    found = less(mixed, noise, sides)
    assert found.taken_off.all()

    def mean_covariance(law):
        std = law.std.estimate + law.growth.estimate * sides
        matrix = np.eye(4)
        i, j = np.triu_indices(4, 1)
        matrix[i, j] = matrix[j, i] = law.correlation.estimate
        return (std[:, :, None] * std[:, None, :] * matrix).mean(axis=0)

    np.testing.assert_allclose(mean_covariance(found.errors), mean_covariance(mixed) - noise[0], rtol=1e-9, atol=1e-9)
