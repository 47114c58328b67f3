"""Report on a voyage besides the detector, and its tables."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from modsim3d.core.document import Block, Figure, Heading, Items, Table, Text
from modsim3d.core.text import counted, in_percent, number
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import match
from modsim3d.geometry.camera import Camera
from modsim3d.learn.bootstrap import Column
from modsim3d.learn.learn_detector import LearnOptions, learn_detector
from modsim3d.learn.learned_detector import LearnSettings
from modsim3d.learn.matches import Outcomes
from modsim3d.learn.report import LearnReport
from modsim3d.learn.states import each_its_own, parse_states
from modsim3d.learn.voyage import coverage as sea_coverage
from modsim3d.learn.voyage import deconvolution as truth_noise
from modsim3d.learn.voyage.coverage import Coverage, FrameStretch
from modsim3d.learn.voyage.deconvolution import ComponentNoise, CorrectedDetector
from modsim3d.learn.voyage.labelled_voyage import CameraFit, LabelledVoyage
from modsim3d.learn.voyage.non_ais import classification
from modsim3d.learn.voyage.non_ais.classification import ClassifiedDetections, StateRates, TimeSpan
from modsim3d.learn.voyage.non_ais.duration_types import MIN_RATIO, MIN_S
from modsim3d.learn.voyage.non_ais.linking import Behaviour
from modsim3d.learn.voyage.registration.parameters import COMMON_DELAY, SHARED, ConfoundedGroup
from modsim3d.learn.voyage.registration.registering import BY_RULE, RegisteredValue, Registration
from modsim3d.scene.scene import Scene

_RATES_TITLE = "False positives in an image, where not everything that floats has a transponder"
_HEADS = ("state", "images", "unmatched", "like vessels", "least", "by lifetimes", "most", "in empty stretches", "used")


def rows_of(rates: Sequence[StateRates], level: float) -> list[tuple[str, ...]]:
    """The rows of the table, with intervals of a level."""
    return [
        (
            rate.state,
            f"{rate.images:,}",
            f"{rate.unmatched:,}",
            _share(rate.vessel_share, level, rate.units) if rate.mixture else "none",
            *(_rate(column, level, rate.units) for column in (rate.lower, rate.mixture, rate.upper, rate.empty)),
            rate.source.value,
        )
        for rate in rates
    ]


def sentences(judged: ClassifiedDetections, rates: Sequence[StateRates]) -> Iterator[str]:
    """Sentences beside the table: vessels, what was not taken for one and why, and what cannot be known."""
    tracklets, least = judged.tracklets, f"{judged.least_s:g} s"
    if not np.isfinite(judged.links.time_s).any() and len(judged.links.rows):
        yield "the frames have no times, so no detection can be followed: all unmatched detections count as false"
        return
    if not judged.kinds.found:
        short = f"no unmatched detections last as vessels do ({least} on average at least)"
        yield f"{short}: all of them count as false positives"
        if longer := int(np.count_nonzero(judged.kinds.longer[judged.kinds.of_thing])):
            yield (
                f"the rate of false positives may be an upper bound: {counted(longer, 'thing', 'things')} seen for "
                f"longer than {judged.least_s / MIN_RATIO:g} s may be vessels, and the frames do not tell"
            )
    else:
        vessels = int(np.count_nonzero(judged.lasting >= 0.5))
        yield (
            f"{vessels:,} of {len(tracklets.detections):,} unmatched things are taken for vessels without a transponder"
            f": they last {_seconds(judged.kinds.long_s[0])} on average, and flicker that stays "
            f"{_seconds(judged.kinds.short_s[0])}; their detections count neither as hits nor as false"
        )
        if ignored := int(np.count_nonzero(judged.crossings.annotations)):
            boxes = counted(ignored, "box", "boxes")
            yield f"{boxes} of known vessels that these pass are ignored, since one may hide the other"
        yield (
            f"false positives are taken to last {judged.least_s / MIN_RATIO:g} s on average at most; a buoy and a "
            "false positive that stays look alike, and what lasts as long as vessels do counts as a "
            "vessel; only stretches in which the sea is known to be empty (--empty) can tell them apart"
        )
    if silent := int(np.count_nonzero(~judged.tells)):
        yield (
            f"{counted(silent, 'unmatched detection', 'unmatched detections')} where vessels pass each other or come "
            "into view at the image's border may be of known ones: they are left out, and count in 'most' alone"
        )
    lasting = tracklets.lasted_s >= judged.least_s
    for behaviour in Behaviour:
        count = int(np.count_nonzero(lasting & (tracklets.behaviour == behaviour)))
        if count and behaviour is not Behaviour.LIKE_A_VESSEL:
            number = "1 thing that lasts counts" if count == 1 else f"{count:,} things that last count"
            but = ", but not in the least rate" if behaviour in (Behaviour.JUMPS, Behaviour.CHANGES_SIZE) else ""
            yield f"{number} as false{but}: {behaviour.in_words}"
    for source in classification.RateSource:
        states = [rate.state for rate in rates if rate.source is source]
        if states and (judged.kinds.found or judged.stretches):
            where = f" in {', '.join(states)}" if len(states) < len(rates) else ""
            yield f"the rate of false positives{where} is that of {source.value}"


def _seconds(time_s: float) -> str:
    return f"{time_s:,.0f} s" if time_s >= 100 else f"{time_s:.3g} s"


def _rate(column: Column | None, level: float, units: int) -> str:
    if column is None:
        return "–"
    low, high = column.interval(level, units)
    return f"{number(float(column.estimate), 2)} ({number(float(low), 2)} to {number(float(high), 2)})"


def _share(column: Column, level: float, units: int) -> str:
    low, high = column.interval(level, units)
    return f"{in_percent(float(column.estimate))} ({in_percent(float(low))} to {in_percent(float(high))})"


def learn_beside_unseen(
    labelled: LabelledSet,
    settings: LearnSettings,
    options: LearnOptions,
    stretches: tuple[TimeSpan, ...] = (),
    least_s: float = MIN_S,
) -> tuple[LearnReport, ClassifiedDetections]:
    """Learn a detector from a set whose annotations are vessels with a transponder; detections that behave like another
    are neither hits nor false. In the stretches, on the images' clock, nothing else floats; `least_s` is the least mean
    lifetime of what lasts as vessels do. The report has rates of false positives. Raises ModsimError as
    `learn_detector`; also if no frame lies in a stretch that is marked as empty."""
    conditions = labelled.conditions
    states = parse_states(options.states, conditions) if options.states else each_its_own(conditions)
    image_state = states.of_images(labelled.images, conditions)
    matched = match(labelled, settings.rule, settings.threshold)
    observed = Outcomes(labelled, matched, states.names, image_state, settings.threshold, settings.without)
    judged = classification.classify_unmatched(observed, stretches, least_s)
    report = learn_detector(judged.labelled, settings, options)
    learned = report.learned
    rates = judged.rates(learned.resampling, learned.observed.image_state, learned.observed.states)
    remarks = (*report.remarks_on_data, *sentences(judged, rates))
    return replace(report, learned=judged.corrected(learned), remarks_on_data=remarks), judged


# ---- A registration as a table and in sentences ----

HEADER = ("parameter", "scene", "registered", "change", "95 % interval", "held")
_WORDS = {parameter.name: parameter.words for parameter in SHARED} | {COMMON_DELAY: "mean delay of all reports"}
_WORDS |= {"clock_s": "clock", "focal_share": "focal length", "k1": "lens distortion k1"}
_UNITS = {parameter.name: parameter.unit for parameter in SHARED} | {COMMON_DELAY: "s"}


def registration_table(registered: CameraFit, scene: Scene) -> Table:
    """The parameters of one camera."""
    solution = registered.registration
    (camera,) = (eye for eye in scene.cameras if eye.name == solution.camera)
    before, after = _values(camera), _values(solution.camera_of(camera))
    before["clock_s"] = f"{registered.clock_s:+.3f} s" if registered.clock_s else "0 s"
    after["clock_s"] = f"{registered.clock_s + solution.values['clock_s']:+.3f} s"
    lost = {group.held for group in solution.groups} - {*BY_RULE, COMMON_DELAY}
    rows = tuple(
        (
            _name(entry),
            before.get(entry.name, ""),
            after.get(entry.name, "") if not entry.held else "",
            amount(entry.name, entry.value, entry.unit, entry.standard_error) if not entry.held else "",
            _interval(entry),
            "not determined, see below" if entry.name in lost else entry.held,
        )
        for entry in (*solution.estimates, delay_of(registered), *solution.vessels)
    )
    return Table(f"Registration of camera '{solution.camera}' in {registered.source}", HEADER, rows)


def registration_lead(registered: CameraFit) -> str:
    """Basis of a registration, and its residuals before and after."""
    solution = registered.registration
    before = f"{solution.rms_before_px:.3g} px" if math.isfinite(solution.rms_before_px) else "more than the lens shows"
    moved = ", with vessels off their reports as fits them best" if solution.values.vessels.any() else ""
    return (
        f"Camera '{solution.camera}' was registered by {len(solution.sightings):,} of "
        f"{counted(solution.detections, 'detection')}, of {counted(solution.matched_vessels, 'vessel')}: bearings and "
        f"waterlines are off by {before} with the scene's values and by {solution.rms_after_px:.3g} px with the "
        f"registered ones{moved} (root mean square, by the same matches)."
    )


def delay_of(registered: CameraFit) -> RegisteredValue:
    """The mean delay of all reports, which is held by a rule."""
    given, nan = registered.known.delay_s, float("nan")
    rule = "the mean delay is taken to be zero" if given is None else f"given as {given:+g} s"
    return RegisteredValue(COMMON_DELAY, _WORDS[COMMON_DELAY], "s", given or 0.0, nan, nan, nan, rule)


def exchanges(registration: Registration) -> list[str]:
    """Sentences on values that cannot be told apart: by how much others would change if a held one were another."""
    return [_exchange(group) for group in registration.groups]


def amount(name: str, value: float, unit: str, error: float | None = None) -> str:
    """A change with its sign and unit, to the digits that an error leaves; shares are in percent."""
    size, shown = (100.0, " %") if name.endswith("_share") else (1.0, unit if unit in ("", "°") else f" {unit}")
    if error is None:
        return f"{size * value:+.3g}{shown}"
    digits = min(max(1 - math.floor(math.log10(max(size * error, 1e-6))), 0), 6)
    return f"{round(size * value, digits) + 0.0:+.{digits}f}{shown}"  # + 0.0: no minus before zero


def _name(estimate: RegisteredValue) -> str:
    vessel = estimate.name.rpartition(".")[0]
    return f"{vessel}: {estimate.words}" if vessel else _WORDS[estimate.name]


def _exchange(group: ConfoundedGroup) -> str:
    held = _WORDS[group.held]
    if not group.exchange:
        return f"{held} is held: the detections say nothing of it"
    one = 0.01 if _UNITS[group.held] == "" else 1.0
    changes = ", ".join(f"{amount(name, one * by, _UNITS[name])} of {_WORDS[name]}" for name, by in group.exchange)
    return f"{held} is held; {amount(group.held, one, _UNITS[group.held])} of it would look like {changes}"


def _interval(estimate: RegisteredValue) -> str:
    if estimate.held or not np.isfinite(estimate.low):
        return ""
    ends = estimate.low, estimate.high
    return " to ".join(amount(estimate.name, end, estimate.unit, estimate.standard_error) for end in ends)


def _values(camera: Camera) -> dict[str, str]:
    """The values of a camera as its scene has them, in degrees, metres and pixels."""
    mount, lens = camera.mount, camera.intrinsics
    angles = {f"{name}_deg": np.degrees(getattr(mount, f"{name}_rad")) for name in ("roll", "pitch", "yaw")}
    return {name: f"{angle:.3f}°" for name, angle in angles.items()} | {
        "height_m": f"{mount.position_m[2]:.3f} m",
        "focal_share": f"{lens.focal_px[0]:,.1f} px",
        "k1": f"{lens.distortion.k1 if lens.distortion else 0:.4f}",
    }


NOT_REGISTERED = "Cameras and clocks were taken as the scene and the log have them: nothing was registered."


@dataclass(frozen=True, eq=False)
class VoyageReport:
    """Report on a voyage besides the detector."""

    voyage: LabelledVoyage
    classification: ClassifiedDetections  # which unmatched detections are of vessels without a transponder
    correction: CorrectedDetector  # what errors of truth were taken off the box errors
    rates: tuple[StateRates, ...]  # of false positives in each state, as bounds and between them
    level: float  # of the intervals of the rates

    @cached_property
    def coverage(self) -> list[Coverage]:
        """Matches and misses of each camera."""
        return sea_coverage.coverages(self.classification.telling, self.voyage.views)

    @cached_property
    def missed(self) -> list[FrameStretch]:
        """Stretches in which vessels were missed."""
        return sea_coverage.missed_stretches(self.voyage, self.classification)

    @cached_property
    def unmatched(self) -> list[FrameStretch]:
        """Detections of nothing known."""
        return sea_coverage.unmatched_stretches(self.voyage, self.classification)


# ---- What `modsim3d learn --json` says of a voyage ----


def voyage_json(report: VoyageReport) -> dict[str, Any]:
    """Registrations, rates of false positives as bounds, box errors less errors of truth, and coverage."""
    return {
        "registration": [_registration_content(fit) for fit in report.voyage.registered],
        "false_positives_per_image": [_rates(rate, report.level) for rate in report.rates],
        "box_errors": [_box_error(component) for component in report.correction.components()],
        "coverage": [
            {
                "camera": coverage.camera,
                "bearings_deg": coverage.bearings_deg.tolist(),
                "ranges_m": coverage.ranges_m.tolist(),
                "matched": coverage.counts()[0].astype(int).tolist(),
                "to_be_detected": coverage.counts()[1].astype(int).tolist(),
            }
            for coverage in report.coverage
        ],
    }


def _registration_content(registered: CameraFit) -> dict[str, Any]:
    solution = registered.registration
    return {
        "camera": solution.camera,
        "log": registered.source,
        "matches": len(solution.sightings),
        "detections": solution.detections,
        "vessels": solution.matched_vessels,
        "residual_before_px": solution.rms_before_px,
        "residual_after_px": solution.rms_after_px,
        "clock_before_s": registered.clock_s,
        "parameters": [
            {"name": entry.name, "unit": entry.unit, "value": entry.value, "low": entry.low, "high": entry.high}
            | {"held": entry.held or None}
            for entry in (*solution.estimates, delay_of(registered), *solution.vessels)
        ],
        "held_by_rule": exchanges(solution),
    }


def _box_error(error: ComponentNoise) -> dict[str, Any]:
    names = ("learned", "from_errors_of_truth", "at_least", "written")
    about = {"state": error.state, "component": error.component, "unit": error.unit}
    return about | dict(zip(names, error.std, strict=True)) | {"upper_bound": error.upper_bound}


def _rates(rates: StateRates, level: float) -> dict[str, Any]:
    def content(column: Column | None) -> dict[str, float] | None:
        return None if column is None else column.content(level, rates.units)

    return {
        "state": rates.state,
        "unmatched": rates.unmatched,
        "like_vessels": content(rates.vessel_share if rates.mixture else None),
        "least": content(rates.lower),
        "by_lifetimes": content(rates.mixture),
        "most": content(rates.upper),
        "in_empty_stretches": content(rates.empty),
        "used": rates.source.value,
    }


# ---- The sections of a voyage on the page of what was learned ----

_DRAWN = 3
_COVERAGE = (
    "Each cell has the share that was matched, and of how many boxes. Vessels without a transponder are in none of "
    "them. Where no vessel passed, nothing is known."
)
_KEY = (
    "Blue: vessels that were matched. Red, dashed: vessels that were missed. Orange: detections of nothing known. The "
    "grey line is the horizon. The circle is about what the title names."
)


def voyage_sections(report: VoyageReport) -> tuple[Block, ...]:
    """All sections."""
    return *_registration(report), *_reference(report), *_coverage(report), *_worst(report)


def _registration(report: VoyageReport) -> Iterator[Block]:
    yield Heading("Registration")
    if not report.voyage.registered:
        yield Text(NOT_REGISTERED)
    for fit in report.voyage.registered:
        yield Text(registration_lead(fit))
        yield registration_table(fit, report.voyage.scene)
        yield Text("Cannot be told apart by these data, so that a rule settles it:")
        yield Items([f"{text[:1].upper()}{text[1:]}.".replace(" -", " −") for text in exchanges(fit.registration)])


def _reference(report: VoyageReport) -> Iterator[Block]:
    yield Heading("What AIS does not see")
    yield Table(_RATES_TITLE, _HEADS, rows_of(report.rates, report.level))
    if rows := report.correction.rows():
        yield Heading("How well the truth is known")
        yield Table(truth_noise.TITLE, truth_noise.HEADER, rows)


def _coverage(report: VoyageReport) -> Iterator[Block]:
    yield Heading("Coverage of the sea")
    for coverage in report.coverage:
        yield Figure(partial(sea_coverage.coverage_drawing, coverage), _COVERAGE)
        yield sea_coverage.range_table(coverage)


def _worst(report: VoyageReport) -> Iterator[Block]:
    yield Heading("The longest without a match")
    for stretches, table_of in (
        (report.missed, sea_coverage.missed_table),
        (report.unmatched, sea_coverage.unmatched_table),
    ):
        yield table_of(stretches)
        if stretches:
            yield Figure(partial(_sketches, report, stretches[:_DRAWN]), _KEY)


def _sketches(report: VoyageReport, stretches: list[FrameStretch]) -> str:
    return "".join(sea_coverage.frame_sketch(report.voyage, report.classification, stretch) for stretch in stretches)
