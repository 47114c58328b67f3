"""The verdicts on a run as terminal rows, `verify.json` and a page."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from modsim3d.arrays import Array
from modsim3d.boxes import sizes
from modsim3d.detector.box_error import BoxErrorSource
from modsim3d.detector.model import ERROR_COMPONENTS, ERROR_PAIRS, DetectorModel
from modsim3d.detector.records import TRUE
from modsim3d.display import counted
from modsim3d.outputs.placing import write_files
from modsim3d.paths import StrPath, as_path
from modsim3d.verify.class_checks import miss_probabilities
from modsim3d.verify.error_parameters import parameter_names
from modsim3d.verify.evidence import Evidence
from modsim3d.verify.measures import Exact
from modsim3d.verify.parameters import (
    DIFFERS,
    FALLS_SHORT,
    OBEYS,
    OVERALL_ALPHA,
    UNCHECKED,
    UNTESTED,
    Verdict,
    Verification,
)
from modsim3d.verify.run_lengths import expected_run_lengths, missed_again, run_lengths
from modsim3d.verify.verification import VerifiedRun
from modsim3d.view.pages import charts, page
from modsim3d.view.pages.provenance import Provenance, file_input
from modsim3d.view.pages.run_inputs import run_inputs, run_seeds, run_versions

FORMAT = 1
FILES = ("verify.json", "verify.html")
HEADER = ("parameter", "asked", "measured", "interval", "noticed from", "verdict")
_MOST_DOTS = 1200
_BINS = 10


def groups_of(verification: Verification) -> dict[str, list[Verdict]]:
    """The verdicts by part of the detector, in order."""
    groups: dict[str, list[Verdict]] = {}
    for verdict in verification.verdicts:
        groups.setdefault(verdict.parameter.group, []).append(verdict)
    return groups


def row_of(verdict: Verdict) -> tuple[str, ...]:
    """A verdict as cells under `HEADER`."""
    parameter = verdict.parameter
    unit = f" {parameter.unit}" if parameter.unit else ""
    asked, promised = _number(verdict.asked) + unit, parameter.promised
    if verdict.measured is None or verdict.interval is None:
        return parameter.name, asked if math.isfinite(verdict.asked) else "–", "–", "–", "–", verdict.verdict
    if isinstance(parameter.measure, Exact):
        wrong = "{} of {} wrong".format(*_counts(parameter.measure))
        return parameter.name, "always" if parameter.asked is None else asked, wrong, "exact", "once", verdict.verdict
    asked = asked if promised is None else f"{_number(promised)}, by rule {asked}"
    interval = " … ".join(map(_number, verdict.interval))
    return parameter.name, asked, _number(verdict.measured), interval, _noticed(verdict), verdict.verdict


def notes_of(verification: Verification) -> list[str]:
    """What else a reader should know."""
    return [f"{name}: {note}" for name, note in named_notes(verification)]


def named_notes(verification: Verification) -> list[tuple[str, str]]:
    """The names of parameters, and what a reader should know of each."""
    notes = []
    for verdict in verification.verdicts:
        parameter = verdict.parameter
        if verdict.verdict == FALLS_SHORT and parameter.promised is not None:
            short = (
                f"asked for is {_number(parameter.promised)}; the rule of eq. 7.35 gives {_number(verdict.asked)} on "
                f"this run, {_number(parameter.promised - verdict.asked)} short of it; measured "
                f"{_number(verdict.measured or 0.0)}"
            )
            notes.append((parameter.name, short))
        elif parameter.note and verdict.verdict != FALLS_SHORT:
            notes.append((parameter.name, parameter.note))
    return notes


def conclusion(verification: Verification) -> str:
    """The outcome in a sentence."""
    tested = sum(verdict.verdict not in (UNTESTED, UNCHECKED) for verdict in verification.verdicts)
    cause = verification.cause
    if cause is None:
        short = sum(verdict.verdict == FALLS_SHORT for verdict in verification.verdicts)
        also = f"; {short} obey the thesis's rule and fall short of what is asked for" if short else ""
        return f"The run obeys its detector file: nothing in {tested} tests speaks against it{also}."
    measure = cause.parameter.measure
    said = f"asked {_number(cause.asked)}, measured {_number(cause.measured or 0.0)}"
    if isinstance(measure, Exact):
        said = "wrong {} times of {}".format(*_counts(measure))
    return (
        f"The run does NOT obey the detector file: {len(verification.failed)} of {tested} tests fail. What stands out "
        f"is {cause.parameter.name}: {said}."
    )


def _counts(measure: Exact) -> tuple[str, str]:
    return f"{measure.wrong}", f"{measure.count:.0f}"


def _number(value: float) -> str:
    return f"{value:.4g}".replace("-", "−").replace("inf", "∞")


def _noticed(verdict: Verdict) -> str:
    below, above = verdict.noticed
    if below is not None and above is not None and abs(below - above) <= 0.1 * above:
        return f"± {_number(max(below, above))}"
    parts = [f"−{_number(below)}"] if below is not None else []
    parts += [f"+{_number(above)}"] if above is not None else []
    return " ".join(parts) or "–"


def report_data(verified: VerifiedRun) -> dict[str, Any]:
    """What `verify.json` holds."""
    verification = verified.verification
    cause = verification.cause
    return {
        "format": FORMAT,
        "scene": verified.run.scene.name,
        "detector": str(verified.detector) if verified.detector else str(Path("scene") / "detector"),
        "obeys": verification.obeys,
        "cause": cause.parameter.name if cause else None,
        "overall_alpha": OVERALL_ALPHA,
        "alpha": verification.alpha,
        "parameters": [_entry(verdict) for verdict in verification.verdicts],
    }


def _entry(verdict: Verdict) -> dict[str, Any]:
    parameter, measure = verdict.parameter, verdict.parameter.measure
    return {
        "name": parameter.name,
        "group": parameter.group,
        "state": parameter.state,
        "in_file": parameter.in_file,
        "unit": parameter.unit,
        "asked": _finite(verdict.asked),
        "promised": parameter.promised,
        "measured": _finite(verdict.measured),
        "interval": verdict.interval,
        "p_value": verdict.p_value,
        "strength": _finite(measure.strength()) if measure else None,
        "effective_count": _finite(measure.count) if measure else None,
        "noticed_below": verdict.noticed[0],
        "noticed_above": verdict.noticed[1],
        "verdict": verdict.verdict,
        "note": parameter.note,
    }


def _finite(value: float | None) -> float | None:
    return None if value is None or not math.isfinite(value) else value


def write_report(verified: VerifiedRun, folder: StrPath, command: str | None = None) -> None:
    """Write `verify.json` and `verify.html` into a folder; the page names the command, or the call if it is None."""
    target = as_path(folder, "folder")
    data = orjson.dumps(report_data(verified), option=orjson.OPT_INDENT_2 | orjson.OPT_SERIALIZE_NUMPY) + b"\n"
    write_files(dict(zip((target / name for name in FILES), (data, _page(verified, command)), strict=True)))


def _page(verified: VerifiedRun, command: str | None) -> str:
    verification, model, evidence = verified.verification, verified.model, verified.evidence
    found, false = evidence.true_detections, evidence.false_detections
    body = [
        page.paragraph(conclusion(verification), "lead" if verification.obeys else "bad"),
        page.paragraph(
            f"{verified.run.steps} steps, {len(evidence.instances.state)} chances to detect a vessel, "
            f"{len(found.instance)} true detections, {len(false.frame_row)} false ones. Each interval holds the values "
            "that its test would not have rejected; the level of all tests together is "
            f"{OVERALL_ALPHA:.0%}. “Noticed from” is the smallest change of the file that this run would have shown, "
            "with 90 % power.",
            "soft",
        ),
        page.tiles(_results(verification)),
        *([page.heading("What fails"), _table(verification.failed)] if verification.failed else []),
        page.heading("Performance states"),
        *_timelines(model, evidence),
        page.heading("Box errors"),
        *_scatters(verification, model, evidence),
        page.heading("Misses and confidence"),
        charts.figure(
            [_run_lengths(model, evidence), _reliability(evidence)],
            "Left: how many frames in a row a vessel is missed; line: expected. Right: share of true ones among the "
            "detections of each confidence, with 95 % intervals; one that is a probability follows the dashes.",
        ),
    ]
    body += [page.heading("Every test"), *(_group(name, found) for name, found in groups_of(verification).items())]
    if notes_of(verification):
        body += [page.heading("Notes"), *_notes(verification)]
    title = f"{verified.run.scene.name}: does the run obey its detector file?"
    return page.page(title, body, _provenance(verified, command))


def _notes(verification: Verification) -> Iterator[str]:
    """The notes, each once with the names that it is about."""
    names: dict[str, list[str]] = {}
    for name, note in named_notes(verification):
        names.setdefault(note, []).append(name)
    yield page.listed(f"{found[0]}: {note}" for note, found in names.items() if len(found) == 1)
    for note, found in names.items():
        if len(found) > 1:
            yield page.folded(f"{note[0].upper()}{note[1:]}: {len(found)} entries", page.paragraph(", ".join(found)))


def _provenance(verified: VerifiedRun, command: str | None) -> Provenance:
    run, given = verified.run, verified.detector
    call = f"modsim3d.verify_run({str(run.folder)!r}{'' if given is None else f', {str(given)!r}'}).write(…)"
    named = () if given is None else (file_input("detector file that it is held against", given),)
    return Provenance(
        page="verification: does a run obey its detector file?",
        made_by=command or f"{call} from Python",
        inputs=(*named, *run_inputs(run)),
        seeds=run_seeds(run),
        options=(("Level", f"{OVERALL_ALPHA:.0%} for all tests together, {verified.verification.alpha:.2g} for each"),),
        made_before=run_versions(run),
    )


def _results(verification: Verification) -> list[tuple[str, str, str]]:
    """The tiles: how many tests passed, failed, and could not be made."""
    count = Counter(verdict.verdict for verdict in verification.verdicts)
    unmade = count[UNTESTED] + count[UNCHECKED]
    tested = len(verification.verdicts) - unmade
    found = [
        ("Passed", f"{tested - count[DIFFERS]:,}", f"of {tested:,} tests"),
        ("Failed", f"{count[DIFFERS]:,}", "tests in which the run speaks against its file"),
        ("Not tested", f"{unmade:,}", "too little seen, or a model without a check"),
    ]
    if count[FALLS_SHORT]:
        found.append(("Fall short", f"{count[FALLS_SHORT]:,}", "obey the thesis's rule, not the rate asked for"))
    return found


def _group(name: str, verdicts: Sequence[Verdict]) -> str:
    """The tests of a part of the detector, folded; those that fail stand at the top of the page too."""
    count = Counter(verdict.verdict for verdict in verdicts)
    said = [f"{counted(count[OBEYS], 'test')} passed"] if count[OBEYS] else []
    said += [f"{count[DIFFERS]:,} failed"] if count[DIFFERS] else []
    said += [f"{count[FALLS_SHORT]:,} fall short of the asked rate"] if count[FALLS_SHORT] else []
    said += [f"{count[UNTESTED]:,} not tested: too little seen"] if count[UNTESTED] else []
    said += [f"{count[UNCHECKED]:,} without a check"] if count[UNCHECKED] else []
    passed = " (all within the interval of their test)" if count[OBEYS] == len(verdicts) else ""
    return page.folded(f"{name.capitalize()}: {', '.join(said)}{passed}", _table(verdicts))


def _table(verdicts: Sequence[Verdict]) -> str:
    bad = {index for index, verdict in enumerate(verdicts) if verdict.fails}
    return page.table([row_of(verdict) for verdict in verdicts], HEADER, bad)


def _timelines(model: DetectorModel, evidence: Evidence) -> list[str]:
    """One timeline for all cameras, or one for each where they have states of their own."""
    cameras = evidence.cameras if model.performance.per_camera else evidence.cameras[:1]
    figures = []
    for camera, seen in enumerate(cameras):
        caption = "Which state the detector was in" + (f": {seen.frames.camera}" if len(cameras) > 1 else "")
        figures.append(charts.figure([_timeline(model, evidence, camera)], caption))
    return figures


def _timeline(model: DetectorModel, evidence: Evidence, camera: int) -> str:
    images = evidence.frames
    ours = images.camera == camera
    times, states = images.time_s[ours], images.state[ours]
    changes = np.flatnonzero(np.diff(states, prepend=states[0] - 1))
    stops = np.append(times[changes[1:]], times[-1])
    return charts.timeline(times[changes], stops, states[changes].tolist(), [state.name for state in model.states])


def _scatters(verification: Verification, model: DetectorModel, evidence: Evidence) -> list[str]:
    found = {verdict.parameter.name: verdict for verdict in verification.verdicts}
    state_of_hits = evidence.instances.state[evidence.true_detections.instance]
    scale, figures = BoxErrorSource.from_model(model), []
    for index, state in enumerate(model.states):
        rows = np.flatnonzero((state_of_hits == index) & (evidence.true_detections.kind == TRUE))
        if not len(rows):
            continue
        boxes = evidence.instances.boxes_px[evidence.true_detections.instance[rows]]
        errors = scale.in_file_units(np.full(len(rows), index), sizes(boxes), evidence.true_detections.errors_px[rows])
        path = f"states.{state.name}.box_error"
        laws = [_law(found, path, measured) for measured in (False, True)]
        unit = "sides" if state.box_error.relative else "px"
        drawings = [_scatter(errors, pair, laws, state.name, unit) for pair in ((0, 1), (2, 3))]
        caption = (
            f"{state.name}: errors as put out, two standard deviations of the law asked for (dashed) and of the law "
            "fitted (solid), both before truncation: boxes cut the errors down, which the fit takes out."
        )
        figures.append(charts.figure(drawings, caption))
    return figures


Law = tuple[Array, Array] | None


def _law(found: dict[str, Verdict], path: str, measured: bool) -> Law:
    """Mean and covariance of a state's box errors, asked or measured; None where they were not tested."""
    names = [f"{path}.{name}" for name in parameter_names()]
    values = [(found[name].measured if measured else found[name].asked) if name in found else None for name in names]
    numbers = np.array([np.nan if value is None else value for value in values])
    if np.isnan(numbers).any():
        return None
    correlation = np.eye(4)
    for value, (i, j) in zip(numbers[8:], ERROR_PAIRS, strict=True):
        correlation[i, j] = correlation[j, i] = value
    return numbers[:4], correlation * np.outer(numbers[4:8], numbers[4:8])


def _scatter(errors: Array, pair: tuple[int, int], laws: list[Law], name: str, unit: str) -> str:
    i, j = pair
    shown = errors[:: max(1, len(errors) // _MOST_DOTS)]
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


def _run_lengths(model: DetectorModel, evidence: Evidence) -> str:
    found = run_lengths(evidence)
    most = max(len(found) - 1, 4)
    missed = miss_probabilities(model, evidence)
    again = missed_again(model, evidence, missed)
    expected = expected_run_lengths(missed, again, evidence.instances.before, most)
    counts = np.zeros(most)
    counts[: len(found) - 1] = found[1:]
    lengths = np.arange(1.0, most + 1)
    axes = charts.Axes((0.4, most + 0.6), (0, 1.1 * float(max(counts.max(), expected.max(), 1))))
    content = charts.bars(axes, lengths, counts, 0.7, charts.FOUND)
    content += charts.line(axes, lengths, expected, charts.ASKED, dashed=True)
    return axes.drawing(content, "misses in a row", "frames", "number of runs")


def _reliability(evidence: Evidence) -> str:
    true, false = evidence.true_detections.confidence, evidence.false_detections.confidence
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
