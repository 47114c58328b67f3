"""Files whose numbers parse but cannot be what their columns say: no reader takes one of them without a word.

Each reader has a small file that is right, as rows of raw text by role. Each condition spoils all values of a role, or
the text of the whole file. The file is then refused, or a note says what is odd, or what was meant is read.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import modsim3d
from modsim3d.core.errors import ModsimError
from modsim3d.formats.reading.builder import ReadOptions
from modsim3d.formats.reading.pair import read_pair
from modsim3d.learn.voyage.attitude import read_attitude
from modsim3d.learn.voyage.log_to_scene import on_scene
from modsim3d.learn.voyage.logs.log import LogOptions
from modsim3d.learn.voyage.logs.reading import read_log
from modsim3d.runs.run_rows import RunRows
from modsim3d.scene.ais.options import Options
from modsim3d.scene.ais.report import warning
from modsim3d.scene.ais.traffic import read_traffic
from modsim3d.tracks.reading import read_tracks
from modsim3d.tracks.world_reading import read_world_tracks
from tests.formats.labelled_files import CHANGES, HEIGHT, WIDTH, Video, coco, mot, yolo
from tests.scene.ais.ais_builders import OLD_HEADER
from tests.tracks.sea_runs import CROSSER, PLACES_M, TIMES_S, VELOCITIES_M_S, sea_run
from tests.tracks.track_files import detected_tracks, top_left

Row = dict[str, str]
Reading = tuple[Any, tuple[str, ...]]
"""What was read, and the notes."""
BOX = ("x", "y", "w", "h")
STEP_S, START_UNIX_S = 0.2, 1_704_362_400
VIDEO = Video.of()


@dataclass(frozen=True)
class Reader:
    """A reader of foreign files.

    Attributes:
        rows: The right file, in raw text by role; constant columns are part of the form.
        form: Row or rows to text.
        read: Reads a file in a folder.
        size: Width and height of the images, 1 where boxes are shares.
        separator: Between the cells; empty in JSON.
        name: Of the file.
    """

    rows: tuple[Row, ...]
    form: Callable[[tuple[Row, ...]], str]
    read: Callable[[Path], Reading]
    size: tuple[float, float] = (WIDTH, HEIGHT)
    separator: str = ","
    name: str = "file.txt"
    roles: frozenset[str] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "roles", frozenset(self.rows[0]))


def columns(names: str, header: str = "", separator: str = ",") -> Callable[[tuple[Row, ...]], str]:
    """A line for each row, of roles by their names and of constants, after a line with the names of columns."""
    parts = names.split()

    def form(rows: tuple[Row, ...]) -> str:
        lines = [separator.join(row.get(part, part) for part in parts) for row in rows]
        return "\n".join([*([header] if header else []), *lines, ""])

    return form


def video_rows(
    boxes: np.ndarray[Any, Any], first_px: float = 0.0, **more: Callable[[int, int], str]
) -> tuple[Row, ...]:
    """A row for each box of the video, with its frame and identity."""
    return tuple(
        {
            "frame": str(k + 1),
            "id": str(j + 1),
            **{
                role: repr(round(float(n) + (first_px if role in "xy" else 0), 3))
                for role, n in zip(BOX, boxes[k, j], strict=True)
            },
            **{role: of(k, j) for role, of in more.items()},
        }
        for k in range(len(boxes))
        for j in range(boxes.shape[1])
    )


def labelled(which: int, files: Callable[[Path], Any], **options: Any) -> Callable[[Path], Reading]:
    """Reads a pair of files of which one is given."""

    def read(path: Path) -> Reading:
        content = path.read_bytes()
        pair = list(files(path.parent))
        assert pair[which] == path
        path.write_bytes(content)
        found = read_pair("day", *pair, ReadOptions(**options))
        return (found.labels, found.annotations, found.results, len(found.images)), tuple(found.notes)

    return read


def coco_truth(rows: tuple[Row, ...]) -> str:
    images = ",".join(f'{{"id": {k + 1}, "width": {WIDTH}, "height": {HEIGHT}}}' for k in range(len(VIDEO.true)))
    kinds = ",".join(f'{{"id": {k + 1}, "name": "{name}"}}' for k, name in enumerate(("boat", "sailboat", "ship")))
    each = ",".join(
        f'{{"id": {n}, "image_id": {row["frame"]}, "category_id": {row["class"]}, "track_id": {row["id"]}, '
        f'"iscrowd": {row["flag"]}, "bbox": [{",".join(row[role] for role in BOX)}]}}'
        for n, row in enumerate(rows)
    )
    return f'{{"images": [{images}], "categories": [{kinds}], "annotations": [{each}]}}'


def coco_found(rows: tuple[Row, ...]) -> str:
    each = (
        f'{{"image_id": {row["frame"]}, "category_id": {row["class"]}, "score": {row["score"]}, '
        f'"bbox": [{",".join(row[role] for role in BOX)}]}}'
        for row in rows
    )
    return f"[{','.join(each)}]"


def log_lines(rows: tuple[Row, ...]) -> str:
    frames: dict[str, list[str]] = {}
    for row in rows:
        box = f'"box_px": [{",".join(row[role] for role in BOX)}]'
        frames.setdefault(row["time"], []).append(f'{{{box}, "label": {row["label"]}, "confidence": {row["score"]}}}')
    return "".join(f'{{"time_s": {time}, "detections": [{",".join(boxes)}]}}\n' for time, boxes in frames.items())


@pytest.fixture(scope="module")
def readers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Reader]:
    """All readers by name."""
    right = CHANGES["right"]
    score = lambda k, j: f"{0.3 + 0.6 * ((7 * k + j) % 10) / 10:g}"  # noqa: E731
    kind = lambda k, j: str(j % 3 + 1)  # noqa: E731
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
            video_rows(VIDEO.true, flag=lambda k, j: "0", **{"class": kind}), coco_truth, labelled(0, coco_files),
            separator="", name="gt.json",
        ),
        "COCO detections": Reader(
            video_rows(VIDEO.found, score=score, **{"class": kind}), coco_found, labelled(1, coco_files),
            separator="", name="dt.json",
        ),
    }  # fmt: skip
    still = Video(*(np.repeat(boxes[:1], len(VIDEO.true), axis=0) for boxes in (VIDEO.true, VIDEO.found)))
    shares = [CHANGES["shares"](*CHANGES["centres"](*box)) for box in still.true[0]]
    rows = tuple(
        {"class": str(j % 3), **{role: f"{n:.8f}" for role, n in zip(BOX, share, strict=True)}}
        for j, share in enumerate(shares)
    )

    def yolo_read(path: Path) -> Reading:
        truth, detections = yolo(path.parent, still)
        for k in range(len(still.true)):  # the same in all images, so that what is odd is odd everywhere
            (truth / "labels" / f"{k:03}.txt").write_bytes(path.read_bytes())
        found = read_pair("day", truth, detections, ReadOptions(image_size_px=(WIDTH, HEIGHT)))
        return (found.labels, found.annotations, found.results), tuple(found.notes)

    found["YOLO labels"] = Reader(rows, columns("class x y w h", separator=" "), yolo_read, (1.0, 1.0), " ")
    found |= voyage_readers()
    found |= track_readers(tmp_path_factory.mktemp("tracks"))
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
    return found


def ais_read(path: Path) -> Reading:
    traffic = read_traffic([path], Options())
    vessels = [(each.mmsi, each.reported_s, each.places_m, each.headings_rad) for each in traffic.vessels]
    left_out = [f"{reason}: {count}" for reason, count in traffic.dropped.items()]
    filled = [f"{what}: {count}" for each in traffic.vessels for what, count in each.replaced.items()]
    return (traffic.origin, traffic.grid.start_s, vessels), tuple(filter(None, [warning(traffic), *left_out, *filled]))


def voyage_readers() -> dict[str, Reader]:
    """Logs of the bow camera of the strait, and the attitude of own ship."""
    scene = modsim3d.load_scene("strait")
    size = scene.cameras[[each.name for each in scene.cameras].index("bow")].intrinsics.image_size_px
    boxes = [[200.0 + 3 * k + 400 * j, 520.0 + 9 * j, 90.0 - 20 * j, 44.0 - 9 * j] for k in range(30) for j in range(3)]
    rows = tuple(
        {"time": f"{1 + 0.5 * (n // 3):g}", "label": "Vessel",
         "score": f"{0.35 + 0.02 * (n % 25):g}", **{role: f"{n:g}" for role, n in zip(BOX, box, strict=True)}}
        for n, box in enumerate(boxes)
    )  # fmt: skip
    labels = scene.detector.labels

    def log(**options: Any) -> Callable[[Path], Reading]:
        def read(path: Path) -> Reading:
            found = on_scene(read_log(path, LogOptions(**options)), scene, "bow")
            (camera,) = found.cameras
            return (camera.time_s, camera.frame, camera.boxes_px, camera.confidence, camera.label), tuple(found.notes)

        return read

    def attitude(path: Path) -> Reading:
        read = read_attitude(path, scene)
        return (read.time_s, read.angles_rad), ()

    corners = tuple(
        row | {"label": f'"{labels[0]}"'}
        | dict(zip(BOX, (f"{n:g}" for n in CHANGES["corners"](*(float(row[r]) for r in BOX))), strict=True))
        for row in rows
    )  # fmt: skip
    rows = tuple(row | {"label": labels[0]} for row in rows)
    logs = {
        "log CSV": Reader(
            rows, columns("time x y w h label score", "time_s,left,top,width,height,label,score"),
            log(frame_rate_hz=2), size, name="log.csv",
        ),
        "log lines": Reader(corners, log_lines, log(frame_rate_hz=2), size, "", "log.jsonl"),
        "log MOT": Reader(
            tuple(
                {"frame": str(n // 3 + 1), "x": f"{float(row['x']) + 1:g}", "y": f"{float(row['y']) + 1:g}"}
                | {role: row[role] for role in ("w", "h", "score")}
                for n, row in enumerate(rows)
            ),
            columns("frame -1 x y w h score 1"), log(frame_rate_hz=2, labels=(labels[0],)), size, name="log.txt",
        ),
    }  # fmt: skip
    times = scene.times_s(0, scene.steps)[:100]
    own = scene.own_ships[0]
    headings = scene.poses.poses(0, 100).headings_rad[:, own]
    logs["attitude"] = Reader(
        tuple(
            {"time": f"{t:.3f}", "roll": f"{0.02 * math.sin(t):.6f}", "pitch": f"{0.01 * math.cos(t):.6f}",
             "heading": f"{h:.6f}"}
            for t, h in zip(times, headings, strict=True)
        ),
        columns("time roll pitch heading", "time_s,roll_rad,pitch_rad,heading_rad"), attitude, name="attitude.csv",
    )  # fmt: skip
    return logs


def track_readers(folder: Path) -> dict[str, Reader]:
    """Tracks in the images of a run of one camera, and tracks on the sea."""
    run = sea_run(folder / "run")
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

    names = "camera,{},track,x_min_px,y_min_px,x_max_px,y_max_px"
    size = (1280, 720)
    places, speeds = PLACES_M[:, [CROSSER, 3]].reshape(-1, 2), np.tile(VELOCITIES_M_S[[CROSSER, 3]], (len(TIMES_S), 1))
    sea = tuple(
        {"time": f"{TIMES_S[n // 2]:g}", "id": str(n % 2 + 11), "w1": f"{p[0]:.3f}", "w2": f"{p[1]:.3f}",
         "v1": f"{v[0]:.3f}", "v2": f"{v[1]:.3f}"}
        for n, (p, v) in enumerate(zip(places, speeds, strict=True))
    )  # fmt: skip
    return {
        "tracks by step": Reader(
            of(0, True), columns("bow frame id x y w h", names.format("step")), image, size, name="t.csv"
        ),
        "tracks by time": Reader(
            of(0, True), columns("bow time id x y w h", names.format("time_s")), image, size, name="t.csv"
        ),
        "tracks MOT": Reader(of(1, False), columns("frame id x y w h 1 -1 -1 -1"), image, size, name="bow.txt"),
        "tracks on the sea": Reader(
            sea, columns("time id w1 w2 v1 v2", "time_s,track,w1_m,w2_m,v1_m_s,v2_m_s"), world, name="w.csv"
        ),
    }


# ---- conditions ----

Spoiled = Callable[[Reader], tuple[Row, ...] | None]


def each_of(role: str, change: Callable[[str], str]) -> Spoiled:
    """All values of a role, changed; None where a reader has not got it."""
    return lambda reader: (
        tuple(row | {role: change(row[role])} for row in reader.rows) if role in reader.roles else None
    )


def of_ais(role: str, change: Callable[[str], str], *more: str) -> Spoiled:
    """Roles of the table of AIS reports alone."""

    def spoil(reader: Reader) -> tuple[Row, ...] | None:
        if "latitude" not in reader.roles:
            return None
        return tuple(row | {each: change(row[each]) for each in (role, *more)} for row in reader.rows)

    return spoil


def number(change: Callable[[float], float]) -> Callable[[str], str]:
    return lambda text: f"{change(float(text)):.12g}"


def times(change: Callable[[float], float], own: bool = False) -> Spoiled:
    """Times in seconds, changed; those of AIS are dates, which have conditions of their own."""
    return lambda reader: None if own or "latitude" in reader.roles else each_of("time", number(change))(reader)


def boxes(change: Callable[..., tuple[float, ...]], corners: Callable[..., tuple[float, ...]] | None = None) -> Spoiled:
    """All boxes in another form; of files with corners the change is another."""

    def spoil(reader: Reader) -> tuple[Row, ...] | None:
        if not {*BOX} <= reader.roles:
            return None
        has_corners = reader.name in ("t.csv", "log.jsonl")
        use = corners if has_corners else change
        if use is None:
            return None
        return tuple(
            row
            | dict(zip(BOX, (f"{n:.9g}" for n in use(*(float(row[role]) for role in BOX), *reader.size)), strict=True))
            for row in reader.rows
        )

    return spoil


def from_zero(empty: bool) -> Spoiled:
    """Frames that count from 0, of which the first may be empty."""

    def spoil(reader: Reader) -> tuple[Row, ...] | None:
        if "frame" not in reader.roles or reader.name in ("t.csv", "gt.json", "dt.json"):
            return None
        rows = [row for row in reader.rows if not empty or row["frame"] != "1"]
        return tuple(row | {"frame": str(int(row["frame"]) - 1)} for row in rows)

    return spoil


def quoted(reader: Reader, role: str, text: str) -> tuple[Row, ...] | None:
    """A flag of JSON as text."""
    return None if reader.separator or role not in reader.roles else tuple(row | {role: text} for row in reader.rows)


ROWS: dict[str, Spoiled] = {
    "identities in scientific notation": each_of("id", lambda text: "2.19E+08"),
    "identities as 7.0": each_of("id", lambda text: f"{text}.0"),
    "identities as 7.5": each_of("id", lambda text: f"{text}.5"),
    "identities below 0": each_of("id", lambda text: "-7"),
    "identities of 15 digits": each_of("id", lambda text: "219012345678901"),
    "identities through single precision": of_ais("id", lambda text: f"{float(np.float32(text)):.0f}"),
    "identities as words": lambda reader: (
        None if reader.name == "w.csv" else each_of("id", lambda text: "'vessel'")(reader)
    ),
    "frames as 1.0": each_of("frame", lambda text: f"{text}.0"),
    "frames as 1.5": each_of("frame", lambda text: f"{text}.5"),
    "frames from 0": from_zero(False),
    "frames from 0, the first empty": from_zero(True),
    "frames below 0": each_of("frame", lambda text: f"-{text}"),
    "frames in scientific notation": each_of("frame", lambda text: "1E+08"),
    "times in milliseconds": times(lambda time: 1000 * time),
    "times in microseconds": times(lambda time: 1e6 * time),
    "times in nanoseconds": times(lambda time: 1e9 * time),
    "times of 1970": times(lambda time: 86_400 * 200 + time),
    "times of an identity": times(lambda time: 219_012_345),
    "times of today": times(lambda time: START_UNIX_S + time),
    "frame numbers as times": times(lambda time: round(2 * time)),
    "one time": lambda reader: times(lambda time: 3.0)(reader) if reader.separator else None,
    "times below 0": times(lambda time: -time - 100),
    "corners for sizes, or sizes for corners": boxes(
        lambda x, y, w, h, *_: (x, y, x + w, y + h), lambda a, b, c, d, *_: (a, b, c - a, d - b)
    ),
    "centres for corners": boxes(lambda x, y, w, h, *_: (x + w / 2, y + h / 2, w, h)),
    "centre and size for two corners": boxes(
        lambda x, y, w, h, *_: (x + w / 2, y + h / 2, w, h),
        lambda a, b, c, d, *_: ((a + c) / 2, (b + d) / 2, c - a, d - b),
    ),
    "x and y exchanged": boxes(lambda x, y, w, h, *_: (y, x, h, w), lambda a, b, c, d, *_: (b, a, d, c)),
    "shares of the image": boxes(
        lambda x, y, w, h, W, H: (
            (x / W, y / H, w / W, h / H) if W > 1 else (x * WIDTH, y * HEIGHT, w * WIDTH, h * HEIGHT)
        ),
        lambda a, b, c, d, W, H: (a / W, b / H, c / W, d / H),
    ),
    "per cent of the image": boxes(
        lambda x, y, w, h, W, H: (100 * x / W, 100 * y / H, 100 * w / W, 100 * h / H),
        lambda a, b, c, d, W, H: (100 * a / W, 100 * b / H, 100 * c / W, 100 * d / H),
    ),
    "y from below": boxes(
        lambda x, y, w, h, W, H: (x, H - y - h, w, h) if W > 1 else (x, 1 - y, w, h),
        lambda a, b, c, d, W, H: (a, H - d, c, H - b),
    ),
    "boxes of an image twice as large": boxes(
        lambda x, y, w, h, *_: (2 * x, 2 * y, 2 * w, 2 * h), lambda a, b, c, d, *_: (2 * a, 2 * b, 2 * c, 2 * d)
    ),
    "sizes below 0": boxes(lambda x, y, w, h, *_: (x, y, -w, -h), lambda a, b, c, d, *_: (c, d, a, b)),
    "boxes without area": boxes(lambda x, y, w, h, *_: (x, y, 0, 0), lambda a, b, c, d, *_: (a, b, a, b)),
    "boxes in scientific notation": boxes(
        lambda x, y, w, h, *_: (1e9, 1e9, w, h), lambda a, b, c, d, *_: (1e9, 1e9, 2e9, 2e9)
    ),
    "confidences in per cent": each_of("score", number(lambda score: 100 * score)),
    "confidences of 8 bits": each_of("score", number(lambda score: round(255 * score))),
    "confidences as logits": each_of("score", number(lambda score: math.log(score / (1 - score)))),
    "confidences of -1": each_of("score", lambda text: "-1"),
    "confidences all 1": each_of("score", lambda text: "1"),
    "confidences as flags": each_of("score", lambda text: str(int(float(text) > 0.5))),
    "classes as 1.5": each_of("class", lambda text: f"{text}.5"),
    "classes as 1.0": each_of("class", lambda text: f"{text}.0"),
    "classes below 0": each_of("class", lambda text: "-1"),
    "classes beyond the list": each_of("class", lambda text: str(int(text) + 70)),
    "labels of others": each_of("label", lambda text: '"tanker"' if text.startswith('"') else "tanker"),
    "labels as numbers": each_of("label", lambda text: "1"),
    "flags of 2": each_of("flag", lambda text: "2"),
    "flags of 0.5": each_of("flag", lambda text: "0.5"),
    "flags '0'": lambda reader: quoted(reader, "flag", '"0"'),
    "flags 'false'": lambda reader: quoted(reader, "flag", '"false"'),
    "flags '1'": lambda reader: quoted(reader, "flag", '"1"'),
    "flags 'no'": lambda reader: quoted(reader, "flag", '"no"'),
    "flags as lists": lambda reader: quoted(reader, "flag", "[0]"),
    "visibility in per cent": each_of("visible", number(lambda share: 100 * share)),
    "visibility of 0": each_of("visible", lambda text: "0"),
    "visibility of -1": each_of("visible", lambda text: "-1"),
    "visibility as words": each_of("visible", lambda text: "full"),
    "angles in degrees": each_of("heading", number(math.degrees)),
    "compass headings": lambda reader: (
        each_of("heading", number(lambda angle: math.pi / 2 - angle + 1))(reader) if "roll" in reader.roles else None
    ),
    "roll in degrees": each_of("roll", number(lambda angle: 50 * math.degrees(angle))),
    "axes exchanged": lambda reader: (
        tuple(row | {"w1": row["w2"], "w2": row["w1"], "v1": row["v2"], "v2": row["v1"]} for row in reader.rows)
        if "w1" in reader.roles
        else tuple(row | {"latitude": row["longitude"], "longitude": row["latitude"]} for row in reader.rows)
        if "latitude" in reader.roles
        else None
    ),
    "w2 to starboard": lambda reader: (
        tuple(row | {"w2": f"{-float(row['w2']):g}", "v2": f"{-float(row['v2']):g}"} for row in reader.rows)
        if "w1" in reader.roles
        else None
    ),
    "kilometres": lambda reader: (
        tuple(row | {axis: f"{float(row[axis]) / 1000:.9g}" for axis in ("w1", "w2")} for row in reader.rows)
        if "w1" in reader.roles
        else None
    ),
    "millimetres": lambda reader: (
        tuple(row | {axis: f"{float(row[axis]) * 1000:.9g}" for axis in ("w1", "w2")} for row in reader.rows)
        if "w1" in reader.roles
        else None
    ),
    "degrees in radians": of_ais("latitude", number(math.radians), "longitude"),
    "dates of 1899": of_ais("time", lambda text: "1899-12-30T" + text[11:]),
    "dates to come": of_ais("time", lambda text: "2099" + text[4:]),
    "no dates": of_ais("time", lambda text: text[11:]),
}  # fmt: skip
TEXTS: dict[str, Callable[[str, str], bytes | None]] = {
    "a byte order mark": lambda text, _: b"\xef\xbb\xbf" + text.encode(),
    "UTF-16": lambda text, _: text.encode("utf-16"),
    "CR LF": lambda text, _: text.replace("\n", "\r\n").encode(),
    "CR": lambda text, _: text.replace("\n", "\r").encode(),
    "blank lines at the end": lambda text, _: f"{text}\n\n".encode(),
    "no end of the last line": lambda text, _: text.rstrip("\n").encode(),
    "a zero byte": lambda text, _: f"{text}\0".encode(),
    "half of the file": lambda text, comma: text[: len(text) * 3 // 5].rpartition(comma or ",")[0].encode(),
    "semicolons": lambda text, comma: text.replace(",", ";").encode() if comma == "," else None,
    "tabs": lambda text, comma: text.replace(comma, "\t").encode() if comma else None,
    "decimal commas": lambda text, comma: text.replace(",", ";").replace(".", ",").encode() if comma else None,
    "a line sep=": lambda text, comma: f"sep={comma}\n{text}".encode() if comma else None,
    "a column more": lambda text, comma: text.replace("\n", f"{comma}3\n").encode() if comma else None,
    "a column less": lambda text, comma: (
        "".join(f"{line.rpartition(comma)[0]}\n" for line in text.splitlines()).encode() if comma else None
    ),
    "quotes": lambda text, comma: (
        "".join('"' + line.replace(",", '","') + '"\n' for line in text.splitlines()).encode() if comma == "," else None
    ),
    "no content": lambda text, _: b"",
}
"""From the right text and its separator."""


def same(one: Any, other: Any) -> bool:
    """Whether two results are equal, arrays to the last digits that files have."""
    if isinstance(one, np.ndarray):
        if one.shape != np.shape(other):
            return False
        return (
            bool(np.allclose(one, other, atol=1e-3, equal_nan=True))
            if one.dtype.kind in "fiub"
            else bool((one == other).all())
        )
    if is_dataclass(one):
        return type(one) is type(other) and all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    return bool(one == other)


NOTHING = "a detector or a tracker may have found nothing, and images may show nothing"
WITH_TRUTH = "a reader of logs has no truth; learning from the voyage holds the boxes against it"
UNDECIDABLE: dict[tuple[str, str], str] = {
    **{(name, "no content"): NOTHING for name in ("MOT truth", "MOT classes", "MOT detections", "YOLO labels")},
    ("tracks MOT", "no content"): NOTHING,
    **{(log, "y from below"): WITH_TRUTH for log in ("log CSV", "log lines", "log MOT")},
    **{(log, "centres for corners"): WITH_TRUTH for log in ("log CSV", "log MOT")},
    **{(log, "centre and size for two corners"): WITH_TRUTH for log in ("log CSV", "log MOT")},
    **{(name, "half of the file"): "lines have six numbers or more" for name in ("MOT truth", "MOT classes")},
    ("MOT truth", "visibility of -1"): "-1 stands for a visibility that is not known",
    ("log CSV", "a column less"): "a log may have no confidences",
    ("log MOT", "frames from 0, the first empty"): "as a clock that is a frame late, which registration finds",
    ("AIS table", "axes exchanged"): "56° N 12° E and 12° N 56° E are both at sea",
}
"""Conditions that nothing in the file or beside it tells from a right file, with the reason."""


def outcome(reader: Reader, path: Path, content: bytes, right: Reading) -> str:
    path.write_bytes(content)
    try:
        read, notes = reader.read(path)
    except ModsimError:
        return "refused"
    if {*notes} - {*right[1]}:
        return "noted"
    return "read" if same(right[0], read) else "SILENT"


def spoiled(reader: Reader) -> Iterator[tuple[str, bytes]]:
    text = reader.form(reader.rows)
    for name, spoil in ROWS.items():
        if (rows := spoil(reader)) is not None and (content := reader.form(rows)) != text:
            yield name, content.encode()
    for name, mark in TEXTS.items():
        if (content := mark(text, reader.separator)) is not None:
            yield name, content


def test_no_file_is_misread_without_a_word(readers: dict[str, Reader], tmp_path: Path) -> None:
    outcomes: dict[tuple[str, str], str] = {}
    for place, (name, reader) in enumerate(readers.items()):
        folder = tmp_path / str(place)
        folder.mkdir()
        path = folder / reader.name
        path.write_text(reader.form(reader.rows))
        right = reader.read(path)
        for condition, content in spoiled(reader):
            outcomes[name, condition] = outcome(reader, path, content, right)
    counts = Counter(outcomes.values())
    assert {key for key, value in outcomes.items() if value == "SILENT"} == UNDECIDABLE.keys()
    assert counts["refused"] > 350 and counts["read"] < 150 and counts.total() > 500
