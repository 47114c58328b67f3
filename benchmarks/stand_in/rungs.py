"""The ladder: detector files learned from the same films, each with more of the simulator's models than the last."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from modsim3d.learn.learned_detector import RICHER
from modsim3d.learn.learning import LearnResult, learn_detector

if TYPE_CHECKING:
    from benchmarks.stand_in.films import Film

MIN_IOU = 0.3
"""Of a match: a box that is half too wide is still the box of its vessel."""
MIN_CONFIDENCE = 0.2


@dataclass(frozen=True)
class Rung:
    """A step of the ladder: its letter, what it adds to the step below, and the models that it leaves out."""

    name: str
    title: str
    without: frozenset[str]


_ADDED: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("the thesis's model", ()),
    ("errors that grow with the box", ("relative", "mixed")),
    ("misses by visibility, size, distance", ("effects",)),
    ("misses and errors that persist", ("persistence",)),
    ("places, sizes and lives of false positives", ("sizes", "places", "lasting")),
    (
        "confidence, merges, splits, tails",
        ("confidence", "slopes", "duplicates", "merges", "splits", "student_t"),
    ),
    ("vessels that are always harder, boxes always off to one side", ("vessels", "components")),
    ("misses as confidences that fall below the threshold", ("score",)),
    ("false positives on vessels", ("on_vessels",)),
)


def _rungs() -> Iterator[Rung]:
    left = set(RICHER)
    for letter, (title, models) in zip("abcdefghi", _ADDED, strict=True):
        left -= set(models)
        yield Rung(letter, title, frozenset(left))


RUNGS = tuple(_rungs())


def learn_rung(films: Sequence[Film], rung: Rung, confidence: float = MIN_CONFIDENCE, **given: Any) -> LearnResult:
    """Learn from films, with their weather as the performance state, from a confidence on; `given` goes to learning.

    Raises:
        ModsimError: The films' files cannot be read.
    """
    return learn_detector(
        truth=[film.truth for film in films],
        detections=[film.real for film in films],
        conditions=[film.weather for film in films],
        match="confidence",
        least_iou=MIN_IOU,
        confidence=confidence,
        without=sorted(rung.without),
        check=False,  # the comparison on other films is the check
        **given,
    )


def learned_files(films: Sequence[Film], folder: Path, rungs: Sequence[Rung] = RUNGS) -> dict[str, Path]:
    """Learn every rung and write its detector file; files by the name of the rung."""
    folder.mkdir(parents=True, exist_ok=True)
    return {rung.name: learn_rung(films, rung).write(folder / f"{rung.name}.yaml", overwrite=True)[0] for rung in rungs}
