"""The forms in which a scene gives a camera: what stands against each other, and the one form that they come to."""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from modsim3d.core.errors import InputError
from modsim3d.scene.calibration import Calibration, read_calibration
from modsim3d.scene.keys import ANGLES, LENSES, CameraKeys, MatrixRows

HALF_PX = 0.5
"""OpenCV's K counts from the centre of the first pixel, where the image here begins at that pixel's edge."""
OFF_CENTRE = 0.12
"""A principal point that is farther from the middle, as a share of a side, is strange; of 5 : 4 swapped it is 0.125."""
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
    said = f"the principal point ({point_px[0]:g}, {point_px[1]:g}) is "
    if off > OFF_CENTRE and turned < off / 3:
        return f"{said}in the middle of {height} × {width}, not of {width} × {height}: swap width and height"
    return f"{said}outside the image of {width} × {height}: give both for the same image" if off >= 0.5 else ""


def resolved(name: str, camera: Mapping[str, Any], keys: CameraKeys, folder: Path) -> dict[str, Any]:
    """The keys of a camera as a copy of the scene has them: with a principal point, angles in radians, and `focal_px`
    unless the focal length is in metres. `camera` has no form problems and is as in the scene file, which lies in a
    folder; `keys` are its valid keys. Raises InputError if the calibration file is wrong, or the principal point is."""
    where, size = f"cameras.{name}", keys.image_size_px
    lens: dict[str, Any] = {} if keys.K is None else _of_matrix(keys.K)
    if keys.calibration is not None:
        try:
            found = read_calibration(folder / keys.calibration, name)
        except InputError as error:
            problems = (f"{where}.calibration: {keys.calibration}: {problem}" for problem in error.problems)
            raise InputError(where, problems) from None
        lens, size = _calibrated(where, keys.calibration, found, size)
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
    where: str, file: str, found: Calibration, size: tuple[int, int] | None
) -> tuple[dict[str, Any], tuple[int, int]]:
    """The keys of the lens in a calibration file, and the size of the images, which the scene may give too."""
    named = found.image_size_px or size
    if named is None:
        raise InputError(where, [f"{where}.image_size_px: missing, and {file} has none either: give it"])
    if size not in (None, named):
        said = f"{list(size or ())} is not the size in {file}, {list(named)}"
        raise InputError(where, [f"{where}.image_size_px: {said}: leave it out, or calibrate at this size"])
    return _of_matrix(found.matrix) | ({"distortion": found.distortion} if found.distortion else {}), named


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
    """The keys of a pose or mount without angles in degrees."""
    degrees = {key: math.radians(value) for key, value in place.items() if key.endswith("_deg") and value is not None}
    kept = {key: value for key, value in place.items() if not key.endswith("_deg")}
    return kept | {key.replace("_deg", "_rad"): value for key, value in degrees.items()}
