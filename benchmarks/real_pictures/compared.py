"""Real and simulated detections compared on films that the simulated detector was not learned from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.processes import say
from benchmarks.real_pictures.sets import Picture
from benchmarks.stand_in.measure import measure
from benchmarks.stand_in.rungs import RUNGS, Rung, learn_rung

LEARNED: tuple[Rung, ...] = (RUNGS[0], RUNGS[-1])
"""The thesis's model, and all models."""
THRESHOLD = 0.3
"""Least confidence of a detection, real or simulated, and in learning."""
KEPT = ("films", "rungs", "trackers", "seeds", "scores", "differences", "film_correlation", "bins", "ranking",
        "exchanged", "learned_from")  # fmt: skip
"""Parts of a comparison that are stored."""


def compared(films: Sequence[Picture], folder: Path, seeds: int, workers: int) -> dict[str, Any]:
    """Learn from each half of some films, every second one, and compare on the other half."""
    files = {}
    for half in (0, 1):
        say(f"learning from half {half + 1} of {len(films)} films")
        files[1 - half] = _learned(films[half::2], folder / f"half_{half}")
    of_films = {film.name: files[place % 2] for place, film in enumerate(films)}
    return _measured(films, files[0], of_films, seeds, workers, len(films) // 2)


def judged(known: Sequence[Picture], kept: Sequence[Picture], folder: Path, seeds: int, workers: int) -> dict[str, Any]:
    """Learn from all known films, and compare on those that were kept."""
    say(f"learning from {len(known)} films")
    files = _learned(known, folder / "all")
    return _measured(kept, files, {}, seeds, workers, len(known))


def _learned(films: Sequence[Picture], folder: Path) -> dict[str, Path]:
    folder.mkdir(parents=True, exist_ok=True)
    return {
        rung.name: learn_rung(films, rung, THRESHOLD).write(folder / f"{rung.name}.yaml", overwrite=True)[0]
        for rung in LEARNED
    }


def _measured(
    films: Sequence[Picture],
    files: dict[str, Path],
    of_films: dict[str, dict[str, Path]],
    seeds: int,
    workers: int,
    learned_from: int,
) -> dict[str, Any]:
    found = measure(
        films,
        files,
        range(1, seeds + 1),
        threshold=THRESHOLD,
        of_films=of_films,
        titles={rung.name: rung.title for rung in LEARNED},
        workers=workers,
        learned_from=learned_from,
    )
    return {name: found[name] for name in KEPT}
