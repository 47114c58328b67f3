"""Where a camera ashore sees the circles on which vessels move (Jessen & Mohr (2023), Appendix B)."""

from __future__ import annotations

import math

from modsim3d.errors import InputError


def camera_placement(
    centre_m: tuple[float, float],
    radius_m: float,
    *,
    height_m: float,
    focal_length_m: float,
    sensor_width_m: float,
    whole: bool = True,
) -> dict[str, list[float] | float]:
    """The `pose` of a camera beyond a circle in the direction of w1, which looks at its centre (eq. B.1–B.3).

        pose = modsim3d.camera_placement((0, 0), 500, height_m=20, focal_length_m=0.05, sensor_width_m=0.036)

    Eq. B.2 prints d = r / tan(2 AOV), a misprint: such a camera may stand within the circle. The source's program
    computes d = r / tan(AOV / 2), from where the circle's nearer half is cut at the sides of the image. From
    d = r / sin(AOV / 2) on, the whole circle is seen across the image. A test projects the circle for all three.

    Args:
        centre_m: w1 and w2 of the circle's centre.
        radius_m: Its radius, r.
        height_m: Height of the camera above the sea.
        focal_length_m: f.
        sensor_width_m: Columns of the image times the width of a pixel; the principal point is in the middle.
        whole: Whether to see the whole circle; if not, the distance is that of the source's program.

    Raises:
        InputError: A length is not positive, or a number is not finite.
        TypeError: A length is not a number.
    """
    names = ("radius_m", "height_m", "focal_length_m", "sensor_width_m")
    lengths = zip(names, (radius_m, height_m, focal_length_m, sensor_width_m), strict=True)
    problems = [f"{name}: {value:g} is not a length above 0" for name, value in lengths if not 0 < value < math.inf]
    problems += [f"centre_m: {place:g} is not finite" for place in centre_m if not math.isfinite(place)]
    if problems:
        raise InputError("camera_placement", problems)
    half_view_rad = math.atan(sensor_width_m / (2 * focal_length_m))
    distance_m = radius_m / (math.sin if whole else math.tan)(half_view_rad)
    return {
        "position_m": [centre_m[0] + distance_m, centre_m[1], height_m],
        "pitch_rad": math.atan(height_m / distance_m),
        "yaw_rad": math.pi,
    }
