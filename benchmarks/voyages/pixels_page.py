"""What the page says of the detector that looks at pixels."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from benchmarks.voyages.causes import NUMBERS, Truth
from benchmarks.voyages.pixels import NEAR_AIS, VARIANTS
from benchmarks.voyages.wrong_camera import WRONG

WORDS = (
    "The films of [stand_in](../stand_in.md), in which a detector that was trained on photographs looks at pictures of "
    "this program. Of the first films of each place in clear weather from ashore, the detector is learned by full "
    "truth, and by AIS through the same wrong camera and clock as above. The vessels are near, so AIS means less here: "
    f"{NEAR_AIS.position_m:g} m, delays of {NEAR_AIS.delay_s:g} s. Films last half a minute. Values are means over the "
    "films; of the films it is counted in how many the value by AIS lies within the interval of full truth, and in how "
    "many both intervals overlap. A value that is said to be an upper bound need only be above that of full truth; "
    "in how many films it is said is given too.\n\n"
    "False positives differ by the vessels without a transponder: with transponders on all, they are those of full "
    "truth. A film of half a minute hardly tells such vessels from false positives, since only things that last 30 s "
    "on average are taken for vessels."
)
CAUSES = (
    "Box errors by AIS are smaller than by full truth, since boxes of partly hidden vessels [tell nothing of them]"
    "(../voyage.md#how-well-the-truth-is-known) where positions are not surely known. A detector that looks at pixels "
    "is worse at such vessels; the errors of a detector that modsim3d simulates do not depend on what is hidden. The "
    "following tables tell film by film why box errors differ. Each cell has the standard deviations of errors in x "
    "and in width, in pixels, and how long box errors persist, in seconds. From column to column one cause is added."
)
_TITLE = {"all": "Transponders on all", "some": "Transponders on four fifths"}
_SOME_WORDS = (
    "The vessels with transponders alone, with their own detections, are the sample of vessels. Then the detections "
    "of the others are there, too: some match a vessel with a transponder that is beside them. By true tracks, vessels "
    "without a transponder hide nothing. Then boxes that are partly hidden are left out. AIS adds errors of positions, "
    "registration those of the camera and of the clock. Matches of others counts the detections that match a vessel "
    "with a transponder and by full truth are of one without."
)


def pixels_section(found: dict[str, Any]) -> list[str]:
    """In how many films AIS teaches what full truth does, and by what box errors differ."""
    names = dict.fromkeys(name for variant in VARIANTS for name in found[variant])
    lines = ["## A detector that looks at pixels", "", WORDS, "",
             "| number | full truth | by AIS, all have transponders | films | by AIS, four fifths have | films |",
             "|---|---|---|---|---|---|"]  # fmt: skip
    for name in names:
        scores = [found[variant].get(name) for variant in VARIANTS]
        full = next(_short(score["full"]) for score in scores if score)
        cells = [f"{_short(score['ais'])} | {_films(score)}" if score else "– | –" for score in scores]
        lines.append(f"| `{name}` | {full} | {' | '.join(cells)} |")
    lines += [""]
    for film, reason in found["refused"].items():
        lines += [f"Refused, {film}: {reason}", ""]
    return [*lines, *_causes(found)]


def _films(score: dict[str, float]) -> str:
    bounds = f"; upper bound in {score['bounds']}" if score["bounds"] else ""
    return f"{score['inside']}, {score['overlap']} of {score['films']}{bounds}"


def _causes(found: dict[str, Any]) -> Iterator[str]:
    yield from (f"**{_TITLE['all']}**", "", CAUSES, "")
    yield from _table(found, "all", (Truth.FULL, Truth.IN_VIEW, Truth.REPORTS))
    yield from ("", f"**{_TITLE['some']}**", "", _SOME_WORDS, "")
    yield from _table(found, "some", tuple(Truth))
    yield from ("", _conclusion(found), "")


def _table(found: dict[str, Any], variant: str, truths: tuple[Truth, ...]) -> Iterator[str]:
    counts, registered = variant == "some", found["registered"][variant]
    heads = ["film", *truths, "AIS, registered", "clock off", *(["matches of others"] if counts else [])]
    yield f"| {' | '.join(heads)} |"
    yield "|---" * len(heads) + "|"
    for film, causes in found["causes"].items():
        cells = [film, *(_values(causes[variant][truth.name]) for truth in truths)]
        cells += [_values(registered[film]), _clock(registered[film]["clock"])] if film in registered else ["–"] * 2
        yield f"| {' | '.join([*cells, *([_share(causes)] if counts else [])])} |"


def _values(numbers: dict[str, Any]) -> str:
    return ", ".join(_short(numbers[name]) if name in numbers else "–" for name in NUMBERS)


def _clock(clock: dict[str, float]) -> str:
    half = (clock["high"] - clock["low"]) / 2
    return f"{clock['value'] - WRONG['clock_s']:+.2f} ± {half:.2f} s"


def _share(causes: dict[str, Any]) -> str:
    return f"{causes['of_others']} of {causes['matches']}"


def _conclusion(found: dict[str, Any]) -> str:
    """What the films tell, with the film in which most matches are of another vessel."""
    film, worst = max(found["causes"].items(), key=lambda each: each[1]["of_others"] / each[1]["matches"])
    own, both = (_values(worst["some"][truth.name]) for truth in (Truth.SAME_VESSELS, Truth.ALL_DETECTIONS))
    clocks = [each["clock"] for films in found["registered"].values() for each in films.values()]
    held = sum(clock["low"] <= WRONG["clock_s"] <= clock["high"] for clock in clocks)
    return (
        f"With four fifths, box errors grow by wrong matches, in one film: in {film}, {_share(worst)} detections match "
        "another vessel than by full truth, since vessels without a transponder pass close to others that are missed "
        f"there. By that alone, with true tracks, the values change from {own} to {both}. In the other films the "
        "vessels with transponders have the errors of all, or a little larger ones of their own. That vessels without "
        "a transponder hide others unknown changes little. In the basin errors of positions remain in x: boats are 80 "
        "to 300 m away and turn by up to a full circle. An error of a position lasts in east and north, and "
        "registration finds one offset along and across the heading, so it does not take it off a vessel that turns. "
        f"Of the intervals of the clock, {held} of {len(clocks)} hold the true one."
    )


def _short(value: float) -> str:
    return f"{value:.3g}"
