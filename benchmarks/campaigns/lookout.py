"""lookout: from where on vessels are known in the shipped campaign of that name, and how often its bounds err.

The bounds of a share of approaches are those of `clustered_low` in modsim3d/campaign/verdicts/bounds.py. They are tried
on simulated campaigns whose true share is known: seeds with a Poisson number of approaches, more or less alike within a
seed (beta-binomial), also where seeds with more approaches have more that are missed.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d import run_campaign
from modsim3d.campaign.folder import opened_campaign
from modsim3d.campaign.report.lookout import lookout_sections
from modsim3d.campaign.verdicts.bounds import clustered_low
from modsim3d.core.arrays import Array
from modsim3d.core.document import Table

OUT = Path(__file__).resolve().parents[2] / "docs" / "campaigns"
CAMPAIGNS, ALPHA = 2000, 0.05
SEEDS, SHARES, SIZES, ALIKE = (5, 10, 20, 40, 100), (0.5, 0.8, 0.95, 0.99), (1.5, 4.0), (0.0, 0.05, 0.2, 0.5, 1.0)


def drawn(rng: np.random.Generator, seeds: int, share: float, size: float, alike: float, denser: bool) -> Any:
    """Approaches of each seed, those that are known, both (campaigns, seeds), and the true share of all."""
    trials = rng.poisson(size, (CAMPAIGNS, seeds))
    missed = np.full(trials.shape, 1 - share)
    if denser:  # the odds of a miss grow by two thirds with each standard deviation of the number of approaches
        weight = np.exp(0.5 * (trials - size) / np.sqrt(size))
        missed = np.minimum((1 - share) * weight * trials.sum() / (trials * weight).sum(), 0.95)
    true = 1 - float((trials * missed).sum() / trials.sum())
    if alike == 1:
        missed = rng.random(trials.shape) < missed
    elif alike:
        missed = rng.beta(missed * (1 - alike) / alike, (1 - missed) * (1 - alike) / alike)
    return trials.astype(float), rng.binomial(trials, 1 - missed).astype(float), true


def errors() -> Iterator[dict[str, Any]]:
    """How often the lower and the upper bound are wrong, in percent, the worst over how alike approaches are."""
    rng = np.random.default_rng(11)
    for seeds in SEEDS:
        for share in SHARES:
            low, high, shown = [], [], []
            for size in SIZES:
                for alike in ALIKE:
                    for denser in (False, True):
                        trials, hits, true = drawn(rng, seeds, share, size, alike, denser)
                        lower = bounds(hits, trials)
                        low.append(100 * float(np.mean(lower > true)))
                        high.append(100 * float(np.mean(1 - bounds(trials - hits, trials) < true)))
                        if alike == 0.05 and size == 4 and not denser:
                            shown.append(float(np.median(lower)))
            yield {"seeds": seeds, "share": share, "low": max(low), "high": max(high), "median_low": shown[0]}


def bounds(hits: Array, trials: Array) -> Array:
    """The lower bound of each campaign, shape (campaigns,)."""
    return np.array([clustered_low(*each, ALPHA) for each in zip(hits, trials, strict=True)])


def all_known(share: float, size: int) -> int:
    """Number of seeds with so many approaches each, all of them known, that show a share."""
    return next(
        n for n in range(2, 10_000) if clustered_low(np.full(n, size * 1.0), np.full(n, size * 1.0), ALPHA) >= share
    )


ABOUT = """Written by `script/campaign lookout`: the shipped campaign `lookout`, 12 traffic seeds of `fairway` and
of `small_target`, in clear sight and in haze. An approach is a vessel that was in view of own ship
beyond a distance and came so near; it is known if tracks followed it before, and kept it until the
closest approach ([lookout requirements](../requirements.md#lookout-requirements)). Detector and
trackers are those that ship with the scenes. The detector's numbers are invented, so these are
examples, and say nothing of a real lookout."""
ERRORS = """{count:,} simulated campaigns of each kind whose true share is known, with 1.5 or 4 approaches a seed on
average, with intra-class correlations of {alike}, with and without more misses in seeds with more
approaches. A line has the worst of these {kinds} kinds. At most {worst:.1f} % err, where 5 % is aimed
at; a kind is off by {off:.1f} % at most (3 standard errors), and the worst of many is biased upwards."""
LAST = """The last column is with 4 approaches a seed and a correlation of 0.05. If all approaches are known, a
share of 95 % takes {one} seeds with one approach each, {four} with four, {ten} with ten."""


def page(campaign: Any, table: Table, found: Sequence[dict[str, Any]]) -> str:
    """The results as Markdown."""
    needed = {name: all_known(0.95, size) for name, size in (("one", 1), ("four", 4), ("ten", 10))}
    told = {
        "count": CAMPAIGNS,
        "alike": ", ".join(f"{each:g}" for each in ALIKE),
        "kinds": len(ALIKE) * len(SIZES) * 2,
        "worst": max(max(row["low"], row["high"]) for row in found),
        "off": 300 * np.sqrt(ALPHA * (1 - ALPHA) / CAMPAIGNS),
    }
    verdicts = [(v.text, v.tracker, _where(v), f"**{v.outcome}**", v.why) for v in campaign.verdicts]
    keys = ("share", "seeds", "low", "high", "median_low")
    bounds_of = [tuple(f"{row[key]:.3g}" for key in keys) for row in found]
    header = ("True share", "Seeds", "Lower bound above it, %", "Upper bound below it, %", "Median lower bound")
    parts = [
        "# From where on vessels are known",
        ABOUT,
        _table(table.header, table.rows),
        "## Its requirements",
        _table(("Requirement", "Tracker", "Where", "Outcome", "Why"), verdicts),
        "## How often the bounds err",
        ERRORS.format(**told),
        _table(header, bounds_of),
        LAST.format(**needed),
    ]
    return "\n\n".join(parts) + "\n"


def _table(header: Sequence[Any], rows: Sequence[Sequence[Any]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)


def _where(verdict: Any) -> str:
    return ", ".join(f"{key} {value}" for key, value in verdict.values.items())


def main() -> int:
    parser = argparse.ArgumentParser(prog="script/campaign lookout", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--campaign", type=Path, help="folder of the campaign, to keep it, or to go on with it")
    parser.add_argument("--out", type=Path, default=OUT, help="folder for lookout.md and lookout.json")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = asked.campaign or Path(scratch) / "lookout"
        campaign = run_campaign("lookout", folder, workers=asked.workers)
        blocks = lookout_sections(opened_campaign(folder).plan, campaign.table)
        (table,) = (each for each in blocks if isinstance(each, Table))
    found = list(errors())
    content = {
        "format": 1,
        "version": version("modsim3d"),
        "header": [*map(str, table.header)],
        "rows": [[*map(str, row)] for row in table.rows],
        "verdicts": [
            {
                "text": v.text,
                "tracker": v.tracker,
                "values": v.values,
                "outcome": v.outcome,
                "share": v.estimate,
                "low": v.low,
                "high": v.high,
            }
            for v in campaign.verdicts
        ],
        "errors": found,
    }
    (asked.out / "lookout.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    (asked.out / "lookout.md").write_text(page(campaign, table, found), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
