"""The page of the campaign: what was simulated, what held, and by how much it was off."""

from __future__ import annotations

from typing import Any

from benchmarks.voyages.cases import AIS, CASES, FIRST_SEED, TOLD_M, Case
from benchmarks.voyages.pixels import PIXELS
from benchmarks.voyages.pixels_page import pixels_section
from benchmarks.voyages.scores import PARTS, below, share
from benchmarks.voyages.wrong_camera import WRONG

PLACES = {
    "strait": "The shipped strait, a minute of eight vessels at 100 to 900 m",
    "strait_minute": "The shipped strait, a minute of eight vessels at 30 to 900 m",
    "strait_traffic": "The shipped strait with the traffic of `benchmarks/voyages/strait_traffic.yaml`, ten minutes of "
    "eighteen vessels that cross at 180 to 720 m",
    "lanes": "`benchmarks/voyages/lanes.yaml`, ten minutes of fifteen ships that pass at 0.5 to 1.4 km",
    "sample": "Six minutes of ten vessels",
}
TITLES = {"registration": "Camera and clock", "detector": "Detector"}
HEAD = "| number | true | held | fewest | bias | spread | half-width |"
UNITS = {"clock_s": "s", "pitch_deg": "°", "yaw_deg": "°", "height_m": "m"}


def text(results: dict[str, dict[str, Any]]) -> str:
    """The page."""
    lines = ["# Learning from simulated voyages", "", _introduction(), "", *_summary(results)]
    if {"detector_ais", "unregistered"} <= results.keys():
        lines += _side_by_side(results["detector_ais"]["detector"], results["unregistered"]["detector"])
    for case in CASES:
        if case.name in results:
            lines += _section(case, results[case.name])
    if PIXELS in results:
        lines += pixels_section(results[PIXELS])
    return "\n".join(lines).rstrip() + "\n"


def _introduction() -> str:
    wrong = ", ".join(_wrong(name, value) for name, value in WRONG.items())
    return (
        "`script/campaign voyages` simulates voyages whose camera, clock and detector are known, and learns them again "
        "as [`modsim3d learn-voyage`](../voyage.md) does. The scene that the user has is wrong by amounts drawn with "
        f"each seed from minus to plus these: {wrong}. Each seed draws the detections anew, too, and moves each "
        "vessel's way along its course by up to a quarter of it, so that no two voyages have the same encounters. "
        f"Seeds count from {FIRST_SEED}, since those below were looked at while learning was built.\n\n"
        f"By AIS means: each coordinate of a position is off by {AIS.position_m:g} m (standard deviation), an error "
        f"that lasts {AIS.position_s:g} s and changes with each report, every {AIS.reports_s:g} s "
        "from a moment of the vessel's own on; a vessel's reports "
        f"are late by {AIS.delay_s:g} s (standard deviation over vessels); {AIS.absent:.0%} of the vessels have no "
        f"transponder. All of these are drawn anew with each seed. Learning gets `--position-noise {TOLD_M:g}`; that "
        "reports are late it finds itself. Boxes match by centres, as is usual with AIS: by IoU, slivers of vessels at "
        "the image's border and behind others would be taken for false positives, even with true tracks.\n\n"
        "Held is the number of 95 % intervals that hold the true value, of so many voyages. Fewest is the binomial "
        "limit: intervals that hold 95 % of the time fall below it in 1 % of the campaigns; those that hold more often "
        "are wider than they need to be. Bias and spread are mean and standard deviation of the estimates about the "
        "true value, half-width the median of the intervals. A "
        "number that a voyage had too little data to learn, or for which it chose another model than the file has, is "
        "not counted in that voyage. Nor are mean box errors, which registration takes as zero, and box errors in "
        "another unit."
    )


def _wrong(name: str, value: float) -> str:
    words = name.rsplit("_", 1)[0]
    return f"{words} {value:.0%}" if name == "focal_share" else f"{words} {value:g} {UNITS[name]}".replace(" °", "°")


def _summary(results: dict[str, dict[str, Any]]) -> list[str]:
    lines = [
        "| voyage | seeds | refused | camera and clock: intervals that hold | detector: intervals that hold | CPU |"
    ]
    lines += ["|---|---|---|---|---|---|"]
    for case in CASES:
        if case.name in results:
            found = results[case.name]
            cells = [_held(found[part]) if part in found else "–" for part in PARTS]
            refused = sum(found["refused"].values())
            lines.append(
                f"| [{case.title}](#{_anchor(case.title)}) | {found['voyages']} | {refused} | {' | '.join(cells)} | "
                f"{found['cpu_s']:.1f} s |"
            )
    return [*lines, ""]


def _held(part: dict[str, dict[str, float]]) -> str:
    fallen = len(below(part))
    return f"{share(part):.1%}; {fallen} of {len(part)} numbers below the limit"


def _anchor(title: str) -> str:
    return "".join(each for each in title.lower() if each.isalnum() or each == " ").replace(" ", "-")


def _side_by_side(registered: dict[str, Any], plain: dict[str, Any]) -> list[str]:
    """Bias of the numbers that both learn, largest without registration first, in the unit of their half-widths."""
    lines = ["## With and without registration", "",
             "The same voyages by AIS, learned with registration and without. Bias of what each learns.", "",
             "| number | true | bias with | bias without | held with | held without |",
             "|---|---|---|---|---|---|"]  # fmt: skip
    for name, with_it in registered.items():
        if name in plain:
            without = plain[name]
            held = " | ".join(f"{each['held']}/{each['of']}" for each in (with_it, without))
            bias = f"{_short(with_it['bias'])} | {_short(without['bias'])}"
            lines.append(f"| `{short(name)}` | {_asked(with_it)} | {bias} | {held} |")
    return [*lines, ""]


SAID = {
    "bounds": "Said to be an upper bound, which holds if the true value is below it",
    "unknown": "Said to be unknown, and not counted",
}


def _section(case: Case, found: dict[str, Any]) -> list[str]:
    lines = [f"## {case.title}", "", f"{case.said} {PLACES[case.scene]}, camera `{case.camera}`, "
             f"{found['voyages']} voyages.", ""]  # fmt: skip
    for part in PARTS:
        if part in found:
            lines += [f"**{TITLES[part]}**", "", HEAD, "|---|---|---|---|---|---|---|"]
            lines += [_row(name, score) for name, score in found[part].items()] + [""]
            if fallen := below(found[part]):
                lines += [f"Below the limit: {', '.join(f'`{short(name)}`' for name in fallen)}.", ""]
            for kind, said in SAID.items():
                counted = {name: score[kind] for name, score in found[part].items() if score[kind]}
                if counted:
                    counts = ", ".join(f"`{short(name)}` in {number:g}" for name, number in counted.items())
                    lines += [f"{said}: {counts} voyages.", ""]
    for reason, number in found["refused"].items():
        lines += [f"Refused in {number}: {reason}", ""]
    return lines


def _row(name: str, score: dict[str, float]) -> str:
    numbers = " | ".join(_short(score[key]) for key in ("bias", "spread", "half_width"))
    held = f"{score['held']:g}/{score['of']:g}"
    return f"| `{short(name)}` | {_asked(score)} | {held} | {score['fewest']:g} | {numbers} |"


def _asked(score: dict[str, float]) -> str:
    """The true value, or the least and the greatest of all voyages."""
    least, most = (_short(score[key]) for key in ("asked", "greatest_asked"))
    return least if least == most else f"{least} to {most}"


def short(name: str) -> str:
    """A number's name without the state, of which there is only one."""
    return name.removeprefix("states.voyage.")


def _short(value: float) -> str:
    return f"{value:.3g}"
