"""Measures what a campaign costs, and writes benchmarks/CAMPAIGNS.md.

Runs benchmarks/thousand.yaml as a user does: all of it, and its first 200 runs with one process and with two. Then it
times the parts from which the cost of a million runs is worked out. Run it with `python -m benchmarks.campaign_costs`;
`--quick` is a trial that writes nothing, `--out DIR` keeps the folder of the 1,000 runs.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import yaml

from benchmarks.campaign_parts import (
    Coordinated,
    LayerCost,
    TaskCost,
    coordinated,
    layer_costs,
    runs_of_task,
    task_cost,
)
from benchmarks.measured import BUSY_LOAD, significant, table
from benchmarks.processes import ROOT, child, modsim3d, say
from benchmarks.whole_commands import differing_files
from modsim3d.campaign.done_rows import results_table
from modsim3d.campaign.folder import opened_campaign

RESULTS = ROOT / "benchmarks" / "CAMPAIGNS.md"
CAMPAIGN = ROOT / "benchmarks" / "thousand.yaml"
MB, GB, HOUR_S = 1e6, 1e9, 3600.0
MILLION, CORES = 1_000_000, 1_000
MEMORY_GB = 16.0
"""Of a usual machine."""
ENDED = (0, 1, 3)
"""Exit statuses of a campaign that ended: its requirements are met, one failed, one is undecided."""


@dataclass(frozen=True)
class Amount:
    """How much is measured.

    Attributes:
        pair_seeds: Traffic seeds of the campaign that is run with one process and with two.
        layer_seeds: Traffic seeds whose layers are timed.
        tasks: Number of empty tasks.
        coordinated_runs: Numbers of runs that are handed out, of two campaigns.
    """

    pair_seeds: int
    layer_seeds: int
    tasks: int
    coordinated_runs: tuple[int, int]


FULL = Amount(25, 10, 5_000, (20_000, 60_000))
QUICK = Amount(1, 1, 500, (2_000, 8_000))


@dataclass(frozen=True)
class Cost:
    """What a campaign cost.

    Attributes:
        runs: Number of runs.
        frames: Number of frames of all runs.
        seconds: Time by the clock, from the command to its end.
        processor_s: Processor time of all its processes.
        folder_bytes: Bytes of all files that are left.
        hours: Simulated time of all runs.
    """

    runs: int
    frames: int
    seconds: float
    processor_s: float
    folder_bytes: int
    hours: float

    @property
    def run_s(self) -> float:
        """Processor time of a run."""
        return self.processor_s / self.runs


def campaign(file: Path, folder: Path, *options: str) -> Cost:
    """Run a campaign as a user does."""
    spent = modsim3d("campaign", "run", file, "--out", folder, "-q", *options, right=ENDED)
    rows = results_table(opened_campaign(folder))
    if crashed := sum(status != "done" for status in rows["status"].to_pylist()):
        raise RuntimeError(f"{crashed} runs of {file} crashed")
    size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    hours, frames = (sum(rows[name].to_pylist()) for name in ("simulated_s", "frames"))
    return Cost(len(rows), frames, spent.seconds, spent.processor_s, size, hours / HOUR_S)


def with_seeds(seeds: int, folder: Path) -> Path:
    """The campaign with another number of traffic seeds."""
    content = yaml.safe_load(CAMPAIGN.read_text(encoding="utf-8")) | {"seeds": {"traffic": seeds}}
    path = folder / f"seeds{seeds}.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def cost_row(what: str, cost: Cost) -> list[str]:
    """A row of the table of campaigns."""
    return [
        what,
        f"{cost.runs:,}",
        f"{cost.seconds:,.0f}",
        significant(cost.run_s),
        f"{1e3 * cost.processor_s / cost.frames:.2f}",
        f"{cost.folder_bytes / MB / cost.runs:.4f}",
        f"{cost.folder_bytes / MB / cost.hours:.3f}",
        f"{cost.hours:.1f}",
    ]


def pair_text(one: Cost, two: Cost, same: bool) -> str:
    """Two processes against one, in words."""
    more, faster = two.run_s / one.run_s - 1, one.seconds / two.seconds
    held = {True: "held", False: "**not held**"}
    return (
        f"Two processes against one, on the same {one.runs:,} runs: {more:+.1%} CPU seconds a run (within 5 %: "
        f"{held[abs(more) <= 0.05]}) and {faster:.2f} × by the clock (at least 1.7 × on a quiet machine: "
        f"{held[faster >= 1.7]}), from the command to its end. The results are "
        f"{'the same bytes' if same else '**different**'}."
    )


def layer_table(costs: Mapping[str, LayerCost], runs: int) -> str:
    """The table of layers."""
    rows = [
        [name, significant(1e3 * cost.median_s), f"{cost.made / runs:g}", significant(1e3 * by_run(cost, runs))]
        for name, cost in costs.items()
    ]
    total = sum(by_run(cost, runs) for cost in costs.values())
    rows.append(["together", "", "", significant(1e3 * total)])
    return table(("Layer", "Median, CPU ms", "Made, times a run", "CPU ms a run"), rows)


def by_run(cost: LayerCost, runs: int) -> float:
    """Processor time of a layer that a run of a campaign has, in seconds."""
    return cost.median_s * cost.made / runs


@dataclass(frozen=True)
class Million:
    """A million runs on many cores, worked out.

    Attributes:
        run_s: Processor time of a run.
        task: What a task costs beside its runs.
        fewer: Campaigns that were handed out with rows that were there, of a smaller and a larger size.
        more: The larger one.
    """

    run_s: float
    task: TaskCost
    fewer: Coordinated
    more: Coordinated

    @property
    def runs_of_task(self) -> float:
        return self.more.runs / self.more.tasks

    @property
    def tasks(self) -> float:
        return MILLION / self.runs_of_task

    @property
    def hours(self) -> float:
        """Processor hours."""
        return MILLION * self.run_s / HOUR_S

    @property
    def tasks_per_s(self) -> float:
        """Tasks that end each second on all cores."""
        return CORES / (self.runs_of_task * self.run_s)

    @property
    def handing_s(self) -> float:
        """Processor time of the command for each task: its own, and that of its connection to Dask."""
        return self.more.handing_s / self.more.tasks + self.task.client_s

    def grown(self, name: str) -> float:
        """A figure of the two campaigns, for a million runs, if it grows with the number of runs."""
        low, high = getattr(self.fewer, name), getattr(self.more, name)
        return float(high + (high - low) / (self.more.runs - self.fewer.runs) * (MILLION - self.more.runs))

    @property
    def limits(self) -> dict[str, float]:
        """How many cores keep each part busy that there is one of."""
        per_core = self.tasks_per_s / CORES
        return {
            "the command that hands the tasks out": 1 / (per_core * self.handing_s),
            "the Dask scheduler": 1 / (per_core * self.task.scheduler_s),
        }

    def text(self) -> str:
        """What it costs, what breaks first, and what the format does about it."""
        more, cores = self.more, f"{CORES:,}"
        done, rows = more.done_bytes / more.tasks, more.results_bytes / more.runs
        peak_gb = self.grown("peak_bytes") / GB
        figures = [
            ("Processor time", f"{self.hours:,.0f} h"),
            (f"By the clock on {cores} cores", f"{self.hours / CORES:.2f} h, if none is idle"),
            (
                "Tasks of 30 s",
                f"{self.tasks:,.0f}, of {self.runs_of_task:.1f} runs; {self.tasks_per_s:.0f} end a second",
            ),
            ("Load of the Dask scheduler", f"{self.tasks_per_s * self.task.scheduler_s:.0%} of a core"),
            ("Load of the command that hands them out", f"{self.tasks_per_s * self.handing_s:.0%} of a core"),
            ("What goes over the network for tasks", f"{self.tasks * self.task.bytes / GB:.2f} GB"),
            (
                "Files of rows while it runs",
                f"{self.tasks:,.0f} of {done / 1e3:.0f} kB, {self.tasks * done / GB:.2f} GB",
            ),
            ("Files of the data set", f"{-(-MILLION // 50_000)} for each scene, {MILLION * rows / GB:.2f} GB"),
            ("Memory of the command at its end", f"{peak_gb:.1f} GB"),
            ("Time to gather, on one core", f"{self.grown('gathering_s'):.0f} s"),
        ]
        limits = sorted(self.limits.items(), key=lambda each: each[1])
        memory = MILLION * MEMORY_GB / peak_gb
        return "\n\n".join(
            [
                table(("", "Worked out"), [list(each) for each in figures]),
                f"**What breaks first.** With more cores it is {limits[0][0]}: it is busy all the time from "
                f"{limits[0][1]:,.0f} cores on ({limits[1][0]} from {limits[1][1]:,.0f}), and more cores would wait. "
                "Shorter runs do not change that, since tasks are cut by their time and not by their number of runs. "
                f"With more runs it is memory: one process gathers all rows, and {MEMORY_GB:g} GB hold about "
                f"{memory / MILLION:.1f} million. `--shard` has no limit of cores: each job writes its own rows, and "
                "only gathering is left.",
                f"**Small files.** A file for each run would be {MILLION:,} of them, and one for each layer four times "
                f"as many. Rows are written once a task ({self.tasks:,.0f} files, all in `done/`), and at the end they "
                "become the data set: a folder for each scene, `scene=NAME`, with files of 50,000 rows in the order of "
                "the plan, which any reader of hive partitions takes; `done/` is removed. Layers are written only "
                "where `keep` asks for them.",
            ]
        )


def page(amount: Amount, out: Path | None, folder: Path, quick: bool) -> str:
    """The figures, as the text of the page."""
    machine, load = child("machine"), os.getloadavg()[0]
    small = with_seeds(amount.pair_seeds, folder)
    whole: Cost | None = None
    if not quick:
        say("1,000 runs")
        whole = campaign(CAMPAIGN, out or folder / "thousand")
    pair = {}
    for workers in (1, 2):
        say(f"{amount.pair_seeds} traffic seeds, workers: {workers}")
        pair[workers] = campaign(small, folder / f"workers{workers}", "--workers", str(workers))
    results = [folder / f"workers{workers}" / "results" for workers in pair]
    same = not differing_files(*results)
    run_s = pair[1].run_s
    say("layers")
    layers, runs = layer_costs(CAMPAIGN, amount.layer_seeds)
    say("empty tasks")
    task = task_cost(CAMPAIGN, runs_of_task(run_s), amount.tasks)
    say("handing out and gathering")
    by_seed = pair[1].runs // amount.pair_seeds
    sizes = [with_seeds(count // by_seed, folder) for count in amount.coordinated_runs]
    fewer, more = (coordinated(file, folder / "workers1", run_s) for file in sizes)
    head = ("Campaign", "Runs", "Seconds", "CPU s a run", "CPU ms a frame", "MB a run", "MB a simulated hour", "Hours")
    rows = [] if whole is None else [cost_row("all of it, a process for each core", whole)]
    rows += [cost_row(f"`--workers {workers}`", cost) for workers, cost in pair.items()]
    again = layers["detections"].median_s / (layers["truth"].median_s + layers["detections"].median_s)
    lines = [
        "# What a campaign costs",
        "",
        "Written by `python -m benchmarks.campaign_costs`; do not edit.",
        "",
        f"- Processor: {machine['processor']}, {len(os.sched_getaffinity(0))} cores",
    ]
    if load > BUSY_LOAD:
        lines.append(f"- **The machine was not idle: a load of {load:.1f} before it began.**")
    lines += [
        "",
        "`benchmarks/thousand.yaml`: `harbour`, whose thirty vessels move in the waves, two wave levels, two miss "
        "rates, two trackers and 125 seeds; 300 steps a run. It is run by `modsim3d campaign run`. Megabytes "
        "are those of all files of its folder: rows, plan, log and verdicts, without layers that `keep` would name.",
        "",
        table(head, rows),
        "",
        pair_text(pair[1], pair[2], same),
        "",
        "## Layers",
        "",
        f"Processor time in one process, over {runs:,} runs. Runs with the same truth, or the same detections, make "
        "them once.",
        "",
        layer_table(layers, runs),
        "",
        f"Detections over a truth that is there cost {again:.0%} of truth and detections.",
        "",
        "## A task",
        "",
        f"- An empty Dask task that carries a real one ({task.bytes / 1e3:.1f} kB), scheduler and two workers in "
        f"processes of their own on the loopback, {amount.tasks:,} tasks: {1e3 * task.wall_s:.2f} ms by the clock, "
        f"{1e3 * task.scheduler_s:.2f} ms of the scheduler's processor, {1e3 * task.client_s:.2f} ms of the command's.",
        f"- The command itself, which cuts, hands out, reads the rows back and looks at them, with {more.runs:,} runs "
        f"in {more.tasks:,} tasks whose rows are there at once: {1e3 * more.handing_s / more.tasks:.2f} ms a task "
        f"({1e3 * fewer.handing_s / fewer.tasks:.2f} ms with {fewer.runs:,} runs).",
        f"- The data set and the verdicts at the end: {1e3 * more.gathering_s / more.runs:.3f} ms a run; "
        f"{more.results_bytes / more.runs:.0f} bytes a row in {more.results_files} files; at most "
        f"{more.peak_bytes / MB:,.0f} MB of memory ({fewer.peak_bytes / MB:,.0f} MB with {fewer.runs:,} runs).",
        "",
        f"## {MILLION:,} runs on {CORES:,} cores, on paper",
        "",
        "Worked out from the figures above, as if all cores were like this one and storage kept up; never run.",
        "",
        Million(run_s, task, fewer, more).text(),
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a trial: little work, written nowhere")
    parser.add_argument("--out", type=Path, metavar="DIR", help="where the folder of the 1,000 runs stays")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="modsim3d-campaigns-") as folder:
        text = page(QUICK if arguments.quick else FULL, arguments.out, Path(folder), arguments.quick)
    print(text)
    if not arguments.quick:
        RESULTS.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
