# SPDX-License-Identifier: Apache-2.0
"""Threads that work side by side on the CPU. Kernels run outside of Python's lock, so that two threads take half the
time of one."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

# Beyond, the triangles that every thread looks at cost more than the rays it need not.
MOST = 8

Job = Callable[[], None]


def available_cores() -> int:
    """Cores that this process may use, at most :data:`MOST`."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(cores, MOST))


class Workers:
    """A thread for each job beyond the first, which the caller does itself.

    Args:
        count: the most jobs at once.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._pool: ThreadPoolExecutor | None = None

    def run(self, jobs: Sequence[Job]) -> None:
        """Do all jobs, at most ``count``; returns, or raises what one of them raised, when all have ended."""
        if len(jobs) > 1 and self._pool is None:
            self._pool = ThreadPoolExecutor(self.count - 1, "shadow_tracer")
        others: list[Future[None]] = [self._pool.submit(job) for job in jobs[1:]] if self._pool else []
        try:
            jobs[0]()
        finally:
            errors = [other.exception() for other in others]  # waits for each
        for error in errors:
            if error is not None:
                raise error
