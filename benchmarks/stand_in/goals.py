"""How near simulated scores are to come to the real ones: fixed before the judged films were made."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from benchmarks.stand_in.differences import AGREES, DIFFERS, verdict
from benchmarks.stand_in.margins import BY_KEY
from benchmarks.stand_in.words import interval, signed, top_rung

Results = Mapping[str, Any]
HOTA_GAP, ASSA_GAP, PLACE_GAP, SWITCHES, CORRELATION = 0.02, 0.04, 0.05, 0.2, 0.05
"""Of the mean HOTA and AssA, HOTA of one place, ID switches as a share of the real ones, and of correlations."""
WORDS = {AGREES: "reached", DIFFERS: "missed"}


@dataclass(frozen=True)
class Goal:
    """A goal for a tracker, and what was found.

    Attributes:
        title: What it is about.
        limit: How far simulated and real may lie apart, in words.
        found: The difference, with its interval where it has one.
        verdict: `reached` if the whole interval lies within the limit, `missed` if it lies outside, else where the mean
            is.
    """

    title: str
    limit: str
    found: str
    verdict: str


def goals(results: Results, tracker: str) -> Iterator[Goal]:
    """The goals for a tracker at the last rung."""
    top = top_rung(results)
    scores = results["differences"][top][tracker]
    for key, limit in (("hota", HOTA_GAP), ("assa", ASSA_GAP)):
        yield _of_difference(f"mean {BY_KEY[key].title}", scores[key], limit, f"{limit:g}", BY_KEY[key].decimals)
    switches = scores["id_switches"]
    yield _of_difference("ID switches of a film", switches, SWITCHES * (switches["real"] or 0.0), f"{SWITCHES:.0%}", 2)
    for name, each in results["groups"][top][tracker].items():
        if name.startswith("place: "):
            title = f"mean HOTA, {name.removeprefix('place: ')}"
            yield _of_difference(title, each, PLACE_GAP, f"{PLACE_GAP:g}", BY_KEY["hota"].decimals)
    alike = results["film_correlation"][top][tracker]
    if alike["real"] is not None and alike["seeds"] is not None:
        apart = alike["real"] - alike["seeds"]
        said = "reached" if abs(apart) <= CORRELATION else "missed"
        found = f"{signed(apart, 2)} ({alike['real']:.2f}; among seeds {alike['seeds']:.2f})"
        yield Goal("correlation of films' HOTA", f"{CORRELATION:g}", found, said)


def _of_difference(title: str, found: Results, limit: float, said: str, decimals: int) -> Goal:
    if found["low"] is None:
        return Goal(title, said, "–", "too few films")
    word = WORDS.get(verdict(found["low"], found["high"], limit))
    inside = "not shown; the mean lies inside" if abs(found["mean"]) <= limit else "not shown; the mean lies outside"
    return Goal(title, said, interval(found, decimals), word or inside)
