"""Trackers in the world, on sightings that these tests simulate themselves."""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2
from stonesoup.dataassociator.probability import JPDA
from stonesoup.updater.kalman import ExtendedKalmanUpdater

from modsim3d.core.errors import ModsimError
from modsim3d.geometry.camera import Camera, Intrinsics
from modsim3d.geometry.camera_poses import Mount
from modsim3d.runs.locating import Locations
from modsim3d.tracking.trackers.interface import SensedFrame
from modsim3d.tracking.trackers.stone_soup import StoneSoupWorld, WorldGnn, WorldJpda
from modsim3d.tracking.trackers.world_interface import AisReport, WorldFacts, WorldFrame, WorldStep, WorldTrackedStep

HEIGHT_M, STEP_S = 10.0, 0.5
BEARING_STD, INVERSE_STD = 2e-3, 1e-4
"""In rad and 1/m: at 300 m, 0.6 m across and 9 m along."""
CAMERA = Camera("bow", Intrinsics((1000.0, 1000.0), (960.0, 540.0), (1920, 1080)), Mount((0.0, 0.0, HEIGHT_M)))
FACTS = WorldFacts((CAMERA,), ("boat",), ("own",))
Places = Callable[[float], Any]
"""Positions of the vessels at a time, shape (n, 2); NaN for one that is not detected."""

EXACT = {"waterline_m": 0.0, "extent_m": 0.001}
"""Settings for vessels without size."""

both = pytest.mark.parametrize("model", [WorldGnn, WorldJpda])


def frame(time_s: float, vessels_m: Any, camera_m: Any, generator: Any, behind_m: float) -> WorldFrame:
    """What a camera measures of vessels, (n, 2), by the definitions of docs/positions.md."""
    vessels_m = vessels_m[np.isfinite(vessels_m[:, 0])]
    away, count = vessels_m - camera_m, len(vessels_m)
    bearing = np.arctan2(away[:, 1], away[:, 0])
    inverse = 1 / (np.hypot(*away.T) - behind_m)
    if generator is not None:
        bearing = bearing + generator.normal(0, BEARING_STD, count)
        inverse = inverse + generator.normal(0, INVERSE_STD, count)
    located = Locations(
        bearing,
        np.full(count, BEARING_STD),
        inverse,
        np.full(count, INVERSE_STD),
        np.zeros(count),
        np.full((count, 2), np.nan),
        np.full((count, 2, 2), np.nan),
    )
    sensed = SensedFrame(time_s, np.zeros((count, 4)), np.zeros(count, int), np.full(count, 0.9))
    return WorldFrame(CAMERA.name, sensed, located, np.array([*camera_m, HEIGHT_M]), np.eye(3))


def steps_of(places: Places, count: int, seed=1, *, own_m_s=3.0, behind_m=0.0, ais=None) -> Iterator[WorldStep]:
    """Steps at which a camera on own ship, which makes way along w1, sees the vessels."""
    generator = None if seed is None else np.random.default_rng(seed)
    for step in range(count):
        time_s = step * STEP_S
        seen = frame(time_s, places(time_s), np.array([own_m_s * time_s, 0.0]), generator, behind_m)
        yield WorldStep(step, time_s, (seen,), () if ais is None else ais(time_s), ())


def answers(tracker: StoneSoupWorld, steps: Iterator[WorldStep]) -> list[WorldTrackedStep]:
    return list(tracker.follow_world(steps, FACTS))


def nearest(answer: WorldTrackedStep, place_m: Any) -> tuple[int, float]:
    """The track nearest to a place, and its distance; −1 and infinity without tracks."""
    if not len(answer.track):
        return -1, np.inf
    away = np.hypot(*(answer.position_m - place_m).T)
    return int(answer.track[away.argmin()]), float(away.min())


def crossing_m(time_s: float) -> Any:
    """Two vessels whose bearings cross at about 20 s, 60 m apart."""
    return np.array([[300.0 + 0 * time_s, -80 + 4 * time_s], [360.0, 80 - 4 * time_s]])


def with_gap(time_s: float) -> Any:
    """The crossing; the second vessel is missed for four seconds."""
    places_m = crossing_m(time_s)
    return np.where([[False], [28 <= time_s < 32]], np.nan, places_m)


@both
def test_crossing_vessels_keep_their_tracks_through_a_gap_and_the_same_steps_give_the_same_bytes(model):
    found = answers(model(**EXACT), steps_of(with_gap, 100))
    names = [[nearest(answer, place)[0] for place in crossing_m(k * STEP_S)] for k, answer in enumerate(found)]
    assert not any(len(answer.track) for answer in found[:3])  # four detections confirm a track
    assert set(map(tuple, (names[k] for k in (10, 50, 55, 70, 99)))) == {(names[10][0], names[10][1])}
    assert names[10][0] != names[10][1]
    steps = [k for k in range(30, 100) if k not in range(60, 64)]
    off = [nearest(found[k], place)[1] for k in steps for place in crossing_m(k * STEP_S)]
    assert np.sqrt(np.mean(np.square(off))) < 5
    np.testing.assert_allclose(found[99].velocity_m_s[np.argsort(names[99])], [[0, 4], [0, -4]], atol=0.8)
    assert len({track for answer in found for track in answer.track.tolist()}) == 2
    tracker = model()
    one, other = (tracker.follow_world(steps_of(dense_m, 8), FACTS) for _ in range(2))
    for first, second in zip(one, other, strict=True):  # in turn: sets of one are not where those of the other are
        for name in ("track", "position_m", "velocity_m_s", "covariance"):
            np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert len(first.track)


def dense_m(time_s: float) -> Any:
    """Twelve vessels a few metres apart: most measurements lie in most gates."""
    return np.stack([300.0 + 6 * (np.arange(12) // 3), -6 + 6.0 * (np.arange(12) % 3) + 2 * time_s], axis=-1)


@both
def test_a_dense_group_takes_one_expected_measurement_for_each_track_and_frame_and_no_enumeration(model, monkeypatch):
    expected, predict = [], ExtendedKalmanUpdater.predict_measurement
    counted = lambda *a, **k: expected.append(0) or predict(*a, **k)  # noqa: E731
    monkeypatch.setattr(ExtendedKalmanUpdater, "predict_measurement", counted)
    monkeypatch.setattr(JPDA, "enumerate_JPDA_hypotheses", None)
    found = answers(model(**EXACT), steps_of(dense_m, 8))
    assert 9 <= len(found[-1].track) <= 16
    assert len(expected) <= 2 * 8 * 16  # those that are not confirmed are expected twice at most


@both
def test_squared_errors_over_covariances_are_those_of_chi_square(model: type[StoneSoupWorld]) -> None:
    """Vessels whose motion, speed and errors are drawn from what the tracker assumes."""
    density, speed_m_s, count, steps = 0.01, 1.0, 12, 24
    sure = {"speed_sigma_m_s": speed_m_s, "waterline_m": 4.0, "gate_probability": 0.9999}
    tracker = model(acceleration_density_m2_s3=density, **EXACT | sure)
    squares: list[Any] = []
    for seed in range(3):
        generator = np.random.default_rng(100 + seed)
        bearing, away = np.linspace(-0.7, 0.7, count), generator.uniform(150, 350, count)
        place = np.stack([away * np.cos(bearing), away * np.sin(bearing)], axis=-1)
        velocity = generator.normal(0, speed_m_s, (count, 2))
        places, velocities = [], []
        root = np.linalg.cholesky(density * np.array([[STEP_S**3 / 3, STEP_S**2 / 2], [STEP_S**2 / 2, STEP_S]]))
        for _ in range(steps):
            places.append(place)
            velocities.append(velocity)
            change = np.einsum("ij,jnk->ink", root, generator.normal(0, 1, (2, count, 2)))
            place, velocity = place + STEP_S * velocity + change[0], velocity + change[1]
        last = answers(tracker, steps_of(lambda t: places[round(t / STEP_S)], steps, seed, behind_m=4.0))[-1]  # noqa: B023
        for at, track_m in enumerate(last.position_m):
            vessel = np.hypot(*(places[-1] - track_m).T).argmin()
            error = np.concatenate([track_m - places[-1][vessel], last.velocity_m_s[at] - velocities[-1][vessel]])
            squares.append(error @ np.linalg.solve(last.covariance[at], error))
    assert len(squares) > 0.9 * 3 * count
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 4 * len(squares)) / (4 * len(squares))
    assert low < np.mean(squares) / 4 < high


@both
def test_two_cameras_are_one_filter_and_the_second_makes_positions_better_known(model: type[StoneSoupWorld]) -> None:
    generator = np.random.default_rng(5)
    aside = np.array([300.0, -250.0])  # sees the vessels from the side
    steps = list(steps_of(crossing_m, 30))
    seen = lambda each: frame(each.time_s, crossing_m(each.time_s), aside, generator, 0.0)  # noqa: E731
    more = [replace(each, frames=(*each.frames, seen(each))) for each in steps]
    tracker = model(**EXACT)
    alone, together = (answers(tracker, iter(each))[-1] for each in (steps, more))
    assert len(alone.track) == len(together.track) == 2
    assert np.linalg.det(together.covariance[:, :2, :2]).max() < 0.1 * np.linalg.det(alone.covariance[:, :2, :2]).min()
    assert max(nearest(together, place)[1] for place in crossing_m(29 * STEP_S)) < 3


def astern_m(time_s: float) -> Any:
    """A vessel right astern, whose measured bearings lie on both sides of half a turn."""
    return np.array([[-200.0 - time_s, 0.0]])


@both
def test_bearings_alone_are_followed_and_late_reports_of_ais_correct_a_track_where_asked_for(model):
    steps = list(steps_of(astern_m, 40, own_m_s=0.0))
    for each in steps[25:]:
        each.frames[0].located.inverse_range_per_m[:] = np.nan  # cut by the lower edge of the image
    tracker = model(**EXACT, coast_s=0.0, gate_probability=0.9999, greatest_std_m=1e6)
    found = answers(tracker, iter(steps))
    assert [answer.track.tolist() for answer in found] == [[]] * 3 + [[0]] * 37
    along, across = np.abs(found[-1].position_m[0] - astern_m(39 * STEP_S)[0])
    assert across < 2 and along < 3 * np.sqrt(found[-1].covariance[0, 0, 0])
    assert not any(len(answer.track) for answer in answers(tracker, iter(steps[25:])))
    trackers = (model(**EXACT, ais=ais, ais_std_m=2.0) for ais in (False, True))
    without, with_ais = (answers(tracker, steps_of(crossing_m, 60, ais=reports_of)) for tracker in trackers)
    spread, off = [], []
    for found in (without, with_ais):
        names = [nearest(answer, crossing_m(k * STEP_S)[0]) for k, answer in enumerate(found)][20:]
        spread.append(np.trace(found[-1].covariance[0, :2, :2]))
        off.append(np.mean([away for _, away in names]))
    assert spread[1] < 0.75 * spread[0] and off[1] < off[0]
    plain = answers(model(**EXACT), steps_of(crossing_m, 60))
    assert plain[-1].position_m.tobytes() == without[-1].position_m.tobytes()


def reports_of(time_s: float) -> tuple[AisReport, ...]:
    """A report of the first vessel of the crossing each two seconds, three seconds late."""
    sent_s = time_s - 3
    if sent_s < 0 or round(sent_s / STEP_S) % 4:
        return ()
    return (AisReport(time_s, 1, "", sent_s, crossing_m(sent_s)[0], np.array([0.0, 4.0])),)


def test_a_failure_names_the_time_and_missing_libraries_how_to_install_them(monkeypatch: pytest.MonkeyPatch) -> None:
    broken = list(steps_of(crossing_m, 3))
    broken[2] = replace(broken[2], frames=(replace(broken[2].frames[0], camera="stern"),))
    with pytest.raises(ModsimError, match=r"WorldGnn failed at 1 s: .*stern"):
        answers(WorldGnn(), iter(broken))
    monkeypatch.delitem(sys.modules, "modsim3d.tracking.trackers.stone_soup_parts", raising=False)
    for name in [each for each in sys.modules if each.split(".")[0] == "stonesoup"]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ModsimError, match=r'pip install "modsim3d\[trackers\]"'):
        answers(WorldGnn(), iter(broken))
