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

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what happens inside as stage ``name``."""
        if self._paused:
            yield
            return
        self._times.setdefault(name, 0.0)
        if self._device.is_cpu:
            begin = time.perf_counter()
            try:
                yield
            finally:
                self._times[name] += (time.perf_counter() - begin) * 1e3
        else:
            first, last = self._event(), self._event()
            stream = wp.get_stream(self._device)
            stream.record_event(first)
            try:
                yield
            finally:
                stream.record_event(last)
                self._events.append((name, first, last))

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
