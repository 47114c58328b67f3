"""Every command that writes, so that what holds for all of them is tested for all of them."""

from collections.abc import Callable
from pathlib import Path

from tests.campaign.small_campaign import small_campaign


def scene_file(run: Path) -> Path:
    """The scene in the copy that a run keeps."""
    (path,) = (path for path in (run / "scene").glob("*.json") if path.name not in ("vessels.json", "poses.json"))
    return path


SHORT = ("--kind", "ids", "--end", 1)
QUICK = ("--replicates", 20, "--without", "persistence")
"""Options of `learn` for tests of what becomes of files, not of what is learned."""


def voyage(run: Path) -> tuple[object, ...]:
    return ("learn-voyage", scene_file(run), "--detections", run, "--match", "centre", *QUICK, "--fixed", "all")


def labelled(run: Path) -> tuple[object, ...]:
    truth, detector = run.parent / "coco" / "gt.json", run / "scene" / "detector.yaml"
    return ("detect", "--truth", truth, "--detector", detector)


def guess(run: Path) -> tuple[object, ...]:
    conditions = ("--from-condition", "noon_clear", "--to-condition", "foggy_cloudy")
    return ("learn", "--detector", run / "scene" / "detector.yaml", *conditions)


def report_file(run: Path) -> Path:
    report = run.parent / "report.yaml"
    report.write_text("labels: [boat]\nprecision: 0.9\nrecall: 0.8\n", encoding="utf-8")
    return report


Line = Callable[[Path, Path], tuple[object, ...]]
"""A command line, given a run directory and the file to write."""
WRITERS: dict[str, tuple[str, Line]] = {
    "report": ("page.html", lambda run, out: ("report", run, "--out", out)),
    "export: rerun": ("run.rrd", lambda run, out: ("export", run, "--format", "rerun", "--out", out.parent)),
    "check run": ("verify.json", lambda run, out: ("check", "run", run, "--out", out.parent)),
    "check scene": ("map.png", lambda run, out: ("check", "scene", scene_file(run), "--map", out)),
    "check truth": ("compare.html", lambda run, out: ("check", "truth", scene_file(run), "--out", out.parent)),
    "export": ("dt.json", lambda run, out: ("export", run, "--format", "coco", "--out", out.parent)),
    "export: ais": ("ais.nmea", lambda run, out: ("export", run, "--format", "ais", "--out", out.parent)),
    "export: mot": ("frames.csv", lambda run, out: ("export", run, "--format", "mot", "--out", out.parent)),
    "export: yolo": ("data.yaml", lambda run, out: ("export", run, "--format", "yolo", "--out", out.parent)),
    "track": ("tracks.parquet", lambda run, out: ("track", run, "--out", out.parent)),
    "score": ("score.json", lambda run, out: ("score", run, run.parent / "tracks.csv", "--out", out.parent)),
    "campaign table": ("means.csv", lambda run, out: ("campaign", "table", small_campaign(run.parent), "--out", out)),
    "campaign report": ("page.html", lambda run, out: ("campaign", "report", small_campaign(run.parent), "--out", out)),
    "learn": ("detector.yaml", lambda run, out: ("learn", run, *QUICK, "--no-check", "--out", out)),
    "learn-voyage": ("detector.yaml", lambda run, out: (*voyage(run), "--out", out)),
    "learn-voyage: written scene": (
        "detector.yaml",
        lambda run, out: (*voyage(run), "--out", out.with_name("d.yaml"), "--write-scene", out.parent),
    ),
    "learn: page": ("d.html", lambda run, out: ("learn", run, *QUICK, "--no-check", "--out", out.with_name("d.yaml"))),
    "learn: guess": ("guess.yaml", lambda run, out: (*guess(run), "--out", out)),
    "learn: figures": ("reported.yaml", lambda run, out: ("learn", "--from-figures", report_file(run), "--out", out)),
    "view frame": ("picture.png", lambda run, out: ("view", "frame", run, 3, "--width", 160, "--out", out)),
    "view map": ("map.png", lambda run, out: ("view", "map", run, "--width", 160, "--out", out)),
    "view film": ("film.gif", lambda run, out: ("view", "film", run, *SHORT, "--width", 160, "--out", out)),
}
"""Those that write files, by the command: the name of a file that it writes, and its command line."""
TRACKS = "step,track,x_min_px,y_min_px,x_max_px,y_max_px\n5,1,100,100,120,110\n"
"""Tracks of somebody's own, which `score` reads from `tracks.csv` beside the run."""
INPUTS: dict[str, Callable[[Path], Path]] = {
    "check scene": scene_file,
    "check truth": scene_file,
    "learn: guess": lambda run: run / "scene" / "detector.yaml",
    "learn: figures": report_file,
    "campaign table": lambda run: small_campaign(run.parent) / "plan.json",
    "campaign report": lambda run: small_campaign(run.parent) / "plan.json",
}
"""A file in the run that a command reads which does not read the run itself."""
FOLDER_WRITERS = ("run", "detect", "ais", "campaign reproduce")
"""Those that write a folder of their own, which they alone recognise."""
NO_DEFAULT = ("check scene", "check truth", "score", "campaign table", "campaign report")
CONTINUING = ("campaign run",)
"""Those that go on with a folder of their own and never replace one, so that they have no `--overwrite`."""
INTO_RUNS = ("view sheet",)
"""Those that write into the run that they are given, and nowhere else."""
NO_WRITERS = ("scenes", "check repeat", "stream", "campaign status", "campaign plan")
DEFAULTS: dict[str, tuple[tuple[str, ...], Callable[[Path], tuple[object, ...]]]] = {
    "report": (("report.html",), lambda run: ("report", run)),
    "check run": (("verify.json", "verify.html"), lambda run: ("check", "run", run)),
    "check run: out": (("verify.json", "verify.html"), lambda run: ("check", "run", run, "--out", run)),
    "view frame": (("ids_000003.png",), lambda run: ("view", "frame", run, 3, "--kind", "ids")),
    "view map": (("map_000039.png",), lambda run: ("view", "map", run)),
    "view film": (("ids.gif",), lambda run: ("view", "film", run, *SHORT, "--format", "gif")),
    "view film: frames": (
        ("corners/frame_000000.png",),
        lambda run: ("view", "film", run, "--kind", "corners", "--end", 1, "--format", "png"),
    ),
    "view sheet": (("contact_sheet.png",), lambda run: ("view", "sheet", run)),
}
"""What a command writes into the run directory unless told otherwise."""
READ = {"scene", "campaign", "run", "other", "truth", "detections", "detector", "sequence", "files", "tracks"}
READ |= {"pictures", "images", "attitude", "like", "runs", "from_figures"}
"""Parameters that name what is read."""
WRITTEN = {"out", "cache", "write_scene"}
"""Parameters that name what is written."""
