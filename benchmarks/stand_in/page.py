"""The page docs/stand_in.md, from the results of a comparison alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.stand_in import prose
from benchmarks.stand_in.differences import AGREES, DIFFERS, UNDECIDED
from benchmarks.stand_in.exchange import SCORES as EXCHANGED_SCORES
from benchmarks.stand_in.goals import goals
from benchmarks.stand_in.ladder import draw_ladder
from benchmarks.stand_in.margins import BY_KEY, REASONS, SCORES
from benchmarks.stand_in.measure import BIN_MARGIN, REAL
from benchmarks.stand_in.prose import filled
from benchmarks.stand_in.scores import BINS, RULES
from benchmarks.stand_in.statements import meaning
from benchmarks.stand_in.words import (
    LEVEL_OF_TESTS,
    area,
    cell,
    code,
    distribution_name,
    headline,
    listed,
    plain,
    signed,
    steps,
    surely_not_0,
    top_rung,
)

Results = Mapping[str, Any]
Lines = Iterator[str]
DOCS = Path(__file__).resolve().parents[2] / "docs"
HOTA_MARGIN = BY_KEY["hota"].least


def write_page(results: Results, docs: Path = DOCS) -> None:
    """Write the page and its picture into the folder of the documents."""
    (docs / "stand_in.md").write_text(page(results), encoding="utf-8")
    draw_ladder(results, docs / "stand_in.png")


def page(results: Results) -> str:
    """The page."""
    parts = (
        _opening,
        _goals,
        _ladder,
        _exchanged,
        _scores,
        meaning,
        _order,
        _scatter,
        _distributions,
        _parts_of_films,
        _classifier,
        _missing,
        _limits,
        _how,
    )
    return "\n".join(line for part in parts for line in part(results)) + "\n"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A table in Markdown, with an empty line before and after."""
    return ["", *(f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *rows)), ""]


def _opening(results: Results) -> Lines:
    films, trackers = results["films"], results["trackers"]
    total = {
        key: sum(film[key] for film in films)
        for key in ("vessel_frames", "hidden", "found", "found_hidden", "detections")
    }
    found = {name: results["differences"][top_rung(results)][name]["hota"] for name in trackers}
    yield from ("# Is it a good stand-in?", "", headline(results), "")
    yield filled(
        prose.DONE,
        films=len(films),
        learned=results["learned_from"],
        trackers=_count(len(trackers)),
        clear=(total["found"] - total["found_hidden"]) / max(total["vessel_frames"] - total["hidden"], 1),
        hidden=total["found_hidden"] / max(total["hidden"], 1),
        precision=total["found"] / max(total["detections"], 1),
    )
    verdicts = " ".join(
        _of_hota(verdict, code(names))
        for verdict in (AGREES, DIFFERS, UNDECIDED)
        if (names := [name for name, each in found.items() if each["verdict"] == verdict])
    )
    sure = [name for name, each in found.items() if each["verdict"] == UNDECIDED and surely_not_0(each)]
    if sure:
        verdicts += f" The difference is surely not 0 for {listed(code(sure))}."
    yield from ("", filled(prose.WITHIN, margin=HOTA_MARGIN, verdicts=verdicts), "")


def _count(number: int) -> str:
    words = ("No", "One", "Two", "Three", "Four", "Five", "Six")
    return words[number] if number < len(words) else str(number)


def _of_hota(verdict: str, names: Sequence[str]) -> str:
    """What a verdict on HOTA says of trackers."""
    told: dict[str, str] = {
        AGREES: f"HOTA agrees for {listed(names)}.",
        DIFFERS: f"HOTA differs by more than that for {listed(names)}.",
        UNDECIDED: f"For {listed(names)} these films do not say whether it agrees.",
    }
    return told[verdict]


def _ladder(results: Results) -> Lines:
    yield "![Simulated minus real scores at each rung of the ladder, a panel for each score and tracker](stand_in.png)"
    yield from ("", "## The ladder", "", filled(prose.LADDER))
    trackers, found = results["trackers"], results["differences"]
    yield from table(
        ["", "Learned", *code(trackers)],
        [
            [
                rung["name"],
                f"{'+ ' if at else ''}{rung['title']}",
                *(cell(found[rung["name"]][name]["hota"], 3) for name in trackers),
            ]
            for at, rung in enumerate(results["rungs"])
        ],
    )
    if farther := [str(step) for step in steps(results) if step.after > step.before]:
        yield from (f"HOTA came farther from the real one with {listed(farther)}.", "")


def _scores(results: Results) -> Lines:
    trackers, found = results["trackers"], results["differences"][top_rung(results)]

    def told(each: Results, decimals: int) -> str:
        return f"{plain(each['real'], decimals)}: {cell(each, decimals)}"

    yield from ("## All scores at the last rung", "", filled(prose.SCORES_BEGIN))
    yield from table(
        ["Score", *code(trackers)],
        [[score.title, *(told(found[name][score.key], score.decimals) for name in trackers)] for score in SCORES],
    )


def _order(results: Results) -> Lines:
    yield from ("## Does the ranking of the trackers come out the same?", "", filled(prose.ORDER))
    rows = []
    for rung in results["rungs"]:
        found = results["ranking"][rung["name"]]
        if not found["films"]:
            continue
        orders = [" > ".join(found[name]) for name in ("real", "simulated")]
        numbers = [plain(found["tau"], 2), plain(found["tau_of_seeds"], 2)]
        rows.append([rung["name"], *orders, *numbers, *(f"{found[name]:.0%}" for name in ("same_order", "same_best"))])
    yield from table(["", "Real", "Simulated", "Tau", "Among seeds", "Same order", "Same best"], rows)
    pairs = results["ranking"][top_rung(results)].get("pairs", [])
    if pairs:
        yield filled(prose.PAIRS)
        yield from table(
            ["Better on real detections", "than", "by, real", "by, simulated"],
            [
                [
                    f"`{each['better']}`",
                    f"`{each['worse']}`",
                    *(f"{signed(each[side], 3)} ± {each[f'{side}_half']:.3f}" for side in ("real", "simulated")),
                ]
                for each in pairs
            ],
        )


def _scatter(results: Results) -> Lines:
    yield from ("## Do single films come out as they should?", "", filled(prose.SCATTER))
    trackers, found = results["trackers"], results["differences"]

    def told(each: Results) -> str:
        text = plain(each["scatter"], 1)
        return f"**{text}**" if each["scatter_p"] is not None and each["scatter_p"] < LEVEL_OF_TESTS else text

    yield from table(
        ["", *code(trackers)],
        [[rung["name"], *(told(found[rung["name"]][name]["hota"]) for name in trackers)] for rung in results["rungs"]],
    )


def _distributions(results: Results) -> Lines:
    yield from ("## Lengths and confidence as distributions", "", filled(prose.DISTRIBUTIONS))
    yield from table(
        ["", "Mean, real", "simulated", "Median, real", "simulated", "Distance", "To move", "p"],
        [_distribution(each) for each in results["distributions"][top_rung(results)]],
    )


def _distribution(found: Results) -> list[str]:
    """A line of the table."""
    sides = found["real"], found["simulated"]
    medians = [None if side["quartiles"] is None else side["quartiles"][1] for side in sides]
    numbers = [*(side["mean"] for side in sides), *medians, found["ks"], found["wasserstein"]]
    p = plain(found["adjusted_p"], 3)
    differs = found["adjusted_p"] is not None and found["adjusted_p"] < LEVEL_OF_TESTS
    return [distribution_name(found), *(plain(number, 2) for number in numbers), f"**{p}**" if differs else p]


def _parts_of_films(results: Results) -> Lines:
    trackers, top = results["trackers"], top_rung(results)
    bins, groups = results["bins"][top], results["groups"][top]
    yield from ("## By occlusion, range and weather", "", filled(prose.BINS_BEGIN, margin=BIN_MARGIN))
    yield from table(
        ["Vessel-frames", *code(trackers)],
        [[title, *(cell(bins[name][key]["recall"], 3) for name in trackers)] for key, title in BINS],
    )
    yield filled(prose.GROUPS, margin=HOTA_MARGIN, share=results["hidden_share_of_groups"])
    yield from table(
        ["Films", "Number", *code(trackers)],
        [
            [name, str(first["films"]), *(cell(groups[tracker][name], 3) for tracker in trackers)]
            for name, first in groups[trackers[0]].items()
        ],
    )


def _goals(results: Results) -> Lines:
    """The goals that were fixed before these films were made."""
    settled = prose.JUDGED if results["judged"] else prose.DEVELOPED
    said = filled(settled, films=len(results["films"]), learned=results["learned_from"])
    yield from ("## Goals", "", f"{said} {filled(prose.GOALS)}")
    rows = [
        [f"`{tracker}`", goal.title, goal.limit, goal.found, goal.verdict]
        for tracker in results["trackers"]
        for goal in goals(results, tracker)
    ]
    yield from table(["Tracker", "Simulated minus real", "Within", "Found", "Goal"], rows)


def _exchanged(results: Results) -> Lines:
    """Which part of the output the gap comes from."""
    yield from ("## Which part the gap comes from", "", filled(prose.EXCHANGED))
    decimals = {key: BY_KEY[key].decimals for key in EXCHANGED_SCORES}
    for into, title in (("simulated", "Simulated detections, with real"), (REAL, "Real detections, with simulated")):
        rows = [
            [
                " and ".join(each["parts"]) or "nothing",
                *(
                    ", ".join(signed(found[key]["mean"], decimals[key]) for key in EXCHANGED_SCORES)
                    for found in each["trackers"].values()
                ),
            ]
            for each in results["exchanged"]
            if each["into"] == into
        ]
        yield from table([title, *code(results["trackers"])], rows)
    yield from (" ".join(_closed(results, tracker) for tracker in results["trackers"]), "")


def _closed(results: Results, tracker: str) -> str:
    """The single part whose exchange brings the simulated HOTA nearest to the real one."""
    gaps = {
        " and ".join(each["parts"]): each["trackers"][tracker]["hota"]["mean"]
        for each in results["exchanged"]
        if each["into"] != REAL and len(each["parts"]) < 2
    }
    usual, best = gaps[""], min(gaps, key=lambda part: abs(gaps[part]))
    what = f"goes to {signed(gaps[best], 3)} with real {best}" if best else "is nearest to 0 as it is"
    return f"For `{tracker}` the gap of HOTA of {signed(usual, 3)} {what}."


def _classifier(results: Results) -> Lines:
    told = results.get("told_apart")
    if not told:
        return
    titles = {rung["name"]: [rung["name"], rung["title"]] for rung in results["rungs"]}
    yield from ("## Can a classifier tell them apart?", "", filled(prose.CLASSIFIER))
    yield from table(
        ["", "Learned", "Frames", "told by", "Tracks", "told by"],
        [
            [
                *titles.get(name, ("", prose.SEEDS_APART)),
                *(text for kind in ("frames", "tracks") for text in area(each.get(kind))),
            ]
            for name, each in told.items()
        ],
    )


def _missing(_: Results) -> Lines:
    yield from ("## What the models lack", "", "Seen in the real detections, and not simulated, the largest first:", "")
    yield from (f"- {filled(text)}" for text in prose.MISSING)
    yield ""


def _limits(results: Results) -> Lines:
    counts = sorted({film["frames"] for film in results["films"]})
    frames = " to ".join(dict.fromkeys(str(count) for count in (counts[0], counts[-1])))
    yield from ("## Limits", "")
    yield from (f"- {filled(text, frames=frames, least=RULES.similarity.least)}" for text in prose.LIMITS)
    yield ""


def _how(results: Results) -> Lines:
    tracker, films = results["trackers"][0], results["films"]
    yield from ("## How it was measured", "")
    yield filled(
        prose.METHOD,
        films=len(films),
        seeds=results["seeds"],
        threshold=results["threshold"],
        split=_split(tracker, results["differences"][top_rung(results)][tracker]["hota"]),
    ).strip()
    yield from ("", filled(prose.MARGINS))
    yield from table(["Score", "Margin", "Why"], REASONS)
    yield filled(prose.TESTS)
    yield from table(
        ["Film", "Place", "Weather", "Vessel-frames", "Under half visible", "Detected"],
        [
            [
                *(str(film[name]) for name in ("name", "place", "weather", "vessel_frames")),
                *(f"{film[name] / max(film['vessel_frames'], 1):.0%}" for name in ("hidden", "found")),
            ]
            for film in films
        ],
    )
    if detector := results.get("detector"):
        yield f"The detector is {detector['name']} from {detector['source']}; its weights have the SHA-256"
        yield f"`{detector['sha256']}`."
    yield "With " + ", ".join(f"{name} {number}" for name, number in results["versions"].items()) + "."


def _split(tracker: str, found: Results) -> str:
    if found["within"] is None or found["between"] is None:
        return ""
    return filled(prose.SPLIT, tracker=tracker, within=found["within"], between=found["between"])
