# SPDX-License-Identifier: Apache-2.0
"""How long each stage of a frame takes. Wall clock on the CPU, events on CUDA (read once, at the end: no waiting in
between)."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import warp as wp


class Stages:
    """Milliseconds per named stage, in the order of first use; a stage used several times in a frame adds up."""

    def __init__(self, device: Any) -> None:
        self._device = device
        self._on_host = bool(device.is_cpu)
        self._times: dict[str, float] = {}
        self._events: list[tuple[str, wp.Event, wp.Event]] = []
        self._pool: list[wp.Event] = []
        self._paused = False

    def reset(self) -> None:
        """Begin a new frame."""
        self._times = {}
        for _, begin, end in self._events:
            self._pool += [begin, end]
        self._events = []

    def stage(self, name: str) -> _Stage:
        """Time what happens inside as stage ``name``."""
        return _Stage(self, name)

    def _begin(self, name: str) -> float | wp.Event | None:
        if self._paused:
            return None
        self._times.setdefault(name, 0.0)
        if self._on_host:
            return time.perf_counter()
        return wp.get_stream(self._device).record_event(self._event())

    def _end(self, name: str, begin: float | wp.Event | None) -> None:
        if isinstance(begin, float):
            self._times[name] += (time.perf_counter() - begin) * 1e3
        elif begin is not None:
            self._events.append((name, begin, wp.get_stream(self._device).record_event(self._event())))

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Stages inside are not timed: what is recorded cannot be."""
        self._paused = True
        try:
            yield
        finally:
            self._paused = False

    def read(self) -> dict[str, float]:
        """Stage name to milliseconds. Waits for the device."""
        times = dict(self._times)
        for name, begin, end in self._events:
            times[name] += wp.get_event_elapsed_time(begin, end)
        return times

    def _event(self) -> wp.Event:
        return self._pool.pop() if self._pool else wp.Event(self._device, enable_timing=True)


class _Stage:
    """A stage, or a part of it: a class, because a generator takes five times as long as it has to tell."""

    __slots__ = ("_begin", "_name", "_stages")

    def __init__(self, stages: Stages, name: str) -> None:
        self._stages, self._name = stages, name

    def __enter__(self) -> None:
        self._begin = self._stages._begin(self._name)

    def __exit__(self, *_: object) -> None:
        self._stages._end(self._name, self._begin)
