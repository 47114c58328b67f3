"""Figures of the page that `modsim3d check run` writes: what a run shows of its detector."""

from functools import partial

import numpy as np

from modsim3d.core.arrays import Array, Indices, run_starts
from modsim3d.core.boxes import sizes
from modsim3d.core.document import Figure
from modsim3d.detector.box_error import BoxErrorSource
from modsim3d.detector.model import ERROR_COMPONENTS, ERROR_PAIRS, DetectorModel
from modsim3d.detector.records import TRUE
from modsim3d.verify.class_checks import at_each, miss_covariance, miss_probabilities
from modsim3d.verify.error_parameters import parameter_names
from modsim3d.verify.evidence import Evidence
from modsim3d.verify.parameters import TestResult, Verification
from modsim3d.view.pages import charts


def run_lengths(evidence: Evidence) -> Indices:
    """Number of runs of misses by length from 0 on, (most + 1,); one ends where the vessel is found or ignored."""
    instances = evidence.instances
    missed = instances.outcome == -1
    length = missed.astype(np.int64)
    order = np.lexsort((instances.frame, instances.camera))  # each row after the one before it
    for row in order[missed[order] & (instances.before[order] >= 0)]:
        length[row] += length[instances.before[row]]
    goes_on = np.zeros(len(missed), dtype=bool)
    goes_on[instances.before[np.flatnonzero(missed & (instances.before >= 0))]] = True
    return np.bincount(length[missed & ~goes_on], minlength=2)


def asked_run_lengths(model: DetectorModel, evidence: Evidence, miss_probability: Array, most: int) -> Array:
    """Expected number of runs of 1, 2, ... `most` misses, shape (most,), given the probability of each miss, (n,)."""
    before, score = evidence.instances.before, model.persistence.score
    share = model.persistence.class_vessel_share if score is None else score.vessel_share
    if not share:
        again = missed_again(model, evidence, miss_probability)
        return expected_run_lengths(miss_probability, again, before, most)
    expected = np.zeros(most)
    for weight, (chance,) in at_each(share, 1 - miss_probability):
        again = missed_again(model, evidence, 1 - chance)
        expected += weight * expected_run_lengths(1 - chance, again, before, most)
    return expected


def missed_again(model: DetectorModel, evidence: Evidence, miss_probability: Array) -> Array:
    """Probability of a miss given that the frame before was one, shape (n,); the plain one without a frame before."""
    instances, tau, score = evidence.instances, model.persistence.class_s, model.persistence.score
    if tau <= 0 and score is None:
        return miss_probability
    before = np.where(instances.before >= 0, instances.before, 0)
    earlier, apart_s = miss_probability[before], instances.time_s - instances.time_s[before]
    if score is not None:  # of the memory beyond the frame before, only what vessels keep counts
        changing = (score.correlation(apart_s) - score.vessel_share) / (1 - score.vessel_share)
        covariance = miss_covariance(miss_probability, earlier, changing)
        again = miss_probability + covariance / np.maximum(earlier, 1e-12)
        return np.where(instances.before >= 0, np.minimum(again, 1), miss_probability)
    kept = np.exp(-apart_s / tau)
    same = np.minimum(1.0, miss_probability / np.where(earlier > 0, earlier, 1))
    return np.where(instances.before >= 0, kept * same + (1 - kept) * miss_probability, miss_probability)


def expected_run_lengths(miss_probability: Array, again: Array, before: Indices, most: int) -> Array:
    """Expected number of runs of 1, 2, ... `most` misses, shape (most,). Instances (n,) have a probability of a miss,
    one given that the frame before was a miss, and the row of that frame, or −1."""
    after = np.full(len(before), -1)
    follows = np.flatnonzero(before >= 0)
    after[before[follows]] = follows
    ends = np.where(after >= 0, 1 - again[after], 1.0)
    chance = miss_probability - np.where(before >= 0, miss_probability[before] * again, 0.0)
    expected = np.zeros(most)
    row, alive = np.arange(len(before)), np.ones(len(before), dtype=bool)
    for k in range(most):
        expected[k] = (chance * ends[row])[alive].sum()
        onwards = after[row]
        alive &= onwards >= 0
        row = np.where(onwards >= 0, onwards, row)
        chance = chance * np.where(alive, again[row], 0)
    return expected


_MAX_DOTS = 1200
_BINS = 10


def timelines(model: DetectorModel, evidence: Evidence) -> list[Figure]:
    """One timeline for all cameras, or one for each where they have states of their own."""
    cameras = evidence.cameras if model.performance.per_camera else evidence.cameras[:1]
    titles = [f": {seen.frames.camera}" if len(cameras) > 1 else "" for seen in cameras]
    return [
        Figure(partial(_timeline, model, evidence, camera), f"Which state the detector was in{title}")
        for camera, title in enumerate(titles)
    ]


def _timeline(model: DetectorModel, evidence: Evidence, camera: int) -> str:
    images = evidence.frames
    mask = images.camera == camera
    times, states = images.time_s[mask], images.state[mask]
    changes = run_starts(states)
    stops = np.append(times[changes[1:]], times[-1])
    return charts.timeline(times[changes], stops, states[changes].tolist(), [state.name for state in model.states])


def error_scatters(verification: Verification, model: DetectorModel, evidence: Evidence) -> list[Figure]:
    """A figure of the box errors of each state, with the laws asked for and measured."""
    tests = {verdict.parameter.name: verdict for verdict in verification.verdicts}
    state_of_hits = evidence.instances.state[evidence.true_detections.instance]
    scale, figures = BoxErrorSource.from_model(model), []
    for index, state in enumerate(model.states):
        rows = np.flatnonzero((state_of_hits == index) & (evidence.true_detections.kind == TRUE))
        if not len(rows):
            continue
        boxes = evidence.instances.boxes_px[evidence.true_detections.instance[rows]]
        errors = scale.in_file_units(np.full(len(rows), index), sizes(boxes), evidence.true_detections.errors_px[rows])
        laws = [_law(tests, f"states.{state.name}.box_error", measured) for measured in (False, True)]
        unit = "sides" if state.box_error.relative else "px"
        caption = (
            f"{state.name}: errors as put out, two standard deviations of the law asked for (dashed) and of the law "
            "fitted (solid), both before truncation: boxes cut the errors down, which the fit takes out."
        )
        figures.append(Figure(partial(_scatters, errors, laws, state.name, unit), caption))
    return figures


Law = tuple[Array, Array] | None


def _law(tests: dict[str, TestResult], path: str, measured: bool) -> Law:
    """Mean and covariance of a state's box errors, asked or measured; None where they were not tested."""
    names = [f"{path}.{name}" for name in parameter_names()]
    values = [(tests[name].measured if measured else tests[name].asked) if name in tests else None for name in names]
    numbers = np.array([np.nan if value is None else value for value in values])
    if np.isnan(numbers).any():
        return None
    correlation = np.eye(4)
    for value, (i, j) in zip(numbers[8:], ERROR_PAIRS, strict=True):
        correlation[i, j] = correlation[j, i] = value
    return numbers[:4], correlation * np.outer(numbers[4:8], numbers[4:8])


def _scatters(errors: Array, laws: list[Law], name: str, unit: str) -> str:
    return "".join(_scatter(errors, pair, laws, name, unit) for pair in ((0, 1), (2, 3)))


def _scatter(errors: Array, pair: tuple[int, int], laws: list[Law], name: str, unit: str) -> str:
    i, j = pair
    shown = errors[:: max(1, len(errors) // _MAX_DOTS)]
    outlines = [None if law is None else charts.ellipse(law[0][[i, j]], law[1][np.ix_(pair, pair)]) for law in laws]
    x = np.concatenate([shown[:, i], *(outline[0] for outline in outlines if outline)])
    y = np.concatenate([shown[:, j], *(outline[1] for outline in outlines if outline)])
    axes = charts.Axes(_range(x), _range(y))
    content = charts.dots(axes, shown[:, i], shown[:, j], charts.colour_of(5))
    for outline, colour, dashed in zip(outlines, (charts.ASKED, charts.FOUND), (True, False), strict=True):
        if outline is not None:
            content += charts.line(axes, *outline, colour, dashed)
    first, second = ERROR_COMPONENTS[i], ERROR_COMPONENTS[j]
    return axes.drawing(content, f"{name}: {first} and {second}", f"{first}, {unit}", f"{second}, {unit}")


def _range(values: Array) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    room = 0.04 * (high - low) or 1.0
    return low - room, high + room


def miss_lengths(model: DetectorModel, evidence: Evidence) -> str:
    """Numbers of frames in a row in which vessels are missed, and what is expected."""
    runs = run_lengths(evidence)
    most = max(len(runs) - 1, 4)
    expected = asked_run_lengths(model, evidence, miss_probabilities(model, evidence), most)
    counts = np.zeros(most)
    counts[: len(runs) - 1] = runs[1:]
    lengths = np.arange(1.0, most + 1)
    axes = charts.Axes((0.4, most + 0.6), (0, 1.1 * float(max(counts.max(), expected.max(), 1))))
    content = charts.bars(axes, lengths, counts, 0.7, charts.FOUND)
    content += charts.line(axes, lengths, expected, charts.ASKED, dashed=True)
    return axes.drawing(content, "misses in a row", "frames", "number of runs")


def reliability(evidence: Evidence) -> str:
    """The share of true detections at each confidence."""
    true, false = evidence.true_detections.confidence, evidence.false_positives.confidence
    edges = np.linspace(0, 1, _BINS + 1)
    n_true, _ = np.histogram(true, edges)
    n_all = n_true + np.histogram(false, edges)[0]
    some = n_all > 0
    share, total = n_true[some] / n_all[some], n_all[some]
    middle = (edges[:-1] + edges[1:])[some] / 2
    z = 1.96  # Wilson (1927)
    centre = (share + z**2 / (2 * total)) / (1 + z**2 / total)
    half = z * np.sqrt(share * (1 - share) / total + z**2 / (4 * total**2)) / (1 + z**2 / total)
    axes = charts.Axes((0, 1), (0, 1.05))
    content = charts.line(axes, np.array([0.0, 1.0]), np.array([0.0, 1.0]), "var(--soft)", dashed=True, width=1)
    content += charts.whiskers(axes, middle, centre - half, centre + half, charts.FOUND)
    content += charts.line(axes, middle, share, charts.FOUND)
    return axes.drawing(content, "reliability of confidence", "confidence", "share of true detections")
