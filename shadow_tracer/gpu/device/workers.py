# SPDX-License-Identifier: Apache-2.0
"""Threads that work side by side on the CPU. Kernels run outside of Python's lock, so that two threads take half the
time of one.

An exception can reach the calling thread between any two steps of Python: Ctrl-C, a signal handler that raises, a
timeout. Three rules keep a job from running on in buffers that a later frame uses:

- a turn is known to ``settle`` before a thread can begin one of its jobs;
- a job runs only while its own lock is held, and only if the turn is still open when the lock has been taken, so a turn
  that is closed and whose locks have all been held once is over;
- what the calling thread waits for are plain locks, which an exception leaves either taken or not. ``threading`` and
  ``concurrent.futures`` wait in Python code, which an exception can leave half done.
"""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable, Sequence
from queue import SimpleQueue

# Beyond, the triangles that every thread looks at cost more than the rays it need not.
MOST = 8

Job = Callable[[], None]


def available_cores() -> int:
    """Cores that this process may use, at most :data:`MOST`."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(cores, MOST))


class _Turn:
    """Jobs of one call; number 0 belongs to the calling thread."""

    def __init__(self, jobs: Sequence[Job]) -> None:
        self._jobs = jobs
        self._running = [threading.Lock() for _ in jobs]
        self._ended = [threading.Lock() for _ in jobs]
        for lock in self._ended:
            lock.acquire()
        self._errors: list[BaseException | None] = [None] * len(jobs)
        self._closed = False

    def do(self, number: int) -> None:
        """Do a job, unless the turn is closed. Called by its thread."""
        with self._running[number]:
            if self._closed:
                return
            try:
                self._jobs[number]()
            except BaseException as error:
                self._errors[number] = error
        self._ended[number].release()

    def wait(self) -> None:
        """Wait until all jobs but the first have ended; raises what one of them raised."""
        for ended in self._ended[1:]:
            ended.acquire()
        for error in self._errors:
            if error is not None:
                raise error

    def close(self) -> None:
        """When this returns, none of the jobs runs and none will begin."""
        self._closed = True
        for running in self._running[1:]:
            with running:
                pass


class Workers:
    """A thread for each job beyond the first, which the caller does itself.

    After a fork the child begins with threads that it starts when it first needs them: those of the parent do not exist
    there.

    Args:
        count: the most jobs at once.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._turn: _Turn | None = None
        self._inboxes: list[SimpleQueue[tuple[_Turn, int] | None]] = []
        self._process = os.getpid()

    def run(self, jobs: Sequence[Job]) -> None:
        """Do all jobs, at most ``count``, and return when all have ended. What one of them raises, or reaches the
        calling thread meanwhile, comes out when those have ended that had begun; the others are not done."""
        self.settle()
        self._turn = turn = _Turn(jobs)
        try:
            for number in range(1, len(jobs)):
                self._inbox(number - 1).put((turn, number))
            jobs[0]()
            turn.wait()
        except BaseException:
            self.settle()
            raise
        self._turn = None

    def settle(self) -> None:
        """Return when no job of an earlier call runs any more, and none will."""
        if self._process != os.getpid():
            self._inboxes, self._turn, self._process = [], None, os.getpid()
        if self._turn is not None:
            self._turn.close()
            self._turn = None

    def _inbox(self, number: int) -> SimpleQueue[tuple[_Turn, int] | None]:
        while len(self._inboxes) <= number:
            inbox: SimpleQueue[tuple[_Turn, int] | None] = SimpleQueue()
            # A thread that waits for nobody any more must not keep the process, nor live on after its tracer.
            weakref.finalize(self, inbox.put, None)
            threading.Thread(target=_serve, args=(inbox,), name="shadow_tracer", daemon=True).start()
            self._inboxes.append(inbox)
        return self._inboxes[number]


def one_after_the_other(jobs: Sequence[Job]) -> None:
    """Do all jobs in this thread."""
    for job in jobs:
        job()


def _serve(inbox: SimpleQueue[tuple[_Turn, int] | None]) -> None:
    while (task := inbox.get()) is not None:
        turn, number = task
        turn.do(number)
        del task, turn  # they hold the buffers of a tracer
