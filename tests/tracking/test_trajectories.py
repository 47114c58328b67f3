"""T-GOSPA and OSPA(2) against examples of their authors and all assignments; approaches to own ship by hand."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from modsim3d import RunRows, Tracks
from modsim3d.tracking.lookout import LOST_S, approaches, tracks_in_images, tracks_in_world
from modsim3d.tracking.scores.scored_run import Rules, ScoredRun
from modsim3d.tracking.scores.trajectories import TrajectorySets, ospa2, t_gospa
from modsim3d.tracking.world.following import WorldTruth, follow_in_world
from tests.scenes import camera_keys
from tests.tracking.test_world_scores import tracks_of
from tests.tracks import track_files
from tests.tracks.track_files import ANCHORED, CROSSER, NAMES, PLACES_M, TIMES_S

C, GAMMA = 5.0, 1.0
NONE = np.nan


def sets_of(truths, tracks, cutoff=C):
    """Sets of trajectories on a line, NaN where one is absent: shapes (n, steps) and (m, steps)."""
    frames = []
    for x, y in zip(np.transpose(truths), np.transpose(tracks), strict=True):
        a, b = np.flatnonzero(~np.isnan(x)), np.flatnonzero(~np.isnan(y))
        frames.append((a, b + 100, np.abs(x[a][:, None] - y[b])))
    return TrajectorySets.of(frames, cutoff)


def line(value, first=1, last=5, steps=5):
    return [value if first <= step <= last else NONE for step in range(1, steps + 1)]


# The six examples that García-Fernández, Rahmathullah & Svensson (2020) discuss, and a seventh with a hole, with the
# numbers of the authors' demonstration: one dimension, c = 5, p = 1, γ = 1, δ = 1 and Δ = 0.1. Sums worked out by hand.
EXAMPLES = {
    "one track is off by δ": ([line(1)], [line(2)], (5, 0, 0, 0)),
    "it ends a step early": ([line(1)], [line(2, 1, 4)], (4, 2.5, 0, 0)),
    "it is split into two": ([line(1)], [line(1.1, 1, 3), line(1.1, 4, 5)], (0.5, 0, 0, 1)),
    "both sides have a split, and cross": (
        [line(1), line(2.2, 1, 3), line(2.2, 4, 5)],
        [line(1.1, 1, 3), line(1.1, 4, 5), line(2.1)],
        (1, 0, 0, 2),
    ),
    "exchanged halfway": ([line(1, steps=4), line(2.2, steps=4)], [[2, 2, 1.2, 1.2], [1.2, 1.2, 2, 2]], (1.6, 0, 0, 2)),
    "one of two is split": (
        [line(1, steps=4), line(2.2, steps=4)],
        [line(2, steps=4), line(1.2, 1, 2, 4), line(1.2, 3, 4, 4)],
        (1.6, 0, 0, 1),
    ),
    "a hole is no switch": ([line(0.5), [2, 2, NONE, 2, 2]], [line(1.5), line(0)], (4.5, 0, 2.5, 0)),
}


@pytest.mark.parametrize("example", EXAMPLES)
def test_the_authors_examples_have_the_sums_of_their_parts(example):
    truths, tracks, parts = EXAMPLES[example]
    found = t_gospa(sets_of(truths, tracks), 1, GAMMA)
    assert found is not None
    assert [each * len(truths[0]) for each in found] == pytest.approx([sum(parts), *parts])


def by_trying_all(truths, tracks, power, switch):
    """The metric by the best sequence of assignments, each step's tried all."""
    n, m, alone = len(truths), len(tracks), C**power / 2
    choices = [
        way for way in itertools.product(range(-1, m), repeat=n) if len({*way} - {-1}) == sum(j >= 0 for j in way)
    ]

    def cost(step, choice):
        taken, total = set(), 0.0
        for x, j in zip(truths[:, step], choice, strict=True):
            y = NONE if j < 0 else tracks[j, step]
            taken |= {j}
            there = (not np.isnan(x)) + (not np.isnan(y))
            total += min(abs(x - y), C) ** power if there == 2 else alone * there
        return total + alone * sum(not np.isnan(tracks[j, step]) for j in range(m) if j not in taken)

    def change(one, other):
        return switch**power / 2 * sum((a >= 0) + (b >= 0) for a, b in zip(one, other, strict=True) if a != b)

    best = {each: cost(0, each) for each in choices}
    for step in range(1, truths.shape[1]):
        best = {each: cost(step, each) + min(best[one] + change(one, each) for one in choices) for each in choices}
    return min(best.values())


@pytest.mark.parametrize("power", [1, 2])
def test_t_gospa_is_that_of_the_best_of_all_assignments(power):
    rng = np.random.default_rng(4)
    for _ in range(25):
        truths, tracks = rng.uniform(0, 8, (2, 5)), rng.uniform(0, 8, (3, 5))
        for each in (truths, tracks):
            each[rng.random(each.shape) < 0.25] = NONE
        switch = float(rng.uniform(0.2, 6))
        found = t_gospa(sets_of(truths, tracks), power, switch)
        assert found is not None
        assert 5 * found.t_gospa**power == pytest.approx(by_trying_all(truths, tracks, power, switch), abs=1e-4)
        assert found.t_gospa**power == pytest.approx(sum(found[1:]))


def test_long_trajectories_that_rival_for_moments_only_make_a_small_program_with_the_same_result(monkeypatch):
    steps, sizes = 4000, []
    truths = np.vstack([np.zeros(steps), np.full(steps, 40.0)])
    tracks = np.full((40, steps), NONE)
    for index in range(40):
        tracks[index, 100 * index : 100 * index + 104] = 1  # each begins four steps before the one before it ends
    from modsim3d.tracking.scores import trajectories

    solve = trajectories.linprog
    counted = lambda cost, *rest, **more: sizes.append(len(cost)) or solve(cost, *rest, **more)  # noqa: E731
    monkeypatch.setattr(trajectories, "linprog", counted)
    found = t_gospa(sets_of(truths, tracks), 1, GAMMA)
    assert found is not None and sum(sizes) < 2000
    expected = (1 * steps, C / 2 * steps, C / 2 * 4 * 39, GAMMA * 39)
    assert [each * steps for each in found[1:]] == pytest.approx(expected)


def test_ospa2_of_tracks_that_are_there_half_the_time_or_split_is_worked_out_by_hand():
    whole, half = np.zeros((1, 8)), np.where(np.arange(8) < 4, 1.0, NONE)[None]
    assert ospa2(sets_of(whole, whole + 2), 1, 8) == pytest.approx(2)
    assert ospa2(sets_of(whole, half), 1, 8) == pytest.approx((4 * 1 + 4 * C) / 8)
    split = np.vstack([half, half[:, ::-1]])
    # One half is assigned, at a distance of (1 + c) / 2; the other is one track too many of two.
    assert ospa2(sets_of(whole, split), 1, 8) == pytest.approx(((1 + C) / 2 + C) / 2)
    assert ospa2(sets_of(whole, split), 2, 8) == pytest.approx((((1 + C) ** 2 / 4 + C**2) / 2) ** 0.5)
    assert ospa2(sets_of(whole, split), 1, 4) == pytest.approx(1)  # in each window it is one track
    nothing = np.full((1, 8), NONE)
    assert [ospa2(sets_of(*each), 1, 8) for each in ((nothing, nothing), (whole, nothing))] == [0, C]
    assert ospa2(TrajectorySets.of([], C), 1, 8) is t_gospa(TrajectorySets.of([], C), 1, 1) is None


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> RunRows:
    return RunRows.of(track_files.sea_run(tmp_path_factory.mktemp("sea") / "run"))


@pytest.fixture(scope="module")
def seen(rows: RunRows) -> np.ndarray:
    return WorldTruth.of(rows).scored


def found_of(rows: RunRows, parts) -> dict:
    following = follow_in_world(WorldTruth.of(rows), tracks_of(parts), 50.0)
    return {each.vessel: each for each in approaches(rows, tracks_in_world(rows, following))}


def apart_m(vessel: int, step: int) -> float:
    return float(np.hypot(*(PLACES_M[step, vessel] - PLACES_M[step, 0])))


def test_an_approach_has_its_distances_and_a_vessel_is_lost_after_five_seconds_in_view(rows, seen):
    found = found_of(rows, [(CROSSER, TIMES_S[6:40]), (ANCHORED, TIMES_S[20:])])
    assert set(found) == {"crosser", "anchored"}  # no camera sees the vessel astern
    crosser = found["crosser"]
    assert (crosser.own_ship, crosser.label, crosser.length_m) == ("own", "boat", 12)
    assert crosser.in_view_m == pytest.approx(apart_m(CROSSER, 0), abs=1e-3)
    # The closest approach is at 20.49 s; steps are 0.5 s apart.
    assert crosser.closest_m == pytest.approx(min(apart_m(CROSSER, step) for step in range(60)), abs=1e-3)
    assert crosser.known_m == crosser.one_track_m == pytest.approx(apart_m(CROSSER, 6), abs=1e-3)
    assert found["anchored"].known_m == pytest.approx(apart_m(ANCHORED, 20), abs=1e-3)
    short, long = int(LOST_S / 0.5), int(LOST_S / 0.5) + 1
    hidden = np.flatnonzero(~seen[:, ANCHORED])
    assert hidden[-1] < 42 and len(hidden) > 1
    for missing, kept, one in ((short, 0, 0), (long, 42 + long, 42 + long)):
        parts = [(ANCHORED, np.delete(TIMES_S, np.arange(42, 42 + missing)))]
        found = found_of(rows, parts)["anchored"]
        apart = [apart_m(ANCHORED, s) for s in (kept, one)]
        assert [found.known_m, found.one_track_m] == pytest.approx(apart, abs=1e-3)
    found = found_of(rows, [(ANCHORED, TIMES_S[:30]), (ANCHORED, TIMES_S[30:])])["anchored"]
    assert [found.known_m, found.one_track_m] == pytest.approx([apart_m(ANCHORED, s) for s in (0, 30)], abs=1e-3)
    around = np.arange(hidden[0], min(hidden[-1] + short, 59))  # too long, but for the time in which it is hidden
    assert len(around) > short
    known_m = found_of(rows, [(ANCHORED, np.delete(TIMES_S, around))])["anchored"].known_m
    assert known_m == pytest.approx(200.998, abs=1e-3)
    for times in (TIMES_S[:40], np.zeros(0)):  # gone before the end, or never there
        assert found_of(rows, [(CROSSER, TIMES_S[:1]), (ANCHORED, times)])["anchored"].known_m == 0


def test_tracks_in_the_images_are_those_of_own_ships_cameras_and_each_camera_has_its_own(tmp_path: Path) -> None:
    ahead = {"vessel": "own", "position_m": [5, 0, 6], "pitch_rad": 0.02}
    cameras = {name: camera_keys(1280, 720, focal_length_m=0.008, mount=ahead) for name in ("bow", "twin")}
    cameras["ashore"] = camera_keys(1280, 720, focal_length_m=0.008, pose={"position_m": [-300, 0, 9]})
    rows = RunRows.of(track_files.sea_run(tmp_path / "run", cameras=cameras))
    here = np.flatnonzero(rows.truth_vessel == ANCHORED)
    frame, boxes = rows.truth_frame[here], rows.annotated_boxes_px[here]
    halves = (frame % 3 == 0) & (frame < 90) | (frame % 3 == 1) & (frame >= 90)  # by one camera, then by the other

    def kept(chosen):
        tracks = Tracks.of(3, frame[chosen], np.full(int(chosen.sum()), 7), boxes[chosen])
        following = ScoredRun.of(rows, tracks, Rules()).following
        found = {each.vessel: each for each in approaches(rows, tracks_in_images(rows, following))}
        return found[NAMES[ANCHORED]]

    every, both, ashore = kept(frame % 3 == 0), kept(halves), kept(frame % 3 == 2)
    assert (every.known_m, every.one_track_m) == (pytest.approx(200.998, abs=1e-3),) * 2
    assert (both.known_m, ashore.known_m) == (every.known_m, 0)
    assert both.one_track_m == pytest.approx(apart_m(ANCHORED, 30), abs=1e-3)


def test_a_vessel_that_is_lost_after_the_closest_approach_was_known(tmp_path: Path) -> None:
    port = {"vessel": "own", "position_m": [5, 0, 6], "pitch_rad": 0.02, "yaw_rad": np.pi / 2}
    cameras = {"port": camera_keys(1280, 720, focal_length_m=0.008, mount=port)}
    rows = RunRows.of(track_files.sea_run(tmp_path / "run", cameras=cameras))
    seen = np.flatnonzero(WorldTruth.of(rows).scored[:, CROSSER])
    assert seen[-1] == 59 and TIMES_S[seen[0]] < 20.49  # it passes at 20.49 s, and is in view to the end
    (found,) = [each for name, each in found_of(rows, [(CROSSER, TIMES_S[:43])]).items() if name == "crosser"]
    assert found.known_m == found.in_view_m > found.closest_m
