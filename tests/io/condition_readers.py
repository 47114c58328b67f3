"""Readers of foreign files, each with a small file that is right."""

import math
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from pyais import encode_dict
from pyarrow import csv as pa_csv

import modsim3d
from modsim3d import LogOptions, RunRows, StoredRun, read_tracks, read_world_tracks
from modsim3d.formats.reading.builder import ReadOptions
from modsim3d.formats.reading.pair import read_pair, read_truth
from modsim3d.io.ros_bag import ODOMETRY
from modsim3d.learn.voyage.attitude import read_attitude
from modsim3d.learn.voyage.labelled_voyage import VoyageOptions, labelled_voyage
from modsim3d.learn.voyage.log_to_scene import NO_CORRECTION, on_scene
from modsim3d.learn.voyage.logs.reading import read_log
from modsim3d.scene.ais.options import Options
from modsim3d.scene.ais.scene_folder import warning
from modsim3d.scene.ais.traffic import read_traffic
from tests.formats.labelled_files import CHANGES, HEIGHT, WIDTH, Video, coco, mot, yolo
from tests.learn.voyage.test_logs_as_written import bag
from tests.scene.ais.ais_builders import OLD_HEADER
from tests.tracks.test_world_tracks import odometry, write_bag
from tests.tracks.track_files import CROSSER, PLACES_M, TIMES_S, VELOCITIES_M_S, detected_tracks, sea_run, top_left

Row = dict[str, str]
Reading = tuple[Any, tuple[str, ...]]
"""What was read, and the notes."""
BOX = ("x", "y", "w", "h")
STEP_S, START_UNIX_S = 0.2, 1_704_362_400
VIDEO = Video.of()


@dataclass(frozen=True)
class Reader:
    """A reader of foreign files."""

    rows: tuple[Row, ...]  # the right file, in raw text by role; constant columns are part of the form
    form: Callable[[tuple[Row, ...]], str]  # rows to text
    read: Callable[[Path], Reading]  # a file in a folder
    size: tuple[float, float] = (WIDTH, HEIGHT)  # of the images, 1 where boxes are shares
    separator: str = ","  # between the cells; empty in JSON
    name: str = "file.txt"
    text: bool = True  # others are made of the text when they are read
    boxes: str = "right"  # corner and size, corners, or centre and size

    @property
    def roles(self) -> frozenset[str]:
        return frozenset(self.rows[0])


def columns(names: str, header: str = "", separator: str = ",") -> Callable[[tuple[Row, ...]], str]:
    """A line for each row, of roles by their names and of constants, after a line with the names of columns."""
    parts = names.split()

    def form(rows: tuple[Row, ...]) -> str:
        lines = [separator.join(row.get(part, part) for part in parts) for row in rows]
        return "\n".join([*([header] if header else []), *lines, ""])

    return form


def video_rows(boxes: np.ndarray[Any, Any], first_px: float = 0, **more: Callable[[int, int], str]) -> tuple[Row, ...]:
    """A row for each box of the video, with its frame and identity."""
    rows = []
    for k, j in np.ndindex(boxes.shape[:2]):
        sides = (boxes[k, j] + np.array([first_px, first_px, 0, 0])).round(3).tolist()
        others = {role: of(k, j) for role, of in more.items()}
        rows.append({"frame": str(k + 1), "id": str(j + 1), **dict(zip(BOX, map(repr, sides), strict=True)), **others})
    return tuple(rows)


def labelled(which: int, files: Callable[[Path], Any], alone: bool = False) -> Callable[[Path], Reading]:
    """Reads a pair of files of which one is given, or that of the truth alone."""
    files = cache(files)

    def read(path: Path) -> Reading:
        content = path.read_bytes()
        pair = list(files(path.parent))
        assert pair[which] == path
        path.write_bytes(content)
        found = read_truth(path)[0] if alone else read_pair("day", *pair, ReadOptions())
        left_out = [f"{found.annotations.ignored.sum()} are left out"] * alone  # which detect says
        return (found.labels, found.annotations, found.results, len(found.images)), (*found.notes, *left_out)

    return read


def coco_truth(rows: tuple[Row, ...]) -> str:
    images = ",".join(f'{{"id": {k + 1}, "width": {WIDTH}, "height": {HEIGHT}}}' for k in range(len(VIDEO.true)))
    kinds = ",".join(f'{{"id": {k + 1}, "name": "{name}"}}' for k, name in enumerate(("boat", "sailboat", "ship")))
    entry = (
        '{{"id": {n}, "image_id": {image}, "category_id": {class}, "track_id": {id}, "iscrowd": {flag}, "bbox": {b}}}'
    )
    each = (entry.format(n=n, b="[{x},{y},{w},{h}]".format(**row), **row) for n, row in enumerate(rows))
    return f'{{"images": [{images}], "categories": [{kinds}], "annotations": [{",".join(each)}]}}'


def by_time(rows: tuple[Row, ...], entry: str) -> list[tuple[str, str]]:
    """Each time of the rows, with the entries of its rows, which are made of a form, and commas between."""
    times: dict[str, list[str]] = {}
    for n, row in enumerate(rows):
        times.setdefault(row["time"], []).append(entry.format(n=n, box=",".join(row[role] for role in BOX), **row))
    return [(time, ", ".join(entries)) for time, entries in times.items()]


def coco_found(rows: tuple[Row, ...]) -> str:
    entry = '{{"image_id": {image}, "category_id": {class}, "score": {score}, "bbox": [{x},{y},{w},{h}]}}'
    return f"[{','.join(entry.format(**row) for row in rows)}]"


def log_lines(rows: tuple[Row, ...]) -> str:
    entry = '{{"box_px": [{box}], "label": {label}, "confidence": {score}}}'
    return "".join(f'{{"time_s": {time}, "detections": [{boxes}]}}\n' for time, boxes in by_time(rows, entry))


def all_readers(folder: Path) -> dict[str, Reader]:
    """All readers by name; those of tracks have their run in a folder."""
    right = CHANGES["right"]
    score = lambda k, j: f"{0.3 + 0.6 * ((7 * k + j) % 10) / 10:g}"  # noqa: E731
    kind = lambda k, j: str(j % 3 + 1)  # noqa: E731
    image = lambda k, j: str(k + 1)  # noqa: E731
    mot_files = lambda folder: mot(folder, VIDEO)  # noqa: E731
    coco_files = lambda folder: coco(folder, VIDEO, right, right)  # noqa: E731
    found = {
        "MOT truth": Reader(
            video_rows(VIDEO.true, 1.0, flag=lambda k, j: "1", visible=lambda k, j: f"{0.5 + j / 20:g}"),
            columns("frame id x y w h flag 1 visible"), labelled(0, mot_files), name="gt.txt",
        ),
        "MOT classes": Reader(
            video_rows(VIDEO.true, 1.0, **{"class": kind}), columns("frame id x y w h 1 class 1"),
            labelled(0, lambda folder: mot(folder, VIDEO, found_tail="0.9,1,-1,-1")), name="gt.txt",
        ),
        "MOT detections": Reader(
            video_rows(VIDEO.found, 1.0, score=score), columns("frame -1 x y w h score -1 -1 -1"),
            labelled(1, mot_files), name="det.txt",
        ),
        "COCO truth": Reader(
            video_rows(VIDEO.true, flag=lambda k, j: "0", image=image, **{"class": kind}), coco_truth,
            labelled(0, coco_files), separator="", name="gt.json",
        ),
        "COCO detections": Reader(
            video_rows(VIDEO.found, score=score, image=image, **{"class": kind}), coco_found, labelled(1, coco_files),
            separator="", name="dt.json",
        ),
    }  # fmt: skip
    for form, files in (("MOT", mot_files), ("COCO", coco_files)):
        found[f"{form} truth alone"] = replace(found[f"{form} truth"], read=labelled(0, files, alone=True))
    still = Video(*(np.repeat(boxes[:1], 12, axis=0) for boxes in (VIDEO.true, VIDEO.found)))
    still_files = cache(lambda folder: yolo(folder, still))

    def yolo_read(which: int) -> Callable[[Path], Reading]:
        def read(path: Path) -> Reading:
            pair = still_files(path.parent)
            for k in range(len(still.true)):  # the same in all images, so that what is odd is odd everywhere
                (pair[which] / ("", "labels")[which == 0] / f"{k:03}.txt").write_bytes(path.read_bytes())
            found = read_pair("day", *pair, ReadOptions(image_size_px=(WIDTH, HEIGHT)))
            return (found.labels, found.annotations, found.results), tuple(found.notes)

        return read

    for which, name in enumerate(("labels", "detections")):
        shares = [CHANGES["shares"](*CHANGES["centres"](*box)) for box in (still.true, still.found)[which][0]]
        texts = [dict(zip(BOX, (f"{n:.8f}" for n in of), strict=True)) for of in shares]
        scores = [{"score": score(0, j)} if which else {} for j in range(len(texts))]
        rows = tuple({"class": str(j % 3)} | text | scores[j] for j, text in enumerate(texts))
        line = columns("class x y w h" + " score" * which, separator=" ")
        found[f"YOLO {name}"] = Reader(rows, line, yolo_read(which), (1.0, 1.0), " ", boxes="centres")
    run = sea_run(folder / "run")
    found |= voyage_readers(run)
    found |= track_readers(run)
    found["AIS table"] = Reader(
        tuple(
            {"id": f"2190{12345 + 1111 * vessel}", "time": f"2024-01-04T10:{k:02d}:00",
             "latitude": f"{56 + 0.002 * k:.4f}", "longitude": f"{12 + 0.01 * vessel + 0.001 * k:.4f}",
             "speed": "8.0", "heading": "16.0"}
            for k in range(20) for vessel in range(6)
        ),
        columns("id time latitude longitude speed heading heading X 0 call 70 0 100 20 5 0 A", OLD_HEADER),
        ais_read, name="old.csv",
    )  # fmt: skip
    found["AIS sentences"] = Reader(
        tuple(
            {"unix": str(START_UNIX_S + 60 * k + 7 * vessel),
             "sentence": encode_dict({
                 "type": 1, "mmsi": 219012345 + 1111 * vessel, "lat": 56 + 0.002 * k, "second": 7 * vessel,
                 "lon": 12 + 0.01 * vessel + 0.001 * k, "speed": 8.0, "course": 16.0, "heading": 16,
             })[0]}
            for k in range(20) for vessel in range(6)
        ),
        columns("unix sentence", separator=" "), ais_read, separator="", name="log.nmea",
    )  # fmt: skip
    return found


def ais_read(path: Path) -> Reading:
    traffic = read_traffic([path], Options())
    vessels = [(each.mmsi, each.reported_s, each.places_m, each.headings_rad) for each in traffic.vessels]
    left_out = [f"{reason}: {count}" for reason, count in traffic.dropped.items()]
    filled = [f"{what}: {count}" for each in traffic.vessels for what, count in each.replaced.items()]
    return (traffic.origin, traffic.grid.start_s, vessels), tuple(filter(None, [warning(traffic), *left_out, *filled]))


def thesis_log(of: tuple[Row, ...]) -> str:
    box = '{{"centre": {{"x": {x}, "y": {y}}}, "width": {w}, "height": {h}}}'
    entry = f'"{{n}}": {{{{"label": {{label}}, "confidenceScore": {{score}}, "bbox": {box}}}}}'
    return "{" + ", ".join(f'"{time}": {{{each}}}' for time, each in by_time(of, entry)) + "}"


def coco_log(of: tuple[Row, ...]) -> str:
    times = list(dict.fromkeys(row["time"] for row in of))
    images = ", ".join(f'{{"id": {k}, "time_s": {time}}}' for k, time in enumerate(times))
    each = coco_found(tuple(row | {"image": str(times.index(row["time"]))} for row in of))
    kinds = f'[{{"id": {of[0]["class"]}, "name": {of[0]["label"]}}}]'
    return f'{{"images": [{images}], "annotations": {each}, "categories": {kinds}}}'


def parquet(path: Path) -> Path:
    pq.write_table(pa_csv.read_csv(path), path.with_suffix(".parquet"))
    return path.with_suffix(".parquet")


def ros_log(path: Path) -> Path:
    frames: dict[float, list[tuple[Any, ...]]] = {}
    for line in path.read_text().splitlines()[1:]:
        time, *numbers, name, score = line.split(",")
        frames.setdefault(float(time), []).append((*map(float, numbers), name, float(score)))
    shutil.rmtree(path.parent / "bag", ignore_errors=True)
    return bag(path.parent / "bag", ("/bow/detections",), frames=frames)


def voyage_readers(run: StoredRun) -> dict[str, Reader]:
    """Logs of the camera of a run, which are held against its vessels, and the attitude of own ship."""
    scene, tracks = run.scene, detected_tracks(RunRows.of(run))
    size, (label, *_) = scene.cameras[0].intrinsics.image_size_px, scene.detector.labels

    def log(convert: Callable[[Path], Path] = lambda path: path, **options: Any) -> Callable[[Path], Reading]:
        def read(path: Path) -> Reading:
            read_on_scene = on_scene(read_log(convert(path), LogOptions(**options)), scene)
            found = labelled_voyage(read_on_scene, VoyageOptions(NO_CORRECTION)).labelled
            return (found.labels, found.images.time_s, found.annotations, found.results), tuple(found.notes)

        return read

    def rows(change: str, first_px: float = 0.0, mark: str = "") -> tuple[Row, ...]:
        return tuple(
            {"time": f"{step * 0.5:g}", "label": f"{mark}{label}{mark}",
             "score": f"{0.35 + 0.02 * (n % 25):g}"}
            | {role: f"{number + first_px * (role in 'xy'):.9g}"
               for role, number in zip(BOX, CHANGES[change](*four), strict=True)}
            for n, (step, four) in enumerate(zip(tracks.step.tolist(), top_left(tracks.boxes_px).tolist(), strict=True))
        )  # fmt: skip

    table = columns("time x y w h label score", "time_s,left,top,width,height,label,score")
    logs = {
        "log CSV": Reader(rows("right"), table, log(frame_rate_hz=2), size, name="log.csv"),
        "log Parquet": Reader(rows("right"), table, log(parquet, frame_rate_hz=2), size, name="log.csv", text=False),
        "log lines": Reader(rows("corners", mark='"'), log_lines, log(), size, "", "log.jsonl", boxes="corners"),
        "log thesis": Reader(rows("centres", mark='"'), thesis_log, log(), size, "", "log.json", boxes="centres"),
        "log COCO": Reader(
            tuple(row | {"class": "1"} for row in rows("right", mark='"')), coco_log, log(), size, "", "log.json"
        ),
        "log ROS bag": Reader(rows("centres"), table, log(ros_log), size, name="ros.csv", text=False, boxes="centres"),
        "log MOT": Reader(
            tuple(
                {"frame": f"{2 * float(row['time']) + 1:g}", **{role: row[role] for role in (*BOX, "score")}}
                for row in rows("right", 1.0)
            ),
            columns("frame -1 x y w h score 1"), log(frame_rate_hz=2, labels=(label,)), size, name="log.txt",
        ),
    }  # fmt: skip
    return logs | {"attitude": attitude_reader()}


def attitude_reader() -> Reader:
    """The attitude of own ship in the strait."""
    scene = modsim3d.load_scene("strait")

    def attitude(path: Path) -> Reading:
        read = read_attitude(path, scene)
        return (read.time_s, read.angles_rad), ()

    times = scene.times_s(0, 100)
    headings = scene.poses.poses(0, 100).headings_rad[:, scene.own_ships[0]]
    return Reader(
        tuple(
            {"time": f"{t:.3f}", "roll": f"{0.02 * math.sin(t):.6f}", "pitch": f"{0.01 * math.cos(t):.6f}",
             "heading": f"{h:.6f}"}
            for t, h in zip(times, headings, strict=True)
        ),
        columns("time roll pitch heading", "time_s,roll_rad,pitch_rad,heading_rad"), attitude, name="attitude.csv",
    )  # fmt: skip


def track_readers(run: StoredRun) -> dict[str, Reader]:
    """Tracks in the images of a run of one camera, and tracks on the sea."""
    rows = RunRows.of(run)
    tracks = detected_tracks(rows)
    boxes = np.round(top_left(tracks.boxes_px), 3)

    def of(first_px: float, corners: bool) -> tuple[Row, ...]:
        numbers = tracks.boxes_px if corners else boxes + np.array([first_px, first_px, 0, 0])
        return tuple(
            {"frame": str(step + (0 if corners else 1)), "time": f"{step * 0.5:g}", "id": str(track + 7),
             **{role: repr(round(float(n), 3)) for role, n in zip(BOX, four, strict=True)}}
            for step, track, four in zip(tracks.step, tracks.track, numbers, strict=True)
        )  # fmt: skip

    def image(path: Path) -> Reading:
        read = read_tracks(path, run, rows).tracks
        return (read.frame, read.track, read.boxes_px), ()

    def world(path: Path) -> Reading:
        read = read_world_tracks(path, run)
        return (read.time_s, read.track, read.position_m, read.velocity_m_s), ()

    def ros(path: Path) -> Reading:
        messages = []
        for line in path.read_text().splitlines()[1:]:
            time, name, *numbers = line.split(",")
            w1, w2, v1, v2 = map(float, numbers)
            messages.append(odometry(float(time), name, np.array([w1, w2]), np.array([v1, v2])))
        shutil.rmtree(path.parent / "bag", ignore_errors=True)
        return world(write_bag(path.parent / "bag", {"/tracks": (ODOMETRY, messages)}))

    names, size = "camera,{},track,x_min_px,y_min_px,x_max_px,y_max_px", (1280, 720)
    by_step = columns("bow frame id x y w h", names.format("step"))
    by_time = columns("bow time id x y w h", names.format("time_s"))
    on_the_sea = columns("time id w1 w2 v1 v2", "time_s,track,w1_m,w2_m,v1_m_s,v2_m_s")
    places, speeds = PLACES_M[:, [CROSSER, 3]].reshape(-1, 2), np.tile(VELOCITIES_M_S[[CROSSER, 3]], (len(TIMES_S), 1))
    sea = tuple(
        {"time": f"{TIMES_S[n // 2]:g}", "id": str(n % 2 + 11), "w1": f"{p[0]:.3f}", "w2": f"{p[1]:.3f}",
         "v1": f"{v[0]:.3f}", "v2": f"{v[1]:.3f}"}
        for n, (p, v) in enumerate(zip(places, speeds, strict=True))
    )  # fmt: skip
    return {
        "tracks by step": Reader(of(0, True), by_step, image, size, name="t.csv", boxes="corners"),
        "tracks by time": Reader(of(0, True), by_time, image, size, name="t.csv", boxes="corners"),
        "tracks MOT": Reader(of(1, False), columns("frame id x y w h 1 -1 -1 -1"), image, size, name="bow.txt"),
        "tracks on the sea": Reader(sea, on_the_sea, world, name="w.csv"),
        "tracks in a ROS bag": Reader(sea, on_the_sea, ros, name="w.csv", text=False),
    }
