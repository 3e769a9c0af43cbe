# SPDX-License-Identifier: Apache-2.0
"""The launches of a whole frame, recorded once and replayed as one: no Python between kernels.

A recording holds launch sizes and array addresses. Buffers are allocated once, and what changes from frame to frame
(camera, lights, depth, vertices) is read from memory by the kernels, so a recording serves every frame for which the
host would decide the same: ``key`` says all of that. The first frame of a key is launched kernel by kernel (which also
compiles what has to be compiled), the second is recorded, from then on it is replayed. Where recording fails (a device
that cannot allocate meanwhile, no memory for the recording), frames of that key are launched kernel by kernel.
"""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Callable, Hashable
from enum import Enum, auto
from typing import Any

import warp as wp

_KEPT = 8
_log = logging.getLogger(__name__)


class _No(Enum):
    """What stands in the place of a recording."""

    RECORDED_YET = auto()
    RECORDING = auto()  # it has failed


def can_record(device: Any) -> bool:
    """Whether frames can be recorded on a device: scans and sorts allocate, which a recording allows from a memory pool
    alone."""
    return bool(device.is_cpu or (device.is_mempool_supported and device.is_mempool_enabled))


def end_recording(device: Any) -> None:
    """End the recording that an exception has left open, if there is one: else all that is launched goes into it."""
    try:
        wp.capture_end(device)
    except RuntimeError:
        pass  # there is none


class FrameGraphs:
    """Recordings of frames on one device, the least recently used one dropped when there are too many."""

    def __init__(self, device: Any) -> None:
        self._device = device
        self._graphs: OrderedDict[Hashable, Any] = OrderedDict()
        self._complained = False

    def run(self, key: Hashable, launch: Callable[[], None]) -> bool:
        """Do what ``launch`` does: its launches must depend on nothing but ``key`` and memory, and it may be called a
        second time if it fails while being recorded. Returns whether they were recorded, which takes longer."""
        graph = self._graphs.setdefault(key, None)
        self._graphs.move_to_end(key)
        if graph is None or graph is _No.RECORDING:
            launch()
            if graph is None:
                self._graphs[key] = _No.RECORDED_YET
            if len(self._graphs) > _KEPT:
                self._graphs.popitem(last=False)
            return False
        record = graph is _No.RECORDED_YET
        if record:
            try:
                with wp.ScopedCapture(device=self._device, force_module_load=False) as capture:
                    launch()
                graph = capture.graph
                wp.capture_launch(graph)
            except Exception as error:
                self._give_up(key, error)
                launch()
                return True
            self._graphs[key] = graph
        else:
            wp.capture_launch(graph)
        return record

    def _give_up(self, key: Hashable, error: Exception) -> None:
        self._graphs[key] = _No.RECORDING
        if not self._complained:
            self._complained = True
            _log.warning("%s: a frame could not be recorded and is launched kernel by kernel: %s", self._device, error)

    def recorded(self) -> int:
        """How many recordings there are."""
        return sum(not isinstance(graph, _No) for graph in self._graphs.values() if graph is not None)

    def clear(self) -> None:
        """Drop them all: addresses have changed."""
        self._graphs.clear()
