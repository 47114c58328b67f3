"""Every command that writes, so that what holds for all of them is tested for all of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tests.campaign.small_campaign import small_campaign


def scene_file(run: Path) -> Path:
    """The scene in the copy that a run keeps."""
    (path,) = (path for path in (run / "scene").glob("*.json") if path.name not in ("vessels.json", "poses.json"))
    return path


QUICK = ("--replicates", 20, "--without", "persistence")
"""Options of `learn` for tests of what becomes of files, not of what is learned."""
Line = Callable[[Path, Path], tuple[object, ...]]
"""A command line, given a run directory and the file to write."""
WRITERS: dict[str, tuple[str, Line]] = {
    "report": ("page.html", lambda run, out: ("report", run, "--out", out)),
    "rerun": ("run.rrd", lambda run, out: ("rerun", run, "--out", out)),
    "verify": ("verify.json", lambda run, out: ("verify", run, "--out", out.parent)),
    "compare": ("compare.html", lambda run, out: ("compare", scene_file(run), "--out", out.parent)),
    "export": ("dt.json", lambda run, out: ("export", run, "--format", "coco", "--out", out.parent)),
    "export: ais": ("ais.nmea", lambda run, out: ("export", run, "--format", "ais", "--out", out.parent)),
    "export: mot": ("frames.csv", lambda run, out: ("export", run, "--format", "mot", "--out", out.parent)),
    "export: yolo": ("data.yaml", lambda run, out: ("export", run, "--format", "yolo", "--out", out.parent)),
    "detect: truth": (
        "dt.json",
        lambda run, out: (
            *("detect", "--truth", run.parent / "coco" / "gt.json", "--detector", run / "scene" / "detector.yaml"),
            *("--out", out.parent),
        ),
    ),
    "track": ("tracks.parquet", lambda run, out: ("track", run, "--out", out.parent)),
    "score": ("score.json", lambda run, out: ("score", run, run.parent / "tracks.csv", "--out", out.parent)),
    "campaign-table": ("means.csv", lambda run, out: ("campaign-table", small_campaign(run.parent), "--out", out)),
    "campaign-report": ("page.html", lambda run, out: ("campaign-report", small_campaign(run.parent), "--out", out)),
    "learn": ("detector.yaml", lambda run, out: ("learn", "--run", run, *QUICK, "--out", out)),
    "learn: scene": (
        "detector.yaml",
        lambda run, out: (
            *("learn", "--scene", scene_file(run), "--detections", run, "--match", "centre", *QUICK),
            *("--fixed", "all", "--out", out),
        ),
    ),
    "learn: written scene": (
        "detector.yaml",
        lambda run, out: (
            *("learn", "--scene", scene_file(run), "--detections", run, "--match", "centre", *QUICK),
            *("--fixed", "all", "--out", out.with_name("d.yaml"), "--write-scene", out.parent),
        ),
    ),
    "learn: page": (
        "page.html",
        lambda run, out: ("learn", "--run", run, *QUICK, "--out", out.with_name("d.yaml"), "--page", out),
    ),
    "guess": (
        "guess.yaml",
        lambda run, out: (
            *("guess", run / "scene" / "detector.yaml", "--from", "noon_clear", "--to", "foggy_cloudy", "--out", out),
        ),
    ),
    "view: picture": ("picture.png", lambda run, out: ("view", run, "--frame", 3, "--width", 160, "--out", out)),
    "view: map": ("map.png", lambda run, out: ("view", run, "--map", "--width", 160, "--out", out)),
    "view: film": (
        "film.gif",
        lambda run, out: ("view", run, "--film", "ids", "--to", 1, "--width", 160, "--out", out),
    ),
}
"""Those that write files, by the command: the name of a file that it writes, and its command line."""
TRACKS = "step,track,x_min_px,y_min_px,x_max_px,y_max_px\n5,1,100,100,120,110\n"
"""Tracks of somebody's own, which `score` reads from `tracks.csv` beside the run."""
INPUTS: dict[str, Callable[[Path], Path]] = {
    "compare": scene_file,
    "guess": lambda run: run / "scene" / "detector.yaml",
    "campaign-table": lambda run: small_campaign(run.parent) / "plan.json",
    "campaign-report": lambda run: small_campaign(run.parent) / "plan.json",
    "detect: truth": lambda run: run.parent / "coco" / "gt.json",
}
"""A file in the run that a command reads which does not read the run itself."""
FOLDER_WRITERS = ("run", "detect", "ais", "campaign-run")
"""Those that write a folder of their own, which they alone recognise."""
NO_DEFAULT = ("compare", "score", "campaign-table", "campaign-report")
CONTINUING = ("campaign",)
"""Those that go on with a folder of their own and never replace one, so that they have no `--overwrite`."""
NO_WRITERS = ("check", "scenes", "repeat", "stream", "campaign-status")
DEFAULTS: dict[str, tuple[tuple[str, ...], Callable[[Path], tuple[object, ...]]]] = {
    "report": (("report.html",), lambda run: ("report", run)),
    "rerun": (("run.rrd",), lambda run: ("rerun", run)),
    "verify": (("verify.json", "verify.html"), lambda run: ("verify", run)),
    "verify: out": (("verify.json", "verify.html"), lambda run: ("verify", run, "--out", run)),
    "view: picture": (("ids_000003.png",), lambda run: ("view", run, "--film", "ids", "--frame", 3)),
    "view: map": (("map_000039.png",), lambda run: ("view", run, "--map")),
    "view: film": (("ids.gif",), lambda run: ("view", run, "--film", "ids", "--to", 1, "--format", "gif")),
    "view: frames": (
        ("corners/frame_000000.png",),
        lambda run: ("view", run, "--film", "corners", "--to", 1, "--format", "png"),
    ),
    "view: sheet": (("contact_sheet.png",), lambda run: ("view", run, "--sheet")),
}
"""What a command writes into the run directory unless told otherwise."""
READ = {
    *("scene", "campaign", "run", "other", "truth", "detections", "detector", "sequence", "files", "tracks"),
    *("images", "attitude", "like"),
}
"""Parameters that name what is read."""
WRITTEN = {"out", "page", "cache", "write_scene"}
"""Parameters that name what is written."""
