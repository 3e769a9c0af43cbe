# SPDX-License-Identifier: Apache-2.0
"""The launches of a whole frame, recorded once and replayed as one: no Python between kernels.

A recording holds launch sizes and array addresses. Buffers are allocated once, and what changes from frame to frame
(camera, lights, depth, vertices) is read from memory by the kernels, so a recording serves every frame for which the
host would decide the same: ``key`` says all of that. The first frame of a key is launched kernel by kernel (which also
compiles what has to be compiled), the second is recorded, from then on it is replayed.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any

import warp as wp

_KEPT = 8


class FrameGraphs:
    """Recordings of frames on one device, the least recently used one dropped when there are too many."""

    def __init__(self, device: Any) -> None:
        self._device = device
        self._graphs: OrderedDict[Hashable, Any] = OrderedDict()  # None: seen, not recorded yet

    def run(self, key: Hashable, launch: Callable[[], None]) -> bool:
        """Do what ``launch`` does: its launches must depend on nothing but ``key`` and memory. Returns whether they
        were recorded, which takes longer."""
        if key not in self._graphs:
            launch()
            self._graphs[key] = None
            if len(self._graphs) > _KEPT:
                self._graphs.popitem(last=False)
            return False
        self._graphs.move_to_end(key)
        record = self._graphs[key] is None
        if record:
            with wp.ScopedCapture(device=self._device, force_module_load=False) as capture:
                launch()
            self._graphs[key] = capture.graph
        wp.capture_launch(self._graphs[key])
        return record

    def recorded(self) -> int:
        """How many recordings there are."""
        return sum(graph is not None for graph in self._graphs.values())

    def clear(self) -> None:
        """Drop them all: addresses have changed."""
        self._graphs.clear()
