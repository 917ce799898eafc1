"""A progress bar on a terminal; nothing in a pipe."""

from __future__ import annotations

import math
import sys
import time
from types import TracebackType
from typing import Final, Self, TextIO

_WIDTH: Final = 30
_REDRAW_S: Final = 0.1


class Progress:
    """Shows how many of ``total`` are done, on stderr, and leaves no trace when it ends."""

    def __init__(self, label: str, total: int, stream: TextIO | None = None) -> None:
        self._label = label
        self._total = max(total, 1)
        self._stream = sys.stderr if stream is None else stream
        self._shown = self._stream.isatty()
        self._drawn_s = 0.0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._shown:
            self._stream.write("\r\x1b[K")
            self._stream.flush()

    def update(self, done: int) -> None:
        """Say how many are done; draws no more often than an eye follows."""
        now_s = time.monotonic()
        if not self._shown or (now_s - self._drawn_s < _REDRAW_S and done < self._total):
            return
        self._drawn_s = now_s
        filled = _WIDTH * min(done, self._total) // self._total
        bar = "#" * filled + "." * (_WIDTH - filled)
        self._stream.write(f"\r\x1b[K{self._label} [{bar}] {done}/{self._total}")
        self._stream.flush()


class Phases:
    """A bar for each part of something long, one after the other."""

    def __init__(self) -> None:
        self._name = ""
        self._bar: Progress | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def tell(self, name: str, done: float, total: float) -> None:
        """Show how far the part called ``name`` is."""
        if name != self._name:
            self._end()
            self._name, self._bar = name, Progress(name, math.ceil(total)).__enter__()
        if self._bar is not None:
            self._bar.update(int(done))

    def _end(self) -> None:
        if self._bar is not None:
            self._bar.__exit__(None, None, None)
