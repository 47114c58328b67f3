"""Scenes from AIS with their page: what became of the reports of ships, with the map."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from modsim3d.core.document import Block, Document, Heading, Items, Result, Table, Text, Where
from modsim3d.core.paths import StrPath, as_path
from modsim3d.core.text import UNKNOWN, counted, percent_of
from modsim3d.core.written_files import OutputFiles
from modsim3d.detector.file.reading import find_detector, load_detector
from modsim3d.io.overwrite_guard import check_free, locked_folder
from modsim3d.scene.ais.gathering import SHOWN_PROBLEMS
from modsim3d.scene.ais.options import (
    Options,
    parse_end,
    parse_labels,
    parse_origin,
    parse_region,
    parse_time,
    time_text,
)
from modsim3d.scene.ais.scene_folder import (
    FILES,
    PAGE,
    REASONS,
    messages_read,
    messages_used,
    summary_rows,
    warning,
    write_scene,
)
from modsim3d.scene.ais.scene_folder import check_free as check_free_scene
from modsim3d.scene.ais.traffic import AisTraffic, read_traffic
from modsim3d.scene.ais.vessel_track import VesselTrack
from modsim3d.view.pages.ais_drawings import MAX_LANES, presence_chart, traffic_map
from modsim3d.view.pages.page import document_page
from modsim3d.view.pages.provenance import Provenance, file_input

MAX_ROWS = 200
NOT_SHIPS = "not_a_ship"
GUESSED = {"antenna": "place of the antenna", "air_draft": "air draft"}  # the others by their own names


def ais_page(traffic: AisTraffic, command: str | None = None) -> str:
    """The page as HTML, which says that `command` made it, or the call from Python if None; the same traffic from the
    same files gives the same page."""
    rests_on = Provenance(
        page="traffic from AIS",
        made_by=command or "modsim3d.ais(…) from Python",
        inputs=tuple(
            file_input("AIS log", tally.path, f"{tally.format}, {counted(tally.messages, 'message')}")
            for tally in traffic.files
        ),
        options=tuple(_options(traffic)),
    )
    blocks = [traffic_map(traffic), *_vessels(traffic), *_left_out(traffic), *_messages(traffic), *_jumps(traffic)]
    blocks += [*_times(traffic), *_values(traffic), *_how(traffic)]
    return document_page(Document("Traffic from AIS", _result(traffic), blocks), rests_on)


def _result(traffic: AisTraffic) -> list[Text]:
    kept, grid = len(traffic.vessels), traffic.grid
    span = f"from {_time(grid.start_s)} to {_time(grid.end_s)}"
    steps = f"{counted(len(grid.timestamps), 'step')}, one every {traffic.options.time_step_s:g} s"
    lead = f"{kept:,} of {counted(kept + len(_lost(traffic)), 'vessel')} in the scene, {span}: {steps}."
    jumps = sum(vessel.jumps for vessel in traffic.vessels)
    guessed = sum(bool({"length", "beam"} & set(vessel.hull.defaults)) for vessel in traffic.vessels)
    used = f"{messages_used(traffic):,} of {counted(messages_read(traffic), 'message')} used as positions"
    removed = f"{counted(jumps, 'position')} removed as {'a jump' if jumps == 1 else 'jumps'}"
    sizes = f"length or beam guessed for {counted(guessed, 'vessel')}"
    far = _farthest(traffic)
    bad = [f"Warning: {text}" for text in (warning(traffic),) if text]
    bad += [f"The farthest position is {far}."] if "where the plane" in far else []
    return [
        Text(lead, "lead"),
        *(Text(text, "bad") for text in bad),
        Text(f"{used}; {removed}; {sizes}. Air draft is not in AIS: it is typical of the ship type."),
    ]


def _lost(traffic: AisTraffic) -> dict[int, str]:
    """Vessels that are not in the scene, and why."""
    gap = f"at no step: no two reports around one are at most {traffic.options.max_gap_s:g} s apart"
    lost = dict.fromkeys(traffic.elsewhere, gap)
    for mmsi, reasons in traffic.left_out.items():
        if set(reasons) != {NOT_SHIPS}:
            several = sorted(reasons.items(), key=lambda entry: (-entry[1], entry[0]))
            reached = {name: REASONS[name].format(max_speed_kn=traffic.options.max_speed_kn) for name in reasons}
            lost[mmsi] = "; ".join(f"{reached[name]} ({count:,})" for name, count in several)
    return lost


def _vessels(traffic: AisTraffic) -> list[Block]:
    header = (
        *("MMSI", "name", "type", "label", "length, m", "beam, m", "air draft, m"),
        *("centre from antenna", "guessed from the type"),
    )
    rows = [
        (
            str(vessel.mmsi),
            _shown(vessel.hull.name) or UNKNOWN,
            vessel.hull.group.replace("_", " "),
            _shown(traffic.options.label(vessel.hull.group)),
            *(f"{value:g}" for value in (vessel.hull.length_m, vessel.hull.beam_m, vessel.hull.air_draft_m)),
            _offset(vessel),
            ", ".join(GUESSED.get(name, name) for name in vessel.hull.defaults),
        )
        for vessel in traffic.vessels
    ]
    note = (
        "Ships report the place of their antenna; the scene has the centres of hulls, moved by what the table says. "
        "Where a size is guessed, it is that of a typical ship of the type, and the antenna is in the middle."
    )
    return [Heading("Vessels in the scene"), Text(note), *_limited(rows, header)]


def _offset(vessel: VesselTrack) -> str:
    """Place of the centre of its hull, seen from its antenna."""
    ahead, port = vessel.hull.ahead_m, vessel.hull.to_port_m
    along = f"{'ahead' if ahead > 0 else 'astern'} {abs(ahead):g} m" if ahead else ""
    across = f"to {'port' if port > 0 else 'starboard'} {abs(port):g} m" if port else ""
    return ", ".join(part for part in (along, across) if part) or "the same"


def _left_out(traffic: AisTraffic) -> list[Block]:
    lost = _lost(traffic)
    stations = sum(set(reasons) == {NOT_SHIPS} for reasons in traffic.left_out.values())
    others = "1 other sender is no ship" if stations == 1 else f"{stations:,} other senders are no ships"
    also = f" {others}: {REASONS[NOT_SHIPS]}." if stations else ""
    parts: list[Block] = [Heading("Vessels that are not in the scene")]
    if not lost:
        return [*parts, Text(f"None: every vessel with a position is in the scene.{also}")]
    why = Counter(lost.values())
    if len(lost) > MAX_ROWS:  # too many to name: a log of a day, cut to a region
        groups = Counter(reason.rpartition(" (")[0] or reason for reason in lost.values())
        by_count = sorted(groups.items(), key=lambda item: (-item[1], item[0]))
        rows = [(reason, f"{count:,}") for reason, count in by_count]
        return [*parts, *_limited(rows, ("reason, of its positions", "vessels")), Text(also.strip())]
    rows = [(str(mmsi), reason) for mmsi, reason in sorted(lost.items(), key=lambda item: (-why[item[1]], item))]
    return [*parts, *_limited(rows, ("MMSI", "why, with the number of its positions")), Text(also.strip())]


def _messages(traffic: AisTraffic) -> list[Block]:
    read, used = messages_read(traffic), messages_used(traffic)
    particulars = traffic.dropped["particulars_only"]
    tables = dict(summary_rows(traffic))
    rows = [
        ("read", f"{read:,}", ""),
        ("used as positions", f"{used:,}", percent_of(used, read)),
        ("with names and dimensions only", f"{particulars:,}", percent_of(particulars, read)),
        *(
            (f"dropped: {meaning}", f"{int(count):,}", percent_of(int(count), read))
            for _, count, meaning in tables["messages dropped"]
        ),
    ]
    parts: list[Block] = [Heading("Messages"), Table("", ("messages", "number", "share"), rows)]
    for tally in traffic.files:
        if tally.problems:
            bad = sum(tally.dropped[reason] for reason in ("unreadable", "checksum", "undecodable"))
            shown = f", of which the first {len(tally.problems)}" if bad > SHOWN_PROBLEMS else ""
            parts.append(Text(f"{_shown(tally.path.name)}: what could not be read{shown}:"))
            parts.append(Items([_shown(problem) for problem in tally.problems]))
    return parts


def _jumps(traffic: AisTraffic) -> list[Block]:
    header = ("MMSI", "name", "seconds after the start", "w1, m", "w2, m", "off the track, m")
    rows = [row for vessel in traffic.vessels for row in _jump_rows(vessel)]
    limit = f"{traffic.options.max_speed_kn:g} kn"
    note = (
        f"A position is removed if the vessel can reach it only faster than {limit} from the one before, or the next "
        "one from it. The map has crosses there. All other positions are used as they were reported."
    )
    parts: list[Block] = [Heading("Positions removed as jumps"), Text(note)]
    return [*parts, *_limited(rows, header), Text("" if rows else "There are none.")]


def _jump_rows(vessel: VesselTrack) -> list[tuple[str, ...]]:
    way = [np.interp(vessel.jumps_s, vessel.reported_s, vessel.reported_m[:, axis]) for axis in (0, 1)]
    off_m = np.linalg.norm(vessel.jumps_m - np.stack(way, axis=-1), axis=-1)
    places = zip(vessel.jumps_s.tolist(), vessel.jumps_m.tolist(), off_m.tolist(), strict=True)
    return [
        (str(vessel.mmsi), _shown(vessel.hull.name) or UNKNOWN, f"{s:.0f}", f"{x:.0f}", f"{y:.0f}", f"{d:.0f}")
        for s, (x, y), d in places
    ]


def _times(traffic: AisTraffic) -> list[Block]:
    longest = f"{traffic.options.max_gap_s:g} s"
    note = (
        "Between two reports a vessel follows the curve that fits their positions, speeds and courses, or a straight "
        f"line where these do not fit. Where they are more than {longest} apart it is absent."
    )
    header = (
        *("MMSI", "name", "reports", "usual interval, s", "longest bridged, s"),
        *("gaps", "longest gap, s", "steps", "share of all steps"),
    )
    rows = [_time_row(vessel, traffic) for vessel in traffic.vessels]
    shown = "" if len(rows) <= MAX_LANES else f", of the {MAX_LANES} vessels that are absent for longest"
    chart = presence_chart(traffic, f"When each vessel is in the scene{shown}. Dots are its reports.")
    return [Heading("Between the reports"), Text(note), chart, *_limited(rows, header)]


def _time_row(vessel: VesselTrack, traffic: AisTraffic) -> tuple[str, ...]:
    apart_s = np.diff(vessel.reported_s)
    bridged, gaps = (apart_s[apart_s <= traffic.options.max_gap_s], apart_s[apart_s > traffic.options.max_gap_s])
    present, steps = len(vessel.steps), len(traffic.grid.timestamps)
    return (
        str(vessel.mmsi),
        _shown(vessel.hull.name) or UNKNOWN,
        f"{vessel.messages:,}",
        f"{np.median(apart_s):g}" if len(apart_s) else UNKNOWN,
        f"{bridged.max():g}" if len(bridged) else UNKNOWN,
        f"{len(gaps)}",
        f"{gaps.max():g}" if len(gaps) else UNKNOWN,
        f"{present:,}",
        percent_of(present, steps),
    )


def _values(traffic: AisTraffic) -> list[Block]:
    tables = dict(summary_rows(traffic))
    parts: list[Block] = [Heading("Values replaced and guessed")]
    nothing = "No value was missing in a message that was used."
    for title, missing, unit, none in (
        ("values replaced, in messages", "in a message", "messages", nothing),
        ("defaults, in vessels", "of a vessel", "vessels", "Nothing was guessed."),
    ):
        rows = [(f"{meaning[:1].upper()}{meaning[1:]}", f"{int(count):,}") for _, count, meaning in tables[title]]
        parts += [Table("", (f"missing {missing}: what stands for it", unit), rows), Text("" if rows else none)]
    return parts


def _how(traffic: AisTraffic) -> list[Block]:
    note = (
        "The sea is flat: latitude and longitude became metres east (w1) and north (w2) of the origin on the plane "
        f"that touches the Earth there. The farthest position is {_farthest(traffic).partition(',')[0]}."
    )
    return [Heading("From latitude and longitude to metres"), Text(note)]


def _options(traffic: AisTraffic) -> list[tuple[str, str]]:
    """The options that make this scene again, and which of them were given."""
    options, usual = traffic.options, Options()
    origin, given, default = "{:.7f},{:.7f}".format(*traffic.origin), "given", "by default"
    end = "by --end" if options.duration_s is not None else "the last report"
    rows = [
        (f"--origin {origin}", given if options.origin else "the median position"),
        (f"--start {time_text(traffic.grid.start_s)}", "the first report" if options.start_s is None else given),
        (f"--end {time_text(traffic.grid.end_s)}", end if options.end_s is None else given),
    ]
    if options.region is not None:
        rows.append((f"--region {options.region}", given))
    for name, value, unless in (
        ("time-step", options.time_step_s, usual.time_step_s),
        ("report-gap", options.max_gap_s, usual.max_gap_s),
        ("max-speed", options.max_speed_kn, usual.max_speed_kn),
    ):
        rows.append((f"--{name} {value:g}", default if value == unless else given))
    if options.swap_coordinates:
        rows.append(("--swap-coordinates", given))
    rows.append(("--label type", given) if options.labels_by_type else ("--label Vessel, for all", default))
    return rows + [(f"--label {group}={_shown(label)}", given) for group, label in sorted(options.labels.items())]


def _farthest(traffic: AisTraffic) -> str:
    rows = {name: (number, meaning) for _, table in summary_rows(traffic) for name, number, meaning in table}
    return " ".join(rows["farthest"])


def _limited(rows: Sequence[Sequence[str]], header: Sequence[str]) -> list[Block]:
    """A table of the first rows, and a line that says how many there are."""
    more = f"The first {MAX_ROWS} of {len(rows):,}; report.json has all vessels." if len(rows) > MAX_ROWS else ""
    return [Table("", header, rows[:MAX_ROWS]), Text(more, "soft")]


def _time(unix_s: float) -> str:
    return time_text(unix_s).replace("T", " ").replace("Z", " UTC")


def _shown(text: str) -> str:
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text)


# ---- The scene folder ----


@dataclass(frozen=True, repr=False, kw_only=True)
class AisScene(Result, OutputFiles):
    """A scene folder that was made from AIS, from `ais`; `traffic` has the vessels, and what became of the reports.

    scene = modsim3d.load_scene(modsim3d.ais("log.csv", "scenes/sound"))
    """

    traffic: AisTraffic

    def _document(self) -> Document:
        tables = [Table(title, (), rows, where=Where.EVERYWHERE) for title, rows in summary_rows(self.traffic)]
        return Document("", [Text(str(self.path))], tables)


def ais(
    files: StrPath | Sequence[StrPath],
    out: StrPath,
    *,
    origin: str | Sequence[float] | None = None,
    region: str | Sequence[float] | None = None,
    start: str | None = None,
    end: str | None = None,
    time_step_s: float = 1.0,
    max_gap_s: float = 400.0,
    max_speed_kn: float = 60.0,
    swap_coordinates: bool = False,
    labels: Sequence[str] | Mapping[str, str] = (),
    detector: StrPath = "vessel",
    overwrite: bool = False,
    call: str | None = None,
) -> AisScene:
    """Make a scene folder from real traffic: AIS of Denmark, MarineCadastre or a receiver.

        made = modsim3d.ais("aisdk-2024-01-04.csv", "scenes/sound", region=(55.6, 12.6, 55.8, 12.9), end="+600")

    Args:
        files, out: AIS logs, CSV or NMEA, gzipped or not; scene folder to write.
        origin: Latitude and longitude of the scene's origin, in degrees; the median position if None.
        region: Latitudes and longitudes of two corners, between which positions are kept; all are if None.
        start, end: Times of the first and last step, in UTC, or `+SECONDS` from the first; of all reports if None.
        time_step_s, max_gap_s: Time between steps; time between reports beyond which a vessel is absent.
        max_speed_kn: Drop a position that a vessel can reach only at a higher speed, in knots.
        swap_coordinates: Exchange latitude and longitude, for CSV files that have them swapped.
        labels: Labels by group of ship types, such as `{"cargo": "Ship"}`; `["type"]` for a label of each.
        detector: Detector file or shipped name of the scene.
        overwrite: Replace a scene that is there.
        call: Command that made the scene, for the foot of its page; this function if None.

    Raises:
        ModsimError: A file or an argument is wrong, no vessel is left, or the folder cannot be written.
        TypeError: A path is neither text nor a path.
    """
    texts = [f"{group}={label}" for group, label in labels.items()] if isinstance(labels, Mapping) else labels
    detector, folder = find_detector(detector), as_path(out, "out", "a folder")
    options = Options(
        origin=None if origin is None else parse_origin(origin),
        region=None if region is None else parse_region(region),
        start_s=None if start is None else parse_time(start, "--start"),
        **parse_end(end),
        time_step_s=time_step_s,
        max_gap_s=max_gap_s,
        max_speed_kn=max_speed_kn,
        swap_coordinates=swap_coordinates,
        labels_by_type="type" in texts,
        labels=parse_labels(text for text in texts if text != "type"),
        detector_labels=load_detector(detector).labels,
    )
    logs = [as_path(log, "files") for log in (files if isinstance(files, list | tuple) else [files])]
    return _written(logs, options, folder, detector, overwrite, call)


def _written(
    logs: list[Path], options: Options, folder: Path, detector: Path, overwrite: bool, call: str | None
) -> AisScene:
    """Scene folder of AIS logs and a detector file, with a page that names the command `call`."""
    check_free_scene(folder, overwrite)
    with locked_folder(folder):
        read = [file for file in logs if not file.is_dir()]  # folders are refused when they are read
        for name in FILES:
            check_free(folder / name, overwrite, [*read, detector])
        traffic = read_traffic(logs, options)
        write_scene(traffic, folder, detector, overwrite, ais_page(traffic, call))
    size = counted(len(traffic.vessels), "vessel"), counted(len(traffic.grid.timestamps), "step")
    odd = warning(traffic)
    return AisScene((folder, folder / PAGE), (", ".join(size), *([odd] if odd else [])), traffic=traffic)
