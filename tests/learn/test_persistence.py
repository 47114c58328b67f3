"""Whether noise persists is decided by an interval; what vessels keep of misses and box errors comes back."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import special
from scipy.linalg import block_diag
from scipy.stats import binom

from modsim3d.detector.file.reading import parse_detector
from modsim3d.formats.labelled import LabelledSet
from modsim3d.learn.bootstrap import Resampling
from modsim3d.learn.lags import LagTable
from modsim3d.learn.learned import Learned
from modsim3d.learn.misses import choose_classes
from modsim3d.learn.persistence import Consecutive, SightingStretches
from tests.formats.labelled_files import found
from tests.learn.one_state import learned_in, moored, normal_chain, observed_in

RATE_HZ = 5.0


def two_boats(frames: int, errors_px: np.ndarray, missed: np.ndarray | None = None) -> LabelledSet:
    """Two boats in each frame, with errors (frames, 2, 4) in pixels; which are missed has shape (frames, 2)."""
    labelled = moored(frames, 2, columns=2, size_px=(600.0, 600.0), step_s=1 / RATE_HZ)
    return with_found(labelled, errors_px.reshape(-1, 4), None if missed is None else ~missed.ravel())


def with_found(labelled: LabelledSet, errors_px: np.ndarray, seen: np.ndarray | None) -> LabelledSet:
    """The set with detections, with errors of their corners, of the annotations that are seen."""
    rows = np.arange(len(errors_px)) if seen is None else np.flatnonzero(seen)
    image, boxes_px = labelled.annotations.image[rows], labelled.annotations.boxes_px + errors_px
    return replace(labelled, results=found(image, 0 * image, boxes_px[rows], np.full(len(rows), 0.9)))


def learned_from(labelled: LabelledSet, without: frozenset[str] = frozenset(), replicates: int = 20) -> Learned:
    return learned_in(observed_in(labelled, without=without), replicates=replicates)


def notes_on(key: str, learned: Learned) -> list[str]:
    return [note for note in learned.notes if note.startswith(f"{key}: ")]


def test_misses_that_persist_in_few_frames_are_found():
    rng = np.random.default_rng(1)
    luck = normal_chain(0.95, rng, 90, 2)
    misses = learned_from(two_boats(90, rng.normal(size=(90, 2, 4)), luck < -0.3))
    assert misses.detector()["persistence"].keys() == {"class_s"}


def test_the_correlation_time_of_errors_is_right_where_frames_last_only_a_few_times_as_long():
    asked_s, seeds, found = 3.0, 24, []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        errors = 2 * normal_chain(np.exp(-1 / RATE_HZ / asked_s), rng, 80, 2, 4)
        learned = learned_from(two_boats(80, errors, rng.random((80, 2)) < 0.2))
        (interval,) = [each for each in learned.intervals(0.95) if each.key.path == "persistence.box_s"]
        found.append((interval.estimate, interval.low <= asked_s <= interval.high))
    estimates, inside = np.array(found, dtype=float).T
    assert np.log(estimates / asked_s).mean() == pytest.approx(0, abs=0.15)
    assert binom.cdf(inside.sum(), seeds, 0.95) > 0.001


def test_what_the_mean_takes_of_a_correlation_is_what_matrices_say():
    counts, gap_s, times_s = (40, 30, 1), 0.2, np.array([0.3, 3.0, 30.0])
    stretches = SightingStretches(np.array(counts, dtype=float), np.array([gap_s, gap_s, 0]), np.zeros(3, dtype=int))
    centred = np.eye(71) - 1 / 71
    earlier = np.r_[0:39, 40:69]
    for time_s, left in zip(times_s, stretches.correlation_left(times_s), strict=True):
        alone = (np.exp(-gap_s * np.abs(np.subtract.outer(np.arange(n), np.arange(n))) / time_s) for n in counts)
        covariance = centred @ block_diag(*alone) @ centred
        asked = covariance[earlier, earlier + 1].sum() / covariance[earlier, earlier].sum()
        assert left * np.exp(-gap_s / time_s) == pytest.approx(asked, rel=1e-9)


def test_the_interval_that_includes_zero_is_the_reason():
    rng = np.random.default_rng(2)
    learned = learned_from(two_boats(40, rng.normal(size=(40, 2, 4)), rng.random((40, 2)) < 0.3))
    assert "persistence" not in learned.detector()
    for key in ("class_s", "box_s"):
        (note,) = notes_on(f"persistence.{key}", learned)
        said = re.search(r"interval of the correlation in (\d+) consecutive pairs, (\S+) to (\S+), includes 0$", note)
        assert said and 20 < int(said[1]) <= 78 and float(said[2]) <= 0 <= float(said[3]) < 1 and "99.9%" in note


@pytest.mark.parametrize(("change", "key", "reason"), [
    ("times", "persistence", "none; frames have no times"),
    ("identities", "persistence", "none; annotations have no identities"),
    ("one frame each", "persistence", "none; nothing is annotated in two frames with times"),
    ("all found", "persistence.class_s", "0; of each label in each state either everything or nothing was missed"),
    ("few", "persistence.box_s", "0; no state has 20 matches with all sides inside the image"),
])  # fmt: skip
def test_the_reason_is_what_is_missing(change, key, reason):
    frames = 9 if change == "few" else 40
    labelled = two_boats(frames, np.random.default_rng(3).normal(size=(frames, 2, 4)))
    if change == "times":
        labelled = replace(labelled, images=replace(labelled.images, time_s=np.full(40, np.nan)))
    number = {"identities": np.full(80, -1), "one frame each": np.arange(80)}.get(change)
    if number is not None:
        labelled = replace(labelled, annotations=replace(labelled.annotations, identity=number))
    assert notes_on(key, learned_from(labelled)) == [f"{key}: {reason}"]


def misses_of(missed: np.ndarray) -> Consecutive:
    """Consecutive misses of one thing, shape (n,)."""
    residual = missed - missed.mean()
    count = len(missed) - 1
    return Consecutive(residual[:-1] * residual[1:], residual[:-1] ** 2, np.ones(count), np.zeros(count, dtype=int))


def test_a_correlation_of_rare_misses_is_not_said_to_be_known_and_noise_hardly_ever_to_persist():
    missed = np.zeros(1000)
    missed[[300, 700]] = 1
    found = misses_of(missed).correlation()
    assert not found.persists and found.high > 0.7  # one of the two might as well have lasted
    assert "includes 0" in found.doubt
    alternating = misses_of(np.arange(200) % 2.0).correlation()
    assert alternating.high < 0 and "lies below 0" in alternating.doubt
    rng = np.random.default_rng(4)
    for count in (12, 60, 400):
        noise = ((rng.random(count + 1) < 0.4).astype(float) for _ in range(1000))
        assert sum(misses_of(each).correlation().persists for each in noise) <= 5  # of both sides, at 99.9 %


BOATS, FRAMES, CLASS_S, BOX_S, MISSES = 40, 120, 1.0, 0.7, 0.35


def boats(seed: int, class_share: float, box_share: float) -> LabelledSet:
    """Boats in a row, whose misses and errors are made like a detector's with shares that vessels keep."""
    rng = np.random.default_rng(seed)
    errors = normal_chain(np.exp(-1 / RATE_HZ / BOX_S), rng, FRAMES, BOATS, 4)
    errors = np.sqrt(box_share) * rng.normal(size=(BOATS, 4)) + np.sqrt(1 - box_share) * errors
    latent = rng.normal(size=(FRAMES, BOATS))
    for frame in range(1, FRAMES):
        keeps = rng.random(BOATS) < np.exp(-1 / RATE_HZ / CLASS_S)
        latent[frame] = np.where(keeps, latent[frame - 1], latent[frame])
    latent = np.sqrt(class_share) * rng.normal(size=BOATS) + np.sqrt(1 - class_share) * latent
    seen = (latent < -special.ndtri(MISSES)).ravel()
    labelled = moored(FRAMES, BOATS, columns=BOATS, size_px=(300.0 + 250 * BOATS, 800.0), step_s=1 / RATE_HZ)
    centre, side = errors.reshape(-1, 4)[:, :2] * 2, errors.reshape(-1, 4)[:, 2:] * 2
    return with_found(labelled, np.concatenate([centre - side / 2, centre + side / 2], axis=1), seen)


def test_shares_and_correlation_times_come_back_inside_their_intervals() -> None:
    asked = {"class_s": CLASS_S, "class_vessel_share": 0.4, "box_s": BOX_S, "box_vessel_share": 0.3}
    inside: dict[str, list[bool]] = {key: [] for key in (*asked, "misses", "means") if not key.endswith("_s")}
    estimates: dict[str, list[float]] = {key: [] for key in asked}
    for seed in range(4):
        learned = learned_from(boats(seed, 0.4, 0.3), replicates=30)
        intervals = {each.key.path: each for each in learned.intervals(0.95)}
        for key, value in asked.items():
            each = intervals[f"persistence.{key}"]
            estimates[key].append(float(each.estimate))
            if key.endswith("_s"):  # with a share its interval holds too seldom, so there is none
                assert np.isnan(each.low) and np.isnan(each.high)
            else:
                inside[key].append(bool(each.low <= value <= each.high))
        missed, mean = intervals["states.usual.confusion"], intervals["states.usual.box_error_mean"]
        inside["misses"].append(bool(missed.low[1, 0] <= MISSES <= missed.high[1, 0]))
        inside["means"] += [bool(low <= 0 <= high) for low, high in zip(mean.low, mean.high, strict=True)]
    for key, value in asked.items():
        assert np.median(estimates[key]) == pytest.approx(value, rel=0.15)
    for key, hits in inside.items():
        assert binom.cdf(sum(hits), len(hits), 0.95) > 0.01, key
    assert parse_detector(learned.detector()).persistence.class_vessel_share > 0.2


def test_what_the_mean_of_few_things_takes_of_a_share_is_made_up_for() -> None:
    """Of n equal things with a share s, residuals from their mean keep s·(1 − 1/n)/(1 − s/n)."""
    things, share, time_s = 10, 0.4, 1.5
    lag_s = np.array([0.5, 1, 1.5, 2, 3, 4, 6, 8, 12, 16])
    lag, thing = (each.ravel() for each in np.meshgrid(np.arange(len(lag_s)), np.arange(things), indexing="ij"))
    level = share * (1 - 1 / things) / (1 - share / things)
    products = level + (1 - level) * np.exp(-lag_s[lag] / time_s)
    table = LagTable(products, np.ones(len(lag)), lag_s[lag], lag, thing, 0 * lag, lag_s, things, 1 / things)
    fits = table.fit(Resampling(np.ones((1, 1)), np.zeros(1, dtype=np.int64)))
    assert fits.levels[0] == pytest.approx(share, abs=0.003) and fits.times_s[0] == pytest.approx(time_s, rel=0.03)


@pytest.mark.parametrize(("seed", "shares", "left_out"), [(0, (0, 0), ()), (1, (0, 0), ()), (1, (0.4, 0.3), "vessels")])
def test_noise_that_is_forgotten_is_not_said_to_be_kept_and_shares_can_be_left_out(seed, shares, left_out) -> None:
    learned = learned_from(boats(seed, *shares), frozenset([left_out] if left_out else ()), replicates=30)
    assert learned.detector()["persistence"].keys() == {"class_s", "box_s"}
    notes = [note for note in learned.notes if "vessel_share" in note]
    assert len(notes) == (0 if left_out else 2)
    assert all("standard errors from 0 with 40 things, needs 3.3" in note for note in notes)


def test_vessels_that_are_harder_by_themselves_give_no_slope() -> None:
    """Each boat stays at one distance, so chance makes far ones harder in as many frames as there are."""
    steeper, seeds = 0, 12
    for seed in range(seeds):
        labelled = boats(seed, 0.4, 0.0)
        distance_m = np.random.default_rng(100 + seed).uniform(100, 1000, BOATS)[labelled.annotations.identity]
        labelled = replace(labelled, annotations=replace(labelled.annotations, depth_m=distance_m))
        steeper += bool(choose_classes(observed_in(labelled)).effects)
    assert steeper <= binom.isf(0.001, seeds, 0.01)
