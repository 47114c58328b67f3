"""Type that each detection counts as, once the data show whether there are second boxes, splits and merges."""

from dataclasses import dataclass, replace

import numpy as np

from modsim3d.core.arrays import NOBODY, Array, Indices, Mask
from modsim3d.core.text import counted
from modsim3d.detector.merges_and_splits import MergesAndSplits
from modsim3d.formats.labelled import Images, LabelledSet
from modsim3d.formats.matching import Matched
from modsim3d.learn.bootstrap import SIGNIFICANT, Resampling, resample, spread
from modsim3d.learn.match_shapes import Trials
from modsim3d.learn.match_types import NONE, MatchTypes, VesselBoxes, kinds_of

NAMES = ("on_vessels", "duplicates", "merges", "splits")
"""The keys of the detector file, in its order."""
_WHAT = {
    "on_vessels": ("false detection on a vessel", "false detections on vessels"),
    "duplicates": ("second box", "second boxes"),
    "merges": ("box around two vessels", "boxes around two vessels"),
    "splits": ("vessel in two parts", "vessels in two parts"),
}
THRESHOLDS = {  # key of the threshold, its default and the other values that are tried
    "merges": ("merge_overlap", MergesAndSplits.merge_overlap, np.arange(2, 19) * 0.05),
    "splits": ("split_aspect", MergesAndSplits.split_aspect, np.arange(6, 33) * 0.25),
}
_STRAY = 0.002  # share of hits below a threshold that are a mistake of the rules
_TRIALS, _RUNS = 200, 24


@dataclass(frozen=True, eq=False)
class CountedAs:
    """Type that each detection counts as: types that the data do not clearly show count as if they did not exist."""

    detection: Indices  # row of the result that detects each annotation, −1 where none does, shape (T,)
    in_merged_box: Mask  # whether an annotation is in the box of another one, shape (T,)
    ambiguous: Mask  # whether an annotation is or may be in another's box, so that nobody knows a miss, shape (T,)
    false: Indices  # rows of false detections, second boxes and smaller parts included, shape (f,)
    false_positives: Indices  # rows of those that are neither, and not on vessels, shape (g,)
    on_vessels: VesselBoxes  # annotations with a false detection on them, if such are shown
    one_vessel: Mask  # whether a detection is surely one whole box of one vessel if it detects one, shape (D,)
    thresholds: dict[str, float]  # of each kind that is shown and has one
    trials: dict[str, Trials]  # of the kinds that are shown, above their threshold
    notes: tuple[str, ...]


def counted_as(labelled: LabelledSet, matched: Matched, used: Mask, without: frozenset[str] = frozenset()) -> CountedAs:
    """Types that the detections of the images that are used (I,) count as; kinds in `without` are left out."""
    false = matched.false[used[labelled.results.image[matched.false]]]
    one_vessel = np.ones(len(labelled.results), dtype=bool)
    in_merged_box, ambiguous = np.zeros((2, len(labelled.annotations)), dtype=bool)
    wanted = [name for name in NAMES if name not in without]
    if not wanted:
        return CountedAs(matched.detection, in_merged_box, ambiguous, false, false, NONE, one_vessel, {}, {}, ())
    kinds, notes = kinds_of(labelled, matched, used), list[str]()
    thresholds, trials = dict[str, float](), dict[str, Trials]()
    for name, least in _shown(kinds, wanted, labelled.images, notes).items():
        trials[name] = _above(kinds.trials[name], least)
        if least is not None:
            thresholds[name] = least
    detection, of_vessel = matched.detection.copy(), [false[:0]]
    if "splits" in trials:
        detection[kinds.split[0]] = kinds.split[1]
        one_vessel[kinds.split[1]] = one_vessel[kinds.perhaps_parts] = False
        of_vessel.append(kinds.fragments)
    if "merges" in trials:
        least = thresholds["merges"]
        merged = kinds.merged.at_least(least)
        detection[merged.smaller], detection[merged.larger] = NOBODY, merged.box
        in_merged_box[merged.smaller] = ambiguous[merged.smaller] = True
        one_vessel[merged.box] = one_vessel[kinds.one_box.at_least(least).box] = False
        ambiguous[kinds.ambiguous.at_least(least).smaller] = True
    on_vessels = NONE
    if "on_vessels" in trials:
        on_vessels, among = kinds.on_vessels, trials["on_vessels"]
        trials["on_vessels"] = replace(among, hits=among.hits + among.chance)  # those by chance lie there as well
        of_vessel.append(on_vessels.box)
        if not kinds.copies and trials.pop("duplicates", None) is not None:
            notes.append("false_positives.duplicates: none; they fit worse than first boxes do, so they lie on vessels")
    if "duplicates" in trials:
        of_vessel.append(kinds.doubled)
    owned = detection[detection >= 0]
    counted = np.flatnonzero(matched.counts & used[labelled.results.image])
    false = np.setdiff1d(counted, owned)
    free = np.setdiff1d(false, np.concatenate(of_vessel))
    said = tuple(notes)
    return CountedAs(detection, in_merged_box, ambiguous, false, free, on_vessels, one_vessel, thresholds, trials, said)


def _shown(kinds: MatchTypes, wanted: list[str], images: Images, notes: list[str]) -> dict[str, float | None]:
    """The kinds that the data clearly show, with their thresholds; notes on the others."""
    shown = dict[str, float | None]()
    for name in wanted:
        trials = kinds.trials[name]
        least, remark = _least(name, trials)
        above = _above(trials, least)
        seen, chance = float((above.hits + above.chance).sum()), float(above.chance.sum())
        needed = _needed(chance)
        strength = _strength(above, images) if seen >= needed else 0.0
        if strength >= SIGNIFICANT:
            shown[name] = least
            notes += remark
        elif seen >= needed:
            why = f"{strength:.1f} standard errors from 0 in {len(above.image)} cases, needs {SIGNIFICANT}"
            notes.append(f"false_positives.{name}: none; {why}")
        else:
            by_chance = f", of which {chance:.1f} by chance" if chance >= 0.05 else ""
            found = f"had {counted(round(seen), *_WHAT[name])}{by_chance}, needs {needed}"
            notes.append(f"false_positives.{name}: none; {found}")
    return shown


def _least(name: str, trials: Trials) -> tuple[float | None, list[str]]:
    """The threshold of a kind, its default unless another is clearly likelier, with a remark; None without one."""
    if name not in THRESHOLDS:
        return None, []
    key, default, others = THRESHOLDS[name]
    best = max([default, *others.tolist()], key=lambda value: _likelihood(trials, value))
    gain = 2 * (_likelihood(trials, best) - _likelihood(trials, default))
    if gain <= SIGNIFICANT**2:
        return default, []
    return float(f"{best:.4g}"), [f"false_positives.{key}: {best:.4g}, clearly likelier than {default:g}"]


def _above(trials: Trials, least: float | None) -> Trials:
    return trials if least is None else trials.where(trials.value >= least - 1e-9)


def _needed(chance: float) -> int:
    """Least number that is surely more than chance makes."""
    square = SIGNIFICANT**2
    return int(np.ceil(chance + (square + np.sqrt(square**2 + 8 * chance * square)) / 2))


def _strength(trials: Trials, images: Images) -> float:
    """Standard errors from 0 of the share, from runs of frames."""
    times = images.time_s
    timed = bool(np.isfinite(times).any())
    run_s = float(np.nanmax(times) - np.nanmin(times)) / _RUNS if timed else 0.0
    sums = hits_and_trials(trials, resample(images, _TRIALS, 0, run_s))
    error = float(spread(sums[1:, 0]))
    return float(sums[0, 0]) / error if error > 0 else 0.0


def hits_and_trials(trials: Trials, resampling: Resampling) -> Array:
    """Number of hits and of trials, the sums of the data first, shape (1 + replicates, 2)."""
    return resampling.sums(trials.image, np.column_stack([trials.hits, trials.weight]))


def _likelihood(trials: Trials, least: float) -> float:
    """Log-likelihood with a share above a threshold and hardly any hits below it, besides those of chance."""
    above = trials.value >= least - 1e-9
    total = 0.0
    for chosen, at_least in ((above, 0.0), (~above, 1.0)):
        part = trials.where(chosen)
        whole = float(part.weight.sum())
        if whole <= 0:
            continue
        hits = float(np.clip(part.hits.sum(), 0, whole))
        share = _STRAY if at_least else float(np.clip(hits / whole, _STRAY, 1 - _STRAY))
        total += hits * np.log(share) + (whole - hits) * np.log(1 - share)
    return total
