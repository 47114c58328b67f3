"""The forms in which a scene gives a camera: what stands against each other, and the one form that they come to; and
calibration files: OpenCV's YAML and JSON, the camera_info of ROS, and the camchain of Kalibr."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from modsim3d.core.errors import InputError
from modsim3d.io.input_files import MAX_YAML_BYTES, read_text
from modsim3d.io.strict_text import parse_yaml
from modsim3d.io.validation import MAX_NUMBER, shown
from modsim3d.scene.keys import ANGLES, LENSES, MAX_IMAGE_SIDE_PX, CameraKeys, MatrixRows, upper_triangular

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
    lens = next((key for key in data if re.fullmatch(r"d|dist(ortion)?(_?coef\w*)?", key)), "")  # as programs name it
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
        problem = f"has more than {', '.join(COEFFICIENTS)}, and not all of the others are 0 ({shown(values[5:])})"
        raise ValueError(f"{key}: {problem}: calibrate with the model of five coefficients")
    return {name: value for name, value in zip(COEFFICIENTS, values, strict=False) if value}


def _size(sides: Sequence[float] | None) -> tuple[int, int] | None:
    if sides is None or math.prod(sides) == 0:
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
    if len(values) not in counts or not all(
        type(value) in (int, float) and abs(value) <= MAX_NUMBER for value in values
    ):
        needed = " or ".join(", ".join(map(str, counts)).rsplit(", ", 1))
        raise ValueError(f"{key}: {needed} numbers are needed (got {len(values)}: {shown(entry)})")
    return [float(value) for value in values]


HALF_PX = 0.5  # OpenCV's K counts from the centre of the first pixel, where the image here begins at that pixel's edge
OFF_CENTRE = 0.12  # of a side: a principal point farther from the middle is strange; of 5 : 4 swapped it is 0.125
_FORMS = tuple(form for form, *_ in LENSES)


def form_problems(camera: Mapping[str, Any]) -> Iterator[str]:
    """Problems of the keys of a camera that stand beside each other, whatever their values; each begins with a key."""
    given = {key for key, value in camera.items() if value is not None}
    forms = [form for form in _FORMS if form in given]
    if not forms and "pixel_size_m" not in given:
        yield f": give its lens by one of {', '.join(_FORMS)} (focal_length_m goes with pixel_size_m)"
    elif len(forms) > 1:
        yield f".{forms[1]}: beside {forms[0]}, which gives the lens too: leave one of them out"
    elif missing := {"focal_length_m", "pixel_size_m"} - given if forms in ([], ["focal_length_m"]) else set():
        yield f".{missing.pop()}: missing"
    else:
        beside = next(beside for form, *beside in LENSES if form == forms[0])
        others = {key for _, *keys in LENSES for key in keys} - {*beside}
        yield from (f".{key}: does not go with {forms[0]}: leave one of them out" for key in sorted(others & given))
    if "image_size_px" not in given and "calibration" not in given:
        yield ".image_size_px: missing"
    for place in ("pose", "mount"):
        keys = camera.get(place)
        angles = {key for key in keys if keys[key] is not None} if isinstance(keys, dict) else set()
        for angle in ANGLES:
            if {f"{angle}_rad", f"{angle}_deg"} <= angles:
                yield f".{place}.{angle}_deg: beside {angle}_rad: leave one of them out"


def point_problem(point_px: tuple[float, float], image_size_px: tuple[int, int]) -> str:
    """Reason why a principal point does not go with the size of its image; empty if it does."""
    width, height = image_size_px
    off = max(abs(at / side - 0.5) for at, side in zip(point_px, image_size_px, strict=True))
    turned = max(abs(at / side - 0.5) for at, side in zip(point_px, (height, width), strict=True))
    subject = f"the principal point ({point_px[0]:g}, {point_px[1]:g}) is "
    if off > OFF_CENTRE and turned < off / 3:
        return f"{subject}in the middle of {height} × {width}, not of {width} × {height}: swap width and height"
    return f"{subject}outside the image of {width} × {height}: give both for the same image" if off >= 0.5 else ""


def resolved(name: str, camera: Mapping[str, Any], keys: CameraKeys, folder: Path) -> dict[str, Any]:
    """The keys of a camera as a copy of the scene has them: with a principal point, angles in radians, and `focal_px`
    unless the focal length is in metres. `camera` has no form problems and is as in the scene file, which lies in a
    folder; `keys` are its valid keys. Raises InputError if the calibration file is wrong, or the principal point is."""
    where, size = f"cameras.{name}", keys.image_size_px
    lens: dict[str, Any] = {} if keys.K is None else _of_matrix(keys.K)
    if keys.calibration is not None:
        try:
            reading = read_calibration(folder / keys.calibration, name)
        except InputError as error:
            problems = (f"{where}.calibration: {keys.calibration}: {problem}" for problem in error.problems)
            raise InputError(where, problems) from None
        lens, size = _calibrated(where, keys.calibration, reading, size)
    assert size is not None
    point = lens.setdefault("principal_point_px", list(keys.principal_point_px or (size[0] / 2, size[1] / 2)))
    if keys.focal_length_m is None and (problem := point_problem(point, size)):
        key = next(key for key in ("calibration", "K", "principal_point_px") if camera.get(key) is not None)
        raise InputError(where, [f"{where}.{key}: {problem}"])
    for angle_deg, at, side in ((keys.hfov_deg, point[0], size[0]), (keys.vfov_deg, point[1], size[1])):
        if angle_deg is not None:
            lens["focal_px"] = [_focal_px(math.radians(angle_deg), at, side)] * 2
    place = next(key for key in ("pose", "mount") if camera.get(key) is not None)
    turned = _in_radians(camera[place])
    if turned == camera[place] and all(camera.get(key) is not None for key in lens):
        return {**camera}  # in this form already
    lens["image_size_px"] = list(size)
    others = {key: value for key, value in camera.items() if key not in (*_FORMS[2:], *lens, place)}
    return {**lens, **others, place: turned}


def _calibrated(
    where: str, file: str, reading: Calibration, size: tuple[int, int] | None
) -> tuple[dict[str, Any], tuple[int, int]]:
    """The keys of the lens in a calibration file, and the size of the images, which the scene may give too."""
    named = reading.image_size_px or size
    if named is None:
        raise InputError(where, [f"{where}.image_size_px: missing, and {file} has none either: give it"])
    if size not in (None, named):
        problem = f"{list(size or ())} is not the size in {file}, {list(named)}"
        raise InputError(where, [f"{where}.image_size_px: {problem}: leave it out, or calibrate at this size"])
    return _of_matrix(reading.matrix) | ({"distortion": reading.distortion} if reading.distortion else {}), named


def _of_matrix(matrix: MatrixRows) -> dict[str, Any]:
    (fx, skew, cx), (_, fy, cy), _ = matrix
    lens = {"focal_px": [fx, fy], "principal_point_px": [cx + HALF_PX, cy + HALF_PX]}
    return lens | ({"skew": skew} if skew else {})


def _focal_px(angle_rad: float, at_px: float, side_px: float) -> float:
    """The focal length with which a side of the image, with the principal point at a place on it, is seen under an
    angle: the f with atan(a / f) + atan((w − a) / f) = angle. From the middle that is w / (2 tan(angle / 2))."""
    along = side_px / math.tan(angle_rad)
    return (along + math.sqrt(along**2 + 4 * at_px * (side_px - at_px))) / 2


def _in_radians(place: Mapping[str, Any]) -> dict[str, Any]:
    degrees = {key: math.radians(value) for key, value in place.items() if key.endswith("_deg") and value is not None}
    kept = {key: value for key, value in place.items() if not key.endswith("_deg")}
    return kept | {key.replace("_deg", "_rad"): value for key, value in degrees.items()}
