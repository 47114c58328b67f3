"""sequences: how often verdicts on requirements are wrong, and after how many seeds they come, by simulated campaigns.

Each campaign is a row of random numbers whose share or mean is exactly at the threshold; a verdict there is an error.
Bounds are those of modsim3d.campaign.verdicts.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from scipy import stats

from benchmarks.resampled_means import (
    RULE,
    SHOWN,
    SIZES,
    STORED,
    TRAFFICS,
    T,
    lower_rate,
    make_scores,
    summary,
    summary_of_differences,
)
from modsim3d.campaign.verdicts.bounds import clean_seeds, clean_seeds_sequential, log_capital, mixture_log_capital
from modsim3d.campaign.verdicts.wording import DIFFERENCE, HIGH, LOW, OFFERS
from modsim3d.core.statistics import exact_bounds, t_bounds

ROOT = Path(__file__).resolve().parents[2]
OUT = ROOT / "docs" / "campaigns"
ALPHA = 0.05
POWER = 0.9
MAX_SEEDS = 20_000
"""Seeds of a campaign with requirements of shares."""
MAX_MEAN_SEEDS = 2_000
"""The same with requirements of means."""
AT_ONCE = 100
"""Campaigns whose capital is computed at once."""
SHARES = (0.99, 0.9, 0.5)
FIXED = {0.99: (299, 473, 1000), 0.9: (29, 100, 300), 0.5: (10, 100, 300)}
TRUE_SHARES = {0.99: (1.0, 0.999, 0.998, 0.995, 0.98, 0.95), 0.9: (1.0, 0.98, 0.95, 0.85, 0.7), 0.5: (0.9, 0.6, 0.4)}
BETA_SUM = 22.0
"""Both parameters of a beta distribution together: a standard deviation of 0.1 at a mean of 0.6."""
THRESHOLD = 0.6
TRUE_MEANS = (0.7, 0.65, 0.62, 0.58, 0.55, 0.5)

Draw = Callable[[np.random.Generator, tuple[int, int]], np.ndarray]


def beta(mean: float, together: float) -> Draw:
    return lambda rng, shape: rng.beta(mean * together, (1 - mean) * together, shape)


DISTRIBUTIONS: dict[str, tuple[float, Draw]] = {
    "0 or 1, mean 0.5": (0.5, lambda rng, shape: (rng.random(shape) < 0.5).astype(float)),
    "0 or 1, mean 0.9": (0.9, lambda rng, shape: (rng.random(shape) < 0.9).astype(float)),
    "uniform": (0.5, lambda rng, shape: rng.random(shape)),
    "0.98, or 0 one time in 20": (0.931, lambda rng, shape: np.where(rng.random(shape) < 0.95, 0.98, 0.0)),
    "beta, mean 0.6, deviation 0.10": (0.6, beta(0.6, BETA_SUM)),
    "beta, mean 0.6, deviation 0.03": (0.6, beta(0.6, 265.0)),
    "beta, mean 0.95, deviation 0.10": (0.95, beta(0.95, 3.75)),
}


def first_above(capital: np.ndarray) -> np.ndarray:
    """After how many seeds the capital is 1/α, infinite if it never is, of each campaign."""
    hit = capital >= -math.log(ALPHA)
    return np.where(hit.any(axis=-1), hit.argmax(axis=-1) + 1.0, math.inf)


def decided_shares(right: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
    """After how many seeds a share is met and failed, of each campaign."""
    first: list[tuple[np.ndarray, np.ndarray]] = []
    for some in np.array_split(right, max(1, len(right) // AT_ONCE)):
        capital = mixture_log_capital(some, share)
        found = np.cumsum(some, axis=1) / np.arange(1, some.shape[1] + 1)
        above = np.where(found > share, capital, -math.inf)
        below = np.where(found < share, capital, -math.inf)
        first.append((first_above(above), first_above(below)))
    return np.concatenate([met for met, _ in first]), np.concatenate([failed for _, failed in first])


def decided_means(values: np.ndarray, mean: float) -> tuple[np.ndarray, np.ndarray]:
    """After how many seeds a mean that should be at least a threshold is met and failed, of each campaign."""
    parts = np.array_split(values, max(1, len(values) // AT_ONCE))
    met = [first_above(log_capital(some, mean)) for some in parts]
    failed = [first_above(log_capital(1 - some, 1 - mean)) for some in parts]
    return np.concatenate(met), np.concatenate(failed)


def finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def share_of(happened: np.ndarray) -> float:
    return float(np.mean(happened))


def looked_once(rng: np.random.Generator, campaigns: int) -> list[dict[str, Any]]:
    """Errors of exact bounds, met and failed, exact and simulated."""
    rows = []
    for share, sizes in FIXED.items():
        for size in sizes:
            count = np.arange(size + 1)
            bounds = np.array([exact_bounds(int(right), size, ALPHA) for right in count])
            met, failed = bounds[:, 0] >= share, bounds[:, 1] < share
            chance = stats.binom.pmf(count, size, share)
            right = rng.binomial(size, share, campaigns)
            row = {
                "share": share,
                "seeds": size,
                "met": float(chance[met].sum()),
                "failed": float(chance[failed].sum()),
            }
            rows.append({**row, "met simulated": share_of(met[right]), "failed simulated": share_of(failed[right])})
    return rows


def looked_twice(rng: np.random.Generator, campaigns: int) -> dict[str, float]:
    """The exact bound of 99 %, looked at after 299 seeds and, if it is not met, after 473."""
    small, large = (clean_seeds(0.99, 0.95, failures) for failures in (0, 1))
    wrong = rng.random((campaigns, large)) >= 0.99
    met = (wrong[:, :small].sum(axis=1) == 0) | (wrong.sum(axis=1) <= 1)
    clean = 0.99**small
    later = stats.binom.pmf(1, small, 0.01) * 0.99 ** (large - small)
    return {"small": small, "large": large, "met": float(clean + later), "met simulated": share_of(met)}


def sequences_of_shares(rng: np.random.Generator, campaigns: int) -> list[dict[str, Any]]:
    rows = []
    for share in SHARES:
        met, failed = decided_shares(rng.random((campaigns, MAX_SEEDS)) < share, share)
        row = {"share": share, "met": share_of(np.isfinite(met)), "failed": share_of(np.isfinite(failed))}
        rows.append({**row, "either": share_of(np.isfinite(np.minimum(met, failed)))})
    return rows


def sequences_of_means(rng: np.random.Generator, campaigns: int) -> list[dict[str, Any]]:
    rows = []
    for name, (mean, draw) in DISTRIBUTIONS.items():
        values = draw(rng, (campaigns, MAX_MEAN_SEEDS))
        met, failed = decided_means(values, mean)
        row = {"values": name, "met": share_of(np.isfinite(met)), "failed": share_of(np.isfinite(failed))}
        for size in (10, 30, 100):
            bounds = [t_bounds(each[:size], ALPHA) for each in values]
            row[f"t {size} met"] = share_of(np.array([found is not None and found[0] >= mean for found in bounds]))
            row[f"t {size} failed"] = share_of(np.array([found is not None and found[1] < mean for found in bounds]))
        rows.append(row)
    return rows


def power_of_shares(rng: np.random.Generator, campaigns: int) -> list[dict[str, Any]]:
    rows = []
    for share, truths in TRUE_SHARES.items():
        for truth in truths:
            met, failed = decided_shares(rng.random((campaigns, MAX_SEEDS)) < truth, share)
            rows.append(
                {"share": share, "true": truth, **waited(met, failed, truth > share), "fixed": fixed_size(share, truth)}
            )
    return rows


def power_of_means(rng: np.random.Generator, campaigns: int) -> list[dict[str, Any]]:
    rows = []
    for truth in TRUE_MEANS:
        met, failed = decided_means(beta(truth, BETA_SUM)(rng, (campaigns, MAX_MEAN_SEEDS)), THRESHOLD)
        row = {"threshold": THRESHOLD, "true": truth, **waited(met, failed, truth > THRESHOLD)}
        rows.append(
            {
                **row,
                "fixed": fixed_size_of_mean(abs(truth - THRESHOLD), math.sqrt(truth * (1 - truth) / (BETA_SUM + 1))),
            }
        )
    return rows


def waited(met: np.ndarray, failed: np.ndarray, should_be_met: bool) -> dict[str, float | None]:
    """Seeds until the right verdict, and how often the wrong one came first or none."""
    right, wrong = (met, failed) if should_be_met else (failed, met)
    first = np.where(right < wrong, right, math.inf)
    return {
        "median": finite(np.quantile(first, 0.5, method="inverted_cdf")),
        "90 %": finite(np.quantile(first, POWER, method="inverted_cdf")),
        "wrong": share_of(np.isfinite(wrong) & (wrong < right)),
        "undecided": share_of(np.isinf(right) & np.isinf(wrong)),
    }


def fixed_size(share: float, truth: float) -> float:
    """The least size from which on the exact bound decides rightly with the probability POWER, up to MAX_SEEDS."""
    sizes = np.arange(1, MAX_SEEDS + 1)
    if truth > share:
        most_wrong = stats.binom.ppf(ALPHA, sizes, 1 - share)
        most_wrong -= stats.binom.cdf(most_wrong, sizes, 1 - share) > ALPHA
        power = stats.binom.cdf(most_wrong, sizes, 1 - truth)
    else:
        least_wrong = stats.binom.isf(ALPHA, sizes, 1 - share) + 1
        power = stats.binom.sf(least_wrong - 1, sizes, 1 - truth)
    short = np.flatnonzero(power < POWER)
    return float(sizes[short[-1]] + 1) if len(short) else 1.0


def fixed_size_of_mean(distance: float, deviation: float) -> float:
    """The least size with which Student's t decides rightly with the probability POWER."""
    for size in range(2, MAX_SEEDS):
        limit = stats.t.isf(ALPHA, size - 1)
        if stats.nct.sf(limit, size - 1, distance / deviation * math.sqrt(size)) >= POWER:
            return float(size)
    return math.inf


def percent(value: float) -> str:
    return f"{100 * value:.1f} %"


def whole(value: float | None) -> str:
    return "–" if value is None else f"{value:,.0f}"


def table(header: list[str], rows: list[list[str]]) -> str:
    lines = [f"| {' | '.join(header)} |", f"|{'---:|' * len(header)}", *(f"| {' | '.join(row)} |" for row in rows)]
    return "\n".join(lines) + "\n"


PAGE = """\
# Errors and cost of verdicts

`script/campaign sequences`: {campaigns:,} simulated campaigns a line, confidence 95 %. In the first three sections
the true share or mean is the threshold itself, so that every *met* and every *failed* counts as an error, and at most
5 % of each may be. Simulated lines are off by {off} at most (3 standard errors).

## A share, exact bounds, looked at once

{once}
The same bounds for 99 %, looked at after {small} seeds and again after {large}: met in {twice} of the campaigns
(simulated {twice_simulated}). That is why they hold for one look only.

## A share, the sequence, looked at after each of {longest:,} seeds

{shares}
## A mean, the sequence, looked at after each of {longest_mean:,} seeds; Student's t, looked at once

{means}
The sequence stays below 5 %. Student's t calls a mean met too often where most values are near 1 and few are far below,
with 10 seeds and still with 100. No verdict rests on it.

## A mean of real scores, looked at once

A mean is judged by Student's t corrected for skewness, `corrected_bounds` in `modsim3d/campaign/verdicts/bounds.py`.
That is an approximation, so how often it errs was measured. {seeds} traffic seeds of each of five traffics were run
with `sort`, `bytetrack` and `reference`: 300 steps of `fairway`, and the bay, the basin, the roads and the narrows of
`benchmarks/traffics`. `script/campaign sequences --scores` runs them again, in about an hour; their scores are in
`sequences_scores.parquet`. From the scores of each tracker, {resampled:,} campaigns were drawn with replacement, with
the threshold at the mean of all seeds. A cell fails, and is in bold, if the lower 99.9 % bound of its rate of wrong
*met* exceeds 5 %.

The rule was chosen in three rounds. On `fairway` alone, without a least skewness, it failed on the bay with 10 and with
20 seeds (7 % for HOTA and `id_switches`). On `fairway` and the bay, with a least skewness of 1.2, it held on the basin
and the roads, but with 10 seeds its power was 72 to 82 % of that of Student's t. So the least skewness became 1, and
the half-width gains more where a score is not 0 at best; the basin and the roads were in view then. The narrows were
made afterwards: they alone judge the rule cleanly. About 200 variants were tried.

Wrong *met* in %, by Student's t → corrected, with so many seeds, of the tracker with the most:

{wrong}
Power: how often a requirement is met that holds, with a threshold so far off the mean that Student's t would meet it
in {power} for normal values: 0.99 standard deviations with 10 seeds, 0.55 with 30. Here it is the power of the
corrected bound over that of Student's t at the level at which it errs 5 % in the same cell; and in brackets over that
of Student's t as it is, which errs more. Of the tracker with the least:

{powers}
Over all scores, both bounds, states, and confidences of {confidences}, {judged:,} cells of the other
three traffics were judged that `fairway` and the bay had let pass. {failing:,} of them fail, the worst of each score:

{failing_table}
A bound is given from the number of seeds on from which the cells of **all five** traffics hold
(`modsim3d/campaign/verdicts/{offers}`). Between numbers that were tried it is taken to hold.
The five traffics chose this list, and no sixth has judged it. At 95 %:

{offered}
Nobody has measured it on another traffic. A share of seeds, with `in`, is exact on every traffic, and
`stop: sequential` holds for every score with a least and a greatest value.

## A difference between two trackers, looked at once

The same bounds, of the difference of a score between every two of the three trackers on the same traffic seeds, with
both signs, drawn in the same way. The rule was not chosen for differences. Two trackers often agree in most traffics
and differ by much in a few, and who has not met these thinks too well of the mean. Wrong *met* in % of the worst pair,
by Student's t → corrected:

{wrong_differences}
Where `fairway` and the bay let a bound pass, {judged_differences:,} cells of the other three traffics were judged;
{failing_differences:,} of them fail. So a mean difference is judged only from the number of seeds on from which the
cells of all five traffics and all pairs hold, and for most scores that is never. At 95 %:

{offered_differences}
Where it is never, a share of seeds with `in` is exact, and `stop: sequential` holds for every score with a least and a
greatest value.

## Seeds until the verdict

Seeds until the right verdict, in half of the campaigns and in {power} of them. The fixed size is that with which exact
bounds or Student's t, looked at once, give it in {power}.

{power_shares}
Values of a beta distribution with a standard deviation of about 0.1; the mean should be at least {threshold:g}:

{power_means}
Where nothing fails, a share of 99 % takes {clean} seeds looked at once and {clean_sequential} with the sequence. Half
of the campaigns with a sequence end about as early as with a fixed size that suits the truth, or need up to three times
as many seeds; the slowest tenth need up to three and a half times as many. A sequence pays where nobody knows the
distance beforehand.
"""


def text(found: dict[str, Any]) -> str:
    """The page."""
    once, real = ("met", "failed", "met simulated", "failed simulated"), found["resampled"]
    by_t = [key for key in found["means"][0] if key.startswith("t ")]
    t_header = [f"t, {size} seeds: {way}" for _, size, way in map(str.split, by_t)]
    return PAGE.format(
        campaigns=found["campaigns"],
        off=percent(3 * math.sqrt(ALPHA * (1 - ALPHA) / found["campaigns"])),
        once=table(
            ["share", "seeds", "met", "failed", "met, simulated", "failed, simulated"],
            [
                [f"{row['share']:g}", f"{row['seeds']:,}", *(percent(row[key]) for key in once)]
                for row in found["looked at once"]
            ],
        ),
        small=found["looked at twice"]["small"],
        large=found["looked at twice"]["large"],
        twice=percent(found["looked at twice"]["met"]),
        twice_simulated=percent(found["looked at twice"]["met simulated"]),
        longest=MAX_SEEDS,
        shares=table(
            ["share", "ever met", "ever failed", "either"],
            [
                [f"{row['share']:g}", *(percent(row[key]) for key in ("met", "failed", "either"))]
                for row in found["shares"]
            ],
        ),
        longest_mean=MAX_MEAN_SEEDS,
        means=table(
            ["values", "ever met", "ever failed", *t_header],
            [[row["values"], *(percent(row[key]) for key in ("met", "failed", *by_t))] for row in found["means"]],
        ),
        power=f"{POWER:.0%}".replace("%", " %"),
        seeds=min(real["seeds"].values()),
        resampled=real["campaigns"],
        wrong=wrong_table(real),
        powers=power_shares_table(real),
        confidences=", ".join(f"{100 * each:g} %" for each in real["confidences"]),
        judged=real["judged"],
        failing=len(real["misjudged"]),
        failing_table=failing_table(real["misjudged"]),
        offers=OFFERS,
        offered=offered_table(real),
        wrong_differences=wrong_table(found["differences"]),
        judged_differences=found["differences"]["judged"],
        failing_differences=found["differences"]["failing"],
        offered_differences=offered_table(found["differences"], BOTH),
        power_shares=power_table(found["power, shares"], "share"),
        threshold=THRESHOLD,
        power_means=power_table(found["power, means"], "threshold"),
        clean=clean_seeds(0.99, 0.95),
        clean_sequential=clean_seeds_sequential(0.99, 0.95),
    )


def cells_of(real: dict[str, Any]) -> list[tuple[str, list[dict[int, list[dict[str, Any]]]]]]:
    """The cells of each score of the tables, by traffic and by number of seeds."""
    return [
        (
            score,
            [
                {
                    seeds: [
                        cell
                        for cell in real["cells"]
                        if (cell["score"], cell["traffic"], cell["seeds"]) == (score, traffic, seeds)
                    ]
                    for seeds in SIZES
                }
                for traffic in TRAFFICS
            ],
        )
        for score in SHOWN
    ]


def asked(score: str) -> str:
    return f"{score} at {'least' if SHOWN[score] == LOW else 'most'}"


def wrong_table(real: dict[str, Any]) -> str:
    """The rates of wrong verdicts, of the tracker with the most."""

    def text_of(cells: list[dict[str, Any]]) -> str:
        if not cells:
            return "–"
        rates = [max(cell["wrong"][rule] for cell in cells) for rule in (T, RULE)]
        texts = [f"{100 * rate:.1f}" for rate in rates]
        return " → ".join(
            f"**{each}**" if lower_rate(rate, real["campaigns"]) > ALPHA else each
            for each, rate in zip(texts, rates, strict=True)
        )

    return table(
        ["mean of", "traffic", *(f"{seeds} seeds" for seeds in SIZES)],
        [
            [asked(score), traffic, *map(text_of, by_seeds.values())]
            for score, by_traffic in cells_of(real)
            for traffic, by_seeds in zip(TRAFFICS, by_traffic, strict=True)
            if any(by_seeds.values())
        ],
    )


def power_shares_table(real: dict[str, Any]) -> str:
    """The power from ten seeds on, of the tracker with the least."""

    def text_of(cells: list[dict[str, Any]]) -> str:
        if not cells:
            return "–"
        strict = min(cell["power"][RULE] / cell["strict"] for cell in cells)
        as_it_is = min(cell["power"][RULE] / cell["power"][T] for cell in cells)
        return f"{100 * strict:.0f} % ({100 * as_it_is:.0f} %)"

    sizes = [seeds for seeds in SIZES if seeds >= 10]
    return table(
        ["mean of", "traffic", *(f"{seeds} seeds" for seeds in sizes)],
        [
            [asked(score), traffic, *(text_of(by_seeds[seeds]) for seeds in sizes)]
            for score, by_traffic in cells_of(real)
            for traffic, by_seeds in zip(TRAFFICS, by_traffic, strict=True)
        ],
    )


def failing_table(cells: list[dict[str, Any]]) -> str:
    """The cells that fail, the worst of each score and bound."""
    worst: dict[tuple[str, str], dict[str, Any]] = {}
    for cell in sorted(cells, key=lambda cell: cell["wrong"] / (1 - cell["confidence"])):
        worst[cell["score"], cell["bound"]] = cell
    return table(
        ["mean of", "part", "wrong", "in place of", "traffic", "seeds"],
        [
            [
                f"{score} at {'least' if bound == LOW else 'most'}",
                cell["part"],
                percent(cell["wrong"]),
                f"{100 * (1 - cell['confidence']):.0f} %",
                cell["traffic"],
                str(cell["seeds"]),
            ]
            for (score, bound), cell in sorted(worst.items())
        ],
    )


EACH = ((LOW, "at least"), (HIGH, "at most"))
BOTH = ((LOW, "at least and at most"),)
"""Of differences, whose bounds are the same with both signs."""


def offered_table(real: dict[str, Any], sides: Sequence[tuple[str, str]] = EACH) -> str:
    """From how many seeds on each mean is judged."""
    place, rows = real["confidences"].index(1 - ALPHA), []
    for bound, words in sides:
        by_seeds: dict[int | None, list[str]] = {}
        for score, offer in real["offers"].items():
            by_seeds.setdefault(offer[bound][place], []).append(score.removeprefix(f"{DIFFERENCE}."))
        for seeds in (*SIZES, None):
            if seeds in by_seeds:
                rows.append([words, "never" if seeds is None else str(seeds), ", ".join(by_seeds[seeds])])
    lines = [f"| {' | '.join(row)} |" for row in (["mean", "from seeds", "scores"], ["---"] * 3, *rows)]
    return "\n".join(lines) + "\n"


def power_table(rows: list[dict[str, Any]], asked: str) -> str:
    header = [asked, "truth", "sequence, half", "sequence, 90 %", "fixed size", "wrong", "undecided"]
    return table(
        header,
        [
            [
                *(f"{row[key]:g}" for key in (asked, "true")),
                *(whole(row[key]) for key in ("median", "90 %", "fixed")),
                *(percent(row[key]) for key in ("wrong", "undecided")),
            ]
            for row in rows
        ],
    )


def measured(campaigns: int, resampled: int) -> dict[str, Any]:
    """All figures."""
    rng = np.random.default_rng(20240119)
    return {
        "campaigns": campaigns,
        "confidence": 1 - ALPHA,
        "looked at once": looked_once(rng, campaigns),
        "looked at twice": looked_twice(rng, campaigns),
        "shares": sequences_of_shares(rng, campaigns),
        "means": sequences_of_means(rng, campaigns),
        "power, shares": power_of_shares(rng, campaigns),
        "power, means": power_of_means(rng, campaigns),
        "resampled": summary(resampled, pq.read_table(STORED)),
        "differences": summary_of_differences(resampled, pq.read_table(STORED)),
    }


def offers_text(offers: dict[str, Any]) -> str:
    """The offers as JSON, a score a line."""
    lines = ",\n".join(f"  {json.dumps(score)}: {json.dumps(offer)}" for score, offer in offers["seeds"].items())
    return f'{{"confidences": {json.dumps(offers["confidences"])}, "seeds": {{\n{lines}\n}}}}\n'


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--campaigns", type=int, default=1_000)
    parser.add_argument("--resampled", type=int, default=20_000, help="campaigns that are drawn from real scores")
    parser.add_argument("--scores", action="store_true", help="run the campaigns whose scores are drawn from: an hour")
    options = parser.parse_args()
    if options.scores:
        make_scores()
    found = measured(options.campaigns, options.resampled)
    seeds = found["resampled"]["offers"] | found["differences"]["offers"]
    offers = {"confidences": found["resampled"]["confidences"], "seeds": seeds}
    (ROOT / "modsim3d/campaign/verdicts" / OFFERS).write_text(offers_text(offers), encoding="utf-8")
    OUT.mkdir(parents=True, exist_ok=True)
    content = json.dumps(found, indent=1, allow_nan=False)
    (OUT / "sequences.json").write_text(content + "\n", encoding="utf-8")
    (OUT / "sequences.md").write_text(text(found), encoding="utf-8")
    print(text(found))


if __name__ == "__main__":
    main()
