"""A registration as a table and in sentences: each parameter before and after, and what is held by which rule."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from modsim3d.display import counted
from modsim3d.geometry.camera import Camera
from modsim3d.learn.told.tables import Table
from modsim3d.scene.scene import Scene
from modsim3d.voyage.labelled_voyage import Registered
from modsim3d.voyage.registration import Estimate, Registration
from modsim3d.voyage.registration.determined import COMMON_DELAY, Group
from modsim3d.voyage.registration.parameters import SHARED
from modsim3d.voyage.registration.registering import BY_RULE

HEADER = ("parameter", "scene", "registered", "change", "95 % interval", "held")
_WORDS = {parameter.name: parameter.words for parameter in SHARED} | {COMMON_DELAY: "mean delay of all reports"}
_WORDS |= {"clock_s": "clock", "focal_share": "focal length", "k1": "lens distortion k1"}
_UNITS = {parameter.name: parameter.unit for parameter in SHARED} | {COMMON_DELAY: "s"}


def registration_table(registered: Registered, scene: Scene) -> Table:
    """The parameters of one camera."""
    found = registered.registration
    (camera,) = (each for each in scene.cameras if each.name == found.camera)
    before, after = _values(camera), _values(found.camera_of(camera))
    before["clock_s"] = f"{registered.clock_s:+.3f} s" if registered.clock_s else "0 s"
    after["clock_s"] = f"{registered.clock_s + found.values['clock_s']:+.3f} s"
    lost = {group.held for group in found.groups} - {*BY_RULE, COMMON_DELAY}
    rows = tuple(
        (
            _name(each),
            before.get(each.name, ""),
            after.get(each.name, "") if not each.held else "",
            amount(each.name, each.value, each.unit, each.standard_error) if not each.held else "",
            _interval(each),
            "not determined, see below" if each.name in lost else each.held,
        )
        for each in (*found.estimates, delay_of(registered), *found.vessels)
    )
    return Table(f"Registration of camera '{found.camera}' in {registered.source}", HEADER, rows)


def registration_lead(registered: Registered) -> str:
    """How much it rests on, and the residuals before and after."""
    found = registered.registration
    before = f"{found.rms_before_px:.3g} px" if math.isfinite(found.rms_before_px) else "more than the lens shows"
    moved = ", with vessels off their reports as fits them best" if found.values.vessels.any() else ""
    return (
        f"Camera '{found.camera}' was registered by {len(found.sightings):,} of "
        f"{counted(found.detections, 'detection')}, of {counted(found.matched_vessels, 'vessel')}: bearings and "
        f"waterlines are off by {before} with the scene's values and by {found.rms_after_px:.3g} px with the "
        f"registered ones{moved} (root mean square, by the same matches)."
    )


def delay_of(registered: Registered) -> Estimate:
    """The mean delay of all reports, which is held by a rule."""
    given, nan = registered.known.delay_s, float("nan")
    rule = "the mean delay is taken to be zero" if given is None else f"given as {given:+g} s"
    return Estimate(COMMON_DELAY, _WORDS[COMMON_DELAY], "s", given or 0.0, nan, nan, nan, rule)


def exchanges(registration: Registration) -> Iterator[str]:
    """What cannot be told apart: by how much other values would change if a held one were another."""
    for group in registration.groups:
        yield _exchange(group)


def amount(name: str, value: float, unit: str, error: float | None = None) -> str:
    """A change with its sign and unit, to the digits that an error leaves; shares are in percent."""
    percent = name.endswith("_share")
    size, shown = (100.0, " %") if percent else (1.0, unit if unit in ("", "°") else f" {unit}")
    if error is None:
        return f"{size * value:+.3g}{shown}"
    digits = min(max(1 - math.floor(math.log10(max(size * error, 1e-6))), 0), 6)
    return f"{round(size * value, digits) + 0.0:+.{digits}f}{shown}"  # + 0.0: no minus before zero


def _name(estimate: Estimate) -> str:
    vessel = estimate.name.rpartition(".")[0]
    return f"{vessel}: {estimate.words}" if vessel else _WORDS[estimate.name]


def _exchange(group: Group) -> str:
    held = _WORDS[group.held]
    if not group.exchange:
        return f"{held} is held: the detections say nothing of it"
    one = 0.01 if _UNITS[group.held] == "" else 1.0
    changes = ", ".join(f"{amount(name, one * by, _UNITS[name])} of {_WORDS[name]}" for name, by in group.exchange)
    return f"{held} is held; {amount(group.held, one, _UNITS[group.held])} of it would look like {changes}"


def _interval(estimate: Estimate) -> str:
    if estimate.held or not np.isfinite(estimate.low):
        return ""
    low, high = (
        amount(estimate.name, end, estimate.unit, estimate.standard_error) for end in (estimate.low, estimate.high)
    )
    return f"{low} to {high}"


def _values(camera: Camera) -> dict[str, str]:
    """The values of a camera as its scene has them, in degrees, metres and pixels."""
    mount, lens = camera.mount, camera.intrinsics
    angles = {f"{name}_deg": np.degrees(getattr(mount, f"{name}_rad")) for name in ("roll", "pitch", "yaw")}
    return {name: f"{angle:.3f}°" for name, angle in angles.items()} | {
        "height_m": f"{mount.position_m[2]:.3f} m",
        "focal_share": f"{lens.focal_px[0]:.1f} px",
        "k1": f"{lens.distortion.k1 if lens.distortion else 0:.4f}",
    }
