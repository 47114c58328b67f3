"""Whether a learned detector behaves as the real one where it was not learned. Each half of the data is simulated, over
its own annotations, by what was learned from the other; what matters to a tracker is counted in the real results and in
the simulated ones, and trackers are run over both. The detector that is written is learned from all data."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask, run_starts
from modsim3d.core.boxes import centres, iou, sizes
from modsim3d.core.errors import InputError, ModsimError
from modsim3d.core.text import listed, three_digits
from modsim3d.detector.chain import Detector, target_statistics
from modsim3d.detector.file.reading import parse_detector
from modsim3d.detector.model import DetectorModel, Performance
from modsim3d.detector.records import FALSE_KINDS, ON_VESSEL, CameraFrames, Targets
from modsim3d.formats.labelled import EVERYWHERE, LabelledSet, Results
from modsim3d.formats.matching import image_pairs, match
from modsim3d.learn.bootstrap import Entry, resample, with_entries
from modsim3d.learn.learned_detector import Estimates, LearnSettings, choose_form
from modsim3d.learn.matches import Outcomes
from modsim3d.runs.tracker_view import anonymised
from modsim3d.tracking.scores.association import hota_of, joined_sequence, metrics
from modsim3d.tracking.trackers.interface import CameraFacts
from modsim3d.tracking.trackers.registry import NamedTracker, named_tracker
from modsim3d.tracking.trackers.running import answered
from modsim3d.tracks.tracks import Similarity, Tracks
from modsim3d.tracks.true_tracks import TrueTracks, follow

SEEDS = 20  # simulated runs that each half is compared with
LEVEL = 0.05  # probability that any of the numbers is said to differ by chance
MIN_COUNT = 20  # what a number must be counted from, in the real results
TRACKERS = ("reference", "sort")
TRACKED_SEEDS = 5  # simulated runs of each half that trackers work on, which takes longer than to count
_BLOCKS = 4
_ON_A_VESSEL = 0.1

Counts = dict[str, tuple[float, float]]  # sum and number of what is averaged, by name


@dataclass(frozen=True)
class RealityComparison:
    """A number of the real results and of the simulated ones: their mean and spread over seeds, of one half."""

    name: str
    real: float
    simulated: float
    spread: float
    p_value: float

    @property
    def differs(self) -> bool:
        """Whether both surely differ; p-values are adjusted for the number of comparisons."""
        return self.p_value < LEVEL


@dataclass(frozen=True)
class SelfCheck:
    """Comparisons where the detector was not learned, those that differ most first; why there are none, if so."""

    comparisons: tuple[RealityComparison, ...] = ()
    why_none: str = ""

    @classmethod
    def of(cls, learned: Estimates, settings: LearnSettings) -> SelfCheck:
        """The check of what was learned, or why it cannot be made."""
        try:
            return cls(self_check(learned, settings, SEEDS))
        except ModsimError as error:
            return cls(why_none=str(error))

    @property
    def sentence(self) -> str:
        """Outcome, with what differs first."""
        if self.why_none:
            return f"Not checked where it was not learned: {self.why_none}"
        differing = [row for row in self.comparisons if row.differs]
        checked = (
            f"Learned from one half of the data and simulated {SEEDS} times over the other, and the other way round, "
            f"{len(differing)} of {len(self.comparisons)} numbers differ from the real results"
        )
        some = [f"{row.name} {three_digits(row.real)} in place of {three_digits(row.simulated)}" for row in differing]
        return f"{checked}{': ' if some else ''}{listed(some) if some else ''}"


def self_check(learned: Estimates, settings: LearnSettings, seeds: int) -> tuple[RealityComparison, ...]:
    """Comparisons where the detector was not learned, those that differ most first. Each half stands for itself:
    summed, one's excess hides the other's. A seed has a replicate of the learned numbers, so that the spread has what a
    half leaves open. Raises ModsimError if there is too little to split, or the sizes of images are not known."""
    observed = learned.observed
    half = _first_half(observed)
    compared: list[dict[str, RealityComparison]] = []
    for number, mask in enumerate((half, ~half)):
        unseen = replace(observed, image_state=np.where(mask, observed.image_state, -1))
        seen = replace(observed, image_state=np.where(mask, -1, observed.image_state))
        if not len(unseen.found) or not len(seen.found):
            raise ModsimError("one half of the data has no matches, so nothing learned from the other can be checked")
        real, drawn = counts_of(unseen, observed) | hota_counts(unseen), []
        for seed, model in enumerate(_models_of(seen, learned, settings, seeds)):
            labelled = simulated(observed.labelled, unseen.image_state, model, settings.seed + number * seeds + seed)
            again = replace(unseen, labelled=labelled, matched=match(labelled, settings.rule, settings.threshold))
            drawn.append(counts_of(again, observed) | (hota_counts(again) if seed < TRACKED_SEEDS else {}))
        compared.append({row.name: row for row in _compared(real, drawn)})
    rows = [_worse(*(half_of[name] for half_of in compared)) for name in compared[0] if name in compared[1]]
    if not rows:
        raise ModsimError(f"nothing is counted {MIN_COUNT} times in both halves of the data")
    return tuple(_adjusted(sorted(rows, key=lambda row: row.p_value)))


def _models_of(seen: Outcomes, learned: Estimates, settings: LearnSettings, seeds: int) -> Iterator[DetectorModel]:
    """Detectors learned from one half: replicates of its numbers, the estimate where one is no detector."""
    form = choose_form(seen, settings.false_positives)
    numbers = form.estimate(seen, resample(seen.labelled.images, seeds, settings.seed, learned.run_s))

    def model_of(row: int) -> DetectorModel:
        chosen = with_entries(numbers, lambda entry: _replicate(entry, row))
        return parse_detector(replace(learned, observed=seen, form=form, numbers=chosen).detector(), "one half")

    estimate = model_of(0)
    for row in range(1, seeds + 1):
        try:
            yield model_of(row)
        except InputError:
            yield estimate


def _replicate(entry: Entry, row: int) -> Entry:
    """The entry with a replicate as its estimate, where that is known."""
    values = entry.column.values
    chosen = np.where(np.isfinite(values[row]), values[row], values[0])
    return replace(entry, column=replace(entry.column, values=chosen[None]))


def _first_half(observed: Outcomes) -> Mask:
    """Images of one half of each state: whole films, all cameras of a run, or every other quarter of a single one."""
    images, half = observed.labelled.images, np.zeros(len(observed.image_state), dtype=bool)
    sequence = images.sequence if observed.labelled.results.origin is None else np.zeros_like(images.sequence)
    _, film = np.unique(np.column_stack([images.source, sequence]), axis=0, return_inverse=True)
    film = film.ravel()
    for state in range(len(observed.states)):
        members = np.flatnonzero(observed.image_state == state)
        number = np.bincount(film[members], minlength=int(film.max(initial=0)) + 1)
        if np.count_nonzero(number) > 1:
            chosen, sizes_of_halves = np.zeros(len(number), dtype=bool), [0, 0]
            for index in np.argsort(-number, kind="stable").tolist():
                chosen[index] = sizes_of_halves[0] <= sizes_of_halves[1]
                sizes_of_halves[0 if chosen[index] else 1] += int(number[index])
            half[members] = chosen[film[members]]
        else:
            time_s = np.where(np.isfinite(images.time_s[members]), images.time_s[members], np.arange(len(members)))
            rank = np.unique(time_s, return_inverse=True)[1].ravel()
            half[members] = (rank * _BLOCKS // max(int(rank.max(initial=0)) + 1, 1)) % 2 == 0
    return half


def _compared(real: Counts, drawn: Sequence[Counts]) -> Iterator[RealityComparison]:
    """Comparisons with the p-values of Student's t; 0 where the simulated results have no such case at all."""
    for name, (amount, number) in real.items():
        if number < MIN_COUNT:
            continue
        sums = (counts.get(name, (0.0, 0.0)) for counts in drawn)
        means = np.array([total / whole for total, whole in sums if whole > 0])
        value = amount / number
        if len(means) < 2:
            yield RealityComparison(name, value, float("nan"), float("nan"), 0.0)
            continue
        mean, spread = float(means.mean()), max(float(means.std(ddof=1)), 1 / number)
        deviation = (value - mean) / (spread * np.sqrt(1 + 1 / len(means)))
        yield RealityComparison(name, value, mean, spread, 2 * float(special.stdtr(len(means) - 1, -abs(deviation))))


def _worse(first: RealityComparison, second: RealityComparison) -> RealityComparison:
    """The half that differs more, with the p-value of the smaller of two (Bonferroni)."""
    chosen = min(first, second, key=lambda row: row.p_value)
    return replace(chosen, p_value=min(1.0, 2 * chosen.p_value))


def _adjusted(rows: Sequence[RealityComparison]) -> Iterator[RealityComparison]:
    """Rows in the order of their p-values, which are adjusted for their number by the method of Holm (1979)."""
    highest = 0.0
    for rank, row in enumerate(rows):
        highest = max(highest, min(1.0, (len(rows) - rank) * row.p_value))
        yield replace(row, p_value=highest)


def counts_of(observed: Outcomes, whole: Outcomes) -> Counts:
    """Counts that a tracker feels of some results; ranges of size and distance are those of the `whole` data."""
    hits = observed.missed == 0
    counts = {"share found": _mean(hits)} | _by_range(observed, whole, hits) | _of_boxes(observed)
    return counts | _of_time(observed, hits) | _of_false(observed)


def _mean(values: Array | Mask) -> tuple[float, float]:
    return float(np.sum(values)), float(len(values))


def _by_range(observed: Outcomes, whole: Outcomes, hits: Mask) -> Counts:
    """Share found by thirds of size and of distance, and of the visible share where it is known."""
    counts: Counts = {}
    for unit, column in {"px large": "size_px", "m away": "depth_m"}.items():
        values = getattr(observed.labelled.annotations, column)
        every = values[whole.rows]
        if not np.isfinite(every).all() or np.ptp(every) == 0:
            continue
        low, high = (float(f"{edge:.2g}") for edge in np.quantile(every, [1 / 3, 2 / 3]))
        amounts = values[observed.rows]
        for name, chosen in (
            (f"share found, below {low:,g} {unit}", amounts < low),
            (f"share found, {low:,g} to {high:,g} {unit}", (amounts >= low) & (amounts < high)),
            (f"share found, above {high:,g} {unit}", amounts >= high),
        ):
            counts[name] = _mean(hits[chosen])
    visible = observed.labelled.annotations.visible_fraction[observed.rows]
    for name, chosen in (("under half visible", visible < 0.5), ("wholly visible", visible > 0.99)):
        counts[f"share found, {name}"] = _mean(hits[chosen])
    return counts


def _of_boxes(observed: Outcomes) -> Counts:
    """IoU of matches, and changes of the centre's error from frame to frame."""
    labelled, rows = observed.labelled, observed.rows[observed.found]
    boxes = labelled.results.boxes_px[observed.detection[observed.found]]
    true = labelled.annotations.boxes_px[rows]
    error = np.full((len(observed.rows), 2), np.nan)
    error[observed.found] = (centres(boxes) - centres(true)) / np.maximum(sizes(true), 1.0)
    change = np.abs(error[observed.steps.later] - error[observed.steps.earlier])
    finite = np.isfinite(change).all(axis=1)
    names = ("change of the centre across", "change of the centre down")
    return {
        "mean IoU of matches": _mean(iou(boxes, true)),
        **{f"{name}, in sides": _mean(change[finite, k]) for k, name in enumerate(names)},
    }


def _of_time(observed: Outcomes, hits: Mask) -> Counts:
    """Lengths of runs of sightings and of gaps between them, and the confidence before a miss."""
    steps = observed.steps
    counts: Counts = {}
    if not len(steps):
        return counts
    length = np.ones(len(hits))
    for later, earlier in zip(steps.later.tolist(), steps.earlier.tolist(), strict=True):
        if hits[later] == hits[earlier]:
            length[later] = length[earlier] + 1
    ended = steps.earlier[hits[steps.later] != hits[steps.earlier]]
    runs, gaps = length[ended[hits[ended]]], length[ended[~hits[ended]]]
    label, labels = observed.detected_label, len(observed.labelled.labels)
    both = (label[steps.later] < labels) & (label[steps.earlier] < labels)
    if labels > 1:
        counts["share of labels that change"] = _mean((label[steps.later] != label[steps.earlier])[both])
    counts |= {"frames of a run of sightings": _mean(runs), "frames of a gap": _mean(gaps)}
    counts["share of gaps of one frame"] = _mean(gaps == 1)
    if observed.labelled.scored:
        confidence = np.full(len(hits), np.nan)
        confidence[observed.found] = observed.labelled.results.confidence[observed.detection[observed.found]]
        counts["confidence of matches"] = _mean(confidence[observed.found])
        lost = hits[steps.earlier] & ~hits[steps.later] & np.isfinite(confidence[steps.earlier])
        counts["confidence before a miss"] = _mean(confidence[steps.earlier[lost]])
    return counts


def _of_false(observed: Outcomes) -> Counts:
    """False positives of an image, and the share of them that lies on a vessel."""
    results, annotations = observed.labelled.results, observed.labelled.annotations
    images, false = np.flatnonzero(observed.image_state >= 0), observed.false
    false = false[np.argsort(results.image[false], kind="stable")]
    order = np.argsort(annotations.image, kind="stable")
    on_vessel = np.zeros(len(false), dtype=bool)
    for first, second in image_pairs(results.image[false], annotations.image[order], len(observed.image_state)):
        near = iou(results.boxes_px[false[first]], annotations.boxes_px[order[second]]) > _ON_A_VESSEL
        on_vessel[first[near]] = True
    number = np.bincount(results.image[false], minlength=len(observed.image_state))[images]
    return {
        "false positives an image": _mean(number.astype(np.float64)),
        "share of false positives on a vessel": _mean(on_vessel),
    }


def hota_counts(observed: Outcomes) -> Counts:
    """HOTA of trackers, counted once for each vessel in an image, with settings for scenes not shipped; none without
    identities, times of images or an installed library of trackers."""
    labelled, rows = observed.labelled, observed.labelled.annotations
    image = np.flatnonzero(observed.image_state >= 0)
    known = np.isfinite(labelled.images.time_s[image]).all() and np.isfinite(labelled.images.sizes_px[image]).all()
    if not known or not len(observed.rows) or (rows.identity[observed.rows] < 0).any():
        return {}
    films = _Films.of(observed)
    seen = observed.rows[np.lexsort((rows.identity[observed.rows], films.frame[rows.image[observed.rows]]))]
    frame, identity = films.frame[rows.image[seen]], rows.identity[seen]
    hidden = rows.visible_fraction[seen] == 0
    appearance = np.unique(frame % films.count + films.count * identity, return_inverse=True)[1].ravel()
    kept = seen, frame, identity, appearance, rows.label[seen], rows.boxes_px[seen], ~hidden, hidden
    truth = TrueTracks(films.count, *kept)
    counts = Counts()
    for name in TRACKERS:
        named = named_tracker(name, {}, "")
        try:
            metrics(), named.origin
        except ModsimError:
            continue  # a library is not installed
        tracks = films.tracks(observed, named)
        following = follow(truth, tracks, Similarity())
        counted = truth.take(truth.scored), tracks.take(following.counted)
        value = hota_of(joined_sequence(*counted, following.similarity)).hota
        number = np.count_nonzero(truth.scored)
        counts[f"HOTA of {name}"] = (number * (value or 0.0), float(number))
    return counts


@dataclass(frozen=True, eq=False)
class _Films:
    """Images that take part as films without gaps in time; a frame is place in the film × films + film, as in runs."""

    count: int
    frame: Indices  # of each image, `NOBODY` where it takes no part, (I,)
    images: tuple[Indices, ...]  # of each film, in order of time

    @classmethod
    def of(cls, observed: Outcomes) -> _Films:
        images = observed.labelled.images
        order = np.lexsort((images.time_s, images.sequence))
        inside = observed.image_state[order] >= 0
        begins = np.diff(images.sequence[order], prepend=NOBODY) != 0
        begins[1:] |= ~inside[:-1]
        film = np.cumsum(begins & inside) - 1
        parts = [order[inside & (film == number)] for number in range(int(film.max(initial=NOBODY)) + 1)]
        frame = np.full(len(order), NOBODY)
        for number, part in enumerate(parts):
            frame[part] = np.arange(len(part)) * len(parts) + number
        return cls(len(parts), frame, tuple(parts))

    def tracks(self, observed: Outcomes, named: NamedTracker) -> Tracks:
        """Tracks over the detections in all films, but for those that lie where nothing counts."""
        images, results = observed.labelled.images, observed.labelled.results
        confidence = np.nan_to_num(results.confidence, nan=1.0)
        kept = np.flatnonzero((self.frame[results.image] >= 0) & observed.matched.counts)
        frame = self.frame[results.image[kept]]
        detections = anonymised(frame, results.label[kept], results.boxes_px[kept], confidence[kept])
        frames, answers = [], []
        for number, part in enumerate(self.images):
            here = detections.take(detections.frame % self.count == number)
            times_s = images.time_s[part] - images.time_s[part[0]]
            rate_hz = (len(part) - 1) / float(times_s[-1]) if len(part) > 1 and times_s[-1] > 0 else 1.0
            width, height = images.sizes_px[part[0]].tolist()
            facts = CameraFacts(f"film {number}", (int(width), int(height)), rate_hz, tuple(observed.labelled.labels))
            answers.append(answered(named, facts, times_s, replace(here, frame=here.frame // self.count)))
            frames.append(answers[-1].frame * self.count + number)
        track, boxes_px = (np.concatenate([getattr(part, name) for part in answers]) for name in ("track", "boxes_px"))
        return Tracks.of(self.count, np.concatenate(frames), track, boxes_px)


# ---- Results of a simulated detector over the annotations of a labelled set ----


@dataclass(frozen=True, eq=False)
class SequencePart:
    """Images of one sequence and size, as the detector takes them, with their rows (S,), those of annotations that
    count (n,), and states (S,)."""

    images: Indices
    rows: Indices
    frames: CameraFrames
    targets: Targets
    states: Indices


def parts_of(labelled: LabelledSet, image_state: Indices) -> Iterator[SequencePart]:
    """Split all images that have a state, shape (I,), by sequence and size. Raises ModsimError if a size is unknown."""
    images, annotations = labelled.images, labelled.annotations
    used = np.flatnonzero(image_state >= 0)
    if not np.isfinite(images.sizes_px[used]).all():
        raise ModsimError("the detector cannot be simulated over images whose size is not known")
    keys = np.column_stack([images.sequence[used], images.sizes_px[used].astype(np.int64)])
    for number, key in enumerate(np.unique(keys, axis=0)):
        part = used[(keys == key).all(axis=1)]
        timed = bool(np.isfinite(images.time_s[part]).all())
        part = part[np.argsort(images.time_s[part], kind="stable")] if timed else part
        times = images.time_s[part] if timed else np.arange(len(part), dtype=np.float64)
        times = times - times[0]
        if len(times) > 1 and np.any(np.diff(times) <= 0):
            times = np.arange(len(part), dtype=np.float64)
        place = np.full(len(images), NOBODY)
        place[part] = np.arange(len(part))
        rows = np.flatnonzero((place[annotations.image] >= 0) & ~annotations.ignored)
        rows = rows[np.argsort(place[annotations.image[rows]], kind="stable")]
        frame = place[annotations.image[rows]]
        ordinal = np.arange(len(rows)) - np.searchsorted(frame, frame)
        identity = annotations.identity[rows]
        names, vessel = np.unique(np.where(identity >= 0, identity, -1 - ordinal), return_inverse=True)
        given = images.half_planes[part]
        half_planes = np.where(np.isnan(given), EVERYWHERE, given)
        size = (int(key[1]), int(key[2]))
        yield SequencePart(
            part,
            rows,
            CameraFrames(f"sequence {number}", np.arange(len(part)), times, size, half_planes),
            Targets(
                frame=frame,
                vessel=vessel.ravel(),
                label=annotations.label[rows],
                boxes_px=np.clip(annotations.boxes_px[rows], 0, [*size, *size]),
                visible_fraction=annotations.visible_fraction[rows],
                depth_m=annotations.depth_m[rows],
                vessel_ids=tuple(f"{name}" for name in names.tolist()),
            ),
            image_state[part],
        )


def simulated(labelled: LabelledSet, image_state: Indices, model: DetectorModel, seed: int) -> LabelledSet:
    """Labelled set with the results of a simulated detector, in states of images of shape (I,)."""
    parts = list(parts_of(labelled, image_state))
    statistics = target_statistics(model, ((part.frames, part.targets) for part in parts))
    columns: list[Results] = []
    for part in parts:
        times = part.frames.times_s
        schedule = tuple((float(times[k]), int(part.states[k])) for k in run_starts(part.states))
        held = replace(model, performance=Performance(True, schedule), transition_interval_s=None)

        def clock(first: int, stop: int, times: Array = times) -> Array:
            return times[first:stop]

        drawn = Detector(held, seed, statistics, clock).detect(part.frames, part.targets)
        own = ~np.isin(drawn.kind, FALSE_KINDS) & (drawn.target >= 0)
        columns.append(
            Results(
                image=part.images[drawn.frame],
                label=drawn.label,
                boxes_px=drawn.boxes_px,
                confidence=drawn.confidence,
                origin=np.where(own, np.append(part.rows, NOBODY)[drawn.target], NOBODY),
                kind=drawn.kind,
                partner=np.append(part.rows, NOBODY)[np.where(drawn.kind == ON_VESSEL, drawn.target, drawn.partner)],
            )
        )
    names = ("image", "label", "boxes_px", "confidence", "origin", "kind", "partner")
    whole = Results(**{name: np.concatenate([getattr(part, name) for part in columns]) for name in names})
    return replace(labelled, results=whole.by_image())
