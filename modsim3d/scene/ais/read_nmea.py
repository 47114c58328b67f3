r"""Reads AIS reports from NMEA sentences, through pyais.

A sentence gives only the second of the minute at which it was sent, so a log must add the time, as

- a tag block before the sentence, `\s:station,c:1423133048*5F\!AIVDM,...` (NMEA 0183 version 4.10, section 7; E. S.
  Raymond, "AIVDM/AIVDO protocol decoding", section "NMEA 4.10 Tag Blocks"): `c` is Unix time;
- a date and time before the sentence or after it, as OpenCPN, IWRAP and AIS-catcher write it;
- a Unix time there, as the United States Coast Guard's and many receivers' logs have it: `1423133048 !AIVDM,...` or
  `!AIVDM,...*5C,r003669945,1423133048`.

`time_beside` has the rules. All parts of a message may have the time, or only the first.

Of the message types of ITU-R M.1371-5, 1 to 3 (class A), 18 and 19 (class B) are positions of ships; 5, 19 and 24 are
particulars; 4, 9, 11 and 21 are base stations, aircraft and aids to navigation. Type 27 gives positions to 0.1 minute
(180 m), which is too coarse to move a vessel by. All others say nothing of where ships are.
"""

import re
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import datetime
from functools import reduce
from operator import xor
from pathlib import Path
from typing import IO, Any

import numpy as np

from modsim3d.core.errors import InputError
from modsim3d.io.validation import shown
from modsim3d.scene.ais.messages import Chunk, Particulars, Positions
from modsim3d.scene.ais.read_csv import open_reports, source_of

_UNIX = r"[1-9](?:\d{15}|\d{12}|\d{9}(?:\.\d+)?)"
_ALONE = re.compile(rf"(?<![\w.:+-])({_UNIX})(?![\w.:])")
_NAME = r"\b(?:toa|(?:rx)?(?:ux)?time(?:stamp)?)\"?\s*[:=]\s*\"?"
_NAMED = re.compile(rf"{_NAME}({_UNIX})(?![\w.:])", re.IGNORECASE)
_NAME_BEFORE = re.compile(rf"{_NAME}$", re.IGNORECASE)
_TAG = re.compile(r"(?:^|,)c:(\d+(?:\.\d+)?)(?:,|$)")
_ZONE = r"(?:\s?((?i:Z|UTC|GMT)|[+-]\d\d:?\d\d)|([+-]\d\d))?"
_NO_WORD = r"(?![\w.:]|\s?[+-]\d|\s?[\[(]?(?!(?:AIS|NMEA|UDP|TCP|DEBUG|INFO)\b)[A-Za-z])"
_CLOCK = rf"(\d\d)(:?)(\d\d)\6((?:[0-5]\d|60)(?:\.\d+)?){_ZONE}{_NO_WORD}"
_YEAR_FIRST = re.compile(rf"(?<![\w.])(\d{{4}})([-/.]?)(\d\d)\2(\d\d)(?:[T _]|, ?)?{_CLOCK}")
_YEAR_LAST = re.compile(rf"(?<![\w.])(\d\d)([-.])(\d\d)\2(\d{{4}})(?:[T _]|, ?){_CLOCK}")
_FIRST_S, _FIRST_LOG_S, _LAST_S, _DAY_S = 631_152_000.0, 1_041_379_200.0, 4_102_444_800.0, 86400.0
"""1990, 2003, and 2100."""


def time_beside(tag: str | None, before: str, after: str) -> float | None:
    """Unix time that a tag block or the text around a sentence has; None if neither has one. What has a name such as
    `toa` or `rxtime` comes first, then dates. Of several Unix times the first before the sentence counts, or the last
    after it; none where they are more than a day apart, for one is something else."""
    if tag and (match := _TAG.search(tag)) and _FIRST_S <= (said_s := _unix_s(match[1])) < _LAST_S:
        return said_s
    text = f"{before}|{after}"
    if times := [*_times(_NAMED.findall(text)), *(value for *_, value in sorted(_dates(text)))]:
        return times[0]
    alone = _times([*reversed(_ALONE.findall(after)), *_ALONE.findall(before)])
    return alone[0] if alone and max(alone) - min(alone) <= _DAY_S else None


def _times(numbers: list[str]) -> list[float]:
    """Unix times among some that a log of AIS can have."""
    return [value for value in map(_unix_s, numbers) if _FIRST_LOG_S <= value < time.time() + _DAY_S]


def _unix_s(text: str) -> float:
    """Seconds of a Unix time, of which 13 digits are milliseconds, 16 microseconds and 19 nanoseconds."""
    digits = len(text.partition(".")[0])
    return float(text) / 10 ** (digits - 10) if digits in (13, 16, 19) else float(text)


def _dates(text: str) -> Iterator[tuple[bool, int, float]]:
    """The dates with times in a text: whether they have no name, their place, and the Unix time."""
    for pattern, order in ((_YEAR_FIRST, (1, 3, 4)), (_YEAR_LAST, (4, 3, 1))):
        for match in pattern.finditer(text):
            zone = match[9] if match[9] and match[9][0] in "+-" else match[10] or "Z"
            try:
                minute = datetime.fromisoformat(f"{'-'.join(match[k] for k in order)}T{match[5]}:{match[7]}{zone}")
            except ValueError:
                continue
            value = minute.timestamp() + float(match[8])
            if _FIRST_S <= value < _LAST_S:
                yield _NAME_BEFORE.search(text, 0, match.start()) is None, match.start(), value


SENTENCE = re.compile(r"[!$][A-Z]{2}VD[MO],[^*]*\*[0-9A-Fa-f]{2}")
START = re.compile(rb"[!$][A-Z]{2}VD[MO],")
OTHER_SENTENCE = re.compile(r"[\\!$]")
POSITIONS, PARTICULARS, STATIONS, LONG_RANGE = {1, 2, 3, 18, 19}, {5, 19, 24}, {4, 9, 11, 21}, 27
PENDING_S = 60.0  # parts of a message that are further apart do not belong together: sequence numbers are used again
CHUNK_MESSAGES, SHOWN_PROBLEMS = 200_000, 5
MAX_LINE_BYTES, READ_AT_ONCE = 2048, 1 << 20
"""A sentence has at most 82 characters and a tag block 80; a line of JSON around them takes a thousand. The time
to search a line grows with its square."""
MAX_PARTS, MAX_PENDING = 9, 1000
"""Parts of a message, by the standard, and messages that wait for parts: sequence numbers and channels are few."""
SIZES = ("to_bow", "to_stern", "to_port", "to_starboard")
TIME_NEEDED = (
    r"has no times, and AIS sentences carry none of their own: record them with a tag block "
    r"(\c:1423133048*hh\!AIVDM,...), or with a Unix time, in seconds or milliseconds, or a date and time such as "
    "2024-01-04T10:00:00Z before or after each sentence"
)
FEW_BEATS, MAX_BEATS, LOOSE_BEAT = 50, 10_000, 0.3
"""Positions that are looked at, and how far a mean of unit vectors is from 0 where seconds are any."""
MINUTE = re.compile(r"\d\d(0[1-9]|1[0-2])(0[1-9]|[12]\d|3[01])([01]\d|2[0-3])[0-5]\d")
"""A date and time as yymmddHHMM. Unix times of more than a minute do not all look like that: they count on after 59."""


@dataclass(frozen=True)
class _Part:
    """One sentence of a message, as pyais has it, and the line where it stands."""

    sentence: Any
    time_s: float | None
    line: int
    around: str


@dataclass
class _Rows:
    """Rows and counts of the chunk that is being read, and by how much times are after the seconds in the messages."""

    positions: list[tuple[float, ...]] = field(default_factory=list)
    particulars: list[tuple[Any, ...]] = field(default_factory=list)
    dropped: Counter[str] = field(default_factory=Counter)
    problems: list[str] = field(default_factory=list)
    messages: int = 0
    beats: list[float] = field(default_factory=list)

    def drop(self, reason: str, line: int, problem: str | None = None) -> None:
        self.messages += 1
        self.dropped[reason] += 1
        if problem and len(self.problems) < SHOWN_PROBLEMS:
            self.problems.append(f"line {line}: {problem}")

    def odd(self) -> str:
        """Fault of times whose seconds have nothing to do with those that ships send with positions."""
        beats = np.array(self.beats)
        if len(beats) < FEW_BEATS or np.abs(np.exp(2j * np.pi / 60 * beats).mean()) > LOOSE_BEAT:
            return ""
        fault = "the seconds of the times beside its sentences are not those in the messages"
        return f"{fault}: are these times, or do they count something else?"

    def chunk(self) -> Chunk:
        """The rows as columns; begins the next chunk."""
        numbers = np.array(self.positions, dtype=np.float64).reshape(-1, 8)
        _, times, latitude, longitude, speed, course, heading, _ = numbers.T
        mmsi, lines = numbers[:, 0].astype(np.int64), numbers[:, 7].astype(np.int64)
        ships = np.ones(len(numbers), dtype=bool)
        positions = Positions(mmsi, times, latitude, longitude, speed, course, heading, ships, lines)
        columns = np.array(self.particulars, dtype=object).reshape(-1, 10).T
        sizes = columns[4:].astype(np.float64)
        particulars = Particulars(columns[0].astype(np.int64), columns[1].astype(np.float64), *columns[2:4], *sizes)
        done = Chunk(positions, particulars, self.messages, self.dropped, tuple(self.problems), self.odd())
        self.positions, self.particulars, self.problems = [], [], []
        self.dropped, self.messages = Counter(), 0
        return done


def read_nmea(path: Path) -> Iterator[Chunk]:
    """Reports of a log of NMEA sentences. Raises InputError if it cannot be read, or no sentence in it has a time."""
    rows = _Rows()
    timed, untimed, around = 0, 0, ""
    first_s, last_s, minutes = np.inf, -np.inf, True
    with open_reports(path) as stream:
        for parts in _messages(stream, rows):
            time_s = next((part.time_s for part in parts if part.time_s is not None), None)
            if time_s is None:
                untimed, around = untimed + 1, around or parts[0].around
                rows.drop("no_time", parts[0].line, "has no time")
            else:
                timed += 1
                first_s, last_s = min(first_s, time_s), max(last_s, time_s)
                minutes = minutes and MINUTE.fullmatch(f"{time_s:.10g}") is not None
                _decode(parts, time_s, rows)
            if rows.messages >= CHUNK_MESSAGES:
                yield rows.chunk()
    if untimed and not timed:
        hint = f" (beside the first stands {shown(around)})" if around else ""
        raise InputError(source_of(path), [TIME_NEEDED + hint])
    if minutes and timed > 2 and last_s - first_s >= 60:
        problem = "the numbers beside its sentences are dates such as yymmddHHMM, must be Unix times, in seconds"
        raise InputError(source_of(path), [f"{problem} (got {first_s:.0f} to {last_s:.0f})"])
    yield rows.chunk()


def _messages(stream: IO[bytes], rows: _Rows) -> Iterator[list[_Part]]:
    """The parts of each whole message; incomplete messages are counted as dropped."""
    pending: dict[tuple[Any, ...], dict[int, _Part]] = {}

    def give_up(line: int) -> None:
        rows.drop("incomplete", line, "other parts of this message are missing")

    for part in _parts(stream, rows):
        sentence = part.sentence
        key = (sentence.talker_id, sentence.frag_cnt, sentence.seq_id, sentence.channel)
        parts = pending.setdefault(key, {}) if sentence.frag_cnt != 1 else {}
        if sentence.frag_num in parts or not _close(parts, part):
            give_up(part.line)
            parts.clear()
        parts[sentence.frag_num] = part
        if len(pending) > MAX_PENDING:
            give_up(min(part.line for part in pending.pop(next(iter(pending))).values()))
        if len(parts) == sentence.frag_cnt:
            yield [parts[place] for place in sorted(parts)]
            pending.pop(key, None)
    for parts in pending.values():
        give_up(min(part.line for part in parts.values()))


def _parts(stream: IO[bytes], rows: _Rows) -> Iterator[_Part]:
    """All AIS sentences; broken ones are counted as dropped, and comments and other instruments' are passed over."""
    from pyais.exceptions import AISBaseException
    from pyais.messages import AISSentence, NMEASentenceFactory

    for number, raw in _lines(stream):
        if not raw:
            rows.drop("too_long", number, f"has sentences, and more than {MAX_LINE_BYTES} bytes")
        for line in _split(raw.decode("ascii", "replace")):
            try:
                sentence = NMEASentenceFactory.produce(line.sentence.encode("ascii"))
            except (AISBaseException, ValueError, IndexError, UnicodeEncodeError):
                rows.drop("undecodable", number, "is not a whole AIS sentence")
                continue
            if not isinstance(sentence, AISSentence) or not sentence.is_valid or not _tag_holds(line.tag):
                none = ": its tag block has none" if line.tag and "*" not in line.tag else ""
                rows.drop("checksum", number, f"does not match its checksum{none}")
            elif not 1 <= sentence.frag_num <= sentence.frag_cnt <= MAX_PARTS:
                rows.drop("undecodable", number, f"a message has 1 to {MAX_PARTS} parts")
            else:
                tag = line.tag and line.tag.rpartition("*")[0]
                time_s = time_beside(tag, line.before, line.after)
                yield _Part(sentence, time_s, number, f"{line.before}{tag or ''} {line.after}".strip())


def _lines(stream: IO[bytes]) -> Iterator[tuple[int, bytes]]:
    """Numbers and texts of the lines that may hold a sentence, by its letters; no text for each of a line too long."""
    number, rest = 1, b""
    while piece := stream.read(READ_AT_ONCE):
        block = rest + piece
        stop = block.rfind(b"\n") + 1
        yield from _telling(block[:stop], number)
        number += block.count(b"\n")
        rest = block[stop:]
        if len(rest) > MAX_LINE_BYTES:
            yield from _telling(rest, number)
            rest = b" " * (MAX_LINE_BYTES + 1)  # enough to know it
    yield from _telling(rest, number)


def _telling(block: bytes, first: int) -> Iterator[tuple[int, bytes]]:
    """Lines of a block that have a sentence's letters, numbered from `first`; nothing for each of a line too long."""
    at, counted = block.find(b"VD"), 0
    while at >= 0:
        begin, end = block.rfind(b"\n", 0, at) + 1, block.find(b"\n", at)
        end = len(block) if end < 0 else end
        first, counted = first + block.count(b"\n", counted, begin), begin
        too_long = end - begin > MAX_LINE_BYTES
        yield from (
            [(first, b"") for _ in START.finditer(block, begin, end)] if too_long else [(first, block[begin:end])]
        )
        at = block.find(b"VD", end)


@dataclass(frozen=True)
class _Line:
    """A line with a sentence: the text before it, the content of a tag block, and the text after it."""

    before: str
    tag: str | None
    sentence: str
    after: str


def _split(line: str) -> Iterator[_Line]:
    """The first sentence of a line and what stands around it, or all sentences of a line of JSON."""
    match = SENTENCE.search(line)
    if match is None:
        return
    if line.startswith("{"):
        around = SENTENCE.sub("", line)
        yield from (_Line(around, None, sentence, "") for sentence in SENTENCE.findall(line))
        return
    before, tag = line[: match.start()], None
    start, stop = before.rfind("\\", 0, max(before.rfind("\\"), 0)), before.rfind("\\")
    between = before[stop + 1 :]
    if start >= 0 and not OTHER_SENTENCE.search(between):
        tag, before = before[start + 1 : stop], before[:start]
    else:
        before, between = between, ""
    yield _Line(f"{OTHER_SENTENCE.split(before)[-1]} {between}", tag, match[0], line[match.end() :])


def _close(parts: dict[int, _Part], part: _Part) -> bool:
    """Whether a part was sent at about the time of those before it."""
    times = [other.time_s for other in parts.values() if other.time_s is not None]
    return part.time_s is None or not times or abs(part.time_s - times[0]) <= PENDING_S


def _tag_holds(tag: str | None) -> bool:
    """Whether a tag block matches its checksum; true without a tag block."""
    if tag is None:
        return True
    parts = re.fullmatch(r"(.*)\*\s*([0-9A-Fa-f]{1,2})\s*", tag)
    return parts is not None and reduce(xor, parts[1].encode("ascii", "replace"), 0) == int(parts[2], 16)


def _decode(parts: list[_Part], time_s: float, rows: _Rows) -> None:
    """Add what a message says to the rows, or count it as dropped."""
    from pyais.messages import AISSentence

    line = parts[0].line
    try:
        message: Any = AISSentence.assemble_from_iterable([part.sentence for part in parts]).decode()
        kind, mmsi = int(message.msg_type), int(message.mmsi)
        if kind in STATIONS:
            rows.drop("not_a_ship", line)
        elif kind == LONG_RANGE:
            rows.drop("long_range", line)
        elif kind not in POSITIONS | PARTICULARS:
            rows.drop("other_message", line)
        else:
            if kind in POSITIONS:
                names = ("lat", "lon", "speed", "course", "heading")
                if len(rows.beats) < MAX_BEATS and time_s % 60 and message.second < 60:
                    rows.beats.append(time_s - message.second)
                rows.positions.append((mmsi, time_s, *(float(getattr(message, name)) for name in names), line))
            if kind in PARTICULARS:
                rows.particulars.append(_particulars(message, mmsi, time_s))
            rows.messages += 1
    except Exception:  # pyais lets errors of many kinds through for messages that are cut short
        rows.drop("undecodable", line, "cannot be decoded")


def _particulars(message: Any, mmsi: int, time_s: float) -> tuple[Any, ...]:
    """A row of particulars; of a report in two halves each fills in its own columns."""
    name, ship_type, *sizes = (getattr(message, field, None) for field in ("shipname", "ship_type", *SIZES))
    return (
        mmsi,
        time_s,
        str(name or "").strip(),
        "" if ship_type is None else str(int(ship_type)),
        *(np.nan if size is None else float(size) for size in sizes),
        np.nan,
        np.nan,
    )
