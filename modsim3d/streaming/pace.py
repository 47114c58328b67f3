"""The pace of a stream in real time."""

from __future__ import annotations

import time
from collections.abc import Callable


class Pace:
    """Lets no step leave before its time, counted from the first step, and notes the step that was latest.

    Every due time is counted from the first step, so that errors do not add up.

    Attributes:
        late_s: How much later than its time the latest step left.
        latest: That step; None before the first one.
    """

    def __init__(
        self, clock: Callable[[], float] = time.monotonic, sleep: Callable[[float], object] = time.sleep
    ) -> None:
        """Start with the first step that is waited for."""
        self.late_s = 0.0
        self.latest: int | None = None
        self._clock, self._sleep = clock, sleep
        self._zero: float | None = None

    def wait(self, step: int, time_s: float) -> None:
        """Wait until the time of a step has come; a step that is late leaves at once."""
        if self._zero is None:
            self._zero = self._clock() - time_s
        due = self._zero + time_s
        while (left := due - self._clock()) > 0:
            self._sleep(left)
        if self.latest is None or -left > self.late_s:
            self.late_s, self.latest = -left, step
