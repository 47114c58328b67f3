"""How the process of a worker ended in the middle of a task."""

from __future__ import annotations

import platform
from dataclasses import dataclass
from signal import SIGHUP, SIGINT, SIGKILL, SIGTERM, Signals

STOPPING = (SIGTERM, SIGINT, SIGHUP)
"""Signals that a batch system or a user sends to all processes of a campaign, to stop it."""


@dataclass(frozen=True)
class Death:
    """The end of a worker in the middle of a task.

    Attributes:
        run: Number of the run that it had begun; None if that is unknown.
        how: Exit status or signal.
        outside: Whether something else than the run may have ended it, as the system does for want of memory.
        host: Name of its machine; empty if that is unknown.
    """

    run: int | None
    how: str
    outside: bool
    host: str = ""

    @classmethod
    def of(cls, run: int | None, code: int) -> Death:
        """From an exit status on this machine, or minus the number of a signal."""
        named = Signals(-code).name if -code in set(Signals) else f"signal {-code}"
        return cls(run, f"exit status {code}" if code >= 0 else named, -code == SIGKILL, platform.node())

    @property
    def error(self) -> str | None:
        """The error of the run; None if it is not known to have ended the process itself."""
        return None if self.outside or self.run is None else f"the run ended its worker process ({self.how})"


LOST = Death(None, "its Dask worker was lost", True)
"""A worker that was lost with all that is known of it."""
