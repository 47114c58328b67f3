"""What a reader did with an input: it accepted it, refused it with a clear error, or failed."""

from __future__ import annotations

import sys
import traceback
import unicodedata
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

from modsim3d.errors import InputError, ModsimError

ACCEPTED, REFUSED, FAILED = "accepted", "refused", "failed"
MOST_LINES, MOST_CHARACTERS = 202, 2010
"""Most lines of a message, and most characters of a line, without the folder of the input."""


@dataclass(frozen=True)
class Outcome:
    """What became of an input.

    Attributes:
        verdict: `accepted`, `refused` or `failed`.
        said: The message of a refusal, or what went wrong.
        place: For a failure, its kind and where in modsim3d it arose: equal for failures of one cause.
    """

    verdict: str
    said: str = ""
    place: str = ""


def outcome_of(read: Callable[[Path], None], folder: Path, also_names: Collection[str] = ()) -> Outcome:
    """Read what lies in a folder and judge what happens.

    An error must name the folder or one of `also_names`. Warnings must be errors when this is called.
    """
    late: list[str] = []
    before, sys.unraisablehook = sys.unraisablehook, lambda found: late.append(repr(found.exc_value))
    try:
        read(folder)
    except ModsimError as error:
        found = _of_refusal(error, str(folder), also_names)
    except Exception as error:
        found = Outcome(FAILED, _brief(f"{type(error).__name__}: {error}"), f"{type(error).__name__} {place_of(error)}")
    else:
        found = Outcome(ACCEPTED)
    finally:
        sys.unraisablehook = before
    return Outcome(FAILED, _brief(late[0]), "left open") if late else found


def _of_refusal(error: ModsimError, folder: str, also_names: Collection[str]) -> Outcome:
    message = str(error)
    fault = message_fault(message.replace(folder, ""))
    if isinstance(error, InputError) and any("\n" in text for text in (error.source, *error.problems)):
        fault = fault or "holds a line break within a problem"
    if not fault and not any(name in message for name in (folder, *also_names)):
        fault = "does not name the source"
    if fault:
        return Outcome(FAILED, f"the message {fault}: {_brief(message)}", f"message {fault} {place_of(error)}")
    return Outcome(REFUSED, message)


def message_fault(message: str) -> str:
    """What is wrong with a message to a user; empty if nothing is."""
    if not message.strip():
        return "is empty"
    if any(unicodedata.category(sign) in ("Cc", "Cf", "Cs", "Zl", "Zp") for sign in message.replace("\n", "")):
        return "holds control characters"
    lines = message.split("\n")
    if len(lines) > MOST_LINES:
        return f"has more than {MOST_LINES} lines"
    if max(map(len, lines)) > MOST_CHARACTERS:
        return f"has a line of more than {MOST_CHARACTERS} characters"
    return ""


def place_of(error: BaseException) -> str:
    """The innermost function of modsim3d in which an error arose."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "/modsim3d/" in frame.filename] or frames
    return f"{Path(own[-1].filename).stem}.{own[-1].name}" if own else ""


def _brief(text: str) -> str:
    plain = text.encode("ascii", "backslashreplace").decode().replace("\x1b", "\\x1b").replace("\n", " | ")
    return plain if len(plain) <= 300 else plain[:200] + " ... " + plain[-80:]
