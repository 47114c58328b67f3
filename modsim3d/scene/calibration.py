"""Calibration files of cameras: OpenCV's YAML and JSON, the camera_info of ROS, and the camchain of Kalibr."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

from modsim3d.core.errors import InputError
from modsim3d.io.input_files import MAX_YAML_BYTES, read_text
from modsim3d.io.strict_text import parse_yaml
from modsim3d.io.validation import MOST, shown
from modsim3d.scene.keys import MAX_IMAGE_SIDE_PX, MatrixRows, upper_triangular

COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")
"""Order of the coefficients of a lens in all three formats; what OpenCV and ROS write after them belongs to models that
are not known here, unless it is 0."""
COUNTS = (0, 4, 5, 8, 12, 14)  # of coefficients that OpenCV writes
_BROWN = ("plumb_bob", "radtan", "rational_polynomial", "none", "")
_OTHER_MODELS = {"fisheye_model": (0,), "binning_x": (0, 1), "binning_y": (0, 1)}
"""Keys by which a file says that its camera is no such one, and the values with which it is."""


@dataclass(frozen=True)
class Calibration:
    """Content of a calibration file."""

    matrix: MatrixRows  # K, which counts from the centre of the first pixel
    distortion: dict[str, float]  # by the names of `COEFFICIENTS`, without those that are 0
    image_size_px: tuple[int, int] | None  # width and height, if the file has them


def read_calibration(path: Path, camera: str) -> Calibration:
    """The calibration in a file, of a file of Kalibr's that of the camera of this name, or of its only one. Raises
    InputError if the file cannot be read, is in no known format, or is of a camera with another model."""
    source = f"calibration {path}"
    text = read_text(path, "calibration", MAX_YAML_BYTES)
    if text.lstrip().startswith("<"):
        raise InputError(source, ["is XML: write it as YAML, which OpenCV does where the file's name ends in .yaml"])
    # OpenCV's first line is no directive of YAML, its tag says what the keys below do, and ROS prints --- at the end.
    text = re.sub(r"\A%YAML.*", "", text).replace("!!opencv-matrix", "").rstrip().removesuffix("\n---")
    data = parse_yaml(text, source)
    try:
        if not isinstance(data, dict):
            raise ValueError("has no keys")
        chain = {str(name): cam for name, cam in data.items() if isinstance(cam, dict) and "intrinsics" in cam}
        return _of_kalibr(chain, camera) if chain else _of_opencv({str(key).lower(): data[key] for key in data})
    except ValueError as error:
        raise InputError(source, [str(error)]) from None


def _of_kalibr(chain: Mapping[str, Mapping[str, Any]], camera: str) -> Calibration:
    if camera not in chain and len(chain) > 1:
        raise ValueError(f"has the cameras {', '.join(chain)}: call the scene's camera as one of them ('{camera}')")
    cam = chain.get(camera) or next(iter(chain.values()))
    if (model := cam.get("camera_model")) != "pinhole":
        raise ValueError(f"camera_model: {shown(model)} is not known: only pinhole is")
    fx, fy, cx, cy = _numbers(cam, "intrinsics", (4,))
    distortion = _distortion(cam, "distortion_coeffs")
    size = _numbers(cam, "resolution", (2,)) if "resolution" in cam else None
    return Calibration(upper_triangular(((fx, 0, cx), (0, fy, cy), (0, 0, 1))), distortion, _size(size))


def _of_opencv(data: Mapping[str, Any]) -> Calibration:
    """The content of a file of OpenCV or ROS, by its keys in small letters."""
    for key, values in _OTHER_MODELS.items():
        if data.get(key, 0) not in values:
            raise ValueError(f"{key}: {shown(data[key])} is not read: only a pinhole's lens and whole images are")
    matrix = next((key for key in ("camera_matrix", "k") if key in data), None)
    if matrix is None:
        raise ValueError("has neither camera_matrix (OpenCV, ROS), K (a camera_info message) nor cam0 with intrinsics")
    k = _numbers(data, matrix, (9,))
    lens = next((key for key in ("distortion_coefficients", "d") if key in data), "")
    sides = next((pair for pair in (("image_width", "image_height"), ("width", "height")) if {*pair} <= {*data}), ())
    size = [_numbers(data, side, (1,))[0] for side in sides] if sides else None
    distortion = _distortion(data, lens) if lens else {}
    try:
        rows = upper_triangular(((k[0], k[1], k[2]), (k[3], k[4], k[5]), (k[6], k[7], k[8])))
    except ValueError as error:
        raise ValueError(f"{matrix}: {error}") from None
    return Calibration(rows, distortion, _size(size))


def _distortion(data: Mapping[str, Any], key: str) -> dict[str, float]:
    model = data.get("distortion_model", "")
    if model not in _BROWN:
        raise ValueError(f"distortion_model: {shown(model)} is not known: only {', '.join(filter(None, _BROWN))} are")
    values = _numbers(data, key, COUNTS) if key in data else []
    if any(values[len(COEFFICIENTS) :]):
        said = f"has more than {', '.join(COEFFICIENTS)}, and not all of the others are 0 ({shown(values[5:])})"
        raise ValueError(f"{key}: {said}: calibrate with the model of five coefficients")
    return {name: value for name, value in zip(COEFFICIENTS, values, strict=False) if value}


def _size(sides: Sequence[float] | None) -> tuple[int, int] | None:
    if sides is None or prod(sides) == 0:
        return None  # a camera_info that was not filled in
    if any(side != int(side) or not 0 < side <= MAX_IMAGE_SIDE_PX for side in sides):
        raise ValueError(f"image sizes must be whole numbers up to {MAX_IMAGE_SIDE_PX} (got {shown(list(sides))})")
    return int(sides[0]), int(sides[1])


def _numbers(data: Mapping[str, Any], key: str, counts: Sequence[int]) -> list[float]:
    """The numbers of a key: one, a list, rows, or OpenCV's matrix, whose numbers are its `data`."""
    given = data.get(key)
    entry: Any = given.get("data") if isinstance(given, dict) else given
    rows = entry if isinstance(entry, list) else [entry]
    values: list[Any] = [value for row in rows for value in (row if isinstance(row, list) else [row])]
    if len(values) not in counts or not all(type(each) in (int, float) and abs(each) <= MOST for each in values):
        needed = " or ".join(", ".join(map(str, counts)).rsplit(", ", 1))
        raise ValueError(f"{key}: {needed} numbers are needed (got {len(values)}: {shown(entry)})")
    return [float(value) for value in values]
