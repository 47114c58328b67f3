"""Report on detections without a transponder: a table with a row for each state, and sentences."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from modsim3d.core.text import counted
from modsim3d.formats.labelled import LabelledSet
from modsim3d.formats.matching import match
from modsim3d.learn.bootstrap import Column
from modsim3d.learn.learn_detector import LearnOptions, learn_detector
from modsim3d.learn.learned import LearnSettings
from modsim3d.learn.matches import Observed
from modsim3d.learn.report import LearnReport
from modsim3d.learn.states import each_its_own, parse_states
from modsim3d.learn.voyage.non_ais.classification import ClassifiedDetections, classify_unmatched
from modsim3d.learn.voyage.non_ais.rates import RateSource, StateRates, TimeSpan
from modsim3d.learn.voyage.non_ais.tracklets import MIN_RATIO, MIN_S, Behaviour

TITLE = "False positives in an image, where not everything that floats has a transponder"
HEADER = ("state", "images", "unmatched", "like vessels", "least", "by lifetimes", "most", "in empty stretches", "used")


def rows_of(rates: Sequence[StateRates], level: float) -> list[tuple[str, ...]]:
    """The rows of the table, with intervals of a level."""
    return [
        (
            each.state,
            f"{each.images:,}",
            f"{each.unmatched:,}",
            _share(each.vessel_share, level, each.units) if each.mixture else "none",
            *(_rate(column, level, each.units) for column in (each.lower, each.mixture, each.upper, each.empty)),
            each.source.value,
        )
        for each in rates
    ]


def sentences(judged: ClassifiedDetections, rates: Sequence[StateRates]) -> Iterator[str]:
    """Sentences beside the table: vessels, what was not taken for one and why, and what cannot be known."""
    things, least = judged.things, f"{judged.least_s:g} s"
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
            f"{vessels:,} of {len(things.detections):,} unmatched things are taken for vessels without a transponder: "
            f"they last {_seconds(judged.kinds.long_s[0])} on average, and flicker that stays "
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
    lasting = things.lasted_s >= judged.least_s
    for behaviour in Behaviour:
        count = int(np.count_nonzero(lasting & (things.behaviour == behaviour)))
        if count and behaviour is not Behaviour.LIKE_A_VESSEL:
            number = "1 thing that lasts counts" if count == 1 else f"{count:,} things that last count"
            but = ", but not in the least rate" if behaviour in (Behaviour.JUMPS, Behaviour.CHANGES_SIZE) else ""
            yield f"{number} as false{but}: {behaviour.in_words}"
    for source in RateSource:
        states = [each.state for each in rates if each.source is source]
        if states and (judged.kinds.found or judged.stretches):
            where = f" in {', '.join(states)}" if len(states) < len(rates) else ""
            yield f"the rate of false positives{where} is that of {source.value}"


def _seconds(time_s: float) -> str:
    return f"{time_s:,.0f} s" if time_s >= 100 else f"{time_s:.3g} s"


def _rate(column: Column | None, level: float, units: int) -> str:
    if column is None:
        return "–"
    low, high = column.interval(level, units)
    return f"{float(column.estimate):.3g} ({float(low):.2g} to {float(high):.2g})"


def _share(column: Column, level: float, units: int) -> str:
    low, high = column.interval(level, units)
    return f"{float(column.estimate):.0%} ({float(low):.0%} to {float(high):.0%})"


# ---- Learning from a voyage on ----


def learn_beside_unseen(
    labelled: LabelledSet,
    settings: LearnSettings,
    options: LearnOptions,
    stretches: tuple[TimeSpan, ...] = (),
    least_s: float = MIN_S,
) -> tuple[LearnReport, ClassifiedDetections]:
    """Learn a detector from a set whose annotations are vessels with a transponder; detections that behave like a
    vessel which is not annotated are neither hits nor false. In the stretches, on the clock of the images, nothing
    floats but what is annotated; `least_s` is the least mean lifetime of what lasts as vessels do. The report has the
    rates of false positives of the classified detections, and says which these are. Raises ModsimError as
    `learn_detector`; also if no frame lies in a stretch that is marked as empty."""
    conditions = labelled.conditions
    states = parse_states(options.states, conditions) if options.states else each_its_own(conditions)
    image_state = states.of_images(labelled.images, conditions)
    matched = match(labelled, settings.rule, settings.threshold)
    observed = Observed(labelled, matched, states.names, image_state, settings.threshold, settings.without)
    judged = classify_unmatched(observed, stretches, least_s)
    report = learn_detector(judged.labelled, settings, options)
    learned = report.learned
    rates = judged.rates(learned.resampling, learned.observed.image_state, learned.observed.states)
    remarks = (*report.remarks_on_data, *sentences(judged, rates))
    return replace(report, learned=judged.corrected(learned), remarks_on_data=remarks), judged
