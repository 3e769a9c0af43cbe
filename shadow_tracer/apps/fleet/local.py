# SPDX-License-Identifier: Apache-2.0
"""Jobs by processes of this machine."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any, TypeVar

J = TypeVar("J")
R = TypeVar("R")


def run_local(
    work: Callable[[J], R],
    jobs: Sequence[J],
    workers: int,
    retries: int,
    good: Callable[[R], bool],
    done: Callable[[J, R | Exception], None],
) -> None:
    """Do jobs in worker processes, and again those whose result is not good or whose process died.

    Args:
        work: a function of a module, of data that can be sent to a process.
        jobs: what it is called with.
        workers: processes.
        retries: how often a job is done again.
        good: whether a result is one that stays.
        done: called once for each job with its last result, or with what was raised.
    """
    run = _Run(jobs, workers, retries, good, done)
    while run.left:
        run.round(work)


class _Run:
    """Jobs that are left. After a process has died nobody knows by whose fault: what was in the works then is done one
    by one."""

    def __init__(self, jobs: Sequence[Any], workers: int, retries: int, good: Any, done: Any) -> None:
        self._waiting = deque((job, 0) for job in jobs)
        self._suspects: deque[tuple[Any, int]] = deque()
        self._workers = workers
        self._retries = retries
        self._good = good
        self._done = done

    @property
    def left(self) -> bool:
        """Whether there is more to do."""
        return bool(self._waiting or self._suspects)

    def round(self, work: Callable[[Any], Any]) -> None:
        """Do all, or until a process dies."""
        careful = bool(self._suspects)
        queue = self._suspects if careful else self._waiting
        workers = 1 if careful else min(self._workers, len(queue))
        spawn = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(workers, mp_context=spawn, initializer=_begin, initargs=(os.getpid(),))
        open_ones: dict[Future[Any], tuple[Any, int]] = {}
        with pool, _ended_at_once():
            while queue or open_ones:
                try:
                    while queue and len(open_ones) < workers:
                        open_ones[pool.submit(work, queue[0][0])] = queue[0]
                        queue.popleft()
                except BrokenProcessPool:
                    pass  # as the results say
                finished, _ = wait(open_ones, return_when=FIRST_COMPLETED)
                if any(isinstance(each.exception(), BrokenProcessPool) for each in finished):
                    self._broken(open_ones, careful)
                    return
                for each in finished:
                    self._take(*open_ones.pop(each), each.exception() or each.result())

    def _broken(self, open_ones: dict[Future[Any], tuple[Any, int]], careful: bool) -> None:
        wait(open_ones)
        for future, (job, tries) in open_ones.items():
            error = future.exception()
            if not isinstance(error, BrokenProcessPool):
                self._take(job, tries, error or future.result())
            elif not careful:
                self._suspects.append((job, tries))
            else:
                self._take(job, tries, RuntimeError("the process that did it died; is there enough memory?"))

    def _take(self, job: Any, tries: int, result: Any) -> None:
        fine = not isinstance(result, BaseException) and self._good(result)
        if fine or tries >= self._retries:
            self._done(job, result)
        else:
            self._waiting.append((job, tries + 1))


@contextmanager
def _ended_at_once() -> Iterator[None]:
    """Whoever is interrupted does not wait for what is in the works: it is whole or not there."""
    try:
        yield
    except BaseException:
        for child in multiprocessing.active_children():
            child.terminate()
        raise


def _begin(parent: int) -> None:
    """A worker ends with whoever started it, and leaves Ctrl-C to that one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
