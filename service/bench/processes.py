"""Work over the machine's cores: each job in a process, results in the jobs' order."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Final, TypeVar

_Job = TypeVar("_Job")
_Result = TypeVar("_Result")

MOST: Final = 8


def in_processes(work: Callable[[_Job], _Result], jobs: Sequence[_Job]) -> Iterator[_Result]:
    """``work`` of each job; with one core, or one job, in this process. ``work`` must be a module's own function."""
    workers = min(len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1, MOST)
    if workers == 1 or len(jobs) < 2:
        yield from map(work, jobs)
        return
    # Not forked: threads of this process (Zenoh, numba) may hold locks.
    with ProcessPoolExecutor(min(workers, len(jobs)), multiprocessing.get_context("spawn")) as pool:
        yield from pool.map(work, jobs)
