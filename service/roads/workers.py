"""Processes that match: Valhalla computes in C++ for longer than packets may wait, and might end its process."""

from __future__ import annotations

import logging
import multiprocessing
import queue
import signal
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any, Final

logger = logging.getLogger(__name__)

MOST_S: Final = 60.0
"""A stretch of minutes takes some hundredths of a second; a process that has not answered by then has gone astray."""
_ENDING_S: Final = 5.0
_TRIES: Final = 2


class MatcherProcesses:
    """Some processes with a folder's roads, each at one stretch at a time; a dead or lost one is started anew."""

    def __init__(self, folder: Path, count: int) -> None:
        self._workers = [_Worker(folder) for _ in range(count)]
        self._idle: queue.SimpleQueue[_Worker] = queue.SimpleQueue()
        self._threads: ThreadPoolExecutor | None = None

    def start(self) -> None:
        """Begin; each process starts with its first stretch."""
        self._threads = ThreadPoolExecutor(len(self._workers), thread_name_prefix="roads")
        for worker in self._workers:
            self._idle.put(worker)

    def stop(self) -> None:
        """End; what is under way is broken off and comes out as None."""
        for worker in self._workers:
            worker.end()
        if self._threads is not None:
            self._threads.shutdown(cancel_futures=True)
            self._threads = None

    def run(self, method: str, calls: Sequence[Sequence[Any]]) -> list[Any]:
        """Results of a ``Tracer``'s method, in the order of the calls; None for one that fails or ends its process."""
        if self._threads is None:
            return [None] * len(calls)
        return list(self._threads.map(lambda arguments: self._call(method, arguments), calls))

    def _call(self, method: str, arguments: Sequence[Any]) -> Any:
        worker = self._idle.get()
        try:
            return worker.call(method, arguments)
        finally:
            self._idle.put(worker)


class _Worker:
    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lock = threading.Lock()
        self._ended = False
        self._process: SpawnProcess | None = None
        self._pipe: Connection | None = None

    def call(self, method: str, arguments: Sequence[Any]) -> Any:
        """What the method returns; None if it fails, or ends its process twice."""
        for attempt in range(_TRIES):
            try:
                pipe = self._started()
                if pipe is None:
                    return None
                pipe.send((method, tuple(arguments)))
                if not pipe.poll(MOST_S):
                    raise TimeoutError(f"no answer in {MOST_S:.0f} s")
                result, problem = pipe.recv()
            except (OSError, EOFError) as error:  # TimeoutError is one
                self._kill()
                if self._ended:
                    return None
                logger.warning("a process that matches roads ended (%s), try %d", error or "it died", attempt + 1)
                continue
            if problem is not None:
                logger.error("roads: %s failed: %s", method, problem)
            return result
        logger.error("roads: %s ended or held up %d processes one after the other and is given up", method, _TRIES)
        return None

    def end(self) -> None:
        """End the process, and start none anew."""
        with self._lock:
            self._ended = True
        self._kill()

    def _started(self) -> Connection | None:
        with self._lock:
            if self._ended:
                return None
            if self._process is None or not self._process.is_alive():
                context = multiprocessing.get_context("spawn")
                ours, theirs = context.Pipe()
                self._process = context.Process(
                    target=_serve, args=(theirs, str(self._folder)), name="telefuse-roads", daemon=True
                )
                self._process.start()
                theirs.close()
                self._pipe = ours
            return self._pipe

    def _kill(self) -> None:
        with self._lock:
            process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.join(_ENDING_S)


def _serve(pipe: Connection, folder: str) -> None:
    """The process: answers calls until the other end of its pipe is closed."""
    from service.roads.trace import Tracer

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the service ends this process itself
    tracer = Tracer(Path(folder))
    while True:
        try:
            method, arguments = pipe.recv()
        except EOFError:
            return
        try:
            pipe.send((getattr(tracer, method)(*arguments), None))
        except Exception as error:  # whatever it is, the other end waits for an answer
            pipe.send((None, f"{type(error).__name__}: {error}"))
