# SPDX-License-Identifier: Apache-2.0
"""Jobs by a cluster of Dask. That each is done once is not asked of it: a job that runs again does no harm, and what is
done is known by its result's file, whatever the scheduler has forgotten."""

from __future__ import annotations

import queue
import secrets
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, TypeVar

J = TypeVar("J")
R = TypeVar("R")
PATIENCE = 300.0  # seconds for which a scheduler may be away
_CONNECT = 10.0
# A cluster looks after itself so often that scheduler and two idle workers keep a tenth of a core busy.
_SELDOM = {
    "distributed.admin.tick.interval": "500ms", "distributed.admin.system-monitor.interval": "5s",
    "distributed.worker.memory.monitor-interval": "1s", "distributed.worker.profile.enabled": False,
}  # fmt: skip
_LOOK = 5.0  # seconds after which it is asked whether the scheduler still knows the jobs


def run_dask(
    work: Callable[[J], R],
    jobs: Sequence[J],
    address: str,
    file: str,
    workers: int,
    retries: int,
    good: Callable[[R], bool],
    known: Callable[[J], R | None],
    done: Callable[[J, R | Exception], None],
) -> None:
    """Do jobs on a cluster, and again those whose result is not good; while its scheduler is away they wait.

    Args:
        work: a function of a module that the workers have, too.
        jobs: what it is called with.
        address: of the scheduler, such as tcp://host:8786; "": see ``file``.
        file: that the scheduler wrote; "" with no address either: a cluster of this machine is started.
        workers: of that one, processes.
        retries: how often a job is done again.
        good: whether a result is one that stays.
        known: the result of a job that is done already.
        done: called once for each job with its last result, or with what was raised.

    Raises:
        OSError: there is no scheduler, or it stayed away.
    """
    import dask
    from distributed import LocalCluster

    left = [(job, 0) for job in jobs]
    if address or file:
        _with_scheduler(
            work, left, {"address": address} if address else {"scheduler_file": file}, retries, good, known, done
        )
        return
    # 127.0.0.1: nobody else is to be served.
    with (
        dask.config.set(_SELDOM),
        LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None
        ) as cluster,
    ):
        where = {"address": cluster.scheduler_address}
        _with_scheduler(work, left, where, retries, good, known, done)


def _with_scheduler(
    work: Any, left: list[tuple[Any, int]], where: dict[str, str], retries: int, good: Any, known: Any, done: Any
) -> None:
    first = True
    while left:
        client = _client(where, _CONNECT if first else PATIENCE)
        first = False
        try:
            left = _Round(client, work, left, retries, good, done).finish()
        finally:
            with suppress(Exception):  # it may be gone
                client.close(timeout=2)
        again = []
        for job, tries in left:  # the connection was lost: some may be done meanwhile
            result = known(job)
            if result is None:
                again.append((job, tries))
            else:
                done(job, result)
        left = again


def _client(where: dict[str, str], patience: float) -> Any:
    from distributed import Client

    end = time.monotonic() + patience
    while True:
        try:
            return Client(**where, timeout=_CONNECT, set_as_default=False)
        except (OSError, ValueError) as error:
            if time.monotonic() > end:
                place = next(iter(where.values()))
                raise OSError(f"the scheduler of Dask at {place} does not answer: {error}") from error
            time.sleep(1.0)


class _Round:
    """Jobs of one connection."""

    def __init__(self, client: Any, work: Any, jobs: list[tuple[Any, int]], retries: int, good: Any, done: Any) -> None:
        self._client = client
        self._work = work
        self._retries = retries
        self._good = good
        self._done = done
        self._name = f"shadow_tracer-{secrets.token_hex(4)}"
        self._count = 0
        self._open: dict[Any, tuple[Any, int]] = {}
        self._finished: queue.Queue[Any] = queue.Queue()
        for job, tries in jobs:
            self._submit(job, tries)

    def _submit(self, job: Any, tries: int) -> None:
        self._count += 1
        future = self._client.submit(self._work, job, key=f"{self._name}-{self._count}", pure=False)
        self._open[future.key] = job, tries
        future.add_done_callback(self._finished.put)

    def finish(self) -> list[tuple[Any, int]]:
        """Wait for all. Returns what is left when the connection is lost."""
        while self._open:
            future = self._next()
            if future is None or future.status in ("cancelled", "lost"):
                return list(self._open.values())
            if future.key not in self._open:
                continue
            job, tries = self._open.pop(future.key)
            try:
                result = future.exception(timeout=_CONNECT) or future.result(timeout=_CONNECT)
            except Exception:  # the worker or the scheduler that had it is gone
                return [*self._open.values(), (job, tries)]
            future.release()  # or it would be done again for a worker that is lost
            fine = not isinstance(result, BaseException) and self._good(result)
            if fine or tries >= self._retries:
                self._done(job, result)
            else:
                self._submit(job, tries + 1)
        return []

    def _next(self) -> Any:
        """The next that is finished; None if the connection is lost."""
        while True:
            try:
                return self._finished.get(timeout=_LOOK)
            except queue.Empty:
                if self._client.status != "running" or not self._is_known():
                    return None

    def _is_known(self) -> bool:
        """Whether the scheduler still has our jobs: one that was started again has forgotten them."""
        key = next(iter(self._open))
        try:
            return bool(self._client.run_on_scheduler(_has, key=key))
        except Exception:  # whatever a connection that is breaking raises
            return False


def _has(key: str, dask_scheduler: Any = None) -> bool:
    return key in dask_scheduler.tasks
