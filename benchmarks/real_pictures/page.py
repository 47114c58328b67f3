"""The page docs/real_pictures.md, from the results of the comparison alone."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from benchmarks.real_pictures.compared import THRESHOLD
from benchmarks.real_pictures.sets import DETECTORS
from benchmarks.stand_in.differences import AGREES, verdict
from benchmarks.stand_in.page import table
from benchmarks.stand_in.scores import PICTURE_BINS
from benchmarks.stand_in.words import code, interval, listed, plain, signed, top_rung
from modsim3d.core.text import counted

Results = Mapping[str, Any]
MARGIN = 0.03
"""Of the mean HOTA, fixed before the films that were kept were scored."""
TITLES = {
    **{name: f"Cars by {each.name}" for name, each in DETECTORS.items()},
    "fvessel": "Vessels on a river",
    "tud": "People in two short films",
}
PARTS = {
    "judged": "films that were kept for the end",
    "halves": "films that were learned from in halves, each compared on the other half",
    "blocks": "blocks of a minute, of which every second one was learned from for the others",
}
SOURCES = (
    "KITTI's tracking films (Geiger, Lenz & Urtasun (2012)): 21 films of a driving car's camera at 10 Hz, 8,008 "
    "images. Labels and the detections of RRC (Ren et al. (2017)) are in the public repository "
    "wangxiyang2022/DeepFusionMOT, `evaluation/KITTI/data/gt/label_02` and `data/detections/2D/rrc`; those of YOLOv3 "
    "(Redmon & Farhadi (2018)) in its history, at commit 832ab540, `data/detections/2D/yolov3`. Their licence allows "
    "no commercial use, so only numbers worked out from them are here. RRC was trained on a part of these films, so it "
    "looks better in them than elsewhere.",
    "FVessel's Video-01 (Guo et al. (2023); gy65896/FVessel, MIT): a river seen from a bridge, 620 s at 1 Hz, five "
    "vessels. Its published detections are its tracker's boxes, without confidences: no claim is made on identity "
    "switches.",
    "TUD-Campus and TUD-Stadtmitte of MOT15 (Leal-Taixé et al. (2015)): people in streets, 71 and 179 images at 25 Hz. "
    "The labels are in the Python package `motmetrics`, the detections of a Faster R-CNN in the public repository "
    "abewley/sort, `data/train`.",
)
HOW = (
    "Cars are targets, vans are ignored, and regions that nobody labelled (`DontCare`) count for nothing where half "
    "of a box lies in them. A car's class of occlusion stands for 1, 0.7 and 0.3 of it, and an unknown one for what "
    f"other boxes cover. Detections count from a confidence of {THRESHOLD:g} on, real and simulated. Trackers have the "
    "settings that ship. A film is the unit of every interval (95 %, Student's t), and seeds of the simulated detector "
    "are nested in it. Equivalence is said only where the whole interval lies within the margin."
)


def page(results: Results) -> str:
    """The page."""
    lines = ["# Is it a good stand-in on real pictures?", "", _opening(results), "", HOW, ""]
    for name, title in TITLES.items():
        for part, said in PARTS.items():
            if part in results.get(name, {}):
                lines += _section(f"{title}: {said}", results[name][part], switches=name != "fvessel")
    lines += ["## Where the data are from", "", *(line for source in SOURCES for line in (source, ""))]
    sums = {name: each["sha256"] for name, each in results.items() if "sha256" in each}
    if sums:
        lines += ["SHA-256 of all files of a folder, one after the other:"]
        lines += table(["", "labels", "detections"], [[TITLES[name], *each.values()] for name, each in sums.items()])
    lines += [
        "## Do it again",
        "",
        "`script/campaign real_pictures --data DIR --judge`, where `DIR` has the folders above, `fvessel/` with "
        "`Video-01_gt_tracking.txt` and `Video-01_re_detection.txt`, and `tud/` with `gt.txt` and `det.txt` in a "
        "folder for each film. The numbers are in "
        "[real_pictures.json](campaigns/real_pictures.json).",
    ]
    return "\n".join(lines).rstrip() + "\n"


def _gaps(found: Results) -> dict[str, Mapping[str, Any]]:
    """The difference of HOTA of each tracker, with all models."""
    return {name: each["hota"] for name, each in found["differences"][top_rung(found)].items()}


def _opening(results: Results) -> str:
    missed, reached = [], []
    for name, title in TITLES.items():
        part = next((part for part in PARTS if part in results.get(name, {})), None)
        if part is None or name not in DETECTORS:
            continue
        gaps = _gaps(results[name][part])
        outside = [each for each, gap in gaps.items() if abs(gap["mean"]) > MARGIN]
        inside = [each for each in gaps if each not in outside]
        shown = [each for each, gap in gaps.items() if _verdict(gap) == AGREES]
        words = [f"outside ±{MARGIN:g} for {listed(code(outside))}"] if outside else []
        words += [f"within ±{MARGIN:g} for {listed(code(inside))}"] if inside else []
        whole = f"the whole interval for {listed(code(shown))}" if shown else "no interval lies wholly within"
        values = listed([f"{signed(gap['mean'], 3)} ± {gap['high'] - gap['mean']:.3f}" for gap in gaps.values()])
        films = len(results[name][part]["films"])
        (missed if outside else reached).append(
            f"**{title}**, {films} {PARTS[part]}: mean HOTA, simulated minus real, is {listed(words)}; {whole} "
            f"({values}, in the order of the table)."
        )
    return " ".join([*missed, *reached]) or "The films that were kept for the end are not scored yet."


def _verdict(gap: Results) -> str:
    return str(verdict(gap["low"], gap["high"], MARGIN)) if gap["low"] is not None else ""


def _section(title: str, found: Results, *, switches: bool) -> Iterator[str]:
    top, trackers = top_rung(found), found["trackers"]
    vessels = sum(film["vessel_frames"] for film in found["films"])
    share = sum(film["found"] for film in found["films"]) / max(vessels, 1)
    yield from (f"## {title}", "")
    yield (
        f"{len(found['films'])} films with {vessels:,} boxes, of which the real detector finds {share:.0%}; "
        f"{found['seeds']} seeds of the simulated one, learned from {counted(found['learned_from'], 'other film')}."
    )
    columns = [("hota", "HOTA", 3), ("deta", "DetA", 3)]
    columns += [("assa", "AssA", 3), ("id_switches", "ID switches", 1)] if switches else []
    rows = []
    for rung in found["rungs"]:
        for tracker in trackers:
            each = found["differences"][rung["name"]][tracker]
            cells = [f"{plain(each[key]['real'], digits)}; {interval(each[key], digits)}" for key, _, digits in columns]
            alike = found["film_correlation"][rung["name"]][tracker]
            cells += [f"{plain(alike['real'], 2)} ({plain(alike['seeds'], 2)})"]
            rows.append([rung["title"] if rung["name"] != top else "all models", f"`{tracker}`", *cells])
    head = [f"{name}: real; simulated − real" for _, name, _ in columns]
    yield from table(["Learned", "Tracker", *head, "films alike (seeds)"], rows)
    order = found["ranking"][top]
    if order["films"]:
        yield f"By mean HOTA: real {' > '.join(order['real'])}; simulated {' > '.join(order['simulated'])}."
    yield from ("", "Recall of tracks, real; simulated − real, by what the labels know:")
    bins = found["bins"][top]
    yield from table(
        ["", *code(trackers)],
        [
            [words, *(_recall(bins[tracker][name]["recall"]) for tracker in trackers)]
            for name, words in PICTURE_BINS
            if bins[trackers[0]][name]["recall"]["low"] is not None
        ],
    )
    yield "HOTA with one part of the detections exchanged, less that of the real detections:"
    yield from table(
        ["Into", "exchanged", *code(trackers)],
        [
            [
                each["into"],
                " and ".join(each["parts"]) or "nothing",
                *(signed(each["trackers"][tracker]["hota"]["mean"], 3) for tracker in trackers),
            ]
            for each in found["exchanged"]
        ],
    )


def _recall(found: Results) -> str:
    return f"{plain(found['real'], 2)}; {interval(found, 2)}" if found["real"] is not None else "–"
