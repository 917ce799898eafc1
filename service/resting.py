"""Rest for workers beside the hot path: in proportion to what they worked, so that packets go first."""

from __future__ import annotations

import threading
import time


class StoppedError(Exception):
    """The service stops."""


class Rest:
    """Rests in proportion to the work done since it rested last; raises StoppedError once the service stops."""

    def __init__(self, stopping: threading.Event, times: float) -> None:
        self._stopping, self._times = stopping, times
        self._since_s = time.monotonic()

    def __call__(self) -> None:
        if self._stopping.wait(self._times * (time.monotonic() - self._since_s)):
            raise StoppedError
        self._since_s = time.monotonic()
