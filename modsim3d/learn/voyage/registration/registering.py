"""Registers a camera and its detector's clock against the truth that AIS and a scene give."""

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from modsim3d.core.arrays import Array
from modsim3d.core.boxes import centre_form, corner_form
from modsim3d.core.errors import ModsimError
from modsim3d.geometry.camera import Camera
from modsim3d.io.validation import nearest
from modsim3d.learn.voyage.attitude import Attitude
from modsim3d.learn.voyage.log_to_scene import Correction
from modsim3d.learn.voyage.registration import parameters
from modsim3d.learn.voyage.registration.estimating import PROBED, LastFit, blocks_of, columns, estimate, linearized
from modsim3d.learn.voyage.registration.icp import Aligner, Alignment, BoxesAtTimes, Sightings
from modsim3d.learn.voyage.registration.initial_guesses import check_matches, check_times, explained, rivals_of, starts
from modsim3d.learn.voyage.registration.model import BoxModel, HidingBodies, KnownTraffic
from modsim3d.learn.voyage.registration.parameters import SHARED, SHARED_NAMES, ConfoundedGroup, Linear, Values, flags
from modsim3d.scene.scene import Scene


@dataclass(frozen=True)
class RegisteredValue:
    """One number of a registration; zero is what the scene says. Of a held one, error and interval are nan."""

    name: str  # with unit, such as `pitch_deg`; of a vessel with the vessel's ID before: `ferry.delay_s`
    words: str
    unit: str
    value: float  # the estimate, or the value at which it is held
    standard_error: float
    low: float  # lower end of the 95 % interval
    high: float
    held: str = ""  # the rule by which it is held; empty if it was estimated


@dataclass(frozen=True, eq=False)
class Registration:
    """Differences of a camera and its detector's clock from the scene. Root mean squares are of bearings' and
    waterlines' residuals by the same matches, with the scene's values, nan if not in the image, and registered."""

    camera: str
    values: Values
    estimates: tuple[RegisteredValue, ...]  # the shared parameters, in order
    vessels: tuple[RegisteredValue, ...]  # of single vessels: only what the data determine
    covariance: Array  # of the estimated shared parameters, in the order of `estimates`, (p, p)
    groups: tuple[ConfoundedGroup, ...]  # what the data cannot tell apart, so that a rule had to settle it
    sightings: Sightings  # the matches that were used
    detections: int
    rms_before_px: float
    rms_after_px: float

    def __getitem__(self, name: str) -> RegisteredValue:
        """An estimate by its name, such as `pitch_deg` or `ferry.delay_s`."""
        return {entry.name: entry for entry in (*self.estimates, *self.vessels)}[name]

    @property
    def matched_vessels(self) -> int:
        """Number of vessels that were matched."""
        return len(np.unique(self.sightings.vessel))

    @property
    def correction(self) -> Correction:
        """Correction of the camera and of the clock by the estimates."""
        return Correction(**{field.name: self.values[field.name] for field in fields(Correction)})

    def camera_of(self, camera: Camera) -> Camera:
        """The camera as it really is, from the scene's."""
        return self.correction.camera(camera)

    def scene_of(self, scene: Scene) -> Scene:
        """The scene with the camera as it really is. The clock and the vessels are left as they are."""
        cameras = (self.camera_of(camera) if camera.name == self.camera else camera for camera in scene.cameras)
        return replace(scene, cameras=tuple(cameras))

    def __repr__(self) -> str:
        """The estimates line by line, then what could not be told apart."""
        lines = [f"registration of camera '{self.camera}' by {len(self.sightings)} of {self.detections} detections"]
        lines[0] += f" of {self.matched_vessels} vessels"
        lines.append(f"  residual {self.rms_before_px:.1f} px before, {self.rms_after_px:.1f} px after")
        for entry in (*self.estimates, *self.vessels):
            interval = f"held: {entry.held}" if entry.held else f"{entry.low:.4g} to {entry.high:.4g}"
            lines.append(f"  {entry.name:<20} {entry.value:>9.4g} {entry.unit:<3} ({interval})")
        return "\n".join([*lines, *(f"  by rule: {group.words()}" for group in self.groups)])


SEARCHED_S = 60.0
FIRST_FRAMES = 150
MAX_BOXES = 2500  # of more detections a fit takes frames spread evenly: neighbours have nearly the same errors
BY_RULE = ("mean_x_px", "mean_y_px")  # mean errors are zero, or given: in images nothing else looks like yaw and pitch
NORMAL = 1.96


def register(
    scene: Scene,
    camera: str,
    boxes: BoxesAtTimes,
    *,
    fixed: Sequence[str] = (),
    mean_errors: Sequence[float | None] = (None, None, None, None),
    use_sizes: bool = True,
    searched_s: float = SEARCHED_S,
    offsets_m: float | None = None,
    noise_m: float = 0.0,
    attitude: Attitude | None = None,
) -> Registration:
    """Estimate how a camera and its detector's clock differ from what the scene says:
    `register(scene, "quay", BoxesAtTimes(times_s, frame, boxes_px))`.
    Parameters in `fixed`, such as `pitch`, are held at the scene's values. Mean box errors in x and y, in pixels, and
    in width and height, as shares, are taken off and held. None where one is not known: those in x and y are taken to
    be zero then. Widths and heights of boxes do not count if the vessels' dimensions are guesses. The clock is looked
    for at offsets of at most `searched_s`.
    `offsets_m` is the standard deviation, over vessels, that is expected of how far positions are off, such as by
    unknown places of antennas. It counts as much as four vessels. With `noise_m`, reports are also expected to be late,
    by `DELAY_S` over vessels. None if nothing is expected: then the matches alone tell, which few vessels do badly.
    `noise_m` is the standard deviation, in each direction, of errors of positions that change over minutes, such as
    those of satellite navigation: see `drift_axes`. The attitude of own ship as it was measured replaces the scene's
    waves. Raises ModsimError, with the reason, if the data cannot tell."""
    eye = _camera(scene, camera)
    if scene.live:
        raise ModsimError(f"{scene.title}: a registration needs poses that are known beforehand, not live ones")
    model = BoxModel.of(scene, KnownTraffic.of(scene, eye, attitude))
    check_times(model, boxes, searched_s)
    given = _corrected(boxes, np.array([value or 0.0 for value in mean_errors]))
    known_means = {name: value for name, value in zip(_MEANS, mean_errors, strict=True) if value is not None}
    free = _free_names([*fixed, *BY_RULE, *known_means, *(() if use_sizes else _SIZES)])
    hiding = HidingBodies.of(scene, model)
    # Offsets of the clock are searched with few frames, and the best is fitted with more, all values tied to the scene.
    few = Aligner(model, hiding, given.some(FIRST_FRAMES), free, use_sizes)
    best, rivals = starts(few, searched_s, float(np.hypot(offsets_m or 0.0, noise_m)), scene)
    some = given.some(max(int(len(given.times_s) * MAX_BOXES / len(given.frame)), FIRST_FRAMES))
    tied = Aligner(model, hiding, some, free, use_sizes)
    aligned = tied.until_stable(tied.first(best), tied.all_unknowns(), tied=True)
    check_matches(model, aligned, scene.vessel_names)
    linear = linearized(tied, aligned)
    chosen = Linear(columns(linear, free), linear.residuals)
    groups = parameters.undetermined(chosen, free, blocks_of(aligned.residuals))
    # Values that the data do not determine are the scene's; the others are fitted without ties, from each start.
    lost = {group.held for group in groups}
    free = tuple(name for name in free if name not in lost)
    last = _LastFit(Aligner(model, hiding, some, free, use_sizes), free, lost, offsets_m, noise_m, scene.vessel_names)
    estimated, knowledge = _best(last.aligner, [last.of(aligned), *filter(None, map(last.from_start, rivals))], free)
    check_matches(model, estimated.aligned, scene.vessel_names)
    vessels = _vessel_estimates(scene, model, estimated.aligned, estimated.effects, knowledge.covariance)
    rules = _rules(fixed, {*free, *lost}, groups, known_means)
    # Held by a rule: what the others would be under another one.
    groups += [
        parameters.exchange(estimated.linear, PROBED, name, list(free)) for name in (*BY_RULE, parameters.COMMON_DELAY)
    ]
    aligned = estimated.aligned
    if some is not given:
        aligned = Aligner(model, hiding, given, free, use_sizes).matched(aligned)
    return _registration(camera, model, aligned, free, knowledge, known_means, rules, groups, vessels, len(boxes.frame))


_MEANS = tuple(parameter.name for parameter in parameters.MEAN_ERRORS)
_SIZES = _MEANS[2:]


def _free_names(held_names: Sequence[str]) -> tuple[str, ...]:
    """Names of the shared parameters that are not held. Raises ModsimError if all are held, or a name is of none."""
    free = tuple(name for name, is_held in zip(SHARED_NAMES, flags(held_names), strict=True) if not is_held)
    if not free:
        raise ModsimError("fixed: all parameters are fixed; leave at least one to be estimated")
    return free


def _rules(
    fixed: Sequence[str], estimated: Container[str], groups: Sequence[ConfoundedGroup], known_means: Mapping[str, float]
) -> dict[str, str]:
    """Rule by which each parameter is held that is; those of `estimated` were free at first."""
    rules = {name: "fixed by the user" for name, is_held in zip(SHARED_NAMES, flags(fixed), strict=True) if is_held}
    rules |= {name: "mean errors are taken to be zero" for name in (*BY_RULE, *_SIZES) if name not in estimated}
    rules |= {group.held: f"not determined: {group.words()}" for group in groups}
    for name, value in known_means.items():
        rules[name] = f"given as {value:+g} px" if name in BY_RULE else f"given as {100 * value:+g} %"
    return rules


def _camera(scene: Scene, name: str) -> Camera:
    cameras = {camera.name: camera for camera in scene.cameras}
    if name not in cameras:
        raise ModsimError(f"{scene.title}: no camera '{name}' ({nearest(name, list(cameras))})")
    return cameras[name]


def _corrected(detections: BoxesAtTimes, mean: Array) -> BoxesAtTimes:
    """The detections with given mean errors taken off: x and y in pixels, width and height as shares."""
    if mean.shape != (4,) or not np.isfinite(mean).all() or np.any(mean[2:] <= -1):
        raise ModsimError(f"mean_errors: four numbers x, y, width, height are needed (got {mean.tolist()})")
    boxes = centre_form(detections.boxes_px)
    boxes[:, :2] -= mean[:2]
    boxes[:, 2:] /= 1 + mean[2:]
    return BoxesAtTimes(detections.times_s, detections.frame, corner_form(boxes))


@dataclass(frozen=True, eq=False)
class _LastFit:
    """The last fit, in which undetermined values are the scene's, without ties to them; see `register`."""

    aligner: Aligner
    free: tuple[str, ...]  # the values that are fitted
    lost: set[str]  # the undetermined ones
    offsets_m: float | None
    noise_m: float
    names: tuple[str, ...]  # of the vessels

    def of(self, aligned: Alignment) -> LastFit:
        """The fit from an alignment."""
        return estimate(self.aligner, self._settled(aligned), self.free, self.offsets_m, self.noise_m)

    def from_start(self, start: Values) -> LastFit | None:
        """The fit from other values; None where its matches come to nothing, so that it is no registration."""
        aligner = self.aligner
        aligned = aligner.until_stable(aligner.first(start), aligner.all_unknowns(), tied=True)
        try:
            settled = self._settled(aligned)
            check_matches(aligner.model, settled, self.names)
            fitted = estimate(aligner, settled, self.free, self.offsets_m, self.noise_m)
            check_matches(aligner.model, fitted.aligned, self.names)
        except ModsimError:
            return None
        return fitted

    def _settled(self, aligned: Alignment) -> Alignment:
        back = aligned.values.changed(**dict.fromkeys(self.lost, 0.0))
        again = Alignment(back, aligned.sightings, aligned.residuals, aligned.spreads_px)
        return self.aligner.until_stable(again, self.aligner.all_unknowns(), tied=False)


def _best(aligner: Aligner, fits: Sequence[LastFit], free: tuple[str, ...]) -> tuple[LastFit, parameters.Knowledge]:
    """The fit that explains the detections best, with intervals that hold those nearly as good, too."""
    if len(fits) == 1:
        return fits[0], fits[0].knowledge
    scored = [(explained(aligner, fit.aligned), fit) for fit in fits]
    (most, best), *others = sorted(scored, key=lambda pair: -float(pair[0].sum()))
    values = best.aligned.values
    rivals = rivals_of(most, values, [(less, fit.aligned.values) for less, fit in others])
    return best, parameters.covering(best.knowledge, [rival.scaled(free) - values.scaled(free) for rival in rivals])


def _vessel_estimates(
    scene: Scene, model: BoxModel, aligned: Alignment, effects: parameters.VesselEffects, covariance: Array
) -> tuple[RegisteredValue, ...]:
    """Determined values of single vessels; `covariance` is that of the camera's parameters in plausible distances."""
    if not effects.spreads.any():
        return ()
    times_s = aligned.sightings.time_s + aligned.values["clock_s"]
    vessel, traffic = aligned.sightings.vessel, model.traffic
    moved = traffic.at(times_s + 0.5, vessel)[0] - traffic.at(times_s - 0.5, vessel)[0]
    metres = np.hypot(moved[:, 0], moved[:, 1])
    totals, counts = (np.bincount(vessel, values, len(model.hulls_m)) for values in (metres, None))
    speeds = (totals / np.maximum(counts, 1))[effects.vessels]  # the last matches may be without one of them
    return tuple(
        RegisteredValue(name, words, unit, value, error, value - NORMAL * error, value + NORMAL * error)
        for name, words, unit, value, error in parameters.vessel_values(effects, covariance, speeds, scene.vessel_names)
    )


def _registration(
    camera: str,
    model: BoxModel,
    aligned: Alignment,
    free: tuple[str, ...],
    knowledge: parameters.Knowledge,
    means: Mapping[str, float],
    rules: dict[str, str],
    groups: list[ConfoundedGroup],
    vessels: tuple[RegisteredValue, ...],
    detections: int,
) -> Registration:
    scales, estimates, nan = parameters.plausible(free), [], float("nan")
    for parameter in SHARED:
        value = means.get(parameter.name, aligned.values[parameter.name])
        error, half = nan, nan
        if parameter.name in free:
            place = free.index(parameter.name)
            error, half = (float(column[place] * scales[place]) for column in (knowledge.errors, knowledge.half_widths))
        about, rule = (parameter.name, parameter.words, parameter.unit), rules.get(parameter.name, "")
        estimates.append(RegisteredValue(*about, value, error, value - half, value + half, rule))
    before, after = (_rms(model, aligned, values) for values in (Values.none(len(model.hulls_m)), aligned.values))
    parts = tuple(estimates), vessels, knowledge.covariance * scales[:, None] * scales, tuple(groups)
    return Registration(camera, aligned.values, *parts, aligned.sightings, detections, before, after)


def _rms(model: BoxModel, aligned: Alignment, values: Values) -> float:
    px = aligned.residuals.px(model, values)[aligned.residuals.kind <= 3]
    return float(np.sqrt(np.mean(px**2))) if len(px) else float("nan")
