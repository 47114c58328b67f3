"""real_pictures: do trackers score on simulated detections as on those of real detectors in real pictures?

Cars in KITTI's films by two public detectors: films 0 to 13 are learned from in halves, each compared on the other;
films 14 to 20, but 17 without a car, are scored once, by what all of those taught. Vessels in ten minutes of FVessel's
river, block by block, and people in two short films of MOT15.
The data are read from `--data`; only numbers worked out from them are written.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from benchmarks.processes import ROOT, say
from benchmarks.real_pictures.compared import compared, judged
from benchmarks.real_pictures.page import page
from benchmarks.real_pictures.sets import DETECTORS, TO_DEVELOP, TO_JUDGE, checksums, pictures, river, streets
from benchmarks.stand_in.measure import rounded
from modsim3d.core.errors import ModsimError

RESULTS, PAGE = ROOT / "docs" / "campaigns" / "real_pictures.json", ROOT / "docs" / "real_pictures.md"
RIVER, STREET = "fvessel", "tud"


def main() -> None:
    """Learn, compare, and write the results and the page after each set."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, metavar="DIR", help="folder with the data sets")
    parser.add_argument("--set", choices=[*DETECTORS, RIVER, STREET], action="append", help="this one alone")
    parser.add_argument("--judge", action="store_true", help="the films that are kept for the end, too: once")
    parser.add_argument(
        "--work", type=Path, default=ROOT / "runs" / "real_pictures", metavar="DIR", help="for the runs"
    )
    parser.add_argument("--seeds", type=int, default=5, metavar="N", help="seeds of the simulated detector on a film")
    parser.add_argument("--workers", type=int, default=2, metavar="N", help="processes (2 unless given)")
    parser.add_argument("--out", type=Path, default=RESULTS, metavar="FILE", help="results; the page is beside docs")
    given = parser.parse_args()
    try:
        results = json.loads(given.out.read_text(encoding="utf-8")) if given.out.is_file() else {}
        for name in given.set or [*DETECTORS, RIVER, STREET]:
            say(name)
            found = results.setdefault(name, {})
            if name == RIVER:
                found["blocks"] = compared(river(given.data, given.work), given.work / name, given.seeds, given.workers)
            elif name == STREET:
                films = streets(given.data, given.work)
                found["halves"] = compared(films, given.work / name, given.seeds, given.workers)
            else:
                known = pictures(given.data, given.work, name, TO_DEVELOP)
                found["halves"] = compared(known, given.work / name, given.seeds, given.workers)
                found["sha256"] = checksums(given.data, (*TO_DEVELOP, *TO_JUDGE), name)
                _write(results, given.out)
                if given.judge:
                    kept = pictures(given.data, given.work, name, TO_JUDGE)
                    found["judged"] = judged(known, kept, given.work / name, given.seeds, given.workers)
            _write(results, given.out)
    except ModsimError as error:
        sys.exit(f"error: {error}")


def _write(results: dict[str, Any], path: Path) -> None:
    path.write_text(json.dumps(rounded(results), separators=(",", ":")) + "\n", encoding="utf-8")
    if path == RESULTS:
        PAGE.write_text(page(results), encoding="utf-8")


if __name__ == "__main__":
    main()
