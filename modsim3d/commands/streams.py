"""Standard output and standard error of the command line, whose readers may go away before the command ends.

`modsim3d verify RUN | head` ends as `modsim3d verify RUN` does, with the status of its verdict: what nobody reads is
dropped, and the work goes on. A status of its own, such as the 141 of programs that SIGPIPE kills, would hide the
verdict, and stopping there would leave undone what the command had still to write.
"""

from __future__ import annotations

import io
import select
import sys

from modsim3d.errors import ModsimError


class _Descriptor(io.FileIO):
    """A descriptor to write to that raises nothing, so that no output decides how a command ends.

    Attributes:
        problem: Why something could not be written, other than that nobody reads it; None if nothing was lost.
        unread: Nobody reads it any more.
    """

    problem: OSError | None = None
    unread = False

    def write(self, data: object, /) -> int:
        """Write data, or drop it."""
        view = memoryview(data)  # type: ignore[arg-type]
        try:
            return super().write(view)
        except BrokenPipeError:
            self.unread = True
            return view.nbytes
        except OSError as error:
            self.problem = self.problem or error
            return view.nbytes


def prepare_output() -> None:
    """Let standard output replace what its encoding lacks, and let neither stream fail when its reader goes away."""
    if (output := _prepared(sys.stdout, "replace")) is not None:
        sys.stdout = output
    if (output := _prepared(sys.stderr, "backslashreplace")) is not None:
        sys.stderr = output


def _prepared(stream: object, errors: str) -> io.TextIOWrapper | None:
    """A stream in place of one of the interpreter's own; None if another has taken its place, as in tests."""
    if not isinstance(stream, io.TextIOWrapper):
        return None
    stream.reconfigure(errors=errors)
    raw = getattr(stream.buffer, "raw", stream.buffer)
    if type(raw) is not io.FileIO:
        return None
    stream.flush()
    descriptor = _Descriptor(raw.fileno(), "wb", closefd=False)
    return io.TextIOWrapper(
        descriptor if raw is stream.buffer else io.BufferedWriter(descriptor),
        encoding=stream.encoding,
        errors=errors,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )


def lost_output() -> OSError | None:
    """Why some of standard output could not be written, as on a full disk; None if all was, or nobody read it."""
    if sys.stdout is None or not isinstance(sys.stdout, io.TextIOWrapper):
        return None
    sys.stdout.flush()
    raw = getattr(sys.stdout.buffer, "raw", sys.stdout.buffer)
    return raw.problem if isinstance(raw, _Descriptor) else None


def write_at_once(data: bytes) -> bool:
    """Write bytes to standard output past its buffer; False if nobody reads it any more, or it cannot be written to.

    Nothing is left for later, so a command whose reader has stopped reading can be interrupted.

    Raises:
        ModsimError: There is no standard output.
    """
    if sys.stdout is None:
        raise ModsimError("there is no standard output to write to")
    sys.stdout.flush()
    raw = getattr(sys.stdout.buffer, "raw", sys.stdout.buffer)
    rest = memoryview(data)
    while rest:
        written = raw.write(rest)
        if written is None:  # a pipe that does not block is full
            select.select([], [raw], [])
        rest = rest[written or 0 :]
    return not (isinstance(raw, _Descriptor) and (raw.unread or raw.problem is not None))
