"""What a reader did with an input: it accepted it, refused it with a clear error, or failed."""

import contextlib
import io
import sys
import traceback
import unicodedata
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

from modsim3d.cli.terminal import say_error
from modsim3d.core.errors import InputError, ModsimError
from tests.cli.bad_input.builders import foreign

ACCEPTED, REFUSED, FAILED = "accepted", "refused", "failed"
MAX_LINES, MAX_CHARACTERS = 502, 2010
"""Most lines of a message, and most characters of a line, without the folder of the input."""
_UNSEEN = ("Cc", "Cs", "Zl", "Zp")
_TURNING = "\u061c\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"


@dataclass(frozen=True)
class Outcome:
    """What became of an input."""

    verdict: str  # `accepted`, `refused` or `failed`
    said: str = ""  # the message of a refusal, or what went wrong
    place: str = ""  # of a failure: its kind and where in modsim3d it arose, equal for failures of one cause


def outcome_of(read: Callable[[Path], None], folder: Path, also_names: Collection[str] = ()) -> Outcome:
    """Read what lies in a folder and judge what happens: an error must name the folder or one of `also_names`.
    Warnings must be errors when this is called."""
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
    fault = message_fault(error, folder)
    if not fault and not any(name in str(error) for name in (folder, *also_names)):
        fault = "does not name the source"
    if fault:
        return Outcome(FAILED, f"the message {fault}: {_brief(str(error))}", f"message {fault} {place_of(error)}")
    return Outcome(REFUSED, str(error))


def message_fault(error: ModsimError, folder: str = "") -> str:
    """What is wrong with the message of an error as the command line prints it; empty if nothing is."""
    texts = [error.source, *error.problems] if isinstance(error, InputError) else [str(error)]
    output = printed(error)
    if not "".join(texts).strip():
        return "is empty"
    if output.count("\n") > len(texts):
        return "holds a line break"
    if any(unicodedata.category(sign) in _UNSEEN or sign in _TURNING for sign in output.replace("\n", "")):
        return "holds control characters"
    if found := foreign(output):
        return f"has the words {found}, which are pydantic's"
    if len(texts) > MAX_LINES:
        return f"has more than {MAX_LINES} lines"
    if any(len(text.replace(folder, "")) > MAX_CHARACTERS for text in texts):
        return f"has a line of more than {MAX_CHARACTERS} characters"
    return ""


def printed(error: ModsimError) -> str:
    """What the command line writes of an error."""
    with contextlib.redirect_stderr(io.StringIO()) as stream:
        say_error(error)
    return stream.getvalue()


def place_of(error: BaseException) -> str:
    """The innermost function of modsim3d in which an error arose."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "/modsim3d/" in frame.filename] or frames
    return f"{Path(own[-1].filename).stem}.{own[-1].name}" if own else ""


def _brief(text: str) -> str:
    plain = text.encode("ascii", "backslashreplace").decode().replace("\x1b", "\\x1b").replace("\n", " | ")
    return plain if len(plain) <= 300 else plain[:200] + " ... " + plain[-80:]
