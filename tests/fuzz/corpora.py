"""Good files of every kind that is read, as they lie in a folder, runs among them: name → content."""

import contextlib
import gzip
import hashlib
import io
import json
import struct
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from modsim3d.io.input_files import data_folder
from modsim3d.runs.files.block_files import DIGEST_BYTES
from modsim3d.runs.run import run_scene
from modsim3d.scene.reading import load_scene
from tests.cli.bad_input.builders import CIRCULAR, FILES, GOOD
from tests.detector_variants import CHANGES, variant
from tests.scene.test_lens import FILES as CALIBRATIONS

Files = dict[str, bytes | None]
"""What lies in a folder: content by path; None is a folder."""

AIS_SAMPLES = Path(__file__).resolve().parents[1] / "data" / "ais"
AIS_ROWS = 30
FORM: dict[str, Any] = json.loads((Path(__file__).parent / "scene_parts.json").read_text(encoding="utf-8"))


def _json(content: Any) -> bytes:
    return json.dumps(content).encode()


def _shipped(name: str) -> bytes:
    return (data_folder("scenes") / name).read_bytes()


_CORNERS = np.array([(-1, -1, 0), (3, -1, 0), (3, 1, 0), (-1, 1, 0), (0, 0, 2)], dtype="<f4")
_FACES = np.array([(0, 2, 1), (0, 3, 2), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)], dtype="<u2")


def _obj(names: str = "") -> bytes:
    corners = "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in _CORNERS.tolist())
    return (f"# a hull\n{names}{corners}" + "".join(f"f {a + 1}//1 {b + 1} {c + 1}\n" for a, b, c in _FACES)).encode()


def _text_stl() -> bytes:
    corners = ["  vertex {:g} {:g} {:g}\n".format(*corner) for corner in _CORNERS.tolist()]
    loops = ("".join(corners[corner] for corner in face) for face in _FACES)
    facets = (f"facet normal 0 0 0\n outer loop\n{loop} endloop\nendfacet\n" for loop in loops)
    return ("solid hull\n" + "".join(facets) + "endsolid hull\n").encode()


def _binary_stl() -> bytes:
    facets = (bytes(12) + _CORNERS[face].tobytes() + bytes(2) for face in _FACES)
    return bytes(80) + struct.pack("<I", len(_FACES)) + b"".join(facets)


def _ply(form: str) -> bytes:
    header = (
        f"ply\nformat {form} 1.0\ncomment a hull\nelement vertex {len(_CORNERS)}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(_FACES)}\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()
    if form == "ascii":
        rows = ["{:g} {:g} {:g}".format(*corner) for corner in _CORNERS.tolist()]
        return header + "\n".join([*rows, *("3 {} {} {}".format(*face) for face in _FACES), ""]).encode()
    order = "<" if "little" in form else ">"
    faces = b"".join(struct.pack(f"{order}B3i", 3, *face) for face in _FACES.tolist())
    return header + _CORNERS.astype(f"{order}f4").tobytes() + faces


def _glb() -> bytes:
    data = _CORNERS.tobytes() + _FACES.tobytes()
    text = json.dumps({**FORM["glb"], "buffers": [{"byteLength": len(data)}]}).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


@cache
def meshes(ending: str) -> tuple[Files, ...]:
    """Mesh files with an ending, each as `hull.ENDING`."""
    found = {
        "glb": [_glb(), _glb(), *(path.read_bytes() for path in sorted(data_folder("meshes").glob("*.glb")))],
        "obj": [_obj(), _obj("mtllib hull.mtl\no hull\ng a b\nvt 0 0\nvn 0 0 1\nusemtl red\n")],
        "stl": [_text_stl(), _binary_stl()],
        "ply": [_ply("ascii"), _ply("binary_little_endian"), _ply("binary_big_endian")],
    }[ending]
    return tuple({f"hull.{ending}": content} for content in found)


def _small_scene(changes: dict[str, Any], ending: str = "yaml") -> Files:
    """The small scene of the tests for bad input with some sections replaced; None removes one."""
    scene = {key: value for key, value in {**GOOD["scene"], **changes}.items() if value is not None}
    good = {FILES[name]: _json(GOOD[name]) for name in ("vessels", "poses", "detector")}
    return {f"scene.{ending}": _json(scene), **good, "hull.obj": _obj(), "hull.stl": _text_stl()}


@cache
def scenes() -> tuple[Files, ...]:
    """Scenes that have every section between them, in YAML and JSON, and shipped ones."""
    lines = b"".join(_json({time: entries}) + b"\n" for time, entries in GOOD["poses"].items())
    generated = {"steps": 5, "time_step_s": 0.5}
    ashore = {"cameras": FORM["cameras_ashore"], "waves": FORM["process"]}
    named = [
        _small_scene({}),
        _small_scene({}, "json"),
        _small_scene({**FORM["everything"]}, "json"),
        _small_scene({**FORM["everything"]}),
        _small_scene({**generated, "poses": CIRCULAR, **ashore}, "json"),
        _small_scene({**generated, "poses": {"agents": FORM["agents"]}, "waves": {"level": "large"}}, "json"),
        {**_small_scene({"poses": {"stream": {"file": "live.jsonl", "timeout_s": 0}}}, "json"), "live.jsonl": lines},
        {**_small_scene({"poses": {"file": "poses.jsonl.gz"}}), "poses.jsonl.gz": gzip.compress(lines, mtime=0)},
    ]
    shipped: Files = {"scene.yaml": _shipped("simulation_1.yaml")}
    shipped |= {"detectors/thesis.yaml": _shipped("detectors/thesis.yaml")}
    strait: Files = {**shipped, "scene.yaml": _shipped("strait.yaml").replace(b"steps: 300", b"steps: 20")}
    strait |= {"detectors/coastal.yaml": _shipped("detectors/coastal.yaml")}
    return (*named, *named, shipped, strait)


@cache
def vessels() -> tuple[Files, ...]:
    """Vessels files."""
    more = {**GOOD["vessels"], "hulk": {**GOOD["vessels"]["vehicle1"], "mesh": {"file": "hull.obj", "up": "+z"}}}
    texts = [json.dumps(content, indent=indent) for content in (GOOD["vessels"], more) for indent in (None, 1)]
    return tuple({"vessels.json": text.encode()} for text in texts)


@cache
def poses() -> tuple[Files, ...]:
    """Pose files: JSON, JSON Lines, and both packed."""
    whole = json.dumps(GOOD["poses"], indent=1).encode()
    lines = b"\n".join(_json({time: entries}) for time, entries in GOOD["poses"].items())
    plain = {"poses.json": whole, "poses.jsonl": lines}
    packed = {f"{name}.gz": gzip.compress(content, mtime=0) for name, content in plain.items()}
    return tuple({name: content} for name, content in (plain | packed).items())


@cache
def stream() -> tuple[Files, ...]:
    """Lines of poses as a live scene gets them."""
    return ({"live.jsonl": poses()[1]["poses.jsonl"]},)


@cache
def detectors() -> tuple[Files, ...]:
    """Detector files: the shipped ones, one for each model, and one that has all."""
    shipped = [_shipped(f"detectors/{name}.yaml") for name in ("rich", "three_labels", "conditions/noon_clear")]
    small = [_json(variant(name)) for name in sorted(CHANGES)]
    return tuple({"detector.yaml": content} for content in (*shipped, _json(GOOD["detector"]), *small))


@cache
def calibrations() -> tuple[Files, ...]:
    """Calibration files of OpenCV, ROS and Kalibr."""
    endings = {name: "json" if name == "json" else "yaml" for name in CALIBRATIONS}
    return tuple({f"solved.{ending}": CALIBRATIONS[name].encode()} for name, ending in endings.items())


@cache
def coco() -> tuple[Files, ...]:
    """Ground truth and results of COCO, plain and with every key that is read."""
    sets = (FORM["coco"], FORM["coco_as_written_by_others"])
    return tuple({"gt.json": _json(pair["truth"]), "dt.json": _json(pair["results"])} for pair in sets)


@cache
def mot() -> tuple[Files, ...]:
    """A sequence of the MOT challenge, with and without classes."""
    info = b"[Sequence]\nname=bay\nframeRate=10\nseqLength=4\nimWidth=640\nimHeight=480\nimExt=.jpg\n"
    rows = [(frame, boat, 40 * boat + frame, 30, 20, 25) for frame in (1, 2, 3) for boat in (1, 2)]
    truth = "".join(f"{','.join(map(str, row))},1,{row[1]},0.75\n" for row in rows)
    found = [(frame, -1, x + 1, y, w, h, 0.5) for frame, _, x, y, w, h in rows]
    plain = "".join(f"{','.join(map(str, row))},-1,-1,-1\n" for row in found)
    classes = "".join(f"{','.join(map(str, row))},{1 + k % 2},-1\n" for k, row in enumerate(found))
    files = {"seqinfo.ini": info, "gt/gt.txt": truth.encode()}
    return tuple({**files, "det/det.txt": text.encode()} for text in (plain, classes))


@cache
def _picture(form: str, width: int = 64, height: int = 48) -> bytes:
    from PIL import Image

    out = io.BytesIO()
    exif = Image.Exif()
    exif[274] = 6
    Image.new("RGB", (width, height), (20, 80, 160)).save(out, form, exif=exif)
    return out.getvalue()


@cache
def yolo() -> tuple[Files, ...]:
    """Folders of labels and predictions, with images of several kinds, and names in either file."""
    labels: Files = {"set/labels/a.txt": b"0 0.5 0.5 0.2 0.25\n1 0.25 0.3 0.1 0.1\n", "set/labels/b.txt": b""}
    labels["set/labels/c.txt"] = b"1 0.75 0.5 0.3 0.2\n"
    found: Files = {"found/a.txt": b"0 0.5 0.52 0.2 0.25 0.875\n1 0.2 0.3 0.1 0.1 0.5\n"}
    found["found/c.txt"] = b"0 0.7 0.5 0.3 0.2 0.25\n"
    data = b"path: ../set\ntrain: images\nval: images\nnames:\n  0: kayak\n  1: ferry\n"
    images: list[Files] = [
        {f"set/images/{stem}.{kind}": _picture(kind.upper()) for stem, kind in zip("abc", each, strict=True)}
        for each in (("png", "jpeg", "bmp"), ("webp", "tiff", "png"))
    ]
    return (
        {**labels, **found, **images[0], "set/data.yaml": data},
        {**labels, **found, **images[1], "set/labels/classes.txt": b"kayak\nferry\n"},
    )


@cache
def ais(sample: str) -> tuple[Files, ...]:
    """The beginning of a sample of AIS reports, plain and packed."""
    lines = (AIS_SAMPLES / sample).read_bytes().split(b"\n")
    text = b"\n".join([*lines[:AIS_ROWS], b""])
    return ({sample: text}, {sample: text}, {sample: text}, {f"{sample}.gz": gzip.compress(text, mtime=0)})


class _Stop(Exception):
    """Interrupts a run once a block is kept."""


def _stop(steps: int) -> None:
    raise _Stop


@cache
def stored_runs(interrupted: bool) -> tuple[Files, ...]:
    """Runs of the small scenes with one camera and with everything."""
    return tuple(_files_of(scenes()[number], _stop if interrupted else lambda steps: None) for number in (0, 3))


def _files_of(inputs: Files, progress: Callable[[int], None]) -> Files:
    with tempfile.TemporaryDirectory(prefix="modsim3d_fuzz_") as name:
        folder = Path(name)
        write_files(inputs, folder / "in")
        scene = load_scene(folder / "in" / "scene.yaml", source="analytic")
        with contextlib.suppress(_Stop):
            run_scene(scene, folder / "run", progress=progress)
        paths = sorted((folder / "run").rglob("*"))
        return {f"run/{path.relative_to(folder / 'run')}": path.read_bytes() for path in paths if path.is_file()}


def reseal(files: Files) -> None:
    """Put the sizes, checksums and numbers of rows of changed files into a run's lists, as if the run had made them."""
    for name, content in files.items():
        if name.endswith(".npz") and content is not None:
            files[name] = content[:-DIGEST_BYTES] + hashlib.sha256(content[:-DIGEST_BYTES]).digest()
    for name in ("run/run.json", "run/unfinished/settings.json"):
        try:
            content = json.loads(files.get(name) or b"")
            folder = name.rpartition("/")[0]
            content["scene_sha256"] = _scene_sha256(files, f"{folder}/scene/", f"{content['scene']}.json")
            if name.endswith("run.json"):
                _list_again(files, content)
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError, OSError, pa.ArrowException):
            continue  # the lists themselves are spoiled
        files[name] = json.dumps(content).encode()


def _scene_sha256(files: Files, folder: str, scene: str) -> str:
    """As `SceneCopy.sha256`."""
    inside = {name.removeprefix(folder): content or b"" for name, content in files.items() if name.startswith(folder)}
    digest = hashlib.sha256(hashlib.sha256(inside.pop(scene)).digest())
    for name, content in sorted(inside.items()):
        digest.update(hashlib.sha256(name.encode()).digest() + hashlib.sha256(content).digest())
    return digest.hexdigest()


def _list_again(files: Files, content: dict[str, Any]) -> None:
    for name, entry in content.get("files", {}).items():
        found = files.get(f"run/{name}") or b""
        entry.update(bytes=len(found), sha256=hashlib.sha256(found).hexdigest())
    tables = ("frames", "truth", "detections")
    rows = {name: pq.read_metadata(io.BytesIO(files[f"run/{name}.parquet"] or b"")).num_rows for name in tables}
    counts = content["counts"]
    counts.update(frames=rows["frames"], vessel_frames=rows["truth"])
    counts["false_positives"] = rows["detections"] - counts["detected"] + counts["merged"]


def write_files(files: Files, folder: Path) -> None:
    """Write files below a folder, which is made if it does not exist."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if content is None:
            path.mkdir()
        else:
            path.write_bytes(content)
