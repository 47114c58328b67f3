"""stand_in: do trackers score on simulated detections as on those of a detector that looks at pixels?

Films of three places in three weathers are drawn in light and shade and shown to a pretrained detector. Detector files
are learned from some of them, each with more models than the last, and trackers are scored behind real and simulated
detections on others that no model was settled on: once, when all of them are there. What was found in a film is stored:
only films of which nothing is stored are drawn, and the weights are fetched for them.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.processes import say
from benchmarks.stand_in.films import WORK, Film, all_films, judged_films, make_films
from benchmarks.stand_in.measure import measure, rounded
from benchmarks.stand_in.page import write_page
from benchmarks.stand_in.rungs import MIN_CONFIDENCE, RUNGS, learned_files
from benchmarks.stand_in.stored import JUDGED, STORED, names_in, restore_films, store
from benchmarks.stand_in.tell_apart import told_apart
from benchmarks.stand_in.weights import PACKAGE, SHA256
from modsim3d.core.errors import ModsimError

RESULTS = Path(__file__).resolve().parents[2] / "docs" / "campaigns" / "stand_in.json"


def main() -> None:
    """Make films, learn, measure, and write the results and the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, default=WORK, metavar="DIR", help="where the films and the weights are")
    parser.add_argument("--develop", action="store_true", help="on the films that the models are settled on")
    parser.add_argument("--seeds", type=int, default=5, metavar="N", help="seeds of the simulated detector on a film")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="processes (2 unless given)")
    parser.add_argument("--draw", action="store_true", help="draw films of which something is stored, too")
    given = parser.parse_args()
    try:
        known, judged = all_films(given.work), [] if given.develop else judged_films(given.work)
        for films, path, least in ((known, STORED, MIN_CONFIDENCE), (judged, JUDGED, 0.0)):
            stored = names_in(path) if not given.draw else set()
            restore_films(given.work, [film for film in films if film.name in stored], path)
            if len(stored) < len(films):  # films may be made in parts
                make_films(given.work, films, given.workers)
                store(films, path, least)
        learn_from = [film for film in known if not given.develop or film.role == "learn"]
        scored = judged or [film for film in known if film.role == "compare"]
        results = compared(learn_from, scored, given.work / "detectors", given.seeds, given.workers)
        RESULTS.write_text(json.dumps(results, separators=(",", ":")) + "\n", encoding="utf-8")
        write_page(results)
    except ModsimError as error:
        sys.exit(f"error: {error}")


def compared(seen: Sequence[Film], unseen: Sequence[Film], folder: Path, seeds: int, workers: int) -> dict[str, object]:
    """Learn from some films, and compare on others."""
    say(f"learning from {len(seen)} films")
    detectors = learned_files(seen, folder)
    titles = {rung.name: rung.title for rung in RUNGS}
    numbers = range(1, seeds + 1)
    results = measure(
        unseen,
        detectors,
        numbers,
        threshold=MIN_CONFIDENCE,
        titles=titles,
        workers=workers,
        learned_from=len(seen),
        judged=all(film.role == "judge" for film in unseen),
    )
    say("training classifiers")
    results["told_apart"] = rounded(told_apart(unseen, detectors, numbers, MIN_CONFIDENCE))
    results["detector"] = {"name": "YOLOv8n", "source": f"the npm package {PACKAGE}", "sha256": SHA256}
    return results


if __name__ == "__main__":
    main()
