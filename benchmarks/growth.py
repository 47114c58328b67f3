"""How the time per vessel and frame grows with the number of vessels."""

from __future__ import annotations

import statistics
from dataclasses import dataclass
from typing import Any

from benchmarks import scenes
from benchmarks.measured import Bench, Found, Row, profile_of_run, significant, spread, table
from benchmarks.processes import Answer, child

COUNTS = (25, 50, 100, 200)
MAKERS = {"small": scenes.small, "dense": scenes.dense}
TITLES = {"small": "boats far apart", "dense": "ships before ships"}
HEAD = ("vessels", "µs per vessel and frame", "frames/s", "overlapping", "hidden", "wholly hidden", "× the limit")


@dataclass(frozen=True)
class Case:
    """A scene with a number of vessels, and what was measured of it.

    Attributes:
        given: What the timed process is given.
        count: Number of vessels.
        seconds: Time per vessel and frame of each round.
        shares: How many vessels overlap and hide each other.
        limit: The time over the time that memory needs, as text.
    """

    given: dict[str, Any]
    count: int
    seconds: list[float]
    shares: Answer
    limit: str

    @property
    def cells(self) -> list[str]:
        """Its row of the table."""
        return [
            str(self.count),
            spread([1e6 * value for value in self.seconds]),
            significant(1 / statistics.median(self.seconds) / self.count),
            *(f"{self.shares[share]:.1%}" for share in ("overlapping", "hidden", "wholly_hidden")),
            self.limit,
        ]


def growth(bench: Bench) -> Found:
    """Time per boat and frame as the number of boats grows; for the dense scene too."""
    cases = _measured(bench)
    small = cases["small"]
    grown = [max(seconds[1:]) / seconds[0] for seconds in zip(*(case.seconds for case in small), strict=True)]
    met = statistics.median(grown) <= 1.1
    row = Row(
        f"`small` with {', '.join(map(str, COUNTS))} boats: time per boat, the greatest against that with {COUNTS[0]}",
        "≤ +10 %",
        _percent(grown),
        met,
        "; ".join(case.limit for case in small),
    )
    found = Found([row])
    for kind, title in TITLES.items():
        rows = [case.cells for case in cases[kind]]
        found.sections.append(f"## More vessels: `{kind}`, {title}\n\n" + table(HEAD, rows))
    if not met:
        found.profiles += [
            profile_of_run(f"small with {case.count} boats, {case.given['steps']} frames", **case.given)
            for case in (small[0], small[-1])
        ]
    return found


def _measured(bench: Bench) -> dict[str, list[Case]]:
    """The cases of each kind of scene, measured in turn."""
    steps = {"small": bench.steps(scenes.SMALL_STEPS), "dense": bench.steps(100)}
    given = {
        (kind, count): {"scene": bench.scene(f"{kind}{count}", make(count)), "steps": steps[kind], "warm": True}
        for kind, make in MAKERS.items()
        for count in COUNTS
    }
    answers: dict[tuple[str, int], list[Answer]] = {key: [] for key in given}
    for _ in bench.rounds():
        for key, arguments in given.items():
            answers[key].append(child("run", **arguments))
    return {
        kind: [_case(bench, given[kind, count], count, answers[kind, count]) for count in COUNTS] for kind in MAKERS
    }


def _case(bench: Bench, given: dict[str, Any], count: int, answers: list[Answer]) -> Case:
    seconds = [answer["seconds"] / answer["frames"] / count for answer in answers]
    limit = bench.times_limit(statistics.median(answer["seconds"] for answer in answers), answers[0]["drawn_bytes"])
    return Case(given, count, seconds, child("shares", scene=given["scene"]), limit)


def _percent(ratios: list[float]) -> str:
    """Ratios as growth: their median, and least to greatest."""
    percent = [100 * (ratio - 1) for ratio in ratios]
    rounds = f"{min(percent):+.0f} to {max(percent):+.0f}" if len(percent) > 1 else "one round"
    return f"{statistics.median(percent):+.0f} % ({rounds})"
