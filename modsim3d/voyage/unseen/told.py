"""What is said of detections without a transponder: a table with a row for each state, and sentences."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from modsim3d.display import counted
from modsim3d.learn.numbers.resampling import Column
from modsim3d.voyage.unseen.judged import Judged
from modsim3d.voyage.unseen.lifetimes import LEAST_RATIO
from modsim3d.voyage.unseen.rates import RateSource, StateRates
from modsim3d.voyage.unseen.things import Behaviour

TITLE = "False positives in an image, where not everything that floats has a transponder"
HEADER = (
    "state",
    "images",
    "unmatched",
    "like vessels",
    "least",
    "by lifetimes",
    "most",
    "in empty stretches",
    "used",
)


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


def sentences(judged: Judged, rates: Sequence[StateRates]) -> Iterator[str]:
    """What the table does not say: what was taken for a vessel, what was not and why, and what cannot be known."""
    things, least = judged.things, f"{judged.least_s:g} s"
    if not np.isfinite(judged.links.time_s).any() and len(judged.links.rows):
        yield "the frames have no times, so no detection can be followed: all unmatched detections count as false"
        return
    if not judged.kinds.found:
        yield (
            f"no unmatched detections last as vessels do ({least} on average at least): all of them count as false "
            "positives"
        )
        if longer := int(np.count_nonzero(judged.kinds.longer[judged.kinds.of_thing])):
            yield (
                f"the rate of false positives may be an upper bound: {counted(longer, 'thing', 'things')} seen for "
                f"longer than {judged.least_s / LEAST_RATIO:g} s may be vessels, and the frames do not tell"
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
            f"false positives are taken to last {judged.least_s / LEAST_RATIO:g} s on average at most; a buoy and a "
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
