"""search: does a search find lower scores than as many random trials? Best score by number of trials, by repetitions.

Four problems, each with its own ranges. In a repetition the search and the random trials have the same traffic seeds to
choose from and the same budget; the next repetition has other seeds. Random trials are uniform in the ranges (in the
logarithm where the scale is log) and in the seeds.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.tracker_trials import mean_and_interval
from modsim3d.campaign.keys import CampaignKeys, SearchKeys
from modsim3d.campaign.plan import Plan, at
from modsim3d.campaign.search_folder import TriedPoint, batches, planned_trial, proposed
from modsim3d.campaign.work.layers import RunLayers
from modsim3d.campaign.work.row import row_of

OUT = Path(__file__).resolve().parents[2] / "docs" / "campaigns"
BUDGET = 100
AT = (10, 20, 30, 50, 75, 100)
"""Numbers of trials after which the best score is told."""
PROBLEMS: dict[str, dict[str, Any]] = {
    "camera": {
        "about": "harbour, where the camera stands and looks: the score depends on it strongly and smoothly",
        "repetitions": 10,
        "scene": "harbour",
        "steps": 30,
        "seeds": 1,
        "over": {
            "cameras.quay.pose.position_m[2]": {"low": 4, "high": 40, "scale": "log"},
            "cameras.quay.pose.position_m[0]": [-100, 20],
            "cameras.quay.pose.yaw_rad": [-0.2, 0.4],
            "cameras.quay.pose.pitch_rad": [-0.05, 0.1],
        },
    },
    "detector": {
        "about": "harbour, the detector's state, errors and false positives, with 50 seeds",
        "repetitions": 10,
        "scene": "harbour",
        "steps": 30,
        "seeds": 50,
        "over": {
            "state": {"choices": ["excellent", "good", "bad", "terrible"]},
            "detector.false_positives.persistence.lifetime_s": [0.5, 10],
            "detector.false_positives.duplicates": [0, 0.05],
            "detector.persistence.class_s": {"low": 0.1, "high": 5, "scale": "log"},
            "detector.persistence.box_s": {"low": 0.1, "high": 5, "scale": "log"},
        },
    },
    "seeds": {
        "about": "harbour, 500 seeds, and a range that hardly matters: nothing can be learned from other trials",
        "repetitions": 10,
        "scene": "harbour",
        "steps": 30,
        "seeds": 500,
        "over": {"detector.operating_threshold": [0.2, 0.25]},
    },
    "waves": {
        "about": "strait, the sea, with 20 seeds",
        "repetitions": 5,
        "scene": "strait",
        "steps": 20,
        "seeds": 20,
        "over": {
            "waves.significant_height_m": [0.1, 1.5],
            "waves.peak_period_s": [4, 9],
            "waves.direction_rad": [-3.1, 3.1],
            "state": {"choices": ["clear", "haze"]},
        },
    },
}


def keys_of(problem: dict[str, Any], seed: int, budget: int) -> CampaignKeys:
    """A problem as a campaign file."""
    search = {"minimise": "hota", "over": problem["over"], "seeds": problem["seeds"], "budget": budget}
    return CampaignKeys.model_validate(
        {"scene": problem["scene"], "steps": problem["steps"], "seed": seed, "trackers": ["sort"], "search": search}
    )


def scorer(keys: CampaignKeys, layers: RunLayers) -> Callable[[int, dict[str, Any]], float | None]:
    """Gives the HOTA of a traffic seed and values."""
    plan, rules = Plan.of(keys), keys.score

    def score(seed_index: int, values: dict[str, Any]) -> float | None:
        value: float | None = row_of(0, layers.layers_of(planned_trial(plan, 0, seed_index, values)), rules)["hota"]
        return value

    return score


def searched(keys: CampaignKeys, layers: RunLayers) -> list[float | None]:
    """The scores of a search, in order."""
    search, score, tried = _search(keys), scorer(keys, layers), list[TriedPoint]()
    for batch in range(batches(search)):
        points = proposed(search, keys.seed, batch, tried)
        tried += [TriedPoint(point, score(point.seed_index, point.values(search.over))) for point in points]
    return [each.value for each in tried]


def drawn(keys: CampaignKeys, layers: RunLayers) -> list[float | None]:
    """The scores of as many random trials."""
    search, score, rng = _search(keys), scorer(keys, layers), np.random.default_rng([3, keys.seed])
    return [
        score(int(rng.integers(search.seeds)), at(search.over, rng.random(len(search.over))))
        for _ in range(search.budget)
    ]


def _search(keys: CampaignKeys) -> SearchKeys:
    assert keys.search is not None
    return keys.search


def best(scores: list[float | None]) -> list[float]:
    """The least score so far, after each trial; trials without a score have none."""
    known = [math.inf if score is None else score for score in scores]
    return [round(float(each), 6) for each in np.minimum.accumulate(known)]


def repetition(problem: dict[str, Any], seed: int, budget: int) -> dict[str, list[float]]:
    """Best scores of a search and of random trials."""
    keys = keys_of(problem, seed, budget)
    with closing(RunLayers(keys, Path(), Path("cache"))) as layers:
        return {"search": best(searched(keys, layers)), "random": best(drawn(keys, layers))}


def tidied(value: dict[str, Any]) -> str:
    half = "" if value["half"] is None else f" ± {value['half']:.3f}"
    return f"{value['mean']:.3f}{half}"


def table(name: str, problem: dict[str, Any], found: list[dict[str, list[float]]]) -> list[str]:
    """Lines of the page for a problem."""
    keys = ", ".join(f"`{key}`" for key in problem["over"])
    lines = [f"## {name}", "", f"{problem['about'].capitalize()}. {len(found)} repetitions, over {keys}.", ""]
    lines += ["| trials | search | random | search − random | lower in |", "|---|---|---|---|---|"]
    for count in (count for count in AT if count <= len(found[0]["search"])):
        ends = {kind: [each[kind][count - 1] for each in found] for kind in ("search", "random")}
        differences = [a - b for a, b in zip(ends["search"], ends["random"], strict=True)]
        lower = sum(each < 0 for each in differences)
        cells = [tidied(mean_and_interval(each)) for each in (ends["search"], ends["random"], differences)]
        lines.append(f"| {count} | {' | '.join(cells).replace('-', '−')} | {lower} of {len(found)} |")
    return [*lines, "", verdict(found), ""]


def verdict(found: list[dict[str, list[float]]]) -> str:
    """What a problem's figures support, in a sentence."""
    last = mean_and_interval([each["search"][-1] - each["random"][-1] for each in found])
    half = math.inf if last["half"] is None else last["half"]
    if last["mean"] + half < 0:
        caught = [1 + int(np.argmax(np.array(each["search"]) <= each["random"][-1])) for each in found
                  if each["search"][-1] <= each["random"][-1]]  # fmt: skip
        lead = f"In {len(caught)} of {len(found)} repetitions it reached what all random trials had reached"
        return f"The search found lower scores. {lead}, in the median after {np.median(caught):.0f} trials."
    if last["mean"] - half > 0:
        return "The random trials found lower scores."
    return "At the end the interval of the difference holds 0: no advantage is shown."


def page(data: dict[str, Any]) -> str:
    """The page."""
    lines = [
        "# Search against random trials",
        "",
        f"`script/campaign search`. Lowest HOTA of `sort` found after so many trials, in batches of 10: mean over "
        f"repetitions with its 95 % interval (Student's t), and the mean difference within a repetition. Lower is "
        f"better for a search. It took {data['cpu_s'] / 60:.0f} minutes of processor.",
        "",
    ]
    for name in PROBLEMS:
        if name in data["problems"]:
            lines += table(name, PROBLEMS[name], data["problems"][name])
    if missing := [name for name in PROBLEMS if name not in data["problems"]]:
        lines += [f"Not run yet: {', '.join(missing)}."]
    return "\n".join(lines).rstrip() + "\n"


def main() -> None:
    """Run, and write after every problem: what is there is a result."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problems", nargs="*", default=list(PROBLEMS), help="those named; others keep their figures")
    parser.add_argument("--budget", type=int, default=BUDGET)
    asked = parser.parse_args()
    path = OUT / "search.json"
    data = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {"cpu_s": 0.0, "problems": {}}
    if set(asked.problems) == set(PROBLEMS):
        data = {"cpu_s": 0.0, "problems": {}}
    for name in asked.problems:
        started = time.process_time()
        seeds = range(1, PROBLEMS[name]["repetitions"] + 1)
        data["problems"][name] = [repetition(PROBLEMS[name], seed, asked.budget) for seed in seeds]
        data["cpu_s"] = round(data["cpu_s"] + time.process_time() - started, 1)
        path.write_text(json.dumps(data) + "\n", encoding="utf-8")
        (OUT / "search.md").write_text(page(data), encoding="utf-8")
    print(page(data))


if __name__ == "__main__":
    main()
