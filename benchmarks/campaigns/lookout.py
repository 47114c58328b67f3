"""lookout: from where on vessels are known in the shipped campaign of that name, and how often its bounds err.

The bounds of the mean share of approaches are those of `mean_share_low` in modsim3d/campaign/verdicts/bounds.py. They
are tried on simulated campaigns whose true mean is known: seeds with a Poisson number of approaches, more or less alike
within a seed (beta-binomial), also where seeds with more approaches have more that are missed, and with few dense ones.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from modsim3d import run_campaign
from modsim3d.campaign.folder import opened_campaign
from modsim3d.campaign.report.campaign_page import lookout_sections
from modsim3d.campaign.verdicts.bounds import mean_share_low
from modsim3d.core.arrays import Array
from modsim3d.core.document import Table

OUT = Path(__file__).resolve().parents[2] / "docs" / "campaigns"
CAMPAIGNS, ALPHA = 400, 0.05
SEEDS, SHARES, SIZES, ALIKE = (10, 20, 40), (0.5, 0.8, 0.95), (1.5, 4.0), (0.0, 0.2, 1.0)


def drawn(rng: np.random.Generator, seeds: int, share: float, size: float, alike: float, denser: bool) -> Any:
    """Share of the approaches of each seed that are known, NaN without any, (campaigns, seeds), and its true mean."""
    trials = rng.poisson(size, (CAMPAIGNS, seeds))
    missed = np.full(trials.shape, 1 - share)
    if denser:  # a miss is likelier by two thirds with each standard deviation of the number of approaches
        weight = np.exp(0.5 * (trials - size) / np.sqrt(size))
        missed = np.minimum((1 - share) * weight * trials.sum() / (trials * weight).sum(), 0.95)
    true = 1 - float(missed[trials > 0].mean())
    if alike == 1:
        missed = rng.random(trials.shape) < missed
    elif alike:
        missed = rng.beta(missed * (1 - alike) / alike, (1 - missed) * (1 - alike) / alike)
    return np.where(trials > 0, rng.binomial(trials, 1 - missed) / np.maximum(trials, 1), np.nan), true


def few_dense(rng: np.random.Generator, seeds: int) -> tuple[Array, float]:
    """Shares where one seed in ten has 30 approaches, 70 % of them known, and the others 2 that are all known."""
    dense = rng.random((CAMPAIGNS, seeds)) < 0.1
    return np.where(dense, rng.binomial(30, 0.7, dense.shape) / 30, 1.0), 0.97


def errors() -> Iterator[dict[str, Any]]:
    """How often the lower and the upper bound are wrong, in percent, the worst over the kinds of campaigns."""
    rng = np.random.default_rng(11)
    for seeds in SEEDS:
        for share in SHARES:
            kinds = [drawn(rng, seeds, share, *kind) for kind in product(SIZES, ALIKE, (False, True))]
            yield {"seeds": seeds, "share": f"{share:g}"} | _worst(kinds)
        yield {"seeds": seeds, "share": "0.97, few dense"} | _worst([few_dense(rng, seeds)])


def _worst(kinds: Sequence[tuple[Array, float]]) -> dict[str, float]:
    low, high, median = [], [], []
    for shares, true in kinds:
        lower, above = bounds(shares), 1 - bounds(1 - shares)
        low.append(100 * float(np.mean(lower > true)))
        high.append(100 * float(np.mean(above < true)))
        median.append(float(np.median(lower)))
    return {"low": max(low), "high": max(high), "least": min(median), "most": max(median)}


def bounds(shares: Array) -> Array:
    """The lower bound of each campaign, shape (campaigns,), from shares with NaN for seeds without approaches."""
    return np.array([mean_share_low(each[~np.isnan(each)], ALPHA) for each in shares])


ABOUT = """Written by `script/campaign lookout`: the shipped campaign `lookout`, 12 traffic seeds of `fairway` and
of `small_target`, in clear sight and in haze. An approach is a vessel that was in view of own ship
beyond a distance and came so near; it is known if one track followed it before, and kept it until the
closest approach ([lookout requirements](../requirements.md#lookout-requirements)). Detector and
trackers are those that ship with the scenes. The detector's numbers are invented, so these are
examples, and say nothing of a real lookout."""
ERRORS = """{count:,} simulated campaigns of each kind whose true mean over seeds is known, with 1.5 or 4 approaches a
seed on average, with intra-class correlations of {alike}, with and without more misses in seeds with
more approaches; and with one seed in ten that has 30 approaches, 70 % of them known, where the others
have 2 that are all known. A line has the worst of its kinds. At most {worst:.1f} % err, where at most 5 %
may; medians are of the lower bound, over the kinds."""
LAST = "If all approaches are known, a share of 95 % takes {seeds} seeds, however many approaches each has."


def page(campaign: Any, table: Table, found: Sequence[dict[str, Any]]) -> str:
    """The results as Markdown."""
    told = {
        "count": CAMPAIGNS,
        "alike": ", ".join(f"{each:g}" for each in ALIKE),
        "worst": max(max(row["low"], row["high"]) for row in found),
    }
    needed = next(n for n in range(2, 1000) if mean_share_low(np.ones(n), ALPHA) >= 0.95)
    verdicts = [(v.text, v.tracker, _where(v), f"**{v.outcome}**", v.why) for v in campaign.verdicts]
    numbers = ("low", "high", "least", "most")
    bounds_of = [(row["share"], row["seeds"], *(f"{row[key]:.3g}" for key in numbers)) for row in found]
    header = (
        "True mean about",
        "Seeds",
        "Lower bound above it, %",
        "Upper bound below it, %",
        "Least median",
        "Greatest",
    )
    parts = [
        "# From where on vessels are known",
        ABOUT,
        _table(table.header, table.rows),
        "## Its requirements",
        _table(("Requirement", "Tracker", "Where", "Outcome", "Why"), verdicts),
        "## How often the bounds err",
        ERRORS.format(**told),
        _table(header, bounds_of),
        LAST.format(seeds=needed),
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
