"""Numbers and verdicts of a comparison in words, for the page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.stand_in.differences import AGREES, DIFFERS
from benchmarks.stand_in.distributions import TITLES
from benchmarks.stand_in.margins import BY_KEY, Score

MARKS = {AGREES: "✓", DIFFERS: "✗"}
NOTABLE = 0.005
"""The mean gap of HOTA must change by so much for a rung to be named: a quarter of its margin."""
LEVEL_OF_TESTS = 0.05
_DRAWS, _SEED, _SURE = 2000, 22, 0.975
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


@dataclass(frozen=True)
class Step:
    """What a rung changes in the mean gap: the mean over trackers of the size of the mean difference of HOTA.

    Attributes:
        title: What the rung adds.
        before: The mean gap at the rung before.
        after: At this rung.
        sure: Whether it surely changes: films drawn with replacement give the same sign in 97.5 % of draws.
    """

    title: str
    before: float
    after: float
    sure: bool

    def __str__(self) -> str:
        return f"*{self.title}* (mean gap {self.before:.3f} before, {self.after:.3f} after)"


def steps(results: Numbers) -> list[Step]:
    """The rungs that surely and notably change the mean gap of HOTA, the most effective first."""
    names = [rung["name"] for rung in results["rungs"]]
    apart = np.array(
        [
            [np.subtract(*(np.array(scores["hota"][side], dtype=float) for side in (name, "real"))) for name in names]
            for scores in results["scores"].values()
        ]
    )  # of each tracker: rungs, films
    apart = apart[:, :, ~np.isnan(apart).any(axis=(0, 1))]
    films = apart.shape[2]
    if not films:
        return []
    drawn = np.random.default_rng(_SEED).integers(films, size=(_DRAWS, films))
    gaps, draws = np.abs(apart.mean(axis=2)).mean(axis=0), np.abs(apart[:, :, drawn].mean(axis=3)).mean(axis=0)
    found = []
    for at in range(1, len(names)):
        grows = float(np.mean(draws[at] > draws[at - 1])), float(np.mean(draws[at] < draws[at - 1]))
        sure = max(grows) >= _SURE
        found.append(Step(results["rungs"][at]["title"], float(gaps[at - 1]), float(gaps[at]), sure))
    notable = [step for step in found if step.sure and abs(step.before - step.after) > NOTABLE]
    return sorted(notable, key=lambda step: -abs(step.before - step.after))


def headline(results: Numbers) -> str:
    """The sentence that the page begins with, and one on what brought it about."""
    found = {name: each["hota"] for name, each in results["differences"][top_rung(results)].items()}
    if any(each["low"] is None for each in found.values()):
        return "There are too few films to say how far HOTA from simulation lies from the real one."
    films, margin = max(each["films"] for each in found.values()), BY_KEY["hota"].least
    gaps = listed([f"{signed(e['mean'], 3)} ± {e['high'] - e['mean']:.3f} for `{name}`" for name, e in found.items()])
    shown = [name for name, each in found.items() if each["verdict"] == AGREES]
    others = [name for name in found if name not in shown]
    said = [f"shown for {listed(code(shown))}"] if shown else []
    said += [f"not shown for {listed(code(others))}"] if others else []
    models = [str(step) for step in steps(results) if step.after < step.before]
    why = f"What brought it closer: {listed(models)}." if models else "No model surely brought it closer."
    return (
        f"Mean HOTA gap over {films} films, simulated minus real: {gaps}; agreement within {margin:g} is "
        f"{listed(said)}. {why}"
    )


def kinder(score: Score, found: Numbers) -> str:
    """What a difference means: whether a tracker looks better or worse on simulated detections."""
    if score.larger_is_better is None:
        return "more or longer ones in simulation" if found["mean"] > 0 else "fewer or shorter ones in simulation"
    better = (found["mean"] > 0) == score.larger_is_better
    return "simulation flatters the tracker" if better else "simulation is harder than the real detector"


def surely_not_0(found: Numbers) -> bool:
    """Whether the interval of a difference leaves 0 out."""
    return found["low"] is not None and not found["low"] <= 0 <= found["high"]


MANY_FILMS = 500
"""More films than this are not counted."""


def films_in_words(found: Numbers) -> str:
    """About how many films would show agreement if the mean stayed, or why none would."""
    if found["low"] is None:
        return "defined in too few films"
    needed = films_needed(found)
    if needed is None:
        return "outside, and surely not 0" if surely_not_0(found) else "outside"
    return f"over {MANY_FILMS}" if needed > MANY_FILMS else f"{needed}"


def films_needed(found: Numbers) -> int | None:
    """About so many films would show agreement if the mean stayed; None where it lies outside the margin."""
    if found["low"] is None or abs(found["mean"]) >= found["margin"]:
        return None
    half = found["high"] - found["mean"]
    return math.ceil(float(found["films"] * (half / (found["margin"] - abs(found["mean"]))) ** 2))


def top_rung(results: Numbers) -> str:
    """Name of the last rung."""
    return str(results["rungs"][-1]["name"])


def code(names: Sequence[str]) -> list[str]:
    return [f"`{name}`" for name in names]


def area(found: Numbers | None) -> tuple[str, str]:
    """An area with its interval, and the groups of features that reach most alone.

    The check of seeds has no interval; the areas of its seeds stand in its place.
    """
    if not found:
        return "–", "–"
    if "aucs" in found:
        return f"{found['auc']:.2f} (seeds: {min(found['aucs']):.2f} to {max(found['aucs']):.2f})", "–"
    groups = sorted(found.get("groups", {}).items(), key=lambda each: -each[1]["alone"])[:2]
    by = ", ".join(f"{name} ({each['alone']:.2f})" for name, each in groups) or "–"
    return f"{found['auc']:.2f} ({found['low']:.2f} to {found['high']:.2f})", by


def distribution_name(found: Numbers) -> str:
    return TITLES[found["name"]] + ("" if found["tracker"] is None else f", `{found['tracker']}`")
