# SPDX-License-Identifier: Apache-2.0
"""Makes the tracer and does what takes long with it in a thread, so that the node answers meanwhile: the first start
compiles kernels. No ROS here."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from shadow_tracer import ShadowTracer
from shadow_tracer.ros.settings import Settings
from shadow_tracer.self_test import Result, run

Done = Callable[["Outcome"], None]


@dataclass(frozen=True)
class Outcome:
    """How a job ended: what it returned, why it failed ("" if it did not), its seconds."""

    value: Any
    error: str
    seconds: float


@dataclass(frozen=True)
class _Job:
    name: str
    work: Callable[[], Any]
    done: Done


class TracerHost:
    """Owns the tracer. One job at a time runs in a thread; meanwhile ``tracer`` is None and nobody else touches it.

    Args:
        on_done: called from the thread when a job has ended; must only wake somebody up who calls :meth:`collect`.
    """

    def __init__(self, on_done: Callable[[], None]) -> None:
        self._on_done = on_done
        self._tracer: ShadowTracer | None = None
        self._thread: threading.Thread | None = None
        self._running: _Job | None = None
        self._outcome: Outcome | None = None
        self._waiting: list[_Job] = []
        self._started = 0.0
        self._cones = False

    @property
    def tracer(self) -> ShadowTracer | None:
        """The tracer if it is ready to be used, else None."""
        return None if self.busy else self._tracer

    @property
    def made(self) -> ShadowTracer | None:
        """The tracer to look at, be it busy; None before it could be made."""
        return self._tracer

    @property
    def busy(self) -> bool:
        """True while a job runs or its outcome has not been collected."""
        return self._thread is not None

    @property
    def doing(self) -> str:
        """Name of the running job, "" if there is none: start, select, verify, cones or self-test."""
        return self._running.name if self._running else ""

    @property
    def ready_for_cones(self) -> bool:
        """Whether kernels for cones have been loaded, or could not be."""
        return self._cones

    def busy_for(self) -> float:
        """Seconds since the running job began."""
        return time.monotonic() - self._started

    def start(self, settings: Settings, done: Done) -> None:
        """Make the tracer these settings ask for and compile its kernels."""

        def work() -> None:
            tracer = ShadowTracer(
                pipeline=settings.pipeline,
                variant=settings.variant or None,
                device=settings.tracer_device,
                bounds=settings.bounds,
                threads=settings.threads or None,
            )
            tracer.warm_up()
            if settings.verify_every:
                tracer.prepare_verify()
            self._tracer = tracer

        self._submit(_Job("start", work, done))

    def select(self, settings: Settings, done: Done) -> None:
        """Change to the pipeline and variant of these settings; the last wish counts if a job is running."""

        def work() -> None:
            tracer = self._needed()
            before = (tracer.pipeline, tracer.variant)
            try:
                tracer.select(settings.pipeline, settings.variant or None)
                tracer.warm_up(cones=self._cones)
                if settings.verify_every:
                    tracer.prepare_verify()
            except Exception:
                tracer.select(*before)
                raise

        self._submit(_Job("select", work, done))

    def verify(self, wanted: bool, done: Done) -> None:
        """Make the second pipeline of ``verify_every``, or free its buffers."""

        def work() -> None:
            if wanted:
                self._needed().prepare_verify()
            else:
                self._needed().release_verify()

        self._submit(_Job("verify", work, done))

    def prepare_cones(self, done: Done) -> None:
        """Compile or load the kernels for cones."""

        def work() -> None:
            self._cones = True  # whatever comes of it: not again before each question
            self._needed().warm_up(cones=True)

        self._submit(_Job("cones", work, done))

    def self_test(self, done: Done) -> None:
        """Trace a built-in scene on every pipeline; the outcome's value is a list of :class:`self_test.Result`."""

        def work() -> list[Result]:
            return run(self._needed().device, threads=self._needed().threads)

        self._submit(_Job("self-test", work, done))

    def release(self) -> None:
        """Free the tracer; only while nothing runs."""
        if self.busy:
            raise RuntimeError(f"tracer: {self.doing} is running")
        self._tracer = None
        self._cones = False
        self._waiting.clear()

    def collect(self) -> None:
        """If a job has ended, tell the one who asked for it, and begin the next."""
        thread, job, outcome = self._thread, self._running, self._outcome
        if thread is None or job is None or outcome is None:
            return
        thread.join()
        self._thread = self._running = self._outcome = None
        if self._waiting and self._tracer is not None:
            self._begin(self._waiting.pop(0))
        job.done(outcome)

    def join(self, timeout: float) -> bool:
        """Wait for a running job; False if it still runs after ``timeout`` seconds: a compiler cannot be stopped."""
        if self._thread is not None:
            self._thread.join(timeout)
            return not self._thread.is_alive()
        return True

    def _needed(self) -> ShadowTracer:
        if self._tracer is None:
            raise RuntimeError("the tracer has not been made")
        return self._tracer

    def _submit(self, job: _Job) -> None:
        # The last wish for a pipeline counts; every self-test gets its answer. A start has the settings of now: what
        # was wished before is in them.
        if job.name == "start":
            self._waiting.clear()
        elif job.name != "self-test":
            self._waiting = [other for other in self._waiting if other.name != job.name]
        self._waiting.append(job)
        if not self.busy and (self._tracer is not None or job.name == "start"):
            self._begin(self._waiting.pop(0))

    def _begin(self, job: _Job) -> None:
        self._running, self._started = job, time.monotonic()

        def guarded() -> None:
            value, error = None, ""
            try:
                value = job.work()
            except Exception as fault:  # whatever a driver or compiler raises, the node says it and lives
                error = f"{fault}" or type(fault).__name__
            self._outcome = Outcome(value, error, time.monotonic() - self._started)
            self._on_done()

        self._thread = threading.Thread(target=guarded, name="tracer", daemon=True)
        self._thread.start()
