"""Campaigns drawn from real scores of traffic seeds: how often bounds of their mean are wrong, and how often they help.

The scores are those of some traffics, each with the same traffic seeds and trackers. Seeds are drawn with replacement,
so that the true mean is the mean over all seeds, and a requirement with this threshold is not to be met.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from scipy import stats

import modsim3d
from modsim3d.campaign.keys import ScoreKeys
from modsim3d.campaign.plan import STATE
from modsim3d.campaign.verdicts.bounds import corrected_bounds
from modsim3d.campaign.verdicts.wording import DIFFERENCE, HIGH, LOW
from modsim3d.campaign.work.row import SCORES, SCORES_BY, score_bounds
from modsim3d.core.statistics import exact_bounds, half_widths

OUT = Path(__file__).resolve().parents[1] / "docs" / "campaigns"
STORED = OUT / "sequences_scores.parquet"
WHOLE = "whole"
TRAFFICS: dict[str, dict[str, Any]] = {
    "fairway": {"scene": "fairway", "steps": 300},
    "bay": {"scene": str(Path(__file__).parent / "traffics" / "bay.yaml")},
    "basin": {"scene": str(Path(__file__).parent / "traffics" / "basin.yaml")},
    "roads": {"scene": str(Path(__file__).parent / "traffics" / "roads.yaml")},
    "narrows": {"scene": str(Path(__file__).parent / "traffics" / "narrows.yaml")},
}
CHOSEN_ON, JUDGED_ON = ("fairway", "bay"), ("basin", "roads", "narrows")
TRACKERS = ("sort", "bytetrack", "reference")
SEEDS = 160
SIZES = (3, 5, 10, 20, 30, 50)
"""Seeds of a campaign."""
LEVELS = (0.8, 0.9, 0.95, 0.99)
"""Confidences."""
CONFIDENCE = 0.95
"""The one of the tables and of the power."""
SURE = 0.999
"""Confidence of the bound of a rate above which a cell fails."""
POWER = 0.9
"""Power that Student's t would have for normal values at the threshold at which powers are compared."""

Rule = Callable[[np.ndarray, np.ndarray, np.ndarray, int, float, float], np.ndarray]


def t_lower(
    mean: np.ndarray, deviation: np.ndarray, skewness: np.ndarray, count: int, alpha: float, greatest: float
) -> np.ndarray:
    """Lower bounds by Student's t; minus infinity where there is none."""
    half = half_widths(mean, deviation, count, alpha)
    return np.where(np.isnan(half), -np.inf, mean - half)


T, RULE = "Student's t", "corrected"
RULES: dict[str, Rule] = {T: t_lower, RULE: corrected_bounds}
"""Lower bounds of means."""


def make_scores() -> None:
    """Run the campaigns of all traffics and keep their scores by traffic, tracker and seed."""
    tables = []
    for traffic, keys in TRAFFICS.items():
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "campaign.yaml"
            campaign = {**keys, "seeds": {"traffic": SEEDS}, "trackers": list(TRACKERS)}
            file.write_text(yaml.safe_dump(campaign), encoding="utf-8")
            tables.append(kept(traffic, modsim3d.run_campaign(file, Path(folder) / "out", workers=1).table))
    pq.write_table(pa.concat_tables(tables), STORED, compression="zstd")


def kept(traffic: str, table: pa.Table) -> pa.Table:
    """The columns of a campaign's rows that are drawn from."""
    states = [f"{STATE}.{state}.{score}" for state in ("clear", "haze") for score in SCORES_BY[STATE]]
    table = table.select(["tracker", "traffic_seed", *SCORES, *states])
    return table.add_column(0, "traffic", pa.array([traffic] * len(table)))


@dataclass(frozen=True, eq=False)
class Population:
    """The values of a score over traffic seeds, and between which values it lies.

    Attributes:
        score: A key of the scores.
        part: `WHOLE`, or the state within the runs; `DIFFERENCE` of one between two trackers.
        traffic: The traffic.
        tracker: The tracker, or two.
        values: Those of the seeds that have one.
        limits: The least and the greatest possible value.
    """

    score: str
    part: str
    traffic: str
    tracker: str
    values: np.ndarray
    limits: tuple[float, float]


def populations(table: pa.Table) -> Iterator[Population]:
    """All populations in which two values differ."""
    keys = ScoreKeys()
    labels = [np.array(table[name].to_pylist()) for name in ("traffic", "tracker")]
    for column in table.column_names[3:]:
        head, _, score = column.rpartition(".")
        of_all = table[column].to_numpy().astype(float)
        for traffic in TRAFFICS:
            for tracker in TRACKERS:
                values = of_all[(labels[0] == traffic) & (labels[1] == tracker)]
                values = values[np.isfinite(values)]
                if len(np.unique(values)) > 1:
                    part = head.removeprefix(f"{STATE}.") or WHOLE
                    yield Population(score, part, traffic, tracker, values, score_bounds(score, keys))


def differences(table: pa.Table) -> Iterator[Population]:
    """The same of differences between two trackers on the same traffic seeds, of whole runs."""
    keys = ScoreKeys()
    labels = [np.array(table[name].to_pylist()) for name in ("traffic", "tracker")]
    for score in (name for name in table.column_names[3:] if name in SCORES):
        of_all = table[score].to_numpy().astype(float)
        span = float(np.subtract(*reversed(score_bounds(score, keys))))
        for traffic in TRAFFICS:
            for pair in combinations(TRACKERS, 2):
                first, second = (of_all[(labels[0] == traffic) & (labels[1] == each)] for each in pair)
                both = np.isfinite(first) & np.isfinite(second)
                values = first[both] - second[both]
                if len(np.unique(values)) > 1:
                    yield Population(score, DIFFERENCE, traffic, " − ".join(pair), values, (-span, span))


@cache
def threshold_distance(seeds: int) -> float:
    """Standard deviations at which Student's t with one-sided 95 % is right with `POWER` for normal values."""
    limit = stats.t.isf(0.05, seeds - 1)
    low, high = 0.0, 50.0
    while high - low > 1e-9:
        middle = (low + high) / 2
        short = stats.nct.sf(limit, seeds - 1, middle * math.sqrt(seeds)) < POWER
        low, high = (middle, high) if short else (low, middle)
    return high


def cells(population: Population, uniform: Mapping[int, np.ndarray]) -> list[dict[str, Any]]:
    """Rates of wrong verdicts, and the power, of each bound, number of seeds and rule.

    The power is that at a threshold which holds, so far off the mean that Student's t would meet it with `POWER` for
    normal values. Beside it is that of a Student's t made so much stricter that it errs no more than 5 % here.

    Args:
        population: What is drawn from.
        uniform: For each number of seeds, uniform numbers that choose them, shape (campaigns, seeds).
    """
    found = []
    least, greatest = population.limits
    for seeds, chosen in uniform.items():
        mean, deviation, skewness = moments(population.values[(chosen * len(population.values)).astype(int)])
        true, distance = population.values.mean(), population.values.std() * threshold_distance(seeds)
        for bound, sign, limit in ((LOW, 1, greatest), (HIGH, -1, -least)):
            of_seeds = (sign * mean, deviation, -sign * skewness, seeds)
            low = {rule: {level: of(*of_seeds, 1 - level, limit) for level in LEVELS} for rule, of in RULES.items()}
            found.append(
                {
                    "bound": bound,
                    "seeds": seeds,
                    "wrong": {
                        rule: {c: float(np.mean(each >= sign * true)) for c, each in of.items()}
                        for rule, of in low.items()
                    },
                    "power": {
                        rule: float(np.mean(of[CONFIDENCE] >= sign * true - distance)) for rule, of in low.items()
                    },
                    "strict": strict_t_power(sign * mean, deviation, seeds, sign * true, distance),
                }
            )
    return found


def moments(drawn: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean, standard deviation and skewness of each row."""
    seeds, mean = drawn.shape[1], drawn.mean(axis=1)
    off = drawn - mean[:, None]
    square = off * off
    variance = square.mean(axis=1)
    cubed = (square * off).mean(axis=1)
    skewness = np.divide(cubed, variance**1.5, out=np.zeros_like(mean), where=variance > 0)
    return mean, np.sqrt(variance * seeds / (seeds - 1)), skewness


def strict_t_power(mean: np.ndarray, deviation: np.ndarray, seeds: int, true: float, distance: float) -> float:
    """The power of Student's t whose critical value is raised until it errs no more than 5 % of the time."""
    error = deviation / math.sqrt(seeds)
    differ = np.isfinite(half_widths(mean, deviation, seeds, 0.05))
    scaled = np.divide(mean - true, error, out=np.full_like(mean, -np.inf), where=differ)
    limit = max(float(np.quantile(scaled, 0.95, method="higher")), float(stats.t.isf(0.05, seeds - 1)))
    return float(np.mean(differ & (mean - limit * error >= true - distance)))


def measured(
    campaigns: int,
    table: pa.Table,
    sizes: Sequence[int] = SIZES,
    drawn_from: Callable[[pa.Table], Iterator[Population]] = populations,
) -> list[dict[str, Any]]:
    """All cells of all populations."""
    rng = np.random.default_rng(20240119)
    uniform = {seeds: rng.random((campaigns, seeds)) for seeds in sizes}
    found = []
    for each in drawn_from(table):
        about = {"score": each.score, "part": each.part, "traffic": each.traffic, "tracker": each.tracker}
        found += [{**about, **cell} for cell in cells(each, uniform)]
    return found


def turned(cell: Mapping[str, Any]) -> dict[str, Any]:
    """The cell of a difference with the other sign: its bounds change places."""
    other = {LOW: HIGH, HIGH: LOW}
    return {**cell, "bound": other[cell["bound"]], "tracker": " − ".join(reversed(cell["tracker"].split(" − ")))}


def holds(cell: Mapping[str, Any], confidence: float, campaigns: int, rule: str = RULE) -> bool:
    """Whether a cell does not fail: the lower bound of its rate of wrong verdicts is at most what is allowed."""
    return lower_rate(cell["wrong"][rule][confidence], campaigns) <= 1 - confidence + 1e-12


def lower_rate(rate: float, campaigns: int) -> float:
    """The lower bound (Clopper & Pearson) of a rate with the confidence `SURE`."""
    return exact_bounds(round(rate * campaigns), campaigns, 1 - SURE)[0]


def offer_of(cell: Mapping[str, Any]) -> str:
    """The key of a cell's offer: scores of states, and differences, have their own."""
    score: str = cell["score"]
    kind = {WHOLE: "", DIFFERENCE: f"{DIFFERENCE}."}.get(cell["part"], f"{STATE}.")
    return kind + score


def offers(found: Sequence[Mapping[str, Any]], campaigns: int, traffics: Collection[str]) -> dict[str, Any]:
    """For each score, bound and confidence the least number of seeds from which on all cells hold; None: never."""
    failing: dict[tuple[str, str, float], int] = {}
    for cell in found:
        if cell["traffic"] in traffics:
            for confidence in LEVELS:
                key = (offer_of(cell), cell["bound"], confidence)
                failing[key] = max(failing.get(key, 0), 0 if holds(cell, confidence, campaigns) else cell["seeds"])
    sizes = (*SIZES, None)
    least = {key: sizes[0 if not worst else SIZES.index(worst) + 1] for key, worst in failing.items()}
    scores = list(dict.fromkeys(score for score, _, _ in failing))
    return {
        score: {bound: [least[score, bound, confidence] for confidence in LEVELS] for bound in (LOW, HIGH)}
        for score in scores
    }


SHOWN = {
    **dict.fromkeys(("hota", "mota", "idf1"), LOW),
    **dict.fromkeys(("id_switches", "false_track_s", "anees", "rmse_px"), HIGH),
}
"""Scores of the tables, and the bound that meets what is usually required of them."""


def misjudged(
    found: Sequence[Mapping[str, Any]], chosen: Mapping[str, Any], campaigns: int
) -> tuple[list[dict[str, Any]], int]:
    """Cells of the judging traffics that fail although the other traffics have them hold; and the number of all."""
    failing, judged = [], 0
    for cell in found:
        if cell["traffic"] in CHOSEN_ON or offer_of(cell) not in chosen:
            continue
        for place, confidence in enumerate(LEVELS):
            least = chosen[offer_of(cell)][cell["bound"]][place]
            if least is not None and cell["seeds"] >= least:
                judged += 1
                if not holds(cell, confidence, campaigns):
                    about = {key: cell[key] for key in ("score", "bound", "part", "traffic", "tracker", "seeds")}
                    failing.append({**about, "confidence": confidence, "wrong": cell["wrong"][RULE][confidence]})
    return failing, judged


def summary(campaigns: int, table: pa.Table, sizes: Sequence[int] = SIZES) -> dict[str, Any]:
    """What the page shows, and from how many seeds on each mean is judged: where the cells of all traffics hold."""
    found = measured(campaigns, table, sizes)
    chosen = offers(found, campaigns, CHOSEN_ON)
    failing, judged = misjudged(found, chosen, campaigns)
    cells = [
        {**cell, "wrong": {rule: cell["wrong"][rule][CONFIDENCE] for rule in RULES}}
        for cell in found
        if SHOWN.get(cell["score"]) == cell["bound"] and cell["part"] == WHOLE
    ]
    return {
        "campaigns": campaigns,
        "seeds": {traffic: int(np.sum(np.array(table["traffic"]) == traffic)) // len(TRACKERS) for traffic in TRAFFICS},
        "cells": cells,
        "confidences": list(LEVELS),
        "chosen": chosen,
        "offers": offers(found, campaigns, TRAFFICS),
        "judged": judged,
        "misjudged": failing,
    }


def summary_of_differences(campaigns: int, table: pa.Table, sizes: Sequence[int] = SIZES) -> dict[str, Any]:
    """The same of differences with both signs; of the cells the worst of all pairs of trackers."""
    found = measured(campaigns, table, sizes, differences)
    found += [turned(cell) for cell in found]
    worst: dict[tuple[str, str, int], dict[str, float]] = {}
    for cell in found:
        if SHOWN.get(cell["score"]) == cell["bound"]:
            rates = worst.setdefault((cell["score"], cell["traffic"], cell["seeds"]), dict.fromkeys(RULES, 0.0))
            rates.update({rule: max(rates[rule], cell["wrong"][rule][CONFIDENCE]) for rule in RULES})
    failing, judged = misjudged(found, offers(found, campaigns, CHOSEN_ON), campaigns)
    return {
        "campaigns": campaigns,
        "cells": [dict(zip(("score", "traffic", "seeds"), key, strict=True), wrong=of) for key, of in worst.items()],
        "confidences": list(LEVELS),
        "offers": offers(found, campaigns, TRAFFICS),
        "judged": judged,
        "failing": len(failing),
    }
