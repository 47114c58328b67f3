"""Numbers and verdicts of a comparison in words, for the page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from benchmarks.stand_in.differences import AGREES, DIFFERS
from benchmarks.stand_in.margins import Score

MARKS = {AGREES: "✓", DIFFERS: "✗"}
NOTABLE = 0.005
"""The mean gap of HOTA must shrink by so much for a rung to be named as a cause: a quarter of its margin."""
Numbers = Mapping[str, Any]


def signed(value: float, decimals: int) -> str:
    """A difference with its sign; no sign where it rounds to 0."""
    text = f"{abs(value):,.{decimals}f}"
    if not float(text.replace(",", "")):
        return text
    return ("+" if value > 0 else "−") + text


def plain(value: float | None, decimals: int) -> str:
    """A value; a dash where there is none."""
    return "–" if value is None else f"{value:,.{decimals}f}".replace("-", "−")


def interval(found: Numbers, decimals: int) -> str:
    """A difference with its interval."""
    if found["low"] is None:
        return "–"
    return f"{signed(found['mean'], decimals)} ({signed(found['low'], decimals)} to {signed(found['high'], decimals)})"


def cell(found: Numbers, decimals: int) -> str:
    """The same with the mark of its verdict, as a table has it."""
    if found["low"] is None:
        return "–"
    return f"{interval(found, decimals)} {MARKS.get(found['verdict'], '?')}"


def listed(names: Sequence[str], last: str = "and") -> str:
    """Names as a sentence has them."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {last} {names[-1]}"


def farthest(found: Sequence[Numbers]) -> float | None:
    """The largest difference that the intervals allow; None if any has no interval."""
    if any(each["low"] is None for each in found):
        return None
    return float(max(max(abs(each["low"]), abs(each["high"])) for each in found))


def upwards(value: float, decimals: int = 3) -> str:
    """A bound, rounded so that it still is one."""
    return f"{math.ceil(value * 10**decimals - 1e-9) / 10**decimals:.{decimals}f}"


def gaps(results: Numbers, key: str = "hota") -> list[float]:
    """Mean over trackers of the size of the mean difference of a score, at each rung."""
    found = [
        [
            abs(each[key]["mean"])
            for each in results["differences"][rung["name"]].values()
            if each[key]["mean"] is not None
        ]
        for rung in results["rungs"]
    ]
    return [sum(each) / len(each) if each else math.nan for each in found]


def causes(results: Numbers) -> list[str]:
    """The rungs that brought HOTA closer, the most effective first, each with the gap before and after."""
    sizes, titles = gaps(results), [rung["title"] for rung in results["rungs"]]
    steps = [(before - after, at) for at, (before, after) in enumerate(pairwise(sizes), 1)]
    return [
        f"*{titles[at]}* (mean gap {sizes[at - 1]:.3f} before, {sizes[at]:.3f} after)"
        for shrunk, at in sorted(steps, key=lambda step: -step[0])
        if shrunk > NOTABLE
    ]


def headline(results: Numbers) -> str:
    """The sentence that the page begins with."""
    top = results["rungs"][-1]["name"]
    found = [each["hota"] for each in results["differences"][top].values()]
    bound, models = farthest(found), causes(results)
    if bound is None:
        return "On this detector, there are too few films to say how far HOTA from simulation lies from the real one."
    why = f"because of {listed(models)}" if models else "no model beyond the plainest brought it closer"
    sentence = f"On this detector, HOTA from simulation was within {upwards(bound)} of the real one"
    return f"{sentence}, {why}, and here is the evidence."


def kinder(score: Score, found: Numbers) -> str:
    """What a difference means: whether a tracker looks better or worse on simulated detections."""
    if score.larger_is_better is None:
        return "more or longer ones in simulation" if found["mean"] > 0 else "fewer or shorter ones in simulation"
    better = (found["mean"] > 0) == score.larger_is_better
    return "simulation flatters the tracker" if better else "simulation is harder than the real detector"


MANY_FILMS = 500
"""More films than this are not counted."""


def films_in_words(found: Numbers) -> str:
    """About how many films would show agreement if the mean stayed, or why none would."""
    if found["low"] is None:
        return "defined in too few films"
    needed = films_needed(found)
    if needed is None:
        return "outside"
    return f"over {MANY_FILMS}" if needed > MANY_FILMS else f"{needed}"


def films_needed(found: Numbers) -> int | None:
    """About so many films would show agreement if the mean stayed; None where it lies outside the margin."""
    if found["low"] is None or abs(found["mean"]) >= found["margin"]:
        return None
    half = found["high"] - found["mean"]
    return math.ceil(float(found["films"] * (half / (found["margin"] - abs(found["mean"]))) ** 2))
