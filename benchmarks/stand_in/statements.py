"""What a comparison means for someone who certifies: the section of the page with the statements that hold."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from benchmarks.stand_in import prose
from benchmarks.stand_in.differences import AGREES, DIFFERS, LEVEL, UNDECIDED
from benchmarks.stand_in.distributions import holm
from benchmarks.stand_in.margins import SCORES, Score
from benchmarks.stand_in.prose import filled
from benchmarks.stand_in.scores import BINS
from benchmarks.stand_in.words import (
    LEVEL_OF_TESTS,
    area,
    code,
    distribution_name,
    films_in_words,
    interval,
    kinder,
    listed,
    plain,
    top_rung,
)

Results = Mapping[str, Any]
Lines = Iterator[str]
AGREEMENT_LEVEL = (1 - LEVEL) / 2
"""Of each of the two one-sided tests."""


def meaning(results: Results) -> Lines:
    yield from ("## What it means for someone who certifies", "")
    found = results["differences"][top_rung(results)]
    told = {AGREES: (prose.HOLD, _holds), DIFFERS: (prose.HOLD_NOT, _holds_not), UNDECIDED: (prose.OPEN, _open)}
    for verdict, (introduction, line) in told.items():
        lines = []
        for score in SCORES:
            each = {name: by_score[score.key] for name, by_score in found.items()}
            if chosen := {name: one for name, one in each.items() if one["verdict"] == verdict}:
                lines.append(f"- {score.title} {line(score, chosen)}")
        if lines:
            yield from (filled(introduction), "", *lines, "")
    yield from (prose.BESIDE, "", *_other_statements(results), "", filled(prose.USE), "")


def _holds(score: Score, found: Mapping[str, Results]) -> str:
    told = [
        f"`{name}` ({plain(each['real'], score.decimals)} ± {plain(each['margin'], score.decimals)})"
        for name, each in found.items()
    ]
    return f"of {listed(told)}"


def _holds_not(score: Score, found: Mapping[str, Results]) -> str:
    by_meaning: dict[str, list[str]] = {}
    for name, each in found.items():
        by_meaning.setdefault(kinder(score, each), []).append(f"`{name}` {interval(each, score.decimals)}")
    return "of " + "; ".join(f"{', '.join(each)}: {meaning}" for meaning, each in by_meaning.items())


def _open(score: Score, found: Mapping[str, Results]) -> str:
    return "of " + ", ".join(f"`{name}` ({films_in_words(each)})" for name, each in found.items())


def _other_statements(results: Results) -> Lines:
    """What the comparison says beside the scores."""
    top = top_rung(results)
    tests = [each["p_value"] for scores in results["differences"][top].values() for each in scores.values()]
    agree = sum(p is not None and p <= AGREEMENT_LEVEL for p in tests)
    if agree:
        kept = sum(p is not None and p <= AGREEMENT_LEVEL for p in holm(tests))
        yield f"- Of the {agree} values that hold, {kept} do with tests adjusted for their number (Holm's method)."
    order = results["ranking"][top]
    if order["films"]:
        best = [order[name][0] for name in ("real", "simulated")]
        same = (
            f"is the same, `{best[0]}`," if best[0] == best[1] else f"is `{best[1]}` in place of `{best[0]}`, the same"
        )
        yield f"- The best tracker by HOTA {same} in {order['same_best']:.0%} of draws of films."
    for kind, each in results.get("told_apart", {}).get(top, {}).items():
        yield f"- A classifier that is to tell {kind} apart reaches an area of {area(each)[0]}: 0.5 is guessing."
    found = [each for each in results["distributions"][top] if each["adjusted_p"] is not None]
    differ = [distribution_name(each) for each in found if each["adjusted_p"] < LEVEL_OF_TESTS]
    named = f"{len(differ)} differ: {'; '.join(differ)}" if differ else "none was found to differ"
    yield f"- Of {len(found)} distributions, {named}."
    for key, title in BINS:
        recall = {name: each[key]["recall"]["verdict"] for name, each in results["bins"][top].items()}
        told = [
            f"{word} for {listed(code(names))}"
            for verdict, word in ((AGREES, "agrees"), (DIFFERS, "differs"), (UNDECIDED, "is open"))
            if (names := [name for name, each in recall.items() if each == verdict])
        ]
        yield f"- Share followed, {title}: {', '.join(told)}."
