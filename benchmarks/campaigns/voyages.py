"""voyages: are a camera, its clock and its detector learned right from a voyage without labels? Simulated, by seeds.

A case is a scene whose camera and clock are wrong for the user, with true tracks or those that AIS gives. Of every
number that is estimated it is counted how often its interval holds the true one.
"""

from __future__ import annotations

import argparse
import json
import os
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # small matrices: threads double the CPU time

from benchmarks.stand_in.films import WORK
from benchmarks.voyages.cases import CASES, FIRST_SEED
from benchmarks.voyages.causes import causes
from benchmarks.voyages.page import text
from benchmarks.voyages.pixels import PIXELS, pixel_voyages, restored_films
from benchmarks.voyages.scores import scores
from benchmarks.voyages.trials import trial

OUT = Path(__file__).resolve().parents[2] / "docs" / "campaigns"


def main() -> None:
    """Run, and write after every case: what is there is a result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--workers", type=int, default=2)
    names = [*(case.name for case in CASES), PIXELS]
    parser.add_argument("--case", action="append", choices=names, help="this one alone")
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the page and the numbers")
    parser.add_argument("--work", type=Path, default=WORK, help="folder of the stand-in's films")
    asked = parser.parse_args()
    page, numbers = asked.out / "voyages.md", asked.out / "voyages.json"
    asked.out.mkdir(parents=True, exist_ok=True)
    results = json.loads(numbers.read_text(encoding="utf-8")) if asked.case and numbers.is_file() else {}
    with ProcessPoolExecutor(asked.workers) as pool:
        for name in names:
            if asked.case and name not in asked.case:
                continue
            if name == PIXELS:
                films = restored_films(asked.work)
                results[name] = pixel_voyages(pool, films) | {"causes": causes(pool, films)}
            else:
                seeds = range(FIRST_SEED, FIRST_SEED + asked.seeds)
                results[name] = scores(list(pool.map(trial, [name] * len(seeds), seeds)))
            numbers.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
            page.write_text(text(results), encoding="utf-8")
    print(text(results))


if __name__ == "__main__":
    main()
