"""What `modsim3d learn --from-condition` does: a detector as it might be in another condition."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modsim3d.cli.shared import out_file, print_rows, print_written
from modsim3d.cli.terminal import open_console, print_prose, tell_files, warn

if TYPE_CHECKING:
    from modsim3d.learn.guess import ConditionChange


STRANGE_SPREAD = 4.0
"""Box errors of the thesis's conditions on the same images differ by factors of 3.4 at most."""
_STRANGE = (
    "the box errors of the two conditions differ by more than a factor of four. If they were measured on different "
    "images, this is not the effect of the condition"
)


def guess_detector(detector: Path, measured_in: str, wanted_in: str, out: Path, overwrite: bool) -> None:
    """Write a guess of a detector in another condition, and print what changes."""
    from modsim3d.detector.file.reading import find_detector, load_detector
    from modsim3d.detector.file.writing import detector_text
    from modsim3d.io.atomic_write import write_files
    from modsim3d.io.overwrite_guard import claimed
    from modsim3d.io.strict_text import load_yaml
    from modsim3d.io.validation import find_condition
    from modsim3d.learn.guess import ConditionChange, guessed

    files = [Path(name) if Path(name).is_file() else find_condition(name) for name in (measured_in, wanted_in)]
    detector, out = find_detector(detector), out_file(out, Path("detector.yaml"))
    tell_files([detector, *files])
    with claimed([out], overwrite=overwrite, inputs=[detector, *files]):
        before, after = (
            (name, load_detector(file)) for name, file in zip((measured_in, wanted_in), files, strict=True)
        )
        change = ConditionChange.between(before, after)
        content = load_yaml(detector, "detector")
        result = guessed(content, change, f"detector {detector}")
        write_files({out: detector_text(result, _comments(detector, measured_in, wanted_in, change))})
    console = open_console()
    print_prose(console, _guess(detector, measured_in, wanted_in))
    print_rows(console, "In each state", list(_rows(content, result)))
    print_written(console, [out])
    if any(not 1 / STRANGE_SPREAD < ratio < STRANGE_SPREAD for ratio in change.spread):
        warn(_STRANGE)


def _guess(detector: Path, measured_in: str, wanted_in: str) -> str:
    return (
        f"A guess, not a measurement: {detector.name} in {wanted_in}, if it changes from {measured_in} as much as the "
        "detector of those two conditions did."
    )


def _comments(detector: Path, measured_in: str, wanted_in: str, change: ConditionChange) -> list[str]:
    """Comments that a reader of the file needs."""
    spread = ", ".join(f"{ratio:.3g}" for ratio in change.spread)
    changes = (
        f"Multiplied: odds of a miss by {change.miss_odds:.3g}, odds that a detection is false by "
        f"{change.false_odds:.3g}, false positives per image by {change.false_per_image:.3g}, standard deviations of "
        f"e_x, e_y, e_w, e_h by {spread}. Added to the log-odds of confidence: {change.confidence[0]:.3g} (true), "
        f"{change.confidence[1]:.3g} (false)."
    )
    texts = (f"Written by modsim3d learn --from-condition. {_guess(detector, measured_in, wanted_in)}", changes)
    return [line for text in texts for line in textwrap.wrap(text, 110)]


def _rows(before: dict[str, Any], after: dict[str, Any]) -> Iterator[tuple[str, ...]]:
    """Numbers of each state before and after the change."""
    for name, was in before["states"].items():
        now, unit = after["states"][name], was["box_error"]["unit"]
        for label, old, new in zip(before["labels"], was["confusion"][-1], now["confusion"][-1], strict=True):
            yield name, f"{label} missed", f"{old:.1%} → {new:.1%}"
        if "false_discovery_rate" in was:
            yield name, "false detections", f"{was['false_discovery_rate']:.1%} → {now['false_discovery_rate']:.1%}"
        else:
            key, rates = "false_positives_per_image", [each["false_positives"].get("rate") for each in (before, after)]
            old, new = (state.get(key, rate) for state, rate in zip((was, now), rates, strict=True))
            yield name, "false detections in an image", f"{old:.3g} → {new:.3g}"
        old, new = (state["box_error"]["covariance"][2][2] ** 0.5 for state in (was, now))
        yield name, "width error, standard deviation", f"{old:.3g} → {new:.3g} {'' if unit == 'relative' else 'px'}"
