"""Start of a fit: the guess of the search from which the detections are explained best. The clock has several local
optima: on board, the waves' motion looks much the same a period later. So guesses are aligned one by one, with vessels
off their reports where that is expected, and compared."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from modsim3d.core.arrays import Array, Indices
from modsim3d.core.errors import ModsimError
from modsim3d.core.text import counted, duration_text
from modsim3d.geometry.camera import Intrinsics
from modsim3d.learn.voyage.registration.icp import Aligner, Alignment, BoxesAtTimes, Unknowns, usual_px
from modsim3d.learn.voyage.registration.model import BoxModel, same_frame
from modsim3d.learn.voyage.registration.parameters import Values
from modsim3d.scene.scene import Scene

# ---- The first guess ----

CELL_RAD = np.radians(0.5)
MAX_DOWN_RAD = np.radians(4.0)
SIZE_RATIO = 2.5
SEARCHED_FRAMES = 150
APART_S = 2.0


@dataclass(frozen=True)
class Guess:
    """A clock and a turn, and how many detections vote for them."""

    clock_s: float  # to add to the detector's times
    yaw_deg: float  # turn of the camera to port
    pitch_deg: float  # turn down
    votes: int  # detections of the searched frames that they explain

    def values(self, vessels: int) -> Values:
        """As a start of a fit."""
        return Values.none(vessels).changed(clock_s=self.clock_s, yaw_deg=self.yaw_deg, pitch_deg=self.pitch_deg)


@dataclass(frozen=True, eq=False)
class Search:
    """Guesses, best first, and what chance would have given."""

    guesses: tuple[Guess, ...]  # at most one every `APART_S` seconds of the clock
    chance: int  # votes of the best cell for mirrored detections
    searched: int  # number of detections that could vote


@dataclass(frozen=True, eq=False)
class _Directions:
    """Detections as directions from the camera: azimuth to the right, elevation down, width, all in radians."""

    frame: Indices
    azimuth: Array
    down: Array
    width: Array


def search(model: BoxModel, boxes: BoxesAtTimes, clocks_s: Array, most_turn_rad: float, most: int = 6) -> Search:
    """Vote over clock offsets, ascending, (c,), and turns of at most so much, π for all round, for `most` guesses."""
    some = boxes.some(SEARCHED_FRAMES)
    lens = model.traffic.camera.intrinsics
    seen, mirrored = _directions(lens, some), _directions(lens, _mirrored(lens, some))
    tables = [_tables(model, some.times_s + clock, most_turn_rad) for clock in clocks_s]
    votes = [_votes(seen, table, most_turn_rad) for table in tables]
    chance = max((_votes(mirrored, table, most_turn_rad)[0] for table in tables), default=0)
    order = sorted(range(len(clocks_s)), key=lambda i: -votes[i][0])
    kept: list[int] = []
    for index in order:
        if all(abs(clocks_s[index] - clocks_s[other]) >= APART_S for other in kept) and votes[index][0]:
            kept.append(index)
    guesses = tuple(
        Guess(float(clocks_s[i]), float(np.degrees(votes[i][1])), float(-np.degrees(votes[i][2])), votes[i][0])
        for i in kept[:most]
    )
    return Search(guesses, chance, len(seen.frame))


def _mirrored(lens: Intrinsics, detections: BoxesAtTimes) -> BoxesAtTimes:
    boxes = detections.boxes_px[:, [2, 1, 0, 3]] * (-1, 1, -1, 1) + np.array([lens.image_size_px[0], 0] * 2)
    return BoxesAtTimes(detections.times_s, detections.frame, boxes)


def _directions(lens: Intrinsics, detections: BoxesAtTimes) -> _Directions:
    """The middle of the lower edge of each box, and the angle between its sides; what no lens shows is left out."""
    left, _, right, bottom = detections.boxes_px.T
    pixels = np.stack([np.stack([x, bottom], axis=-1) for x in (left, (left + right) / 2, right)], axis=1)
    rays = lens.unproject(pixels, np.ones(pixels.shape[:2]))
    azimuth = np.arctan2(rays[..., 0], rays[..., 2])
    down = np.arctan2(rays[:, 1, 1], np.hypot(rays[:, 1, 0], rays[:, 1, 2]))
    finite = np.isfinite(azimuth).all(axis=1) & np.isfinite(down)
    return _Directions(
        detections.frame[finite], azimuth[finite, 1], down[finite], (azimuth[:, 2] - azimuth[:, 0])[finite]
    )


def _tables(model: BoxModel, times_s: Array, most_turn_rad: float) -> _Directions:
    """Directions of all vessels that are there and, turned by the most, in the field of view, in order of frame."""
    traffic, count = model.traffic, len(model.hulls_m)
    frame, vessel = np.divmod(np.arange(len(times_s) * count), count)
    present = traffic.presence(times_s[frame], vessel)
    if traffic.carrier is not None:
        present &= vessel != traffic.carrier
        present &= traffic.presence(times_s[frame], np.full(len(frame), traffic.carrier))
    frame, vessel = frame[present], vessel[present]
    if not len(frame):
        return _Directions(frame, *np.empty((3, 0)))
    none = Values.none(count)
    places, rotations = traffic.at(times_s[frame], vessel)
    camera = model.camera_poses(none, times_s[frame]).to_camera(places[:, None])[:, 0]
    away = np.maximum(np.hypot(camera[:, 0], camera[:, 2]), 1.0)
    to_camera = model.camera_poses(none, times_s[frame]).positions_m - places
    bearing = np.einsum("nij,ni->nj", rotations, to_camera)[:, :2] / away[:, None]
    length, beam = np.ptp(model.hulls_m[vessel], axis=1)[:, :2].T
    width = (length * np.abs(bearing[:, 1]) + beam * np.abs(bearing[:, 0])) / away
    azimuth, down = np.arctan2(camera[:, 0], camera[:, 2]), np.arctan2(camera[:, 1], away)
    lens = traffic.camera.intrinsics
    seen = np.abs(azimuth) < np.arctan(lens.image_size_px[0] / 2 / lens.focal_px[0]) + most_turn_rad + width
    return _Directions(frame[seen], azimuth[seen], down[seen], width[seen])


def _votes(seen: _Directions, vessels: _Directions, most_turn_rad: float) -> tuple[int, float, float]:
    """Votes of the best cell and its turn to the side and down, in radians."""
    box, row = same_frame(seen.frame, vessels.frame)
    side = np.remainder(seen.azimuth[box] - vessels.azimuth[row] + np.pi, 2 * np.pi) - np.pi
    down = seen.down[box] - vessels.down[row]
    ratio = np.abs(np.log(np.maximum(seen.width[box], 1e-6) / np.maximum(vessels.width[row], 1e-6)))
    kept = (np.abs(side) < most_turn_rad) & (np.abs(down) < MAX_DOWN_RAD) & (ratio < np.log(SIZE_RATIO))
    side, down, box = side[kept], down[kept], box[kept]
    if not len(side):
        return 0, 0.0, 0.0
    columns, rows = (int(2 * most // CELL_RAD) + 3 for most in (most_turn_rad, MAX_DOWN_RAD))
    column = ((side + most_turn_rad) // CELL_RAD).astype(int) + 1
    level = ((down + MAX_DOWN_RAD) // CELL_RAD).astype(int) + 1
    cells = np.bincount(column * rows + level, minlength=columns * rows)[: columns * rows].reshape(columns, rows)
    around = np.pad(cells, 1)
    smooth = np.sum([around[i : i + columns, j : j + rows] for i in range(3) for j in range(3)], axis=0)
    best = np.unravel_index(int(np.argmax(smooth)), smooth.shape)
    near = (np.abs(column - best[0]) <= 1) & (np.abs(level - best[1]) <= 1)
    return len(np.unique(box[near])), float(np.median(side[near])), float(np.median(down[near]))


# ---- When a registration cannot be known, and why ----

MIN_VESSELS, MIN_MATCHES = 3, 30
MIN_BEARINGS_DEG = 3.0
OVER_CHANCE = 1.5
MIN_SHARE = 0.15  # least share of the detections that a registration has to explain
_NEEDED = f"at least {MIN_MATCHES} matches of {MIN_VESSELS} vessels are needed"
_OTHERWISE = (
    "The log may be of another place, camera or time; its boxes may be in pixels of another size, or too far off; or "
    "what the scene says of the camera is: its place, its focal length, or its pitch, by more than 4°"
)


def check_times(model: BoxModel, boxes: BoxesAtTimes, searched_s: float) -> None:
    """Raise ModsimError if scene and detections have no time in common, or there are too few detections or vessels."""
    if not len(boxes.frame):
        raise ModsimError("registration: there are no detections")
    if len(boxes.frame) < MIN_MATCHES:
        raise ModsimError(f"registration: too little to go by: {counted(len(boxes.frame), 'detection')}, and {_NEEDED}")
    others = int(model.traffic.present.any(axis=0).sum()) - (model.traffic.carrier is not None)
    if others < MIN_VESSELS:
        reason = f"the scene has {counted(others, 'vessel')} for the camera to see"
        raise ModsimError(f"registration: {reason}; at least {MIN_VESSELS} are needed")
    low, high = model.traffic.span_s
    first, last = boxes.times_s[[0, -1]]
    if last + searched_s < low or first - searched_s > high:
        apart = first - high if first > high else last - low
        raise ModsimError(
            f"registration: the detections are from {first:,.1f} to {last:,.1f} s and the scene from {low:,.1f} to"
            f" {high:,.1f} s: the clocks are {duration_text(abs(apart))} apart, and at most {searched_s:g} s are"
            " searched. Check the time zone and the start of the log"
        )


def check_search(voted: Search, model: BoxModel, boxes: BoxesAtTimes, clocks_s: Array, scene: Scene) -> None:
    """Raise ModsimError, with what else would explain detections, if the best guess explains no more than chance."""
    _check_bearings(model, boxes.boxes_px, "detections")
    best = voted.guesses[0].votes if voted.guesses else 0
    if best > OVER_CHANCE * voted.chance and best >= MIN_SHARE * voted.searched:
        return
    around = search(model, boxes, clocks_s[:: max(len(clocks_s) // 20, 1)], np.pi, 1)
    most = around.guesses[0].votes if around.guesses else 0
    if most > OVER_CHANCE * around.chance and most >= MIN_SHARE * around.searched and most > 2 * best:
        turn = around.guesses[0].yaw_deg
        yaw_rad = np.arctan2(*(f(model.traffic.camera.mount.yaw_rad + np.radians(turn)) for f in (np.sin, np.cos)))
        raise ModsimError(
            f"registration: the camera looks another way than {scene.title} says: {most} of {around.searched}"
            f" detections are explained by a camera that is turned by {turn:+.0f}° of yaw, and {best} by one that looks"
            f" as the scene says. Correct the yaw in the scene: yaw_rad is about {yaw_rad:.2f}"
        )
    mirrored = "Mirrored ones fit better: the images may be mirrored, or upside down" if voted.chance > 2 * best else ""
    raise ModsimError(
        f"registration: the detections do not fit the vessels of {scene.title}: the best clock, within"
        f" {max(abs(clocks_s)):g} s, and the best yaw explain {best} of {voted.searched} detections, and"
        f" {voted.chance} of mirrored detections, which cannot be right. {mirrored or _OTHERWISE}"
    )


def check_matches(model: BoxModel, aligned: Alignment, names: tuple[str, ...]) -> None:
    """Check that enough vessels were matched, and not all at one bearing; raises ModsimError if not."""
    seen = aligned.sightings
    vessels = np.unique(seen.vessel)
    if len(vessels) < MIN_VESSELS or len(seen) < MIN_MATCHES:
        who = ", ".join(names[vessel] for vessel in vessels) or "none"
        matches = f"{counted(len(seen), 'match', 'matches')} of {counted(len(vessels), 'vessel')} ({who})"
        raise ModsimError(f"registration: too little to go by: {matches}; {_NEEDED}")
    _check_bearings(model, seen.boxes_px, "matched vessels")


def _check_bearings(model: BoxModel, boxes_px: Array, what: str) -> None:
    lens = model.traffic.camera.intrinsics
    pixels = np.stack([(boxes_px[:, 0] + boxes_px[:, 2]) / 2, boxes_px[:, 3]], axis=-1)
    rays = lens.unproject(pixels, np.ones(len(pixels)))
    low, high = np.nanpercentile(np.degrees(np.arctan2(rays[:, 0], rays[:, 2])), [2, 98])
    if high - low < MIN_BEARINGS_DEG:
        raise ModsimError(
            f"registration: all {what} lie within {high - low:.1f}° of one bearing; at least"
            f" {MIN_BEARINGS_DEG:g}° are needed to tell the clock, the yaw and the lens apart"
        )


CLOCK_STEP_S = 0.5
MAX_TURN_DEG = 15.0
MAX_GUESSES, LIKELY = 5, 0.6  # how many guesses are tried, and with how many votes in shares of the best one's
STARTS_APART_S = 0.5  # starts whose clocks have come closer than this are the same
SURE = 3.0  # a start is clearly worse than another by so many standard errors of the mean over stretches of time
STRETCHES = 12


def starts(aligner: Aligner, searched_s: float, spread_m: float, scene: Scene) -> tuple[Values, list[Values]]:
    """The best start, and others whose clocks explain nearly as well, from an aligner of some frames, the greatest
    offset of the clock, and by how far places may be off. Raises ModsimError if none explains more than chance."""
    model, detections, free = aligner.model, aligner.boxes, aligner.free
    clocks = np.arange(-searched_s, searched_s + CLOCK_STEP_S / 2, CLOCK_STEP_S) if "clock_s" in free else np.zeros(1)
    voted = search(model, detections, clocks, np.radians(MAX_TURN_DEG if "yaw_deg" in free else 2.0))
    check_search(voted, model, detections, clocks, scene)
    zero = {name: 0.0 for name in ("clock_s", "yaw_deg", "pitch_deg") if name not in free}
    tried, clocks_s = list[tuple[Array, Values]](), list[float]()
    for guess in voted.guesses[:MAX_GUESSES]:
        if guess.votes < LIKELY * voted.guesses[0].votes:
            break
        rough = aligner.first(guess.values(len(model.hulls_m)).changed(**zero))
        clock_s = rough.values["clock_s"]
        if any(abs(clock_s - other) < STARTS_APART_S for other in clocks_s):
            continue
        clocks_s.append(clock_s)
        if spread_m:
            vessels = np.unique(rough.sightings.vessel)
            unknowns = Unknowns(aligner.all_unknowns().shared, np.array([spread_m, spread_m, 0.0]), vessels)
            rough = aligner.until_stable(rough, unknowns, tied=True, rounds=2)
        tried.append((explained(aligner, rough), rough.values))
    tried.sort(key=lambda start: -start[0].sum())
    (most, best), *others = tried
    return best, rivals_of(most, best, others)


def rivals_of(most: Array, best: Values, others: Sequence[tuple[Array, Values]]) -> list[Values]:
    """Starts of another clock that explain detections, by stretches of time (k,), not clearly worse than the best."""
    rivals = list[Values]()
    for less, other in others:
        worse = most - less
        clocks_s = np.array([start["clock_s"] for start in (best, *rivals)])
        new = np.abs(clocks_s - other["clock_s"]).min() > STARTS_APART_S
        if new and worse.mean() < SURE * worse.std(ddof=1) / np.sqrt(len(worse)):
            rivals.append(other)
    return rivals


def explained(aligner: Aligner, aligned: Alignment) -> Array:
    """Explained detections by stretch of time, (STRETCHES,): a bearing or a waterline counts 1, or less if off."""
    residuals = aligned.residuals
    px = np.nan_to_num(residuals.px(aligner.model, aligned.values), nan=1e3)
    close = np.where(residuals.kind <= 3, 1 / (1 + (px / usual_px(residuals.size_px)) ** 2), 0.0)
    times_s = aligner.boxes.times_s
    edges = np.linspace(times_s[0], times_s[-1], STRETCHES + 1)[1:-1]
    stretch = np.searchsorted(edges, residuals.sightings.time_s[residuals.row])
    return np.asarray(np.bincount(stretch, close, STRETCHES))
