# SPDX-License-Identifier: Apache-2.0
"""Makes and warms up the tracer in a thread, so that the node answers meanwhile: the first start compiles kernels."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from shadow_tracer import ShadowTracer
from shadow_tracer.ros.settings import Settings


class TracerHost:
    """Owns the tracer. One job at a time runs in a thread; meanwhile ``tracer`` is None and nobody else touches it.

    Args:
        on_done: called from the thread when a job has ended; must only wake somebody up.
    """

    def __init__(self, on_done: Callable[[], None]) -> None:
        self._on_done = on_done
        self._tracer: ShadowTracer | None = None
        self._thread: threading.Thread | None = None
        self._result: tuple[str, float] | None = None
        self._started = 0.0
        self._wanted: tuple[str, str | None] | None = None

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
        """True while a job runs or its result has not been collected."""
        return self._thread is not None

    def busy_for(self) -> float:
        """Seconds since the running job began."""
        return time.monotonic() - self._started

    def start(self, settings: Settings) -> None:
        """Make the tracer these settings ask for and compile its kernels."""

        def job() -> None:
            tracer = ShadowTracer(
                pipeline=settings.pipeline,
                variant=settings.variant or None,
                device=settings.tracer_device,
                bounds=settings.bounds,
            )
            tracer.warm_up()
            self._tracer = tracer

        self._run(job)

    def select(self, settings: Settings) -> None:
        """Change to the pipeline and variant of these settings; the last wish counts if a job is running."""
        self._wanted = (settings.pipeline, settings.variant or None)
        self._next()

    def collect(self) -> tuple[str, float] | None:
        """The result of a job that has ended, once: why it failed, "" if it did not, and its seconds; else None."""
        thread, result = self._thread, self._result
        if thread is None or result is None:
            return None
        thread.join()
        self._thread = self._result = None
        self._next()
        return result

    def join(self, timeout: float) -> bool:
        """Wait for a running job; False if it still runs after ``timeout`` seconds: a compiler cannot be stopped."""
        if self._thread is not None:
            self._thread.join(timeout)
            return not self._thread.is_alive()
        return True

    def _next(self) -> None:
        if self._wanted is None or self.busy or self._tracer is None:
            return
        tracer, (pipeline, variant) = self._tracer, self._wanted
        self._wanted = None

        def job() -> None:
            before = (tracer.pipeline, tracer.variant)
            try:
                tracer.select(pipeline, variant)
                tracer.warm_up()
            except Exception:
                tracer.select(*before)
                raise

        self._run(job)

    def _run(self, job: Callable[[], None]) -> None:
        self._started = time.monotonic()

        def guarded() -> None:
            error = ""
            try:
                job()
            except Exception as fault:  # whatever a driver or compiler raises, the node says it and lives
                error = f"{fault}" or type(fault).__name__
            self._result = (error, time.monotonic() - self._started)
            self._on_done()

        self._thread = threading.Thread(target=guarded, name="tracer", daemon=True)
        self._thread.start()
