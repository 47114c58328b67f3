"""The options of `modsim3d ais`, and how they are read from text."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

from modsim3d.core.errors import InputError
from modsim3d.core.text import number_in
from modsim3d.io.validation import nearest, shown
from modsim3d.scene.ais.hulls import ship_types
from modsim3d.scene.ais.messages import SeaRegion

COMMAND_LINE = "command line"
MIN_VALUE, MAX_VALUE = 1e-6, 1e9  # of every time and speed: a microsecond, and 30 years


@dataclass(frozen=True)
class Options:
    """Choices of the user, as docs/ais.md lists them."""

    origin: tuple[float, float] | None = None  # latitude and longitude of w1 = w2 = 0; the median position if None
    region: SeaRegion | None = None  # positions outside are dropped; none are if None
    start_s: float | None = None  # Unix time of the first step; the first report's if None
    end_s: float | None = None  # Unix time of the last step; the last report's if None
    duration_s: float | None = None  # from the first step to the last, in place of the end
    time_step_s: float = 1.0
    max_gap_s: float = 400.0  # a vessel is away between reports that are further apart
    max_speed_kn: float = 60.0  # a position that a vessel can reach only at a higher speed is dropped
    swap_coordinates: bool = False
    labels_by_type: bool = False  # label vessels by group of ship type, not all of them `Vessel`
    labels: Mapping[str, str] = field(default_factory=dict)  # by group, for some or all groups
    detector_labels: tuple[str, ...] = ("Vessel",)

    def label(self, group: str) -> str:
        """The label of a vessel of a group: as asked for, the only one of the detector, or the first of the group's
        names that is one; empty if none is, or the detector lacks what is asked for."""
        labels = {_plain(label): label for label in self.detector_labels}
        only = self.detector_labels[0] if len(labels) == 1 else None
        asked = self.labels.get(group, ship_types()[group].label if self.labels_by_type else only)
        names = ship_types()[group].names if asked is None else [asked]
        usual = asked if only and asked else ""
        return next((labels[_plain(name)] for name in names if _plain(name) in labels), usual)

    def check_labels(self, groups: Iterable[str]) -> None:
        """Raise InputError with every group, of those that are there, that has no label of the detector."""
        missing = [group for group in sorted(set(groups)) if not self.label(group)]
        lacking = [f"{group} (not {shown(self.labels[group])})" if group in self.labels else group for group in missing]
        if lacking:
            problem = f"the detector has no label for {', '.join(lacking)}: give --label GROUP=LABEL for each"
            raise InputError(COMMAND_LINE, [f"--detector: {problem}, with {' or '.join(self.detector_labels)}"])

    @property
    def window_s(self) -> tuple[float, float]:
        """Unix times of the first and last report that may matter: start and end, each widened by the longest gap."""
        first_s = -math.inf if self.start_s is None else self.start_s
        last_s = math.inf if self.end_s is None else self.end_s
        if self.start_s is not None and self.duration_s is not None:
            last_s = self.start_s + self.duration_s
        return first_s - self.max_gap_s, last_s + self.max_gap_s

    def check(self) -> None:
        """Raise InputError with every value that is impossible or contradicts another."""
        problems = [
            f"--{name}: must be above 0, from {MIN_VALUE:g} to {MAX_VALUE:g} (got {value:g})"
            for name, value in (
                ("time-step", self.time_step_s),
                ("report-gap", self.max_gap_s),
                ("max-speed", self.max_speed_kn),
                ("end +SECONDS", self.duration_s),
            )
            if value is not None and not MIN_VALUE <= value <= MAX_VALUE
        ]
        if self.start_s is not None and self.end_s is not None and self.end_s < self.start_s:
            problems.append(f"--end: {time_text(self.end_s)} is before --start, {time_text(self.start_s)}")
        if problems:
            raise InputError(COMMAND_LINE, problems)


def _plain(label: str) -> str:
    return "".join(filter(str.isalnum, label.lower()))


FIRST_TEXT_S, LAST_TEXT_S = (datetime(year, 1, 2, tzinfo=UTC).timestamp() for year in (1, 9999))


def time_text(unix_s: float) -> str:
    """A time as text, such as 2024-01-04T10:00:00Z; years from 1 to 9999, a time outside as a number of seconds."""
    if not FIRST_TEXT_S <= unix_s < LAST_TEXT_S:
        return f"{unix_s:g} s after 1970"
    text = datetime.fromtimestamp(unix_s, UTC).isoformat(timespec="milliseconds")
    return text.removesuffix("+00:00").removesuffix(".000") + "Z"


def parse_time(text: str, option: str) -> float:
    """Unix time of a date and time of ISO 8601; without a zone it is UTC, as in AIS. Raises InputError for others."""
    try:
        when = datetime.fromisoformat(text)
    except ValueError:
        problem = f"{option}: a time such as 2024-01-04T10:00:00 is needed, in UTC (got {shown(text)})"
        raise InputError(COMMAND_LINE, [problem]) from None
    return (when if when.tzinfo else when.replace(tzinfo=UTC)).timestamp()


def parse_end(text: str | None) -> dict[str, float]:
    """The option `end_s` or, of a text such as `+600`, `duration_s`. Raises InputError for other texts."""
    if not text:
        return {}
    if not text.startswith("+"):
        return {"end_s": parse_time(text, "--end")}
    seconds = number_in(text)
    if math.isnan(seconds):
        raise InputError(COMMAND_LINE, [f"--end: needs seconds after the first step, as in +600 (got {shown(text)})"])
    return {"duration_s": seconds}


def parse_origin(text: str | Sequence[float]) -> tuple[float, float]:
    """Latitude and longitude of the origin."""
    latitude, longitude = _degrees(text, "--origin", "LAT,LON")
    return latitude, longitude


def parse_region(text: str | Sequence[float]) -> SeaRegion:
    """A region from two of its corners."""
    return SeaRegion.between(*_degrees(text, "--region", "LAT1,LON1,LAT2,LON2"))


def _degrees(text: str | Sequence[float], option: str, form: str) -> list[float]:
    """Numbers from a text of latitudes and longitudes in turn, separated by commas, as many as `form` names. Raises
    InputError if there are more or fewer numbers, or one is out of range."""
    text = text if isinstance(text, str) else ",".join(map(str, text))
    parts = text.split(",")
    try:
        values = [float(part) for part in parts]
    except ValueError:
        values = []
    if len(values) != len(form.split(",")) or not all(map(math.isfinite, values)):
        raise InputError(COMMAND_LINE, [f"{option}: {form} in degrees is needed (got {shown(text)})"])
    problems = [
        f"{option}: latitude {latitude:g} is beyond ±90"
        + (": latitude comes first" if abs(longitude) <= 90 and abs(latitude) <= 180 else "")
        for latitude, longitude in zip(values[::2], values[1::2], strict=True)
        if abs(latitude) > 90
    ]
    problems += [
        f"{option}: longitude {longitude:g} is beyond ±180" for longitude in values[1::2] if abs(longitude) > 180
    ]
    if problems:
        raise InputError(COMMAND_LINE, problems)
    return values


def parse_labels(texts: Iterable[str]) -> dict[str, str]:
    """Labels by group, from texts such as `passenger=Ferry`. Raises InputError with every problem found."""
    labels: dict[str, str] = {}
    problems = []
    for text in texts:
        group, sign, label = (part.strip() for part in text.partition("="))
        if not sign or not label or not label.isprintable():
            problems.append(f"--label: GROUP=LABEL is needed (got {shown(text)})")
        elif group not in ship_types():
            problems.append(f"--label: no group {shown(group)} ({nearest(shown(group), ship_types())})")
        labels[group] = label
    if problems:
        raise InputError(COMMAND_LINE, problems)
    return labels
